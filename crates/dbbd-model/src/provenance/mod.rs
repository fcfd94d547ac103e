//! Records the sources of an artefact: the chain from job and robot file to a corrected program.
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
pub use identity::{BarIdentity, Identity, IdentityError, MeasuredTemperature, check_text};

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

impl ArtefactRole {
    /// What to give where a file of this kind is needed.
    pub fn file_to_give(self) -> &'static str {
        match self {
            Self::Job => "give the job.toml",
            Self::Robot => {
                "give the name of a built-in robot, the file of a robot, or the directory of a result"
            }
            Self::IdentifiedRobot => "give a robot-identified.toml, or the directory of its result",
            Self::Plan => "give the plan.csv that `dbbd plan` wrote, or its directory",
            Self::Program => "give a program of the robot",
            Self::Capture => "give a capture",
            Self::Measurements => "give a capture, or a table of lengths such as the lengths.csv of a result",
            Self::BaseBalls => "give the centres.csv of a plan",
            Self::Prior => "give the parameters.csv of a result",
            Self::Result => "give a result.json, or its directory",
            Self::Check => "give a check.json, or its directory",
            Self::Comparison => "give a compare.json",
        }
    }

    /// Whether a file of this kind is one of the kind `wanted`.
    fn serves_as(self, wanted: Self) -> bool {
        let robots = [Self::Robot, Self::IdentifiedRobot];
        self == wanted || (robots.contains(&self) && robots.contains(&wanted))
    }

    /// The finding about a file of this kind where one of another kind is needed.
    pub fn instead_of(self, wanted: Self) -> Option<ProvenanceFinding> {
        let (found, file) = (self.to_string(), wanted.file_to_give());
        (!self.serves_as(wanted)).then(|| ProvenanceFinding::OtherKind {
            found,
            wanted: wanted.to_string(),
            file,
        })
    }
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

/// Where readings come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DataOrigin {
    /// A bar whose line has no mark of a simulated one.
    Measured,
    /// The virtual bar of dbbd.
    Simulated,
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
    /// SHA-256 of the content of the file, in hexadecimal digits.
    pub sha256: String,
    /// Where its readings come from, if these are readings and it is stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub origin: Option<DataOrigin>,
}

impl Artefact {
    /// An artefact whose content is in memory.
    pub fn new(role: ArtefactRole, name: impl Into<String>, content: impl AsRef<[u8]>) -> Self {
        Self { role, name: name.into(), serial: None, sha256: sha256(content), origin: None }
    }

    /// The first digits of the artefact's hash.
    fn short_hash(&self) -> &str {
        self.sha256.get(..12).unwrap_or(&self.sha256)
    }

    /// The difference of two robots: of the serial numbers if both are known, else of the names. `None`: they are the
    /// same robot.
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

/// The sources of an artefact, and the version that made it; empty if they were not recorded.
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

/// An artefact with its provenance.
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

    /// Refuses another robot than the one for which this artefact was made, if the artefact records a robot.
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

