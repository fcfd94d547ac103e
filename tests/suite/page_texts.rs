//! The texts of the page: all languages have the same keys, and every key that the page uses exists.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use serde_json::{Map, Value};

fn page(name: &str) -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/live/page");
    fs::read_to_string(root.join(name)).unwrap()
}

fn texts(language: &str) -> Map<String, Value> {
    serde_json::from_str(&page(&format!("texts/{language}.json"))).unwrap()
}

/// The names in braces of a text.
fn values(text: &Value) -> BTreeSet<String> {
    let parts = text.as_str().unwrap().split('{').skip(1);
    parts.map(|part| part.split_once('}').unwrap().0.to_owned()).collect()
}

/// The texts between a mark and the next quote.
fn quoted<'a>(text: &'a str, mark: &'a str) -> impl Iterator<Item = &'a str> {
    text.split(mark).skip(1).filter_map(|rest| rest.split_once('"')).map(|(key, _)| key)
}

#[test]
fn page_texts_are_complete() {
    let files = fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("src/live/page/texts")).unwrap();
    let names = files.map(|file| file.unwrap().path().file_stem().unwrap().to_str().unwrap().to_owned());
    let english = texts("en");
    let mut languages = 0;
    for language in names {
        languages += 1;
        let other = texts(&language);
        assert!(other.keys().eq(english.keys()), "{language} has other keys");
        for (key, text) in &other {
            assert_eq!(values(text), values(&english[key]), "{language}: {key}");
        }
    }
    assert!(languages >= 2);
    let files = fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("src/live/page")).unwrap();
    let names = files.map(|file| file.unwrap().file_name().into_string().unwrap());
    let names: Vec<String> = names.filter(|name| name.ends_with(".js") || name.ends_with(".html")).collect();
    assert!(names.len() > 15);
    for file in &names {
        let text = page(file);
        let marks =
            [" t(\"", "(t(\"", "[t(\"", "list(\"form", "data-text=\"", "data-label=\"", "data-title=\""];
        for key in marks.into_iter().flat_map(|mark| quoted(&text, mark)) {
            let key = key.strip_prefix('.').map_or(key.to_owned(), |rest| format!("form.{rest}"));
            assert!(english.contains_key(&key), "{file} asks for `{key}`");
        }
    }
    for code in ["W0280", "W0281", "W0282", "W0283", "W0284"] {
        assert!(english.contains_key(code), "{code} has no text");
    }
}

/// The service names its sentences and its actions by keys.
#[test]
fn every_step_has_its_sentence_and_its_action() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let steps = fs::read_to_string(root.join("src/daemon/service/workbench/steps.rs")).unwrap();
    let code = steps.split("#[cfg(test)]").next().unwrap();
    let english = texts("en");
    let steps =
        ["robot", "cell", "plan", "programs", "measure", "result", "correct", "check", "certificate", "act"];
    let mut keys: BTreeSet<String> = BTreeSet::new();
    for literal in code.split('"').skip(1).step_by(2) {
        let is_key = |rest: &str| {
            !rest.is_empty() && rest.bytes().all(|byte| byte.is_ascii_lowercase() || byte == b'_')
        };
        if let Some((step, rest)) = literal.split_once('.')
            && steps.contains(&step)
            && is_key(rest)
            && rest != "toml"
            && rest != "dbbd"
        {
            keys.insert(if step == "act" { literal.into() } else { format!("say.{literal}") });
        }
    }
    keys.remove("act.none");
    assert!(keys.len() > 40, "{keys:?}");
    for key in &keys {
        assert!(english.contains_key(key), "{key} has no text");
    }
    for word in ["step.", "state_of.", "verdict."] {
        assert!(english.keys().any(|key| key.starts_with(word)));
    }
}
