//! The archive stores each run once and completely, whatever fails in between.
#![cfg_attr(not(feature = "archive"), allow(dead_code))]

use std::path::Path;
use std::process::{Command, Output};

#[cfg(feature = "archive")]
mod faults;
#[cfg(feature = "archive")]
mod figures;
#[cfg(feature = "archive")]
mod mistakes;
#[cfg(feature = "archive")]
mod on_one_machine;
#[cfg(feature = "archive")]
mod on_servers;
#[cfg(feature = "archive")]
mod pages;
#[cfg(feature = "archive")]
mod plant;
#[cfg(feature = "archive")]
mod restore;
#[cfg(feature = "archive")]
mod servers;
#[cfg(feature = "archive")]
mod service_pushes;

/// Runs `dbbd archive` on the archive in this directory, with no other environment.
pub(crate) fn archive(dir: &Path, args: &[&str]) -> Output {
    archive_with(dir, args, &[("DBBD_ARCHIVE", "sqlite:plant.db"), ("DBBD_STORE", "file:objects")])
}

/// The same with these variables.
pub(crate) fn archive_with(dir: &Path, args: &[&str], variables: &[(&str, &str)]) -> Output {
    command(dir, args, variables).output().unwrap()
}

/// The same, before it is run.
pub(crate) fn command(dir: &Path, args: &[&str], variables: &[(&str, &str)]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_dbbd"));
    for name in
        ["DBBD_ARCHIVE", "DBBD_STORE", "PGPASSWORD", "DBBD_ARCHIVE_PASSWORD_FILE", "DBBD_STORE_SECRET_FILE"]
    {
        command.env_remove(name);
    }
    command.envs(variables.iter().copied());
    command.arg("archive").args(args).current_dir(dir);
    command
}

#[cfg(not(feature = "archive"))]
#[test]
fn without_the_feature_the_command_explains_how_to_get_it() {
    let dir = tempfile::tempdir().unwrap();
    let output = archive(dir.path(), &["list"]);
    assert_eq!((output.status.code(), crate::cell::codes(&output)), (Some(1), vec!["E2401".to_owned()]));
    std::fs::write(dir.path().join("dbbd.toml"), "[archive]\ndatabase = \"sqlite:a\"\nstore = \"file:b\"\n")
        .unwrap();
    let output = crate::cell::dbbd(dir.path(), &["serve", "--config", "dbbd.toml", "--check"]);
    assert_eq!((output.status.code(), crate::cell::codes(&output)), (Some(1), vec!["E2401".to_owned()]));
}
