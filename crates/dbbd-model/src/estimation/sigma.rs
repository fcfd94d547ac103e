//! The noise of the lengths: one model for plans and estimates.
//!
//! The variance of a length is s^2 + t^2, where s is its own standard deviation (of the bar) and t a further one (the
//! repeatability of the robot, errors that the model lacks). The prior of t is r, the repeatability in the robot file, with
//! the weight of nu0 = [`PRIOR_FREEDOM`] lengths. After a fit of p parameters to n lengths with the residuals v, t^2 solves
//!
//!   sum v^2 / (s^2 + t^2) + nu0 r^2 / t^2 = (n - p) + nu0.
//!
//! This is the equation of Paule and Mandel (J. Res. NBS 87, 1982) with the prior as nu0 residuals of size r, so that few
//! lengths that agree by chance do not give a t far below the repeatability. The prior is dropped where the residuals are too
//! small for it (at 0.001). Without the prior, t is 0 as long as chance explains the residuals.

use super::fit::Fit;
use super::lengths::{Lengths, Sigma, Weighted};
use super::linear_system::linear_system;
use super::selection::is_bar;
use crate::math::distributions::ChiSquareOutcome;
use crate::measurement::PreparedMeasurement;
use crate::robot::{ParamId, Robot};

/// Degrees of freedom of the repeatability in a robot file: it is known to a factor of about 1.4.
const PRIOR_FREEDOM: f64 = 4.0;
/// Least standard deviation of a length, mm, so that exact data cause no division by zero.
const FLOOR_MM: f64 = 1e-9;

