//! Levenberg-Marquardt on the lengths, with column scaling, a robust loss by reweighting, and prior rows.
//!
//! Damping follows Nielsen ("Damping parameter in Marquardt's method", IMM-REP-1999-05): it grows
//! faster with each refusal and shrinks by the gain ratio. It starts so small that the first steps are
//! Gauss-Newton's.

use nalgebra::DVector;

use super::lengths::Weighted;
use super::prior::PriorRows;
use crate::linalg::Triangle;
use crate::model::{LengthModel, LengthRow, ParamId, Selection};

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
/// 1 / the 75 % point of the normal distribution: makes the median of |r| a standard deviation.
pub(super) const MAD_TO_SD: f64 = 1.482_602_218_505_602;
/// A residual scale below this (in sigmas or mm) is rounding, not noise.
pub(super) const ROUNDING: f64 = 1e-9;
const MAX_STEPS: usize = 100;
/// A step that changes the lengths by less than this (rms, mm) is none.
const REST_MM: f64 = 1e-10;

/// Minimises the weighted residuals over `problem.ids`, from `start`.
pub(super) fn minimise(problem: &Problem, start: &LengthModel) -> Solution {
    let n = problem.ids.len();
    let mut model = start.clone();
    if n == 0 {
        let residuals = whitened(&problem.lengths, &model);
        return Solution { model, iterations: 0, converged: true, first: residuals.clone(), residuals };
    }
    let mut scale = DVector::<f64>::zeros(n);
    let (mut damping, mut growth) = (1e-12, 4.0);
    let rest = REST_MM / problem.lengths.rms_sigma() * (problem.lengths.count() as f64).sqrt();
    let mut here = equations(problem, &model, f64::INFINITY);
    let first = here.residuals.clone();
    let mut steps = 0;
    while steps < MAX_STEPS {
        let knee = match problem.loss {
            Loss::Squares => f64::INFINITY,
            Loss::Huber => HUBER * robust_scale(&here.residuals).max(ROUNDING),
        };
        if knee.is_finite() {
            here = equations(problem, &model, knee);
        }
        let cost = here.cost;
        // Exact lengths: what is left is rounding, and would only push along what they do not tell.
        if cost.sqrt() <= 0.1 * rest {
            return rest_at(model, steps, true, here, first);
        }
        let factor = here.triangle.factor();
        let rhs = here.triangle.rhs();
        for k in 0..n {
            scale[k] = scale[k].max(factor.column(k).norm());
        }
        // Steps are refused until one lowers the cost.
        loop {
            steps += 1;
            let step = damped_step(&here.triangle, &scale, damping);
            if let Some(step) = step {
                let change = &factor * &step;
                let predicted = 2.0 * rhs.dot(&change) - change.norm_squared();
                let candidate = moved(&model, problem.ids, &step);
                // The reduction left is below the rounding of the cost, or moves no length: this is the minimum.
                if change.norm() <= rest || predicted <= 1e-14 * cost {
                    let residuals = here.residuals;
                    return Solution {
                        model: candidate,
                        iterations: steps,
                        converged: true,
                        residuals,
                        first,
                    };
                }
                let there = equations(problem, &candidate, knee);
                let gain = (cost - there.cost) / predicted;
                if gain > 1e-4 && gain.is_finite() {
                    (model, here) = (candidate, there);
                    damping *= (1.0 - (2.0 * gain - 1.0).powi(3)).clamp(0.1, 0.9);
                    growth = 4.0;
                    break;
                }
                if predicted <= 1e-12 * cost {
                    return rest_at(model, steps, true, here, first);
                }
            }
            damping = (damping * growth).max(1e-9);
            growth *= 2.0;
            if damping > 1e12 || steps >= MAX_STEPS {
                return rest_at(model, steps, false, here, first);
            }
        }
    }
    rest_at(model, steps, false, here, first)
}

fn rest_at(
    model: LengthModel,
    iterations: usize,
    converged: bool,
    here: Equations,
    first: Vec<f64>,
) -> Solution {
    Solution { model, iterations, converged, residuals: here.residuals, first }
}

