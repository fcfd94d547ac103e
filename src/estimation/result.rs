//! What a calibration found. [`super::Calibration::result`] makes it, complete; nobody fills a field later, and every
//! file, page and line is a function of it.

use std::cmp::Ordering;
use std::ops::Range;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::joint_fit::JointSummary;
use super::priors::Prior;
use super::zero_change::ZeroChange;
use super::{
    Combination, Correlation, DistanceQuantities, ErrorSummary, Observability, PositionParts, Posterior,
};
use crate::catalogue::EstimationFinding;
use crate::diagnostic::{Diagnostic, Severity};
use crate::measurement::{LengthModel, Measurement, Measurements, PreparedMeasurement};
use crate::robot::{BallId, ParamId, Robot};

/// Lengths in mm, angles in rad.
#[derive(Clone, Debug)]
pub struct CalibrationResult {
    /// The identified robot, tool ball included, with the nominal one inside.
    pub robot: Robot,
    /// The robot at the start with the part of the set-up fitted that the user did not fix.
    pub before: LengthModel,
    /// Which robot that is.
    pub start: StartRobot,
    /// The identified robot, set-up and bar, and the covariance of the parameters estimated.
    pub posterior: Posterior,
    /// Measurements used; a position counts once.
    pub lengths: usize,
    pub made_from: MadeFrom,
    pub rank: RankSummary,
    /// Of the identified parameters at the solution, their columns in units of their prior standard deviations; `None`
    /// where nothing was identified.
    pub observability: Option<Observability>,
    pub solver: SolverSummary,
    pub sigma: SigmaSummary,
    pub prior: Option<PriorUsed>,
    /// Errors of the joints, where the evidence speaks for them.
    pub joints: Option<JointSummary>,
    pub monte_carlo: Option<MonteCarlo>,
    pub residual_mm: BeforeAfter,
    pub folds: Option<Folds>,
    /// Residuals of separate lengths.
    pub validation: Option<BeforeAfter>,
    /// Where poses were visited more than once.
    pub distance: Option<DistanceQuantities>,
    pub predicted: PredictedPair,
    /// What the bar and the noise contribute to it.
    pub position_parts: PositionParts,
    /// Position uncertainty of the identified robot over the workspace.
    pub map: Vec<MapPoint>,
    /// Every parameter of the model.
    pub parameters: Vec<ParameterResult>,
    /// Linearly dependent parameters: the combinations that are identifiable.
    pub combinations: Vec<Combination>,
    /// Pairs of estimated parameters with |r| > 0.9, strongest first, at most ten.
    pub correlations: Vec<Correlation>,
    /// Further measurements that would help, best first.
    pub recommendations: Vec<Recommendation>,
    /// What the residuals show at single joints beyond chance, strongest first.
    pub joint_effects: Vec<JointEffect>,
    /// The change of a bar's zero, or of the tracker's frame, amid the data that the residuals show most.
    pub zero_change: Option<ZeroChange>,
    pub outliers: Vec<Outlier>,
    pub findings: Vec<EstimationFinding>,
    /// What was found in the inputs before, as in a run.
    pub input_findings: Vec<Diagnostic>,
}

impl CalibrationResult {
    /// All findings, those of the estimate first.
    pub fn diagnostics(&self) -> impl Iterator<Item = Diagnostic> {
        self.findings.iter().cloned().map(Diagnostic::from).chain(self.input_findings.iter().cloned())
    }

    /// Whether a finding throws doubt on the result.
    pub fn is_doubtful(&self) -> bool {
        self.diagnostics().any(|finding| finding.code.severity() != Severity::Info)
    }

    /// The parameter `id`, if the model has it.
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
            before: reading.length_mm - before.length(&reading),
            after: reading.length_mm - after.length(&reading),
        })
    }

    /// With a finding of its inputs that it showed itself; a doubt goes along with the robot.
    pub fn with_finding(mut self, finding: Diagnostic) -> Self {
        if finding.code.severity() == Severity::Warning {
            self.robot.doubts.push(finding.code.to_string());
            self.robot.doubts.sort();
        }
        self.input_findings.push(finding);
        self
    }

    /// Whether the observation at this place of the table is used.
    pub fn uses(&self, place: usize) -> bool {
        let against = |outlier: &Outlier| match &outlier.places {
            places if places.contains(&place) => Ordering::Equal,
            places => places.start.cmp(&place),
        };
        self.outliers.binary_search_by(against).is_err()
    }
}

/// The residuals of one observation, mm: with the nominal robot in the fitted set-up, and with the identified robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResidualPair {
    pub before: f64,
    pub after: f64,
}

/// The robot that "before" is about.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StartRobot {
    #[default]
    Nominal,
    /// As an earlier run identified it.
    Identified,
}

/// Rank of the scaled Jacobian of the parameters asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RankSummary {
    pub nominal: usize,
    pub at_solution: usize,
    /// Of the unit-norm columns of the base set.
    pub condition: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SolverSummary {
    pub iterations: usize,
    pub converged: bool,
}

