//! The result of a calibration. [`super::Calibration::result`] makes it; every file, page and message is a function of it.

use std::ops::Range;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::joint_fit::JointSummary;
use super::priors::Prior;
use super::zero_change::ZeroChange;
use super::{
    Combination, Correlation, DistanceQuantities, ErrorSummary, Observability, PositionParts, Posterior,
};
use crate::diagnostic::{Diagnostic, Severity};
use crate::estimation::EstimationFinding;
use crate::measurement::{LengthModel, Measurement, Measurements, PreparedMeasurement};
use crate::robot::{BallId, ParamId, Robot};

/// Lengths in mm, angles in rad.
#[derive(Clone, Debug)]
pub struct CalibrationResult {
    /// The identified robot, with its tool ball; it contains the nominal robot.
    pub robot: Robot,
    /// The robot at the start, with the free part of the set-up fitted.
    pub before: LengthModel,
    pub start: StartRobot,
    /// The identified robot, set-up and bar with the covariance of the estimated parameters.
    pub posterior: Posterior,
    /// Number of used measurements; a position counts once.
    pub lengths: usize,
    pub made_from: MadeFrom,
    pub rank: RankSummary,
    /// Of the identified parameters at the solution, in units of their prior standard deviations.
    pub observability: Option<Observability>,
    pub solver: SolverSummary,
    pub sigma: SigmaSummary,
    pub prior: Option<PriorUsed>,
    /// Errors of the joints, if the evidence supports them.
    pub joints: Option<JointSummary>,
    pub monte_carlo: Option<MonteCarlo>,
    pub residual_mm: BeforeAfter,
    pub folds: Option<Folds>,
    /// Residuals of separate lengths.
    pub validation: Option<BeforeAfter>,
    /// If poses were measured more than once.
    pub distance: Option<DistanceQuantities>,
    pub predicted: PredictedPair,
    pub position_parts: PositionParts,
    /// Position uncertainty of the identified robot over the workspace.
    pub map: Vec<MapPoint>,
    /// Every parameter of the model.
    pub parameters: Vec<ParameterResult>,
    pub combinations: Vec<Combination>,
    pub correlations: Vec<Correlation>,
    /// Further measurements that would help, best first.
    pub recommendations: Vec<Recommendation>,
    /// Significant errors of single joints in the residuals, strongest first.
    pub joint_effects: Vec<JointEffect>,
    /// The most significant change of a bar's zero or of the tracker's frame.
    pub zero_change: Option<ZeroChange>,
    pub outliers: Vec<Outlier>,
    pub findings: Vec<EstimationFinding>,
    /// Findings about the inputs.
    pub input_findings: Vec<Diagnostic>,
}

impl CalibrationResult {
    /// All findings, those of the estimate first.
    pub fn diagnostics(&self) -> impl Iterator<Item = Diagnostic> {
        self.findings.iter().cloned().map(Diagnostic::from).chain(self.input_findings.iter().cloned())
    }

    /// Whether a finding is more severe than an information.
    pub fn is_doubtful(&self) -> bool {
        self.diagnostics().any(|finding| finding.severity() != Severity::Info)
    }

    pub fn parameter(&self, id: ParamId) -> Option<&ParameterResult> {
        self.parameters.iter().find(|parameter| parameter.id == id)
    }

    pub fn count(&self, status: Status) -> usize {
        self.parameters.iter().filter(|parameter| parameter.status() == status).count()
    }

    /// The residuals of observations, measured minus predicted.
    pub fn residuals<'a>(
        &'a self,
        rows: impl IntoIterator<Item = &'a Measurement>,
    ) -> impl Iterator<Item = ResidualPair> {
        let (before, after) = (self.before.prepare(), self.posterior.model.prepare());
        rows.into_iter().map(PreparedMeasurement::from).map(move |reading| ResidualPair {
            before: before.residual(&reading),
            after: after.residual(&reading),
        })
    }

    /// Adds a finding about the inputs. A warning is also stored with the robot.
    pub fn with_finding(mut self, finding: Diagnostic) -> Self {
        if finding.severity() == Severity::Warning {
            self.robot.doubts.push(finding.code().to_string());
            self.robot.doubts.sort();
        }
        self.input_findings.push(finding);
        self
    }

    /// Whether row number `place` of the observations is used.
    pub fn uses(&self, place: usize) -> bool {
        let next = self.outliers.partition_point(|outlier| outlier.places.end <= place);
        self.outliers.get(next).is_none_or(|outlier| !outlier.places.contains(&place))
    }
}

