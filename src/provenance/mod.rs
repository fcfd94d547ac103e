//! What an artefact was made from: the chain from job and robot file to a corrected program.
//!
//! An artefact is known by the SHA-256 of its file. It carries those that it was made from and whose measurement it is,
//! and a command compares the chains of its inputs before it computes. A chain has no date but that of a capture's own
//! clock, and no path: the same inputs give the same bytes.

mod contradiction;
mod identity;

use std::fmt;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::base::files;
use crate::base::hash::sha256;
use crate::base::serialised;
use crate::catalogue::ProvenanceFinding;
use crate::diagnostic::Diagnostic;
pub use contradiction::Contradiction;
pub use identity::{BarIdentity, CERTIFIED_C, Identity, LENGTH_U_MM, Temperature, Wrong, check_text};

/// dbbd's version, with the commit where it was built from a repository.
pub const VERSION: &str = env!("DBBD_VERSION");

/// What an artefact is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    Job,
    Robot,
    IdentifiedRobot,
    Plan,
    Program,
    Capture,
    /// A table of lengths at poses.
    Measurements,
    BaseBalls,
    Prior,
    Result,
    Check,
    Comparison,
}

impl fmt::Display for Role {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.pad(match self {
            Self::Job => "job",
            Self::Robot => "robot",
            Self::IdentifiedRobot => "identified robot",
            Self::Plan => "plan",
            Self::Program => "program",
            Self::Capture => "capture",
            Self::Measurements => "measurements",
            Self::BaseBalls => "base balls",
            Self::Prior => "prior",
            Self::Result => "result",
            Self::Check => "check",
            Self::Comparison => "comparison",
        })
    }
}

/// A file that something was made from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Artefact {
    pub role: Role,
    /// A robot's name, a plan's hash, else the file's name without its directory.
    pub name: String,
    /// Of the robot; of a job that of its bar.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serial: Option<String>,
    /// Of the file's content, in hexadecimal digits.
    pub sha256: String,
}

impl Artefact {
    /// One whose content is in memory.
    pub fn new(role: Role, name: impl Into<String>, content: impl AsRef<[u8]>) -> Self {
        Self { role, name: name.into(), serial: None, sha256: sha256(content) }
    }

    /// The file at `path`.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn file(role: Role, path: &Path) -> Result<Self, Diagnostic> {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Ok(Self { role, name, serial: None, sha256: files::sha256(path)? })
    }

    /// The first digits of its hash.
    pub fn short_hash(&self) -> &str {
        self.sha256.get(..12).unwrap_or(&self.sha256)
    }

    /// Whether the robot in this artefact is another one than `other`: by their serial numbers where both are known, else
    /// by their names.
    pub fn differs(&self, other: &Self) -> Option<Difference> {
        match (&self.serial, &other.serial) {
            (Some(this), Some(other)) => (this != other).then_some(Difference::Serial),
            _ if self.name != other.name => Some(Difference::Name),
            _ => None,
        }
    }
}

impl fmt::Display for Artefact {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let serial =
            self.serial.as_ref().map_or_else(String::new, |serial| format!(", serial number {serial}"));
        write!(out, "{}{serial} ({})", self.name, self.short_hash())
    }
}

/// By what two robots are not the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Difference {
    Serial,
    Name,
}

/// What an artefact was made from, and by which version. Empty where that was not recorded.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// The version of dbbd that made it.
    #[serde(default)]
    pub dbbd: String,
    /// Each artefact once, before what was made from it.
    #[serde(default)]
    pub from: Vec<Artefact>,
    /// Who measured what, where and when.
    #[serde(default, skip_serializing_if = "Identity::is_empty")]
    pub identity: Identity,
}

/// An artefact with what it was made from.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Traced {
    #[serde(flatten)]
    pub artefact: Artefact,
    pub provenance: Provenance,
}

/// What the file beside a table says of it: a table has no place for its chain.
#[derive(Serialize, Deserialize)]
struct TableRecord {
    table: String,
    /// Of the table, in hexadecimal digits.
    sha256: String,
    provenance: Provenance,
}

impl From<Artefact> for Traced {
    /// One that is not known to be made from others.
    fn from(artefact: Artefact) -> Self {
        Self { artefact, provenance: Provenance::default() }
    }
}

impl Traced {
    /// The file that records what the table at `path` was made from.
    pub fn record_of(table: &Path) -> PathBuf {
        table.with_extension("provenance.json")
    }

    /// A table, with its chain where the file beside it has it, and that it was changed since.
    ///
    /// # Errors
    /// A file that cannot be read, or a record that is damaged.
    pub fn table(role: Role, path: &Path) -> Result<(Self, Option<Diagnostic>), Diagnostic> {
        let artefact = Artefact::file(role, path)?;
        let beside = Self::record_of(path);
        let Some(text) = files::read_if_file(&beside).transpose()? else {
            return Ok((artefact.into(), None));
        };
        let TableRecord { sha256, provenance, .. } = serde_json::from_str(&text).map_err(|error| {
            let why = error.to_string();
            Diagnostic::file(&beside.display().to_string(), ProvenanceFinding::Damaged { why })
        })?;
        let changed = (sha256 != artefact.sha256).then(|| {
            let record = beside.display().to_string();
            Diagnostic::file(&path.display().to_string(), ProvenanceFinding::TableChanged { record })
        });
        Ok((Self { artefact, provenance }, changed))
    }

