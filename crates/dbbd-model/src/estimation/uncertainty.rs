//! The uncertainty of an estimate: its posterior, the standard deviations by the data alone, and the effect of errors of
//! fixed parameters.

use nalgebra::DMatrix;

use super::estimate::Estimate;
use super::joint_fit::JointFit;
use super::lengths::Weighted;
use super::linear_system::factor;
use super::options::Setting;
use super::posterior::{Posterior, inverse_root};
use super::priors::Priors;
use crate::math::stacked;
use crate::measurement::LengthModel;
use crate::robot::ParamId;

#[derive(Clone, Debug)]
pub(super) struct Uncertainty {
    /// Of the estimated parameters, with the prior if there is one.
    pub(super) posterior: Posterior,
    /// Standard deviations by the data alone; infinite for parameters that they do not determine.
    pub(super) data_sd: Vec<f64>,
    /// The effective number of parameters that the data determine: the trace of the resolution matrix.
    pub(super) effective_parameters: f64,
}

impl Uncertainty {
    /// `None` if the estimate is not determined.
    pub(super) fn of(setting: &Setting<'_>, estimate: &Estimate, used: &Weighted) -> Option<Self> {
        let Estimate { kept, base, poorly_observable, .. } = estimate;
        let model = &estimate.fit.model;
        let data = factor(model, used, kept);
        let Some(prior) = &estimate.prior else {
            let root = inverse_root(&data)?;
            let data_sd = row_norms(&root);
            let mut posterior = Posterior::with_root(model.clone(), kept, root);
            if !poorly_observable.is_empty() {
                // No prior binds these; their errors leak into the estimate.
                let ids = [kept.as_slice(), poorly_observable].concat();
                let data = factor(model, used, &ids);
                let (kept, fixed): (Vec<usize>, Vec<usize>) = (0..ids.len()).partition(|at| *at < kept.len());
                let noise = inverse_root(&data.select_columns(&kept))?;
                let partition = Partition { ids: &ids, data: &data, kept: &kept, fixed: &fixed };
                posterior = posterior.widened(&partition.leaks(&setting.priors, &noise));
            }
            return Some(Self { data_sd, posterior, effective_parameters: kept.len() as f64 });
        };
        let root = inverse_root(&stacked(&data, prior.matrix()))?;
        let mut data_sd = vec![f64::INFINITY; kept.len()];
        let determined: Vec<usize> = (0..kept.len()).filter(|&k| base.contains(&kept[k])).collect();
        if let Some(inverse) = inverse_root(&data.select_columns(&determined)) {
            determined.iter().zip(row_norms(&inverse)).for_each(|(k, sd)| data_sd[*k] = sd);
        }
        let (root, effective_parameters) = match &estimate.joints {
            Some(JointFit { root, effective_parameters, .. }) => {
                (root.rows(0, kept.len()).into_owned(), *effective_parameters)
            }
            None => {
                let effective_parameters = (data * &root).norm_squared();
                (root, effective_parameters)
            }
        };
        let posterior = Posterior::with_root(model.clone(), kept, root);
        Some(Self { posterior, data_sd, effective_parameters })
    }
}

fn row_norms(matrix: &DMatrix<f64>) -> Vec<f64> {
    matrix.row_iter().map(|row| row.norm()).collect()
}

/// The standard deviations of `ids` by the data alone; `None` if they are not determined.
pub(super) fn data_sd(model: &LengthModel, lengths: &Weighted, ids: &[ParamId]) -> Option<Vec<f64>> {
    inverse_root(&factor(model, lengths, ids)).map(|root| row_norms(&root))
}

/// A whitened Jacobian of which some columns are estimated and others fixed.
pub(super) struct Partition<'a> {
    pub(super) ids: &'a [ParamId],
    pub(super) data: &'a DMatrix<f64>,
    pub(super) kept: &'a [usize],
    pub(super) fixed: &'a [usize],
}

impl Partition<'_> {
    /// The standard deviation of each kept parameter by the noise and by the tolerances of the fixed ones.
    pub(super) fn sd(&self, priors: &Priors) -> Vec<f64> {
        let Some(noise) = inverse_root(&self.data.select_columns(self.kept)) else {
            return vec![f64::INFINITY; self.kept.len()];
        };
        let leaks = self.leaks(priors, &noise);
        let variance = |k: usize| noise.row(k).norm_squared() + leaks.row(k).norm_squared();
        (0..self.kept.len()).map(|k| variance(k).sqrt()).collect()
    }

    /// The effect of one standard deviation of each fixed parameter on the kept ones, kept by fixed. Least squares responds
    /// to an error e of the fixed column h with (K'K)^-1 K'h e. `noise` is a root of (K'K)^-1.
    fn leaks(&self, priors: &Priors, noise: &DMatrix<f64>) -> DMatrix<f64> {
        let kept = self.data.select_columns(self.kept);
        let mut leaks = noise * noise.transpose() * kept.transpose() * self.data.select_columns(self.fixed);
        for (mut column, h) in leaks.column_iter_mut().zip(self.fixed) {
            column *= priors.fixed_sd(self.ids[*h]);
        }
        leaks
    }
}
