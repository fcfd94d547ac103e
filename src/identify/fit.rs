//! The stages of a fit: set-up first, then the joint offsets, then all; outliers set aside; the
//! sigma of the lengths brought to what the residuals show.

use super::prior::PriorRows;
use super::solver::{Loss, MAD_TO_SD, Problem, ROUNDING, Solution, minimise, robust_scale, whitened};
use crate::model::{LengthModel, ParamId, Reading};

/// A fit and what it was weighted by.
#[derive(Clone, Debug)]
pub(super) struct Fit {
    pub(super) model: LengthModel,
    pub(super) iterations: usize,
    pub(super) converged: bool,
    /// For each reading whether it was used.
    pub(super) used: Vec<bool>,
}

/// Only the part of the set-up that is free, with the robot as it stands.
pub(super) fn set_up(readings: &[Reading], sigma: &[f64], free: &[ParamId], start: &LengthModel) -> Fit {
    let ids: Vec<ParamId> = free.iter().copied().filter(|id| id.is_setup()).collect();
    if ids.is_empty() {
        return Fit {
            model: start.clone(),
            iterations: 0,
            converged: true,
            used: vec![true; readings.len()],
        };
    }
    robust(readings, sigma, ids.len(), |readings, sigma, loss, from| {
        let from = from.unwrap_or(start);
        // The bar's offset trades against the balls' places far from the solution, so it comes second.
        let places: Vec<ParamId> =
            ids.iter().copied().filter(|id| !matches!(id, ParamId::BarOffset(_))).collect();
        stages(readings, sigma, &[&places, &ids], loss, None, from)
    })
}

/// All of `free` from `start`, whose set-up has been fitted; the lengths tell `told` of them by themselves.
pub(super) fn all(
    readings: &[Reading],
    sigma: &[f64],
    (free, told): (&[ParamId], usize),
    prior: Option<&PriorRows>,
    start: &LengthModel,
) -> Fit {
    let offsets: Vec<ParamId> = free
        .iter()
        .copied()
        .filter(|id| matches!(id, ParamId::Theta(_) | ParamId::Tool(_) | ParamId::Centre(..)))
        .collect();
    // With a prior the robot is near its nominal, and offsets that the data do not hold could run away.
    let joints_first = prior.is_none() && offsets.iter().any(|id| matches!(id, ParamId::Theta(_)));
    let both: [&[ParamId]; 2] = [&offsets, free];
    let lists = if joints_first { &both[..] } else { &both[1..] };
    let from = |readings: &[Reading], sigma: &[f64], loss: Loss, start: &LengthModel| {
        stages(readings, sigma, lists, loss, prior, start)
    };
    // What is absurd beside the nominal robot's own errors would pull the start away: first without it.
    let absurd = standing_out(&residuals(readings, sigma, start), ABSURD, 0);
    let near =
        (!absurd.is_empty()).then(|| from(readings, &without(sigma, &absurd), Loss::Huber, start).model);
    let start = near.as_ref().unwrap_or(start);
    robust(readings, sigma, told, |readings, sigma, loss, reached| match reached {
        None => from(readings, sigma, loss, start),
        Some(reached) => stages(readings, sigma, &[free], loss, prior, reached),
    })
}

/// Robust standard deviations beyond which a residual of the nominal robot is absurd.
const ABSURD: f64 = 20.0;

/// The sigmas with those at `out` infinite, which leaves their lengths out; a million need not be copied.
fn without(sigma: &[f64], out: &[usize]) -> Vec<f64> {
    let mut left = sigma.to_vec();
    out.iter().for_each(|at| left[*at] = f64::INFINITY);
    left
}

/// Lengths of a sample that leads a large set near its minimum; a set twice as large is large.
const SAMPLE: usize = 8192;