/// The residuals of one observation, mm: with the robot at the start in the fitted set-up, and with the identified robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResidualPair {
    pub before: f64,
    pub after: f64,
}

/// The robot at the start of the fit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StartRobot {
    #[default]
    Nominal,
    /// As identified by an earlier run.
    Identified,
}

/// Rank of the scaled Jacobian of the parameters asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RankSummary {
    pub nominal: usize,
    pub at_solution: usize,
    /// Condition number of the base set, columns scaled to unit norm.
    pub condition: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SolverSummary {
    pub iterations: usize,
    pub converged: bool,
}

/// The standard deviation of a length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SigmaSummary {
    pub mm: f64,
    pub source: SigmaSource,
    /// Degrees of freedom, if it was estimated.
    pub freedom: Option<f64>,
    /// Coverage factor of a 95 % interval: Student's t if sigma was estimated, normal if it was given, `None` if it is
    /// unknown.
    pub coverage_factor: Option<f64>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SigmaSource {
    /// From the user, or `sigma_mm` of the data.
    Given,
    /// From the residuals.
    Estimated,
    /// Not given, and there are too few lengths to estimate it.
    #[default]
    Assumed,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BeforeAfter {
    /// Robot at the start.
    pub before: Residual,
    /// Identified robot.
    pub after: Residual,
}

/// Residuals of lengths, mm; `max` is the largest magnitude.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Residual {
    pub rms: f64,
    pub mean: f64,
    pub max: f64,
}

/// Root mean square of the held-out residuals of a cross-validation, mm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Folds {
    pub folds: usize,
    pub rms: f64,
}

/// Predicted position uncertainty over the workspace, of the nominal robot by its tolerance and of the identified one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PredictedPair {
    pub nominal: ErrorSummary,
    pub identified: ErrorSummary,
}

/// A position of the tool ball (robot base, mm) and its predicted position error (root mean square, mm).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapPoint {
    pub position: Vector3<f64>,
    pub rms_mm: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PriorUsed {
    pub source: PriorSource,
    /// Factor on its standard deviations: above 1 if the default tolerance was widened to fit the lengths.
    pub scale: f64,
}

