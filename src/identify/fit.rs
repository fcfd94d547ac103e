//! The stages of a fit: set-up first, then the joint offsets, then all; outliers set aside; the
//! sigma of the lengths brought to what the residuals show.

use super::lengths::{Lengths, Sigma, Weighted};
use super::prior::PriorRows;
use super::solver::{Loss, MAD_TO_SD, Problem, ROUNDING, Solution, minimise, robust_scale, whitened};
use crate::model::{LengthModel, ParamId};

/// A fit and what it was weighted by.
#[derive(Clone, Debug)]
pub(super) struct Fit {
    pub(super) model: LengthModel,
    pub(super) iterations: usize,
    pub(super) converged: bool,
    /// The places of the lengths that it did not use, in order.
    pub(super) out: Vec<usize>,
}

/// Only the part of the set-up that is free, with the robot as it stands.
pub(super) fn set_up(lengths: &Lengths, free: &[ParamId], start: &LengthModel) -> Fit {
    let ids: Vec<ParamId> = free.iter().copied().filter(|id| id.is_setup()).collect();
    if ids.is_empty() {
        return Fit { model: start.clone(), iterations: 0, converged: true, out: vec![] };
    }
    // The bar's offset trades against the balls' places far from the solution, so it comes second.
    let places: Vec<ParamId> =
        ids.iter().copied().filter(|id| !matches!(id, ParamId::BarOffset(_))).collect();
    let from = |lengths: &Weighted, loss: Loss, start: &LengthModel| {
        stages(lengths, &[&places, &ids], loss, None, start)
    };
    let whole = lengths.weighted(Sigma::Given, &[]);
    let plain = from(&whole, Loss::Squares, start);
    robust(&whole, ids.len(), plain, |lengths, loss, reached| from(lengths, loss, reached.unwrap_or(start)))
}

/// All of `free` from `start`, whose set-up has been fitted; the lengths tell `told` of them by themselves.
pub(super) fn all(
    lengths: &Lengths,
    sigma: Sigma,
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
    let from =
        |lengths: &Weighted, loss: Loss, start: &LengthModel| stages(lengths, lists, loss, prior, start);
    let whole = lengths.weighted(sigma, &[]);
    let mut plain = from(&whole, Loss::Squares, start);
    // What is absurd beside the nominal robot's own errors would pull the start away: first without it.
    let absurd = standing_out(&whole, start, &plain.first, ABSURD, 0);
    let near =
        (!absurd.is_empty()).then(|| from(&lengths.weighted(sigma, &absurd), Loss::Huber, start).model);
    if let Some(near) = &near {
        plain = from(&whole, Loss::Squares, near);
    }
    let start = near.as_ref().unwrap_or(start);
    robust(&whole, told, plain, |lengths, loss, reached| match reached {
        None => from(lengths, loss, start),
        Some(reached) => stages(lengths, &[free], loss, prior, reached),
    })
}

/// Robust standard deviations beyond which a residual of the nominal robot is absurd.
const ABSURD: f64 = 20.0;

/// An even sample of a large set, which leads it near its minimum.
fn sample(lengths: &Weighted) -> Option<Lengths<'static>> {
    lengths.lengths().are_many().then(|| {
        let some = lengths.some(|reading, sigma| (*reading, sigma)).into_iter();
        let (readings, sigma) = some.filter(|(_, sigma)| sigma.is_finite()).unzip();
        Lengths::few(readings, sigma)
    })
}

/// Minimises over each list in turn; the prior belongs to the last. A large set takes part in the last only.
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
    let sample = sample(lengths);
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

/// The fit by squares, `plain`, when no residual stands out; else by Huber's loss, then by squares without those that
/// stand out, until their set stands. So many `parameters` take up residuals.
fn robust(
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
    for _ in 0..10 {
        let residuals = whitened(whole, &reached.model);
        let now = standing_out(whole, &reached.model, &residuals, limit, parameters);
        let next = solve(&whole.without(&now), Loss::Squares, Some(&reached.model));
        iterations += next.iterations;
        reached = next;
        let stands = now == out || now.is_empty();
        out = now;
        if stands {
            break;
        }
    }
    Fit { model: reached.model, iterations, converged: reached.converged, out }
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
fn standing_out(
    lengths: &Weighted,
    model: &LengthModel,
    residuals: &[f64],
    limit: f64,
    parameters: usize,
) -> Vec<usize> {
    let stride = lengths.lengths().stride();
    let mut left: Vec<f64> = residuals.iter().map(|r| r.abs()).collect();
    let vanished = (parameters / stride).min(left.len().saturating_sub(1));
    if vanished > 0 {
        left.select_nth_unstable_by(vanished, f64::total_cmp);
    }
    let most = limit * robust_scale(&left[vanished..]).max(ROUNDING * MAD_TO_SD);
    if stride == 1 {
        return (0..residuals.len()).filter(|&at| residuals[at].abs() > most).collect();
    }
    let prepared = model.prepare();
    let pieces = lengths.placed(|first, readings, sigma| {
        let beyond =
            |at: &usize| ((readings[*at].length - prepared.length(&readings[*at])) / sigma[*at]).abs() > most;
        (0..readings.len()).filter(beyond).map(|at| first + at).collect::<Vec<usize>>()
    });
    pieces.concat()
}
