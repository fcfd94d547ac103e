//! Comparison of calibrations of one robot over time.

use crate::estimation::ResultFinding;
use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector, Vector3};
use serde::Serialize;

use super::ResultTimeline;
use super::tracked::{SIGNIFICANCE_LEVEL, TrackedQuantity, TrackedValue, ValueSeries, track};
use crate::conformity::ConformityFinding;
use crate::diagnostic::Diagnostic;
use crate::estimation::result::{MapPoint, PriorSource};
use crate::estimation::{
    CalibrationResult, CommonKnowledge, ErrorSummary, ExpectedDifference, Options, PredictedDifference,
    displacement, tool_balls,
};
use crate::math::distributions::COVERAGE_95;
use crate::math::straight_line::{LevelCrossing, StraightLine};
use crate::measurement::ApproachedPose;
use crate::robot::{Geometry, LoadedRobot, ParamId, ParamOwner, Payload, Robot};

/// Relative difference below which nominal values are equal.
const SAME: f64 = 1e-9;

/// A result.json, with the robot file beside it.
pub struct StoredResult {
    pub file: String,
    robot: String,
    parameters: BTreeMap<ParamId, EstimatedParameter>,
    prior: PriorSource,
    predicted_mm: ErrorSummary,
    identified: Option<Box<LoadedRobot>>,
}

#[derive(Clone, Copy, Debug)]
struct EstimatedParameter {
    nominal: f64,
    identified: f64,
    /// Standard deviation of the prior; `None` without one, or exactly known.
    prior_sd: Option<f64>,
    /// `None` if it was not estimated.
    value: Option<TrackedValue>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ComparedResults {
    pub robot: String,
    /// Parameters of the robot.
    pub parameters: Vec<TrackedQuantity<ParamId>>,
    /// Tool ball, base balls and bar, which mounting changes.
    pub set_up: Vec<TrackedQuantity<ParamId>>,
    pub not_compared: Vec<UncomparedParameter>,
    /// The predicted position uncertainty of each result, as it states it, mm.
    pub predicted_position_uncertainty_mm: Vec<ErrorSummary>,
    pub position_change_mm: PositionChange,
}

/// A parameter that is not estimated in all results.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct UncomparedParameter {
    pub name: ParamId,
    /// Indices of the results that estimate it, from 0.
    estimated_in: Vec<usize>,
}

/// The point of both robots whose positions are compared.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ComparedTool {
    /// The last result, whose tool ball it is.
    pub of: String,
    /// In the flange frame, mm.
    pub at_mm: [f64; 3],
}

impl ComparedTool {
    fn of(result: &StoredResult, geometry: &Geometry) -> Self {
        Self { of: result.file.clone(), at_mm: geometry.tool.into() }
    }
}

/// Change of the predicted position of one tool point over the workspace, after the best rigid alignment, mm.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PositionChange {
    pub tool: ComparedTool,
    /// Difference of the predictions of the first and the last result.
    pub whole: ErrorSummary,
    /// What the uncertainties of both let expect of a robot that did not change; `None` without their robot files.
    pub expected: Option<ExpectedDifference>,
    /// Whether the difference exceeds what is expected, at the level of a family of quantities; `None` if that is not known.
    pub is_significant: Option<bool>,
    /// Change of the position by the significant changes only.
    pub significant: ErrorSummary,
    #[serde(skip)]
    pub map: Vec<MapPoint>,
    /// Drift of the 95th percentile over the poses, from the significant trends; `None` without one.
    pub drift: Option<StraightLine>,
    /// The time at which the drift reaches the tolerance.
    pub reaches_tolerance: Option<LevelCrossing>,
}

