//! The lengths in the form that the solver uses. Few are prepared once; many are prepared piece by piece for each pass, so
//! that they take no memory besides the table.

use std::borrow::Cow;

use super::options::Options;
use crate::math::map_pieces;
use crate::measurement::{Measurement, MeasurementPieces, PreparedMeasurement};
use crate::robot::{AXES, BallId, Datum, Robot};

/// Size of the even sample that represents many lengths for a scale or the start of a fit.
pub(super) const SAMPLE: usize = 8192;
const MANY: usize = 2 * SAMPLE;

/// Lengths with their given standard deviations.
#[derive(Clone, Debug)]
pub(crate) struct Lengths<'a> {
    rows: Rows<'a>,
    /// Whether the user stated the standard deviation, so that it is not adjusted to the residuals.
    pub(super) is_sigma_given: bool,
    /// Whether any standard deviations are given.
    pub(super) known: bool,
    /// Standard deviation of the robot's repeatability along a length, mm, if it is known.
    pub(super) repeatability_mm: Option<f64>,
    /// Time of each length, from 0 for the first to 1 for the last; empty if the order is not known.
    elapsed: Vec<f64>,
    /// Whether `elapsed` comes from the times of the rows (and not from their indices).
    timed: bool,
}

#[derive(Clone, Debug)]
enum Rows<'a> {
    /// Prepared lengths with the given standard deviation of each, mm; 1 if none is given.
    Few(Vec<PreparedMeasurement>, Vec<f64>),
    /// Rows of the table with one standard deviation for all, or with those of the rows.
    Many(Cow<'a, [Measurement]>, Option<f64>),
}

/// The rule by which the standard deviation of a length (mm) follows from the given one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Sigma {
    Given,
    /// The given variance plus this one, mm^2.
    And(f64),
    /// The same standard deviation for all lengths, mm.
    All(f64),
}

impl Sigma {
    pub(super) fn of(self, given: f64) -> f64 {
        match self {
            Self::Given => given,
            Self::And(square) => (given * given + square).sqrt(),
            Self::All(sigma) => sigma,
        }
    }
}

/// Lengths with the weights of a fit.
#[derive(Clone, Copy, Debug)]
pub struct Weighted<'a> {
    lengths: &'a Lengths<'a>,
    sigma: Sigma,
    /// Indices of the excluded lengths, ascending.
    excluded: &'a [usize],
}

impl<'a> Lengths<'a> {
    pub(super) fn of(rows: &'a [Measurement], options: &Options, robot: &Robot) -> Self {
        let known = options.sigma_mm.is_some() || rows.iter().all(|row| row.sigma_mm.is_some());
        // If one row has no standard deviation, all get the same: a guess for it would be as good as a measurement.
        let all = options.sigma_mm.or_else(|| (!known).then_some(1.0));
        let held = match rows.len() {
            MANY.. => Rows::Many(Cow::Borrowed(rows), all),
            _ => Rows::Few(
                rows.iter().map(PreparedMeasurement::from).collect(),
                rows.iter().map(|row| given(row, all)).collect(),
            ),
        };
        let (is_sigma_given, repeatability_mm) = (options.sigma_mm.is_some(), robot.repeatability_sd_mm());
        let (elapsed, timed) = elapsed(rows);
        Self { rows: held, is_sigma_given, known, repeatability_mm, elapsed, timed }
    }