impl PriorUsed {
    pub(super) fn of(prior: &Prior, scale: f64) -> Option<Self> {
        let source = match prior {
            Prior::None => return None,
            Prior::Datasheet => PriorSource::Datasheet,
            Prior::Given(_) => PriorSource::File,
            Prior::Posterior => PriorSource::Posterior,
        };
        Some(Self { source, scale })
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PriorSource {
    Datasheet,
    File,
    /// That of an earlier identification.
    Posterior,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MonteCarlo {
    pub trials: usize,
    /// Trials whose fit converged.
    pub used: usize,
    /// Parameters whose interval differs significantly from the linearised one.
    pub disagree: Vec<ParamId>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct ParameterResult {
    pub id: ParamId,
    pub start: f64,
    pub nominal: f64,
    /// Estimated, or the value at which it was fixed.
    pub identified: f64,
    /// Identified minus nominal.
    pub correction: f64,
    /// Standard deviation; `None` if it was not estimated.
    pub sd: Option<f64>,
    pub interval95: Option<[f64; 2]>,
    pub monte_carlo: Option<ParameterDraws>,
    pub reason: Reason,
}

impl ParameterResult {
    pub fn status(&self) -> Status {
        self.reason.status()
    }
}

/// The status of a parameter; the names in `result.json` are those of schema 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    Identified,
    /// Linearly dependent; another member of its combination is estimated.
    Dependent,
    #[serde(rename = "held")]
    Fixed,
    #[serde(rename = "too_weak")]
    PoorlyObservable,
    /// Estimated with the help of the prior.
    Prior,
}

/// Why a parameter has its status.
#[derive(Clone, Debug, PartialEq)]
pub enum Reason {
    Identified,
    /// As a member of a combination; `shared` if the prior distributes it among several members.
    IdentifiedFor {
        combination: Combination,
        shared: bool,
    },
    /// The lengths determine only the combination; the prior distributes it.
    PriorShares {
        combination: Option<Combination>,
    },
    /// By the prior: the lengths alone give only this standard deviation.
    PriorCarries {
        data_sd: f64,
    },
    /// With a variance of its group by the evidence; the fraction of it that the lengths determine.
    ByEvidence {
        determined: f64,
    },
    Dependent {
        combination: Option<Combination>,
    },
    FixedAsAsked,
    NotAsked,
    ChangesNoLength,
    /// A place whose standard deviation would exceed the limit.
    Open {
        limit: f64,
    },
    /// Its standard deviation would exceed the limit.
    PoorlyObservable {
        limit: f64,
    },
}

impl Reason {
    pub fn status(&self) -> Status {
        match self {
            Self::Identified | Self::IdentifiedFor { .. } => Status::Identified,
            Self::ByEvidence { determined } if *determined > 0.5 => Status::Identified,
            Self::PriorShares { .. } | Self::PriorCarries { .. } | Self::ByEvidence { .. } => Status::Prior,
            Self::Dependent { .. } => Status::Dependent,
            Self::FixedAsAsked | Self::NotAsked | Self::ChangesNoLength => Status::Fixed,
            Self::Open { .. } | Self::PoorlyObservable { .. } => Status::PoorlyObservable,
        }
    }
}

/// Standard deviation and 95 % interval of a parameter by Monte Carlo.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ParameterDraws {
    pub sd: f64,
    pub interval95: [f64; 2],
}

/// A further measurement with its simulated effect.
#[derive(Clone, Debug, PartialEq)]
pub struct Recommendation {
    pub measure: FurtherMeasurement,
    /// Number of lengths to measure.
    pub poses: usize,
    /// Predicted mean position error of the result, mm.
    pub before_mm: f64,
    /// The same with the measurement and a prior (that of the result, else the datasheet's), mm.
    pub after_mm: f64,
    /// Whether the result has no prior.
    pub needs_prior: bool,
    /// Whether it lowers the error with the prior alone by more than 3 %.
    pub adds: bool,
    /// Parameters that it would identify and that are not identified now.
    pub identifies: Vec<ParamId>,
}

#[derive(Clone, Debug, PartialEq)]
pub enum FurtherMeasurement {
    /// The same lengths with the tolerance of the robot's file as prior.
    Prior,
    /// Circles in other planes about the same ball.
    Circle { planes: Vec<CirclePlane> },
    /// The same positions with other wrist orientations.
    Wrist { degrees: f64 },
    /// A further ball (robot base, mm).
    Ball { at_mm: [f64; 3] },
    /// The same poses and ball, rotated about axis 1.
    TurnedBall { at_mm: [f64; 3] },
    /// Another length of the bar on the same ball.
    Bar { length_mm: f64 },
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CirclePlane {
    Xy,
    Xz,
    Yz,
    /// XY tilted, degrees.
    TiltedAboutX(f64),
    TiltedAboutY(f64),
}

/// An error of a joint that the model lacks, found in the residuals.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct JointEffect {
    /// From 1.
    pub axis: usize,
    pub error: JointError,
    /// Its effect on the lengths that the fit does not compensate, root mean square, mm.
    pub rms_mm: f64,
    /// The reversal error, rad.
    pub play_rad: Option<f64>,
    /// The p-value of the single test.
    pub chance: f64,
    /// The same as a normal deviate.
    pub z: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JointError {
    /// A function of the joint angle: transmission error, or sag.
    Angle,
    /// Depends on the sense of motion: backlash, or lag.
    Reversal,
}

/// A measurement that is not used.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Outlier {
    /// Its row numbers in the observations.
    #[serde(skip)]
    pub places: Range<usize>,
    /// Its index column.
    pub index: u32,
    /// `None` for a position.
    #[serde(rename = "centre")]
    pub ball: Option<BallId>,
    /// For a position the 3-D distance.
    pub residual_mm: f64,
}

/// The number of used measurements by their kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct MadeFrom {
    pub lengths: usize,
    pub positions: usize,
    /// Targets on the tool, including the tool ball.
    pub targets: usize,
}

impl MadeFrom {
    pub(super) fn of(observations: &Measurements, outliers: &[Outlier]) -> Self {
        let positions = observations.positions().count();
        let rejected_positions = outliers.iter().filter(|outlier| outlier.ball.is_none()).count();
        Self {
            lengths: observations.count() - positions - (outliers.len() - rejected_positions),
            positions: positions - rejected_positions,
            targets: observations.targets(),
        }
    }
}
