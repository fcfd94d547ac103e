//! Residuals of used, held-out and separate lengths.

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_pcg::Pcg64;

use super::lengths::{Lengths, Weighted};
use super::result::Residual;
use crate::measurement::{LengthModel, MeasurementPieces, Measurements, PreparedMeasurement};

const DEFAULT_FOLDS: usize = 5;
/// By default there are no folds with fewer lengths per parameter,
const LENGTHS_PER_PARAMETER: usize = 3;
/// nor with more lengths in total: with hundreds per parameter the held-out residuals are like the others.
const MAX_BY_DEFAULT: usize = 20_000;

/// The number of folds; `None` for no cross-validation.
pub(super) fn folds(asked: Option<usize>, lengths: usize, parameters: usize) -> Option<usize> {
    match asked {
        Some(0 | 1) => None,
        Some(folds) => Some(folds),
        None => {
            let enough = LENGTHS_PER_PARAMETER * parameters;
            (enough..=MAX_BY_DEFAULT).contains(&lengths).then_some(DEFAULT_FOLDS)
        }
    }
}

/// Root mean square of the held-out residuals, mm: each fold is predicted by `fit` of the others, without `outliers`. Rows
/// with equal axis angles (one pose measured to several balls) are in one fold, so that no fold is fitted to its own poses.
/// `None` if there are fewer poses than folds, or a fold leaves too few lengths to fit, as to a ball with a few of them.
pub(super) fn held_out_rms(
    lengths: &Lengths,
    outliers: &[usize],
    folds: usize,
    fit: impl Fn(&Lengths) -> Option<LengthModel>,
) -> Option<f64> {
    let fold_of = assign(lengths, folds)?;
    let used: Vec<usize> = (0..lengths.len()).filter(|at| outliers.binary_search(at).is_err()).collect();
    let mut residuals = vec![0.0; lengths.len()];
    for fold in 0..folds {
        let (held_out, others): (Vec<usize>, Vec<usize>) = used.iter().partition(|at| fold_of[**at] == fold);
        let model = fit(&lengths.at(&others))?;
        let prepared = model.prepare();
        held_out.into_iter().for_each(|at| residuals[at] = prepared.residual(&lengths.reading(at)));
    }
    let squares: f64 = used.iter().map(|at| residuals[*at] * residuals[*at]).sum();
    Some((squares / used.len().max(1) as f64).sqrt())
}

/// The fold of each reading: the poses, shuffled with a fixed seed, are assigned in turn.
fn assign(lengths: &Lengths, folds: usize) -> Option<Vec<usize>> {
    let bits = |at: usize| lengths.axes(at).map(f64::to_bits);
    let mut poses: Vec<[u64; 6]> = (0..lengths.len()).map(bits).collect();
    poses.sort_unstable();
    poses.dedup();
    if poses.len() < folds {
        return None;
    }
    let mut dealt: Vec<usize> = (0..poses.len()).map(|at| at % folds).collect();
    dealt.shuffle(&mut Pcg64::seed_from_u64(1));
    Some((0..lengths.len()).map(|at| poses.binary_search(&bits(at)).map_or(0, |at| dealt[at])).collect())
}

#[derive(Clone, Copy, Default)]
struct Sums {
    count: usize,
    sum: f64,
    squares: f64,
    max: f64,
}

impl Sums {
    fn of(residuals: impl Iterator<Item = f64>) -> Self {
        residuals.fold(Self::default(), |sums, residual| {
            sums.and(Self { count: 1, sum: residual, squares: residual * residual, max: residual.abs() })
        })
    }

    fn and(self, other: Self) -> Self {
        Self {
            count: self.count + other.count,
            sum: self.sum + other.sum,
            squares: self.squares + other.squares,
            max: self.max.max(other.max),
        }
    }

    fn residual(self) -> Option<Residual> {
        let count = self.count.max(1) as f64;
        let residual = Residual { rms: (self.squares / count).sqrt(), mean: self.sum / count, max: self.max };
        residual.rms.is_finite().then_some(residual)
    }
}

/// The residuals of the lengths that were used; `None` if they are not finite.
pub(super) fn residual_of_used(model: &LengthModel, used: &Weighted) -> Option<Residual> {
    let prepared = model.prepare();
    let pieces = used.in_pieces(|_, readings, sigma| {
        let weighted = readings.iter().zip(sigma).filter(|(_, sigma)| **sigma != f64::INFINITY);
        Sums::of(weighted.map(|(reading, _)| prepared.residual(reading)))
    });
    pieces.into_iter().fold(Sums::default(), Sums::and).residual()
}

/// The residuals of other lengths; `None` if they are not finite.
pub(super) fn residual_of(model: &LengthModel, set: &Measurements) -> Option<Residual> {
    let prepared = model.prepare();
    let readings = set.rows.iter().map(PreparedMeasurement::from);
    Sums::of(readings.map(|reading| prepared.residual(&reading))).residual()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::Options;
    use crate::measurement::BaseBall;
    use crate::robot::BallId;
    use crate::test_support::cell::{CENTRE, kr60, measure, three_planes};
    use nalgebra::Vector3;

    #[test]
    fn folds_by_default_need_enough_lengths() {
        for (asked, lengths, expected) in [
            (None, 29, None),
            (None, 30, Some(5)),
            (None, 20_001, None),
            (Some(1), 30, None),
            (Some(3), 4, Some(3)),
        ] {
            assert_eq!(folds(asked, lengths, 10), expected);
        }
    }

    /// With the true robot in each fold, held-out lengths are wrong by the error that was added; an outlier does not
    /// count.
    #[test]
    fn held_out_lengths_are_off_by_their_noise_and_a_fold_without_a_fit_gives_nothing() {
        let robot = kr60();
        let mut data = measure(&robot, &three_planes(1, CENTRE), 10, 30.0);
        for (at, row) in data.rows.iter_mut().enumerate() {
            row.length_mm += if at % 2 == 0 { 0.03 } else { -0.01 };
        }
        data.rows[4].length_mm += 5.0;
        let balls = [BaseBall { id: BallId::FIRST, position: Vector3::from(CENTRE) }];
        let model = LengthModel::new(robot.geometry.clone(), &balls);
        let options = Options::default();
        let lengths = Lengths::of(&data.rows, &options, &robot);
        let rms = held_out_rms(&lengths, &[4], 5, |_| Some(model.clone())).unwrap();
        // 14 lengths are off by 0.03 and 15 by 0.01 mm.
        let expected = ((14.0 * 0.03f64.powi(2) + 15.0 * 0.01f64.powi(2)) / 29.0).sqrt();
        assert!((rms / expected - 1.0).abs() < 1e-6, "{rms} {expected}");
        let of_most = |training: &Lengths| (training.len() > 23).then(|| model.clone());
        assert_eq!(held_out_rms(&lengths, &[4], 5, of_most), None);
        assert_eq!(held_out_rms(&lengths, &[4], 31, |_| Some(model.clone())), None);
    }
}
