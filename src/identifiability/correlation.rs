//! Pairs of estimated parameters that the data hardly tell apart.

use nalgebra::DMatrix;

use crate::model::ParamId;

/// Pairs below this are not worth a word: at 0.9 a pair's difference has a quarter of the variance of its sum.
const STRONG: f64 = 0.9;
/// At most so many are named.
const MOST: usize = 10;

/// Two parameters with the correlation of their estimates.
#[derive(Clone, Copy, Debug, PartialEq)]
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