    /// A finding if this artefact was made with another calibration of the robot than `given`, if `given` is a
    /// calibrated robot.
    pub fn other_calibration_than(&self, given: &TracedArtefact) -> Option<ProvenanceFinding> {
        let is_calibrated = |robot: &&Artefact| robot.role == ArtefactRole::IdentifiedRobot;
        let used = self.robot().filter(is_calibrated)?;
        if !is_calibrated(&&given.artefact) || given.artefact.sha256 == used.sha256 {
            return None;
        }
        let (artefact, is_newer) = (self.artefact.to_string(), given.provenance.has(used));
        let (used, given) = (used.to_string(), given.artefact.to_string());
        Some(if is_newer {
            ProvenanceFinding::Outdated { artefact, used, newest: given }
        } else {
            ProvenanceFinding::OtherCalibration { artefact, used, given }
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

    /// The provenance of an artefact that `version` of dbbd makes from `inputs`.
    pub fn made_by<'a>(version: &str, inputs: impl IntoIterator<Item = &'a TracedArtefact>) -> Self {
        let mut made = Self { dbbd: version.into(), ..Self::default() };
        for input in inputs {
            input.chain().for_each(|source| made.add(source));
            let stated = &input.provenance.identity;
            // The conditions of an earlier calibration are not those of the next measurement.
            if matches!(input.artefact.role, ArtefactRole::Robot | ArtefactRole::IdentifiedRobot) {
                made.identity.extend(&stated.of_robot());
            } else {
                made.identity.extend(stated);
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

    /// The captures and tables of this measurement, without the sources of an earlier calibration on which it builds.
    pub fn measured(&self) -> impl Iterator<Item = &Artefact> {
        let earlier = self.from.iter().rposition(|source| source.role == ArtefactRole::IdentifiedRobot);
        let own = self.from.iter().skip(earlier.map_or(0, |at| at + 1));
        own.filter(|source| [ArtefactRole::Measurements, ArtefactRole::Capture].contains(&source.role))
    }

    /// The captures and tables of readings in the whole chain.
    fn data(&self) -> impl Iterator<Item = &Artefact> {
        let is_data =
            |source: &&Artefact| [ArtefactRole::Measurements, ArtefactRole::Capture].contains(&source.role);
        self.from.iter().filter(is_data)
    }

    /// Where the readings in the chain come from: simulated if any of them is, measured if all of them are; `None` if it is
    /// not stated, or there are none.
    pub fn origin(&self) -> Option<DataOrigin> {
        let mut origins = self.data().map(|source| source.origin);
        let first = origins.next()?;
        origins.fold(first, |all, one| match (all, one) {
            (Some(DataOrigin::Simulated), _) | (_, Some(DataOrigin::Simulated)) => {
                Some(DataOrigin::Simulated)
            }
            (all, one) => all.and(one),
        })
    }

    pub fn is_simulated(&self) -> bool {
        self.origin() == Some(DataOrigin::Simulated)
    }

    /// The finding about simulated readings in the chain: they are all simulated, or some are and some are not.
    pub fn of_origin(&self) -> Option<ProvenanceFinding> {
        let is_simulated = |source: &&Artefact| source.origin == Some(DataOrigin::Simulated);
        let simulated = self.data().find(is_simulated)?.to_string();
        Some(match self.data().find(|source| !is_simulated(source)) {
            Some(other) => ProvenanceFinding::OriginsMixed { simulated, other: other.to_string() },
            None => ProvenanceFinding::Simulated { simulated },
        })
    }

    /// The measured artefact with which a program was corrected, if it was.
    pub fn corrected_by(&self) -> Option<&Artefact> {
        let measured = [ArtefactRole::IdentifiedRobot, ArtefactRole::Measurements, ArtefactRole::Capture];
        self.from.iter().rev().find(|source| measured.contains(&source.role))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnostic::Finding as _;

    fn artefact(role: ArtefactRole, name: &str, serial: Option<&str>) -> Artefact {
        Artefact {
            serial: serial.map(str::to_owned),
            ..Artefact::new(role, name, format!("{role}{name}{serial:?}"))
        }
    }

    #[test]
    fn robots_differ_by_serial_number_or_else_by_name() {
        let robot = |name: &str, serial: Option<&str>| artefact(ArtefactRole::Robot, name, serial);
        let difference = |one: (&str, Option<&str>), other: (&str, Option<&str>)| {
            robot(one.0, one.1).differs(&robot(other.0, other.1))
        };
        assert_eq!(difference(("a", Some("1")), ("b", Some("1"))), None);
        assert_eq!(difference(("a", Some("1")), ("a", Some("2"))), Some(ArtefactDifference::Serial));
        assert_eq!(difference(("a", Some("1")), ("b", None)), Some(ArtefactDifference::Name));
        assert_eq!(difference(("a", None), ("a", Some("2"))), None);
    }

    #[test]
    fn a_chain_has_each_source_once_and_in_order() {
        let robot = TracedArtefact::from(artefact(ArtefactRole::Robot, "r", None));
        let made = |role, name: &str, inputs: &[&TracedArtefact]| TracedArtefact {
            artefact: artefact(role, name, None),
            provenance: Provenance::made_by("1", inputs.iter().copied()),
        };
        let plan = made(ArtefactRole::Plan, "p", &[&robot]);
        let lengths = made(ArtefactRole::Measurements, "m", &[&plan, &robot]);
        let identified = made(ArtefactRole::IdentifiedRobot, "i", &[&lengths, &robot]);
        let names = |one: &TracedArtefact| one.chain().map(|source| source.name.clone()).collect::<String>();
        assert_eq!(names(&identified), "rpmi");
        assert_eq!(identified.robot().map(|robot| robot.name.as_str()), Some("i"));
        assert_eq!(identified.provenance.robot().map(|robot| robot.name.as_str()), Some("r"));
        // Measured with a calibrated robot: only what comes after it is the own measurement.
        let again = made(ArtefactRole::Measurements, "n", &[&identified]);
        let result = made(ArtefactRole::Result, "x", &[&again]);
        let measured = |one: &TracedArtefact| {
            one.provenance.measured().map(|source| source.name.clone()).collect::<String>()
        };
        assert_eq!((measured(&identified), measured(&result)), ("m".to_owned(), "n".to_owned()));
        assert_eq!(result.provenance.corrected_by().map(|source| source.name.as_str()), Some("n"));
        assert_eq!(plan.provenance.corrected_by(), None);
        // A newer robot that was made from the used one makes a result outdated.
        let newer = made(ArtefactRole::IdentifiedRobot, "j", &[&result]);
        assert!(matches!(again.other_calibration_than(&newer), Some(ProvenanceFinding::Outdated { .. })));
        assert!(again.other_calibration_than(&identified).is_none());
        assert!(
            again.other_calibration_than(&robot).is_none() && plan.other_calibration_than(&newer).is_none()
        );
        // The older calibration, or one from other lengths.
        let of_newer = made(ArtefactRole::Measurements, "o", &[&newer]);
        let other = of_newer.other_calibration_than(&identified);
        assert!(matches!(other, Some(ProvenanceFinding::OtherCalibration { .. })));
        assert!(plan.check_made_for(&artefact(ArtefactRole::Robot, "r", Some("5"))).is_ok());
        assert!(plan.check_made_for(&artefact(ArtefactRole::Robot, "s", None)).is_err());
    }

    #[test]
    fn simulated_readings_are_found_in_the_whole_chain() {
        use DataOrigin::{Measured, Simulated};
        let of = |origins: &[Option<DataOrigin>]| {
            let data = origins.iter().zip(["a", "b", "c"]).map(|(origin, name)| Artefact {
                origin: *origin,
                ..artefact(ArtefactRole::Capture, name, None)
            });
            let robot = artefact(ArtefactRole::Robot, "r", None);
            Provenance { from: data.chain([robot]).collect(), ..Provenance::default() }
        };
        let found = |origins: &[Option<DataOrigin>]| {
            let made = of(origins);
            (made.origin(), made.of_origin().map(|finding| finding.code().as_str()))
        };
        assert_eq!(found(&[]), (None, None));
        assert_eq!(found(&[None]), (None, None));
        assert_eq!(found(&[Some(Measured), Some(Measured)]), (Some(Measured), None));
        assert_eq!(found(&[Some(Measured), None]), (None, None));
        assert_eq!(found(&[Some(Simulated)]), (Some(Simulated), Some("I1850")));
        // What does not state its origin may be of a real robot.
        for other in [None, Some(Measured)] {
            assert_eq!(found(&[other, Some(Simulated)]), (Some(Simulated), Some("W1851")));
            assert_eq!(found(&[Some(Simulated), other, other]), (Some(Simulated), Some("W1851")));
        }
    }

    #[test]
    fn artefacts_of_two_serial_numbers_are_refused() {
        let of = |serial: Option<&str>| TracedArtefact::from(artefact(ArtefactRole::Robot, "r", serial));
        let all = |serials: &[Option<&str>]| {
            let traced: Vec<TracedArtefact> = serials.iter().map(|serial| of(*serial)).collect();
            one_robot(traced.iter().map(|one| ("f".to_owned(), one))).is_ok()
        };
        assert!(all(&[Some("1"), None, Some("1")]) && all(&[]) && !all(&[Some("1"), None, Some("2")]));
    }
}
