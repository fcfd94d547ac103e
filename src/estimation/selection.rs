//! Which parameters are estimated: what the data determine well enough, what a prior binds, and which places of the balls
//! poses leave open.

use super::estimate::Search;
use super::lengths::{Sigma, Weighted};
use super::linear_system::factor;
use super::prior;
use super::priors::{Prior, Priors, largest_plausible, open_limit};
use super::uncertainty::{Partition, data_sd};
use crate::math::base_set;
use crate::measurement::LengthModel;
use crate::robot::ParamId;

/// Which parameters an estimate is of.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Choice {
    pub(super) kept: Vec<ParamId>,
    /// Those of them that are independent for the lengths alone.
    pub(super) base: Vec<ParamId>,
    /// Fixed, weakest first.
    pub(super) poorly_observable: Vec<ParamId>,
    /// Bars whose offset the lengths do not determine, so that a prior binds it.
    pub(super) undetermined_bars: Vec<ParamId>,
}

impl Choice {
    pub(super) fn of(search: &Search<'_>) -> Self {
        let Search { setting, base, set_up, implausible, .. } = search;
        let lengths = search.lengths.weighted(search.noise.sigma, &[]);
        match setting.options.prior {
            Prior::None if setting.options.follows_list() => Self::all(base),
            Prior::None => {
                let left = without(base, implausible);
                let poor = poorly_observable(&setting.priors, &set_up.model, &lengths, &left);
                let poor = [implausible.as_slice(), poor.as_slice()].concat();
                Self { poorly_observable: poor.clone(), ..Self::all(&without(base, &poor)) }
            }
            Prior::Datasheet | Prior::Given(_) | Prior::Posterior => Self::bound(search, &lengths),
        }
    }

    /// The whole base set, as the user's list is followed.
    fn all(base: &[ParamId]) -> Self {
        Self {
            kept: base.to_vec(),
            base: base.to_vec(),
            poorly_observable: vec![],
            undetermined_bars: vec![],
        }
    }

    /// All that a prior binds or the lengths determine.
    fn bound(search: &Search<'_>, lengths: &Weighted) -> Self {
        let Search { setting, base, analysis, set_up, .. } = search;
        let mut undetermined_bars = weak_bars(&setting.priors, base, &set_up.model, lengths);
        undetermined_bars.extend(analysis.dependent().into_iter().filter(is_bar));
        let sharing = prior::sharing(&setting.priors, &undetermined_bars, analysis);
        let mut kept = [base.as_slice(), sharing.as_slice()].concat();
        kept.sort();
        Self { kept, poorly_observable: search.open.clone(), undetermined_bars, ..Self::all(base) }
    }
}

fn without(ids: &[ParamId], out: &[ParamId]) -> Vec<ParamId> {
    ids.iter().copied().filter(|id| !out.contains(id)).collect()
}

pub(super) fn is_bar(id: &ParamId) -> bool {
    matches!(id, ParamId::BarOffset(_))
}

/// Whether a parameter says where a target, a base ball or the tracker is.
pub(crate) fn is_place(id: &ParamId) -> bool {
    id.is_setup() && !is_bar(id)
}

/// The parameters of `ids` that these lengths determine too weakly, weakest first: each is fixed before the next is
/// judged. Fixing one lowers the noise of the others, but its own error, of the size of its tolerance, then leaks into
/// them, and counts.
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
    let mut fix = |kept: &mut Vec<usize>, judged: fn(ParamId) -> bool, fixed: fn(ParamId) -> bool| loop {
        let sd = Partition { ids, data: &data, kept, fixed: &weak }.sd(priors);
        let ratios: Vec<(usize, f64)> =
            (0..kept.len()).filter_map(|k| Some((k, sd[k] / priors.weak_limit(ids[kept[k]])?))).collect();
        let enough = ratios.iter().all(|(k, ratio)| *ratio <= 1.0 || !judged(ids[kept[*k]]));
        let weakest =
            ratios.iter().filter(|(k, _)| fixed(ids[kept[*k]])).max_by(|(_, a), (_, b)| a.total_cmp(b));
        match weakest {
            Some((k, _)) if !enough => weak.push(kept.remove(*k)),
            _ => break,
        }
    };
    // Bars go first: on circles of one radius their offset is a scale of the robot by another name,
    // and a robot's length that were fixed in its stead would bend all the others.
    let bar = |id: ParamId| is_bar(&id);
    fix(&mut kept, bar, bar);
    fix(&mut kept, |_| true, |_| true);
    // What is optional must not cost a parameter that the data determine without it.
    if !optional.is_empty() {
        kept.extend(optional);
        fix(&mut kept, |_| true, ParamId::is_optional);
    }
    weak.into_iter().map(|at| ids[at]).collect()
}

/// The bars for whose offset the lengths alone are too weak. A prior on the robot must not decide it: on
/// circles of one radius it would turn the maker's tolerance into a length of the bar.
fn weak_bars(priors: &Priors, base: &[ParamId], model: &LengthModel, lengths: &Weighted) -> Vec<ParamId> {
    let bars = (0..base.len()).filter(|&at| is_bar(&base[at]));
    if bars.clone().next().is_none() {
        return vec![];
    }
    let sd = data_sd(model, lengths, base);
    let limit = |id| priors.weak_limit(id).unwrap_or(f64::INFINITY);
    bars.filter(|&bar| sd.as_ref().is_none_or(|sd| sd[bar] > limit(base[bar]))).map(|bar| base[bar]).collect()
}

/// The parameter whose correction is least plausible, if one is: the data determine it worse than its tolerance, and it is
/// further off than tolerance and data allow together. It carries what the model lacks, or what is fixed.
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

/// What is asked for without those places of tool, base balls and tracker that the lengths leave open, or determine only with
/// others, even of the nominal robot, as where the tool never turns: fitted alone they would run off together. The
/// balls go before the tool, which is known better beforehand.
pub(crate) fn without_open_places(
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

/// Which of these places lengths at the nominal robot leave open, worst first.
pub(super) fn open_places(
    priors: &Priors,
    model: &LengthModel,
    lengths: &Weighted,
    mut places: Vec<ParamId>,
) -> Vec<ParamId> {
    // The nominal robot fits no better than this.
    let lengths = lengths.by(Sigma::All(priors.nominal_fit_mm()));
    let mut open = Vec::new();
    while !places.is_empty() {
        let Some(sd) = data_sd(model, &lengths, &places) else { break };
        let ratio = |k: &usize| sd[*k] / open_limit(places[*k]);
        let Some(worst) = (0..places.len()).max_by(|a, b| ratio(a).total_cmp(&ratio(b))) else { break };
        if ratio(&worst) <= 1.0 {
            break;
        }
        open.push(places.remove(worst));
    }
    open
}
