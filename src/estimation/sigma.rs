//! The standard deviation of the lengths: what is given, or what the residuals show.

use super::fit::Fit;
use super::lengths::{Lengths, Sigma};
use super::linear_system::LinearSystem;
use crate::math::distributions::ChiSquare;
use crate::measurement::PreparedMeasurement;
use crate::robot::ParamId;

/// Before the fit: what a linear fit of the base set leaves, or what is given.
pub(super) fn first_sigma(lengths: &Lengths, set_up: &Fit, base: &[ParamId]) -> Sigma {
    if lengths.vouched {
        return Sigma::Given;
    }
    let used = lengths.weighted(Sigma::Given, &set_up.out);
    let mut system = LinearSystem::at(&set_up.model, &used, base);
    let freedom = used.count() as f64 - base.len() as f64;
    let ratio = if freedom > 0.0 { system.residual_sum() / freedom } else { 1.0 };
    match ChiSquare::of(ratio, freedom) {
        _ if !lengths.known => Sigma::Times(ratio.sqrt().max(FLOOR_MM)),
        ChiSquare::Greater => Sigma::Times(ratio.sqrt()),
        _ => Sigma::Given,
    }
}

/// Lengths are not better than this, mm: it keeps exact data from a division by zero.
const FLOOR_MM: f64 = 1e-9;

/// After the fit: what is given, brought to what the residuals show. Where nothing is known, one
/// sigma for all; where the residuals are larger than the given sigmas and chance, a common further
/// deviation (repeatability, what the model lacks) is added in squares (Paule and Mandel, J. Res.
/// NBS 87, 1982).
pub(super) fn shown_sigma(lengths: &Lengths, fit: &Fit, parameters: usize) -> Sigma {
    if lengths.vouched {
        return Sigma::Given;
    }
    let prepared = fit.model.prepare();
    let used = lengths.weighted(Sigma::Given, &fit.out);
    let freedom = used.count() as f64 - parameters as f64;
    if freedom <= 0.0 {
        return Sigma::Given;
    }
    let square = |reading: &PreparedMeasurement| {
        let residual = reading.length_mm - prepared.length(reading);
        residual * residual
    };
    if !lengths.known {
        return Sigma::All((used.sum(|reading, _| square(reading)) / freedom).sqrt().max(FLOOR_MM));
    }
    let chi = used.sum(|reading, sigma| square(reading) / (sigma * sigma));
    if ChiSquare::of(chi / freedom, freedom) != ChiSquare::Greater {
        return Sigma::Given;
    }
    // How large it is, an even sample of many tells to one part in a hundred.
    let mut squares = used.some(|reading, sigma| (square(reading), sigma * sigma));
    squares.retain(|(_, s2)| s2.is_finite());
    let freedom = freedom * (squares.len() as f64 / used.count() as f64);
    let (mut low, mut high) = (0.0, squares.iter().map(|(r2, _)| r2).sum::<f64>());
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        let chi = squares.iter().map(|(r2, s2)| r2 / (s2 + middle)).sum::<f64>();
        if chi > freedom { low = middle } else { high = middle }
    }
    Sigma::And(high)
}