/// An even sample of a large set.
fn sample(readings: &[Reading], sigma: &[f64]) -> Option<(Vec<Reading>, Vec<f64>)> {
    if readings.len() < 2 * SAMPLE {
        return None;
    }
    let step = readings.len() / SAMPLE;
    Some((readings.iter().step_by(step).copied().collect(), sigma.iter().step_by(step).copied().collect()))
}

/// Minimises over each list in turn; the prior belongs to the last. A large set takes part in the last only.
fn stages(
    readings: &[Reading],
    sigma: &[f64],
    lists: &[&[ParamId]],
    loss: Loss,
    prior: Option<&PriorRows>,
    start: &LengthModel,
) -> Solution {
    let (mut model, mut iterations) = (start.clone(), 0);
    let mut step = |readings: &[Reading], sigma: &[f64], ids: &[ParamId], prior: Option<&PriorRows>| {
        let solution = minimise(&Problem { readings, sigma, ids, loss, prior }, &model);
        iterations += solution.iterations;
        model = solution.model.clone();
        Solution { iterations, ..solution }
    };
    let sample = sample(readings, sigma);
    let (few, their_sigma) =
        sample.as_ref().map_or((readings, sigma), |(few, sigma)| (few.as_slice(), sigma.as_slice()));
    let (last, before) = lists.split_last().map_or((&[][..], &[][..]), |(last, before)| (*last, before));
    for ids in before {
        step(few, their_sigma, ids, None);
    }
    if sample.is_some() {
        step(few, their_sigma, last, prior);
    }
    step(readings, sigma, last, prior)
}

/// By squares when no residual stands out; else by Huber's loss, then by squares without those that
/// stand out, until their set stands. So many `parameters` take up residuals.
fn robust(
    readings: &[Reading],
    sigma: &[f64],
    parameters: usize,
    solve: impl Fn(&[Reading], &[f64], Loss, Option<&LengthModel>) -> Solution,
) -> Fit {
    let plain = solve(readings, sigma, Loss::Squares, None);
    // A far outlier spreads over all residuals in a fit by squares: look closer already at less.
    if standing_out(&plain.residuals, 0.85 * limit(readings.len()), parameters).is_empty() {
        let Solution { model, iterations, converged, .. } = plain;
        return Fit { model, iterations, converged, used: vec![true; readings.len()] };
    }
    let mut reached = solve(readings, sigma, Loss::Huber, None);
    let mut iterations = plain.iterations + reached.iterations;
    let mut used = vec![true; readings.len()];
    for _ in 0..10 {
        let residuals = self::residuals(readings, sigma, &reached.model);
        let out = standing_out(&residuals, limit(readings.len()), parameters);
        let mut now = vec![true; readings.len()];
        out.iter().for_each(|at| now[*at] = false);
        let next = solve(readings, &without(sigma, &out), Loss::Squares, Some(&reached.model));
        iterations += next.iterations;
        reached = next;
        if now == used && !out.is_empty() || out.is_empty() {
            used = now;
            break;
        }
        used = now;
    }
    Fit { model: reached.model, iterations, converged: reached.converged, used }
}

/// Residuals in sigmas.
fn residuals(readings: &[Reading], sigma: &[f64], model: &LengthModel) -> Vec<f64> {
    whitened(&Problem { readings, sigma, ids: &[], loss: Loss::Squares, prior: None }, model)
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

/// The residuals beyond `limit` robust standard deviations. A fit of `parameters` makes as many residuals
/// vanish, so the least ones say nothing of the scale: of few data the rest would seem to stand out.
fn standing_out(residuals: &[f64], limit: f64, parameters: usize) -> Vec<usize> {
    let mut left: Vec<f64> = residuals.iter().map(|r| r.abs()).collect();
    let vanished = parameters.min(left.len().saturating_sub(1));
    if vanished > 0 {
        left.select_nth_unstable_by(vanished, f64::total_cmp);
    }
    let scale = robust_scale(&left[vanished..]).max(ROUNDING * MAD_TO_SD);
    (0..residuals.len()).filter(|&at| residuals[at].abs() > limit * scale).collect()
}
