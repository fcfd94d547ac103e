//! `dbbd robots` lists the robots that are built in.

use std::process::Output;

use dbbd_model::robot::Robot;
use tempfile::tempdir;

use crate::cell::{dbbd, stderr};

#[test]
fn robots_are_listed_and_shown_with_their_source() {
    let dir = tempdir().unwrap();
    let stdout = |output: &Output| String::from_utf8(output.stdout.clone()).unwrap();
    let list = stdout(&dbbd(dir.path(), &["robots"]));
    for (name, _) in Robot::built_in() {
        assert!(list.contains(name), "{list}");
        let shown = dbbd(dir.path(), &["robots", "show", name]);
        assert!(shown.status.success(), "{}", stderr(&shown));
        assert!(stdout(&shown).contains("Geometry"), "{name} has no source");
    }
}
