//! Codes are stable, explained and provoked.
#![cfg(unix)]

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use dbbd::catalogue;

use crate::cell::dbbd;

/// Codes that no test provokes, and why.
const NOT_HERE: &[(&str, &str)] = &[
    ("E0202", "root may open every port: held beside the code, in device/port/mod.rs"),
    ("E0208", "a system that refuses the list of its devices"),
    ("I0210", "an adapter with a latency timer"),
    ("I0212", "a computer without serial ports"),
    ("I1380", "no input leads to it"),
    ("E1511", "a job of an hour, or of 2 GB"),
    ("E2401", "a program without the archive: `.ci/night` runs the tests without features"),
    ("I2003", "a program without the PDF: `.ci/night` runs the tests without features"),
];

/// The code of an unknown code.
const UNKNOWN: &str = "E0001";

/// Debug builds log each code that a finding is asked for to the file that `DBBD_CODE_LOG` names. `.ci/run` runs all tests with it,
/// and this one last.
#[test]
#[ignore = "reads what all other tests logged: .ci/run runs it behind them"]
fn every_code_is_provoked_by_a_test() {
    let path = std::env::var_os("DBBD_CODE_LOG").expect("DBBD_CODE_LOG names the log of the codes");
    let log = fs::read_to_string(path).unwrap();
    let provoked: BTreeSet<&str> = log.lines().chain(NOT_HERE.iter().map(|(code, _)| *code)).collect();
    let silent: Vec<_> = catalogue::entries()
        .map(|entry| entry.code.as_str())
        .filter(|code| !provoked.contains(code))
        .collect();
    assert!(silent.is_empty(), "no test provokes {silent:?}");
}

/// `DBBD_BLESS=1 cargo test troubleshooting_page` writes the page.
#[test]
fn troubleshooting_page_is_the_catalogue() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/troubleshooting.md");
    if std::env::var_os("DBBD_BLESS").is_some() {
        fs::write(&path, catalogue::page()).unwrap();
    }
    assert_eq!(fs::read_to_string(path).unwrap(), catalogue::page(), "DBBD_BLESS=1 writes it again");
}

#[test]
fn explain_prints_an_entry_and_refuses_an_unknown_code() {
    let root = Path::new(".");
    for entry in catalogue::entries() {
        let output = dbbd(root, &["explain", entry.code.as_str(), "--json"]);
        let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(json["code"], entry.code.as_str());
    }
    let unknown = dbbd(root, &["explain", "E9999", "--json"]);
    assert_eq!(unknown.status.code(), Some(1));
    let json: serde_json::Value = serde_json::from_slice(&unknown.stdout).unwrap();
    assert_eq!(json["error"]["code"], UNKNOWN);
}
