//! The pages in a browser: the workflow of an operator, played by `tests/clients/page.py`, and the whole work on a robot, played by
//! `tests/clients/workbench.py`. They need Chromium, playwright and axe.
#![cfg(unix)]

use std::path::Path;

use crate::cell::client;

/// Plays all stories of a script.
fn play(script: &str) {
    let dir = tempfile::tempdir().unwrap();
    let paths = [Path::new(env!("CARGO_BIN_EXE_dbbd")), dir.path()].map(Path::as_os_str);
    eprintln!("{}", client(script, paths.into_iter()));
}

#[test]
#[ignore = "needs Chromium, playwright and axe, and four times two minutes: .ci/night"]
fn all_page_stories() {
    play("page.py");
}

#[test]
#[ignore = "needs Chromium, playwright and axe, and eight times three minutes: .ci/night"]
fn a_robot_goes_from_an_empty_directory_to_the_certificate() {
    play("workbench.py");
}