    /// What it was made from, and itself.
    pub fn chain(&self) -> impl DoubleEndedIterator<Item = &Artefact> {
        self.provenance.from.iter().chain([&self.artefact])
    }

    /// The newest robot in its chain.
    pub fn robot(&self) -> Option<&Artefact> {
        let robots = [Role::Robot, Role::IdentifiedRobot];
        self.chain().rev().find(|artefact| robots.contains(&artefact.role))
    }

    /// That it was made for one robot, and another one is given.
    pub fn of_another_robot(&self, made_for: &Artefact, given: &Artefact) -> ProvenanceFinding {
        let [artefact, made_for, given] = [&self.artefact, made_for, given].map(ToString::to_string);
        ProvenanceFinding::OtherRobot { artefact, made_for, given }
    }

    /// That an identified robot was made from the calibration on which this one rests: a newer one is there.
    pub fn outdated_by(&self, newer: &Traced) -> Option<ProvenanceFinding> {
        let used = self.robot().filter(|robot| robot.role == Role::IdentifiedRobot)?;
        (newer.artefact.sha256 != used.sha256 && newer.provenance.has(used)).then(|| {
            let artefact = self.artefact.to_string();
            ProvenanceFinding::Outdated {
                artefact,
                used: used.to_string(),
                newest: newer.artefact.to_string(),
            }
        })
    }
}

/// That no two artefacts, each with the name that the user gave, are of robots with different serial numbers, as far as
/// these are known.
///
/// # Errors
/// The first that is not of the robot of the first.
pub fn one_robot<'a>(all: impl IntoIterator<Item = (String, &'a Traced)>) -> Result<(), Diagnostic> {
    let serial = |(name, one): (String, &'a Traced)| {
        let stated = one.provenance.identity.robot.as_ref();
        Some((name, stated.or_else(|| one.robot()?.serial.as_ref())?))
    };
    let mut known = all.into_iter().filter_map(serial);
    let Some((first, of_first)) = known.next() else { return Ok(()) };
    match known.find(|(_, serial)| *serial != of_first) {
        Some((name, serial)) => {
            let (serial, of_first) = (serial.clone(), of_first.clone());
            Err(Diagnostic::file(&name, ProvenanceFinding::OtherSerial { serial, first, of_first }))
        }
        None => Ok(()),
    }
}

impl Provenance {
    /// Of what this version makes from `inputs`.
    pub fn of<'a>(inputs: impl IntoIterator<Item = &'a Traced>) -> Self {
        let mut made = Self { dbbd: VERSION.into(), ..Self::default() };
        for input in inputs {
            input.chain().for_each(|source| made.add(source));
            let stated = &input.provenance.identity;
            match input.artefact.role {
                // Of its calibration the robot carries nothing into the next measurement but itself.
                Role::Robot | Role::IdentifiedRobot => made.identity.extend(&stated.of_robot()),
                _ => made.identity.extend(stated),
            }
        }
        made
    }

    /// Records beside the table at `path`, which is `content`, what it was made from.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write_beside(&self, path: &Path, content: &str) -> Result<(), Diagnostic> {
        let table = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let record = TableRecord { table, sha256: sha256(content), provenance: self.clone() };
        files::write(&Traced::record_of(path), serialised::json(&record)?)
    }

    /// One more source.
    pub fn add(&mut self, source: &Artefact) {
        if !self.has(source) {
            self.from.push(source.clone());
        }
    }

    /// Whether nothing was recorded.
    pub fn is_empty(&self) -> bool {
        self.from.is_empty() && self.identity.is_empty()
    }

    /// Whether the artefact is in the chain.
    pub fn has(&self, artefact: &Artefact) -> bool {
        self.from.iter().any(|source| source.sha256 == artefact.sha256)
    }

    /// What was measured for it: captures and tables, without those of an earlier calibration that it goes on from.
    pub fn measured(&self) -> impl Iterator<Item = &Artefact> {
        let earlier = self.from.iter().rposition(|source| source.role == Role::IdentifiedRobot);
        let own = self.from.iter().skip(earlier.map_or(0, |at| at + 1));
        own.filter(|source| [Role::Measurements, Role::Capture].contains(&source.role))
    }

    /// The measured artefact by which the commanded poses were corrected, if they were.
    pub fn corrected_by(&self) -> Option<&Artefact> {
        let measured = [Role::IdentifiedRobot, Role::Measurements, Role::Capture];
        self.from.iter().rev().find(|source| measured.contains(&source.role))
    }
}
