//! The result of a calibration: [`CalibrationResult`] is what `result.json` holds, written and read as it is.
//! [`CompletedCalibration`] adds the models from which other files and the pages are made.

use std::ops::Range;

use nalgebra::{DMatrix, Vector3};
use serde::{Deserialize, Serialize};

use super::estimator::{GroupEvidence, JointSummary};
use super::hypotheses::RunHypothesis;
use super::options::ErrorModel;
use super::priors::Prior;
use super::{Combination, Correlation, DistanceQuantities, ErrorSummary, Observability, Posterior};
use crate::base::serialised::Seal;
use crate::diagnostic::{Diagnostic, RecordedFinding, Severity};
use crate::estimation::ResultFinding;
use crate::math::distributions::COVERAGE_FACTOR;
use crate::measurement::{LengthModel, Measurement, Measurements, PreparedMeasurement};
use crate::robot::{AXES, BallId, ParamId, ParamUnit, Robot};

/// The schema of `result.json`.
pub(super) const RESULT_SCHEMA: u32 = 2;

/// `result.json`, schema 2. Lengths in mm, angles in rad.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CalibrationResult {
    /// 2, the schema of this type.
    pub schema: u32,
    /// Name of the robot.
    pub robot: String,
    pub model: ErrorModel,
    /// The robot to which `before` refers.
    pub start: StartRobot,
    pub prior: PriorSource,
    /// Factor on the maker's tolerance that the evidence asks for, at least 1; `None` if a list of parameters was
    /// estimated without a prior.
    pub prior_scale: Option<f64>,
    /// Number of used measurements; a position counts once.
    pub measurements: usize,
    pub made_from: MadeFrom,
    /// What the measurements cost; absent in results of earlier versions, as `max_uncertainty`.
    #[serde(default)]
    pub effort: Option<Effort>,
    /// Rank of the scaled Jacobian of the parameters asked for, at the nominal geometry with the fitted set-up.
    pub rank: usize,
    pub rank_at_solution: usize,
    /// Condition number of the base set, columns scaled to unit norm.
    pub condition: f64,
    /// Observability of the identified parameters at the solution, in units of their prior standard deviations.
    pub observability: Option<Observability>,
    /// Iterations of the solver.
    pub iterations: usize,
    pub converged: bool,
    pub noise_mm: NoiseSummary,
    /// Source of `noise_mm.length`.
    pub sigma_source: SigmaSource,
    /// Coverage factor of a 95 % interval: Student's t if sigma was estimated, normal if it was given, `None` if it is
    /// unknown.
    pub coverage_factor: Option<f64>,
    pub residual_mm: BeforeAfter,
    pub folds: Option<Folds>,
    /// Residuals of separate lengths.
    pub validation: Option<BeforeAfter>,
    /// Quantities along the bar, if poses were measured more than once.
    pub distance: Option<DistanceQuantities>,
    /// The evidence for each group of errors.
    pub groups: Vec<GroupEvidence>,
    /// Errors of the joints, if the evidence supports them.
    pub joint_errors: Option<JointSummary>,
    /// Events that happened while the lengths were measured, or could have happened.
    pub hypotheses: Vec<RunHypothesis>,
    pub monte_carlo: Option<MonteCarlo>,
    pub predicted_position_uncertainty_mm: PredictedPair,
    /// Predicted orientation uncertainty of the flange over some of the same poses; absent in results of earlier
    /// versions.
    #[serde(default)]
    pub predicted_orientation_uncertainty_mrad: Option<PredictedPair>,
    /// Where the uncertainty of the tool ball is largest.
    #[serde(default)]
    pub max_uncertainty: Option<MaxUncertainty>,
    /// For which tool, payload and time the result holds.
    pub validity: Option<Validity>,
    /// Every parameter of the model.
    pub parameters: Vec<ParameterResult>,
    pub combinations: Vec<Combination>,
    /// Strongly correlated pairs, strongest first.
    pub correlated: Vec<Correlation>,
    pub outliers: Vec<Outlier>,
    /// Measurements that were left out on request.
    #[serde(default)]
    pub excluded: Vec<ExcludedMeasurement>,
    /// Further measurements that would help, best first.
    pub recommendations: Vec<Recommendation>,
    /// Findings of the estimate first, then findings about the inputs.
    pub findings: Vec<RecordedFinding>,
}

