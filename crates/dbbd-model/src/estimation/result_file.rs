//! `result.json`, schema 1: the form in which a result is written and read. Names are strings here.

use crate::estimation::ResultFinding;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::result::{
    BeforeAfter, CalibrationResult, Folds, FurtherMeasurement, JointEffect, MadeFrom, MonteCarlo, Outlier,
    ParameterDraws, PredictedPair, PriorUsed, Recommendation, SigmaSource, StartRobot, Status,
};
use super::{
    Combination, Correlation, DistanceQuantities, GroupEvidence, JointSummary, Observability, result,
};
use crate::base::serialised::check_seal;
use crate::diagnostic::{Diagnostic, Severity};
use crate::robot::Robot;

/// Lengths in mm, angles in rad.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ResultFile {
    pub schema: u32,
    pub robot: String,
    /// The robot to which `before` refers.
    #[serde(default)]
    pub start: StartRobot,
    pub observations: usize,
    #[serde(default)]
    pub made_from: MadeFrom,
    pub rank: usize,
    pub rank_at_solution: usize,
    pub condition: f64,
    pub observability: Option<Observability>,
    pub iterations: usize,
    pub converged: bool,
    pub sigma_mm: f64,
    pub sigma_source: SigmaSource,
    pub sigma_freedom: Option<f64>,
    pub coverage_factor: Option<f64>,
    pub prior: Option<PriorUsed>,
    pub groups: Vec<ErrorGroup>,
    pub joint_errors: Option<JointSummary>,
    pub monte_carlo: Option<MonteCarlo>,
    pub residual_mm: BeforeAfter,
    pub folds: Option<Folds>,
    pub validation: Option<BeforeAfter>,
    #[serde(default)]
    pub distance: Option<DistanceQuantities>,
    pub predicted_position_error_mm: PredictedPair,
    pub parameters: Vec<ParameterResult>,
    pub dependent: Vec<Dependent>,
    pub correlated: Vec<Correlation>,
    pub advice: Vec<Advice>,
    pub joints: Vec<JointEffect>,
    pub outliers: Vec<Outlier>,
    pub warnings: Vec<Warning>,
}

impl ResultFile {
    /// # Errors
    /// The text is not that of a result, or it was edited.
    pub fn from_json(file: &str, text: &str) -> Result<Self, Diagnostic> {
        check_seal(text).map_err(|finding| Diagnostic::file(file, finding))?;
        serde_json::from_str(text)
            .map_err(|error| Diagnostic::file(file, ResultFinding::Incomplete { why: error.to_string() }))
    }

    /// The result file beside a robot file, and its path. `read` returns the text of a file if it exists.
    ///
    /// # Errors
    /// As [`Self::from_json`], and those of `read`.
    pub fn beside(
        robot_file: &Path,
        robot: &Robot,
        read: impl FnOnce(&Path) -> Option<Result<String, Diagnostic>>,
    ) -> Result<(PathBuf, Beside), Diagnostic> {
        let path = robot_file.with_file_name("result.json");
        let Some(text) = read(&path).transpose()? else { return Ok((path, Beside::Nothing)) };
        let result = Self::from_json(&path.display().to_string(), &text)?;
        let made: Option<Value> = serde_json::from_str(&text).ok();
        let made = made.and_then(|made| made.get("provenance")?.get("from").cloned());
        let known = &robot.provenance.from;
        let is_other = !known.is_empty() && made.is_some_and(|made| made != json!(known));
        let is_own = result.robot == robot.name && !is_other;
        Ok((path, if is_own { Beside::Own(Box::new(result)) } else { Beside::Another }))
    }
}

/// The result file beside a robot file.
#[derive(Clone, Debug, PartialEq)]
pub enum Beside {
    /// Of the same calibration.
    Own(Box<ResultFile>),
    /// Of another robot or calibration.
    Another,
    Nothing,
}

/// A [`GroupEvidence`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ErrorGroup {
    pub name: String,
    pub sd: f64,
    pub effective_parameters: f64,
    pub rms_mm: f64,
    pub share: f64,
    pub text: String,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ParameterResult {
    pub name: String,
    pub unit: String,
    pub start: f64,
    pub nominal: f64,
    pub identified: f64,
    pub correction: f64,
    pub sd: Option<f64>,
    pub interval95: Option<[f64; 2]>,
    pub monte_carlo: Option<ParameterDraws>,
    pub status: Status,
    pub reason: String,
}

/// A [`Recommendation`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Advice {
    pub kind: Kind,
    pub text: String,
    pub poses: usize,
    pub ball_mm: Option<[f64; 3]>,
    pub before_mm: f64,
    pub after_mm: f64,
    pub adds: bool,
    pub tells: Vec<String>,
}

