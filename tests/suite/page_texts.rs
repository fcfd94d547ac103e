//! The texts of the page: all languages have the same keys, and every key that the page uses exists.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use dbbd_model::conformity::{Headline, Standing};
use serde_json::{Map, Value, json};

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
    for code in ["W0280", "W0281", "W0282", "W0283", "W0284", "W0285"] {
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

/// The codes whose title and cure the workbench has in German: what a user meets in its nine steps. Others are English, and marked so.
const WORKBENCH_CODES: &str = "\
    E0101 E0102 E0120 E0121 E0130 W0131 E0503 E0602 E0603 E0604 E0605 I0681 W0682 W0683 E0701 E0702 E0703 E0704 E0705 E0706 \
    E0707 E0708 E0710 I0711 I0712 I0713 I0714 I0715 I0716 I0717 W0720 W0882 W0885 E0901 W0905 E0906 E0907 E0908 E0912 E0913 \
    W0914 W0918 E0922 E1001 W1002 W1003 W1007 E1084 E1301 E1302 E1307 W1310 W1311 W1312 W1313 I1314 W1315 W1316 I1317 W1319 \
    I1321 I1326 W1327 W1328 W1330 W1331 W1333 I1336 I1341 I1342 I1343 W1381 E1911 W1914 W1915 W1916 W1843 I1846 I2004 W2005 \
    I2003 W0280 W0281 W0282 W0283 W0284 W0285 E0201 E0202 E0203 E0205 E0206 E1503 E1504 E1505 E1506 E1507 E1508";

#[test]
fn codes_of_the_workbench_are_translated() {
    let all: Value = serde_json::from_str(dbbd_job::report::page::CODES).unwrap();
    let codes = all["de"].as_object().unwrap();
    let wanted: BTreeSet<&str> = WORKBENCH_CODES.split_whitespace().collect();
    assert!(codes.keys().map(String::as_str).eq(wanted.iter().copied()), "{:?}", codes.keys());
    let explained = crate::cell::dbbd(Path::new("."), &["explain"]);
    let catalogue = String::from_utf8(explained.stdout).unwrap();
    let known: BTreeSet<&str> = catalogue.lines().filter_map(|line| line.split_whitespace().next()).collect();
    for (code, texts) in codes {
        assert!(known.contains(&**code), "{code} is not in the catalogue");
        let texts = texts.as_array().unwrap();
        assert!(texts.len() == 2 && texts.iter().all(|text| text.as_str().unwrap().len() > 3), "{code}");
    }
}

/// The page makes the first line about a result of the same parts as the terminal and the report.
#[test]
fn a_result_is_said_as_by_the_terminal() {
    let error = |mean: f64| json!({ "mean": mean, "p95": 3.0, "max": 4.0 });
    let content = json!({
        "predicted_position_uncertainty_mm": { "nominal": error(2.4), "identified": error(0.74) },
        "budget": { "lines": [], "combined_mm": 0.8, "coverage_factor": 2.0, "expanded_mm": 1.6 },
        "validity": {
            "tool_mm": [30.0, 20.0, 10.0], "payload_kg": 50.0, "measured": "2026-03-01", "basis": "history",
            "expanded_uncertainty_mm": 1.6, "limit_mm": null, "months": null, "until": null,
        },
    });
    let day = || "2026-03-01".to_owned();
    let english = texts("en");
    let text = |key: &str| english[key].as_str().unwrap();
    for (key, standing) in [
        ("valid", Standing::Usable { until: Some(day()) }),
        ("found", Standing::Usable { until: None }),
        ("over", Standing::Over { until: day() }),
        ("warned", Standing::Warned),
        ("undecided", Standing::Undecided),
        ("failed", Standing::Failed),
    ] {
        let headline = Headline::of_json(&content, &standing).unwrap();
        let parts = [
            ("{headline}", text("headline").to_owned()),
            ("{payload}", text("headline.payload").to_owned()),
            ("{before_mm}", headline.before_mm.to_string()),
            ("{after_mm}", headline.after_mm.to_string()),
            ("{u_mm}", headline.u_mm.to_string()),
            ("{k}", headline.k.to_string()),
            ("{tool_mm}", "(30.0, 20.0, 10.0)".to_owned()),
            ("{payload_kg}", headline.payload_kg.unwrap().to_string()),
            ("{until}", day()),
            ("{measured}", day()),
        ];
        let sentence = text(&format!("say.result.{key}")).to_owned();
        let said = parts.iter().fold(sentence, |said, (name, value)| said.replace(name, value));
        assert_eq!(said, headline.to_string(), "{key}");
    }
}
