//! Any artefact that dbbd writes or reads, by what is in the file.

use std::fs;
use std::path::Path;

use serde_json::Value;

use super::Output;
use super::info::line;
use crate::base::{clock, files, serialised};
use crate::catalogue::ProvenanceFinding::{self, OtherThanPlanned, SerialOfNoBall};
use crate::diagnostic::Diagnostic;
use crate::plan::Job;
use crate::program::{self, Language};
use crate::provenance::{Artefact, Contradiction, Identity, Provenance, Role, Traced};
use crate::recording::run;
use crate::robot::Robot;

/// An artefact with its chain; `None` of a file of another kind. A capture is read elsewhere.
///
/// # Errors
/// What is wrong in the file.
pub(super) fn read(path: &Path, out: &Output) -> Result<Option<Traced>, Diagnostic> {
    let name = path.display().to_string();
    let bytes = fs::read(path).map_err(files::unreadable(&name))?;
    // A program may be in an old code page; what is read of it is ASCII.
    let text = String::from_utf8_lossy(&bytes);
    let first = text.lines().next().unwrap_or_default();
    if serialised::is_sealed_toml(&text) == Some(false) {
        out.finding(Diagnostic::file(&name, ProvenanceFinding::RobotEdited));
    }
    if let Ok(Value::Object(json)) = serde_json::from_str(&text) {
        if ["job", "hash", "moves"].iter().all(|key| json.contains_key(*key)) {
            return plan(path);
        }
        if let Some(table) = json.get("table").and_then(Value::as_str)
            && json.contains_key("provenance")
        {
            return read(&path.with_file_name(table), out);
        }
        // A record beside a table has the hash of the table, a plan that of its content.
        serialised::check_seal(&text).map_err(|finding| Diagnostic::file(&name, finding))?;
        if ["provenance", "parameters"].iter().any(|key| json.contains_key(*key)) {
            serialised::check_seal(&text).map_err(|finding| Diagnostic::file(&name, finding))?;
            let damaged = |error: serde_json::Error| {
                Diagnostic::file(&name, ProvenanceFinding::Damaged { why: error.to_string() })
            };
            let recorded = json.get("provenance").cloned().map(serde_json::from_value).transpose();
            let role = match json {
                json if json.contains_key("decision") => Role::Check,
                json if json.contains_key("inputs") => Role::Comparison,
                _ => Role::Result,
            };
            return with(role, path, recorded.map_err(damaged)?.unwrap_or_default());
        }
    } else if path.extension().is_some_and(|extension| extension == "json")
        && let Err(error) = serde_json::from_str::<Value>(&text)
    {
        let why = error.to_string();
        return Err(Diagnostic::file(&name, ProvenanceFinding::Damaged { why }));
    } else if let Ok(table) = toml::from_str::<toml::Table>(&text) {
        if table.contains_key("joint") {
            let text = files::read(path)?;
            return Ok(Some(Robot::from_toml(&name, &text)?.traced(&text)));
        }
        if table.contains_key("bar") && table.contains_key("robot") {
            let job = Job::from_toml(&name, &text)?;
            return job.traced(path).map(Some);
        }
    } else if first.starts_with("index,circle,centre,kind,move") {
        return plan(path);
    } else if first.split(',').any(|column| column == "length_mm") {
        let (table, changed) = Traced::table(Role::Measurements, path)?;
        changed.into_iter().for_each(|finding| out.finding(finding));
        return Ok(Some(table));
    } else if Language::of_text(&text).is_some() {
        return with(Role::Program, path, program::provenance(&name, &text)?);
    }
    Ok(None)
}

fn with(role: Role, path: &Path, provenance: Provenance) -> Result<Option<Traced>, Diagnostic> {
    Ok(Some(Traced { artefact: Artefact::file(role, path)?, provenance }))
}

/// `plan.csv` and `plan.json` are one artefact.
fn plan(path: &Path) -> Result<Option<Traced>, Diagnostic> {
    Ok(Some(run::read_plan(&path.with_extension("csv"))?.traced()?))
}

/// What a file states of a measurement.
///
/// # Errors
/// What is wrong in the file.
pub(super) fn identity(path: &Path) -> Result<Identity, Diagnostic> {
    let file = path.display().to_string();
    let identity = Identity::from_toml(&file, &files::read(path)?)?;
    identity.check_dates(clock::unix_ns()).map_err(|(_, finding)| Diagnostic::file(&file, finding))?;
    Ok(identity)
}

/// What is stated that cannot be of a run of a job with so many base balls: another robot, bar, certificate or temperature of the
/// bar, by which the lengths were computed, or a ball that it has not. The rest may be known better after the run.
pub(super) fn other_run(job: &Identity, balls: usize, stated: &Identity) -> Vec<ProvenanceFinding> {
    let other = job.contradictions(stated).into_iter();
    let is_fixed = |key: &str| key == "robot" || key.starts_with("bar.") || key == "celsius of bar";
    let other = other.filter(|found| is_fixed(&found.key));
    let other =
        other.map(|Contradiction { key, known, stated }| OtherThanPlanned { key, planned: known, stated });
    let is_further = |ball: &&String| ball.parse::<usize>().is_ok_and(|number| number > balls);
    let further = stated.balls.keys().filter(is_further);
    other.chain(further.map(|ball| SerialOfNoBall { ball: ball.clone(), balls })).collect()
}

/// The artefact and its chain on the screen.
pub(super) fn show(traced: &Traced, out: &Output) {
    let Traced { artefact, provenance } = traced;
    line(out, &artefact.role.to_string(), &artefact.name);
    line(out, "SHA-256", &artefact.sha256);
    if let Some(serial) = &artefact.serial {
        line(out, "serial number", serial);
    }
    chain(provenance, out);
}

/// What an artefact was made from, the newest first.
pub(super) fn chain(provenance: &Provenance, out: &Output) {
    for (name, value) in provenance.identity.facts() {
        line(out, &name, &value);
    }
    if provenance.from.is_empty() {
        return line(out, "made from", "not recorded");
    }
    if !provenance.dbbd.is_empty() {
        line(out, "made by", &format!("dbbd {}", provenance.dbbd));
    }
    for (at, source) in provenance.from.iter().rev().enumerate() {
        line(out, if at == 0 { "made from" } else { "" }, &format!("{:17}{source}", source.role));
    }
}
