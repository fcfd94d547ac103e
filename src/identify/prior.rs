//! What is known beforehand as equations beside the lengths: every parameter of the robot about its nominal value
//! by its tolerance, a bar that the lengths do not tell by its certificate.
//!
//! With them nothing need be held because the lengths do not tell it. A correction of which only a sum can be
//! told is shared among the members in proportion to their variances, which is the likeliest robot. The set-up has
//! no tolerance and stays free: what leans on it alone learns nothing, and stays at its start.

use nalgebra::{DMatrix, DVector};

use super::options::{Options, Prior};
use crate::identifiability::Analysis;
use crate::model::{LengthModel, ParamId, Robot};

/// A bar without certificate is known to this, one standard deviation in mm.
const BAR_MM: f64 = 0.05;

/// Equations `weight * (p - mean) = 0` of unit variance, one for each parameter estimated.
#[derive(Clone, Debug)]
pub(super) struct PriorRows {
    /// 1 / standard deviation; 0 of what is free.
    pub(super) weights: DVector<f64>,
    pub(super) mean: DVector<f64>,
}

impl PriorRows {
    /// The parameters that are bound, by their places.
    pub(super) fn bound(&self) -> impl Iterator<Item = usize> {
        (0..self.weights.len()).filter(|&k| self.weights[k] > 0.0)
    }

    /// Standard deviation of a parameter by its place; `None` of what is free.
    pub(super) fn sd(&self, place: usize) -> Option<f64> {
        Some(self.weights[place].recip()).filter(|sd| sd.is_finite())
    }

    /// The weights as a matrix of rows.
    pub(super) fn matrix(&self) -> DMatrix<f64> {
        DMatrix::from_diagonal(&self.weights)
    }
}

/// One standard deviation of a parameter before the lengths, `None` of what is free. A bar that the lengths tell
/// is free where it has no certificate: the offset of one that nobody calibrated may be anything.
fn known(robot: &Robot, options: &Options, untold_bars: &[ParamId], id: ParamId) -> Option<f64> {
    options.prior_sd(robot, id).or_else(|| untold_bars.contains(&id).then_some(BAR_MM))
}

/// Prior rows for the parameters `kept`, about the values at `start`; `None` without a prior.
pub(super) fn rows(
    robot: &Robot,
    options: &Options,
    untold_bars: &[ParamId],
    kept: &[ParamId],
    start: &LengthModel,
) -> Option<PriorRows> {
    if options.prior == Prior::None {
        return None;
    }
    let weight = |k: usize| known(robot, options, untold_bars, kept[k]).map_or(0.0, f64::recip);
    Some(PriorRows {
        weights: DVector::from_fn(kept.len(), |k, _| weight(k)),
        mean: DVector::from_fn(kept.len(), |k, _| start.value(kept[k])),
    })
}

/// The parameters that the lengths do not tell by themselves and that share, by the prior, what they tell of a sum.
pub(super) fn sharing(
    robot: &Robot,
    options: &Options,
    untold_bars: &[ParamId],
    analysis: &Analysis,
) -> Vec<ParamId> {
    let bound = |id: ParamId| known(robot, options, untold_bars, id).is_some();
    let mut sharing: Vec<ParamId> = analysis
        .combinations()
        .into_iter()
        .filter(|combination| bound(combination.kept))
        .flat_map(|combination| combination.members.into_iter().skip(1).map(|(id, _)| id))
        .filter(|id| bound(*id))
        .collect();
    sharing.sort();
    sharing.dedup();
    sharing
}