/// The standard deviation of a length that the uncertainties go by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SigmaSummary {
    pub mm: f64,
    pub source: SigmaSource,
    /// Degrees of freedom of an estimated one.
    pub freedom: Option<f64>,
    /// Half width of a 95 % interval in standard deviations: Student's where sigma was estimated, normal where it was
    /// given; `None` where nothing is known of the lengths.
    pub coverage_factor: Option<f64>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SigmaSource {
    /// By the user, or the data's `sigma_mm`.
    Given,
    /// From the residuals.
    Estimated,
    /// Nothing is given, and no length is left over to estimate it.
    #[default]
    Assumed,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BeforeAfter {
    /// Nominal robot.
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

/// Predicted position uncertainty over the workspace: of the nominal robot by its tolerance, and of the identified one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PredictedPair {
    pub nominal: ErrorSummary,
    pub identified: ErrorSummary,
}

/// Where the ball is (robot base, mm) and the root mean square of its predicted position error there, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapPoint {
    pub position: Vector3<f64>,
    pub rms_mm: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PriorUsed {
    pub source: PriorSource,
    /// Factor on its standard deviations: above 1 where the tolerance of the robot's file is too small for the lengths.
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
    /// What an earlier identification left.
    Posterior,
}

/// A Monte Carlo of the uncertainties.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MonteCarlo {
    pub trials: usize,
    /// Trials whose fit converged.
    pub used: usize,
    /// Parameters whose interval differs from the linear one by more than chance.
    pub disagree: Vec<ParamId>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct ParameterResult {
    pub id: ParamId,
    pub start: f64,
    pub nominal: f64,
    /// Value found, or the one at which it was fixed.
    pub identified: f64,
    /// Identified minus nominal.
    pub correction: f64,
    /// Standard deviation; `None` of what was not estimated.
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

/// The status of a parameter. The words in `result.json` are those of its first schema.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    Identified,
    /// Another member of its combination carries it.
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
    /// It represents a combination, which the prior shares out among its members or not.
    IdentifiedFor {
        combination: Combination,
        shared: bool,
    },
    /// The lengths determine only this combination of it; the prior shares it out.
    PriorShares {
        combination: Option<Combination>,
    },
    /// The lengths alone leave this standard deviation.
    PriorCarries {
        data_sd: f64,
    },
    /// Its group's variance is set by the evidence; the share of it that the lengths determine.
    ByEvidence {
        determined: f64,
    },
    Dependent {
        combination: Option<Combination>,
    },
    FixedAsAsked,
    NotAsked,
    ChangesNoLength,
    /// Poses leave a place open by more than this.
    Open {
        limit: f64,
    },
    /// Its standard deviation would be larger than this.
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

/// A further measurement that was tried on the model.
#[derive(Clone, Debug, PartialEq)]
pub struct Recommendation {
    pub measure: FurtherMeasurement,
    /// Lengths to be measured.
    pub poses: usize,
    /// Predicted mean position error of the result as it is, mm.
    pub before_mm: f64,
    /// The same with it and a prior (that of the result, else the datasheet's), mm.
    pub after_mm: f64,
    /// Whether the result itself has no prior.
    pub needs_prior: bool,
    /// Whether it lowers the error by more than 3 % of what the prior alone leaves.
    pub adds: bool,
    /// Parameters that it would identify and that are not identified now.
    pub identifies: Vec<ParamId>,
}

/// What could be measured.
#[derive(Clone, Debug, PartialEq)]
pub enum FurtherMeasurement {
    /// Nothing: the same lengths with the tolerance of the robot's file as prior.
    Prior,
    /// Circles in other planes about the same ball.
    Circle { planes: Vec<CirclePlane> },
    /// The same places with the wrist turned more.
    Wrist { degrees: f64 },
    /// A further ball (robot base, mm).
    Ball { at_mm: [f64; 3] },
    /// The same poses and ball, turned about axis 1.
    TurnedBall { at_mm: [f64; 3] },
    /// Another length of the bar on the same ball.
    Bar { length_mm: f64 },
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CirclePlane {
    Xy,
    Xz,
    Yz,
    /// XY tilted by so many degrees.
    TiltedAboutX(f64),
    TiltedAboutY(f64),
}

/// An error of a joint that the residuals show and the model lacks.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct JointEffect {
    /// From 1.
    pub axis: usize,
    pub error: JointError,
    /// What it does to the lengths beyond what the fit has taken up, root mean square, mm.
    pub rms_mm: f64,
    /// The whole reversal error, rad.
    pub play_rad: Option<f64>,
    /// The chance of such residuals on a sound joint, before the number of tests counts.
    pub chance: f64,
    /// The same as a normal deviate.
    pub z: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JointError {
    /// It returns with the axis angle: transmission error, or sag.
    Angle,
    /// It goes with the sense of the motion: backlash, or lag.
    Reversal,
}

/// A measurement that is not used.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Outlier {
    /// The places of its rows among the observations.
    #[serde(skip)]
    pub places: Range<usize>,
    /// The observation's index.
    pub index: u32,
    /// None of a position.
    #[serde(rename = "centre")]
    pub ball: Option<BallId>,
    /// Of a position the distance.
    pub residual_mm: f64,
}

/// What a result was made from: the measurements used, by their kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct MadeFrom {
    pub lengths: usize,
    pub positions: usize,
    /// On the tool, the tool ball among them.
    pub targets: usize,
}

impl MadeFrom {
    pub(super) fn of(observations: &Measurements, outliers: &[Outlier]) -> Self {
        let positions = observations.positions().count();
        let out = outliers.iter().filter(|outlier| outlier.ball.is_none()).count();
        Self {
            lengths: observations.count() - positions - (outliers.len() - out),
            positions: positions - out,
            targets: observations.targets(),
        }
    }
}
