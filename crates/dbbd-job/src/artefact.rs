//! Reads and writes the chain of an artefact: the files from which it was made. `dbbd_model::provenance` defines the
//! chain.
//!
//! This module knows by what each kind of file is recognised and where its chain is kept, and not what the file contains.

use std::path::{Path, PathBuf};

use dbbd_model::base::hash::sha256;
use dbbd_model::base::serialised;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::provenance::{Artefact, ArtefactRole, Provenance, ProvenanceFinding, TracedArtefact};
use serde::{Deserialize, Serialize};
use serde_json::Value;

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

/// The kind of a text of ours, by the keys that it has or the columns that it begins with. Programs are recognised by their
/// language, and captures are no texts.
pub fn kind_of(text: &str) -> Option<ArtefactRole> {
    if let Ok(Value::Object(json)) = serde_json::from_str(text) {
        let has = |key: &str| json.contains_key(key);
        return match (has("job") && has("hash") && has("moves"), has("provenance"), has("parameters")) {
            (true, ..) => Some(ArtefactRole::Plan),
            (false, true, _) if has("table") => None,
            (false, true, _) if has("decision") => Some(ArtefactRole::Check),
            (false, true, _) if has("inputs") => Some(ArtefactRole::Comparison),
            (false, true, _) | (false, _, true) => Some(ArtefactRole::Result),
            (false, false, false) => None,
        };
    }
    if let Ok(table) = toml::from_str::<toml::Table>(text) {
        let has = |key: &str| table.contains_key(key);
        return match (has("joint"), has("bar") && has("robot")) {
            (true, _) if has("nominal") => Some(ArtefactRole::IdentifiedRobot),
            (true, _) => Some(ArtefactRole::Robot),
            (false, true) => Some(ArtefactRole::Job),
            (false, false) => None,
        };
    }
    let header = text.lines().next().unwrap_or_default();
    let has = |name: &str| header.split([',', ';', '\t']).any(|column| column == name);
    // A plan may have been saved by a spreadsheet.
    match (has("length_mm"), has("move") && has("dwell_s")) {
        (true, true) => Some(ArtefactRole::Plan),
        (true, false) => Some(ArtefactRole::Measurements),
        (false, _) => None,
    }
}

/// What was read of a file as one of the kind `wanted`. Where it could not be read because it is of another kind of ours, the
/// error says so.
pub fn read_as<T>(path: &Path, wanted: ArtefactRole, read: Result<T, Diagnostic>) -> Result<T, Diagnostic> {
    read.map_err(|error| {
        let found = files::read_text(path).ok().and_then(|text| kind_of(&text));
        let other = found.and_then(|found| found.instead_of(wanted));
        other.map_or(error, |other| Diagnostic::file(path.display(), other))
    })
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_of_ours_is_recognised_by_its_content() {
        for (text, kind) in [
            ("robot = \"kr60ha\"\n[bar]\nlength_mm = 300.0\n", Some(ArtefactRole::Job)),
            ("name = \"r\"\n[[joint]]\nd_mm = 1.0\n", Some(ArtefactRole::Robot)),
            ("[[joint]]\nd_mm = 1.0\n[nominal]\nname = \"r\"\n", Some(ArtefactRole::IdentifiedRobot)),
            (r#"{"job": {}, "hash": "", "moves": [], "provenance": {}}"#, Some(ArtefactRole::Plan)),
            (r#"{"parameters": []}"#, Some(ArtefactRole::Result)),
            (r#"{"decision": "pass", "provenance": {}}"#, Some(ArtefactRole::Check)),
            (r#"{"inputs": [], "provenance": {}}"#, Some(ArtefactRole::Comparison)),
            // The record beside a table.
            (r#"{"table": "t.csv", "provenance": {}}"#, None),
            ("index,circle,centre,kind,move,length_mm,dwell_s\n", Some(ArtefactRole::Plan)),
            ("index;circle;centre;kind;move;length_mm;dwell_s\n", Some(ArtefactRole::Plan)),
            ("index;length_mm;a1_deg\n", Some(ArtefactRole::Measurements)),
            ("a,b\n", None),
            ("", None),
        ] {
            assert_eq!(kind_of(text), kind, "{text}");
        }
    }

    #[test]
    fn only_a_file_of_another_kind_replaces_the_error() {
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("f.toml");
        std::fs::write(&file, "[[joint]]\nd_mm = 1.0\n[nominal]\nname = \"r\"\n").unwrap();
        let code = |wanted| {
            let unread = Err::<(), _>(Diagnostic::new(ProvenanceFinding::Edited));
            read_as(&file, wanted, unread).unwrap_err().code().as_str().to_owned()
        };
        assert_eq!([ArtefactRole::Plan, ArtefactRole::Job].map(code), ["E0104", "E0104"]);
        assert_eq!(code(ArtefactRole::Robot), "E1808");
        assert!(read_as(&file, ArtefactRole::Plan, Ok(())).is_ok());
    }
}
