//! Reads and writes the chain of an artefact: the files from which it was made. `dbbd_model::provenance` defines the
//! chain.
//!
//! This module knows where the chain of each kind of file is kept, and not what the file contains.

use std::path::{Path, PathBuf};

use dbbd_model::base::hash::sha256;
use dbbd_model::base::serialised;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::provenance::{Artefact, ArtefactRole, Provenance, ProvenanceFinding, TracedArtefact};
use serde::{Deserialize, Serialize};

use crate::files;

/// dbbd's version; in a release build from a repository with the commit.
pub const VERSION: &str = env!("DBBD_VERSION");

/// The file beside a CSV table that holds the chain of the table, because the table has no place for it.
#[derive(Serialize, Deserialize)]
struct TableRecord {
    table: String,
    /// SHA-256 of the table.
    sha256: String,
    provenance: Provenance,
}

/// A file as an artefact.
pub fn of_file(role: ArtefactRole, path: &Path) -> Result<Artefact, Diagnostic> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    Ok(Artefact { role, name, serial: None, sha256: files::sha256(path)?, origin: None })
}

/// The path of the file that records the chain of a table.
fn record_of(table: &Path) -> PathBuf {
    table.with_extension("provenance.json")
}

/// A table with the chain that the file beside it records, and a finding if the table was changed since then.
pub fn of_table(role: ArtefactRole, path: &Path) -> Result<(TracedArtefact, Option<Diagnostic>), Diagnostic> {
    let artefact = of_file(role, path)?;
    let beside = record_of(path);
    let Some(text) = files::read_if_file(&beside).transpose()? else {
        return Ok((artefact.into(), None));
    };
    let TableRecord { sha256, provenance, .. } = serde_json::from_str(&text).map_err(|error| {
        Diagnostic::file(beside.display(), ProvenanceFinding::Damaged { why: error.to_string() })
    })?;
    let changed = (sha256 != artefact.sha256).then(|| {
        let record = beside.display().to_string();
        Diagnostic::file(path.display(), ProvenanceFinding::TableChanged { record })
    });
    let artefact = Artefact { origin: provenance.origin(), ..artefact };
    Ok((TracedArtefact { artefact, provenance }, changed))
}

/// The provenance of a file that this version makes from `inputs`.
pub fn made_from<'a>(inputs: impl IntoIterator<Item = &'a TracedArtefact>) -> Provenance {
    Provenance::made_by(VERSION, inputs)
}

/// Moves a table at `path` aside, with the record beside it, unless the record proves that nobody changed it since it was
/// written. Returns where it is then.
pub fn move_edited_aside(path: &Path) -> Result<Option<PathBuf>, Diagnostic> {
    if !path.is_file() {
        return Ok(None);
    }
    let record = record_of(path);
    let is_own = record.is_file() && matches!(of_table(ArtefactRole::Measurements, path), Ok((_, None)));
    if is_own {
        return Ok(None);
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let mut aside = (1_u32..).map(|number| path.with_file_name(format!("previous-{number}-{name}")));
    let free = aside.find(|aside| !aside.exists() && !record_of(aside).exists());
    let Some(aside) = free else { return Ok(None) };
    std::fs::rename(path, &aside).map_err(files::unwritable(&aside))?;
    if record.is_file() {
        let beside = record_of(&aside);
        std::fs::rename(&record, &beside).map_err(files::unwritable(&beside))?;
    }
    Ok(Some(aside))
}

/// Writes the chain of the table at `path`, whose text is `content`, into the file beside it.
pub fn write_beside(provenance: &Provenance, path: &Path, content: &str) -> Result<(), Diagnostic> {
    let table = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let record = TableRecord { table, sha256: sha256(content), provenance: provenance.clone() };
    files::write_file(&record_of(path), serialised::json(&record)?)
}
