//! Writes the files of a result.

use dbbd_model::base::InternalFinding;
use std::path::Path;

use super::IdentifyDocument;
use crate::file_set::{EarlierFiles, FileSet};
use crate::report;
use crate::request::earlier::EarlierResult;
use crate::robot_files::ROBOT;
use dbbd_model::base::serialised::{self, Seal};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::Posterior;
use dbbd_model::estimation::result::ParameterResult;
use dbbd_model::measurement::Measurements;
use dbbd_model::provenance::{Artefact, ArtefactRole};
use dbbd_model::robot::Robot;

/// Name of the file of the lengths from which the result was computed.
pub const LENGTHS: &str = "lengths.csv";
/// Name of the file of the positions from which the result was computed.
pub const POSITIONS: &str = "positions.csv";
pub(super) const RESULT: &str = "result.json";

const PARAMETER_COLUMNS: &str =
    "name,unit,start,nominal,identified,correction,sd,status,reason,low95,high95,mc_sd,mc_low95,mc_high95";

/// Writes all files of a result, and removes files of an earlier result that this result does not have. Returns the
/// result, to whose provenance the tables of the measurements are added, and the names of the files.
pub(super) fn write_results(
    dir: &Path,
    replaced: EarlierFiles,
    mut document: IdentifyDocument,
    observations: &Measurements,
) -> Result<(IdentifyDocument, Vec<String>), Diagnostic> {
    let calibration = &document.calibration;
    let is_used = |place: usize| calibration.uses(place);
    let (mut set, earlier) =
        (FileSet::begin(dir, replaced)?, EarlierResult::read(&dir.join(RESULT)).provenance);
    let lengths = (calibration.result.made_from.lengths > 0)
        .then(|| set.write_pieces(LENGTHS, observations.csv_pieces(is_used)));
    let positions = observations.positions_csv(is_used).map(|text| set.write_pieces(POSITIONS, [text]));
    for (name, written) in [(LENGTHS, lengths.transpose()?), (POSITIONS, positions.transpose()?)] {
        let table = written.clone().unwrap_or_else(|| dir.join(name));
        if table.is_file() {
            let table = Artefact {
                name: name.into(),
                origin: document.provenance.origin(),
                ..crate::artefact::of_file(ArtefactRole::Measurements, &table)?
            };
            match written {
                Some(_) => document.provenance.add(&table),
                // A table of the user with this name is kept.
                None if earlier.has(&table) => set.remove(name),
                None => {}
            }
        }
    }
    set.write(RESULT, serialised::sealed_json(&document)?)?;
    let IdentifyDocument { calibration, budget, provenance } = &document;
    let robot = Robot { provenance: provenance.clone(), ..calibration.robot.clone() };
    set.write(ROBOT, Seal::Toml.append(&robot.to_toml()?))?;
    set.write("parameters.csv", parameters_csv(&calibration.result.parameters)?)?;
    set.write("covariance.csv", covariance_csv(&calibration.posterior))?;
    set.write("report.html", report::calibration::html(calibration, observations, provenance, budget)?)?;
    let files = set.finish()?;
    Ok((document, files))
}

fn parameters_csv(parameters: &[ParameterResult]) -> Result<String, InternalFinding> {
    // Two cells, which are empty if there is no interval.
    let ends = |interval: Option<[f64; 2]>| interval.map_or([None; 2], |ends| ends.map(Some));
    let rows = parameters.iter().map(|parameter| {
        (
            parameter.name,
            parameter.unit,
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
