//! The pages in a browser: the workflow of an operator, played by `tests/clients/page.py`, and the whole work on a robot, played by
//! `tests/clients/workbench.py`. They need Chromium, playwright and axe.
#![cfg(unix)]

use std::ffi::OsStr;
use std::path::Path;

use crate::cell::client;

/// Plays the stories of a script in these languages.
fn play(script: &str, languages: &[&str]) {
    let dir = tempfile::tempdir().unwrap();
    let paths = [Path::new(env!("CARGO_BIN_EXE_dbbd")), dir.path()].map(Path::as_os_str);
    eprintln!("{}", client(script, paths.into_iter().chain(languages.iter().map(OsStr::new))));
}

#[test]
#[ignore = "needs Chromium, playwright and axe, and four times two minutes: .ci/night"]
fn all_page_stories() {
    play("page.py", &[]);
}

#[test]
#[ignore = "needs Chromium, playwright and axe: .ci/night"]
fn a_robot_goes_from_an_empty_directory_to_the_certificate() {
    play("workbench.py", &[]);
}
