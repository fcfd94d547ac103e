//! The prior as equations beside the lengths: every parameter of the robot about its nominal value by its tolerance, a bar
//! that the lengths do not determine by its certificate; of a robot that was identified before, what this left unknown.
//!
//! With them nothing need be fixed because it is poorly observable. A correction of which only a sum is identifiable is
//! shared among the members in proportion to their variances, which is the likeliest robot. The set-up has no tolerance
//! and stays free: what depends on it alone learns nothing, and stays at its start.

use nalgebra::{DMatrix, DVector};

use super::Analysis;
use super::priors::{Prior, Priors};
use super::setting::Setting;
use crate::measurement::LengthModel;
use crate::robot::ParamId;

/// Equations `rows * (p - mean) = 0` of unit variance about the parameters estimated.
#[derive(Clone, Debug)]
pub(super) struct PriorRows {
    /// The places of the parameters that are bound.
    bound: Vec<usize>,
    /// The root of their covariance.
    root: DMatrix<f64>,
    /// Its inverse, with a column for each parameter estimated.
    rows: DMatrix<f64>,
    mean: DVector<f64>,
}

impl PriorRows {
    /// Of independent parameters with these standard deviations about `mean`; `None` of what is free.
    pub(super) fn independent(sds: &[Option<f64>], mean: &[f64]) -> Self {
        let bound: Vec<usize> = (0..sds.len()).filter(|&k| sds[k].is_some()).collect();
        let of: Vec<f64> = sds.iter().copied().flatten().collect();
        Self {
            root: DMatrix::from_diagonal(&DVector::from_column_slice(&of)),
            rows: DMatrix::from_fn(
                bound.len(),
                sds.len(),
                |i, k| if bound[i] == k { of[i].recip() } else { 0.0 },
            ),
            mean: DVector::from_column_slice(mean),
            bound,
        }
    }

    /// How many parameters are bound.
    pub(super) fn count(&self) -> usize {
        self.bound.len()
    }

    /// Standard deviation of a parameter by its place; `None` of what is free.
    pub(super) fn sd(&self, place: usize) -> Option<f64> {
        let at = self.bound.iter().position(|bound| *bound == place)?;
        Some(self.root.row(at).norm())
    }

    /// The equations' coefficients, a row each.
    pub(super) fn matrix(&self) -> &DMatrix<f64> {
        &self.rows
    }

    /// What the values of `ids` in a model leave of the equations: deviates of unit variance.
    pub(super) fn deviates(&self, model: &LengthModel, ids: &[ParamId]) -> DVector<f64> {
        &self.rows * (values(model, ids) - &self.mean)
    }

    /// The same about a draw around a model.
    pub(super) fn drawn(
        &self,
        model: &LengthModel,
        ids: &[ParamId],
        mut normal: impl FnMut() -> f64,
    ) -> Self {
        let mut mean = values(model, ids);
        let drawn = &self.root * DVector::from_fn(self.count(), |_, _| normal());
        self.bound.iter().zip(&drawn).for_each(|(place, step)| mean[*place] += step);
        Self { mean, ..self.clone() }
    }
}

fn values(model: &LengthModel, ids: &[ParamId]) -> DVector<f64> {
    DVector::from_fn(ids.len(), |k, _| model.value(ids[k]))
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
    let sd = |place: usize| Some((place, setting.priors.bound(kept[place], undetermined_bars)?));
    let (bound, sd): (Vec<usize>, Vec<f64>) = (0..kept.len()).filter_map(sd).unzip();
    let ids: Vec<ParamId> = bound.iter().map(|place| kept[*place]).collect();
    let root = setting.priors.root(&ids, &sd);
    let inverse = root.solve_lower_triangular(&DMatrix::identity(ids.len(), ids.len()))?;
    let mut rows = DMatrix::zeros(ids.len(), kept.len());
    bound.iter().enumerate().for_each(|(at, place)| rows.set_column(*place, &inverse.column(at)));
    Some(PriorRows { bound, root, rows, mean: values(setting.start, kept) })
}

/// The parameters that the lengths do not determine by themselves and that share, by the prior, what they determine of a
/// sum, or whose errors an earlier identification left correlated with those of others.
pub(super) fn sharing(priors: &Priors, undetermined_bars: &[ParamId], analysis: &Analysis) -> Vec<ParamId> {
    let bound = |id: ParamId| priors.bound(id, undetermined_bars).is_some();
    let mut sharing: Vec<ParamId> = analysis
        .combinations()
        .into_iter()
        .filter(|combination| bound(combination.kept))
        .flat_map(|combination| combination.members.into_iter().skip(1).map(|(id, _)| id))
        .filter(|id| bound(*id))
        .collect();
    let others = analysis.dependent().into_iter().chain(analysis.zero());
    sharing.extend(others.filter(|id| priors.is_of_posterior(*id)));
    sharing.sort();
    sharing.dedup();
    sharing
}