impl CalibrationResult {
    /// Reads the text of a `result.json`.
    ///
    /// # Errors
    /// The text is not a result of this schema, or it was edited.
    pub fn from_json(file: &str, text: &str) -> Result<Self, Diagnostic> {
        Seal::Json.check(text).map_err(|finding| Diagnostic::file(file, finding))?;
        let wrong = |finding: ResultFinding| Diagnostic::file(file, finding);
        let json = serde_json::from_str(text)
            .map_err(|error| wrong(ResultFinding::NotJson { why: error.to_string() }))?;
        Self::from_value(json).map_err(wrong)
    }

    /// # Errors
    /// The JSON is not a result of this schema.
    pub fn from_value(json: serde_json::Value) -> Result<Self, ResultFinding> {
        check_schema(&json, RESULT_SCHEMA)?;
        serde_json::from_value(json).map_err(|error| ResultFinding::Incomplete { why: error.to_string() })
    }

    pub fn parameter(&self, id: ParamId) -> Option<&ParameterResult> {
        self.parameters.iter().find(|parameter| parameter.name == id)
    }

    pub fn count(&self, status: Status) -> usize {
        self.parameters.iter().filter(|parameter| parameter.status == status).count()
    }

    /// The findings that are more severe than an information.
    pub fn warnings(&self) -> impl Iterator<Item = &RecordedFinding> {
        self.findings.iter().filter(|finding| finding.severity() != Severity::Info)
    }

    /// Whether a finding is more severe than an information.
    pub fn has_warnings(&self) -> bool {
        self.warnings().next().is_some()
    }
}

/// Checks the key `schema` of the JSON of a result.
///
/// # Errors
/// The key is missing, or its value is not `known`.
pub fn check_schema(json: &serde_json::Value, known: u32) -> Result<(), ResultFinding> {
    match json.get("schema") {
        Some(schema) if schema.as_u64() == Some(u64::from(known)) => Ok(()),
        schema => {
            let schema = schema.map_or("none".into(), ToString::to_string);
            Err(ResultFinding::OtherSchema { schema, known })
        }
    }
}

/// A result with the models behind it, as [`super::Calibration::complete`] makes it. Every file, page and message is a
/// function of it.
#[derive(Clone, Debug)]
pub struct CompletedCalibration {
    pub result: CalibrationResult,
    /// The identified robot, with its tool ball; it contains the nominal robot.
    pub robot: Robot,
    /// The robot at the start, with the free part of the set-up fitted.
    pub before: LengthModel,
    /// The identified robot, set-up and bar with the covariance of the estimated parameters.
    pub posterior: Posterior,
    pub position_parts: PositionParts,
    /// Position uncertainty of the identified robot over the workspace.
    pub map: Vec<MapPoint>,
    /// Rows of the observations that are not used: a range for each outlier, in their order.
    pub excluded_rows: Vec<Range<usize>>,
    /// What certain events added to each length, mm; empty if there was none.
    pub(super) event_mm: Vec<f64>,
    /// Rows whose ball number is wrong, ascending, with their own ball.
    pub(super) wrong_balls: Vec<(usize, BallId)>,
    /// Number of the findings of the estimate. They are the first ones of the result; the others are about the inputs.
    pub(super) of_estimate: usize,
}

impl CompletedCalibration {
    /// All findings as they were made, findings of the estimate first.
    pub fn diagnostics(&self) -> impl Iterator<Item = Diagnostic> {
        self.result.findings.iter().filter_map(RecordedFinding::made).cloned()
    }

