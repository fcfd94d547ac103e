//! Whether the zero of a bar, or the frame of the tracker, stepped or drifted amid the data.
//!
//! Rows are in the order of the measurement. A step from one row on, or a drift over all, is a further column beside all that was
//! estimated: what it takes from the squares of the residuals is linear algebra. Each is judged by its F-test at
//! 0.001 over the number of those that are tried (Bonferroni). What the model lacks is alike in neighbouring
//! rows, so the variance is the long-run one where that is larger (Newey and West, Econometrica 55, 1987).

use std::sync::Arc;

use nalgebra::{Cholesky, DMatrix, DVector};

use super::estimate::Estimate;
use super::lengths::{Lengths, Sigma};
use super::pose_rows::{PoseRows, RowNoise};
use super::posterior::inverse_root;
use crate::catalogue::EstimationFinding;
use crate::math::distributions::ln_f_tail;
use crate::measurement::{Column, Measurement, Measurements};
use crate::robot::{BarId, Coordinate, Datum};

/// Chance that sound measurements are accused.
const CHANCE: f64 = 1e-3;
/// Fewer measurements before or after a step show none.
const FEWEST: usize = 8;
/// Places of steps that are tried, evenly spread.
const MOST: usize = 256;
/// Degrees of freedom below which nothing is decided.
const LEAST_FREEDOM: f64 = 10.0;
/// Residuals below this are rounding, mm.
const ROUNDING_MM: f64 = 1e-6;
/// At a fit of least squares the parameters explain no more of the residuals than their priors hold back, in squares for each.
const HELD_BACK: f64 = 4.0;
/// Share of the squares of a column beside the parameters below which it is one of their combinations.
const DEPENDENT: f64 = 1e-6;

/// What lengths and coordinates are measured from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reference {
    Bar(BarId),
    /// The frame of the tracker.
    Tracker,
}

impl Reference {
    /// How many numbers it has.
    fn size(self) -> usize {
        match self {
            Self::Bar(_) => 1,
            Self::Tracker => Coordinate::ALL.len(),
        }
    }

    /// Which of its numbers a measurement is from.
    fn number_of(self, datum: Datum) -> Option<usize> {
        match (self, datum) {
            (Self::Bar(own), Datum::Ball(_, bar)) => (own == bar).then_some(0),
            (Self::Tracker, Datum::Plane(coordinate)) => Some(coordinate.index()),
            _ => None,
        }
    }
}

/// How it changed over the measurements.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Course {
    /// From the row at this place on.
    Step { first: usize },
    /// In proportion to the time, or to the number of the row where no times are known.
    Drift,
}

/// A change amid the data.
#[derive(Clone, Debug, PartialEq)]
pub struct ZeroChange {
    pub of: Reference,
    pub course: Course,
    /// By which lengths or coordinates at the end are too large, mm.
    pub by_mm: Vec<f64>,
    /// Standard uncertainty of the size, mm.
    pub sd_mm: f64,
}

impl ZeroChange {
    /// The measurements without it: as from their beginning.
    pub fn taken_out(&self, observations: &Measurements) -> Measurements {
        let lapse = lapse(&observations.rows);
        let mut observations = observations.clone();
        for (place, row) in observations.rows.iter_mut().enumerate() {
            let Some(number) = self.of.number_of(row.datum) else { continue };
            let by_mm = self.by_mm[number] * self.course.share(place, &lapse);
            if by_mm != 0.0 {
                row.length_mm -= by_mm;
                let zero_mm = &mut Arc::make_mut(row.context.get_or_insert_default()).zero_mm;
                *zero_mm = Some(zero_mm.unwrap_or(0.0) + by_mm);
            }
        }
        if !observations.columns.contains(&Column::ZeroMm) {
            observations.columns.push(Column::ZeroMm);
        }
        observations
    }

    /// What is said of it; `observations` are those that it was found in.
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
    /// The share of the change that the row at a place has.
    fn share(self, place: usize, lapse: &[f64]) -> f64 {
        match self {
            Self::Step { first } => f64::from(u8::from(place >= first)),
            Self::Drift => lapse[place],
        }
    }
}

/// From 0 at the first row to 1 at the last.
fn lapse(rows: &[Measurement]) -> Vec<f64> {
    let times: Option<Vec<f64>> = rows.iter().map(|row| row.context.as_ref()?.time_s).collect();
    let times = times.filter(|times| times.is_sorted() && times.first() < times.last());
    let course = times.unwrap_or_else(|| (0..rows.len()).map(|place| place as f64).collect());
    let (first, last) = (course.first().copied().unwrap_or(0.0), course.last().copied().unwrap_or(1.0));
    let whole = if last > first { last - first } else { 1.0 };
    course.into_iter().map(|now| (now - first) / whole).collect()
}

