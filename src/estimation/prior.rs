//! The prior as equations beside the lengths: every parameter of the robot about its nominal value by its tolerance, a bar
//! that the lengths do not determine by its certificate.
//!
//! With them nothing need be fixed because it is poorly observable. A correction of which only a sum is identifiable is
//! shared among the members in proportion to their variances, which is the likeliest robot. The set-up has no tolerance
//! and stays free: what depends on it alone learns nothing, and stays at its start.

use nalgebra::{DMatrix, DVector};

use super::Analysis;
use super::priors::{Prior, Priors};
use super::setting::Setting;
use crate::robot::ParamId;

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

/// Prior rows for the parameters `kept`, about the values at the start; `None` without a prior.
pub(super) fn rows(
    setting: &Setting<'_>,
    undetermined_bars: &[ParamId],
    kept: &[ParamId],
) -> Option<PriorRows> {
    if setting.options.prior == Prior::None {
        return None;
    }
    let weight = |k: usize| setting.priors.bound(kept[k], undetermined_bars).map_or(0.0, f64::recip);
    Some(PriorRows {
        weights: DVector::from_fn(kept.len(), |k, _| weight(k)),
        mean: DVector::from_fn(kept.len(), |k, _| setting.start.value(kept[k])),
    })
}

/// The parameters that the lengths do not determine by themselves and that share, by the prior, what they determine of a sum.
pub(super) fn sharing(priors: &Priors, undetermined_bars: &[ParamId], analysis: &Analysis) -> Vec<ParamId> {
    let bound = |id: ParamId| priors.bound(id, undetermined_bars).is_some();
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
