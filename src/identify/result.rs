//! What an identification found: `result.json`.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::identifiability::Observability;
use crate::identifiability::trial::Kind;

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
    /// Observability indices of the identified parameters at the solution, their columns in units of what is known
    /// beforehand; none where nothing was identified.
    pub observability: Option<Observability>,
    /// Solver steps.
    pub iterations: usize,
    /// Whether the solver came to rest.
    pub converged: bool,
    /// Standard deviation of a length that the uncertainties use: given, or estimated from the residuals.
    pub sigma_mm: f64,
    /// Where that comes from.
    pub sigma_source: SigmaSource,
    /// Degrees of freedom of an estimated sigma.
    pub sigma_freedom: Option<f64>,
    /// Half width of a 95 % interval in standard deviations: Student's where sigma was estimated, normal where it
    /// was given; none where nothing is known of the lengths.
    pub coverage_factor: Option<f64>,
    /// The prior, where there was one.
    pub prior: Option<PriorUsed>,
    /// Whether each optional group was added, and why; empty where the user gave a list.
    pub groups: Vec<GroupChoice>,
    /// The Monte Carlo, when one was asked for.
    pub monte_carlo: Option<MonteCarlo>,
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
    /// Pairs of estimated parameters that are hardly told apart (|r| > 0.9), strongest first, at most ten.
    pub correlated: Vec<Correlated>,
    /// What to measure next, best first; none where the data suffice.
    pub advice: Vec<Advice>,
    /// What the residuals show at single joints beyond chance, strongest first.
    pub joints: Vec<JointEffect>,
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

/// Where the lengths' standard deviation comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SigmaSource {
    /// The user, or the data's `sigma_mm`.
    Given,
    /// The residuals.
    Estimated,
    /// Nobody: nothing is given, and no length is left over to tell it.
    #[default]
    Assumed,
}

/// A prior that was used.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PriorUsed {
    /// `datasheet` or `file`.
    pub source: String,
    /// Factor on its standard deviations.
    pub scale: f64,
    /// The factors that were tried, when the scale was chosen by cross-validation.
    pub tried: Vec<ScaleTried>,
}

/// A factor on the prior's standard deviations, and how well it does.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScaleTried {
    /// The factor.
    pub scale: f64,
    /// Root mean square of the held-out residuals, mm.
    pub held_out_rms_mm: f64,
}

/// Whether an optional group was added.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GroupChoice {
    /// `compliance` or `gear`.
    pub name: String,
    /// Whether it is estimated.
    pub added: bool,
    /// F of the nested test, when it was tested,
    pub f: Option<f64>,
    /// its two degrees of freedom,
    pub freedom: Option<[f64; 2]>,
    /// and the probability that chance does as well.
    pub p: Option<f64>,
    /// Held-out residuals without and with the group, where F spoke for it.
    pub held_out_mm: Option<WithoutWith>,
    /// The predicted mean 3-D error without and with it, where the held-out residuals spoke for it too.
    pub predicted_mm: Option<WithoutWith>,
    /// In words.
    pub text: String,
}

/// A quantity without and with an optional group, mm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct WithoutWith {
    /// Without the group.
    pub without: f64,
    /// With it.
    pub with: f64,
}

/// A Monte Carlo of the uncertainties.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MonteCarlo {
    /// Trials asked for.
    pub trials: usize,
    /// Trials whose fit came to rest.
    pub used: usize,
    /// Parameters whose interval differs from the linear one by more than chance.
    pub disagree: Vec<String>,
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
    /// 95 % interval of the value found.
    pub interval95: Option<[f64; 2]>,
    /// The same by Monte Carlo, when that was asked for.
    pub monte_carlo: Option<ParameterDraws>,
    /// What became of it.
    pub status: Status,
    /// Why, in words.
    pub reason: String,
}

/// What the Monte Carlo gave for a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ParameterDraws {
    /// Standard deviation.
    pub sd: f64,
    /// From the 2.5th to the 97.5th percentile of the value.
    pub interval95: [f64; 2],
}

/// Two estimated parameters that are hardly told apart.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Correlated {
    /// Their names.
    pub pair: [String; 2],
    /// Correlation coefficient of their estimates.
    pub r: f64,
}

/// A further measurement that was tried on the model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Advice {
    /// Its kind.
    pub kind: Kind,
    /// In words, with the figures.
    pub text: String,
    /// Lengths to be measured.
    pub poses: usize,
    /// Where a further ball would stand in the robot base, mm.
    pub ball_mm: Option<[f64; 3]>,
    /// Predicted mean 3-D error of the result as it is, mm.
    pub before_mm: f64,
    /// Predicted mean 3-D error with it and a prior (that of the result, else the datasheet's), mm.
    pub after_mm: f64,
    /// Whether it lowers the error by more than 3 % of what the prior alone leaves.
    pub adds: bool,
    /// Parameters that it would tell and that are not told now.
    pub tells: Vec<String>,
}

/// An error of a joint that the residuals show and the model lacks.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct JointEffect {
    /// Axis, from 1.
    pub axis: usize,
    /// Which error.
    pub error: JointError,
    /// What it does to the lengths beyond what the fit has taken up, root mean square, mm.
    pub rms_mm: f64,
    /// The whole play, rad.
    pub play_rad: Option<f64>,
    /// The chance of such residuals on a sound joint, before the number of tests counts.
    pub chance: f64,
    /// The same as a normal deviate.
    pub z: f64,
}

/// An error of a joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JointError {
    /// It returns with the axis angle: a gear's error, or sag.
    Angle,
    /// It turns with the sense of the motion: play.
    Reversal,
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
