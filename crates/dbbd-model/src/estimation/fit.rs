//! The stages of a fit: set-up first, then joint offsets, then all parameters, with rejection of outliers.

use super::lengths::{Lengths, Sigma, Weighted};
use super::prior_rows::PriorRows;
use super::selection::{is_bar, is_place};
use super::solver::{Loss, Problem, ROUNDING, Solution, minimise, robust_scale, whitened};
use crate::math::robust::SIGMA_OF_MAD;
use crate::measurement::{LengthModel, MeasurementPieces};
use crate::robot::ParamId;

/// Robust standard deviations beyond which a residual is no error of a nominal robot.
const ABSURD: f64 = 20.0;
/// Rounds in which the set of outliers may change.
const ROUNDS: usize = 10;

#[derive(Clone, Debug)]
pub(super) struct Fit {
    pub(super) model: LengthModel,
    pub(super) iterations: usize,
    pub(super) converged: bool,
    /// Indices of the lengths that were not used, ascending.
    pub(super) outliers: Vec<usize>,
}

/// Fits the parameters among `free` that belong to the set-up; the robot stays as it is.
pub(super) fn set_up(lengths: &Lengths, free: &[ParamId], start: &LengthModel) -> Fit {
    let ids: Vec<ParamId> = free.iter().copied().filter(|id| id.is_setup()).collect();
    if ids.is_empty() {
        return Fit { model: start.clone(), iterations: 0, converged: true, outliers: vec![] };
    }
    // Far from the solution the offset of a bar compensates errors of the balls, so it is fitted second.
    let places: Vec<ParamId> = ids.iter().copied().filter(|id| !is_bar(id)).collect();
    let from = |lengths: &Weighted, loss: Loss, start: &LengthModel| {
        stages(lengths, &[&places, &ids], loss, None, start)
    };
    let all = lengths.weighted(Sigma::Given, &[]);
    let plain = from(&all, Loss::Squares, start);
    robust(&all, ids.len(), plain, |lengths, loss, reached| from(lengths, loss, reached.unwrap_or(start)))
}

/// Fits the parameters `kept` from `start`, whose set-up has been fitted. By the lengths alone only `independent` of
/// them are independent.
pub(super) fn all(
    lengths: &Lengths,
    sigma: Sigma,
    kept: &[ParamId],
    independent: usize,
    prior: Option<&PriorRows>,
    follows_list: bool,
    start: &LengthModel,
) -> Fit {
    let is_offset = |id: &ParamId| matches!(id, ParamId::Theta(_));
    let offsets: Vec<ParamId> = kept.iter().copied().filter(|id| is_offset(id) || is_place(id)).collect();
    // With a prior the robot is near its nominal geometry, and offsets that the data do not determine could diverge.
    let both: [&[ParamId]; 2] = [&offsets, kept];
    let lists = if follows_list && offsets.iter().any(is_offset) { &both[..] } else { &both[1..] };
    let from =
        |lengths: &Weighted, loss: Loss, start: &LengthModel| stages(lengths, lists, loss, prior, start);
    let all = lengths.weighted(sigma, &[]);
    let mut plain = from(&all, Loss::Squares, start);
    // Residuals far beyond the errors of a nominal robot would distort the start: fit without them first.
    let absurd = exceeding(&all, start, &plain.first, ABSURD, 0);
    let near = (!absurd.is_empty()).then(|| from(&lengths.weighted(sigma, &absurd), Loss::Huber, start));
    if let Some(near) = &near {
        let residuals = whitened(&all, &near.model);
        // Lengths that stay far would spread over all residuals in a least-squares fit: then this fit must not judge
        // them.
        plain = match exceeding(&all, &near.model, &residuals, ABSURD, 0).is_empty() {
            true => from(&all, Loss::Squares, &near.model),
            false => Solution { residuals, ..near.clone() },
        };
    }
    let start = near.as_ref().map_or(start, |near| &near.model);
    robust(&all, independent, plain, |lengths, loss, reached| match reached {
        None => from(lengths, loss, start),
        Some(reached) => stages(lengths, &[kept], loss, prior, reached),
    })
}

/// Minimises over each list in turn, with the prior on the last. Only the last minimisation uses all lengths of a large
/// set; an even sample of them leads it near the minimum.
fn stages(
    lengths: &Weighted,
    lists: &[&[ParamId]],
    loss: Loss,
    prior: Option<&PriorRows>,
    start: &LengthModel,
) -> Solution {
    let (mut model, mut iterations, mut first) = (start.clone(), 0, None);
    let mut step = |lengths: Weighted, ids: &[ParamId], prior: Option<&PriorRows>| {
        let solution = minimise(&Problem { lengths, ids, loss, prior }, &model);
        iterations += solution.iterations;
        model = solution.model.clone();
        let first = first.get_or_insert(solution.first).clone();
        Solution { iterations, first, ..solution }
    };
    let sample = lengths.lengths().are_many().then(|| {
        let (readings, sigma) = lengths.used_sample().into_iter().unzip();
        Lengths::few(readings, sigma)
    });
    let few = sample.as_ref().map_or(*lengths, |sample| sample.weighted(Sigma::Given, &[]));
    let (last, before) = lists.split_last().map_or((&[][..], &[][..]), |(last, before)| (*last, before));
    for ids in before {
        step(few, ids, None);
    }
    if sample.is_some() {
        step(few, last, prior);
    }
    step(*lengths, last, prior)
}

