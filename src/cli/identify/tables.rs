//! The files of a result beside its report.

use std::fmt::Write;
use std::path::Path;

use serde::Deserialize;

use super::Recorded;
use crate::base::{FileSet, files, serialised};
use crate::catalogue::{CliFinding, FileFinding};
use crate::conformity::Budget;
use crate::diagnostic::Diagnostic;
use crate::estimation::{CalibrationResult, JointPoint, Posterior, ResultFile, joint_curve};
use crate::measurement::Measurements;
use crate::program::{self, Language};
use crate::provenance::{Artefact, Provenance, Role};
use crate::report::calibration;
use crate::report::export::{frames, mastering, urdf};
use crate::robot::{Joint, Robot};

/// The lengths that an identification rests on, beside its robot-identified.toml.
pub(crate) const LENGTHS: &str = "lengths.csv";
/// The positions beside them.
pub(crate) const POSITIONS: &str = "positions.csv";
/// What each axis must be corrected by, where a result has it.
const JOINT_ERRORS: &str = "joint-errors.csv";
const RESULT: &str = "result.json";
/// The identified robot beside them.
pub(crate) const ROBOT: &str = "robot-identified.toml";

const PARAMETER_COLUMNS: [&str; 14] = [
    "name",
    "unit",
    "start",
    "nominal",
    "identified",
    "correction",
    "sd",
    "status",
    "reason",
    "low95",
    "high95",
    "mc_sd",
    "mc_low95",
    "mc_high95",
];

/// Writes result.json, parameters.csv, covariance.csv, the robot for other programs, and as lengths.csv those of the
/// observations that the result rests on, and report.html; the provenance with these. Files of an earlier result that this
/// one lacks go.
pub(super) fn write_results(
    dir: &Path,
    found: &CalibrationResult,
    observations: &Measurements,
    mut provenance: Provenance,
    budget: &Budget,
) -> Result<Provenance, Diagnostic> {
    let file = ResultFile::from(found);
    let is_used = |place: usize| found.uses(place);
    let (mut set, earlier) = (FileSet::begin(dir)?, earlier(dir).provenance);
    if found.made_from.lengths > 0 {
        let written = set.write_pieces(LENGTHS, observations.csv_pieces(is_used))?;
        provenance.add(&table(LENGTHS, &written)?);
    } else {
        remove_of(&earlier, &dir.join(LENGTHS), &mut set)?;
    }
    if let Some(text) = observations.positions_csv(is_used) {
        let written = set.write_pieces(POSITIONS, [text])?;
        provenance.add(&table(POSITIONS, &written)?);
    } else {
        remove_of(&earlier, &dir.join(POSITIONS), &mut set)?;
    }
    let recorded = Recorded { result: &file, budget, provenance: &provenance };
    set.write(RESULT, serialised::sealed_json(&recorded)?)?;
    let robot = Robot { provenance: provenance.clone(), ..found.robot.clone() };
    set.write(ROBOT, serialised::sealed_toml(&robot.to_toml()?))?;
    let parameters =
        parameters_csv(&file).map_err(|error| CliFinding::NoOutput { why: error.to_string() })?;
    set.write("parameters.csv", parameters)?;
    set.write("covariance.csv", covariance_csv(&found.posterior))?;
    match found.joints {
        Some(_) => set.write(JOINT_ERRORS, joint_errors_csv(&found.robot))?,
        None => set.remove(JOINT_ERRORS),
    }
    hand_back(&mut set, found, &provenance)?;
    set.write("report.html", calibration::html(found, observations, &provenance, budget)?)?;
    set.finish()?;
    Ok(provenance)
}

/// A table of this result, which is at `written` until the set is finished.
fn table(name: &str, written: &Path) -> Result<Artefact, Diagnostic> {
    Ok(Artefact { name: name.into(), ..Artefact::file(Role::Measurements, written)? })
}

/// A result that is in the directory.
#[derive(Default, Deserialize)]
struct Earlier {
    robot: String,
    provenance: Provenance,
}

