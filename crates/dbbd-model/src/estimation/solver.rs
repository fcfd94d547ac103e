//! Levenberg-Marquardt with column scaling, a robust loss by reweighting, and prior rows.
//!
//! Damping follows Nielsen ("Damping parameter in Marquardt's method", IMM-REP-1999-05): it grows faster with each rejected
//! step and shrinks by the gain ratio. It starts so small that the first steps are Gauss-Newton steps.

use nalgebra::DVector;

use super::lengths::Weighted;
use super::linear_system::Rows;
use super::prior_rows::PriorRows;
use crate::math::{Triangle, robust};
use crate::measurement::LengthModel;
use crate::robot::ParamId;

pub(super) struct Problem<'a> {
    pub(super) lengths: Weighted<'a>,
    /// The parameters to fit.
    pub(super) ids: &'a [ParamId],
    pub(super) loss: Loss,
    pub(super) prior: Option<&'a PriorRows>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Loss {
    Squares,
    /// Huber's loss: linear beyond 1.345 robust standard deviations.
    Huber,
}

#[derive(Clone, Debug)]
pub(super) struct Solution {
    pub(super) model: LengthModel,
    pub(super) iterations: usize,
    pub(super) converged: bool,
    /// Whitened residuals at the model, or at a model whose lengths differ by rounding; an even sample of many lengths.
    pub(super) residuals: Vec<f64>,
    /// Whitened residuals at the start.
    pub(super) first: Vec<f64>,
}

const HUBER: f64 = 1.345;
/// A residual scale below this (in standard deviations or mm) is rounding, not noise.
pub(super) const ROUNDING: f64 = 1e-9;
const MAX_STEPS: usize = 100;
/// A step that changes the lengths by less than this (RMS, mm) ends the iteration.
const REST_MM: f64 = 1e-10;

/// Minimises the loss over `problem.ids`, from `start`.
pub(super) fn minimise(problem: &Problem, start: &LengthModel) -> Solution {
    if problem.ids.is_empty() {
        let residuals = whitened(&problem.lengths, start);
        return Solution {
            model: start.clone(),
            iterations: 0,
            converged: true,
            first: residuals.clone(),
            residuals,
        };
    }
    let mut descent = Descent::new(problem, start);
    let converged = loop {
        match descent.step() {
            Progress::Lower => {}
            Progress::AtRest => break true,
            Progress::Stuck => break false,
        }
    };
    let Descent { model, steps, here, first, .. } = descent;
    Solution { model, iterations: steps, converged, residuals: here.residuals, first }
}

/// The outcome of a step.
enum Progress {
    Lower,
    AtRest,
    /// No step lowers the cost, or there were too many steps.
    Stuck,
}

/// The state of the iteration.
struct Descent<'a> {
    problem: &'a Problem<'a>,
    model: LengthModel,
    here: Equations,
    first: Vec<f64>,
    /// Largest norm of each column so far.
    scale: DVector<f64>,
    damping: f64,
    growth: f64,
    /// [`REST_MM`] as a norm of whitened lengths.
    rest: f64,
    steps: usize,
}

impl<'a> Descent<'a> {
    fn new(problem: &'a Problem<'a>, start: &LengthModel) -> Self {
        let here = Equations::at(problem, start, f64::INFINITY);
        Self {
            problem,
            model: start.clone(),
            first: here.residuals.clone(),
            here,
            scale: DVector::zeros(problem.ids.len()),
            damping: 1e-12,
            growth: 4.0,
            rest: REST_MM / problem.lengths.rms_sigma() * (problem.lengths.count() as f64).sqrt(),
            steps: 0,
        }
    }

