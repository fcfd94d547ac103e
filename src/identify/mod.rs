//! From lengths to parameters: fit, loss, stages, outliers, validation, summary.
//!
//! The lengths L = |p - c| + b are fitted by least squares over a base set of the parameters asked
//! for, chosen at the nominal geometry with the fitted set-up. What the data are too weak for is held
//! (or carries the prior), and every number comes with its standard deviation or the reason why it has none.

mod covariance;
mod estimate;
mod fit;
mod folds;
mod options;
mod prior;
pub mod result;
mod solver;
mod summary;
mod verdict;

use nalgebra::DMatrix;

pub use estimate::IdentifyError;
pub use options::{Options, Prior, tolerance};
pub use result::Identification;

use crate::model::{Centre, LengthModel, Observations, ParamId, Reading, Robot};
use estimate::Lengths;

/// A result with what stands behind it.
#[derive(Clone, Debug)]
pub struct Identified {
    /// What `result.json` holds.
    pub result: Identification,
    /// The identified robot, with the nominal one inside, tool ball included.
    pub robot: Robot,
    /// The identified robot, set-up and bar.
    pub model: LengthModel,
    /// The estimated parameters, and
    pub estimated: Vec<ParamId>,
    /// their covariance, in the units of the parameters.
    pub covariance: DMatrix<f64>,
    /// For each observation: its residual (measured minus predicted) with the nominal robot and with
    /// the identified one, mm, and whether it was used.
    pub residuals: Vec<ResidualPair>,
    /// The predicted 3-D error over the workspace.
    pub predicted: ErrorMap,
}

/// Where the ball is (robot base, mm) and the root mean square of its predicted 3-D error there, mm.
pub type ErrorMap = Vec<([f64; 3], f64)>;

/// The residuals of one observation, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResidualPair {
    /// With the nominal robot and the fitted set-up.
    pub before: f64,
    /// With the identified robot.
    pub after: f64,
    /// Whether the fit used it.
    pub used: bool,
}

/// Identifies the robot from `observations`, starting from its nominal geometry (its `[nominal]`
/// table where it has one) and the base balls at `centres`. `validation` is a separate set of lengths
/// to the same balls on which nothing is fitted.
///
/// # Errors
/// [`IdentifyError`]: numbers that are not finite, nothing to estimate, too few lengths.
pub fn identify(
    robot: &Robot,
    observations: &Observations,
    centres: &[Centre],
    validation: Option<&Observations>,
    options: &Options,
) -> Result<Identified, IdentifyError> {
    let start = LengthModel::new(robot.geometry.clone(), centres);
    let lengths = lengths(observations, options);
    let estimate = estimate::estimate(robot, &start, &lengths, options)?;
    let folds = match options.folds {
        Some(0 | 1) => None,
        Some(folds) => Some(folds),
        None => {
            let enough = folds::LENGTHS_PER_PARAMETER * estimate.kept.len();
            (lengths.readings.len() >= enough).then_some(folds::DEFAULT_FOLDS)
        }
    };
    let folds = folds
        .map(|folds| folds::cross_validate(robot, &start, &lengths, &estimate.fit.used, options, folds))
        .transpose()?
        .flatten();
    summary::summarise(robot, observations, &start, &lengths, estimate, folds, validation, options)
}

/// Only the fit of [`identify`]: the model found, without covariance, folds or predictions.
///
/// # Errors
/// As [`identify`].
pub fn fit(
    robot: &Robot,
    observations: &Observations,
    centres: &[Centre],
    options: &Options,
) -> Result<LengthModel, IdentifyError> {
    let start = LengthModel::new(robot.geometry.clone(), centres);
    Ok(estimate::estimate(robot, &start, &lengths(observations, options), options)?.fit.model)
}

/// The lengths as the solver takes them.
fn lengths(observations: &Observations, options: &Options) -> Lengths {
    let known = options.sigma_mm.is_some() || observations.rows.iter().all(|row| row.sigma_mm.is_some());
    let given = |sigma: Option<f64>| match options.sigma_mm {
        Some(sigma) => sigma,
        // One row without a sigma makes all equal: a guess for it would weigh as a measurement.
        None if known => sigma.unwrap_or(1.0),
        None => 1.0,
    };
    Lengths {
        readings: observations.rows.iter().map(Reading::from).collect(),
        given: observations.rows.iter().map(|row| given(row.sigma_mm)).collect(),
        vouched: options.sigma_mm.is_some(),
        known,
    }
}
