//! What a program was made from, as comments after its first line.

use crate::provenance::{Artefact, Provenance};

/// How the comments begin.
const BY: &str = "; made by dbbd ";
const FROM: &str = "; made from ";

/// The comments, in ASCII.
pub(super) fn lines(provenance: &Provenance) -> Vec<String> {
    let source = |artefact: &Artefact| {
        // Plain texts, which JSON can always hold.
        let json = serde_json::to_string(artefact).unwrap_or_default();
        FROM.chars().chain(json.chars()).map(escaped).collect()
    };
    let by = format!("{BY}{}", provenance.dbbd);
    [by].into_iter().chain(provenance.from.iter().map(source)).collect()
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
pub fn provenance(text: &str) -> Provenance {
    let after = |start: &'static str| text.lines().filter_map(move |line| line.strip_prefix(start));
    Provenance {
        dbbd: after(BY).next().map_or_else(String::new, |version| version.trim().to_owned()),
        from: after(FROM).filter_map(|json| serde_json::from_str(json).ok()).collect(),
    }
}

/// The program with these comments in place of those that it has: after the line that begins its first routine or list.
pub fn stamped(text: &str, provenance: &Provenance) -> String {
    let mut comments = lines(provenance);
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
    stamped
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
