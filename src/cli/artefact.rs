//! Recognises the artefacts that dbbd reads and writes by their content.

use std::path::Path;

use serde_json::{Map, Value};

use super::{CommandOutput, output};
use dbbd_job::files;
use dbbd_job::plan::Job;
use dbbd_job::program::{self, Language};
use dbbd_job::recording::run;
use dbbd_model::base::serialised::Seal;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::provenance::ProvenanceFinding;
use dbbd_model::provenance::{ArtefactRole, Provenance, TracedArtefact};
use dbbd_model::robot::Robot;

/// An artefact with its chain; `None` if the file is of another kind. Captures are not recognised here.
pub(super) fn read_traced(path: &Path, out: &CommandOutput) -> Result<Option<TracedArtefact>, Diagnostic> {
    let name = path.display().to_string();
    let bytes = files::read_bytes(path, files::MAX_TEXT_BYTES)?;
    // A program may be in an old code page. What is read of it here is ASCII.
    let text = String::from_utf8_lossy(&bytes);
    let first_line = text.lines().next().unwrap_or_default();
    if Seal::Toml.check(&text).is_err() {
        out.finding(Diagnostic::file(&name, ProvenanceFinding::RobotEdited));
    }
    match serde_json::from_str(&text) {
        Ok(Value::Object(json)) => return of_json(path, &text, &json, out),
        Err(error) if path.extension().is_some_and(|extension| extension == "json") => {
            return Err(damaged(path, &error));
        }
        _ => {}
    }
    if let Ok(table) = toml::from_str::<toml::Table>(&text) {
        if table.contains_key("joint") {
            let text = files::read_text(path)?;
            return Ok(Some(Robot::from_toml(&name, &text)?.traced(&text)));
        }
        if table.contains_key("bar") && table.contains_key("robot") {
            return Job::from_toml(&name, &text)?.traced(path).map(Some);
        }
    } else if first_line.starts_with("index,circle,centre,kind,move") {
        return plan(path);
    } else if first_line.split(',').any(|column| column == "length_mm") {
        let (table, changed) = dbbd_job::artefact::of_table(ArtefactRole::Measurements, path)?;
        out.findings(changed);
        return Ok(Some(table));
    } else if Language::of_text(&text).is_some() {
        return with(ArtefactRole::Program, path, program::provenance(&name, &text)?);
    }
    Ok(None)
}

fn of_json(
    path: &Path,
    text: &str,
    json: &Map<String, Value>,
    out: &CommandOutput,
) -> Result<Option<TracedArtefact>, Diagnostic> {
    let has = |key: &str| json.contains_key(key);
    if has("job") && has("hash") && has("moves") {
        return plan(path);
    }
    if let Some(table) = json.get("table").and_then(Value::as_str)
        && has("provenance")
    {
        return read_traced(&path.with_file_name(table), out);
    }
    // The files above have a `sha256` of their own kind.
    Seal::Json.check(text).map_err(|finding| Diagnostic::file(path.display(), finding))?;
    if !has("provenance") && !has("parameters") {
        return Ok(None);
    }
    let role = if has("decision") {
        ArtefactRole::Check
    } else if has("inputs") {
        ArtefactRole::Comparison
    } else {
        ArtefactRole::Result
    };
    let recorded = json.get("provenance").cloned().map(serde_json::from_value).transpose();
    with(role, path, recorded.map_err(|error| damaged(path, &error))?.unwrap_or_default())
}

fn damaged(path: &Path, error: &serde_json::Error) -> Diagnostic {
    Diagnostic::file(path.display(), ProvenanceFinding::Damaged { why: error.to_string() })
}

fn with(
    role: ArtefactRole,
    path: &Path,
    provenance: Provenance,
) -> Result<Option<TracedArtefact>, Diagnostic> {
    Ok(Some(TracedArtefact { artefact: dbbd_job::artefact::of_file(role, path)?, provenance }))
}

/// `plan.csv` and `plan.json` are one artefact.
fn plan(path: &Path) -> Result<Option<TracedArtefact>, Diagnostic> {
    Ok(Some(run::read_plan(&path.with_extension("csv"))?.traced()?))
}

/// Prints an artefact and its chain.
pub(super) fn show_artefact(traced: &TracedArtefact, out: &CommandOutput) {
    let TracedArtefact { artefact, provenance } = traced;
    out.field(&artefact.role.to_string(), &artefact.name);
    out.field("SHA-256", &artefact.sha256);
    if let Some(serial) = &artefact.serial {
        out.field("serial number", serial);
    }
    if let Some(origin) = artefact.origin.or(provenance.origin()) {
        out.field("readings are", output::origin(Some(origin)));
    }
    show_chain(provenance, out);
}

/// Prints the identity and the sources of an artefact, the last source first.
pub(super) fn show_chain(provenance: &Provenance, out: &CommandOutput) {
    for (name, value) in provenance.identity.facts() {
        out.field(&name, value);
    }
    if provenance.from.is_empty() {
        return out.field("made from", "not recorded");
    }
    if !provenance.dbbd.is_empty() {
        out.field("made by", format!("dbbd {}", provenance.dbbd));
    }
    for (at, source) in provenance.from.iter().rev().enumerate() {
        out.field(if at == 0 { "made from" } else { "" }, format!("{:17}{source}", source.role));
    }
}