/// The result that is in the directory; empty where there is none that can be read.
fn earlier(dir: &Path) -> Earlier {
    let text = files::read_if_file(&dir.join(RESULT)).and_then(Result::ok);
    text.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default()
}

/// That the result of another arm is not replaced, where the serial numbers or else the names show it.
pub(super) fn is_of_robot(dir: &Path, name: &str, serial: Option<&str>) -> Result<(), Diagnostic> {
    let Earlier { robot, provenance } = earlier(dir);
    let known = provenance.identity.robot;
    let other = match (known.as_deref(), serial) {
        (Some(known), Some(serial)) if known != serial => known,
        _ if !robot.is_empty() && robot != name => &robot,
        _ => return Ok(()),
    };
    let finding = FileFinding::OtherRobot { robot: other.into() };
    Err(Diagnostic::file(&dir.join(RESULT).display().to_string(), finding))
}

/// Removes a table of that result; one of the same name that is the user's own stays.
fn remove_of(earlier: &Provenance, table: &Path, set: &mut FileSet) -> Result<(), Diagnostic> {
    if table.is_file() {
        let artefact = Artefact::file(Role::Measurements, table)?;
        if earlier.has(&artefact) {
            set.remove(&artefact.name);
        }
    }
    Ok(())
}

fn parameters_csv(file: &ResultFile) -> Result<Vec<u8>, csv::Error> {
    let mut table = csv::Writer::from_writer(Vec::new());
    table.write_record(PARAMETER_COLUMNS)?;
    for parameter in &file.parameters {
        table.serialize((
            &parameter.name,
            &parameter.unit,
            parameter.start,
            parameter.nominal,
            parameter.identified,
            parameter.correction,
            parameter.sd,
            parameter.status,
            &parameter.reason,
            ends(parameter.interval95),
            parameter.monte_carlo.map(|drawn| drawn.sd),
            ends(parameter.monte_carlo.map(|drawn| drawn.interval95)),
        ))?;
    }
    table.into_inner().map_err(|error| error.into_error().into())
}

/// In the units of the parameters.
fn covariance_csv(posterior: &Posterior) -> String {
    let mut text = String::from("name");
    // Writing to a string does not fail.
    for id in posterior.ids() {
        let _ = write!(text, ",{id}");
    }
    text.push('\n');
    let covariance = posterior.covariance();
    for (row, id) in covariance.row_iter().zip(posterior.ids()) {
        let _ = write!(text, "{id}");
        for value in row.iter() {
            let _ = write!(text, ",{value:e}");
        }
        text.push('\n');
    }
    text
}

/// What each axis must be corrected by, in its own sense, by either sense of approach.
fn joint_errors_csv(robot: &Robot) -> String {
    let mut text = String::from("axis,angle_deg,rising_deg,falling_deg,sd_deg\n");
    for joint in Joint::ALL {
        for point in joint_curve(robot, joint) {
            let JointPoint { angle_deg, rising, falling, sd } = point;
            let [rising, falling, sd] = [rising, falling, sd].map(f64::to_degrees);
            // Writing to a string does not fail.
            let _ = writeln!(text, "{},{angle_deg:.3},{rising:.6},{falling:.6},{sd:.6}", joint.number());
        }
    }
    text
}

/// What goes to other programs and to the controller: URDF, mastering offsets, KRL frames.
fn hand_back(
    set: &mut FileSet,
    found: &CalibrationResult,
    provenance: &Provenance,
) -> Result<(), Diagnostic> {
    set.write("robot-identified.urdf", urdf::urdf(&found.robot))?;
    let offsets = mastering::offsets(found);
    set.write("mastering.csv", mastering::csv(&offsets)?)?;
    let data = frames::data_list(&found.robot.name, &frames::frames(found), &offsets);
    let data = program::stamped(Language::Krl, &data, provenance)?;
    set.write(&format!("{}.dat", frames::MODULE), data)
}

/// The ends of an interval as two cells, empty where there is none.
fn ends(interval: Option<[f64; 2]>) -> [Option<f64>; 2] {
    interval.map_or([None; 2], |ends| ends.map(Some))
}
