//! The coordinates of the set-up that the poses do not determine.

use super::inverse_root;
use super::lengths::{Sigma, Weighted};
use super::linear_system::factor;
use super::priors::Priors;
use crate::math::base_set;
use crate::measurement::LengthModel;
use crate::robot::ParamId;

pub(super) fn is_bar(id: &ParamId) -> bool {
    matches!(id, ParamId::BarOffset(_))
}

/// Whether a parameter belongs to the position of a target, of a base ball or of the tracker.
pub fn is_place(id: &ParamId) -> bool {
    id.is_setup() && !is_bar(id)
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
    if places.is_empty() {
        return Some(asked.to_vec());
    }
    places.sort_by_key(|id| matches!(id, ParamId::Tool(_)));
    let order: Vec<usize> = (0..places.len()).collect();
    let set = base_set(&factor(start, &lengths.by(Sigma::All(1.0)), &places), &order)?;
    let determined: Vec<ParamId> = set.kept.iter().map(|&k| places[k]).collect();
    let open = open_places(priors, start, lengths, determined.clone());
    let free = |id: &ParamId| !is_judged(id) || determined.contains(id) && !open.contains(id);
    Some(asked.iter().copied().filter(free).collect())
}

/// The places among these that the lengths do not determine for the nominal robot, worst first.
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

/// The standard deviations of `ids` by the data alone; `None` if they are not determined.
pub(super) fn data_sd(model: &LengthModel, lengths: &Weighted, ids: &[ParamId]) -> Option<Vec<f64>> {
    let root = inverse_root(&factor(model, lengths, ids))?;
    Some(root.row_iter().map(|row| row.norm()).collect())
}
