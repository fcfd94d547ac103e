//! Levenberg-Marquardt on the lengths, with column scaling, a robust loss by reweighting, and prior rows.
//!
//! Damping follows Nielsen ("Damping parameter in Marquardt's method", IMM-REP-1999-05): it grows
//! faster with each refusal and shrinks by the gain ratio. It starts so small that the first steps are
//! Gauss-Newton's.

use nalgebra::DVector;

use super::lengths::Weighted;
use super::linear_system::{LinearSystem, Rows};
use super::prior::PriorRows;
use crate::math::{Triangle, robust};
use crate::measurement::LengthModel;
use crate::robot::ParamId;

/// What is to be fitted.
pub(super) struct Problem<'a> {
    pub(super) lengths: Weighted<'a>,
    /// Parameters to fit.
    pub(super) ids: &'a [ParamId],
    pub(super) loss: Loss,
    pub(super) prior: Option<&'a PriorRows>,
}

/// How large residuals count.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Loss {
    /// By their square.
    Squares,
    /// Linearly beyond 1.345 robust standard deviations (Huber).
    Huber,
}

/// Where the solver came to rest.
#[derive(Clone, Debug)]
pub(super) struct Solution {
    pub(super) model: LengthModel,
    pub(super) iterations: usize,
    pub(super) converged: bool,
    /// Residuals, measured minus predicted, in sigmas (an even sample of many lengths), where they were last taken: at
    /// the model, or at one whose lengths are the same to rounding.
    pub(super) residuals: Vec<f64>,
    /// The same at the start.
    pub(super) first: Vec<f64>,
}

const HUBER: f64 = 1.345;
/// A residual scale below this (in sigmas or mm) is rounding, not noise.
pub(super) const ROUNDING: f64 = 1e-9;
const MAX_STEPS: usize = 100;
/// A step that changes the lengths by less than this (rms, mm) is none.
const REST_MM: f64 = 1e-10;

/// Minimises the weighted residuals over `problem.ids`, from `start`.
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

/// What a step came to.
enum Progress {
    Lower,
    AtRest,
    /// No step lowers the cost, or there were too many.
    Stuck,
}

/// Where the solver is.
struct Descent<'a> {
    problem: &'a Problem<'a>,
    model: LengthModel,
    here: Equations,
    first: Vec<f64>,
    /// Largest norm of each column so far.
    scale: DVector<f64>,
    damping: f64,
    growth: f64,
    /// A change of the whitened lengths below this is none.
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

    /// Linearises anew and refuses steps until one lowers the cost.
    fn step(&mut self) -> Progress {
        let threshold = match self.problem.loss {
            Loss::Squares => f64::INFINITY,
            Loss::Huber => HUBER * robust_scale(&self.here.residuals).max(ROUNDING),
        };
        if threshold.is_finite() {
            self.here = Equations::at(self.problem, &self.model, threshold);
        }
        let cost = self.here.cost;
        // Exact lengths: what is left is rounding, and would only push along what they do not determine.
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
            if let Some(step) = self.here.system.damped_step(&self.scale, self.damping) {
                let change = &factor * &step;
                let predicted = 2.0 * rhs.dot(&change) - change.norm_squared();
                let candidate = moved(&self.model, self.problem.ids, &step);
                // The reduction left is below the rounding of the cost, or moves no length: this is the minimum.
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

/// The equations of a step at a model.
struct Equations {
    /// Weighted rows, the prior's among them.
    system: LinearSystem,
    /// Residuals, measured minus predicted, in sigmas; an even sample of many.
    residuals: Vec<f64>,
    /// What is to be made least.
    cost: f64,
}

impl Equations {
    /// At `model`, on all cores where there are many lengths; the loss turns linear at `threshold`.
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
            // A division is worth avoiding here.
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
        let mut system = LinearSystem::of(triangles, problem.ids.len());
        if let Some(prior) = problem.prior {
            cost += system.add_prior(prior, model, problem.ids);
        }
        Self { system, residuals, cost }
    }
}

/// Residuals, measured minus predicted, in sigmas; an even sample of many.
pub(super) fn whitened(lengths: &Weighted, model: &LengthModel) -> Vec<f64> {
    let prepared = model.prepare();
    lengths.some(|reading, sigma| (reading.length_mm - prepared.length(reading)) / sigma)
}

/// Median of the magnitudes as a standard deviation.
pub(super) fn robust_scale(residuals: &[f64]) -> f64 {
    let mut sizes: Vec<f64> = residuals.iter().map(|r| r.abs()).collect();
    robust::median(&mut sizes).unwrap_or(0.0) * robust::SIGMA_OF_MAD
}

/// Root of Huber's weight.
fn huber_weight(residual: f64, threshold: f64) -> f64 {
    if residual.abs() <= threshold { 1.0 } else { (threshold / residual.abs()).sqrt() }
}

fn huber_loss(residual: f64, threshold: f64) -> f64 {
    let size = residual.abs();
    if size <= threshold { residual * residual } else { threshold * (2.0 * size - threshold) }
}

fn moved(model: &LengthModel, ids: &[ParamId], step: &DVector<f64>) -> LengthModel {
    let mut model = model.clone();
    for (id, step) in ids.iter().zip(step) {
        model.shift(*id, *step);
    }
    model
}
