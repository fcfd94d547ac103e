//! The provenance of a program, as comments after its first line.

use super::{Language, Text};
use crate::program::ProgramFinding;
use dbbd_model::base::InternalFinding;
use dbbd_model::base::serialised;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::provenance::ProvenanceFinding;
use dbbd_model::provenance::{Artefact, ArtefactRole, Provenance};

/// What the comments begin with, after the comment sign.
const BY: &str = " made by dbbd ";
const FROM: &str = " made from ";

/// The comments, in ASCII.
pub(super) fn lines(language: Language, provenance: &Provenance) -> Result<Vec<String>, InternalFinding> {
    let sign = language.comment();
    let source = |artefact: &Artefact| {
        let json = serialised::json_line(artefact)?;
        Ok([sign].into_iter().chain(FROM.chars()).chain(json.chars()).map(escaped).collect())
    };
    let by = format!("{sign}{BY}{}", provenance.dbbd);
    [Ok(by)].into_iter().chain(provenance.from.iter().map(source)).collect()
}

/// The comment of a line that begins with the comment sign of any language.
fn comment(line: &str) -> Option<&str> {
    line.strip_prefix(Language::ALL.map(Language::comment))
}

/// A character as ASCII, with the escapes of JSON.
fn escaped(character: char) -> String {
    let mut units = [0; 2];
    match character {
        ' '..='~' => character.into(),
        _ => character.encode_utf16(&mut units).iter().map(|unit| format!("\\u{unit:04x}")).collect(),
    }
}

/// The provenance in the comments of a program; empty if there are none.
///
/// # Errors
/// A damaged comment, because its source could not be compared.
pub fn provenance(file: &str, text: &str) -> Result<Provenance, Diagnostic> {
    let mut provenance = Provenance::default();
    for (line, number) in text.lines().zip(1..) {
        let Some(comment) = comment(line) else { continue };
        if let Some(version) = comment.strip_prefix(BY) {
            provenance.dbbd = version.trim().to_owned();
        } else if let Some(json) = comment.strip_prefix(FROM) {
            let damaged = |error: serde_json::Error| {
                Diagnostic::line(file, number, ProvenanceFinding::Damaged { why: error.to_string() })
            };
            provenance.add(&serde_json::from_str(json).map_err(damaged)?);
        }
    }
    Ok(provenance)
}

/// Refuses source and data of a module that were written for different plans, if both name theirs.
pub fn check_one_plan(source: Text<'_>, data: Text<'_>) -> Result<(), Diagnostic> {
    let plan = |Text { file, text }: Text<'_>| {
        let mut chain = provenance(file, text)?.from.into_iter().rev();
        Ok::<_, Diagnostic>(chain.find(|artefact| artefact.role == ArtefactRole::Plan).map(|plan| plan.name))
    };
    match plan(source)?.zip(plan(data)?).filter(|(plan, data_plan)| plan != data_plan) {
        Some((plan, data_plan)) => {
            let data = data.file.to_owned();
            Err(Diagnostic::file(source.file, ProgramFinding::OtherPlansData { data, plan, data_plan }))
        }
        None => Ok(()),
    }
}

/// The program with the comments of `provenance` after the line that begins its first routine, data list or module, and
/// without those that it had.
pub fn stamped(language: Language, text: &str, provenance: &Provenance) -> Result<String, InternalFinding> {
    let mut comments = lines(language, provenance)?;
    let mut stamped = String::with_capacity(text.len() + 256 * comments.len());
    for line in text.split_inclusive('\n') {
        if comment(line).is_some_and(|comment| [BY, FROM].iter().any(|start| comment.starts_with(start))) {
            continue;
        }
        stamped.push_str(line);
        if language.begins(line) {
            let end = if line.ends_with("\r\n") { "\r\n" } else { "\n" };
            comments.drain(..).for_each(|comment| stamped.extend([comment.as_str(), end]));
        }
    }
    Ok(stamped)
}
