//! The uncertainty budget of a calibrated robot's position.
//!
//! The measurand is the position of the tool ball over the workspace after the best rigid alignment, which lengths do
//! not determine. A contribution is the root mean square of the 3-D error that its source alone causes. The sources are
//! independent, so the squares add (GUM 5.1.2). The expanded uncertainty is twice the root of the sum: a normal 3-D
//! error exceeds it with a probability of at most 4.6 %, the value for an error along one direction.

use serde::{Deserialize, Serialize};

use crate::estimation::result::SigmaSource;
use crate::estimation::{CalibrationResult, Priors};
use crate::measurement::Measurements;
use crate::provenance::Identity;
use crate::robot::{BarId, ParamId};

pub const COVERAGE_FACTOR: f64 = 2.0;

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
    /// The budget of a result from these lengths. `bar_u_mm` is the standard uncertainty of the bar's length, if known.
    pub fn of(
        found: &CalibrationResult,
        lengths: &Measurements,
        bar_u_mm: Option<f64>,
        identity: &Identity,
    ) -> Self {
        let mut lines = vec![bar(found, bar_u_mm), temperature(found, bar_u_mm, identity)];
        lines.extend(scatter(found, lengths));
        lines.push(geometry(found));
        let squares = lines.iter().filter_map(|line| line.position_mm).map(|mm| mm * mm);
        let combined_mm = squares.sum::<f64>().sqrt();
        let expanded_mm = COVERAGE_FACTOR * combined_mm;
        Self { lines, combined_mm, coverage_factor: COVERAGE_FACTOR, expanded_mm }
    }
}

/// Prior standard uncertainty of the bar's length, mm.
fn bar_sd_mm(found: &CalibrationResult, bar_u_mm: Option<f64>) -> f64 {
    Priors::datasheet(&found.robot, bar_u_mm).sd(ParamId::BarOffset(BarId::FIRST))
}

fn bar(found: &CalibrationResult, bar_u_mm: Option<f64>) -> BudgetLine {
    let position_mm = found.position_parts.bar_mm;
    let offset = found.parameter(ParamId::BarOffset(BarId::FIRST));
    let estimated = offset.is_some_and(|offset| offset.sd.is_some());
    let basis = match bar_u_mm {
        _ if estimated && found.prior.is_none() => BudgetBasis::Lengths,
        _ if position_mm == 0.0 => BudgetBasis::Exact,
        Some(_) => BudgetBasis::Certificate,
        None => BudgetBasis::Assumed,
    };
    let stated = [BudgetBasis::Certificate, BudgetBasis::Assumed].contains(&basis);
    let length_mm = stated.then(|| bar_sd_mm(found, bar_u_mm));
    BudgetLine { source: BudgetSource::Bar, basis, length_mm, position_mm: Some(position_mm) }
}

/// An error of the bar's temperature changes its length by u = L alpha u(T), and the position as an error of length
/// does.
fn temperature(found: &CalibrationResult, bar_u_mm: Option<f64>, identity: &Identity) -> BudgetLine {
    let of_bar = identity.temperatures.iter().find(|found| found.of == "bar").and_then(|found| found.u_k);
    let length_mm = identity.bar.length_mm.zip(identity.bar.expansion_per_k).zip(of_bar);
    let length_mm = length_mm.map(|((length, per_k), u_k)| length * per_k.abs() * 0.5 * u_k);
    let leverage = found.position_parts.bar_mm / bar_sd_mm(found, bar_u_mm);
    BudgetLine {
        source: BudgetSource::Temperature,
        basis: if length_mm.is_some() { BudgetBasis::Stated } else { BudgetBasis::NotDetermined },
        length_mm,
        position_mm: length_mm.map(|mm| mm * leverage),
    }
}

/// Splits the scatter of the lengths into its known sources. The contributions are in the ratio of the variances.
fn scatter(found: &CalibrationResult, lengths: &Measurements) -> Vec<BudgetLine> {
    let squares = lengths.rows.iter().map(|row| row.sigma_mm.map(|mm| mm * mm)).sum::<Option<f64>>();
    let total = found.sigma.mm.powi(2);
    let sd = found.robot.repeatability_sd_mm();
    let repeatability = sd.map_or(0.0, |mm| mm * mm);
    // A standard deviation that the user gave includes the repeatability.
    let is_given = found.sigma.source == SigmaSource::Given;
    let given = is_given.then_some((total - repeatability).max(0.0));
    let of_rows = squares.map(|sum| sum / lengths.rows.len().max(1) as f64);
    let of_rows = of_rows.filter(|rows| !is_given || (rows - total).abs() <= 1e-9 * total);
    let stated = of_rows.or(given);
    let noise = stated.unwrap_or(0.0).min(total);
    let repeated = repeatability.min(total - noise);
    let of = |source, basis, variance: f64| {
        let share = if total > 0.0 { (variance / total).sqrt() } else { 0.0 };
        let position_mm = Some(share * found.position_parts.noise_mm);
        BudgetLine { source, basis, length_mm: Some(variance.sqrt()), position_mm }
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
fn geometry(found: &CalibrationResult) -> BudgetLine {
    let total =
        found.map.iter().map(|point| point.rms_mm.powi(2)).sum::<f64>() / found.map.len().max(1) as f64;
    let parts = found.position_parts;
    let rest = (total - parts.bar_mm.powi(2) - parts.noise_mm.powi(2)).max(0.0).sqrt();
    BudgetLine {
        source: BudgetSource::Geometry,
        basis: BudgetBasis::Prediction,
        length_mm: None,
        position_mm: Some(rest),
    }
}
