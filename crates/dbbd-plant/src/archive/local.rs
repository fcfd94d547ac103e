//! A run on this computer: its capture and its results.

use dbbd_model::base::text::unreadable;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

use serde_json::Value;

use super::query::{ArchivedRun, is_sound};
use crate::ArchiveFinding::{NoRobot, NoSerial, NotACheck, NotRegistered, NotStored, NothingToPush};
use dbbd_job::files;
use dbbd_job::recording::capture::{CaptureRecord, CaptureSummary, RunEvent};
use dbbd_job::recording::run;
use dbbd_model::base::date;
use dbbd_model::base::hash::sha256;
use dbbd_model::base::serialised;
use dbbd_model::conformity::ConformityOutcome;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::provenance::{ArtefactRole, Identity, Provenance};

/// The name of the capture among the files of a run.
const CAPTURE: &str = "run.dbbd";
/// The result of an interim check.
const CHECK: &str = "check/check.json";

/// A file of a run.
pub(super) struct LocalFile {
    /// Path in the directory of the run: `run.dbbd`, `identify/result.json`.
    pub(super) name: String,
    pub(super) path: PathBuf,
    pub(super) sha256: String,
    pub(super) bytes: u64,
}

pub struct LocalRun {
    pub(super) record: ArchivedRun,
    pub(super) files: Vec<LocalFile>,
    /// Findings: damages, files that are not stored, missing data.
    findings: Vec<Diagnostic>,
}

/// The content of the directory of a run.
#[derive(Default)]
struct RunListing {
    files: Vec<(String, PathBuf)>,
    /// Entries that are not stored.
    skipped: Vec<PathBuf>,
}

impl LocalRun {
    /// The runs at `path`: a capture, the directory of a run, or a directory of run directories.
    pub fn find(path: &Path) -> Result<Vec<PathBuf>, Diagnostic> {
        if path.is_file() || path.join(CAPTURE).is_file() {
            return Ok(vec![path.to_owned()]);
        }
        let mut found = Vec::new();
        if path.is_dir() {
            let unreadable = unreadable(path.display());
            for entry in fs::read_dir(path).map_err(&unreadable)? {
                found.push(entry.map_err(&unreadable)?.path());
            }
        }
        found.retain(|path| path.join(CAPTURE).is_file());
        found.sort();
        if found.is_empty() {
            return Err(Diagnostic::file(path.display().to_string(), NothingToPush));
        }
        Ok(found)
    }

    /// Reads the run at `path`: a capture or the directory of a run.
    pub fn read(path: &Path) -> Result<Self, Diagnostic> {
        let mut found = RunListing::default();
        if path.is_dir() {
            list_files(path, "", &mut found)?;
        } else {
            found.files.push((CAPTURE.to_owned(), path.to_owned()));
        }
        let skipped = found.skipped.iter().map(|path| NotStored { file: path.display().to_string() }.into());
        let mut findings: Vec<Diagnostic> = skipped.collect();
        let found = found.files;
        let capture = found.iter().find(|(name, _)| name == CAPTURE).map(|(_, path)| path.clone());
        let capture = capture.ok_or_else(|| Diagnostic::file(path.display().to_string(), NothingToPush))?;
        let mut kept = Vec::new();
        for (name, path) in found {
            let bytes = fs::metadata(&path).map_err(unreadable(path.display()))?.len();
            kept.push(LocalFile { sha256: files::sha256(&path)?, name, path, bytes });
        }
        // The capture comes last: if it is in the store, so are its results.
        kept.sort_by_key(|file| (file.name == CAPTURE, file.name.clone()));
        let record = record(&capture, &kept, &mut findings)?;
        Ok(Self { record, files: kept, findings })
    }

    /// A hash of the names, lengths and times of the files of a run, which changes with each of them. No file is read.
    pub fn state(directory: &Path) -> Result<String, Diagnostic> {
        let mut found = RunListing::default();
        list_files(directory, "", &mut found)?;
        found.files.sort();
        let mut text = String::new();
        for (name, path) in found.files {
            let data = fs::metadata(&path).map_err(unreadable(path.display()))?;
            let at = data.modified().ok().and_then(|at| at.duration_since(UNIX_EPOCH).ok());
            text += &format!("{name} {} {}\n", data.len(), at.map_or(0, |at| at.as_nanos()));
        }
        Ok(sha256(text))
    }