impl StoredResult {
    pub fn from_json(file: &str, json: serde_json::Value) -> Result<Self, Diagnostic> {
        let wrong = |finding: ConformityFinding| Diagnostic::file(file, finding);
        let not_a_result = |finding: ResultFinding| Diagnostic::file(file, finding);
        let result = CalibrationResult::from_value(json).map_err(not_a_result)?;
        let mut parameters = BTreeMap::new();
        for parameter in &result.parameters {
            let id = parameter.name;
            if parameter.unit != id.unit() {
                let (unit, given) = (id.unit().to_string(), parameter.unit.to_string());
                return Err(wrong(ConformityFinding::OtherUnit { parameter: id.to_string(), unit, given }));
            }
            if parameter.sd.is_some_and(|sd| sd < 0.0) {
                let why = format!("the standard deviation of {} is negative", parameter.name);
                return Err(not_a_result(ResultFinding::Incomplete { why }));
            }
            let (nominal, identified) = (parameter.nominal, parameter.identified);
            let value =
                |sd| TrackedValue { value: identified, sd, freedom: result.noise_mm.degrees_of_freedom };
            let sd = parameter.sd.filter(|sd| *sd > 0.0 && sd.is_finite());
            let prior_sd = parameter.prior_sd.filter(|sd| *sd > 0.0);
            let value = sd.map(value);
            parameters.insert(id, EstimatedParameter { nominal, identified, prior_sd, value });
        }
        let predicted_mm = result.predicted_position_uncertainty_mm.identified;
        let (file, robot, prior) = (file.into(), result.robot, result.prior);
        Ok(Self { file, robot, parameters, prior, predicted_mm, identified: None })
    }

    /// Whether the robot of its robot-identified.toml is known.
    pub fn has_robot(&self) -> bool {
        self.identified.is_some()
    }

    /// The result with the robot of its robot-identified.toml.
    #[must_use]
    pub fn with_robot(self, identified: LoadedRobot) -> Self {
        Self { identified: Some(Box::new(identified)), ..self }
    }
}

/// Checks that all results are of this robot.
pub fn of_robot(results: &[StoredResult], name: &str) -> Result<(), ConformityFinding> {
    match results.iter().find(|result| result.robot != name) {
        Some(StoredResult { file, robot, .. }) => Err(ConformityFinding::OtherRobot {
            first: file.clone(),
            robot: robot.clone(),
            other: name.into(),
        }),
        None => Ok(()),
    }
}

/// Checks that all results have the robot and the nominal values of the first.
pub fn same_robot(results: &[StoredResult]) -> Result<(), Diagnostic> {
    let Some((first, others)) = results.split_first() else { return Ok(()) };
    for other in others {
        let file = || first.file.clone();
        let wrong = |finding| Err(Diagnostic::file(&other.file, finding));
        if other.robot != first.robot {
            let (robot, other) = (first.robot.clone(), other.robot.clone());
            return wrong(ConformityFinding::OtherRobot { first: file(), robot, other });
        }
        for (id, known) in first.parameters.iter().filter(|(id, _)| id.is_geometric()) {
            let Some(found) = other.parameters.get(id) else { continue };
            if (found.nominal - known.nominal).abs() > SAME * known.nominal.abs().max(1.0) {
                let (parameter, value, other) = (id.to_string(), known.nominal, found.nominal);
                return wrong(ConformityFinding::OtherNominal { first: file(), parameter, value, other });
            }
        }
    }
    Ok(())
}

/// Compares results of one robot. It is an error if no parameter is estimated in all of them.
pub fn compare_results(
    robot: &Robot,
    results: &[StoredResult],
    timeline: &ResultTimeline,
    tolerance_mm: Option<f64>,
) -> Result<ComparedResults, Diagnostic> {
    let mut ids: Vec<ParamId> = results.iter().flat_map(|result| result.parameters.keys().copied()).collect();
    ids.sort();
    ids.dedup();
    let (mut own, mut set_up, mut not_compared) = (Vec::new(), Vec::new(), Vec::new());
    for name in ids {
        let value = |result: &StoredResult| result.parameters.get(&name).and_then(|found| found.value);
        let found: Vec<Option<TrackedValue>> = results.iter().map(value).collect();
        if let Some(values) = found.iter().copied().collect::<Option<Vec<TrackedValue>>>() {
            let family = if name.is_setup() { &mut set_up } else { &mut own };
            family.push(ValueSeries { name, unit: name.unit().name(), values });
        } else if found.iter().any(Option::is_some) {
            let estimated_in = (0..found.len()).filter(|at| found[*at].is_some()).collect();
            not_compared.push(UncomparedParameter { name, estimated_in });
        }
    }
    let (parameters, set_up) = (track(own, timeline), track(set_up, timeline));
    let [Some(first), Some(last)] = [results.first(), results.last()] else {
        return Err(ResultFinding::NeitherResultNorCircle.into());
    };
    if parameters.is_empty() && set_up.is_empty() {
        let finding = ConformityFinding::NothingInCommon { first: first.file.clone() };
        return Err(Diagnostic::file(&last.file, finding));
    }
    let position = ComparedWorkspace::new(robot, first, last);
    Ok(ComparedResults {
        robot: first.robot.clone(),
        position_change_mm: position.change(&parameters, timeline, tolerance_mm),
        parameters,
        set_up,
        not_compared,
        predicted_position_uncertainty_mm: results.iter().map(|result| result.predicted_mm).collect(),
    })
}

