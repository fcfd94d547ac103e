//! The choice of the estimated parameters: those that the data determine well enough or a prior binds, without the places
//! that the poses leave open.

use super::estimate::Search;
use super::lengths::{Sigma, Weighted};
use super::linear_system::factor;
use super::prior;
use super::priors::{Prior, Priors, largest_plausible};
use super::uncertainty::{Partition, data_sd};
use crate::math::base_set;
use crate::measurement::LengthModel;
use crate::robot::ParamId;

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Choice {
    /// The parameters to estimate.
    pub(super) kept: Vec<ParamId>,
    /// Those of them that are independent by the lengths alone.
    pub(super) base: Vec<ParamId>,
    /// Fixed parameters, weakest first.
    pub(super) poorly_observable: Vec<ParamId>,
    /// Bars whose offset the lengths do not determine, so that a prior binds it.
    pub(super) undetermined_bars: Vec<ParamId>,
}

impl Choice {
    pub(super) fn of(search: &Search<'_>) -> Self {
        let Search { setting, base, set_up, implausible, .. } = search;
        let lengths = search.lengths.weighted(search.noise.sigma, &[]);
        match setting.options.prior {
            Prior::None if setting.options.follows_list() => Self::all(base.clone()),
            Prior::None => {
                let plausible = without(base, implausible);
                let poor = poorly_observable(&setting.priors, &set_up.model, &lengths, &plausible);
                let kept = Self::all(without(&plausible, &poor));
                Self { poorly_observable: [implausible.as_slice(), &poor].concat(), ..kept }
            }
            Prior::Datasheet | Prior::Given(_) | Prior::Posterior => Self::bound(search, &lengths),
        }
    }

    fn all(base: Vec<ParamId>) -> Self {
        Self { kept: base.clone(), base, poorly_observable: vec![], undetermined_bars: vec![] }
    }

    /// Everything that a prior binds or the lengths determine.
    fn bound(search: &Search<'_>, lengths: &Weighted) -> Self {
        let Search { setting, base, analysis, set_up, .. } = search;
        let mut undetermined_bars = weak_bars(&setting.priors, base, &set_up.model, lengths);
        undetermined_bars.extend(analysis.dependent().into_iter().filter(is_bar));
        let sharing = prior::sharing(&setting.priors, &undetermined_bars, analysis);
        let mut kept = [base.as_slice(), &sharing].concat();
        kept.sort();
        Self { kept, poorly_observable: search.open.clone(), undetermined_bars, base: base.clone() }
    }
}

fn without(ids: &[ParamId], excluded: &[ParamId]) -> Vec<ParamId> {
    ids.iter().copied().filter(|id| !excluded.contains(id)).collect()
}

pub(super) fn is_bar(id: &ParamId) -> bool {
    matches!(id, ParamId::BarOffset(_))
}

/// Whether a parameter belongs to the position of a target, of a base ball or of the tracker.
pub fn is_place(id: &ParamId) -> bool {
    id.is_setup() && !is_bar(id)
}

/// The parameters of `ids` that the lengths determine worse than their limit, weakest first. They are fixed one by one: fixing
/// a parameter lowers the noise of the others, but its own error, of the size of its tolerance, leaks into them.
fn poorly_observable(
    priors: &Priors,
    model: &LengthModel,
    lengths: &Weighted,
    ids: &[ParamId],
) -> Vec<ParamId> {
    let data = factor(model, lengths, ids);
    let (optional, mut kept): (Vec<usize>, Vec<usize>) =
        (0..ids.len()).partition(|&at| ids[at].is_optional());
    let mut weak: Vec<usize> = Vec::new();
    // Fixes the weakest of the `fixable` parameters as long as a `judged` one exceeds its limit.
    let mut fix = |kept: &mut Vec<usize>, judged: fn(ParamId) -> bool, fixable: fn(ParamId) -> bool| loop {
        let sd = Partition { ids, data: &data, kept, fixed: &weak }.sd(priors);
        let limited = (0..kept.len()).filter(|&k| priors.weak_limit(ids[kept[k]]).is_finite());
        let ratios: Vec<(usize, f64)> =
            limited.map(|k| (k, sd[k] / priors.weak_limit(ids[kept[k]]))).collect();
        let exceeds =
            ratios.iter().any(|(k, ratio)| judged(ids[kept[*k]]) && (*ratio > 1.0 || ratio.is_nan()));
        let weakest =
            ratios.iter().filter(|(k, _)| fixable(ids[kept[*k]])).max_by(|(_, a), (_, b)| a.total_cmp(b));
        match weakest {
            Some((k, _)) if exceeds => weak.push(kept.remove(*k)),
            _ => break,
        }
    };
    // Bars are fixed first: on circles of one radius their offset is equivalent to a scale of the robot, and a length of the
    // robot that were fixed instead would distort all others.
    let bar = |id: ParamId| is_bar(&id);
    fix(&mut kept, bar, bar);
    fix(&mut kept, |_| true, |_| true);
    // An optional parameter is fixed before a parameter that the data determine without it.
    if !optional.is_empty() {
        kept.extend(optional);
        fix(&mut kept, |_| true, ParamId::is_optional);
    }
    weak.into_iter().map(|at| ids[at]).collect()
}

