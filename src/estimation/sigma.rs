//! The noise of the lengths: one model for a plan and for an estimate.
//!
//! The variance of a length is s^2 + t^2: s its own standard deviation (the bar's), t a further one (the robot's
//! repeatability, what the model lacks). Beforehand t is r, the repeatability in the robot file, worth [`PRIOR_FREEDOM`]
//! lengths. After the fit with n lengths and p parameters t^2 solves
//!
//!   sum v^2 / (s^2 + t^2) + nu0 r^2 / t^2 = (n - p) + nu0,
//!
//! v the residuals: Paule and Mandel's equation (J. Res. NBS 87, 1982) with the prior as nu0 residuals of size r, so that few
//! lengths that agree by chance do not pretend to more than the robot repeats. The prior is dropped where the residuals are
//! smaller than it allows once in a thousand; without it s is kept as long as chance explains the residuals.

use super::fit::Fit;
use super::lengths::{Lengths, Sigma, Weighted};
use super::linear_system::LinearSystem;
use super::selection::is_bar;
use crate::math::distributions::ChiSquare;
use crate::measurement::PreparedMeasurement;
use crate::robot::{ParamId, Robot};

/// Degrees of freedom of the repeatability in a robot file: it is known to a factor of about 1.4.
const PRIOR_FREEDOM: f64 = 4.0;
/// Lengths are not better than this, mm: it keeps exact data from a division by zero.
const FLOOR_MM: f64 = 1e-9;

/// Standard deviation of a length before any residual, mm: the bar's, and the robot's repeatability where it is known.
pub fn length_sd_mm(bar_mm: f64, robot: &Robot) -> f64 {
    bar_mm.hypot(robot.repeatability_sd_mm().unwrap_or(0.0))
}

/// By what lengths are weighted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Noise {
    pub(super) sigma: Sigma,
    /// Degrees of freedom of what residuals gave; none where they gave nothing.
    pub(super) freedom: Option<f64>,
}

impl Noise {
    /// As the lengths' own standard deviations are given.
    pub(super) const GIVEN: Self = Self { sigma: Sigma::Given, freedom: None };

    /// Before any residual.
    fn beforehand(lengths: &Lengths) -> Self {
        let sigma = match lengths.repeatability_mm {
            Some(mm) if lengths.known => Sigma::And(mm * mm),
            Some(mm) => Sigma::All(mm),
            None => Sigma::Given,
        };
        Self { sigma, freedom: None }
    }

    /// Before the fit, or where a prior widens its residuals: what a linear fit of the base set leaves.
    pub(super) fn of_linear_fit(lengths: &Lengths, fit: &Fit, base: &[ParamId]) -> Self {
        if lengths.vouched {
            return Self::GIVEN;
        }
        let beforehand = Self::beforehand(lengths).sigma;
        let used = lengths.weighted(beforehand, &fit.out);
        let freedom = used.count() as f64 - base.len() as f64;
        // Lengths of one size determine a bar and the robot's size only together: a robot without size would fit whatever
        // its angles are.
        let sized: Vec<ParamId> = base.iter().copied().filter(|id| !is_bar(id)).collect();
        let squares =
            |used: Weighted<'_>| LinearSystem::at(&fit.model, &used, &sized).residual_sum().max(0.0);
        if freedom <= 0.0 {
            return Self::beforehand(lengths);
        }
        if let Some(mm) = lengths.repeatability_mm {
            let sum = squares(used);
            if ChiSquare::of(sum / freedom, freedom) != ChiSquare::Less {
                let freedom = freedom + PRIOR_FREEDOM;
                let factor = (sum + PRIOR_FREEDOM) / freedom;
                let own = if lengths.known { used.by(Sigma::Given).rms_sigma().powi(2) } else { 0.0 };
                let further = (factor * (own + mm * mm) - own).max(0.0);
                return Self::further(lengths, further, freedom);
            }
        }
        let ratio = squares(used.by(Sigma::Given)) / freedom;
        match ChiSquare::of(ratio, freedom) {
            _ if !lengths.known => Self::further(lengths, ratio, freedom),
            ChiSquare::Greater => Self { sigma: Sigma::Times(ratio.sqrt()), freedom: Some(freedom) },
            _ => Self::GIVEN,
        }
    }

    /// After the fit of so many parameters.
    pub(super) fn of_fit(lengths: &Lengths, fit: &Fit, parameters: usize) -> Self {
        if lengths.vouched {
            return Self::GIVEN;
        }
        let used = lengths.weighted(Sigma::Given, &fit.out);
        let freedom = used.count() as f64 - parameters as f64;
        if freedom <= 0.0 {
            return Self::beforehand(lengths);
        }
        let prepared = fit.model.prepare();
        let square = |reading: &PreparedMeasurement| {
            let residual = reading.length_mm - prepared.length(reading);
            residual * residual
        };
        let chi = |sigma: Sigma| {
            let sum = used.by(sigma).sum(|reading, sigma| square(reading) / (sigma * sigma));
            ChiSquare::of(sum / freedom, freedom)
        };
        let beforehand = Self::beforehand(lengths).sigma;
        let prior = lengths.repeatability_mm.filter(|_| chi(beforehand) != ChiSquare::Less);
        let prior_freedom = prior.map_or(0.0, |_| PRIOR_FREEDOM);
        let of_prior = prior.map_or(0.0, |mm| PRIOR_FREEDOM * mm * mm);
        if !lengths.known {
            let squares = used.sum(|reading, _| square(reading));
            let freedom = freedom + prior_freedom;
            return Self::further(lengths, (squares + of_prior) / freedom, freedom);
        }
        if prior.is_none() && chi(Sigma::Given) != ChiSquare::Greater {
            return Self::GIVEN;
        }
        // How large it is, an even sample of many shows to one part in a hundred.
        let mut squares = used.some(|reading, sigma| (square(reading), sigma * sigma));
        squares.retain(|(_, s2)| s2.is_finite());
        let wanted = freedom * (squares.len() as f64 / used.count() as f64) + prior_freedom;
        let (mut low, mut high) = (0.0, squares.iter().map(|(r2, _)| r2).sum::<f64>() + of_prior);
        for _ in 0..100 {
            let middle = 0.5 * (low + high);
            let sum = squares.iter().map(|(r2, s2)| r2 / (s2 + middle)).sum::<f64>() + of_prior / middle;
            if sum > wanted { low = middle } else { high = middle }
        }
        Self::further(lengths, high, freedom + prior_freedom)
    }

    /// With a further variance, mm^2, which is all of it where the lengths' own is not known.
    fn further(lengths: &Lengths, square: f64, freedom: f64) -> Self {
        let sigma = match lengths.known {
            true => Sigma::And(square),
            false => Sigma::All(square.sqrt().max(FLOOR_MM)),
        };
        Self { sigma, freedom: Some(freedom) }
    }
}
