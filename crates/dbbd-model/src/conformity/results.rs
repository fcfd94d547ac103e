//! Comparison of calibrations of one robot over time.

use crate::estimation::ResultFinding;
use std::collections::BTreeMap;

use nalgebra::DMatrix;
use serde::Serialize;

use super::ResultTimeline;
use super::tracked::{TrackedQuantity, TrackedValue, ValueSeries, track};
use crate::conformity::ConformityFinding;
use crate::diagnostic::Diagnostic;
use crate::estimation::result::MapPoint;
use crate::estimation::{CalibrationResult, ErrorSummary, Options, Workspace};
use crate::math::distributions::COVERAGE_95;
use crate::math::straight_line::{LevelCrossing, StraightLine};
use crate::robot::{ParamId, Robot};

/// Relative difference below which nominal values are equal.
const SAME: f64 = 1e-9;

/// The parameters of a result.json.
#[derive(Clone, Debug)]
pub struct StoredResult {
    pub file: String,
    robot: String,
    parameters: BTreeMap<ParamId, EstimatedParameter>,
    has_joint_errors: bool,
}

#[derive(Clone, Copy, Debug)]
struct EstimatedParameter {
    nominal: f64,
    identified: f64,
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
    pub position_change_mm: PositionChange,
}

/// A parameter that is not estimated in all results.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct UncomparedParameter {
    pub name: ParamId,
    /// Indices of the results that estimate it, from 0.
    estimated_in: Vec<usize>,
}

/// Change of the identified robot's position over the workspace, after the best rigid alignment, mm.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PositionChange {
    /// Change of the position between the first and the last result.
    pub whole: ErrorSummary,
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
            parameters.insert(id, EstimatedParameter { nominal, identified, value: sd.map(value) });
        }
        let has_joint_errors = result.joint_errors.is_some();
        Ok(Self { file: file.into(), robot: result.robot, parameters, has_joint_errors })
    }

    /// Whether it identified errors of the joints. The comparison is of the parameters alone.
    pub fn has_joint_errors(&self) -> bool {
        self.has_joint_errors
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
    })
}

/// The workspace over which the position is compared.
struct ComparedWorkspace {
    workspace: Workspace,
    /// Change of each parameter that moves the tool ball.
    whole: DMatrix<f64>,
}

impl ComparedWorkspace {
    fn new(robot: &Robot, first: &StoredResult, last: &StoredResult) -> Self {
        let moves = |id: &ParamId| id.moves_tool_ball();
        let all: BTreeMap<ParamId, f64> = [last, first]
            .iter()
            .flat_map(|result| result.parameters.iter().map(|(id, found)| (*id, found.nominal)))
            .collect();
        let ids: Vec<ParamId> = all.keys().copied().filter(moves).collect();
        let mut geometry = robot.geometry.clone();
        for id in &ids {
            if let (Some(value), Some(found)) = (geometry.value_mut(*id), first.parameters.get(id)) {
                *value = found.identified;
            }
        }
        let change = |id: &ParamId| {
            // What a result does not list is at its nominal value there.
            let value =
                |result: &StoredResult| result.parameters.get(id).map_or(all[id], |found| found.identified);
            value(last) - value(first)
        };
        let whole = DMatrix::from_iterator(ids.len(), 1, ids.iter().map(change));
        let poses = Options::default().workspace_poses(robot).into_owned();
        Self { workspace: Workspace::new(&geometry, &poses, &ids), whole }
    }

    fn change(
        &self,
        parameters: &[TrackedQuantity<ParamId>],
        timeline: &ResultTimeline,
        tolerance_mm: Option<f64>,
    ) -> PositionChange {
        let moved = self.workspace.displacements(&self.whole);
        let changed = parameters.iter().filter(|parameter| parameter.change.significant);
        let changed: Vec<(ParamId, f64)> = changed.map(|found| (found.name, found.change.change)).collect();
        let drift = self.drift(parameters);
        let reached =
            |(drift, tolerance): (StraightLine, f64)| drift.reaches(tolerance, timeline.last(), COVERAGE_95);
        PositionChange {
            whole: ErrorSummary::of(&moved),
            significant: self.summary(&changed),
            map: self.workspace.map(&moved),
            reaches_tolerance: drift.zip(tolerance_mm).and_then(reached),
            drift,
        }
    }

    fn summary(&self, changes: &[(ParamId, f64)]) -> ErrorSummary {
        let ids = self.workspace.ids();
        let of =
            |id: &ParamId| changes.iter().find(|(name, _)| name == id).map_or(0.0, |(_, change)| *change);
        let column = DMatrix::from_iterator(ids.len(), 1, ids.iter().map(of));
        ErrorSummary::of(&self.workspace.displacements(&column))
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
                (*id, EstimatedParameter { nominal, identified: nominal + by, value: None })
            };
            StoredResult {
                file: "result.json".into(),
                robot: robot.name.clone(),
                parameters: identified.iter().map(estimated).collect(),
                has_joint_errors: false,
            }
        };
        let (few, all) = (result(&[(a3, 0.1)]), result(&[(a3, 0.3), (d4, 0.5)]));
        for (first, last, changes) in [(&few, &all, [0.2, 0.5]), (&all, &few, [-0.2, -0.5])] {
            let compared = ComparedWorkspace::new(&robot, first, last);
            assert_eq!(compared.workspace.ids(), [a3, d4]);
            for (found, expected) in compared.whole.iter().zip(changes) {
                assert!((found - expected).abs() < 1e-9, "{found} {expected}");
            }
        }
    }
}