/// The least-squares fit `plain` if it has no conspicuous residual. Otherwise a fit with Huber's loss, then least-squares
/// fits without the outliers until their set no longer changes. `parameters` is the number of fitted parameters.
fn robust(
    lengths: &Weighted,
    parameters: usize,
    plain: Solution,
    solve: impl Fn(&Weighted, Loss, Option<&LengthModel>) -> Solution,
) -> Fit {
    let limit = limit(lengths.count());
    // In a least-squares fit of few lengths a far outlier spreads over all residuals, so the limit is lower.
    let suspect = if lengths.lengths().are_many() { limit } else { 0.85 * limit };
    if exceeding(lengths, &plain.model, &plain.residuals, suspect, parameters).is_empty() {
        let Solution { model, iterations, converged, .. } = plain;
        return Fit { model, iterations, converged, outliers: vec![] };
    }
    let mut reached = solve(lengths, Loss::Huber, None);
    let mut iterations = plain.iterations + reached.iterations;
    let mut rejected = Vec::new();
    for _ in 0..ROUNDS {
        let now = outliers(lengths, &reached.model, parameters);
        reached = solve(&lengths.without(&now), Loss::Squares, Some(&reached.model));
        iterations += reached.iterations;
        let settled = now == rejected || now.is_empty();
        rejected = now;
        if settled {
            break;
        }
    }
    Fit { model: reached.model, iterations, converged: reached.converged, outliers: rejected }
}

/// Indices of the outliers among `lengths` for a model with this number of fitted `parameters`.
pub(super) fn outliers(lengths: &Weighted, model: &LengthModel, parameters: usize) -> Vec<usize> {
    exceeding(lengths, model, &whitened(lengths, model), limit(lengths.count()), parameters)
}

/// The limit of a residual in robust standard deviations. One set of normal data in a hundred has a residual beyond it
/// (twice Mills' bound on the normal tail, solved for 0.01 / n).
fn limit(readings: usize) -> f64 {
    let n = readings.max(10) as f64;
    let mut limit: f64 = 4.0;
    for _ in 0..20 {
        limit = (2.0 * (100.0 * n * (2.0 / std::f64::consts::PI).sqrt() / limit).ln()).sqrt();
    }
    limit.max(4.5)
}

/// Indices of the measurements whose residuals exceed `limit` robust standard deviations. `residuals` are whitened, of all
/// lengths or of an even sample; the scale is estimated from them.
fn exceeding(
    lengths: &Weighted,
    model: &LengthModel,
    residuals: &[f64],
    limit: f64,
    parameters: usize,
) -> Vec<usize> {
    let rows = exceeding_rows(lengths, model, residuals, limit, parameters);
    let datum = |at: usize| lengths.lengths().reading(at).datum;
    // The three rows of a position are rejected together.
    let mut whole: Vec<usize> = rows.into_iter().flat_map(|at| datum(at).rows(at)).collect();
    whole.sort_unstable();
    whole.dedup();
    whole
}

/// The same for single rows. Lengths and coordinates come from different instruments whose stated uncertainties may be wrong
/// by different factors, so each kind has its own scale.
fn exceeding_rows(
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
    let largest = |kind: &[usize]| {
        let mut sizes: Vec<f64> = kind.iter().map(|sampled| residuals[*sampled].abs()).collect();
        // A fit makes as many residuals vanish as it has parameters. These say nothing about the scale: with few data the
        // others would all exceed it.
        let share = parameters * kind.len() / residuals.len().max(1);
        let vanished = (share / stride).min(sizes.len().saturating_sub(1));
        if vanished > 0 {
            sizes.select_nth_unstable_by(vanished, f64::total_cmp);
        }
        limit * robust_scale(&sizes[vanished..]).max(ROUNDING * SIGMA_OF_MAD)
    };
    let [of_plane, of_other] = [largest(&planes), largest(&others)];
    let largest = |is_plane: bool| if is_plane { of_plane } else { of_other };
    if stride == 1 {
        return (0..residuals.len()).filter(|&at| residuals[at].abs() > largest(is_plane(at))).collect();
    }
    let prepared = model.prepare();
    let pieces = lengths.in_pieces(|first, readings, sigma| {
        let exceeds = |at: &usize| {
            let reading = &readings[*at];
            (prepared.residual(reading) / sigma[*at]).abs() > largest(reading.datum.is_plane())
        };
        (0..readings.len()).filter(exceeds).map(|at| first + at).collect::<Vec<usize>>()
    });
    pieces.concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Normal quantiles of 1 - 0.005 / n, by `NormalDist` of Python. Mills' bound is less than 1 % beyond them.
    #[test]
    fn one_normal_set_in_a_hundred_has_a_residual_beyond_the_limit() {
        for (readings, quantile) in [(10_000, 4.8916), (1_000_000, 5.7307)] {
            let beyond = limit(readings) - quantile;
            assert!(beyond > 0.0 && beyond < 0.01 * quantile, "{readings}: {beyond}");
        }
        // Few lengths say too little of their scale.
        assert_eq!([limit(0), limit(10), limit(1000)], [4.5; 3]);
    }
}
