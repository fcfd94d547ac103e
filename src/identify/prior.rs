//! The prior on the base parameters, carried over from that on all of them.
//!
//! A kept parameter stands for its combination c = p + X q with the dependent ones q. When the
//! robot's parameters are independent with variances S about the nominal, c has the covariance
//! S_p + X S_q X'. The set-up has no tolerance: it stays free, and what leans on it alone adds nothing.

use nalgebra::{DMatrix, DVector};

use super::options::{Options, Prior};
use super::solver::PriorRows;
use crate::identifiability::Analysis;
use crate::model::{LengthModel, ParamId, Robot};

/// Prior rows for the parameters `kept` of the analysis; `None` without a prior.
pub(super) fn rows(
    robot: &Robot,
    options: &Options,
    analysis: &Analysis,
    kept: &[ParamId],
    nominal: &LengthModel,
) -> Option<PriorRows> {
    if options.prior == Prior::None {
        return None;
    }
    let bound: Vec<usize> = (0..kept.len()).filter(|&k| options.prior_sd(robot, kept[k]).is_some()).collect();
    let mut covariance = DMatrix::zeros(bound.len(), bound.len());
    for (place, &k) in bound.iter().enumerate() {
        covariance[(place, place)] = options.prior_sd(robot, kept[k]).map_or(0.0, |sd| sd * sd);
    }
    for (column, coefficients) in &analysis.base.dependent {
        let Some(sd) = options.prior_sd(robot, analysis.ids[*column]) else { continue };
        let lean = DVector::from_fn(bound.len(), |place, _| {
            let id = kept[bound[place]];
            let at = analysis.base.kept.iter().position(|&k| analysis.ids[k] == id);
            at.map_or(0.0, |at| coefficients[at])
        });
        covariance += &lean * lean.transpose() * (sd * sd);
    }
    // Unit diagonal before the factorisation: mm and rad differ by orders of magnitude.
    let sd = DVector::from_fn(bound.len(), |k, _| covariance[(k, k)].sqrt());
    let scaled = DMatrix::from_fn(bound.len(), bound.len(), |i, j| covariance[(i, j)] / (sd[i] * sd[j]));
    let inverse = scaled.cholesky()?.l().try_inverse()?;
    let mut rows = DMatrix::zeros(bound.len(), kept.len());
    for (place, &k) in bound.iter().enumerate() {
        for equation in 0..bound.len() {
            rows[(equation, k)] = inverse[(equation, place)] / sd[place];
        }
    }
    Some(PriorRows { rows, mean: DVector::from_fn(kept.len(), |k, _| nominal.value(kept[k])) })
}
