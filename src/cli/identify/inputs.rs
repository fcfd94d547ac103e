//! The inputs of an identification: observations, points, priors, workspaces.

use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;

use crate::diag::Diagnostic;
use crate::files;
use crate::identify::PriorScale;
use crate::model::parameter::SetUp;
use crate::model::{AXES, Observations, ParamId};
use crate::table::{self, Columns};

pub(super) fn parse_point(text: &str) -> Result<[f64; 3], String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse::<f64>()).collect();
    match numbers.as_deref() {
        Ok(&[x, y, z]) if [x, y, z].iter().all(|v| v.is_finite()) => Ok([x, y, z]),
        _ => Err("three numbers in mm are needed, as 30,20,10".into()),
    }
}

pub(super) fn parse_positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err("a positive number is needed".into()),
    }
}

/// A factor, or `auto`.
pub(super) fn parse_scale(text: &str) -> Result<PriorScale, String> {
    match text {
        "auto" => Ok(PriorScale::CrossValidated),
        _ => parse_positive(text).map(PriorScale::By).map_err(|why| format!("`auto`, or {why}")),
    }
}

/// A CSV `name,unit,sd`; a parameters.csv of an earlier identification is one.
pub(super) fn read_prior(path: &Path, set_up: SetUp) -> Result<BTreeMap<ParamId, f64>, Box<dyn Error>> {
    let file = path.display().to_string();
    let text = files::read(path)?;
    let mut reader = table::reader().from_reader(text.as_bytes());
    let header = reader.headers().map_err(|error| Diagnostic::csv(&file, &error))?.clone();
    let columns = Columns { file: &file, header: &header };
    let [name, unit, sd] = columns.required(["name", "unit", "sd"])?;
    let mut prior = BTreeMap::new();
    for record in reader.records() {
        let record = record.map_err(|error| Diagnostic::csv(&file, &error))?;
        let row = columns.row(&record);
        let Some(value) = row.given(Some(sd), |at| row.positive(at, "a standard deviation is positive"))?
        else {
            continue;
        };
        let id: ParamId = row.text(name).parse().map_err(|why| row.line(format!("{why}")))?;
        set_up.check(id).map_err(|why| row.line(format!("{why}")))?;
        if row.text(unit) != id.unit() {
            return Err(row.line(format!("`{id}` is in {}, not in `{}`", id.unit(), row.text(unit))).into());
        }
        if prior.insert(id, value).is_some() {
            return Err(row.line(format!("`{id}` stands there twice")).into());
        }
    }
    Ok(prior)
}

/// A CSV with the columns a1_deg..a6_deg, more may stand beside them.
pub(super) fn read_workspace(path: &Path) -> Result<Vec<[f64; AXES]>, Box<dyn Error>> {
    let file = path.display().to_string();
    let poses = Observations::poses_from_csv(&file, &files::read(path)?)?;
    Ok(poses.into_iter().map(|axes| axes.map(f64::to_radians)).collect())
}

/// Columns that a `plan.csv` has and no table of measured lengths.
const PLAN: [&str; 2] = ["move", "dwell_s"];

/// The observations of a CSV, which is never whole in memory.
///
/// # Errors
/// Names the path and why it could not be read, or the line and what is wrong there.
pub(crate) fn observations(path: &Path) -> Result<Observations, Diagnostic> {
    let name = path.display().to_string();
    let wrong = |error: csv::Error| Diagnostic::csv(&name, &error);
    let mut reader = table::reader().from_path(path).map_err(wrong)?;
    let header = reader.headers().map_err(wrong)?.clone();
    if PLAN.iter().all(|wanted| header.iter().any(|name| name == *wanted)) {
        let message = "is a plan: its lengths are those that are wanted, not measured ones";
        return Err(
            Diagnostic::file(&name, message).help("measure them: `dbbd acquire`, then give the capture")
        );
    }
    Observations::from_records(&name, &header, |record| reader.read_record(record))
}
