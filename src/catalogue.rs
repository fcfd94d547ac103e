//! Every sentence that reports an error, a warning or an information, by its stable code, with cause and cure.
//!
//! A code is a family: the sentences under it have the same cause and the same cure. `dbbd explain CODE` prints an
//! entry, docs/troubleshooting.md is made from all of them, and tests ask for codes and values, never for sentences.
//! A code that was released keeps its meaning; a code that is dropped is not used again. The entries are in the
//! `catalogue.rs` of the rooms that own them.

use dbbd_device::axes::AxesFinding;
use dbbd_device::port::PortFinding;
use dbbd_device::protocol::ProtocolFinding;
use dbbd_job::plan::PlanFinding;
use dbbd_job::plan::job::JobFinding;
use dbbd_job::program::{CompensationFinding, ProgramFinding};
use dbbd_job::recording::import::ImportFinding;
use dbbd_job::recording::matching::MatchingFinding;
use dbbd_job::recording::{BarFinding, RecordingFinding};
use dbbd_job::report::ReportFinding;
use dbbd_job::report::certificate::CertificateFinding;
use dbbd_job::request::RequestFinding;
use dbbd_job::robot_description::DescriptionFinding;
use dbbd_job::sim::SimulationFinding;
use dbbd_model::base::{FileFinding, InternalFinding};
use dbbd_model::circular::CircularFinding;
use dbbd_model::conformity::ConformityFinding;
use dbbd_model::diagnostic::{Entry, Family};
use dbbd_model::estimation::{EstimationFinding, ResultFinding};
use dbbd_model::measurement::MeasurementFinding;
use dbbd_model::plausibility::PlausibilityFinding;
use dbbd_model::provenance::{IdentityFinding, ProvenanceFinding};
use dbbd_model::robot::RobotFinding;

use dbbd_plant::{ArchiveFinding, FleetFinding};

use crate::cli::{CliFinding, options_of};
use crate::live::ServiceFinding;

/// Codes that differed by their quantity or unit alone from others, and the code that has their sentences now. They are not
/// used again.
const MERGED: &[(&str, &str)] =
    &[("E0580", "E0130"), ("E0601", "E0130"), ("E1701", "E0009"), ("W1842", "W0131")];

/// The families with their headings in docs/troubleshooting.md.
const FAMILIES: &[Family] = &[
    CliFinding::FAMILY,
    RequestFinding::FAMILY,
    InternalFinding::FAMILY,
    FileFinding::FAMILY,
    RobotFinding::FAMILY,
    DescriptionFinding::FAMILY,
    ProvenanceFinding::FAMILY,
    IdentityFinding::FAMILY,
    PlausibilityFinding::FAMILY,
    JobFinding::FAMILY,
    PlanFinding::FAMILY,
    MeasurementFinding::FAMILY,
    BarFinding::FAMILY,
    RecordingFinding::FAMILY,
    MatchingFinding::FAMILY,
    ImportFinding::FAMILY,
    CircularFinding::FAMILY,
    ProgramFinding::FAMILY,
    CompensationFinding::FAMILY,
    SimulationFinding::FAMILY,
    EstimationFinding::FAMILY,
    FleetFinding::FAMILY,
    ResultFinding::FAMILY,
    ConformityFinding::FAMILY,
    CertificateFinding::FAMILY,
    ReportFinding::FAMILY,
    PortFinding::FAMILY,
    AxesFinding::FAMILY,
    ProtocolFinding::FAMILY,
    ServiceFinding::FAMILY,
    ArchiveFinding::FAMILY,
];

/// All entries, in the order of the families.
pub fn entries() -> impl Iterator<Item = &'static Entry> {
    FAMILIES.iter().flat_map(|family| family.entries)
}

/// What `dbbd explain` prints of an entry; Markdown.
pub fn explanation(entry: &Entry) -> String {
    let Entry { code, title, cause, cure, sentences, asks } = entry;
    let sentences: String =
        sentences.iter().map(|sentence| format!("    {}\n", without_names(sentence))).collect();
    let options =
        options_of(asks, |_| true).map_or_else(String::new, |options| format!("Options: {options}\n\n"));
    format!("{code}: {title}\n\nCause: {cause}\n\nCure: {cure}\n\n{options}{sentences}")
}

/// docs/troubleshooting.md.
pub fn page() -> String {
    let mut page = String::from(include_str!("catalogue_head.md"));
    for Family { heading, entries } in FAMILIES {
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

/// The entry of a code, or of the one with which it was merged.
pub fn entry(code: &str) -> Option<&'static Entry> {
    let merged = MERGED.iter().find(|(old, _)| *old == code);
    let code = merged.map_or(code, |(_, new)| new);
    entries().find(|entry| entry.code.as_str() == code)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_code_is_well_formed_and_its_digits_are_its_own() {
        let mut numbers: Vec<&str> = entries().map(|entry| &entry.code.as_str()[1..]).collect();
        for Entry { code, .. } in entries() {
            assert!(["E", "W", "I"].contains(&&code.as_str()[..1]), "{code}");
            assert!(
                code.as_str().len() == 5 && code.as_str()[1..].bytes().all(|b| b.is_ascii_digit()),
                "{code}"
            );
        }
        numbers.extend(MERGED.iter().map(|(old, _)| &old[1..]));
        numbers.sort_unstable();
        let twice: Vec<_> = numbers.windows(2).filter(|pair| pair[0] == pair[1]).collect();
        assert!(twice.is_empty(), "{twice:?}");
    }

    #[test]
    fn a_merged_code_is_explained_by_the_new_one() {
        for (old, new) in MERGED {
            assert_eq!(entry(old).map(|entry| entry.code.as_str()), Some(*new), "{old}");
        }
    }
}