    /// The findings about the inputs.
    pub fn input_findings(&self) -> Vec<Diagnostic> {
        self.diagnostics().skip(self.of_estimate).collect()
    }

    /// The residuals of rows of the observations, measured minus predicted, as the fit has them: without what certain
    /// events added, and each to its own ball.
    pub fn residuals<'a>(
        &'a self,
        rows: impl IntoIterator<Item = (usize, &'a Measurement)>,
    ) -> impl Iterator<Item = ResidualPair> {
        let (before, after) = (self.before.prepare(), self.posterior.model.prepare());
        rows.into_iter().map(move |(place, row)| {
            let mut reading = PreparedMeasurement::from(row);
            reading.length_mm -= self.event_mm.get(place).copied().unwrap_or(0.0);
            if let Ok(wrong) = self.wrong_balls.binary_search_by_key(&place, |(place, _)| *place) {
                reading.datum = reading.datum.to_ball(self.wrong_balls[wrong].1);
            }
            ResidualPair { before: before.residual(&reading), after: after.residual(&reading) }
        })
    }

    /// Lists measurements that were left out of the fit, with who did it and why.
    pub fn with_excluded(mut self, rows: &[Measurement], by: Option<&str>, reason: Option<&str>) -> Self {
        let after = self.posterior.model.prepare();
        let excluded = |row: &Measurement| ExcludedMeasurement {
            index: row.index,
            ball: row.datum.ball(),
            axes_deg: row.axes.degrees(),
            residual_mm: after.residual(&PreparedMeasurement::from(row)),
            by: by.map(str::to_owned),
            reason: reason.map(str::to_owned),
        };
        self.result.excluded.extend(rows.iter().map(excluded));
        self
    }

    /// Whether row number `place` of the observations is used.
    pub fn uses(&self, place: usize) -> bool {
        let next = self.excluded_rows.partition_point(|rows| rows.end <= place);
        self.excluded_rows.get(next).is_none_or(|rows| !rows.contains(&place))
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

/// The noise of the measurements, one standard deviation, mm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct NoiseSummary {
    /// Standard deviation of a length: root mean square over the used lengths.
    pub length: f64,
    /// Standard deviation of the pose in each direction, if it was separated from the rest.
    pub pose: Option<f64>,
    /// Standard deviation of a length without the noise of the pose, if it was separated from the rest.
    pub instrument: Option<f64>,
    /// Degrees of freedom of `length`, if it was estimated.
    pub degrees_of_freedom: Option<f64>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SigmaSource {
    /// Given by the user, or as `sigma_mm` in the data.
    Given,
    /// Estimated from the residuals.
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

/// Contributions to the position error of the identified robot: root mean square over robots and poses, mm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PositionParts {
    /// The error of the bar's length.
    pub bar_mm: f64,
    /// The noise of the lengths.
    pub noise_mm: f64,
    /// Backlash, where no sense of approach is known.
    pub backlash_mm: f64,
}

/// A predicted uncertainty over the workspace: of the nominal robot with its tolerance, and of the identified robot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PredictedPair {
    pub nominal: ErrorSummary,
    pub identified: ErrorSummary,
}

/// What a calibration is valid for, as it is stated in one line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Validity {
    /// The point on the tool for which the calibration is valid, in the flange frame, mm.
    pub tool_mm: [f64; 3],
    /// Mass of the payload with which the uncertainty is computed, kg; `None` if the robot file states none.
    pub payload_kg: Option<f64>,
    /// Day of the measurements, if it is known.
    pub measured: Option<String>,
    /// Expanded uncertainty U (k = 2) on that day: twice the root of the mean square of the 3-D error over the workspace, mm.
    pub expanded_uncertainty_mm: f64,
    /// The expanded uncertainty at which the validity ends, mm, which follows from the user's tolerance; `None` without one.
    pub limit_mm: Option<f64>,
    /// Months from the day of the measurements until U reaches the limit, at most twelve.
    pub months: Option<f64>,
    /// The day on which the validity ends, if there is a limit and the day of the measurements is known.
    pub until: Option<String>,
    pub basis: DriftBasis,
    /// The same day's expanded uncertainty with the payload for which such an arm is made, if that was not measured. Absent in
    /// results of earlier versions.
    #[serde(default)]
    pub rated_payload: Option<PayloadUncertainty>,
}

