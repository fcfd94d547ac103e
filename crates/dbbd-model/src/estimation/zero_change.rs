//! Whether the zero of a bar, or the frame of the tracker, stepped or drifted during the measurement.
//!
//! The rows are in the order of measurement. A step at a row, or a drift over all rows, is a further column besides the
//! estimated parameters. Each has an F-test at 0.001 over the number of tests (Bonferroni). Model errors are correlated
//! between neighbouring rows, so the long-run variance is used if it is larger (Newey and West, Econometrica 55, 1987).

use std::sync::Arc;

use nalgebra::{Cholesky, DMatrix, DVector};

use super::estimate::Estimate;
use super::lengths::{Lengths, Sigma};
use super::pose_rows::{PoseRows, RowNoise, Whitening};
use super::posterior::inverse_root;
use crate::estimation::EstimationFinding;
use crate::math::distributions::ln_f_tail;
use crate::math::stacked;
use crate::measurement::{ContextColumn, Measurement, Measurements};
use crate::robot::{BarId, Coordinate, Datum};

/// Probability of any finding in sound measurements.
const LEVEL: f64 = 1e-3;
/// Least number of measurements before and after a step.
const FEWEST: usize = 8;
/// At most so many places of a step are tested, evenly spread.
const MOST: usize = 256;
/// Degrees of freedom below which nothing is decided.
const LEAST_FREEDOM: f64 = 10.0;
/// Residuals below this are rounding, mm.
const ROUNDING_MM: f64 = 1e-6;
/// In a converged fit the projection of the residuals onto the parameters is balanced by the priors. Its square, in units of
/// the noise, is below this for each parameter.
const BALANCED: f64 = 4.0;
/// A column with a smaller fraction of its squares orthogonal to the parameters depends on them.
const DEPENDENT: f64 = 1e-6;

/// The reference of a length or coordinate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reference {
    Bar(BarId),
    /// The frame of the tracker.
    Tracker,
}

impl Reference {
    /// The number of components that can change.
    fn size(self) -> usize {
        match self {
            Self::Bar(_) => 1,
            Self::Tracker => Coordinate::ALL.len(),
        }
    }

    /// The component that a measurement refers to.
    fn component(self, datum: Datum) -> Option<usize> {
        match (self, datum) {
            (Self::Bar(own), Datum::Ball(_, bar)) => (own == bar).then_some(0),
            (Self::Tracker, Datum::Plane(coordinate)) => Some(coordinate.index()),
            _ => None,
        }
    }
}

/// How a reference changed over the rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Course {
    /// At once, before row number `first`.
    Step { first: usize },
    /// In proportion to the time, or to the row number if times are not known.
    Drift,
}

#[derive(Clone, Debug, PartialEq)]
pub struct ZeroChange {
    pub of: Reference,
    pub course: Course,
    /// The change from the first to the last row, mm: by so much the last lengths or coordinates are too large.
    pub by_mm: Vec<f64>,
    /// Standard uncertainty of the size, mm.
    pub sd_mm: f64,
}

impl ZeroChange {
    /// The measurements with the change subtracted.
    pub fn taken_out(&self, observations: &Measurements) -> Measurements {
        let elapsed = elapsed(&observations.rows);
        let mut observations = observations.clone();
        for (place, row) in observations.rows.iter_mut().enumerate() {
            let Some(component) = self.of.component(row.datum) else { continue };
            let by_mm = self.by_mm[component] * self.course.fraction(place, &elapsed);
            if by_mm != 0.0 {
                row.length_mm -= by_mm;
                let zero_mm = &mut Arc::make_mut(row.context.get_or_insert_default()).zero_mm;
                *zero_mm = Some(zero_mm.unwrap_or(0.0) + by_mm);
            }
        }
        if !observations.columns.contains(&ContextColumn::ZeroMm) {
            observations.columns.push(ContextColumn::ZeroMm);
        }
        observations
    }

