//! The uncertainty budget of a calibrated robot's position.
//!
//! The measurand is the position of the tool ball over the workspace after the best rigid alignment, which lengths do
//! not determine. A contribution is the root mean square of the 3-D error that its source alone causes. The sources are
//! independent, so the squares add (GUM 5.1.2). The expanded uncertainty is twice the root of the sum: a normal 3-D
//! error exceeds it with a probability of at most 4.6 %, the value for an error along one direction.

use serde::{Deserialize, Serialize};

use crate::estimation::result::{MapPoint, PriorSource, SigmaSource};
use crate::estimation::{CompletedCalibration, Priors};
use crate::math::distributions::COVERAGE_FACTOR;
use crate::measurement::Measurements;
use crate::provenance::Identity;
use crate::robot::{BarId, ParamId};

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UncertaintyBudget {
    pub lines: Vec<BudgetLine>,
    /// Root sum of squares of the known contributions.
    pub combined_mm: f64,
    pub coverage_factor: f64,
    pub expanded_mm: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BudgetLine {
    pub source: BudgetSource,
    pub basis: BudgetBasis,
    /// Standard uncertainty of a length from this source; `None` for the geometry.
    pub length_mm: Option<f64>,
    /// Contribution to the position; `None` if it is not determined.
    pub position_mm: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BudgetSource {
    /// Length of the bar.
    Bar,
    /// Temperature of the bar.
    Temperature,
    Repeatability,
    /// Noise of the bar's readings.
    Noise,
    /// Scatter of the lengths beyond noise and repeatability.
    Model,
    /// Parameters of the robot that the lengths do not determine.
    Geometry,
}

/// The origin of the figure of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BudgetBasis {
    Certificate,
    /// Stated by the user or a file.
    Stated,
    Residuals,
    /// A default, because nothing is known.
    Assumed,
    /// Propagation of prior and lengths.
    Prediction,
    /// Determined by the lengths.
    Lengths,
    /// Declared exact by the user.
    Exact,
    NotDetermined,
}

impl BudgetSource {
    /// Whether the bar is the source, not the robot or its model.
    pub fn is_of_bar(self) -> bool {
        match self {
            Self::Bar | Self::Temperature | Self::Noise => true,
            Self::Repeatability | Self::Model | Self::Geometry => false,
        }
    }

    pub fn words(self) -> &'static str {
        match self {
            Self::Bar => "length of the bar",
            Self::Temperature => "temperature of the bar",
            Self::Repeatability => "repeatability of the robot",
            Self::Noise => "noise of the bar's readings",
            Self::Model => "model: scatter beyond noise and repeatability",
            Self::Geometry => "model: geometry that the lengths do not determine",
        }
    }
}

impl BudgetBasis {
    pub fn words(self) -> &'static str {
        match self {
            Self::Certificate => "certificate",
            Self::Stated => "stated",
            Self::Residuals => "residuals of the lengths",
            Self::Assumed => "assumed: no certificate",
            Self::Prediction => "propagated",
            Self::Lengths => "determined by the lengths",
            Self::Exact => "taken as exact",
            Self::NotDetermined => "not determined",
        }
    }
}

impl UncertaintyBudget {
    /// The budget of a result from these lengths. `bar_u_mm` is the standard uncertainty of the bar's length with its temperature,
    /// if known.
    pub fn of(
        found: &CompletedCalibration,
        lengths: &Measurements,
        bar_u_mm: Option<f64>,
        identity: &Identity,
    ) -> Self {
        let mut lines = bar(found, bar_u_mm, identity.bar_temperature_u_mm()).to_vec();
        lines.extend(scatter(found, lengths));
        lines.push(geometry(found));
        Self::with_lines(lines)
    }

    /// The line with the largest contribution to the position: what limits the result.
    pub fn largest(&self) -> Option<&BudgetLine> {
        let known = self.lines.iter().filter(|line| line.position_mm.is_some());
        known.max_by(|one, other| one.position_mm.unwrap_or(0.0).total_cmp(&other.position_mm.unwrap_or(0.0)))
    }

