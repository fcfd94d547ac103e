//! What a program was made from, as comments after its first line.

use crate::base::serialised;
use crate::catalogue::{CliFinding, ProvenanceFinding};
use crate::diagnostic::Diagnostic;
use crate::provenance::{Artefact, Provenance};

/// How the comments begin.
const BY: &str = "; made by dbbd ";
const FROM: &str = "; made from ";

/// The comments, in ASCII.
pub(super) fn lines(provenance: &Provenance) -> Result<Vec<String>, CliFinding> {
    let source = |artefact: &Artefact| {
        let json = serialised::json_line(artefact)?;
        Ok(FROM.chars().chain(json.chars()).map(escaped).collect())
    };
    let by = format!("{BY}{}", provenance.dbbd);
    [Ok(by)].into_iter().chain(provenance.from.iter().map(source)).collect()
}

/// As JSON escapes what is not ASCII.
fn escaped(character: char) -> String {
    let mut units = [0; 2];
    match character {
        ' '..='~' => character.into(),
        _ => character.encode_utf16(&mut units).iter().map(|unit| format!("\\u{unit:04x}")).collect(),
    }
}

/// What the comments of a program say; nothing where there are none.
///
/// # Errors
/// A comment that is damaged: what is not read could not be compared.
pub fn provenance(file: &str, text: &str) -> Result<Provenance, Diagnostic> {
    let mut found = Provenance::default();
    for (line, number) in text.lines().zip(1..) {
        if let Some(version) = line.strip_prefix(BY) {
            found.dbbd = version.trim().to_owned();
        } else if let Some(json) = line.strip_prefix(FROM) {
            let damaged = |error: serde_json::Error| {
                Diagnostic::line(file, number, ProvenanceFinding::Damaged { why: error.to_string() })
            };
            found.add(&serde_json::from_str(json).map_err(damaged)?);
        }
    }
    Ok(found)
}

/// The program with these comments in place of those that it has: after the line that begins its first routine or list.
///
/// # Errors
/// None is known: see [`serialised`].
pub fn stamped(text: &str, provenance: &Provenance) -> Result<String, CliFinding> {
    let mut comments = lines(provenance)?;
    let mut stamped = String::with_capacity(text.len() + 256 * comments.len());
    for line in text.split_inclusive('\n') {
        if [BY, FROM].iter().any(|start| line.starts_with(start)) {
            continue;
        }
        stamped.push_str(line);
        if begins(line) {
            let end = if line.ends_with("\r\n") { "\r\n" } else { "\n" };
            comments.drain(..).for_each(|comment| stamped.extend([comment.as_str(), end]));
        }
    }
    Ok(stamped)
}

/// Whether a text has a routine or a data list of KRL.
pub fn is_program(text: &str) -> bool {
    text.split_inclusive('\n').any(begins)
}

/// Whether a routine or a data list begins here.
fn begins(line: &str) -> bool {
    let mut words = line.split_ascii_whitespace().map(str::to_ascii_uppercase);
    let first = words.next().filter(|word| word != "GLOBAL").or_else(|| words.next());
    line.ends_with('\n') && first.is_some_and(|word| ["DEF", "DEFFCT", "DEFDAT"].contains(&word.as_str()))
}
