//! The inputs of an identification: observations, points, priors, workspaces.

use std::collections::{BTreeMap, HashSet};
use std::path::Path;

use crate::base::table::Table;
use crate::catalogue::{EstimationFinding, MeasurementFinding, RobotFinding};
use crate::cli::Output;
use crate::diagnostic::Diagnostic;
use crate::measurement::positions::PLACE;
use crate::measurement::{self, Distinct, Measurements};
use crate::robot::parameter::SetUp;
use crate::robot::{AXES, ParamId, Robot, Unit};

/// A tool ball is no nearer to the flange's centre, mm: nearer it is one in metres.
const LEAST_TOOL_MM: f64 = 3.0;

pub(crate) fn parse_point(text: &str) -> Result<[f64; 3], EstimationFinding> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse::<f64>()).collect();
    match numbers.as_deref() {
        Ok(&[x, y, z]) if (f64::MIN_POSITIVE..LEAST_TOOL_MM).contains(&x.abs().max(y.abs()).max(z.abs())) => {
            Err(EstimationFinding::PointInMetres)
        }
        Ok(&[x, y, z]) if [x, y, z].iter().all(|v| v.is_finite()) => Ok([x, y, z]),
        _ => Err(EstimationFinding::NotAPoint),
    }
}

/// A table `name,unit,sd`; a parameters.csv of an earlier identification is one.
pub(super) fn read_prior(table: &mut Table<'_>, set_up: SetUp) -> Result<BTreeMap<ParamId, f64>, Diagnostic> {
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
        if !is_prior(id, value) {
            let (parameter, unit) = (id.to_string(), id.unit().to_string());
            return Err(row.wrong(sd, EstimationFinding::NoPriorOf { parameter, value, unit }));
        }
        if prior.insert(id, value).is_some() {
            let parameter = id.to_string();
            return Err(row.wrong(name, EstimationFinding::ParameterTwice { parameter }));
        }
    }
    Ok(prior)
}

/// Whether a standard deviation is one of a robot's geometry: no maker is that bad, and none is known so well.
fn is_prior(id: ParamId, sd: f64) -> bool {
    const MOST_MM: f64 = 50.0;
    const MOST_RAD: f64 = 0.04;
    const LEAST: f64 = 1e-8;
    let most = if id.unit() == Unit::Rad { MOST_RAD } else { MOST_MM };
    !id.is_geometric() || (LEAST..=most).contains(&sd)
}

/// A workspace of a robot: a table with the columns a1_deg..a6_deg, more may stand beside them.
pub(crate) fn read_workspace(
    path: &Path,
    robot: &Robot,
    out: &Output,
) -> Result<Vec<[f64; AXES]>, Diagnostic> {
    /// Fewer are aligned away: the robot's error would not show.
    const LEAST: usize = 10;
    let poses = out.table(path, Measurements::poses_from_table)?;
    let name = path.display().to_string();
    let different: HashSet<_> = poses.iter().map(|pose| pose.axes.degrees().map(f64::to_bits)).collect();
    if different.len() < LEAST {
        let finding = EstimationFinding::SmallWorkspace { poses: different.len(), least: LEAST };
        return Err(Diagnostic::file(&name, finding));
    }
    let angles = poses.iter().zip(1..).map(|(pose, number)| (number, pose.axes));
    let beyond = measurement::beyond(angles, robot.controller());
    beyond.into_iter().for_each(|doubt| out.finding(Diagnostic::file(&name, doubt)));
    Ok(poses.iter().map(|pose| pose.axes.radians()).collect())
}

/// Columns that a `plan.csv` has and no table of measured lengths.
const PLAN: [&str; 2] = ["move", "dwell_s"];

/// The lengths or the positions of a table, whichever it has.
///
/// # Errors
/// As [`observations`].
pub(crate) fn measurements(
    path: &Path,
    found: &mut Vec<Diagnostic>,
    out: &Output,
) -> Result<Measurements, Diagnostic> {
    let (name, table) = (
        path.display().to_string(),
        out.table(path, |table| {
            let has = |wanted: &str| table.names().iter().any(|name| name == wanted);
            if PLACE.into_iter().all(has) && !has("length_mm") && !PLAN.into_iter().all(has) {
                return Measurements::positions_from_table(table);
            }
            lengths(table)
        })?,
    );
    distinct(&name, table, found)
}

/// The positions of a table.
///
/// # Errors
/// As [`observations`].
pub(crate) fn positions(
    path: &Path,
    found: &mut Vec<Diagnostic>,
    out: &Output,
) -> Result<Measurements, Diagnostic> {
    distinct(&path.display().to_string(), out.table(path, Measurements::positions_from_table)?, found)
}

fn lengths(table: &mut Table<'_>) -> Result<Measurements, Diagnostic> {
    if PLAN.iter().all(|wanted| table.names().iter().any(|name| name == wanted)) {
        return Err(Diagnostic::file(table.file(), MeasurementFinding::IsPlan));
    }
    Measurements::from_table(table)
}

/// Each row once, with a finding where one was there twice.
fn distinct(
    name: &str,
    table: Measurements,
    found: &mut Vec<Diagnostic>,
) -> Result<Measurements, Diagnostic> {
    let rows = table.count();
    let Distinct { measurements, repeated } =
        table.distinct().map_err(|finding| Diagnostic::file(name, finding))?;
    if repeated > 0 {
        found.push(Diagnostic::file(name, MeasurementFinding::Repeated { repeated, rows }));
    }
    Ok(measurements)
}

/// The lengths of a table, which is never whole in memory.
///
/// Rows that are there twice are used once, with a finding.
///
/// # Errors
/// Names the path and why it could not be read, or the line and what is wrong there.
pub(crate) fn observations(
    path: &Path,
    found: &mut Vec<Diagnostic>,
    out: &Output,
) -> Result<Measurements, Diagnostic> {
    let table = out.table(path, lengths)?;
    distinct(&path.display().to_string(), table, found)
}