    /// `given` are the standard deviations, mm.
    pub(super) fn few(readings: Vec<PreparedMeasurement>, given: Vec<f64>) -> Lengths<'static> {
        Lengths {
            rows: Rows::Few(readings, given),
            is_sigma_given: true,
            known: true,
            repeatability_mm: None,
            elapsed: vec![],
            timed: false,
        }
    }

    /// The lengths with these indices.
    pub(super) fn at(&self, places: &[usize]) -> Self {
        let rows = match &self.rows {
            Rows::Few(readings, given) => Rows::Few(
                places.iter().map(|&at| readings[at]).collect(),
                places.iter().map(|&at| given[at]).collect(),
            ),
            Rows::Many(rows, all) => Rows::Many(places.iter().map(|&at| rows[at].clone()).collect(), *all),
        };
        let elapsed = places.iter().filter_map(|at| self.elapsed.get(*at).copied()).collect();
        Self { rows, elapsed, ..*self }
    }

    /// The same measurements, some of them to another ball.
    pub(super) fn relabelled(&self, balls: &[(usize, BallId)]) -> Self {
        let mut other = self.clone();
        let relabel = |datum: &mut Datum, ball: BallId| *datum = datum.to_ball(ball);
        match &mut other.rows {
            Rows::Few(readings, _) => {
                balls.iter().for_each(|(at, ball)| relabel(&mut readings[*at].datum, *ball))
            }
            Rows::Many(rows, _) => {
                balls.iter().for_each(|(at, ball)| relabel(&mut rows.to_mut()[*at].datum, *ball))
            }
        }
        other
    }

    /// The time of a length, from 0 for the first to 1 for the last; `None` if the times are not known.
    pub(super) fn time(&self, at: usize) -> Option<f64> {
        self.elapsed(at).filter(|_| self.timed)
    }

    /// The same measurements with other lengths, mm.
    pub(super) fn with_lengths(&self, lengths_mm: Vec<f64>) -> Self {
        let mut other = self.clone();
        match &mut other.rows {
            Rows::Few(readings, _) => {
                readings.iter_mut().zip(lengths_mm).for_each(|(reading, mm)| reading.length_mm = mm);
            }
            Rows::Many(rows, _) => {
                rows.to_mut().iter_mut().zip(lengths_mm).for_each(|(row, mm)| row.length_mm = mm);
            }
        }
        other
    }

    /// The time or order of a length, from 0 for the first to 1 for the last; `None` if the order is not known.
    pub(super) fn elapsed(&self, at: usize) -> Option<f64> {
        self.elapsed.get(at).copied()
    }

    pub(super) fn len(&self) -> usize {
        match &self.rows {
            Rows::Few(readings, _) => readings.len(),
            Rows::Many(rows, _) => rows.len(),
        }
    }

    /// Whether an even sample represents them.
    pub(super) fn are_many(&self) -> bool {
        self.len() >= MANY
    }

    /// The stride of the even sample; 1 for few lengths.
    pub(super) fn stride(&self) -> usize {
        if self.are_many() { self.len() / SAMPLE } else { 1 }
    }

    pub(super) fn reading(&self, at: usize) -> PreparedMeasurement {
        match &self.rows {
            Rows::Few(readings, _) => readings[at],
            Rows::Many(rows, _) => PreparedMeasurement::from(&rows[at]),
        }
    }

    /// The axis angles, rad: cheaper than [`Self::reading`].
    pub(super) fn axes(&self, at: usize) -> [f64; AXES] {
        match &self.rows {
            Rows::Few(readings, _) => readings[at].axes,
            Rows::Many(rows, _) => rows[at].axes.radians(),
        }
    }

    /// The given standard deviation, mm; 1 if none is given.
    pub(super) fn given(&self, at: usize) -> f64 {
        match &self.rows {
            Rows::Few(_, sigma) => sigma[at],
            Rows::Many(rows, all) => given(&rows[at], *all),
        }
    }

    pub(super) fn weighted(&'a self, sigma: Sigma, excluded: &'a [usize]) -> Weighted<'a> {
        Weighted { lengths: self, sigma, excluded }
    }

    /// All lengths with unit weights.
    pub(super) fn plain(&'a self) -> Weighted<'a> {
        self.weighted(Sigma::All(1.0), &[])
    }
}

/// Time of each row from 0 to 1, and whether it comes from the times in the table. Else it comes from the indices of
/// the rows, which must differ; empty if there is no order.
fn elapsed(rows: &[Measurement]) -> (Vec<f64>, bool) {
    let times: Option<Vec<f64>> = rows.iter().map(|row| row.context.as_ref()?.time_s).collect();
    let timed = times.is_some();
    let is_new = |pair: &[Measurement]| pair[0].index != pair[1].index || pair[0].datum != pair[1].datum;
    let indices =
        || rows.windows(2).all(is_new).then(|| rows.iter().map(|row| f64::from(row.index)).collect());
    let times = times.or_else(indices).unwrap_or_default();
    let start = [f64::INFINITY, f64::NEG_INFINITY];
    let [first, last] = times.iter().fold(start, |[low, high], time| [low.min(*time), high.max(*time)]);
    match last > first {
        true => (times.into_iter().map(|time| (time - first) / (last - first)).collect(), timed),
        false => (Vec::new(), false),
    }
}

/// The given standard deviation of a row, mm.
fn given(row: &Measurement, all: Option<f64>) -> f64 {
    all.or(row.sigma_mm).unwrap_or(1.0)
}

impl<'a> Weighted<'a> {
    /// The same lengths with another rule for the standard deviations.
    pub(super) fn by(self, sigma: Sigma) -> Self {
        Self { sigma, ..self }
    }

    pub(super) fn without(self, excluded: &'a [usize]) -> Self {
        Self { excluded, ..self }
    }