/// A [`Combination`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dependent {
    pub combination: BTreeMap<String, f64>,
    pub kept: String,
    pub text: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WarningKind {
    /// An information.
    Note,
    /// A warning (exit code 3).
    Doubt,
}

/// A finding.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Warning {
    pub kind: WarningKind,
    #[serde(default)]
    pub code: String,
    pub text: String,
    /// The numbers and names in the text.
    #[serde(default)]
    pub values: serde_json::Value,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    Prior,
    Circle,
    Wrist,
    Ball,
    TurnedBall,
    Bar,
}

impl From<&CalibrationResult> for ResultFile {
    fn from(result: &CalibrationResult) -> Self {
        Self {
            schema: 1,
            robot: result.robot.name.clone(),
            start: result.start,
            observations: result.lengths,
            made_from: result.made_from,
            rank: result.rank.nominal,
            rank_at_solution: result.rank.at_solution,
            condition: result.rank.condition,
            observability: result.observability,
            iterations: result.solver.iterations,
            converged: result.solver.converged,
            sigma_mm: result.sigma.mm,
            sigma_source: result.sigma.source,
            sigma_freedom: result.sigma.freedom,
            coverage_factor: result.sigma.coverage_factor,
            prior: result.prior,
            groups: result.joints.iter().flat_map(|joints| &joints.groups).map(ErrorGroup::from).collect(),
            joint_errors: result.joints.clone(),
            monte_carlo: result.monte_carlo.clone(),
            residual_mm: result.residual_mm,
            folds: result.folds,
            validation: result.validation,
            distance: result.distance.clone(),
            predicted_position_error_mm: result.predicted,
            parameters: result.parameters.iter().map(ParameterResult::from).collect(),
            dependent: result.combinations.iter().map(Dependent::from).collect(),
            correlated: result.correlations.clone(),
            advice: result.recommendations.iter().map(Advice::from).collect(),
            joints: result.joint_effects.clone(),
            outliers: result.outliers.clone(),
            warnings: result.diagnostics().map(Warning::from).collect(),
        }
    }
}

impl From<&GroupEvidence> for ErrorGroup {
    fn from(group: &GroupEvidence) -> Self {
        let &GroupEvidence { sd, effective_parameters, rms_mm, share, .. } = group;
        Self {
            name: group.group.name().into(),
            sd,
            effective_parameters,
            rms_mm,
            share,
            text: group.to_string(),
        }
    }
}

impl From<&result::ParameterResult> for ParameterResult {
    fn from(parameter: &result::ParameterResult) -> Self {
        Self {
            name: parameter.id.to_string(),
            unit: parameter.id.unit().to_string(),
            start: parameter.start,
            nominal: parameter.nominal,
            identified: parameter.identified,
            correction: parameter.correction,
            sd: parameter.sd,
            interval95: parameter.interval95,
            monte_carlo: parameter.monte_carlo,
            status: parameter.status(),
            reason: parameter.reason_text(),
        }
    }
}

impl From<&Combination> for Dependent {
    fn from(combination: &Combination) -> Self {
        let members = combination.members.iter().map(|(id, share)| (id.to_string(), *share));
        Self {
            combination: members.collect(),
            kept: combination.kept.to_string(),
            text: combination.to_string(),
        }
    }
}

impl From<&Recommendation> for Advice {
    fn from(recommendation: &Recommendation) -> Self {
        let (kind, ball_mm) = match recommendation.measure {
            FurtherMeasurement::Prior => (Kind::Prior, None),
            FurtherMeasurement::Circle { .. } => (Kind::Circle, None),
            FurtherMeasurement::Wrist { .. } => (Kind::Wrist, None),
            FurtherMeasurement::Ball { at_mm } => (Kind::Ball, Some(at_mm)),
            FurtherMeasurement::TurnedBall { at_mm } => (Kind::TurnedBall, Some(at_mm)),
            FurtherMeasurement::Bar { .. } => (Kind::Bar, None),
        };
        Self {
            kind,
            text: recommendation.to_string(),
            poses: recommendation.poses,
            ball_mm,
            before_mm: recommendation.before_mm,
            after_mm: recommendation.after_mm,
            adds: recommendation.adds,
            tells: recommendation.identifies.iter().map(ToString::to_string).collect(),
        }
    }
}

impl From<Diagnostic> for Warning {
    fn from(finding: Diagnostic) -> Self {
        let kind = match finding.severity() {
            Severity::Info => WarningKind::Note,
            Severity::Warning | Severity::Error => WarningKind::Doubt,
        };
        Self { kind, code: finding.code().to_string(), text: finding.message(), values: finding.values() }
    }
}
