//! The files of a result beside its report.

use std::error::Error;
use std::fmt::Write;
use std::path::Path;

use crate::export::{frames, mastering, urdf};
use crate::files;
use crate::identify::Identified;
use crate::model::Observations;

/// The lengths that an identification rests on, beside its robot-identified.toml.
pub(crate) const LENGTHS: &str = "lengths.csv";

/// Writes result.json, parameters.csv, covariance.csv, the robot for other programs, and as lengths.csv those of the
/// observations that the result rests on.
pub(super) fn write_results(
    dir: &Path,
    found: &Identified,
    observations: &Observations,
) -> Result<(), Box<dyn Error>> {
    let result = &found.result;
    let used = |at: usize| found.out.binary_search(&at).is_err();
    files::write_pieces(&dir.join(LENGTHS), observations.csv_pieces(used))?;
    files::write(&dir.join("result.json"), serde_json::to_string_pretty(result)? + "\n")?;
    files::write(&dir.join("robot-identified.toml"), found.robot.to_toml())?;
    let mut table = csv::Writer::from_writer(Vec::new());
    table.write_record([
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
    ])?;
    for parameter in &result.parameters {
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
    files::write(&dir.join("parameters.csv"), table.into_inner()?)?;
    let mut covariance = String::from("name");
    for id in &found.estimated {
        write!(covariance, ",{id}")?;
    }
    covariance.push('\n');
    for (row, id) in found.estimated.iter().enumerate() {
        write!(covariance, "{id}")?;
        for value in found.covariance.row(row).iter() {
            write!(covariance, ",{value:e}")?;
        }
        covariance.push('\n');
    }
    files::write(&dir.join("covariance.csv"), covariance)?;
    hand_back(dir, found)
}

/// What goes to other programs and to the controller: URDF, mastering offsets, KRL frames.
fn hand_back(dir: &Path, found: &Identified) -> Result<(), Box<dyn Error>> {
    files::write(&dir.join("robot-identified.urdf"), urdf::urdf(&found.robot))?;
    let offsets = mastering::offsets(&found.robot, &found.result);
    files::write(&dir.join("mastering.csv"), mastering::csv(&offsets)?)?;
    let data = frames::data_list(&found.robot.name, &frames::frames(&found.result), &offsets);
    files::write(&dir.join(format!("{}.dat", frames::MODULE)), data)?;
    Ok(())
}

/// The ends of an interval as two cells, empty where there is none.
fn ends(interval: Option<[f64; 2]>) -> [Option<f64>; 2] {
    interval.map_or([None; 2], |ends| ends.map(Some))
}