    /// Root sum of squares of the contributions of the bar, mm.
    pub fn by_bar_mm(&self) -> f64 {
        self.lines
            .iter()
            .filter(|line| line.source.is_of_bar())
            .filter_map(|line| line.position_mm)
            .fold(0.0, f64::hypot)
    }

    /// Root sum of squares of the contributions of the robot and its model, mm.
    pub fn by_robot_mm(&self) -> f64 {
        (self.combined_mm.powi(2) - self.by_bar_mm().powi(2)).max(0.0).sqrt()
    }

    /// Adds the squares of the known contributions.
    fn with_lines(lines: Vec<BudgetLine>) -> Self {
        let squares = lines.iter().filter_map(|line| line.position_mm).map(|mm| mm * mm);
        let combined_mm = squares.sum::<f64>().sqrt();
        let expanded_mm = COVERAGE_FACTOR * combined_mm;
        Self { lines, combined_mm, coverage_factor: COVERAGE_FACTOR, expanded_mm }
    }
}

/// The lines of the bar's length and of its temperature. The estimate knows only one error of the length; its effect on
/// the positions is split in the ratio of the variances.
fn bar(found: &CompletedCalibration, bar_u_mm: Option<f64>, temperature_mm: Option<f64>) -> [BudgetLine; 2] {
    let whole_mm = found.position_parts.bar_mm;
    let offset = found.result.parameter(ParamId::BarOffset(BarId::FIRST));
    let estimated = offset.is_some_and(|offset| offset.sd.is_some());
    let basis = match bar_u_mm {
        _ if estimated && found.result.prior == PriorSource::None => BudgetBasis::Lengths,
        _ if whole_mm == 0.0 => BudgetBasis::Exact,
        Some(_) => BudgetBasis::Certificate,
        None => BudgetBasis::Assumed,
    };
    let stated = [BudgetBasis::Certificate, BudgetBasis::Assumed].contains(&basis);
    let sd_mm = Priors::datasheet(&found.robot, bar_u_mm).sd(ParamId::BarOffset(BarId::FIRST));
    bar_lines(basis, stated.then_some(sd_mm), temperature_mm, whole_mm)
}

/// `sd_mm` is the standard uncertainty of the length, if one is stated, and `whole_mm` the contribution of the error of
/// the length to the positions.
fn bar_lines(
    basis: BudgetBasis,
    sd_mm: Option<f64>,
    temperature_mm: Option<f64>,
    whole_mm: f64,
) -> [BudgetLine; 2] {
    let share = temperature_mm.zip(sd_mm).map_or(0.0, |(mm, sd_mm)| (mm / sd_mm).min(1.0));
    let of_length = (1.0 - share * share).sqrt();
    [
        BudgetLine {
            source: BudgetSource::Bar,
            basis,
            length_mm: sd_mm.map(|mm| mm * of_length),
            position_mm: Some(whole_mm * of_length),
        },
        BudgetLine {
            source: BudgetSource::Temperature,
            basis: if temperature_mm.is_some() { BudgetBasis::Stated } else { BudgetBasis::NotDetermined },
            length_mm: temperature_mm,
            position_mm: temperature_mm.map(|_| whole_mm * share),
        },
    ]
}

/// Splits the scatter of the lengths into its known sources. The contributions are in the ratio of the variances.
fn scatter(found: &CompletedCalibration, lengths: &Measurements) -> Vec<BudgetLine> {
    let squares = lengths.rows.iter().map(|row| row.sigma_mm.map(|mm| mm * mm)).sum::<Option<f64>>();
    let of_rows = squares.map(|sum| sum / lengths.rows.len().max(1) as f64);
    let sd = found.robot.repeatability_sd_mm();
    scatter_lines(
        found.result.noise_mm.length,
        found.result.sigma_source,
        of_rows,
        sd,
        found.position_parts.noise_mm,
    )
}

