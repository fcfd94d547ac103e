//! The texts of a report are found in its other language, as `report/language.js` finds them.

use std::collections::BTreeSet;
use std::sync::LazyLock;

const GERMAN: &str =
    include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/crates/dbbd-job/src/report/texts/de.json"));
static TEXTS: LazyLock<BTreeSet<String>> = LazyLock::new(|| {
    let texts: serde_json::Map<String, serde_json::Value> = serde_json::from_str(GERMAN).unwrap();
    texts.into_iter().map(|(english, _)| english).collect()
});

/// Elements whose texts are the program's own. What users name and what a finding says is in others.
const OWN: [&str; 15] = [
    "h1",
    "h2",
    "h3",
    "p",
    "b",
    "strong",
    "th",
    "dt",
    "td",
    "summary",
    "label",
    "text",
    "title",
    "figcaption",
    "div",
];
/// Elements and marks whose texts are the same in each language.
const SAME: [&str; 5] = ["<script", "<style", "<code", "mono\"", "translate=\"no\""];
/// A value of so many words is prose: it has a text of its own. Names and numbers are no words.
const PROSE: usize = 3;

/// Fails with the texts that have none in another language.
pub(crate) fn assert_spoken(page: &str) {
    let missing: BTreeSet<String> = own_texts(page).into_iter().filter(|text| !is_spoken(text)).collect();
    assert!(missing.is_empty(), "no text of another language: {missing:#?}");
}

fn own_texts(page: &str) -> Vec<String> {
    let mut open: Vec<&str> = Vec::new();
    let mut found = Vec::new();
    for piece in page.split('<').skip(1) {
        let Some((tag, text)) = piece.split_once('>') else { continue };
        let name = tag.trim_start_matches('/').split([' ', '\n']).next().unwrap();
        if tag.starts_with('/') {
            open.pop();
        } else if !tag.ends_with('/') && !["meta", "br", "input", "!doctype"].contains(&name) {
            open.push(&page[tag.as_ptr() as usize - page.as_ptr() as usize - 1..][..tag.len() + 1]);
        }
        let is_same = open.iter().any(|tag| SAME.iter().any(|mark| tag.contains(mark)));
        let is_own =
            open.last().is_some_and(|tag| OWN.contains(&tag[1..].split([' ', '\n']).next().unwrap()));
        let text = unescaped(&text.split_whitespace().collect::<Vec<_>>().join(" "));
        if is_own && !is_same && !text.is_empty() {
            found.push(text);
        }
    }
    found
}

fn unescaped(text: &str) -> String {
    let pairs =
        [("&lt;", "<"), ("&gt;", ">"), ("&quot;", "\""), ("&#x27;", "'"), ("&#x2f;", "/"), ("&amp;", "&")];
    pairs.iter().fold(text.to_owned(), |text, (escaped, character)| text.replace(escaped, character))
}

fn is_spoken(text: &str) -> bool {
    let is_file = !text.contains(' ') && text.rsplit_once('.').is_some();
    let is_word = text.as_bytes().windows(3).any(|three| three.iter().all(u8::is_ascii_alphabetic));
    !is_word || is_file || TEXTS.contains(text) || TEXTS.iter().any(|pattern| fits(pattern, text))
}

fn words(value: &str) -> usize {
    let words = value.split(' ').map(|word| word.trim_matches(|c: char| c.is_ascii_punctuation()));
    words.filter(|word| word.len() > 2 && word.bytes().all(|byte| byte.is_ascii_alphabetic())).count()
}

/// Whether a text is a pattern with its values.
fn fits(pattern: &str, text: &str) -> bool {
    let Some((before, rest)) = pattern.split_once('{') else { return pattern == text };
    let (name, after) = rest.split_once('}').unwrap();
    let Some(text) = text.strip_prefix(before) else { return false };
    let is_number = name.starts_with('n') && name[1..].bytes().all(|byte| byte.is_ascii_digit());
    let number = |value: &str| {
        value.trim_start_matches(['−', '-', '+', '±']).starts_with(|c: char| c.is_ascii_digit())
    };
    let is_value = |value: &str| match is_number {
        true => value == "–" || !value.contains(' ') && number(value),
        false => words(value) < PROSE || is_spoken(value),
    };
    let literal = after.split('{').next().unwrap();
    let ends = (1..=text.len()).filter(|&end| text.is_char_boundary(end) && text[end..].starts_with(literal));
    ends.filter(|&end| !after.is_empty() || end == text.len())
        .any(|end| is_value(&text[..end]) && fits(after, &text[end..]))
}

#[test]
fn a_missing_text_is_found() {
    let page =
        |heading: &str| format!("<h2>{heading}</h2><p class=\"mono\">no words of ours</p><td>3.1</td>");
    assert_spoken(&page("Parameters"));
    assert_spoken(&page("Calibration of KUKA KR 60 HA"));
    for missing in ["What was weighed", "from many to {n} trials", "Parameters of no kind"] {
        assert!(std::panic::catch_unwind(|| assert_spoken(&page(missing))).is_err(), "{missing}");
    }
}