/// The bars whose offset the lengths alone do not determine. The prior of the robot must not do it: on circles of one radius
/// the robot's tolerance would determine the length of the bar.
fn weak_bars(priors: &Priors, base: &[ParamId], model: &LengthModel, lengths: &Weighted) -> Vec<ParamId> {
    if !base.iter().any(is_bar) {
        return vec![];
    }
    let sd = data_sd(model, lengths, base);
    let is_weak = |at: usize| sd.as_ref().is_none_or(|sd| sd[at] > priors.weak_limit(base[at]));
    (0..base.len()).filter(|&at| is_bar(&base[at]) && is_weak(at)).map(|at| base[at]).collect()
}

/// The parameter whose correction is least plausible, if any: the data determine it worse than its tolerance does, and the
/// correction is larger than tolerance and data allow. It compensates errors that the model lacks, or fixed parameters.
pub(super) fn most_implausible(
    search: &Search<'_>,
    fitted: &LengthModel,
    lengths: &Weighted,
    kept: &[ParamId],
) -> Option<ParamId> {
    let (priors, nominal) = (&search.setting.priors, &search.set_up.model);
    let sd = data_sd(fitted, lengths, kept)?;
    kept.iter()
        .zip(sd)
        .filter_map(|(id, sd)| {
            let excess = priors.excess(*id, fitted.value(*id) - nominal.value(*id), sd)?;
            (sd > priors.geometric(*id)? && excess > largest_plausible(true)).then_some((*id, excess))
        })
        .max_by(|(_, a), (_, b)| a.total_cmp(b))
        .map(|(id, _)| id)
}

/// The parameters asked for, without the places of tool, base balls and tracker that the lengths do not determine even for
/// the nominal robot (as if the tool never turns): in a fit of the set-up they would diverge together. Base balls are
/// preferred to the tool, whose prior is better.
pub fn without_open_places(
    priors: &Priors,
    start: &LengthModel,
    lengths: &Weighted,
    asked: &[ParamId],
) -> Option<Vec<ParamId>> {
    let is_judged = |id: &ParamId| is_place(id) && !priors.is_of_posterior(*id);
    let mut places: Vec<ParamId> = asked.iter().copied().filter(is_judged).collect();
    places.sort_by_key(|id| matches!(id, ParamId::Tool(_)));
    let order: Vec<usize> = (0..places.len()).collect();
    let set = base_set(&factor(start, &lengths.by(Sigma::All(1.0)), &places), &order)?;
    let determined: Vec<ParamId> = set.kept.iter().map(|&k| places[k]).collect();
    let open = open_places(priors, start, lengths, determined.clone());
    let free = |id: &ParamId| !is_judged(id) || determined.contains(id) && !open.contains(id);
    Some(asked.iter().copied().filter(free).collect())
}

/// Which of these places the lengths leave open for the nominal robot, worst first.
pub(super) fn open_places(
    priors: &Priors,
    model: &LengthModel,
    lengths: &Weighted,
    mut places: Vec<ParamId>,
) -> Vec<ParamId> {
    // The nominal robot fits no better than its tolerance.
    let lengths = lengths.by(Sigma::All(priors.length_tolerance_mm()));
    let mut open = Vec::new();
    while !places.is_empty() {
        let Some(sd) = data_sd(model, &lengths, &places) else { break };
        let ratio = |k: &usize| sd[*k] / places[*k].max_sd().unwrap_or(f64::INFINITY);
        match (0..places.len()).max_by(|a, b| ratio(a).total_cmp(&ratio(b))) {
            Some(worst) if ratio(&worst) > 1.0 => open.push(places.remove(worst)),
            _ => break,
        }
    }
    open
}