/// The robots whose positions are compared, by the results between which the change is.
struct ComparedWorkspace {
    poses: Vec<ApproachedPose>,
    /// The first robot with the tool of the last one.
    geometry: Geometry,
    balls: Vec<Vector3<f64>>,
    /// 3 rows for each pose, mm.
    moved: DVector<f64>,
    expected: Option<ExpectedDifference>,
    tool: ComparedTool,
}

impl ComparedWorkspace {
    /// By the robot files of both results; without them by their parameters in the table of `robot`, without uncertainty.
    fn new(robot: &Robot, first: &StoredResult, last: &StoredResult) -> Self {
        let options = Options::default();
        let axes = options.workspace_poses(robot);
        let poses: Vec<ApproachedPose> = axes.iter().map(ApproachedPose::unapproached).collect();
        match (&first.identified, &last.identified) {
            (Some(one), Some(two)) => {
                let [one, two] = [one, two].map(|known| with_tool_of(&known.robot, &two.robot));
                let common = common_knowledge(first, last);
                let difference = PredictedDifference::of(&one, &two, &common, &poses);
                let expected = Some(difference.expected());
                let tool = ComparedTool::of(last, &two.geometry);
                let PredictedDifference { balls, moved, .. } = difference;
                Self { poses, geometry: one.geometry, balls, moved, expected, tool }
            }
            _ => {
                let [before, after] = by_parameters(&robot.geometry, first, last);
                let [balls, there] = [&before, &after].map(|geometry| tool_balls(geometry, &poses));
                let (moved, tool) = (displacement(&balls, &there), ComparedTool::of(last, &after));
                Self { poses, geometry: before, balls, moved, expected: None, tool }
            }
        }
    }

    fn change(
        &self,
        parameters: &[TrackedQuantity<ParamId>],
        timeline: &ResultTimeline,
        tolerance_mm: Option<f64>,
    ) -> PositionChange {
        let changed = parameters.iter().filter(|parameter| parameter.change.significant);
        let changed: Vec<(ParamId, f64)> = changed.map(|found| (found.name, found.change.change)).collect();
        let drift = self.drift(parameters);
        let reached =
            |(drift, tolerance): (StraightLine, f64)| drift.reaches(tolerance, timeline.last(), COVERAGE_95);
        let moved = DMatrix::from_columns(std::slice::from_ref(&self.moved));
        PositionChange {
            tool: self.tool.clone(),
            whole: ErrorSummary::of(&moved),
            expected: self.expected,
            is_significant: self.expected.map(|expected| expected.p < SIGNIFICANCE_LEVEL),
            significant: self.summary(&changed),
            map: MapPoint::map(&self.balls, &moved),
            reaches_tolerance: drift.zip(tolerance_mm).and_then(reached),
            drift,
        }
    }

    /// The change of the position by changes of parameters of the first robot.
    fn summary(&self, changes: &[(ParamId, f64)]) -> ErrorSummary {
        let mut changed = self.geometry.clone();
        for (id, change) in changes {
            if let Some(value) = changed.value_mut(*id) {
                *value += change;
            }
        }
        let moved = displacement(&self.balls, &tool_balls(&changed, &self.poses));
        ErrorSummary::of(&DMatrix::from_columns(&[moved]))
    }

    /// The significant trends combined, as a line from the first result. The slopes count as independent.
    fn drift(&self, parameters: &[TrackedQuantity<ParamId>]) -> Option<StraightLine> {
        let lines = parameters.iter().filter_map(|parameter| {
            parameter.trend.filter(|trend| trend.significant).map(|trend| (parameter.name, trend.line))
        });
        let lines: Vec<(ParamId, StraightLine)> = lines.collect();
        if lines.is_empty() {
            return None;
        }
        let slopes: Vec<(ParamId, f64)> = lines.iter().map(|(name, line)| (*name, line.slope)).collect();
        let slope = self.summary(&slopes).p95;
        let variance: f64 = (0..lines.len())
            .map(|at| {
                let mut shifted = slopes.clone();
                shifted[at].1 += lines[at].1.slope_sd;
                (self.summary(&shifted).p95 - slope).powi(2)
            })
            .sum();
        Some(StraightLine { centre: 0.0, level: 0.0, level_sd: 0.0, slope, slope_sd: variance.sqrt() })
    }
}