/// The expanded uncertainty with a payload that the robot did not carry when it was measured.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PayloadUncertainty {
    /// Mass of the payload.
    pub kg: f64,
    /// U (k = 2), as [`Validity::expanded_uncertainty_mm`].
    pub expanded_uncertainty_mm: f64,
}

/// What the measurements cost.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Effort {
    /// Poses one after the other; those that are visited again count again.
    pub poses: usize,
    /// From the first to the last pose of each run, in sum; `None` if no times are known.
    pub minutes: Option<f64>,
    /// What an hour more of the same poses would give.
    pub hour_more: Option<MoreOfTheSame>,
}

/// The prediction for more measurements of the same poses.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MoreOfTheSame {
    /// Number of further measurements.
    pub measurements: usize,
    /// An upper bound of the expanded uncertainty (k = 2) with them, mm.
    pub expanded_uncertainty_mm: f64,
}

/// The place of the workspace with the largest predicted position uncertainty.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MaxUncertainty {
    /// The tool ball in the robot base, mm.
    pub position_mm: [f64; 3],
    /// Expanded uncertainty there (k = 2): twice the root of the mean square of the 3-D error, mm.
    pub expanded_uncertainty_mm: f64,
}

/// The source of the drift of a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DriftBasis {
    /// Hyper-priors: this robot has no history of three runs.
    HyperPrior,
    /// Earlier measurements of this robot.
    History,
}

/// A position of the tool ball (robot base, mm) and its predicted position uncertainty (root mean square, mm).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapPoint {
    pub position: Vector3<f64>,
    pub rms_mm: f64,
}

impl MapPoint {
    /// The root mean square over the robots of displacements (3 rows for each place, a column for each robot, mm).
    pub fn map(places: &[Vector3<f64>], displacements: &DMatrix<f64>) -> Vec<Self> {
        let robots = displacements.ncols().max(1) as f64;
        let rms = |pose: usize| (displacements.rows(3 * pose, 3).norm_squared() / robots).sqrt();
        let point =
            |(pose, position): (usize, &Vector3<f64>)| Self { position: *position, rms_mm: rms(pose) };
        places.iter().enumerate().map(point).collect()
    }

    /// The point with the largest uncertainty.
    pub fn max_uncertainty(map: &[Self]) -> Option<MaxUncertainty> {
        let worst = map.iter().max_by(|one, other| one.rms_mm.total_cmp(&other.rms_mm))?;
        Some(MaxUncertainty {
            position_mm: worst.position.into(),
            expanded_uncertainty_mm: COVERAGE_FACTOR * worst.rms_mm,
        })
    }

