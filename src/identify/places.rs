//! Places of the tool ball and the base balls that poses hardly tell, as where the tool never turns.

use super::covariance::spread;
use super::lengths::{Sigma, Weighted};
use crate::identifiability::factor;
use crate::linalg::base_set;
use crate::model::{LengthModel, ParamId, Robot};

/// A coordinate of the tool ball or of a base ball that is told worse than this is better known from a ruler, mm.
pub(super) fn open_mm(id: ParamId) -> f64 {
    if matches!(id, ParamId::Tool(_)) { 50.0 } else { 500.0 }
}

/// Whether a parameter is a coordinate of the tool ball or of a base ball.
pub(super) fn is_place(id: &ParamId) -> bool {
    matches!(id, ParamId::Tool(_) | ParamId::Centre(..))
}

/// What is asked for without those places of tool and base balls that the lengths hardly tell, or tell only with
/// others, even of the nominal robot, as where the tool never turns: fitted alone they would run off together. The
/// balls go before the tool, which is known better beforehand.
pub(super) fn well_told(
    robot: &Robot,
    start: &LengthModel,
    lengths: &Weighted,
    asked: &[ParamId],
) -> Option<Vec<ParamId>> {
    let mut places: Vec<ParamId> = asked.iter().copied().filter(is_place).collect();
    places.sort_by_key(|id| matches!(id, ParamId::Tool(_)));
    let order: Vec<usize> = (0..places.len()).collect();
    let set = base_set(&factor(start, &lengths.by(Sigma::All(1.0)), &places), &order)?;
    let told: Vec<ParamId> = set.kept.iter().map(|&k| places[k]).collect();
    let hardly = hardly_told(robot, start, lengths, told.clone());
    let free = |id: &ParamId| !is_place(id) || told.contains(id) && !hardly.contains(id);
    Some(asked.iter().copied().filter(free).collect())
}

/// Which of these places lengths at the nominal robot tell worse than a ruler would, worst first.
pub(super) fn hardly_told(
    robot: &Robot,
    model: &LengthModel,
    lengths: &Weighted,
    mut places: Vec<ParamId>,
) -> Vec<ParamId> {
    // The nominal robot fits no better than this.
    let lengths = lengths.by(Sigma::All(robot.tolerance.length_mm));
    let mut hardly = Vec::new();
    while !places.is_empty() {
        let Some(spread) = spread(model, &lengths, &places, &places, None) else { break };
        let ratio = |k: &usize| spread.data_sd[*k] / open_mm(places[*k]);
        let Some(worst) = (0..places.len()).max_by(|a, b| ratio(a).total_cmp(&ratio(b))) else { break };
        if ratio(&worst) <= 1.0 {
            break;
        }
        hardly.push(places.remove(worst));
    }
    hardly
}