    /// Linearises and increases the damping until a step lowers the cost.
    fn step(&mut self) -> Progress {
        let threshold = match self.problem.loss {
            Loss::Squares => f64::INFINITY,
            Loss::Huber => HUBER * robust_scale(&self.here.residuals).max(ROUNDING),
        };
        if threshold.is_finite() {
            self.here = Equations::at(self.problem, &self.model, threshold);
        }
        let cost = self.here.cost;
        // With exact lengths only rounding is left, which would drive parameters that are hardly determined.
        if cost.sqrt() <= 0.1 * self.rest {
            return Progress::AtRest;
        }
        let factor = self.here.system.factor();
        let rhs = self.here.system.rhs();
        for (scale, column) in self.scale.iter_mut().zip(factor.column_iter()) {
            *scale = scale.max(column.norm());
        }
        while self.steps < MAX_STEPS {
            self.steps += 1;
            if let Some(step) = self.here.system.solve_damped(&self.scale, self.damping) {
                let change = &factor * &step;
                let predicted = 2.0 * rhs.dot(&change) - change.norm_squared();
                let candidate = self.model.shifted(self.problem.ids, &step);
                // At the minimum no length changes, or the predicted reduction is below the rounding of the cost.
                if change.norm() <= self.rest || predicted <= 1e-14 * cost {
                    self.model = candidate;
                    return Progress::AtRest;
                }
                let there = Equations::at(self.problem, &candidate, threshold);
                let gain = (cost - there.cost) / predicted;
                if gain > 1e-4 && gain.is_finite() {
                    (self.model, self.here) = (candidate, there);
                    self.damping *= (1.0 - (2.0 * gain - 1.0).powi(3)).clamp(0.1, 0.9);
                    self.growth = 4.0;
                    return if self.steps < MAX_STEPS { Progress::Lower } else { Progress::Stuck };
                }
                if predicted <= 1e-12 * cost {
                    return Progress::AtRest;
                }
            }
            self.damping = (self.damping * self.growth).max(1e-9);
            self.growth *= 2.0;
            if self.damping > 1e12 {
                return Progress::Stuck;
            }
        }
        Progress::Stuck
    }
}

/// The linearised problem at a model.
struct Equations {
    /// Whitened rows, including the rows of the prior.
    system: Triangle,
    /// Whitened residuals; an even sample of many lengths.
    residuals: Vec<f64>,
    /// The loss, including the loss of the prior.
    cost: f64,
}

impl Equations {
    /// Residuals beyond `threshold` count linearly.
    fn at(problem: &Problem, model: &LengthModel, threshold: f64) -> Self {
        let stride = problem.lengths.lengths().stride();
        let rows = Rows { model, ids: problem.ids, further: 0 };
        let start = || (Triangle::new(problem.ids.len()), Vec::new(), 0.0);
        let pieces = rows.fold(&problem.lengths, start, |(triangle, residuals, cost), row| {
            let weight = huber_weight(row.residual, threshold);
            if weight < 1.0 {
                row.values.iter_mut().for_each(|value| *value *= weight);
            }
            triangle.push(row.values, row.residual * weight);
            *cost += huber_loss(row.residual, threshold);
            // This inner loop avoids the division if it can.
            if stride == 1 || row.place.is_multiple_of(stride) {
                residuals.push(row.residual);
            }
        });
        let (mut triangles, mut residuals, mut cost) = (Vec::new(), Vec::new(), 0.0);
        for (triangle, of_piece, its_cost) in pieces {
            triangles.push(triangle);
            residuals.extend(of_piece);
            cost += its_cost;
        }
        let mut system = Triangle::merged(triangles, problem.ids.len());
        if let Some(prior) = problem.prior {
            cost += prior.add_to(&mut system, model, problem.ids);
        }
        Self { system, residuals, cost }
    }
}

/// Residuals over their standard deviations; an even sample of many lengths.
pub(super) fn whitened(lengths: &Weighted, model: &LengthModel) -> Vec<f64> {
    let prepared = model.prepare();
    lengths.sample(|reading, sigma| prepared.residual(reading) / sigma)
}

/// The median magnitude, scaled to the standard deviation of a normal distribution.
pub(super) fn robust_scale(residuals: &[f64]) -> f64 {
    let mut sizes: Vec<f64> = residuals.iter().map(|r| r.abs()).collect();
    robust::median(&mut sizes).unwrap_or(0.0) * robust::SIGMA_OF_MAD
}

/// The root of Huber's weight: the factor on row and residual.
fn huber_weight(residual: f64, threshold: f64) -> f64 {
    if residual.abs() <= threshold { 1.0 } else { (threshold / residual.abs()).sqrt() }
}

fn huber_loss(residual: f64, threshold: f64) -> f64 {
    let size = residual.abs();
    if size <= threshold { residual * residual } else { threshold * (2.0 * size - threshold) }
}