    /// Root mean square over all points of a map, mm.
    pub fn root_mean_square_mm(map: &[Self]) -> f64 {
        let square: f64 = map.iter().map(|point| point.rms_mm.powi(2)).sum();
        (square / map.len().max(1) as f64).sqrt()
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PriorSource {
    /// No prior was asked for.
    None,
    Datasheet,
    File,
    /// The posterior of an earlier identification.
    Posterior,
}

impl From<&Prior> for PriorSource {
    fn from(prior: &Prior) -> Self {
        match prior {
            Prior::None => Self::None,
            Prior::Datasheet => Self::Datasheet,
            Prior::Given(_) => Self::File,
            Prior::Posterior => Self::Posterior,
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MonteCarlo {
    pub trials: usize,
    /// Trials whose fit converged.
    pub used: usize,
    /// Parameters whose interval differs significantly from the linearised one.
    pub disagree: Vec<ParamId>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ParameterResult {
    pub name: ParamId,
    pub unit: ParamUnit,
    pub start: f64,
    pub nominal: f64,
    /// The estimated value, or the value at which the parameter was fixed.
    pub identified: f64,
    /// Identified minus nominal.
    pub correction: f64,
    /// Standard deviation; `None` if it was not estimated.
    pub sd: Option<f64>,
    /// Standard deviation of the prior that the estimate used; `None` without one.
    pub prior_sd: Option<f64>,
    pub interval95: Option<[f64; 2]>,
    pub monte_carlo: Option<ParameterDraws>,
    pub status: Status,
    /// Why the parameter has its status, in words; empty if it is identified by itself.
    pub reason: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    Identified,
    /// Estimated with the help of the prior.
    SupportedByPrior,
    /// Its standard deviation would exceed the limit.
    PoorlyObservable,
    /// Linearly dependent; another member of its combination is estimated.
    Dependent,
    Fixed,
}

/// Standard deviation and 95 % interval of a parameter by Monte Carlo.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ParameterDraws {
    pub sd: f64,
    pub interval95: [f64; 2],
}

/// A further measurement with its simulated effect.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Recommendation {
    #[serde(flatten)]
    pub measure: FurtherMeasurement,
    /// Number of lengths to measure.
    pub poses: usize,
    /// Predicted mean position error of the result, mm.
    pub before_mm: f64,
    /// Predicted mean position error with the further measurement, mm.
    pub after_mm: f64,
    /// Whether the measurement lowers the error by more than 3 %.
    pub adds: bool,
    /// Parameters that the measurement would identify and that are not identified now.
    pub identifies: Vec<ParamId>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum FurtherMeasurement {
    /// Circles in other planes about the same ball.
    Circle { planes: Vec<CirclePlane> },
    /// The same positions with other wrist orientations.
    Wrist { degrees: f64 },
    /// A further ball (robot base, mm).
    Ball { ball_mm: [f64; 3] },
    /// The same poses and ball, rotated about axis 1.
    TurnedBall { ball_mm: [f64; 3] },
    /// Another length of the bar on the same ball.
    Bar { length_mm: f64 },
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CirclePlane {
    Xy,
    Xz,
    Yz,
    /// XY tilted, degrees.
    TiltedAboutX(f64),
    TiltedAboutY(f64),
}

/// A measurement that is not used.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Outlier {
    /// Value of the index column.
    pub index: u32,
    /// `None` for a position.
    pub ball: Option<BallId>,
    pub axes_deg: [f64; AXES],
    /// Residual of the length; for a position the 3-D distance.
    pub residual_mm: f64,
}

/// A measurement that was left out on request.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExcludedMeasurement {
    /// Value of the index column.
    pub index: u32,
    /// `None` for a position.
    pub ball: Option<BallId>,
    pub axes_deg: [f64; AXES],
    /// Residual with the identified robot, which was fitted without this measurement.
    pub residual_mm: f64,
    /// Who left the measurement out; `None` if nobody is stated.
    pub by: Option<String>,
    /// `None` if no reason is stated.
    pub reason: Option<String>,
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

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::estimation::EstimationFinding;
    use crate::robot::Joint;

    #[test]
    fn a_recommendation_is_written_with_its_kind_beside_its_effect() {
        let measures = [
            (
                FurtherMeasurement::Circle { planes: vec![CirclePlane::Xy, CirclePlane::TiltedAboutX(30.0)] },
                json!({ "kind": "circle", "planes": ["xy", { "tilted_about_x": 30.0 }] }),
            ),
            (
                FurtherMeasurement::TurnedBall { ball_mm: [1.0, 2.0, 3.0] },
                json!({ "kind": "turned_ball", "ball_mm": [1.0, 2.0, 3.0] }),
            ),
        ];
        for (measure, keys) in measures {
            let recommendation = Recommendation {
                measure,
                poses: 20,
                before_mm: 0.5,
                after_mm: 0.25,
                adds: true,
                identifies: vec![ParamId::D(Joint::J2)],
            };
            let written = serde_json::to_value(&recommendation).unwrap();
            assert_eq!(serde_json::from_value::<Recommendation>(written.clone()).unwrap(), recommendation);
            let effect = json!({
                "poses": 20, "before_mm": 0.5, "after_mm": 0.25, "adds": true, "identifies": ["d2"]
            });
            let all = [keys, effect].into_iter().flat_map(|part| part.as_object().cloned().unwrap());
            assert_eq!(written, serde_json::Value::Object(all.collect()));
        }
    }

    /// An event added 0.3 mm to each length, and one length is of the other ball.
    #[test]
    fn residuals_are_those_of_the_fit() {
        let (mut found, data) = crate::test_support::checked_robot::calibrated_from_two_balls();
        let after = |found: &CompletedCalibration, rows: &[Measurement]| -> Vec<f64> {
            found.residuals(rows.iter().enumerate()).map(|pair| pair.after).collect()
        };
        let plain = after(&found, &data.rows);
        found.event_mm = vec![0.3; data.rows.len()];
        let corrected = after(&found, &data.rows);
        assert!(plain.iter().zip(&corrected).all(|(plain, mm)| (plain - mm - 0.3).abs() < 1e-9));
        found.event_mm.clear();
        let (own, at) = (data.rows[4].datum.ball().unwrap(), 4);
        let mut wrong = data.rows.clone();
        wrong[at].datum = wrong[at].datum.to_ball(BallId::at(1 - own.index()));
        assert!((after(&found, &wrong)[at] - plain[at]).abs() > 1.0);
        found.wrong_balls = vec![(at, own)];
        assert_eq!(after(&found, &wrong), plain);
    }

    /// The members keep their order: it is the order of the sum in words.
    #[test]
    fn a_combination_is_written_by_the_names_of_its_members() {
        let combination = Combination {
            members: vec![(ParamId::D(Joint::J3), 1.0), (ParamId::D(Joint::J2), 0.5)],
            kept: ParamId::D(Joint::J3),
        };
        let text = serde_json::to_string(&combination).unwrap();
        assert_eq!(text, r#"{"members":{"d3":1.0,"d2":0.5},"kept":"d3"}"#);
        assert_eq!(serde_json::from_str::<Combination>(&text).unwrap(), combination);
    }

    #[test]
    fn a_finding_is_typed_until_it_was_written() {
        let made = RecordedFinding::from(
            Diagnostic::from(EstimationFinding::Outliers { outliers: 2 }).in_file("a.csv"),
        );
        let written = serde_json::to_value(&made).unwrap();
        let keys: Vec<&String> = written.as_object().unwrap().keys().collect();
        assert_eq!(keys, ["code", "severity", "text", "values"]);
        let read: RecordedFinding = serde_json::from_value(written.clone()).unwrap();
        assert!(made.made().is_some() && read.made().is_none());
        assert_eq!(
            (read.code(), read.severity(), read.values()),
            (made.code(), made.severity(), json!({ "outliers": 2 }))
        );
        assert_eq!(serde_json::to_value(&read).unwrap(), written);
    }

    #[test]
    fn another_schema_is_refused() {
        let refused = |text: &str| CalibrationResult::from_json("result.json", text).unwrap_err();
        let finding = |text: &str| refused(text).finding::<ResultFinding>().cloned();
        let other = |schema: &str| Some(ResultFinding::OtherSchema { schema: schema.into(), known: 2 });
        assert_eq!((finding(r#"{"schema":1}"#), finding("{}")), (other("1"), other("none")));
        assert!(matches!(finding(r#"{"schema":2}"#), Some(ResultFinding::Incomplete { .. })));
        assert!(matches!(finding("{"), Some(ResultFinding::NotJson { .. })));
    }
}
