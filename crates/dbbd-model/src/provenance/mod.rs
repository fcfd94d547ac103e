//! Records what an artefact was made from: the chain from job and robot file to a corrected program.
//!
//! An artefact is identified by the SHA-256 of its file. It records its sources and the identity of its measurement, and a
//! command compares the chains of its inputs before it computes. A chain has no path and no date except that of a
//! capture, so that the same inputs give the same bytes.

mod catalogue;
pub use catalogue::{IdentityFinding, ProvenanceFinding};

mod contradiction;
mod identity;

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::base::hash::sha256;
use crate::diagnostic::Diagnostic;
pub use contradiction::Contradiction;
pub use identity::{
    BarIdentity, CERTIFIED_C, Identity, IdentityError, LENGTH_U_MM, MeasuredTemperature, check_text,
};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ArtefactRole {
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

impl fmt::Display for ArtefactRole {
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

/// A file, identified by its content.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Artefact {
    pub role: ArtefactRole,
    /// The name of a robot, the hash of a plan, else the name of the file without its directory.
    pub name: String,
    /// The serial number of the robot; of the bar, if this is a job.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serial: Option<String>,
    /// Of the content of the file, in hexadecimal digits.
    pub sha256: String,
}

impl Artefact {
    /// An artefact whose content is in memory.
    pub fn new(role: ArtefactRole, name: impl Into<String>, content: impl AsRef<[u8]>) -> Self {
        Self { role, name: name.into(), serial: None, sha256: sha256(content) }
    }

    /// The first digits of its hash.
    pub fn short_hash(&self) -> &str {
        self.sha256.get(..12).unwrap_or(&self.sha256)
    }

    /// By what two robots differ: by serial number if both are known, else by name. `None`: they are the same robot.
    pub fn differs(&self, other: &Self) -> Option<ArtefactDifference> {
        match (&self.serial, &other.serial) {
            (Some(this), Some(other)) => (this != other).then_some(ArtefactDifference::Serial),
            _ if self.name != other.name => Some(ArtefactDifference::Name),
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

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArtefactDifference {
    Serial,
    Name,
}

/// What an artefact was made from, and by which version; empty if that was not recorded.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// The version of dbbd that made it.
    #[serde(default)]
    pub dbbd: String,
    /// Each source once, before the artefacts that were made from it.
    #[serde(default)]
    pub from: Vec<Artefact>,
    #[serde(default, skip_serializing_if = "Identity::is_empty")]
    pub identity: Identity,
}

/// An artefact with what it was made from.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TracedArtefact {
    #[serde(flatten)]
    pub artefact: Artefact,
    pub provenance: Provenance,
}

impl From<Artefact> for TracedArtefact {
    /// An artefact without known sources.
    fn from(artefact: Artefact) -> Self {
        Self { artefact, provenance: Provenance::default() }
    }
}

impl TracedArtefact {
    /// The sources, and the artefact itself as the last.
    pub fn chain(&self) -> impl DoubleEndedIterator<Item = &Artefact> {
        self.provenance.from.iter().chain([&self.artefact])
    }

    /// The last robot in the chain.
    pub fn robot(&self) -> Option<&Artefact> {
        last_robot(self.chain())
    }

    /// Refuses another robot than that for which this artefact was made, if it records one.
    pub fn check_made_for(&self, given: &Artefact) -> Result<(), ProvenanceFinding> {
        match self.robot().filter(|made_for| made_for.differs(given).is_some()) {
            Some(made_for) => Err(self.of_another_robot(made_for, given)),
            None => Ok(()),
        }
    }

    /// The error that this artefact was made for one robot and another one is given.
    pub fn of_another_robot(&self, made_for: &Artefact, given: &Artefact) -> ProvenanceFinding {
        let [artefact, made_for, given] = [&self.artefact, made_for, given].map(ToString::to_string);
        ProvenanceFinding::OtherRobot { artefact, made_for, given }
    }

    /// A finding if this artefact rests on a calibrated robot from which `newer` was made.
    pub fn outdated_by(&self, newer: &TracedArtefact) -> Option<ProvenanceFinding> {
        let used = self.robot().filter(|robot| robot.role == ArtefactRole::IdentifiedRobot)?;
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

/// Refuses artefacts of robots with different serial numbers, as far as these are known. Each artefact has the name that
/// the user gave.
pub fn one_robot<'a>(all: impl IntoIterator<Item = (String, &'a TracedArtefact)>) -> Result<(), Diagnostic> {
    let serial = |(name, one): (String, &'a TracedArtefact)| {
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

/// The last robot in a chain.
fn last_robot<'a>(chain: impl DoubleEndedIterator<Item = &'a Artefact>) -> Option<&'a Artefact> {
    chain.rev().find(|artefact| [ArtefactRole::Robot, ArtefactRole::IdentifiedRobot].contains(&artefact.role))
}

impl Provenance {
    /// The last robot in the chain.
    pub fn robot(&self) -> Option<&Artefact> {
        last_robot(self.from.iter())
    }

    /// The provenance of what `version` of dbbd makes from `inputs`.
    pub fn made_by<'a>(version: &str, inputs: impl IntoIterator<Item = &'a TracedArtefact>) -> Self {
        let mut made = Self { dbbd: version.into(), ..Self::default() };
        for input in inputs {
            input.chain().for_each(|source| made.add(source));
            let stated = &input.provenance.identity;
            match input.artefact.role {
                // The conditions of an earlier calibration are not those of the next measurement.
                ArtefactRole::Robot | ArtefactRole::IdentifiedRobot => {
                    made.identity.extend(&stated.of_robot())
                }
                _ => made.identity.extend(stated),
            }
        }
        made
    }

    /// Adds a source, unless it is in the chain.
    pub fn add(&mut self, source: &Artefact) {
        if !self.has(source) {
            self.from.push(source.clone());
        }
    }

    pub fn is_empty(&self) -> bool {
        self.from.is_empty() && self.identity.is_empty()
    }

    pub fn has(&self, artefact: &Artefact) -> bool {
        self.from.iter().any(|source| source.sha256 == artefact.sha256)
    }

    /// The captures and tables of this measurement, without those of an earlier calibration on which it builds.
    pub fn measured(&self) -> impl Iterator<Item = &Artefact> {
        let earlier = self.from.iter().rposition(|source| source.role == ArtefactRole::IdentifiedRobot);
        let own = self.from.iter().skip(earlier.map_or(0, |at| at + 1));
        own.filter(|source| [ArtefactRole::Measurements, ArtefactRole::Capture].contains(&source.role))
    }

    /// The measured artefact with which a program was corrected, if it was.
    pub fn corrected_by(&self) -> Option<&Artefact> {
        let measured = [ArtefactRole::IdentifiedRobot, ArtefactRole::Measurements, ArtefactRole::Capture];
        self.from.iter().rev().find(|source| measured.contains(&source.role))
    }
}
