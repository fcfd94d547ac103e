//! The pages in a browser: the workflow of an operator, played by `tests/clients/page.py`, and the whole work on a robot, played by
//! `tests/clients/workbench.py`, if Chromium, playwright and axe are installed.
#![cfg(unix)]

use std::ffi::OsStr;
use std::path::Path;

use crate::cell::client;

/// Plays the stories of a script that these words choose, or all.
fn play(script: &str, chosen: &[&str]) {
    let dir = tempfile::tempdir().unwrap();
    let paths = [Path::new(env!("CARGO_BIN_EXE_dbbd")), dir.path()].map(Path::as_os_str);
    if let Some(said) = client(script, paths.into_iter().chain(chosen.iter().map(OsStr::new))) {
        eprintln!("{said}");
    }
}

/// In the suite the German stories; `page_stories -- --ignored` plays all.
#[test]
fn an_operator_goes_from_the_open_page_to_the_report() {
    play("page.py", &["de"]);
}

/// In the suite one form of eight.
#[test]
fn a_robot_goes_from_an_empty_directory_to_the_certificate() {
    play("workbench.py", &["desktop-en-light-token"]);
}

#[test]
#[ignore = "twelve stories of two minutes each"]
fn all_page_stories() {
    play("page.py", &[]);
    play("workbench.py", &[]);
}
