//! Every sentence that reports an error, a warning or an information, by its stable code, with cause and cure.
//!
//! A code is a family: the sentences under it have the same cause and the same cure. `dbbd explain CODE` prints an
//! entry, docs/troubleshooting.md is made from all of them, and tests ask for codes and values, never for sentences.
//! A code that was released keeps its meaning; a code that is dropped is not used again.

mod archive;
mod axes;
mod bar;
mod certificate;
mod circular;
mod cli;
mod compensation;
mod conformity;
mod estimation;
mod files;
mod import;
mod job;
mod matching;
mod measurement;
mod plan;
mod port;
mod program;
mod protocol;
mod provenance;
mod recording;
mod report;
mod robot;
mod service;
mod simulation;

pub use archive::ArchiveFinding;
pub use axes::AxesFinding;
pub use bar::BarFinding;
pub use certificate::CertificateFinding;
pub use circular::CircularFinding;
pub use cli::CliFinding;
pub use compensation::CompensationFinding;
pub use conformity::ConformityFinding;
pub use estimation::{EstimationFinding, Names};
pub use files::FileFinding;
pub use import::ImportFinding;
pub use job::JobFinding;
pub use matching::MatchingFinding;
pub use measurement::MeasurementFinding;
pub use plan::PlanFinding;
pub use port::PortFinding;
pub use program::ProgramFinding;
pub use protocol::ProtocolFinding;
pub use provenance::ProvenanceFinding;
pub use recording::RecordingFinding;
pub use report::ReportFinding;
pub use robot::RobotFinding;
pub use service::ServiceFinding;
pub use simulation::SimulationFinding;

use crate::diagnostic::Code;

/// What the catalogue says of a code.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    pub code: Code,
    /// What happened, in a few words.
    pub title: &'static str,
    pub cause: &'static str,
    pub cure: &'static str,
    /// The sentences with the names of their values in braces.
    pub sentences: &'static [&'static str],
}

/// Defines an enum of findings: its codes with title, cause and cure, and under each code the sentences as variants
/// whose fields are the values in the sentence.
macro_rules! findings {
    ($(#[$doc:meta])* $name:ident { $(
        $code:ident $title:literal, cause: $cause:literal, cure: $cure:literal {
            $( $variant:ident $({ $($field:ident: $type:ty),+ $(,)? })? => $sentence:literal $(, help: $help:literal)? ; )+
        }
    )+ }) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq, serde::Serialize)]
        #[serde(untagged)]
        pub enum $name { $($( $variant $({ $($field: $type),+ })?, )+)+ }

        impl $name {
            pub(crate) const ENTRIES: &'static [$crate::catalogue::Entry] = &[$( $crate::catalogue::Entry {
                code: $crate::diagnostic::Code(stringify!($code)),
                title: $title,
                cause: $cause,
                cure: $cure,
                sentences: &[$($sentence),+],
            } ),+];
        }

        impl $crate::diagnostic::Finding for $name {
            fn code(&self) -> $crate::diagnostic::Code {
                match self {
                    $($( Self::$variant { .. } )|+ => $crate::diagnostic::Code(stringify!($code)),)+
                }
            }

            fn values(&self) -> serde_json::Value {
                serde_json::to_value(self).unwrap_or_default()
            }

            #[allow(unused_variables)] // a help need not name all values
            fn help(&self) -> Option<String> {
                match self {
                    $($( Self::$variant $({ $($field),+ })? => $crate::catalogue::help!($($help)?), )+)+
                }
            }
        }

        impl std::fmt::Display for $name {
            #[allow(unused_variables)] // a sentence need not name all values
            fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                match self {
                    $($( Self::$variant $({ $($field),+ })? => write!(out, $sentence), )+)+
                }
            }
        }

        impl std::error::Error for $name {}

        impl From<$name> for $crate::diagnostic::Diagnostic {
            fn from(finding: $name) -> Self {
                Self::new(finding)
            }
        }
    };
}
use findings;

macro_rules! help {
    () => {
        None
    };
    ($help:literal) => {
        Some(format!($help))
    };
}
use help;

