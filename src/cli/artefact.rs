//! Recognises the artefacts that dbbd reads and writes by their content.

use std::path::Path;

use serde_json::Value;

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
    if Seal::Toml.check(&text).is_err() {
        out.finding(Diagnostic::file(&name, ProvenanceFinding::RobotEdited));
    }
    let json = match serde_json::from_str(&text) {
        Ok(json) => json,
        Err(error) if path.extension().is_some_and(|extension| extension == "json") => {
            return Err(damaged(path, &error));
        }
        Err(_) => Value::Null,
    };
    let kind = dbbd_job::artefact::kind_of(&text);
    match kind {
        Some(ArtefactRole::Plan) => run::read_plan(path)?.traced().map(Some).map_err(Diagnostic::from),
        Some(ArtefactRole::Robot | ArtefactRole::IdentifiedRobot) => {
            let text = files::read_text(path)?;
            Ok(Some(Robot::from_toml(&name, &text)?.traced(&text)))
        }
        Some(ArtefactRole::Job) => Job::from_toml(&name, &text)?.traced(path).map(Some),
        Some(ArtefactRole::Measurements) => {
            let (table, changed) = dbbd_job::artefact::of_table(ArtefactRole::Measurements, path)?;
            out.findings(changed);
            Ok(Some(table))
        }
        Some(
            ArtefactRole::Program
            | ArtefactRole::Capture
            | ArtefactRole::BaseBalls
            | ArtefactRole::Prior
            | ArtefactRole::Result
            | ArtefactRole::Check
            | ArtefactRole::Comparison,
        )
        | None => match (json.get("table").and_then(Value::as_str), json.get("provenance")) {
            // The record beside a table.
            (Some(table), Some(_)) => read_traced(&path.with_file_name(table), out),
            (_, recorded) if json.is_object() => of_json(kind, path, &text, recorded),
            _ if Language::of_text(&text).is_some() => {
                with(ArtefactRole::Program, path, program::provenance(&name, &text)?)
            }
            _ => Ok(None),
        },
    }
}

/// A file that ends with its own hash, with the provenance that it records.
fn of_json(
    kind: Option<ArtefactRole>,
    path: &Path,
    text: &str,
    recorded: Option<&Value>,
) -> Result<Option<TracedArtefact>, Diagnostic> {
    Seal::Json.check(text).map_err(|finding| Diagnostic::file(path.display(), finding))?;
    let Some(role) = kind else { return Ok(None) };
    let recorded = recorded.cloned().map(serde_json::from_value).transpose();
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
