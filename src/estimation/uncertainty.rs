//! What an estimate leaves unknown: its posterior, the standard deviations by the data alone, and what errors of fixed
//! parameters add.

use nalgebra::DMatrix;

use super::lengths::Weighted;
use super::linear_system::factor;
use super::posterior::{Posterior, inverse_root};
use super::prior::PriorRows;
use super::priors::Priors;
use crate::measurement::LengthModel;
use crate::robot::ParamId;

/// What an estimate leaves unknown.
#[derive(Clone, Debug)]
pub(super) struct Uncertainty {
    /// With the prior, where there is one.
    pub(super) posterior: Posterior,
    /// From the data alone, infinite for what they do not determine; the same without a prior.
    pub(super) data_sd: Vec<f64>,
    /// The effective number of parameters that the data determine: the trace of their part of the estimate.
    pub(super) effective_parameters: f64,
}

/// The standard deviations of `ids` by the data alone; `None` when they are not determined.
pub(super) fn data_sd(model: &LengthModel, lengths: &Weighted, ids: &[ParamId]) -> Option<Vec<f64>> {
    Some(inverse_root(&factor(model, lengths, ids))?.row_iter().map(|row| row.norm()).collect())
}

/// The uncertainty of `ids` at a model, of which the data alone determine at most `base`; `None` when they are not
/// determined.
pub(super) fn uncertainty(
    model: &LengthModel,
    lengths: &Weighted,
    ids: &[ParamId],
    base: &[ParamId],
    prior: Option<&PriorRows>,
) -> Option<Uncertainty> {
    let data = factor(model, lengths, ids);
    let norms = |inverse: &DMatrix<f64>| inverse.row_iter().map(|row| row.norm()).collect::<Vec<f64>>();
    let posterior = |root| Posterior::with_root(model.clone(), ids, root);
    let Some(prior) = prior else {
        let root = inverse_root(&data)?;
        let effective_parameters = ids.len() as f64;
        return Some(Uncertainty { data_sd: norms(&root), posterior: posterior(root), effective_parameters });
    };
    let mut stacked = DMatrix::zeros(data.nrows() + prior.count(), ids.len());
    stacked.rows_mut(0, data.nrows()).copy_from(&data);
    stacked.rows_mut(data.nrows(), prior.count()).copy_from(prior.matrix());
    let both = inverse_root(&stacked)?;
    let mut data_sd = vec![f64::INFINITY; ids.len()];
    let determined: Vec<usize> = (0..ids.len()).filter(|&k| base.contains(&ids[k])).collect();
    if let Some(inverse) = inverse_root(&data.select_columns(&determined)) {
        determined.iter().zip(norms(&inverse)).for_each(|(k, sd)| data_sd[*k] = sd);
    }
    let effective_parameters = (data * &both).norm_squared();
    Some(Uncertainty { posterior: posterior(both), data_sd, effective_parameters })
}

/// A whitened Jacobian of which some columns are estimated and others fixed.
pub(super) struct Partition<'a> {
    pub(super) ids: &'a [ParamId],
    pub(super) data: &'a DMatrix<f64>,
    pub(super) kept: &'a [usize],
    pub(super) fixed: &'a [usize],
}

impl Partition<'_> {
    /// One standard deviation of each kept parameter: noise, and the tolerances of those fixed.
    pub(super) fn sd(&self, priors: &Priors) -> Vec<f64> {
        let Some(noise) = inverse_root(&self.data.select_columns(self.kept)) else {
            return vec![f64::INFINITY; self.kept.len()];
        };
        let leaks = self.leaks(priors, &noise);
        let variance = |k: usize| noise.row(k).norm_squared() + leaks.row(k).norm_squared();
        (0..self.kept.len()).map(|k| variance(k).sqrt()).collect()
    }

    /// What one tolerance of each fixed parameter does to the kept ones, kept by fixed: least squares answers to an error
    /// e of the fixed column h with (K'K)^-1 K'h e.
    fn leaks(&self, priors: &Priors, noise: &DMatrix<f64>) -> DMatrix<f64> {
        let kept = self.data.select_columns(self.kept);
        let mut leaks = noise * noise.transpose() * kept.transpose() * self.data.select_columns(self.fixed);
        for (mut column, h) in leaks.column_iter_mut().zip(self.fixed) {
            column *= priors.fixed_sd(self.ids[*h]);
        }
        leaks
    }
}

/// What one tolerance of each `fixed` parameter, which is poorly observable, does to the `kept` ones, a column each.
pub(super) fn leaks(
    priors: &Priors,
    model: &LengthModel,
    lengths: &Weighted,
    kept: &[ParamId],
    fixed: &[ParamId],
) -> Option<DMatrix<f64>> {
    let ids = [kept, fixed].concat();
    let data = factor(model, lengths, &ids);
    let (kept, fixed): (Vec<usize>, Vec<usize>) = (0..ids.len()).partition(|at| *at < kept.len());
    let noise = inverse_root(&data.select_columns(&kept))?;
    Some(Partition { ids: &ids, data: &data, kept: &kept, fixed: &fixed }.leaks(priors, &noise))
}