/// The equations of a step at a model.
struct Equations {
    /// Weighted rows, the prior's among them.
    triangle: Triangle,
    /// Residuals, measured minus predicted, in sigmas; an even sample of many.
    residuals: Vec<f64>,
    /// What is to be made least.
    cost: f64,
}

/// The equations at `model`, on all cores where there are many; the loss turns linear at `knee`.
fn equations(problem: &Problem, model: &LengthModel, knee: f64) -> Equations {
    let selection = Selection::new(problem.ids);
    let prepared = model.prepare();
    let stride = problem.lengths.lengths().stride();
    let loss = |r: f64| if r.abs() <= knee { r * r } else { knee * (2.0 * r.abs() - knee) };
    let pieces = problem.lengths.placed(|first, readings, sigma| {
        let mut triangle = Triangle::new(problem.ids.len());
        let (mut residuals, mut cost) = (Vec::with_capacity(readings.len() / stride + 1), 0.0);
        let mut row = vec![0.0; problem.ids.len()];
        let mut derivatives = LengthRow::default();
        for (at, (reading, sigma)) in readings.iter().zip(sigma).enumerate() {
            prepared.row_into(reading, &mut derivatives);
            let residual = (reading.length - derivatives.length) / sigma;
            let weight = huber_weight(residual, knee);
            selection.pick(&derivatives, reading.centre, &mut row);
            row.iter_mut().for_each(|value| *value *= weight / sigma);
            triangle.push(&row, residual * weight);
            cost += loss(residual);
            // A division is worth avoiding here.
            if stride == 1 || (first + at).is_multiple_of(stride) {
                residuals.push(residual);
            }
        }
        (triangle, residuals, cost)
    });
    let (mut triangles, mut residuals, mut cost) = (Vec::new(), Vec::new(), 0.0);
    for (triangle, of_piece, its_cost) in pieces {
        triangles.push(triangle);
        residuals.extend(of_piece);
        cost += its_cost;
    }
    let mut triangle = Triangle::merged(triangles, problem.ids.len());
    if let Some(prior) = problem.prior {
        cost += push_prior(&mut triangle, prior, problem.ids, model);
    }
    Equations { triangle, residuals, cost }
}

/// Residuals, measured minus predicted, in sigmas; an even sample of many.
pub(super) fn whitened(lengths: &Weighted, model: &LengthModel) -> Vec<f64> {
    let prepared = model.prepare();
    lengths.some(|reading, sigma| (reading.length - prepared.length(reading)) / sigma)
}

/// Median of the magnitudes as a standard deviation.
pub(super) fn robust_scale(residuals: &[f64]) -> f64 {
    let mut sizes: Vec<f64> = residuals.iter().map(|r| r.abs()).collect();
    if sizes.is_empty() {
        return 0.0;
    }
    let middle = sizes.len() / 2;
    let (_, median, _) = sizes.select_nth_unstable_by(middle, f64::total_cmp);
    *median * MAD_TO_SD
}

/// Root of Huber's weight.
fn huber_weight(residual: f64, knee: f64) -> f64 {
    if residual.abs() <= knee { 1.0 } else { (knee / residual.abs()).sqrt() }
}

/// Adds the prior's equations; the sum of their squares.
fn push_prior(triangle: &mut Triangle, prior: &PriorRows, ids: &[ParamId], model: &LengthModel) -> f64 {
    let mut squares = 0.0;
    for k in prior.bound() {
        let wrong = prior.weights[k] * (model.value(ids[k]) - prior.mean[k]);
        triangle.push_single(k, prior.weights[k], -wrong);
        squares += wrong * wrong;
    }
    squares
}

fn damped_step(triangle: &Triangle, scale: &DVector<f64>, damping: f64) -> Option<DVector<f64>> {
    let mut damped = triangle.clone();
    for (unknown, scale) in scale.iter().enumerate() {
        damped.push_single(unknown, damping.sqrt() * scale, 0.0);
    }
    damped.solve()
}

fn moved(model: &LengthModel, ids: &[ParamId], step: &DVector<f64>) -> LengthModel {
    let mut model = model.clone();
    for (id, step) in ids.iter().zip(step) {
        model.shift(*id, *step);
    }
    model
}
