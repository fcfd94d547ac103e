//! A run on this computer: its capture, and what was made from it.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

use serde_json::Value;

use super::query::ArchivedRun;
use crate::base::hash::sha256;
use crate::base::{date, files, serialised};
use crate::catalogue::ArchiveFinding::NothingToPush;
use crate::diagnostic::Diagnostic;
use crate::provenance::{Identity, Provenance, Role};
use crate::recording::capture::{Event, Pass, Record};
use crate::recording::run;

/// The name of the capture among the files of a run.
pub(super) const CAPTURE: &str = "run.dbbd";
/// The decision of an interim check.
const CHECK: &str = "check/check.json";

/// A file of a run.
pub(super) struct LocalFile {
    /// As `run.dbbd`, `identify/result.json`.
    pub(super) name: String,
    pub(super) path: PathBuf,
    pub(super) sha256: String,
    pub(super) bytes: u64,
}

/// A run on this computer.
pub struct LocalRun {
    pub(super) record: ArchivedRun,
    pub(super) files: Vec<LocalFile>,
}

/// A name of one or two parts that leads nowhere else.
pub(super) fn is_sound(name: &str) -> bool {
    let part = |part: &str| {
        (1..=100).contains(&part.len())
            && !part.starts_with('.')
            && part.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"._-".contains(&byte))
    };
    name.split('/').count() <= 2 && name.split('/').all(part)
}

impl LocalRun {
    /// The runs at `path`: a capture, the directory of a run, or a directory of such.
    ///
    /// # Errors
    /// There is none.
    pub fn find(path: &Path) -> Result<Vec<PathBuf>, Diagnostic> {
        if path.is_file() || path.join(CAPTURE).is_file() {
            return Ok(vec![path.to_owned()]);
        }
        let entries = fs::read_dir(path).into_iter().flatten().flatten().map(|entry| entry.path());
        let mut found: Vec<PathBuf> = entries.filter(|path| path.join(CAPTURE).is_file()).collect();
        found.sort();
        if found.is_empty() {
            return Err(Diagnostic::file(&path.display().to_string(), NothingToPush));
        }
        Ok(found)
    }

    /// Reads the run at `path`: a capture, or the directory of a run.
    ///
    /// # Errors
    /// What cannot be read, or is no capture.
    pub fn read(path: &Path) -> Result<Self, Diagnostic> {
        let mut found = Vec::new();
        if path.is_dir() {
            list(path, "", &mut found)?;
        } else {
            found.push((CAPTURE.to_owned(), path.to_owned()));
        }
        let capture = found.iter().find(|(name, _)| name == CAPTURE).map(|(_, path)| path.clone());
        let capture = capture.ok_or_else(|| Diagnostic::file(&path.display().to_string(), NothingToPush))?;
        let mut kept = Vec::new();
        for (name, path) in found {
            let bytes = fs::metadata(&path).map_err(files::unreadable(path.display()))?.len();
            kept.push(LocalFile { sha256: files::sha256(&path)?, name, path, bytes });
        }
        // The capture last: where it is in the store, all that was made from it is.
        kept.sort_by_key(|file| (file.name == CAPTURE, file.name.clone()));
        let record = record(&capture, &kept)?;
        Ok(Self { record, files: kept })
    }

    /// What changes whenever a file of the run in `directory` does: a hash of names, lengths and times. Nothing is read.
    pub fn state(directory: &Path) -> Result<String, Diagnostic> {
        let mut found = Vec::new();
        list(directory, "", &mut found)?;
        found.sort();
        let mut text = String::new();
        for (name, path) in found {
            let data = fs::metadata(&path).map_err(files::unreadable(path.display()))?;
            // A system without times of files has lengths.
            let at = data.modified().ok().and_then(|at| at.duration_since(UNIX_EPOCH).ok());
            text += &format!("{name} {} {}\n", data.len(), at.map_or(0, |at| at.as_nanos()));
        }
        Ok(sha256(text))
    }

    /// The SHA-256 of its capture.
    pub fn sha256(&self) -> &str {
        &self.record.sha256
    }
}

/// Plain files with sound names, one level deep: no link is followed.
fn list(directory: &Path, prefix: &str, found: &mut Vec<(String, PathBuf)>) -> Result<(), Diagnostic> {
    let entries = fs::read_dir(directory).map_err(files::unreadable(directory.display()))?;
    for entry in entries.flatten() {
        let Ok(kind) = entry.file_type() else { continue };
        let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
        if kind.is_file() && is_sound(&name) && !name.ends_with(".part") {
            found.push((name, entry.path()));
        } else if kind.is_dir() && prefix.is_empty() {
            list(&entry.path(), &format!("{name}/"), found)?;
        }
    }
    Ok(())
}

/// What the registry states of a run.
fn record(capture: &Path, kept: &[LocalFile]) -> Result<ArchivedRun, Diagnostic> {
    let (mut attachments, mut started, mut version) = (BTreeMap::new(), None, None);
    Pass::over(capture, |stamped| {
        match stamped.record {
            Record::Attachment { name, content } => {
                attachments.insert(name, content);
            }
            Record::Event(Event::Started { unix_ns, version: by }) => {
                started = started.or(Some(unix_ns));
                version = Some(by);
            }
            _ => {}
        }
        Ok(())
    })?;
    let (plan, provenance) = run::sources(&attachments, started, version)?;
    let own = kept.iter().find(|file| file.name == CAPTURE);
    let (sha256, bytes) = own.map_or_else(Default::default, |own| (own.sha256.clone(), own.bytes));
    let Provenance { from, identity, .. } = &provenance;
    let robots =
        from.iter().rev().filter(|source| matches!(source.role, Role::Robot | Role::IdentifiedRobot));
    let kind = robots.map(|robot| robot.name.clone()).next();
    let kind = kind.or_else(|| {
        let robot: toml::Table = plan.as_ref()?.header.robot.parse().ok()?;
        Some(robot.get("name")?.as_str()?.to_owned())
    });
    let Identity { robot, cell, operator, measured, bar, .. } = identity.clone();
    let measured = measured.or_else(|| started.map(date::utc)).unwrap_or_default();
    Ok(ArchivedRun {
        sha256,
        cell: cell.unwrap_or_default(),
        robot: robot.or_else(|| kind.clone()).unwrap_or_default(),
        kind: kind.unwrap_or_default(),
        bar: bar.serial.unwrap_or_default(),
        certificate: bar.certificate,
        certified_on: bar.certified_on,
        operator,
        measured,
        plan: plan.map(|plan| plan.header.hash),
        bytes,
        decision: decision(kept),
        provenance: serialised::json_line(&provenance)?,
    })
}

/// That of the check beside the capture.
fn decision(kept: &[LocalFile]) -> Option<String> {
    const MOST_BYTES: u64 = 64 << 20;
    let check = kept.iter().find(|file| file.name == CHECK)?;
    let text = files::read_at_most(&check.path, MOST_BYTES).ok()?;
    let json: Value = serde_json::from_str(&text).ok()?;
    Some(json.get("decision")?.as_str()?.to_owned())
}
