//! The runs of a robot combined into one Gaussian by an information filter, newest first. A robot drifts as a random walk. If
//! a run contradicts the later ones, the robot changed suddenly between them, as by a collision.

use nalgebra::{DMatrix, DVector};

use super::kind::{Kind, information};
use super::{Assumptions, EPOCH_DAYS, Knot, RunPosterior, YEAR_DAYS, inverse};
use dbbd_model::math::distributions::chi_square_exceeded;

/// Standard deviation of a bar's offset at the start of the filter, mm. Its information is subtracted at the end.
const OPEN_MM: f64 = 10.0;
/// Standard deviation of a robot's parameters at the start of the filter, in units of their prior.
const OPEN: f64 = 30.0;
/// Significance level of a contradiction.
const CRASH: f64 = 1e-6;

/// The information of a robot's runs on the robot at its first run (in units of its prior) and on the bars at the knots.
pub(super) struct Folded {
    pub(super) robot: String,
    pub(super) kind: usize,
    pub(super) knots: Vec<Knot>,
    pub(super) information: DMatrix<f64>,
    pub(super) rhs: DVector<f64>,
    pub(super) crashes: Vec<f64>,
}

/// The state of the filter: the robot, then the bars' offsets at the knots so far.
struct Filter {
    knots: Vec<Knot>,
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
}

impl Filter {
    fn new(count: usize) -> Self {
        Self {
            knots: Vec::new(),
            mean: DVector::zeros(count),
            covariance: DMatrix::identity(count, count) * (OPEN * OPEN),
        }
    }

    /// The index of a knot, which is added if it is new.
    fn place(&mut self, knot: Knot, count: usize) -> usize {
        if let Some(at) = self.knots.iter().position(|known| *known == knot) {
            return count + at;
        }
        self.knots.push(knot);
        let size = self.mean.len();
        self.mean = self.mean.clone().insert_row(size, 0.0);
        self.covariance = self.covariance.clone().insert_row(size, 0.0).insert_column(size, 0.0);
        self.covariance[(size, size)] = OPEN_MM * OPEN_MM;
        size
    }

    /// Adds a variance to all parameters of the robot.
    fn widen(&mut self, count: usize, variance: f64) {
        (0..count).for_each(|at| self.covariance[(at, at)] += variance);
    }

    /// Chi-square of a run against the state, and its degrees of freedom.
    fn contradiction(&self, places: &[usize], data: &DMatrix<f64>, rhs: &DVector<f64>) -> Option<(f64, f64)> {
        let own = self.covariance.select_rows(places).select_columns(places);
        let root = own.cholesky()?.l();
        let expected = DVector::from_fn(places.len(), |i, _| self.mean[places[i]]);
        let eigen = (root.transpose() * data * &root).symmetric_eigen();
        let right = eigen.eigenvectors.tr_mul(&(root.transpose() * (rhs - data * expected)));
        let determined = eigen.eigenvalues.iter().zip(right.iter()).filter(|(value, _)| **value > 1e-3);
        let (mut square, mut freedom) = (0.0, 0.0);
        for (value, right) in determined {
            square += right * right / (value * (1.0 + value));
            freedom += 1.0;
        }
        Some((square, freedom))
    }

    /// Adds information on the unknowns at `places`.
    fn update(&mut self, places: &[usize], data: &DMatrix<f64>, rhs: &DVector<f64>) -> Option<()> {
        let before = inverse(&self.covariance)?;
        let (mut after, mut right) = (before.clone(), &before * &self.mean);
        for (i, &row) in places.iter().enumerate() {
            right[row] += rhs[i];
            places.iter().enumerate().for_each(|(j, &column)| after[(row, column)] += data[(i, j)]);
        }
        self.covariance = inverse(&after)?;
        self.mean = &self.covariance * right;
        Some(())
    }
}

/// Combines the runs of a robot, which are in the order of time. The second value is the number of unusable runs.
pub(super) fn fold(
    runs: &[&RunPosterior],
    kinds: &[Kind],
    bars: &[String],
    assumed: &Assumptions,
) -> Option<(Folded, usize)> {
    let first = runs.first()?;
    let at = kinds.iter().position(|kind| kind.name == first.kind)?;
    let (kind, count) = (&kinds[at], kinds[at].ids.len());
    let (mut filter, mut crashes, mut unusable, mut later) = (Filter::new(count), Vec::new(), 0, None);
    for run in runs.iter().rev() {
        let Some((data, rhs)) = information(run, kind) else {
            unusable += 1;
            continue;
        };
        if let Some(later) = later {
            let years: f64 = (later - run.day) / YEAR_DAYS;
            filter.widen(count, assumed.drift * assumed.drift * years.max(0.0));
        }
        let bar = bars.iter().position(|bar| *bar == run.bar)?;
        let knot = filter.place((bar, (run.day / EPOCH_DAYS).floor() as i64), count);
        let places: Vec<usize> = (0..count).chain([knot]).collect();
        if let Some(later) = later
            && let Some((square, freedom)) = filter.contradiction(&places, &data, &rhs)
            && square > chi_square_exceeded(CRASH, freedom)
        {
            crashes.push(later);
            filter.widen(count, OPEN * OPEN);
        }
        later = Some(run.day);
        filter.update(&places, &data, &rhs)?;
    }
    crashes.reverse();
    // Subtract the information of the start.
    let mut information = inverse(&filter.covariance)?;
    let rhs = &information * &filter.mean;
    for place in 0..information.nrows() {
        let open = if place < count { OPEN } else { OPEN_MM };
        information[(place, place)] -= 1.0 / (open * open);
    }
    let robot = first.robot.clone();
    Some((Folded { robot, kind: at, knots: filter.knots, information, rhs, crashes }, unusable))
}
