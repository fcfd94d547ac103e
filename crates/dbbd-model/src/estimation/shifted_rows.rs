//! Whether the lengths of a table are shifted by some rows against their poses. On smooth circles wrong parameters compensate
//! much of such a shift, so that the residuals alone do not reveal it.

use super::estimator::Estimate;
use super::lengths::{Lengths, SAMPLE, Sigma};
use super::linear_system::linear_system;
use super::solver::{Loss, Problem, minimise, robust_scale};
use crate::estimation::EstimationFinding;
use crate::measurement::{LengthModel, PreparedMeasurement};

/// A positive shift assigns the length of a later row to each pose.
const SHIFTS: [isize; 4] = [-1, 1, -2, 2];
/// Natural logarithm of the likelihood ratio that is required,
const DECISIVE: f64 = 20.0;
/// and the required ratio of the residuals: with very many lengths a tiny improvement reaches the likelihood ratio.
const SMALLER: f64 = 1.5;
/// Residuals are truncated at this number of robust standard deviations.
const CAP: f64 = 3.0;
/// Degrees of freedom below which nothing is decided.
const MIN_FREEDOM: f64 = 10.0;

/// The shift with which the lengths fit decisively better than unshifted. The geometry alone, without a prior, is fitted to both:
/// errors of the joints would compensate more of the shift.
pub(super) fn shifted_rows(estimate: &Estimate, lengths: &Lengths) -> Option<EstimationFinding> {
    let fitted = |lengths: &Lengths| {
        let weighted = lengths.weighted(Sigma::Given, &[]);
        let problem = Problem { lengths: weighted, ids: &estimate.base, loss: Loss::Huber, prior: None };
        minimise(&problem, &estimate.at_start).model
    };
    let own = shifted(estimate, lengths, 0);
    if freedom(&own, estimate) < MIN_FREEDOM {
        return None;
    }
    let model = fitted(&own);
    let residual_mm = size_mm(&own, &model, estimate);
    let whitened = residuals(&own, &model).enumerate().map(|(at, residual)| residual / own.given(at));
    let squares: f64 = whitened.map(|residual| residual.powi(2)).sum();
    let better = SHIFTS.iter().filter_map(|&rows| {
        let other = shifted(estimate, lengths, rows);
        let weighted = other.weighted(Sigma::Given, &[]);
        // One linearised step is cheap and rules out almost every shift.
        if linear_system(&estimate.at_start, &weighted, &estimate.base).residual_sum() >= squares {
            return None;
        }
        let shifted_mm = size_mm(&other, &fitted(&other), estimate);
        let gain = decisive(freedom(&other, estimate), [residual_mm, shifted_mm], SMALLER)?;
        Some((gain, EstimationFinding::ShiftedRows { rows, residual_mm, shifted_mm, gain }))
    });
    better.max_by(|(a, _), (b, _)| a.total_cmp(b)).map(|(_, finding)| finding)
}

/// The natural logarithm of the likelihood ratio by which the standard deviation of the residuals falls from `before` to
/// `after`, if it is decisive and they fall by the factor `smaller`.
fn decisive(freedom: f64, [before, after]: [f64; 2], smaller: f64) -> Option<f64> {
    let gain = freedom * (before / after).ln();
    (freedom >= MIN_FREEDOM && gain > DECISIVE && before > smaller * after).then_some(gain)
}

/// The poses with the lengths `rows` further; the first ones of very many. Poses without a length are dropped.
fn shifted(estimate: &Estimate, lengths: &Lengths, rows: isize) -> Lengths<'static> {
    let count = lengths.len().min(2 * SAMPLE);
    let other = |at: usize| {
        let datum = lengths.reading(at).datum;
        let rows = if datum.is_plane() { 3 * rows } else { rows };
        let other = at.checked_add_signed(rows).filter(|other| *other < count)?;
        (lengths.reading(other).datum.is_plane() == datum.is_plane()).then_some(other)
    };
    let pairs = (0..count).filter_map(|at| Some((at, other(at)?)));
    let (readings, sigma) = pairs
        .map(|(at, other)| {
            let length_mm = lengths.reading(other).length_mm;
            let reading = PreparedMeasurement { length_mm, ..lengths.reading(at) };
            (reading, estimate.sigma.of(lengths.given(at)))
        })
        .unzip();
    Lengths::few(readings, sigma)
}

fn freedom(lengths: &Lengths, estimate: &Estimate) -> f64 {
    lengths.len() as f64 - estimate.base.len() as f64
}

/// The standard deviation of the truncated residuals, mm.
pub(super) fn size_mm(lengths: &Lengths, model: &LengthModel, estimate: &Estimate) -> f64 {
    let residuals: Vec<f64> = residuals(lengths, model).collect();
    let most = CAP * robust_scale(&residuals);
    let squares: f64 = residuals.iter().map(|residual| residual.abs().min(most).powi(2)).sum();
    (squares / freedom(lengths, estimate).max(1.0)).sqrt()
}

fn residuals(lengths: &Lengths, model: &LengthModel) -> impl Iterator<Item = f64> {
    let prepared = model.prepare();
    (0..lengths.len()).map(move |at| prepared.residual(&lengths.reading(at)))
}