    /// `observations` are those in which the change was found.
    pub fn finding(&self, observations: &Measurements) -> EstimationFinding {
        let (sd_mm, size_mm) = (self.sd_mm, self.by_mm.iter().map(|by| by * by).sum::<f64>().sqrt());
        let index = |first: usize| observations.rows[first].index;
        match (self.of, self.course) {
            (Reference::Bar(bar), Course::Step { first }) => {
                let (bar, index) = (bar.number(), index(first));
                EstimationFinding::ZeroStep { bar, index, by_mm: self.by_mm[0], sd_mm }
            }
            (Reference::Bar(bar), Course::Drift) => {
                EstimationFinding::ZeroDrift { bar: bar.number(), by_mm: self.by_mm[0], sd_mm }
            }
            (Reference::Tracker, Course::Step { first }) => {
                EstimationFinding::TrackerStep { index: index(first), size_mm, sd_mm }
            }
            (Reference::Tracker, Course::Drift) => EstimationFinding::TrackerDrift { size_mm, sd_mm },
        }
    }
}

impl Course {
    /// The fraction of the change that row number `place` has.
    fn fraction(self, place: usize, elapsed: &[f64]) -> f64 {
        match self {
            Self::Step { first } => f64::from(u8::from(place >= first)),
            Self::Drift => elapsed[place],
        }
    }
}

/// Time or row number, scaled to 0 at the first row and 1 at the last.
fn elapsed(rows: &[Measurement]) -> Vec<f64> {
    let times: Option<Vec<f64>> = rows.iter().map(|row| row.context.as_ref()?.time_s).collect();
    let times = times.filter(|times| times.is_sorted() && times.first() < times.last());
    let times = times.unwrap_or_else(|| (0..rows.len()).map(|place| place as f64).collect());
    let (first, last) = (times.first().copied().unwrap_or(0.0), times.last().copied().unwrap_or(1.0));
    let whole = if last > first { last - first } else { 1.0 };
    times.into_iter().map(|now| (now - first) / whole).collect()
}

/// The most significant change, besides an estimate of so many `parameters`.
pub(super) fn zero_change(
    observations: &Measurements,
    estimate: &Estimate,
    lengths: &Lengths,
    parameters: f64,
) -> Option<ZeroChange> {
    let rows = &observations.rows;
    let regression = Regression::of(estimate, lengths, parameters)?;
    let elapsed = elapsed(rows);
    let candidates = regression.candidates(rows);
    let limit = (LEVEL / candidates.len() as f64).ln();
    let places = &regression.lines.places;
    let tested = candidates.into_iter().filter_map(|(of, course)| {
        let columns = DMatrix::from_fn(places.len(), of.size(), |row, column| {
            let is_own = of.component(rows[places[row]].datum) == Some(column);
            if is_own { course.fraction(places[row], &elapsed) } else { 0.0 }
        });
        let Tested { by, sd, ln_chance } = regression.test(columns)?;
        Some((ln_chance, ZeroChange { of, course, by_mm: by.as_slice().to_vec(), sd_mm: sd }))
    });
    let (ln_chance, change) = tested.min_by(|(a, _), (b, _)| a.total_cmp(b))?;
    (ln_chance < limit).then_some(change)
}

/// The whitened regression of an estimate, to which further columns are added.
struct Regression {
    lines: PoseRows,
    whitening: Whitening,
    residual: DVector<f64>,
    /// Rows times the root of the posterior covariance.
    unknown: DMatrix<f64>,
    freedom: f64,
}

/// Coefficients of further columns with their F-test.
struct Tested {
    by: DVector<f64>,
    sd: f64,
    ln_chance: f64,
}

