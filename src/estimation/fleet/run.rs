//! What the lengths of a run alone say, in information form: its posterior without the prior that it was identified with.

use nalgebra::{DMatrix, DVector};

use super::kind::Kind;
use super::{RunPosterior, inverse};
use crate::robot::ParamId;

/// Directions whose variance the lengths change by less than this share say nothing.
const LEAST_SHARE: f64 = 1e-9;

/// What the lengths of a run alone say of the parameters of its kind (scaled) and of the bar: the last column.
pub(super) fn information(run: &RunPosterior, kind: &Kind) -> Option<(DMatrix<f64>, DVector<f64>)> {
    let count = kind.ids.len();
    let bar = run.ids.iter().position(|id| matches!(id, ParamId::BarOffset(_)));
    let places: Vec<Option<usize>> = run
        .ids
        .iter()
        .map(|id| {
            kind.ids
                .iter()
                .position(|own| own == id)
                .or((matches!(id, ParamId::BarOffset(_))).then_some(count))
        })
        .collect();
    let scale = |at: usize| places[at].map_or(1.0, |to| if to == count { 1.0 } else { kind.scale[to] });
    let kept: Vec<usize> = (0..run.ids.len()).filter(|&at| places[at].is_some()).collect();
    let n = kept.len();
    let covariance =
        DMatrix::from_fn(n, n, |i, j| run.covariance[(kept[i], kept[j])] / (scale(kept[i]) * scale(kept[j])));
    let all = inverse(&covariance)?;
    let mean = DVector::from_fn(n, |i, _| run.corrections[kept[i]] / scale(kept[i]));
    // In units of the prior its information is one in each direction: less than that is rounding.
    let prior =
        DVector::from_fn(n, |i, _| run.prior[kept[i]].map_or(0.0, |sd| (scale(kept[i]) / sd).powi(2)));
    let own = DVector::from_fn(n, |i, _| if prior[i] > 0.0 { prior[i].sqrt() } else { all[(i, i)].sqrt() });
    let whitened = DMatrix::from_fn(n, n, |i, j| {
        (all[(i, j)] - if i == j { prior[i] } else { 0.0 }) / (own[i] * own[j])
    });
    let eigen = whitened.symmetric_eigen();
    let values = eigen.eigenvalues.map(|value| if value > LEAST_SHARE { value } else { 0.0 });
    let data = &eigen.eigenvectors * DMatrix::from_diagonal(&values) * eigen.eigenvectors.transpose();
    let data = DMatrix::from_fn(n, n, |i, j| data[(i, j)] * own[i] * own[j]);
    let rhs = &all * mean;
    let (mut full, mut right) = (DMatrix::zeros(count + 1, count + 1), DVector::zeros(count + 1));
    for i in 0..n {
        let Some(row) = places[kept[i]] else { continue };
        right[row] = rhs[i];
        for j in 0..n {
            if let Some(column) = places[kept[j]] {
                full[(row, column)] = data[(i, j)];
            }
        }
    }
    bar.map(|_| (full, right))
}
