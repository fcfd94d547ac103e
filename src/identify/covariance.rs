//! Covariance of the estimate, effective degrees of freedom, and what the data are too weak for.

use nalgebra::DMatrix;

use super::lengths::Weighted;
use super::options::Tolerances;
use super::prior::PriorRows;
use crate::identifiability::factor;
use crate::model::{LengthModel, ParamId};

/// Covariance of the estimated parameters for unit weight, and how many of them the data determine.
pub(super) struct Spread {
    /// With the prior, where there is one.
    pub(super) covariance: DMatrix<f64>,
    /// From the data alone, infinite for what they do not tell; the same without a prior.
    pub(super) data_sd: Vec<f64>,
    /// Trace of the part of the estimate that comes from the data.
    pub(super) parameters: f64,
}

/// The spread of `ids` at a model, of which the data alone tell at most `base`; `None` when they are not determined.
pub(super) fn spread(
    model: &LengthModel,
    lengths: &Weighted,
    ids: &[ParamId],
    base: &[ParamId],
    prior: Option<&PriorRows>,
) -> Option<Spread> {
    let data = factor(model, lengths, ids);
    let sd_of = |inverse: &DMatrix<f64>| inverse.row_iter().map(|row| row.norm()).collect::<Vec<f64>>();
    let Some(prior) = prior else {
        let inverse = inverse_root(&data)?;
        return Some(Spread {
            covariance: &inverse * inverse.transpose(),
            data_sd: sd_of(&inverse),
            parameters: ids.len() as f64,
        });
    };
    let mut stacked = DMatrix::zeros(data.nrows() + ids.len(), ids.len());
    stacked.rows_mut(0, data.nrows()).copy_from(&data);
    stacked.rows_mut(data.nrows(), ids.len()).copy_from(&prior.matrix());
    let both = inverse_root(&stacked)?;
    let mut data_sd = vec![f64::INFINITY; ids.len()];
    let told: Vec<usize> = (0..ids.len()).filter(|&k| base.contains(&ids[k])).collect();
    if let Some(inverse) = inverse_root(&data.select_columns(&told)) {
        told.iter().zip(sd_of(&inverse)).for_each(|(k, sd)| data_sd[*k] = sd);
    }
    Some(Spread { parameters: (data * &both).norm_squared(), covariance: &both * both.transpose(), data_sd })
}

/// The parameters of `ids` for which these lengths are too weak, weakest first: each is
/// held before the next is judged. Holding one lowers the noise of the others, but its own error,
/// of the size of its tolerance, then leaks into them, and counts.
pub(super) fn too_weak(
    tolerances: Tolerances,
    model: &LengthModel,
    lengths: &Weighted,
    ids: &[ParamId],
) -> Vec<ParamId> {
    let data = factor(model, lengths, ids);
    let (optional, mut kept): (Vec<usize>, Vec<usize>) =
        (0..ids.len()).partition(|&at| ids[at].is_optional());
    let mut weak: Vec<usize> = Vec::new();
    let mut hold = |kept: &mut Vec<usize>, judged: fn(ParamId) -> bool, held: fn(ParamId) -> bool| loop {
        let uncertain = uncertainty(tolerances, &data, ids, kept, &weak);
        let ratios: Vec<(usize, f64)> = (0..kept.len())
            .filter_map(|k| Some((k, uncertain[k] / tolerances.weak_limit(ids[kept[k]])?)))
            .collect();
        let enough = ratios.iter().all(|(k, ratio)| *ratio <= 1.0 || !judged(ids[kept[*k]]));
        let weakest =
            ratios.iter().filter(|(k, _)| held(ids[kept[*k]])).max_by(|(_, a), (_, b)| a.total_cmp(b));
        match weakest {
            Some((k, _)) if !enough => weak.push(kept.remove(*k)),
            _ => break,
        }
    };
    // Bars go first: on circles of one radius their offset is a scale of the robot by another name,
    // and a robot's length that were held in its stead would bend all the others.
    let bar = |id: ParamId| matches!(id, ParamId::BarOffset(_));
    hold(&mut kept, bar, bar);
    hold(&mut kept, |_| true, |_| true);
    // What is optional must not cost a parameter that the data tell without it.
    if !optional.is_empty() {
        kept.extend(optional);
        hold(&mut kept, |_| true, ParamId::is_optional);
    }
    weak.into_iter().map(|at| ids[at]).collect()
}

/// One standard deviation of each kept parameter: noise, and the tolerances of those held.
fn uncertainty(
    tolerances: Tolerances,
    data: &DMatrix<f64>,
    ids: &[ParamId],
    kept: &[usize],
    held: &[usize],
) -> Vec<f64> {
    let Some(noise) = inverse_root(&data.select_columns(kept)) else {
        return vec![f64::INFINITY; kept.len()];
    };
    let leak = leak(tolerances, data, ids, kept, held, &noise);
    (0..kept.len()).map(|k| (noise.row(k).norm_squared() + leak.row(k).norm_squared()).sqrt()).collect()
}

/// What one tolerance of each held parameter does to the kept ones, kept by held: least squares
/// answers to an error e of the held column h with (K'K)^-1 K'h e.
fn leak(
    tolerances: Tolerances,
    data: &DMatrix<f64>,
    ids: &[ParamId],
    kept: &[usize],
    held: &[usize],
    noise: &DMatrix<f64>,
) -> DMatrix<f64> {
    let mut leak =
        noise * noise.transpose() * data.select_columns(kept).transpose() * data.select_columns(held);
    for (mut column, h) in leak.column_iter_mut().zip(held) {
        column *= tolerances.held(ids[*h]);
    }
    leak
}

/// Covariance that the `held` parameters, which the data were too weak for, add to that of `kept`.
pub(super) fn leaked(
    tolerances: Tolerances,
    model: &LengthModel,
    lengths: &Weighted,
    kept: &[ParamId],
    held: &[ParamId],
) -> Option<DMatrix<f64>> {
    let ids = [kept, held].concat();
    let data = factor(model, lengths, &ids);
    let kept: Vec<usize> = (0..kept.len()).collect();
    let held: Vec<usize> = (kept.len()..ids.len()).collect();
    let noise = inverse_root(&data.select_columns(&kept))?;
    let leak = leak(tolerances, &data, &ids, &kept, &held, &noise);
    Some(&leak * leak.transpose())
}

/// A root of the inverse Gram matrix of the rows, unknowns by rows; `None` when it has none.
fn inverse_root(rows: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    // Unit columns first: mm and rad differ by orders of magnitude.
    let norms: Vec<f64> = rows.column_iter().map(|column| column.norm()).collect();
    let mut unit = rows.clone();
    unit.column_iter_mut().zip(&norms).for_each(|(mut column, norm)| column /= *norm);
    let mut inverse = unit.qr().r().try_inverse()?;
    inverse.row_iter_mut().zip(&norms).for_each(|(mut row, norm)| row /= *norm);
    inverse.iter().all(|x| x.is_finite()).then_some(inverse)
}

/// Whether chi-square per degree of freedom is larger, or smaller, than chance allows once in a
/// thousand (Wilson and Hilferty's normal approximation, PNAS 17, 1931).
pub(super) fn beyond_chance(ratio: f64, freedom: f64) -> Option<std::cmp::Ordering> {
    let spread = (2.0 / (9.0 * freedom)).sqrt();
    let bound = |z: f64| (1.0 - spread * spread + z * spread).powi(3);
    if ratio > bound(3.09) {
        Some(std::cmp::Ordering::Greater)
    } else if ratio < bound(-3.09) {
        Some(std::cmp::Ordering::Less)
    } else {
        None
    }
}