/// The families with their headings in docs/troubleshooting.md.
const FAMILIES: &[(&str, &[Entry])] = &[
    ("The command line", CliFinding::ENTRIES),
    ("Files", FileFinding::ENTRIES),
    ("Robots", RobotFinding::ENTRIES),
    ("Provenance", ProvenanceFinding::ENTRIES),
    ("The job", JobFinding::ENTRIES),
    ("The plan", PlanFinding::ENTRIES),
    ("Tables of measurements", MeasurementFinding::ENTRIES),
    ("The bar", BarFinding::ENTRIES),
    ("Captures and runs", RecordingFinding::ENTRIES),
    ("Matching of dwells to poses", MatchingFinding::ENTRIES),
    ("Import of traces", ImportFinding::ENTRIES),
    ("The circular test", CircularFinding::ENTRIES),
    ("Programs", ProgramFinding::ENTRIES),
    ("Correcting a program", CompensationFinding::ENTRIES),
    ("The simulator", SimulationFinding::ENTRIES),
    ("Estimation", EstimationFinding::ENTRIES),
    ("Comparison and interim check", ConformityFinding::ENTRIES),
    ("Certificates", CertificateFinding::ENTRIES),
    ("Pages and exports", ReportFinding::ENTRIES),
    ("The bar and its port", PortFinding::ENTRIES),
    ("The axes of the controller", AxesFinding::ENTRIES),
    ("Protocol definitions", ProtocolFinding::ENTRIES),
    ("The service", ServiceFinding::ENTRIES),
    ("The archive", ArchiveFinding::ENTRIES),
];

/// All entries, in the order of the families.
pub fn entries() -> impl Iterator<Item = &'static Entry> {
    FAMILIES.iter().flat_map(|(_, entries)| *entries)
}

/// What `dbbd explain` prints of an entry; Markdown.
pub fn explanation(entry: &Entry) -> String {
    let Entry { code, title, cause, cure, sentences } = entry;
    let sentences: String =
        sentences.iter().map(|sentence| format!("    {}\n", without_names(sentence))).collect();
    format!("{code}: {title}\n\nCause: {cause}\n\nCure: {cure}\n\n{sentences}")
}

/// docs/troubleshooting.md.
pub fn page() -> String {
    let mut page = String::from(include_str!("head.md"));
    for (heading, entries) in FAMILIES {
        page.push_str(&format!("\n## {heading}\n"));
        for entry in *entries {
            page.push_str(&format!("\n### {}", explanation(entry)));
        }
    }
    page
}

/// A sentence with an ellipsis for each of its values.
fn without_names(sentence: &str) -> String {
    let mut pieces = sentence.split('{');
    let mut text = pieces.next().unwrap_or("").to_owned();
    for piece in pieces {
        text.push('…');
        text.push_str(piece.split_once('}').map_or(piece, |(_, rest)| rest));
    }
    text
}

/// The entry of a code.
pub fn entry(code: &str) -> Option<&'static Entry> {
    entries().find(|entry| entry.code.0 == code)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnostic::{Diagnostic, Finding};

    #[test]
    fn a_code_is_well_formed_and_its_digits_are_its_own() {
        let mut numbers: Vec<&str> = entries().map(|entry| &entry.code.0[1..]).collect();
        for Entry { code, .. } in entries() {
            assert!(["E", "W", "I"].contains(&&code.0[..1]), "{code}");
            assert!(code.0.len() == 5 && code.0[1..].bytes().all(|b| b.is_ascii_digit()), "{code}");
        }
        numbers.sort_unstable();
        let twice: Vec<_> = numbers.windows(2).filter(|pair| pair[0] == pair[1]).collect();
        assert!(twice.is_empty(), "{twice:?}");
    }

    #[test]
    fn a_finding_has_code_sentence_help_and_values() {
        let (absent, header, delimiter) = ("`index`".into(), "a,b".into(), "comma".into());
        let finding = FileFinding::MissingColumns { absent, header, delimiter };
        let diagnostic = Diagnostic::line("obs.csv", 1, finding.clone());
        assert_eq!(diagnostic.code, finding.code());
        let json = serde_json::to_value(&diagnostic).unwrap();
        assert_eq!((&json["line"], &json["values"]["absent"]), (&1.into(), &"`index`".into()));
        assert!(diagnostic.help.is_some());
    }
}