impl Regression {
    fn of(estimate: &Estimate, lengths: &Lengths, parameters: f64) -> Option<Self> {
        let used = estimate.used(lengths).by(Sigma::All(1.0));
        let freedom = used.count() as f64 - parameters;
        if lengths.are_many() || freedom < LEAST_FREEDOM || !estimate.fit.converged {
            return None;
        }
        let (model, ids) = match &estimate.joints {
            Some(fit) => (&fit.model, &fit.ids),
            None => (&estimate.fit.model, &estimate.kept),
        };
        let lines = PoseRows::at(model, &used, ids);
        if lines.residual.norm() < ROUNDING_MM * (used.count() as f64).sqrt() {
            return None;
        }
        let given = lines.places.iter().map(|place| lengths.given(*place));
        let noise = match &estimate.joints {
            Some(fit) => {
                let mean = used.by(Sigma::Given).rms_sigma();
                let weights: Vec<f64> = given.map(|given| given / mean).collect();
                fit.shape.of_rows(&lines, &weights, fit.noise.pose_mm).times(fit.noise.pose_mm)
            }
            None => RowNoise::independent(given.map(|given| estimate.noise.sigma.of(given)).collect()),
        };
        let mut whole = lines.values.clone().insert_column(lines.values.ncols(), 0.0);
        whole.set_column(lines.values.ncols(), &lines.residual);
        let whitening = lines.whitening(&noise)?;
        whitening.apply(&mut whole);
        let values = whole.columns(0, lines.values.ncols()).into_owned();
        let root = match (&estimate.joints, &estimate.prior) {
            (Some(fit), _) => fit.root.clone(),
            (None, Some(prior)) => inverse_root(&stacked(&values, prior.matrix()))?,
            (None, None) => inverse_root(&values)?,
        };
        let residual = whole.column(lines.values.ncols()).into_owned();
        let unknown = values * root;
        // Otherwise the fit did not converge for these rows, as if its set of outliers had not settled.
        let explained = unknown.tr_mul(&residual).norm_squared();
        let balanced = BALANCED * unknown.ncols() as f64 * residual.norm_squared() / freedom;
        (explained <= balanced).then_some(Self { lines, whitening, residual, unknown, freedom })
    }

    /// The drift and the steps of each reference.
    fn candidates(&self, rows: &[Measurement]) -> Vec<(Reference, Course)> {
        let places = &self.lines.places;
        let mut bars: Vec<BarId> = places.iter().filter_map(|at| rows[*at].datum.bar()).collect();
        bars.sort_unstable();
        bars.dedup();
        let mut candidates = Vec::new();
        for of in bars.into_iter().map(Reference::Bar).chain([Reference::Tracker]) {
            let is_first = |at: &&usize| of.component(rows[**at].datum) == Some(0);
            let own: Vec<usize> = places.iter().filter(is_first).copied().collect();
            let inner = own.len().checked_sub(FEWEST).and_then(|last| own.get(FEWEST..last));
            let inner = inner.unwrap_or_default();
            candidates.extend((!inner.is_empty()).then_some((of, Course::Drift)));
            let steps = inner.iter().step_by(inner.len().div_ceil(MOST).max(1));
            candidates.extend(steps.map(|&first| (of, Course::Step { first })));
        }
        candidates
    }

    /// `None` if a column depends on the parameters.
    fn test(&self, mut columns: DMatrix<f64>) -> Option<Tested> {
        self.whitening.apply(&mut columns);
        let shares = self.unknown.tr_mul(&columns);
        let whole = columns.tr_mul(&columns);
        let gram = &whole - shares.tr_mul(&shares);
        if gram.diagonal().iter().zip(&whole.diagonal()).any(|(left, whole)| *left <= DEPENDENT * whole) {
            return None;
        }
        let factor = Cholesky::new(gram)?;
        let right = columns.tr_mul(&self.residual);
        let by = factor.solve(&right);
        let (gain, size) = (right.dot(&by), columns.ncols() as f64);
        let own = columns * &by;
        let own = &own - &self.unknown * self.unknown.tr_mul(&own);
        let left = &self.residual - &own;
        let freedom = self.freedom - size;
        let squares = self.residual.norm_squared() - gain;
        if squares <= 0.0 {
            return None;
        }
        let variance = squares / freedom * long_run(own.component_mul(&left).as_slice());
        let sd = by.dot(&factor.solve(&by)).sqrt() / by.norm() * variance.sqrt();
        Some(Tested { ln_chance: ln_f_tail(gain / size / variance, size, freedom), by, sd })
    }
}

/// The ratio of the long-run variance of a sum to that with independent terms; at least 1.
fn long_run(terms: &[f64]) -> f64 {
    let lags = (terms.len() as f64).cbrt() as usize;
    let product = |lag: usize| terms.iter().zip(&terms[lag..]).map(|(a, b)| a * b).sum::<f64>();
    let covariance = |lag: usize| 2.0 * (1.0 - lag as f64 / (lags + 1) as f64) * product(lag);
    let squares = product(0);
    if squares > 0.0 { (1.0 + (1..=lags).map(covariance).sum::<f64>() / squares).max(1.0) } else { 1.0 }
}
