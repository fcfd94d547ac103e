//! Covariance of the estimate, effective degrees of freedom, and what the data are too weak for.

use nalgebra::DMatrix;

use super::options::tolerance;
use super::solver::PriorRows;
use crate::identifiability::factor;
use crate::model::{LengthModel, ParamId, Reading, Robot};

/// A parameter counts as identified when its standard deviation is at most this many tolerances.
pub(super) const WEAK: f64 = 3.0;

/// Covariance of the estimated parameters for unit weight, and how many of them the data determine.
pub(super) struct Spread {
    /// With the prior, where there is one.
    pub(super) covariance: DMatrix<f64>,
    /// From the data alone; the same without a prior.
    pub(super) data_sd: Vec<f64>,
    /// Trace of the part of the estimate that comes from the data.
    pub(super) parameters: f64,
}

/// The spread of `ids` at a model; `None` when they are not determined.
pub(super) fn spread(
    model: &LengthModel,
    readings: &[Reading],
    ids: &[ParamId],
    sigma: &[f64],
    prior: Option<&PriorRows>,
) -> Option<Spread> {
    let data = factor(model, readings, ids, sigma);
    let inverse = |rows: &DMatrix<f64>| -> Option<DMatrix<f64>> {
        let norms: Vec<f64> = rows.column_iter().map(|column| column.norm()).collect();
        let mut unit = rows.clone();
        unit.column_iter_mut().zip(&norms).for_each(|(mut column, norm)| column /= *norm);
        let mut inverse = unit.qr().r().try_inverse()?;
        inverse.row_iter_mut().zip(&norms).for_each(|(mut row, norm)| row /= *norm);
        inverse.iter().all(|x| x.is_finite()).then_some(inverse)
    };
    let sd_of = |inverse: &DMatrix<f64>| inverse.row_iter().map(|row| row.norm()).collect::<Vec<f64>>();
    let Some(prior) = prior else {
        let inverse = inverse(&data)?;
        return Some(Spread {
            covariance: &inverse * inverse.transpose(),
            data_sd: sd_of(&inverse),
            parameters: ids.len() as f64,
        });
    };
    let mut stacked = DMatrix::zeros(data.nrows() + prior.rows.nrows(), ids.len());
    stacked.rows_mut(0, data.nrows()).copy_from(&data);
    stacked.rows_mut(data.nrows(), prior.rows.nrows()).copy_from(&prior.rows);
    let both = inverse(&stacked)?;
    // What the prior alone determines is infinitely uncertain from the data.
    let data_sd = inverse(&data).map_or_else(|| vec![f64::INFINITY; ids.len()], |inverse| sd_of(&inverse));
    Some(Spread { parameters: (data * &both).norm_squared(), covariance: &both * both.transpose(), data_sd })
}

/// The parameters of `ids` for which lengths of these sigmas are too weak, weakest first: each is
/// held before the next is judged, because holding one strengthens the others.
pub(super) fn too_weak(
    robot: &Robot,
    model: &LengthModel,
    readings: &[Reading],
    ids: &[ParamId],
    sigma: &[f64],
) -> Vec<ParamId> {
    let mut kept = ids.to_vec();
    let mut weak = Vec::new();
    while !kept.is_empty() {
        let sd = match spread(model, readings, &kept, sigma, None) {
            Some(spread) => spread.data_sd,
            None => vec![f64::INFINITY; kept.len()],
        };
        let weakest = (0..kept.len())
            .filter_map(|k| Some((k, sd[k] / tolerance(robot, kept[k])?)))
            .max_by(|(_, a), (_, b)| a.total_cmp(b));
        match weakest {
            Some((k, ratio)) if ratio > WEAK => weak.push(kept.remove(k)),
            _ => break,
        }
    }
    weak
}