/// The lines of the scatter. `of_rows` is the mean variance that the rows state (mm^2), `sd` the standard deviation of the
/// repeatability and `position_mm` what the whole scatter contributes to the position, mm.
fn scatter_lines(
    sigma_mm: f64,
    source: SigmaSource,
    of_rows: Option<f64>,
    sd: Option<f64>,
    position_mm: f64,
) -> Vec<BudgetLine> {
    let total = sigma_mm.powi(2);
    let repeatability = sd.map_or(0.0, |mm| mm * mm);
    // A standard deviation that the user gave includes the repeatability.
    let is_given = source == SigmaSource::Given;
    let given = is_given.then_some((total - repeatability).max(0.0));
    let of_rows = of_rows.filter(|rows| !is_given || (rows - total).abs() <= 1e-9 * total);
    let stated = of_rows.or(given);
    let noise = stated.unwrap_or(0.0).min(total);
    let repeated = repeatability.min(total - noise);
    let of = |source, basis, variance: f64| {
        let share = if total > 0.0 { (variance / total).sqrt() } else { 0.0 };
        BudgetLine { source, basis, length_mm: Some(variance.sqrt()), position_mm: Some(share * position_mm) }
    };
    let unknown =
        |source| BudgetLine { source, basis: BudgetBasis::NotDetermined, length_mm: None, position_mm: None };
    let known = |source, is_known, variance| match is_known {
        true => of(source, BudgetBasis::Stated, variance),
        false => unknown(source),
    };
    vec![
        known(BudgetSource::Noise, stated.is_some(), noise),
        match sd {
            // The residuals are smaller than the stated repeatability.
            Some(_) if repeated < repeatability => {
                of(BudgetSource::Repeatability, BudgetBasis::Residuals, repeated)
            }
            known_sd => known(BudgetSource::Repeatability, known_sd.is_some(), repeated),
        },
        of(BudgetSource::Model, BudgetBasis::Residuals, (total - noise - repeated).max(0.0)),
    ]
}

