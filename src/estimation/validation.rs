//! Cross-validation: lengths that the fit did not see.

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_pcg::Pcg64;

use super::lengths::Lengths;
use crate::catalogue::EstimationFinding;
use crate::measurement::LengthModel;

/// Number of folds when the user does not say, and lengths per parameter below which there are none.
const DEFAULT_FOLDS: usize = 5;
const LENGTHS_PER_PARAMETER: usize = 3;
/// Above so many lengths none are held out unasked: every parameter has hundreds, and what is held out fits like the rest.
const MOST_UNASKED: usize = 20_000;

/// How many folds there are; none where too few lengths are left for each parameter, or so many that it is not worth the time.
pub(super) fn folds(asked: Option<usize>, lengths: usize, parameters: usize) -> Option<usize> {
    match asked {
        Some(0 | 1) => None,
        Some(folds) => Some(folds),
        None => {
            let enough = LENGTHS_PER_PARAMETER * parameters;
            (enough..=MOST_UNASKED).contains(&lengths).then_some(DEFAULT_FOLDS)
        }
    }
}

/// Fits without each fold in turn, as `fit` does, and predicts its lengths: the residual of each that is not `out`, in
/// their order, mm. Rows with equal axis angles (one pose measured to several balls) stay together: a fold must not
/// know its own poses. `None` when there are fewer poses than folds.
pub(super) fn held_out(
    lengths: &Lengths,
    out: &[usize],
    folds: usize,
    fit: impl Fn(&Lengths) -> Result<LengthModel, EstimationFinding>,
) -> Result<Option<Vec<f64>>, EstimationFinding> {
    let Some(fold_of) = assign(lengths, folds) else { return Ok(None) };
    let used: Vec<usize> = (0..lengths.len()).filter(|at| out.binary_search(at).is_err()).collect();
    let mut residuals = vec![0.0; lengths.len()];
    for fold in 0..folds {
        let take = |chosen: bool| -> Vec<usize> {
            used.iter().copied().filter(|&at| (fold_of[at] == fold) == chosen).collect()
        };
        let (held_out, rest) = (take(true), take(false));
        let model = fit(&lengths.at(&rest))?;
        let prepared = model.prepare();
        for at in held_out {
            let reading = lengths.reading(at);
            residuals[at] = reading.length_mm - prepared.length(&reading);
        }
    }
    Ok(Some(used.into_iter().map(|at| residuals[at]).collect()))
}

/// Root mean square of held-out residuals, mm.
pub(super) fn rms(residuals: &[f64]) -> f64 {
    (residuals.iter().map(|r| r * r).sum::<f64>() / residuals.len().max(1) as f64).sqrt()
}

/// The fold of each reading: poses shuffled by a fixed seed, dealt in turn; `None` when there are fewer poses
/// than folds.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folds_are_made_where_lengths_suffice() {
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
}