/// The change that the residuals show most beyond chance, beside an estimate of so many `parameters`.
pub(super) fn zero_change(
    observations: &Measurements,
    estimate: &Estimate,
    lengths: &Lengths,
    parameters: f64,
) -> Option<ZeroChange> {
    let rows = &observations.rows;
    let beside = Beside::of(estimate, lengths, parameters)?;
    let lapse = lapse(rows);
    let candidates = beside.candidates(rows);
    let limit = (CHANCE / candidates.len() as f64).ln();
    let tested = candidates.into_iter().filter_map(|(of, course)| {
        let columns = DMatrix::from_fn(beside.places.len(), of.size(), |row, column| {
            let place = beside.places[row];
            let is_own = of.number_of(rows[place].datum) == Some(column);
            if is_own { course.share(place, &lapse) } else { 0.0 }
        });
        let Tested { by, sd, ln_chance } = beside.test(columns)?;
        Some((ln_chance, ZeroChange { of, course, by_mm: by.as_slice().to_vec(), sd_mm: sd }))
    });
    let (ln_chance, found) = tested.min_by(|(a, _), (b, _)| a.total_cmp(b))?;
    (ln_chance < limit).then_some(found)
}

/// An estimate, beside which further columns are tested.
struct Beside {
    lines: PoseRows,
    /// Places of its rows among all measurements.
    places: Vec<usize>,
    noise: RowNoise,
    /// Of unit noise.
    residual: DVector<f64>,
    /// A root of the rows' covariance by what the estimate leaves unknown.
    unknown: DMatrix<f64>,
    freedom: f64,
}

/// A change with its F-test.
struct Tested {
    by: DVector<f64>,
    sd: f64,
    ln_chance: f64,
}

impl Beside {
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
                fit.shape.of_rows(&lines, &weights).times(fit.noise.pose_mm)
            }
            None => RowNoise::independent(given.map(|given| estimate.noise.sigma.of(given)).collect()),
        };
        let mut whole = lines.values.clone().insert_column(lines.values.ncols(), 0.0);
        whole.set_column(lines.values.ncols(), &lines.residual);
        lines.whiten(&mut whole, &noise)?;
        let values = whole.columns(0, lines.values.ncols()).into_owned();
        let root = match (&estimate.joints, &estimate.prior) {
            (Some(fit), _) => fit.root.clone(),
            (None, Some(prior)) => {
                let mut stacked = values.clone().resize_vertically(values.nrows() + prior.count(), 0.0);
                stacked.rows_mut(values.nrows(), prior.count()).copy_from(prior.matrix());
                inverse_root(&stacked)?
            }
            (None, None) => inverse_root(&values)?,
        };
        let residual = whole.column(lines.values.ncols()).into_owned();
        let (places, unknown) = (lines.places.clone(), values * root);
        // Else the fit is none of these rows, as where it did not settle among outliers.
        let explained = unknown.tr_mul(&residual).norm_squared();
        let settled = HELD_BACK * unknown.ncols() as f64 * residual.norm_squared() / freedom;
        if explained > settled {
            return None;
        }
        Some(Self { lines, places, noise, residual, unknown, freedom })
    }

    /// A drift of each reference, and its steps.
    fn candidates(&self, rows: &[Measurement]) -> Vec<(Reference, Course)> {
        let mut bars: Vec<BarId> = self.places.iter().filter_map(|at| rows[*at].datum.bar()).collect();
        bars.sort_unstable();
        bars.dedup();
        let references = bars.into_iter().map(Reference::Bar).chain([Reference::Tracker]);
        let of_reference = |of: Reference| {
            let first = |at: &&usize| of.number_of(rows[**at].datum) == Some(0);
            let own: Vec<usize> = self.places.iter().filter(first).copied().collect();
            let inner = own.len().checked_sub(FEWEST).and_then(|last| own.get(FEWEST..last));
            let inner = inner.unwrap_or_default();
            let steps = inner.iter().step_by(inner.len().div_ceil(MOST).max(1));
            let drift = (!inner.is_empty()).then_some((of, Course::Drift));
            let steps = steps.map(move |&first| (of, Course::Step { first }));
            drift.into_iter().chain(steps).collect::<Vec<_>>()
        };
        references.flat_map(of_reference).collect()
    }

    /// `None` of columns that are a combination of the parameters'.
    fn test(&self, mut columns: DMatrix<f64>) -> Option<Tested> {
        self.lines.whiten(&mut columns, &self.noise)?;
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

/// How many times as large the variance of a sum is as if its terms were independent; at least 1.
fn long_run(terms: &[f64]) -> f64 {
    let lags = (terms.len() as f64).cbrt() as usize;
    let product = |lag: usize| terms.iter().zip(&terms[lag..]).map(|(a, b)| a * b).sum::<f64>();
    let alike = |lag: usize| 2.0 * (1.0 - lag as f64 / (lags + 1) as f64) * product(lag);
    let squares = product(0);
    if squares > 0.0 { (1.0 + (1..=lags).map(alike).sum::<f64>() / squares).max(1.0) } else { 1.0 }
}