/// The rest of the predicted position uncertainty.
fn geometry(found: &CompletedCalibration) -> BudgetLine {
    let parts = found.position_parts;
    let rest =
        (MapPoint::root_mean_square_mm(&found.map).powi(2) - parts.bar_mm.powi(2) - parts.noise_mm.powi(2))
            .max(0.0)
            .sqrt();
    BudgetLine {
        source: BudgetSource::Geometry,
        basis: BudgetBasis::Prediction,
        length_mm: None,
        position_mm: Some(rest),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(mm: f64, source: SigmaSource, of_rows: Option<f64>, sd: Option<f64>) -> Vec<BudgetLine> {
        scatter_lines(mm, source, of_rows, sd, 2.0)
    }

    /// Basis and variance (1e-6 mm^2) of noise, repeatability and model.
    fn variances(lines: &[BudgetLine]) -> Vec<(BudgetBasis, Option<f64>)> {
        let variance = |line: &BudgetLine| line.length_mm.map(|mm| (1e6 * mm * mm).round());
        lines.iter().map(|line| (line.basis, variance(line))).collect()
    }

    /// 5 um are 4 by the certificate and 3 by the temperature: 25 um at the position are 20 and 15.
    #[test]
    fn error_of_the_bar_is_split_by_variance() {
        let [length, warm] = bar_lines(BudgetBasis::Certificate, Some(0.005), Some(0.003), 0.025);
        for (line, in_length, at_position) in [(length, 0.004, 0.020), (warm, 0.003, 0.015)] {
            assert!((line.length_mm.unwrap() - in_length).abs() < 1e-12, "{line:?}");
            assert!((line.position_mm.unwrap() - at_position).abs() < 1e-12, "{line:?}");
        }
        let [length, unknown] = bar_lines(BudgetBasis::Certificate, Some(0.005), None, 0.025);
        assert_eq!((length.position_mm, unknown.position_mm), (Some(0.025), None));
        assert_eq!(unknown.basis, BudgetBasis::NotDetermined);
        // The temperature alone is more than the whole: nothing is left for the certificate.
        let [length, warm] = bar_lines(BudgetBasis::Certificate, Some(0.005), Some(0.006), 0.025);
        assert_eq!([length, warm].map(|line| line.position_mm), [Some(0.0), Some(0.025)]);
    }

    /// 0.05^2 = 0.03^2 + 0.02^2 + 0.0012; a contribution is 2 times the root of its share of the variance.
    #[test]
    fn scatter_is_split_by_variance() {
        let found = lines(0.05, SigmaSource::Estimated, Some(0.0009), Some(0.02));
        let expected = [
            (BudgetBasis::Stated, Some(900.0)),
            (BudgetBasis::Stated, Some(400.0)),
            (BudgetBasis::Residuals, Some(1200.0)),
        ];
        assert_eq!(variances(&found), expected);
        for (line, expected) in found.iter().zip([1.2, 0.8, 2.0 * 0.48f64.sqrt()]) {
            assert!((line.position_mm.unwrap() - expected).abs() < 1e-12, "{line:?}");
        }
        // The squares of the contributions add up to the whole, and the coverage factor is 2.
        let budget = UncertaintyBudget::with_lines(found);
        assert!((budget.combined_mm - 2.0).abs() < 1e-12 && (budget.expanded_mm - 4.0).abs() < 1e-12);
        // 1.2 mm are of the bar; 1.6 mm of the robot and its model, of which the model has most.
        assert!((budget.by_bar_mm() - 1.2).abs() < 1e-12 && (budget.by_robot_mm() - 1.6).abs() < 1e-12);
        assert_eq!(budget.largest().unwrap().source, BudgetSource::Model);
    }

    #[test]
    fn residuals_below_the_repeatability_limit_it() {
        let found = lines(0.02, SigmaSource::Estimated, Some(0.0003), Some(0.03));
        let expected = [
            (BudgetBasis::Stated, Some(300.0)),
            (BudgetBasis::Residuals, Some(100.0)),
            (BudgetBasis::Residuals, Some(0.0)),
        ];
        assert_eq!(variances(&found), expected);
    }

    #[test]
    fn a_given_standard_deviation_contains_the_repeatability() {
        let expected = [
            (BudgetBasis::Stated, Some(1600.0)),
            (BudgetBasis::Stated, Some(900.0)),
            (BudgetBasis::Residuals, Some(0.0)),
        ];
        assert_eq!(variances(&lines(0.05, SigmaSource::Given, None, Some(0.03))), expected);
        // The standard deviations in the rows were replaced by the given one.
        assert_eq!(variances(&lines(0.05, SigmaSource::Given, Some(0.0001), Some(0.03))), expected);
        let of_rows = variances(&lines(0.05, SigmaSource::Given, Some(0.0025), Some(0.03)));
        assert_eq!(of_rows[..2], [(BudgetBasis::Stated, Some(2500.0)), (BudgetBasis::Residuals, Some(0.0))]);
    }

    #[test]
    fn what_is_not_known_contributes_nothing() {
        let found = lines(0.05, SigmaSource::Estimated, None, None);
        let unknown = (BudgetBasis::NotDetermined, None);
        assert_eq!(variances(&found), [unknown, unknown, (BudgetBasis::Residuals, Some(2500.0))]);
        assert_eq!(found[0].position_mm, None);
        assert!((UncertaintyBudget::with_lines(found).combined_mm - 2.0).abs() < 1e-12);
        let none = lines(0.0, SigmaSource::Given, None, None);
        assert!(none.iter().all(|line| line.position_mm.unwrap_or(0.0) == 0.0));
    }
}