/// The a priori standard deviation of a length, mm: of the bar, and of the robot's repeatability if it is known.
pub fn length_sd_mm(bar_mm: f64, robot: &Robot) -> f64 {
    bar_mm.hypot(robot.repeatability_sd_mm().unwrap_or(0.0))
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Noise {
    pub(super) sigma: Sigma,
    /// Degrees of freedom, if the residuals were used.
    pub(super) freedom: Option<f64>,
}

impl Noise {
    pub(super) const GIVEN: Self = Self { sigma: Sigma::Given, freedom: None };

    /// A priori: without the residuals.
    fn prior(lengths: &Lengths) -> Self {
        let sigma = match lengths.repeatability_mm {
            Some(mm) if lengths.known => Sigma::And(mm * mm),
            Some(mm) => Sigma::All(mm),
            None => Sigma::Given,
        };
        Self { sigma, freedom: None }
    }

    /// From the residuals of a linearised fit of the base set: before the fit, or if a prior increases its residuals.
    pub(super) fn of_linear_fit(lengths: &Lengths, fit: &Fit, base: &[ParamId]) -> Self {
        if lengths.vouched {
            return Self::GIVEN;
        }
        let prior = Self::prior(lengths);
        let used = lengths.weighted(prior.sigma, &fit.outliers);
        let freedom = used.count() as f64 - base.len() as f64;
        // Equal lengths determine the bar and the scale of the robot only together. With a free bar a robot of size zero
        // would fit them with any angles.
        let sized: Vec<ParamId> = base.iter().copied().filter(|id| !is_bar(id)).collect();
        let squares = |used: Weighted<'_>| linear_system(&fit.model, &used, &sized).residual_sum().max(0.0);
        if freedom <= 0.0 {
            return prior;
        }
        if let Some(mm) = lengths.repeatability_mm {
            let sum = squares(used);
            if ChiSquareOutcome::of(sum / freedom, freedom) != ChiSquareOutcome::Less {
                let freedom = freedom + PRIOR_FREEDOM;
                let factor = (sum + PRIOR_FREEDOM) / freedom;
                let own = if lengths.known { used.by(Sigma::Given).rms_sigma().powi(2) } else { 0.0 };
                let further = (factor * (own + mm * mm) - own).max(0.0);
                return Self::further(lengths, further, freedom);
            }
        }
        let ratio = squares(used.by(Sigma::Given)) / freedom;
        if !lengths.known {
            return Self::further(lengths, ratio, freedom);
        }
        match ChiSquareOutcome::of(ratio, freedom) {
            ChiSquareOutcome::Greater => Self { sigma: Sigma::Times(ratio.sqrt()), freedom: Some(freedom) },
            ChiSquareOutcome::AsExpected | ChiSquareOutcome::Less => Self::GIVEN,
        }
    }

    /// From the residuals of a fit of so many parameters.
    pub(super) fn of_fit(lengths: &Lengths, fit: &Fit, parameters: usize) -> Self {
        if lengths.vouched {
            return Self::GIVEN;
        }
        let prior = Self::prior(lengths);
        let used = lengths.weighted(Sigma::Given, &fit.outliers);
        let freedom = used.count() as f64 - parameters as f64;
        if freedom <= 0.0 {
            return prior;
        }
        let prepared = fit.model.prepare();
        let square = |reading: &PreparedMeasurement| {
            let residual = prepared.residual(reading);
            residual * residual
        };
        let chi = |sigma: Sigma| {
            let sum = used.by(sigma).sum(|reading, sigma| square(reading) / (sigma * sigma));
            ChiSquareOutcome::of(sum / freedom, freedom)
        };
        let prior = lengths.repeatability_mm.filter(|_| chi(prior.sigma) != ChiSquareOutcome::Less);
        let prior_freedom = prior.map_or(0.0, |_| PRIOR_FREEDOM);
        let of_prior = prior.map_or(0.0, |mm| PRIOR_FREEDOM * mm * mm);
        if !lengths.known {
            let squares = used.sum(|reading, _| square(reading));
            let freedom = freedom + prior_freedom;
            return Self::further(lengths, (squares + of_prior) / freedom, freedom);
        }
        if prior.is_none() && chi(Sigma::Given) != ChiSquareOutcome::Greater {
            return Self::GIVEN;
        }
        // An even sample of many lengths determines it to one part in a hundred.
        let sample = used.used_sample().into_iter();
        let mut squares: Vec<(f64, f64)> =
            sample.map(|(reading, sigma)| (square(&reading), sigma * sigma)).collect();
        // The square of a very large sigma overflows.
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

    /// With a further variance, mm^2; it is the whole variance if none is given for the lengths.
    fn further(lengths: &Lengths, square: f64, freedom: f64) -> Self {
        let sigma = match lengths.known {
            true => Sigma::And(square),
            false => Sigma::All(square.sqrt().max(FLOOR_MM)),
        };
        Self { sigma, freedom: Some(freedom) }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::estimation::options::Options;
    use crate::measurement::{
        AxisAngles, BallId, BarId, BaseBall, Datum, LengthModel, Measurement, TargetId,
    };
    use crate::robot::Approach;

    /// ISO 9283 states the repeatability of the built-in KR 60 HA, 0.05 mm, as the mean distance and three standard deviations
    /// of the distance. Of a Maxwell distribution these are 2 sqrt(2 / pi) and sqrt(3 - 8 / pi) deviations of a coordinate.
    #[test]
    fn repeatability_adds_to_the_variance_of_the_bar() {
        let robot = Robot::by_name("kr60ha").unwrap().unwrap();
        let pi = std::f64::consts::PI;
        let own = 0.05 / (2.0 * (2.0 / pi).sqrt() + 3.0 * (3.0 - 8.0 / pi).sqrt());
        assert!((length_sd_mm(0.01, &robot) - 0.01f64.hypot(own)).abs() < 1e-5);
        let unknown = Robot { repeatability_mm: None, ..robot };
        assert_eq!(length_sd_mm(0.01, &unknown), 0.01);
    }

    /// Twenty lengths, which are alternately `off_mm` longer and shorter than the model predicts, and a fit of four parameters.
    fn noise(off_mm: f64, sigma_mm: Option<f64>, repeatability_mm: Option<f64>, options: &Options) -> Noise {
        let robot = Robot { repeatability_mm, ..Robot::by_name("kr60ha").unwrap().unwrap() };
        let ball = BaseBall { id: BallId::FIRST, position: Vector3::new(1200.0, 0.0, 600.0) };
        let model = LengthModel::new(robot.geometry.clone(), &[ball]);
        let row = |at: u32| {
            let axes = AxisAngles::from_degrees([3.0 * f64::from(at), -90.0, 90.0, 10.0, 40.0, 0.0]);
            let mut row = Measurement {
                index: at + 1,
                datum: Datum::Ball(BallId::FIRST, BarId::FIRST),
                target: TargetId::FIRST,
                axes,
                approach: Approach::default(),
                length_mm: 0.0,
                sigma_mm,
                context: None,
            };
            let off_mm = if at.is_multiple_of(2) { off_mm } else { -off_mm };
            row.length_mm = model.prepare().length(&PreparedMeasurement::from(&row)) + off_mm;
            row
        };
        let rows: Vec<Measurement> = (0..20).map(row).collect();
        let fit = Fit { model, iterations: 1, converged: true, outliers: vec![] };
        Noise::of_fit(&Lengths::of(&rows, options, &robot), &fit, 4)
    }

    /// s = r = 0.01 mm, v = 0.02 mm: in units of 1e-4 mm^2, 20 * 4 / (1 + x) + 4 / x = 16 + 4, and so 5 x^2 - 16 x - 1 = 0.
    #[test]
    fn further_variance_solves_the_equation_of_paule_and_mandel() {
        let found = noise(0.02, Some(0.01), Some(0.01 * 3.616), &Options::default());
        let Sigma::And(square) = found.sigma else { panic!("{found:?}") };
        let x = (16.0 + 276f64.sqrt()) / 10.0;
        assert!((square / (1e-4 * x) - 1.0).abs() < 1e-6, "{square}");
        assert_eq!(found.freedom, Some(20.0));
    }

    /// Without a repeatability the equation is 80 / (1 + x) = 16.
    #[test]
    fn without_a_prior_the_residuals_alone_decide() {
        let found = noise(0.02, Some(0.01), None, &Options::default());
        let Sigma::And(square) = found.sigma else { panic!("{found:?}") };
        assert!((square / 4e-4 - 1.0).abs() < 1e-6, "{square}");
        assert_eq!(found.freedom, Some(16.0));
        // Residuals that chance explains leave the given standard deviations.
        assert_eq!(noise(0.009, Some(0.01), None, &Options::default()), Noise::GIVEN);
    }

    /// A repeatability of 1 mm would give far larger residuals: it is not used.
    #[test]
    fn prior_that_the_residuals_refuse_is_dropped() {
        assert_eq!(noise(0.009, Some(0.01), Some(3.616), &Options::default()), Noise::GIVEN);
    }

    #[test]
    fn scatter_is_the_standard_deviation_where_none_is_given() {
        let found = noise(0.02, None, None, &Options::default());
        let Sigma::All(sigma) = found.sigma else { panic!("{found:?}") };
        // sqrt(20 * 0.02^2 / 16).
        assert!((sigma / 5e-4f64.sqrt() - 1.0).abs() < 1e-6, "{sigma}");
        assert_eq!(found.freedom, Some(16.0));
        let stated = Options { sigma_mm: Some(0.5), ..Options::default() };
        assert_eq!(noise(0.02, None, None, &stated), Noise::GIVEN);
    }

    #[test]
    fn standard_deviation_of_a_length_by_its_rule() {
        let rules = [Sigma::Given, Sigma::Times(3.0), Sigma::And(16.0), Sigma::All(0.7)];
        assert_eq!(rules.map(|rule| rule.of(3.0)), [3.0, 9.0, 5.0, 0.7]);
    }
}
