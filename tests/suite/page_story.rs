//! The page in a browser: the whole story of an operator, by `tests/clients/page.py`, where Chromium, playwright and axe
//! are installed.
#![cfg(unix)]

use std::io::Write;
use std::path::Path;
use std::process::Command;

/// Exit code of the script where something is not installed.
const SKIPPED: i32 = 77;

/// Plays the stories of these languages.
fn play(languages: &[&str]) {
    let dir = tempfile::tempdir().unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/clients/page.py");
    let played = Command::new("python3")
        .arg(script)
        .args([Path::new(env!("CARGO_BIN_EXE_dbbd")), dir.path()])
        .args(languages)
        .output();
    // Straight to stderr, past the test harness, which keeps what a test that passes prints.
    let mut loud = std::io::stderr();
    let mut skip = |why: &str| writeln!(loud, "SKIPPED: the page in a browser: {why}").unwrap();
    let Ok(played) = played else {
        return skip("there is no python3");
    };
    let said = [played.stdout, played.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    match played.status.code() {
        Some(0) => eprintln!("{}", said[0]),
        Some(SKIPPED) => skip(&said[0]),
        code => panic!("{code:?}\n{}\n{}", said[0], said[1]),
    }
}

/// In the suite the German stories; `page_stories -- --ignored` plays all.
#[test]
fn an_operator_goes_from_the_open_page_to_the_report() {
    play(&["de"]);
}

#[test]
#[ignore = "four stories of two minutes each"]
fn all_page_stories() {
    play(&[]);
}
