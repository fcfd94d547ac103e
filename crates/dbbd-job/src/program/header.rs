//! The provenance of a program, as comments after its first line.

use super::{Language, Text, fanuc};
use crate::program::ProgramFinding;
use dbbd_model::base::InternalFinding;
use dbbd_model::base::serialised;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::provenance::ProvenanceFinding;
use dbbd_model::provenance::{Artefact, ArtefactRole, Provenance};

/// Start of the comments, after the comment sign.
const BY: &str = " made by dbbd ";
const FROM: &str = " made from ";

/// The comments, in ASCII.
pub(super) fn lines(language: Language, provenance: &Provenance) -> Result<Vec<String>, InternalFinding> {
    let source = |artefact: &Artefact| {
        let json = serialised::json_line(artefact)?;
        Ok(FROM.chars().chain(json.chars()).map(escaped).collect())
    };
    let by = format!("{BY}{}", provenance.dbbd);
    let comments = [Ok(by)].into_iter().chain(provenance.from.iter().map(source));
    let lines: Result<Vec<Vec<String>>, InternalFinding> =
        comments.map(|comment| comment.map(|comment| written(language, &comment))).collect();
    Ok(lines?.concat())
}

/// A remark of a TP program has at most 32 characters, keeps no blank at its end and ends at a semicolon.
const REMARK: usize = 31;
/// End of a remark whose comment goes on in the next remark.
const ON: char = '+';

/// The lines of a comment, in the form of the language.
fn written(language: Language, comment: &str) -> Vec<String> {
    match language {
        Language::Krl | Language::Rapid | Language::Urscript => {
            vec![format!("{}{comment}", language.comment())]
        }
        Language::Fanuc => {
            let (start, json) =
                if comment.starts_with(FROM) { comment.split_at(FROM.len()) } else { (comment, "") };
            let json = json.replace(' ', "\\u0020").replace(';', "\\u003b");
            let whole: Vec<char> = start.chars().chain(json.chars()).collect();
            let pieces = whole.chunks(REMARK - 1).map(|piece| piece.iter().collect::<String>());
            let last = whole.len().div_ceil(REMARK - 1);
            let on = |at: usize| if at < last { ON.to_string() } else { String::new() };
            pieces.zip(1..).map(|(piece, at)| format!("   1:  !{piece}{} ;", on(at))).collect()
        }
    }
}

/// The comment of a line that begins with the comment sign of any language, or is a remark of a TP program.
fn comment(line: &str) -> Option<&str> {
    line.strip_prefix(Language::ALL.map(Language::comment)).or_else(|| fanuc::remark_of(line))
}

/// Whether a line begins one of the comments about the provenance.
fn is_first(line: &str) -> bool {
    comment(line).is_some_and(|comment| [BY, FROM].iter().any(|start| comment.starts_with(start)))
}

/// The text of a remark of a TP program whose comment goes on in the next one.
fn goes_on(line: &str) -> Option<&str> {
    fanuc::remark_of(line)?.strip_suffix(ON)
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
    let mut comments: Vec<(usize, String)> = Vec::new();
    let mut is_open = false;
    for (line, number) in text.lines().zip(1..) {
        let Some(comment) = comment(line) else {
            is_open = false;
            continue;
        };
        let more = goes_on(line);
        let text = more.unwrap_or(comment);
        match comments.last_mut().filter(|_| is_open) {
            Some((_, last)) => last.push_str(text),
            None if is_first(line) => comments.push((number, text.to_owned())),
            None => continue,
        }
        is_open = more.is_some();
    }
    for (number, comment) in &comments {
        let number = *number;
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

/// Refuses source and data of a module that were written for different plans, if both name their plan.
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

/// The program with the comments of `provenance` after the line that begins its first routine, data list or module.
/// Earlier such comments are removed.
pub fn stamped(language: Language, text: &str, provenance: &Provenance) -> Result<String, InternalFinding> {
    let mut comments = lines(language, provenance)?;
    let mut stamped = String::with_capacity(text.len() + 256 * comments.len());
    let mut is_open = false;
    for line in text.split_inclusive('\n') {
        if is_first(line) || is_open && comment(line).is_some() {
            is_open = goes_on(line).is_some();
            continue;
        }
        is_open = false;
        stamped.push_str(line);
        if language.begins(line) {
            let end = if line.ends_with("\r\n") { "\r\n" } else { "\n" };
            comments.drain(..).for_each(|comment| stamped.extend([comment.as_str(), end]));
        }
    }
    Ok(if language == Language::Fanuc { fanuc::renumbered(&stamped) } else { stamped })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A remark of a TP program has at most 32 characters: the chain is written over several, and read back.
    #[test]
    fn remarks_of_a_listing_hold_the_chain() {
        let mut chain = Provenance { dbbd: "0.1.0".into(), ..Provenance::default() };
        let robot = Artefact::new(ArtefactRole::Robot, "robot; of cell 7, long name.toml", "text");
        chain.add(&robot);
        let listing = "/PROG  P\r\n/MN\r\n   1:J P[1] 5% FINE ;\r\n/POS\r\n/END\r\n";
        let once = stamped(Language::Fanuc, listing, &chain).unwrap();
        assert_eq!(provenance("P.LS", &once).unwrap().from, chain.from);
        let remarks: Vec<&str> = once.lines().filter_map(fanuc::remark_of).collect();
        assert!(remarks.len() > 3 && remarks.iter().all(|remark| remark.len() <= 32), "{once}");
        assert!(once.contains(&format!("{:4}:J P[1]", remarks.len() + 1)), "{once}");
        assert_eq!(stamped(Language::Fanuc, &once, &chain).unwrap(), once);
        // A remark of the user after the comments is not changed.
        let own = listing.replace("   1:J", "   1:  !+40 mm ;\r\n   2:J");
        let once = stamped(Language::Fanuc, &own, &chain).unwrap();
        assert_eq!(provenance("P.LS", &once).unwrap().from, chain.from);
        assert_eq!(stamped(Language::Fanuc, &once, &chain).unwrap(), once);
        assert!(once.contains("!+40 mm ;"), "{once}");
    }
}
