//! Writes the files of a result.

use dbbd_model::base::InternalFinding;
use std::path::Path;

use super::super::artefact::EarlierResult;
use super::ResultDocument;
use dbbd_job::file_set::FileSet;
use dbbd_job::program::{self, Language};
use dbbd_job::report::calibration;
use dbbd_job::report::export::{frames, mastering, urdf};
use dbbd_model::base::serialised;
use dbbd_model::conformity::UncertaintyBudget;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::{CalibrationResult, JointPoint, Posterior, ResultFile, joint_curve};
use dbbd_model::measurement::Measurements;
use dbbd_model::provenance::{Artefact, ArtefactRole, Provenance};
use dbbd_model::robot::{Joint, Robot};

/// The lengths that the result rests on.
pub(crate) const LENGTHS: &str = "lengths.csv";
/// The positions that the result rests on.
pub(crate) const POSITIONS: &str = "positions.csv";
/// The correction of each axis, if the result has errors of the joints.
const JOINT_ERRORS: &str = "joint-errors.csv";
pub(super) const RESULT: &str = "result.json";
/// The identified robot.
pub(crate) const ROBOT: &str = "robot-identified.toml";

const PARAMETER_COLUMNS: &str =
    "name,unit,start,nominal,identified,correction,sd,status,reason,low95,high95,mc_sd,mc_low95,mc_high95";

/// Writes all files of a result, and removes those of an earlier result that this one lacks. Returns the provenance with the
/// tables of the measurements.
pub(super) fn write_results(
    dir: &Path,
    result: &CalibrationResult,
    observations: &Measurements,
    mut provenance: Provenance,
    budget: &UncertaintyBudget,
) -> Result<Provenance, Diagnostic> {
    let file = ResultFile::from(result);
    let is_used = |place: usize| result.uses(place);
    let (mut set, earlier) = (FileSet::begin(dir)?, EarlierResult::read(&dir.join(RESULT)).provenance);
    let lengths =
        (result.made_from.lengths > 0).then(|| set.write_pieces(LENGTHS, observations.csv_pieces(is_used)));
    let positions = observations.positions_csv(is_used).map(|text| set.write_pieces(POSITIONS, [text]));
    for (name, written) in [(LENGTHS, lengths.transpose()?), (POSITIONS, positions.transpose()?)] {
        let table = written.clone().unwrap_or_else(|| dir.join(name));
        if table.is_file() {
            let table = Artefact {
                name: name.into(),
                ..dbbd_job::artefact::of_file(ArtefactRole::Measurements, &table)?
            };
            match written {
                Some(_) => provenance.add(&table),
                // A table of the user with this name is kept.
                None if earlier.has(&table) => set.remove(name),
                None => {}
            }
        }
    }
    let recorded = ResultDocument { result: &file, budget, provenance: &provenance };
    set.write(RESULT, serialised::sealed_json(&recorded)?)?;
    let robot = Robot { provenance: provenance.clone(), ..result.robot.clone() };
    set.write(ROBOT, serialised::sealed_toml(&robot.to_toml()?))?;
    set.write("parameters.csv", parameters_csv(&file)?)?;
    set.write("covariance.csv", covariance_csv(&result.posterior))?;
    match result.joints {
        Some(_) => set.write(JOINT_ERRORS, joint_errors_csv(&result.robot))?,
        None => set.remove(JOINT_ERRORS),
    }
    write_for_controller(&mut set, result, &provenance)?;
    set.write("report.html", calibration::html(result, observations, &provenance, budget)?)?;
    set.finish()?;
    Ok(provenance)
}

fn parameters_csv(file: &ResultFile) -> Result<String, InternalFinding> {
    // Two cells, empty if there is no interval.
    let ends = |interval: Option<[f64; 2]>| interval.map_or([None; 2], |ends| ends.map(Some));
    let rows = file.parameters.iter().map(|parameter| {
        (
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
        )
    });
    serialised::csv_table(PARAMETER_COLUMNS.split(','), rows)
}

/// The covariance matrix in the units of the parameters.
fn covariance_csv(posterior: &Posterior) -> String {
    let names: String = posterior.ids().iter().map(|id| format!(",{id}")).collect();
    let covariance = posterior.covariance();
    let rows = covariance.row_iter().zip(posterior.ids()).map(|(row, id)| {
        let values: String = row.iter().map(|value| format!(",{value:e}")).collect();
        format!("{id}{values}\n")
    });
    [format!("name{names}\n")].into_iter().chain(rows).collect()
}

/// The correction of each axis in its own sense, by the sense of approach.
fn joint_errors_csv(robot: &Robot) -> String {
    let row = |joint: Joint, JointPoint { angle_deg, rising, falling, sd }: JointPoint| {
        let [rising, falling, sd] = [rising, falling, sd].map(f64::to_degrees);
        format!("{},{angle_deg:.3},{rising:.6},{falling:.6},{sd:.6}\n", joint.number())
    };
    let rows = Joint::ALL
        .into_iter()
        .flat_map(|joint| joint_curve(robot, joint).into_iter().map(move |point| row(joint, point)));
    ["axis,angle_deg,rising_deg,falling_deg,sd_deg\n".to_owned()].into_iter().chain(rows).collect()
}

/// Writes the files for other programs and for the controller: URDF, mastering offsets, KRL frames.
fn write_for_controller(
    set: &mut FileSet,
    result: &CalibrationResult,
    provenance: &Provenance,
) -> Result<(), Diagnostic> {
    set.write("robot-identified.urdf", urdf::urdf(&result.robot))?;
    let offsets = mastering::offsets(result);
    set.write("mastering.csv", mastering::csv(&offsets)?)?;
    let data = frames::data_list(&result.robot.name, &frames::frames(result), &offsets);
    let data = program::stamped(Language::Krl, &data, provenance)?;
    set.write(&format!("{}.dat", frames::MODULE), data)
}
