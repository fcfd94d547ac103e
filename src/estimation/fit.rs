//! The stages of a fit: set-up first, then the joint offsets, then all; without outliers.

use super::lengths::{Lengths, Sigma, Weighted};
use super::outliers::{ABSURD, robust, standing_out};
use super::prior::PriorRows;
use super::selection::is_place;
use super::solver::{Loss, Problem, Solution, minimise};
use crate::measurement::LengthModel;
use crate::robot::ParamId;

/// A fit and what it was weighted by.
#[derive(Clone, Debug)]
pub(super) struct Fit {
    pub(super) model: LengthModel,
    pub(super) iterations: usize,
    pub(super) converged: bool,
    /// The places of the lengths that it did not use, in order.
    pub(super) out: Vec<usize>,
}

/// Only the part of the set-up that is free, with the robot as it is.
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

/// What is fitted to lengths.
pub(super) struct Unknowns<'a> {
    pub(super) free: &'a [ParamId],
    /// How many of them the lengths determine by themselves.
    pub(super) determined: usize,
    pub(super) prior: Option<&'a PriorRows>,
}

/// All unknowns from `start`, whose set-up has been fitted.
pub(super) fn all(lengths: &Lengths, sigma: Sigma, unknowns: &Unknowns<'_>, start: &LengthModel) -> Fit {
    let Unknowns { free, determined, prior } = *unknowns;
    let offsets: Vec<ParamId> =
        free.iter().copied().filter(|id| matches!(id, ParamId::Theta(_)) || is_place(id)).collect();
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
    robust(&whole, determined, plain, |lengths, loss, reached| match reached {
        None => from(lengths, loss, start),
        Some(reached) => stages(lengths, &[free], loss, prior, reached),
    })
}

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
