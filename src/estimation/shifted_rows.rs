//! Whether the lengths of a table are some rows away from their poses. On smooth circles a wrong robot takes up much of
//! such a shift, so that the residual alone does not show it.

use super::estimate::Estimate;
use super::lengths::{Lengths, SAMPLE, Sigma};
use super::linear_system::LinearSystem;
use super::solver::{Loss, Problem, minimise, robust_scale};
use crate::catalogue::EstimationFinding;
use crate::measurement::{LengthModel, PreparedMeasurement};

/// A positive shift gives each pose the length of a later row.
const SHIFTS: [isize; 4] = [-1, 1, -2, 2];
/// Natural logarithm of a likelihood ratio that decides,
const DECISIVE: f64 = 20.0;
/// and how much smaller the residuals are then: of very many lengths a trifle would decide.
const SMALLER: f64 = 1.5;
/// Residuals count up to so many robust standard deviations.
const CAP: f64 = 3.0;
/// Degrees of freedom below which nothing is decided.
const FEWEST: f64 = 10.0;

/// The shift with which the lengths fit decisively better than they do in their own rows.
pub(super) fn shifted_rows(estimate: &Estimate, lengths: &Lengths) -> Option<EstimationFinding> {
    let own = moved(estimate, lengths, 0);
    let here = &estimate.fit.model;
    let (residual_mm, squares) = (size_mm(&own, here, estimate), squares(&own, here));
    let better = SHIFTS.iter().filter_map(|&rows| {
        let other = moved(estimate, lengths, rows);
        let freedom = freedom(&other, estimate);
        // One linear step is cheap, and shows for almost every shift that it is worse.
        if freedom < FEWEST || linear_squares(&other, estimate) >= squares {
            return None;
        }
        let problem = Problem {
            lengths: other.weighted(Sigma::Given, &[]),
            ids: &estimate.kept,
            loss: Loss::Huber,
            prior: estimate.prior.as_ref(),
        };
        let shifted_mm = size_mm(&other, &minimise(&problem, &estimate.before).model, estimate);
        let gain = decisive(freedom, [residual_mm, shifted_mm], SMALLER)?;
        Some(EstimationFinding::ShiftedRows { rows, residual_mm, shifted_mm, gain })
    });
    let gain = |found: &EstimationFinding| match found {
        EstimationFinding::ShiftedRows { gain, .. } => *gain,
        _ => 0.0,
    };
    better.max_by(|a, b| gain(a).total_cmp(&gain(b)))
}

/// The gain of a standard deviation of the residuals, before and after, that is decisively lower and so many times
/// `smaller`: natural logarithm of a likelihood ratio.
pub(super) fn decisive(freedom: f64, [before, after]: [f64; 2], smaller: f64) -> Option<f64> {
    let gain = freedom * (before / after).ln();
    (freedom >= FEWEST && gain > DECISIVE && before > smaller * after).then_some(gain)
}

/// The poses with the lengths of other rows, of very many the first; those that would have none are left out.
fn moved(estimate: &Estimate, lengths: &Lengths, rows: isize) -> Lengths<'static> {
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
            (reading, estimate.noise.sigma.of(lengths.given(at)))
        })
        .unzip();
    Lengths::few(readings, sigma)
}

fn freedom(lengths: &Lengths, estimate: &Estimate) -> f64 {
    lengths.len() as f64 - estimate.base.len() as f64
}

/// The residuals' standard deviation, whatever a few wild ones, mm.
pub(super) fn size_mm(lengths: &Lengths, model: &LengthModel, estimate: &Estimate) -> f64 {
    let residuals = residuals(lengths, model);
    let most = CAP * robust_scale(&residuals);
    let squares: f64 = residuals.iter().map(|residual| residual.abs().min(most).powi(2)).sum();
    (squares / freedom(lengths, estimate).max(1.0)).sqrt()
}

/// Of all residuals in standard deviations.
fn squares(lengths: &Lengths, model: &LengthModel) -> f64 {
    let sigma = (0..lengths.len()).map(|at| lengths.given(at));
    residuals(lengths, model).iter().zip(sigma).map(|(residual, sigma)| (residual / sigma).powi(2)).sum()
}

fn residuals(lengths: &Lengths, model: &LengthModel) -> Vec<f64> {
    let prepared = model.prepare();
    let residual = |reading: PreparedMeasurement| reading.length_mm - prepared.length(&reading);
    (0..lengths.len()).map(|at| residual(lengths.reading(at))).collect()
}

/// What a linear fit from the nominal robot leaves.
fn linear_squares(lengths: &Lengths, estimate: &Estimate) -> f64 {
    LinearSystem::at(&estimate.before, &lengths.weighted(Sigma::Given, &[]), &estimate.base).residual_sum()
}
