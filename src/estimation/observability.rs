//! How well poses determine parameters: observability indices O1 to O5, and pairs that are nearly collinear.
//!
//! Definitions: Sun and Hollerbach, "Observability index selection for robot calibration", ICRA 2008,
//! of the singular values s1 >= .. >= sL of the unit-norm columns and the number of lengths m:
//! O1 = (s1 .. sL)^(1/L) / sqrt(m), O2 = sL / s1, O3 = sL, O4 = sL^2 / s1, O5 = 1 / sum(1 / s).

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use crate::math::svd;
use crate::robot::ParamId;

/// The five indices; larger is better for all.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Observability {
    /// Geometric mean of the singular values over the root of the number of lengths.
    pub o1: f64,
    /// Inverse condition number.
    pub o2: f64,
    /// Smallest singular value.
    pub o3: f64,
    /// Noise amplification index.
    pub o4: f64,
    /// Harmonic mean of the singular values over their number.
    pub o5: f64,
}

/// The indices of `factor` (columns of a base set, in units that make them comparable) for `lengths` lengths.
/// `None` without columns or with a number that is not finite.
pub fn observability(factor: &DMatrix<f64>, lengths: usize) -> Option<Observability> {
    let values = svd(factor)?.values;
    let (largest, smallest) = (*values.iter().next()?, *values.iter().next_back()?);
    if largest == 0.0 {
        return None;
    }
    let mean_log = values.iter().map(|value| value.ln()).sum::<f64>() / values.len() as f64;
    Some(Observability {
        o1: mean_log.exp() / (lengths as f64).sqrt(),
        o2: smallest / largest,
        o3: smallest,
        o4: smallest * smallest / largest,
        o5: 1.0 / values.iter().map(|value| 1.0 / value).sum::<f64>(),
    })
}

/// Pairs below this are not worth a word: at 0.9 a pair's difference has a quarter of the variance of its sum.
const STRONG: f64 = 0.9;
/// At most so many are named.
const MOST: usize = 10;

/// Two parameters with the correlation of their estimates.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Correlation {
    /// The pair, in the order of the covariance.
    pub pair: [ParamId; 2],
    /// Correlation coefficient, -1..1.
    pub r: f64,
}

/// The pairs of `ids` with |r| > 0.9 by their `covariance`, strongest first, at most ten:
/// r = c_ij / sqrt(c_ii c_jj).
pub fn correlations(ids: &[ParamId], covariance: &DMatrix<f64>) -> Vec<Correlation> {
    let sd: Vec<f64> = covariance.diagonal().iter().map(|variance| variance.sqrt()).collect();
    let mut strong = Vec::new();
    for i in 0..ids.len() {
        for j in i + 1..ids.len() {
            let r = covariance[(i, j)] / (sd[i] * sd[j]);
            if r.abs() > STRONG {
                strong.push(Correlation { pair: [ids[i], ids[j]], r: r.clamp(-1.0, 1.0) });
            }
        }
    }
    strong.sort_by(|a, b| b.r.abs().total_cmp(&a.r.abs()));
    strong.truncate(MOST);
    strong
}
