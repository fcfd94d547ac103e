//! Lengths whose residuals do not belong to the others.

use super::fit::Fit;
use super::lengths::Weighted;
use super::solver::{Loss, ROUNDING, Solution, robust_scale, whitened};
use crate::math::robust::SIGMA_OF_MAD;
use crate::measurement::{LengthModel, MeasurementPieces};

/// Robust standard deviations beyond which a residual of the nominal robot is absurd.
pub(super) const ABSURD: f64 = 20.0;
/// Rounds in which the set of outliers may change.
const ROUNDS: usize = 10;

/// The fit by squares, `plain`, when no residual is conspicuous; else by Huber's loss, then by squares without those that
/// are, until their set no longer changes. So many `parameters` take up residuals.
pub(super) fn robust(
    whole: &Weighted,
    parameters: usize,
    plain: Solution,
    solve: impl Fn(&Weighted, Loss, Option<&LengthModel>) -> Solution,
) -> Fit {
    let limit = limit(whole.count());
    // A far outlier spreads over all residuals in a fit of few by squares: look closer already at less.
    let suspect = if whole.lengths().are_many() { limit } else { 0.85 * limit };
    if standing_out(whole, &plain.model, &plain.residuals, suspect, parameters).is_empty() {
        let Solution { model, iterations, converged, .. } = plain;
        return Fit { model, iterations, converged, out: vec![] };
    }
    let mut reached = solve(whole, Loss::Huber, None);
    let mut iterations = plain.iterations + reached.iterations;
    let mut out = Vec::new();
    for _ in 0..ROUNDS {
        let now = outliers(whole, &reached.model, parameters);
        let next = solve(&whole.without(&now), Loss::Squares, Some(&reached.model));
        iterations += next.iterations;
        reached = next;
        let settled = now == out || now.is_empty();
        out = now;
        if settled {
            break;
        }
    }
    Fit { model: reached.model, iterations, converged: reached.converged, out }
}

/// The places of the lengths that do not belong to the others beside a model that takes up so many `parameters`.
pub(super) fn outliers(whole: &Weighted, model: &LengthModel, parameters: usize) -> Vec<usize> {
    standing_out(whole, model, &whitened(whole, model), limit(whole.count()), parameters)
}

/// How many robust standard deviations a residual may have: one length in a hundred normal data
/// sets goes beyond it (twice Mills' bound on the normal tail, solved for 0.01 / n).
fn limit(readings: usize) -> f64 {
    let n = readings.max(10) as f64;
    let mut limit: f64 = 4.0;
    for _ in 0..20 {
        limit = (2.0 * (100.0 * n * (2.0 / std::f64::consts::PI).sqrt() / limit).ln()).sqrt();
    }
    limit.max(4.5)
}

/// The places of the residuals of `model` beyond `limit` robust standard deviations, which the `residuals` of all
/// lengths or of an even sample tell. A fit of `parameters` makes as many residuals vanish, so the least ones say
/// nothing of the scale: of few data the rest would seem to stand out.
pub(super) fn standing_out(
    lengths: &Weighted,
    model: &LengthModel,
    residuals: &[f64],
    limit: f64,
    parameters: usize,
) -> Vec<usize> {
    let out = beyond(lengths, model, residuals, limit, parameters);
    let datum = |at: usize| lengths.lengths().reading(at).datum;
    // Of a position all coordinates are used or none.
    let mut whole: Vec<usize> = out.into_iter().flat_map(|at| datum(at).rows(at)).collect();
    whole.sort_unstable();
    whole.dedup();
    whole
}

/// The places of single rows beyond the limit of their kind: lengths and coordinates come from two instruments, and what is
/// stated of one may be further from the truth than what is stated of the other.
fn beyond(
    lengths: &Weighted,
    model: &LengthModel,
    residuals: &[f64],
    limit: f64,
    parameters: usize,
) -> Vec<usize> {
    let stride = lengths.lengths().stride();
    let is_plane = |at: usize| lengths.lengths().reading(at).datum.is_plane();
    let (planes, others): (Vec<usize>, Vec<usize>) =
        (0..residuals.len()).partition(|sampled| is_plane(sampled * stride));
    let most = |kind: &[usize]| {
        let mut left: Vec<f64> = kind.iter().map(|sampled| residuals[*sampled].abs()).collect();
        let share = parameters * kind.len() / residuals.len().max(1);
        let vanished = (share / stride).min(left.len().saturating_sub(1));
        if vanished > 0 {
            left.select_nth_unstable_by(vanished, f64::total_cmp);
        }
        limit * robust_scale(&left[vanished..]).max(ROUNDING * SIGMA_OF_MAD)
    };
    let [of_plane, of_other] = [most(&planes), most(&others)];
    let most = |is_plane: bool| if is_plane { of_plane } else { of_other };
    if stride == 1 {
        return (0..residuals.len()).filter(|&at| residuals[at].abs() > most(is_plane(at))).collect();
    }
    let prepared = model.prepare();
    let pieces = lengths.in_pieces(|first, readings, sigma| {
        let beyond = |at: &usize| {
            let reading = &readings[*at];
            let residual = (reading.length_mm - prepared.length(reading)) / sigma[*at];
            residual.abs() > most(reading.datum.is_plane())
        };
        (0..readings.len()).filter(beyond).map(|at| first + at).collect::<Vec<usize>>()
    });
    pieces.concat()
}
