//! The tables that an identification reads: measurements, priors, workspaces.

use std::collections::{BTreeMap, HashSet};
use std::path::Path;

use crate::request::RequestSession;
use dbbd_model::base::table::TableReader;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::EstimationFinding;
use dbbd_model::measurement::MeasurementFinding;
use dbbd_model::measurement::positions::PLACE;
use dbbd_model::measurement::{self, DistinctMeasurements, Measurements};
use dbbd_model::plausibility::{PlausibilityFinding, Quantity};
use dbbd_model::robot::RobotFinding;
use dbbd_model::robot::parameter::SetUpCounts;
use dbbd_model::robot::{AXES, AxisAngles, ParamId, ParamUnit, Robot};

/// Reads a prior from a table name,unit,sd, such as the parameters.csv of an earlier identification.
pub(super) fn read_prior(
    table: &mut TableReader<'_>,
    set_up: SetUpCounts,
) -> Result<BTreeMap<ParamId, f64>, Diagnostic> {
    let [name, unit, sd] = table.required(["name", "unit", "sd"])?;
    let mut prior = BTreeMap::new();
    while let Some(row) = table.row()? {
        let Some(value) = row.given(Some(sd), |at| row.positive(at))? else {
            continue;
        };
        let id: ParamId = row.text(name).parse().map_err(|why: RobotFinding| row.wrong(name, why))?;
        set_up.check(id).map_err(|why| row.wrong(name, why))?;
        if row.text(unit) != id.unit().name() {
            let (parameter, given) = (id.to_string(), row.text(unit).into());
            let wrong = EstimationFinding::OtherUnitThan { parameter, unit: id.unit().to_string(), given };
            return Err(row.wrong(unit, wrong));
        }
        plausible_deviation(id, value).map_err(|why| row.wrong(sd, why))?;
        if prior.insert(id, value).is_some() {
            let parameter = id.to_string();
            return Err(row.wrong(name, EstimationFinding::ParameterTwice { parameter }));
        }
    }
    Ok(prior)
}

/// Refuses a prior standard deviation (mm, rad) that no parameter of a geometry has.
pub fn plausible_deviation(id: ParamId, sd: f64) -> Result<(), PlausibilityFinding> {
    let is_angle = id.unit() == ParamUnit::Rad;
    let quantity = if is_angle { Quantity::PriorAngleSd } else { Quantity::PriorLengthSd };
    if id.is_geometric() { quantity.check(id.to_string(), sd) } else { Ok(()) }
}

/// Reads the poses of a workspace from a table with the columns a1_deg..a6_deg.
pub(in crate::request) fn read_workspace(
    path: &Path,
    robot: &Robot,
    session: &RequestSession<'_>,
) -> Result<Vec<[f64; AXES]>, Diagnostic> {
    let poses = session.table(path, Measurements::poses_from_table)?;
    let axes: Vec<AxisAngles> = poses.iter().map(|pose| pose.axes).collect();
    let (workspace, beyond) =
        checked_workspace(&axes, robot).map_err(|finding| Diagnostic::file(path.display(), finding))?;
    session.findings_in(path.display(), beyond);
    Ok(workspace)
}

/// The poses of a workspace, and a finding if the robot's limits do not allow them.
///
/// # Errors
/// There are too few of them.
pub fn checked_workspace(
    poses: &[AxisAngles],
    robot: &Robot,
) -> Result<(Vec<[f64; AXES]>, Option<MeasurementFinding>), EstimationFinding> {
    /// With fewer poses, the rigid alignment would absorb the robot's error.
    const MIN_ALIGNED_POSES: usize = 10;
    let different: HashSet<_> = poses.iter().map(|axes| axes.degrees().map(f64::to_bits)).collect();
    if different.len() < MIN_ALIGNED_POSES {
        return Err(EstimationFinding::SmallWorkspace { poses: different.len(), least: MIN_ALIGNED_POSES });
    }
    let beyond = measurement::beyond((1..).zip(poses.iter().copied()), robot.controller());
    Ok((poses.iter().map(|axes| axes.radians()).collect(), beyond))
}

/// Reads a table of measurements with `read`. Reports rows that are there twice, and uses them once.
pub(crate) fn measurements(
    path: &Path,
    read: impl FnOnce(&mut TableReader<'_>) -> Result<Measurements, Diagnostic>,
    findings: &mut Vec<Diagnostic>,
    session: &RequestSession<'_>,
) -> Result<Measurements, Diagnostic> {
    let table = session.table(path, read)?;
    let rows = table.count();
    let DistinctMeasurements { measurements, repeated } =
        table.distinct().map_err(|finding| Diagnostic::file(path.display(), finding))?;
    if repeated > 0 {
        findings.push(Diagnostic::file(path.display(), MeasurementFinding::Repeated { repeated, rows }));
    }
    Ok(measurements)
}

/// Whether a table is a `plan.csv`: no table of measured lengths has these columns.
fn is_plan(table: &TableReader<'_>) -> bool {
    ["move", "dwell_s"].into_iter().all(|column| has(table, column))
}

fn has(table: &TableReader<'_>, column: &str) -> bool {
    table.names().iter().any(|name| name == column)
}

/// Reads the lengths of a table.
pub(crate) fn lengths(table: &mut TableReader<'_>) -> Result<Measurements, Diagnostic> {
    if is_plan(table) {
        return Err(Diagnostic::file(table.file(), MeasurementFinding::IsPlan));
    }
    Measurements::from_table(table)
}

/// Reads the lengths or the positions of a table, whichever it has.
pub(super) fn lengths_or_positions(table: &mut TableReader<'_>) -> Result<Measurements, Diagnostic> {
    if PLACE.into_iter().all(|column| has(table, column)) && !has(table, "length_mm") && !is_plan(table) {
        return Measurements::positions_from_table(table);
    }
    lengths(table)
}