    /// The SHA-256 of the run's capture.
    pub fn sha256(&self) -> &str {
        &self.record.sha256
    }

    pub fn findings(&self) -> &[Diagnostic] {
        &self.findings
    }
}

/// Lists the plain files with safe names, one level deep. Links are not followed.
fn list_files(directory: &Path, prefix: &str, found: &mut RunListing) -> Result<(), Diagnostic> {
    let unreadable = unreadable(directory.display());
    for entry in fs::read_dir(directory).map_err(&unreadable)? {
        let entry = entry.map_err(&unreadable)?;
        let (kind, own) = (entry.file_type().map_err(&unreadable)?, entry.file_name());
        let own = own.to_string_lossy();
        // Hidden and partial files do not belong to the run.
        if own.starts_with('.') || own.ends_with(".part") {
            continue;
        }
        let name = format!("{prefix}{own}");
        if kind.is_file() && is_sound(&name) {
            found.files.push((name, entry.path()));
        } else if kind.is_dir() && prefix.is_empty() {
            list_files(&entry.path(), &format!("{name}/"), found)?;
        } else {
            found.skipped.push(entry.path());
        }
    }
    Ok(())
}

/// The row of a run. Missing data are added to the findings.
fn record(
    capture: &Path,
    kept: &[LocalFile],
    findings: &mut Vec<Diagnostic>,
) -> Result<ArchivedRun, Diagnostic> {
    let (mut attachments, mut started, mut version) = (BTreeMap::new(), None, None);
    let pass = CaptureSummary::over(capture, |stamped| {
        match stamped.record {
            CaptureRecord::Attachment { name, content } => {
                attachments.insert(name, content);
            }
            CaptureRecord::Event(RunEvent::Started { unix_ns, version: by }) => {
                started = started.or(Some(unix_ns));
                version = Some(by);
            }
            CaptureRecord::Raw(_)
            | CaptureRecord::Samples(_)
            | CaptureRecord::Fault(_)
            | CaptureRecord::Axes(_)
            | CaptureRecord::Event(_) => {}
        }
        Ok(())
    })?;
    let file = capture.display().to_string();
    findings.extend(pass.all_findings().into_iter().map(|finding| Diagnostic::file(&file, finding)));
    let unread = run::unread(&file, &attachments, started);
    findings.extend(unread.map(|why| NotRegistered { why: why.to_string() }.into()));
    let (plan, provenance) = run::sources(&attachments, started, version)?;
    let own = kept.iter().find(|file| file.name == CAPTURE);
    let (sha256, bytes) = own.map_or_else(Default::default, |own| (own.sha256.clone(), own.bytes));
    let Provenance { from, identity, .. } = &provenance;
    let robots = from
        .iter()
        .rev()
        .filter(|source| matches!(source.role, ArtefactRole::Robot | ArtefactRole::IdentifiedRobot));
    let kind = robots.map(|robot| robot.name.clone()).next();
    let kind = kind.or_else(|| {
        let robot: toml::Table = plan.as_ref()?.header.robot.parse().ok()?;
        Some(robot.get("name")?.as_str()?.to_owned())
    });
    let Identity { robot, cell, operator, measured, bar, .. } = identity.clone();
    let measured = measured.or_else(|| started.map(date::utc)).unwrap_or_default();
    if robot.is_none() {
        let run = sha256.clone();
        findings
            .push(kind.clone().map_or(NoRobot { run: run.clone() }, |robot| NoSerial { run, robot }).into());
    }
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
        decision: decision(kept, findings),
        provenance: serialised::json_line(&provenance)?,
    })
}

/// The decision of the check beside the capture.
fn decision(kept: &[LocalFile], findings: &mut Vec<Diagnostic>) -> Option<String> {
    const MAX_CHECK_FILE_BYTES: u64 = 64 << 20;
    let check = kept.iter().find(|file| file.name == CHECK)?;
    let text = files::read_at_most(&check.path, MAX_CHECK_FILE_BYTES).ok();
    let json = text.and_then(|text| serde_json::from_str::<Value>(&text).ok());
    let decision = json.and_then(|json| json.get("decision").and_then(Value::as_str).map(str::to_owned));
    let is_known = |word: &String| ConformityOutcome::ALL.iter().any(|one| one.name() == word);
    let decision = decision.filter(is_known);
    if decision.is_none() {
        findings.push(Diagnostic::file(check.path.display().to_string(), NotACheck));
    }
    decision
}