    /// The number of lengths that are not excluded.
    pub(super) fn count(&self) -> usize {
        self.lengths.len() - self.excluded.len()
    }

    pub(super) fn lengths(&self) -> &'a Lengths<'a> {
        self.lengths
    }

    /// The standard deviations, mm; infinite for excluded lengths.
    pub(super) fn sigmas(&self) -> impl Iterator<Item = f64> {
        let Self { lengths, sigma, mut excluded } = *self;
        (0..lengths.len()).map(move |at| match excluded.split_first() {
            Some((next, others)) if *next == at => {
                excluded = others;
                f64::INFINITY
            }
            _ => sigma.of(lengths.given(at)),
        })
    }

    /// Root mean square of the standard deviations that are not excluded, mm.
    pub(crate) fn rms_sigma(&self) -> f64 {
        let squares = self.sigmas().filter(|sigma| *sigma != f64::INFINITY).map(|sigma| sigma * sigma);
        (squares.sum::<f64>() / self.count().max(1) as f64).sqrt()
    }

    /// The standard deviations of a piece that begins at `first`, from the given ones.
    fn sigmas_of_piece(&self, first: usize, given: impl Iterator<Item = f64>) -> Vec<f64> {
        let mut sigma: Vec<f64> = given.map(|given| self.sigma.of(given)).collect();
        for at in &self.excluded[self.excluded.partition_point(|at| *at < first)..] {
            let Some(excluded) = sigma.get_mut(at - first) else { break };
            *excluded = f64::INFINITY;
        }
        sigma
    }

    /// Applies `of` to each reading and its standard deviation; to an even sample of many lengths.
    pub(super) fn sample<R>(&self, of: impl Fn(&PreparedMeasurement, f64) -> R) -> Vec<R> {
        let sampled = self.sigmas().enumerate().step_by(self.lengths.stride());
        sampled.map(|(at, sigma)| of(&self.lengths.reading(at), sigma)).collect()
    }

    /// The places of the lengths that are not excluded.
    pub(super) fn used_places(&self) -> impl Iterator<Item = usize> {
        self.sigmas().enumerate().filter(|(_, sigma)| *sigma != f64::INFINITY).map(|(at, _)| at)
    }

    /// An even sample of the used lengths, in runs of neighbours: the lengths of a visit stay together.
    pub(super) fn sampled_places(&self) -> Vec<usize> {
        /// Neighbours that are sampled together.
        const RUN: usize = 12;
        /// This number of lengths determines the variances to a few per cent.
        const SHOWING: usize = 2400;
        let used: Vec<usize> = self.used_places().collect();
        let runs = SHOWING / RUN;
        let stride = (used.len() / runs).max(RUN);
        used.chunks(stride).flat_map(|chunk| chunk.iter().take(RUN).copied()).collect()
    }

    /// The readings that are not excluded, with their standard deviations, mm; an even sample of many lengths.
    pub(crate) fn used_sample(&self) -> Vec<(PreparedMeasurement, f64)> {
        let mut sample = self.sample(|reading, sigma| (*reading, sigma));
        sample.retain(|(_, sigma)| sigma.is_finite());
        sample
    }

    /// The sum of `of` over the readings that are not excluded and their standard deviations.
    pub(super) fn sum(&self, of: impl Fn(&PreparedMeasurement, f64) -> f64 + Sync) -> f64 {
        let pieces = self.in_pieces(|_, readings, sigma| {
            let used = readings.iter().zip(sigma).filter(|(_, sigma)| **sigma != f64::INFINITY);
            used.map(|(reading, sigma)| of(reading, *sigma)).sum::<f64>()
        });
        pieces.into_iter().sum()
    }
}

impl MeasurementPieces for Weighted<'_> {
    fn in_pieces<R: Send>(&self, work: impl Fn(usize, &[PreparedMeasurement], &[f64]) -> R + Sync) -> Vec<R> {
        match &self.lengths.rows {
            Rows::Few(readings, given) => {
                let sigma = self.sigmas_of_piece(0, given.iter().copied());
                map_pieces(readings, |first, piece| work(first, piece, &sigma[first..first + piece.len()]))
            }
            Rows::Many(rows, all) => map_pieces(rows, |first, piece| {
                let readings: Vec<PreparedMeasurement> =
                    piece.iter().map(PreparedMeasurement::from).collect();
                let sigma = self.sigmas_of_piece(first, piece.iter().map(|row| given(row, *all)));
                work(first, &readings, &sigma)
            }),
        }
    }
}
