//! What an identification found: `result.json`.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// The whole result; lengths in mm, angles in rad.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Identification {
    /// Version of this form: 1.
    pub schema: u32,
    /// Name of the robot.
    pub robot: String,
    /// Number of lengths used.
    pub observations: usize,
    /// Rank of the scaled Jacobian of the parameters asked for, at the nominal geometry.
    pub rank: usize,
    /// The same at the solution.
    pub rank_at_solution: usize,
    /// Condition number of the unit-norm columns of the base set.
    pub condition: f64,
    /// Solver steps.
    pub iterations: usize,
    /// Whether the solver came to rest.
    pub converged: bool,
    /// Standard deviation of a length that the uncertainties use: given, or estimated from the residuals.
    pub sigma_mm: f64,
    /// Residuals of the lengths.
    pub residual_mm: BeforeAfter,
    /// Held-out residuals by cross-validation, when it was done.
    pub folds: Option<Folds>,
    /// Residuals on a separate file, when one was given.
    pub validation: Option<BeforeAfter>,
    /// Predicted 3-D position error over the workspace.
    pub predicted_position_error_mm: PredictedPair,
    /// Every parameter of the model, with its fate.
    pub parameters: Vec<ParameterResult>,
    /// Groups of parameters of which only a combination can be told.
    pub dependent: Vec<Dependent>,
    /// Lengths that were set aside.
    pub outliers: Vec<Outlier>,
    /// What the user must see.
    pub warnings: Vec<Warning>,
}

/// Residuals with the nominal robot (set-up fitted where the user did not hold it), and identified.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BeforeAfter {
    /// Nominal robot.
    pub before: Residual,
    /// Identified robot.
    pub after: Residual,
}

/// Residuals of lengths, mm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Residual {
    /// Root mean square.
    pub rms: f64,
    /// Mean.
    pub mean: f64,
    /// Largest magnitude.
    pub max: f64,
}

/// Held-out residuals.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Folds {
    /// Number of folds.
    pub folds: usize,
    /// Root mean square of the held-out residuals, mm.
    pub rms: f64,
}

/// Predicted 3-D errors of the nominal and the identified robot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PredictedPair {
    /// Nominal robot, by its tolerance.
    pub nominal: PredictedError,
    /// Identified robot, by what the data left unknown.
    pub identified: PredictedError,
}

/// A predicted 3-D position error over the workspace, after one best rigid alignment, mm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PredictedError {
    /// Mean.
    pub mean: f64,
    /// 95th percentile.
    pub p95: f64,
    /// Maximum.
    pub max: f64,
}

/// What became of a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// Estimated from the data.
    Identified,
    /// Only a combination with others can be told, and another member carries it.
    Dependent,
    /// Held, because the user said so or nothing moves it.
    Held,
    /// The data are too weak for it; held.
    TooWeak,
    /// Estimated with the help of the prior.
    Prior,
}

/// One parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ParameterResult {
    /// Name.
    pub name: String,
    /// `mm`, `rad` or `rad/Nm`.
    pub unit: String,
    /// Value that the solver started from.
    pub start: f64,
    /// Nominal value.
    pub nominal: f64,
    /// Value found, or the one it was held at.
    pub identified: f64,
    /// Identified minus nominal.
    pub correction: f64,
    /// Standard deviation; none for what was not estimated.
    pub sd: Option<f64>,
    /// What became of it.
    pub status: Status,
    /// Why, in words.
    pub reason: String,
}

/// A direction of which only a combination can be told.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dependent {
    /// The identifiable combination: coefficient of each member, the leading one 1.
    pub combination: BTreeMap<String, f64>,
    /// The member that carries it.
    pub kept: String,
    /// In words.
    pub text: String,
}

/// A length that was set aside.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Outlier {
    /// The observation's index.
    pub index: u32,
    /// Its base ball.
    pub centre: usize,
    /// Its residual, mm.
    pub residual_mm: f64,
}

/// Whether a warning is to be known, or throws doubt on the result (exit code 3).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WarningKind {
    /// To be known.
    Note,
    /// Throws doubt on the result.
    Doubt,
}

/// What the user must see.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Warning {
    /// How grave.
    pub kind: WarningKind,
    /// In words, with what to do.
    pub text: String,
}