/// A robot with the tool point and the payload of another one, which are then no difference between them. Both have the same flange.
fn with_tool_of(robot: &Robot, other: &Robot) -> Robot {
    let mut robot = robot.clone();
    robot.tolerance.state_flange();
    let mut robot = robot.with_exact_tool(other.geometry.tool.into());
    let exact = |payload: &Payload| Payload { u_kg: 0.0, u_mm: 0.0, ..payload.clone() };
    robot.geometry.load.payloads = other.geometry.load.payloads.iter().map(exact).collect();
    robot
}

/// The geometry with the parameters of each result, and the tool of the last one. What a result does not list is at its
/// nominal value there.
fn by_parameters(geometry: &Geometry, first: &StoredResult, last: &StoredResult) -> [Geometry; 2] {
    let nominal: BTreeMap<ParamId, f64> = [last, first]
        .iter()
        .flat_map(|result| result.parameters.iter().map(|(id, found)| (*id, found.nominal)))
        .collect();
    let listed = nominal.iter().filter(|(id, _)| id.moves_tool_ball());
    let mut both = [geometry.clone(), geometry.clone()];
    for (id, nominal) in listed {
        for (geometry, result) in both.iter_mut().zip([first, last]) {
            let of_tool = matches!(id.owner(), ParamOwner::ToolBall);
            let found = if of_tool { last } else { result }.parameters.get(id);
            if let Some(value) = geometry.value_mut(*id) {
                *value = found.map_or(*nominal, |found| found.identified);
            }
        }
    }
    both
}

/// What the estimates of two results rest on together. Two with a prior of independent parameters share it, as far as both
/// use it: they have the nominal robot in common.
fn common_knowledge(first: &StoredResult, last: &StoredResult) -> CommonKnowledge {
    let is_earlier =
        |(first, last): (&LoadedRobot, &LoadedRobot)| last.source.provenance.has(&first.source.artefact);
    let of_maker = |result: &StoredResult| matches!(result.prior, PriorSource::Datasheet | PriorSource::File);
    if first.identified.as_deref().zip(last.identified.as_deref()).is_some_and(is_earlier) {
        CommonKnowledge::Earlier
    } else if of_maker(first) && of_maker(last) {
        let sds = |(id, found): (&ParamId, &EstimatedParameter)| {
            let other = last.parameters.get(id)?;
            Some((*id, [found.prior_sd?, other.prior_sd?]))
        };
        let own = first.parameters.iter().filter(|(id, _)| matches!(id.owner(), ParamOwner::Robot));
        CommonKnowledge::Prior(own.filter_map(sds).collect())
    } else {
        CommonKnowledge::Nothing
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Joint;

    /// d4 is listed in one result only, 0.5 mm from its nominal value; a3 is listed in both.
    #[test]
    fn what_a_result_does_not_list_is_nominal() {
        let robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        let (a3, d4) = (ParamId::A(Joint::J4), ParamId::D(Joint::J4));
        let result = |identified: &[(ParamId, f64)]| {
            let estimated = |(id, by): &(ParamId, f64)| {
                let nominal = robot.geometry.value(*id).unwrap();
                let identified = nominal + by;
                (*id, EstimatedParameter { nominal, identified, prior_sd: None, value: None })
            };
            StoredResult {
                file: "result.json".into(),
                robot: robot.name.clone(),
                parameters: identified.iter().map(estimated).collect(),
                prior: PriorSource::None,
                predicted_mm: ErrorSummary::default(),
                identified: None,
            }
        };
        let (few, all) = (result(&[(a3, 0.1)]), result(&[(a3, 0.3), (d4, 0.5)]));
        for (first, last, changes) in [(&few, &all, [0.2, 0.5]), (&all, &few, [-0.2, -0.5])] {
            let [before, after] = by_parameters(&robot.geometry, first, last);
            for (id, expected) in [a3, d4].into_iter().zip(changes) {
                let found = after.value(id).unwrap() - before.value(id).unwrap();
                assert!((found - expected).abs() < 1e-9, "{found} {expected}");
            }
        }
    }
}
