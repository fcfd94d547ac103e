//! Whether lengths and positions are of one robot: Chow's test (Econometrica 28, 1960) of the residuals that each kind leaves
//! alone against those of both together.

use super::estimate::Estimate;
use super::lengths::Lengths;
use super::linear_system::LinearSystem;
use crate::catalogue::EstimationFinding;
use crate::math::base_set;
use crate::math::distributions::ln_f_tail;

/// The chance of such a difference in sound measurements.
const CHANCE: f64 = 1e-4;
/// How much smaller the residuals are apart: what the model lacks differs a little between any two sets of poses.
const SMALLER: f64 = 1.5;
/// Degrees of freedom of each kind below which nothing is decided.
const FEWEST: f64 = 10.0;

/// Linearised at the estimate; without a prior, which binds both alike.
pub(super) fn kinds_disagree(estimate: &Estimate, lengths: &Lengths) -> Option<EstimationFinding> {
    let model = &estimate.fit.model;
    model.tracker?;
    let is_used = |at: &usize| estimate.fit.out.binary_search(at).is_err();
    let is_position = |at: &usize| lengths.reading(*at).datum.is_plane();
    let (positions, others): (Vec<usize>, Vec<usize>) =
        (0..lengths.len()).filter(is_used).partition(is_position);
    if others.is_empty() {
        return None;
    }
    let left = |places: &[usize]| {
        let some = lengths.at(places);
        let mut system = LinearSystem::at(model, &some.weighted(estimate.noise.sigma, &[]), &estimate.base);
        let order: Vec<usize> = (0..estimate.base.len()).collect();
        let rank = base_set(&system.factor(), &order)?.rank;
        Some((system.residual_sum().max(0.0), places.len() as f64 - rank as f64))
    };
    let (together, freedom) = left(&[others.as_slice(), positions.as_slice()].concat())?;
    let ((one, of_one), (other, of_other)) = (left(&others)?, left(&positions)?);
    let (apart, remaining) = (one + other, of_one + of_other);
    if of_one.min(of_other) < FEWEST || freedom <= remaining {
        return None;
    }
    let f = ((together - apart) / (freedom - remaining)) / (apart / remaining);
    let size = |squares: f64, freedom: f64| (squares / freedom).sqrt();
    let (together, apart) = (size(together, freedom), size(apart, remaining));
    if ln_f_tail(f, freedom - remaining, remaining) > CHANCE.ln() || together < SMALLER * apart {
        return None;
    }
    let sigma_mm = estimate.used(lengths).rms_sigma();
    Some(EstimationFinding::KindsDisagree { apart_mm: apart * sigma_mm, together_mm: together * sigma_mm })
}
