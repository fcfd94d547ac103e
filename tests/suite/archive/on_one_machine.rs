//! SQLite and a directory.

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};

use serde_json::Value;
use tempfile::tempdir;

use super::{archive, archive_with, plant};
use crate::cell::codes;

pub(super) fn json(output: &std::process::Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap()
}

/// An archive with nothing in it and a directory of runs.
pub(super) fn plant_of(runs: u64) -> tempfile::TempDir {
    let dir = tempdir().unwrap();
    plant::directory(&dir.path().join("runs"), runs);
    assert_eq!(archive(dir.path(), &["init"]).status.code(), Some(0));
    dir
}

pub(super) fn objects(dir: &Path) -> Vec<PathBuf> {
    let folders = fs::read_dir(dir.join("objects/objects")).unwrap().map(|entry| entry.unwrap().path());
    folders.flat_map(|path| fs::read_dir(path).unwrap().map(|entry| entry.unwrap().path())).collect()
}

#[test]
fn a_run_is_stored_once_and_fetched_unchanged() {
    let dir = plant_of(3);
    let at = dir.path();
    let first = archive(at, &["push", "runs", "--json"]);
    assert_eq!(first.status.code(), Some(0), "{}", crate::cell::stderr(&first));
    assert_eq!(json(&first)["new"].as_array().unwrap().len(), 3);
    let again = archive(at, &["push", "runs", "--json"]);
    assert_eq!((again.status.code(), codes(&again)), (Some(0), vec!["I2413".to_owned(); 3]));
    let listed = json(&archive(at, &["list", "--json"]));
    let robots: Vec<_> =
        listed.as_array().unwrap().iter().map(|run| run["robot"].as_str().unwrap()).collect();
    assert_eq!(robots, ["R2", "R1", "R0"], "the newest first");
    assert_eq!(listed[2]["bar"], "B0");
    assert_eq!(listed[2]["certificate"], "K-B0");
    assert_eq!(listed[2]["cell"], "cell 0");
    assert_eq!(listed[2]["type"], "KUKA KR 60 HA");
    assert_eq!(listed[2]["measured"], "2026-01-01T00:00:00Z");
    assert_eq!(listed[2]["decision"], "pass");
    for (choice, runs) in [
        (&["--robot", "R1"][..], 1),
        (&["--bar", "B9"], 0),
        (&["--cell", "cell 0"], 2),
        (&["--since", "2026-01-02", "--until", "2026-01-03"], 1),
        (&["--search", "CELL 1"], 1),
        (&["--search", "%"], 0),
        (&["--robot", "' OR 1 = 1 --"], 0),
        (&["--limit", "2"], 2),
    ] {
        let found = json(&archive(at, &[&["list", "--json"], choice].concat()));
        assert_eq!(found.as_array().unwrap().len(), runs, "{choice:?}");
    }
    let run = listed[2]["sha256"].as_str().unwrap();
    let shown = json(&archive(at, &["show", &run[..8], "--json"]));
    assert_eq!(shown["provenance"]["identity"]["operator"], "Op 0");
    assert_eq!(archive(at, &["get", &run[..8], "--out", "back"]).status.code(), Some(0));
    for file in ["run.dbbd", "check/check.json"] {
        let [out, back] = ["runs/run-0", "back"].map(|from| fs::read(at.join(from).join(file)).unwrap());
        assert_eq!(out, back, "{file}");
    }
}

#[test]
fn an_interrupted_push_is_resumed_and_damage_is_found() {
    let dir = plant_of(1);
    let at = dir.path();
    assert_eq!(archive(at, &["push", "runs"]).status.code(), Some(0));
    let listed = json(&archive(at, &["list", "--json"]));
    let run = listed[0]["sha256"].as_str().unwrap().to_owned();
    let object = objects(at).into_iter().find(|path| path.ends_with(&run)).unwrap();
    // Truncated, changed with the same length, or missing: `get` refuses, and the next push repairs it.
    let whole = fs::read(&object).unwrap();
    let mut changed = whole.clone();
    changed[whole.len() / 2] ^= 1;
    for content in
        [Some(&whole[..0]), Some(&whole[..1]), Some(&whole[..whole.len() - 1]), Some(&changed), None]
    {
        match content {
            Some(content) => fs::write(&object, content).unwrap(),
            None => fs::remove_file(&object).unwrap(),
        }
        let got = archive(at, &["get", &run, "--out", "back"]);
        assert_eq!((got.status.code(), codes(&got)), (Some(1), vec!["E2408".to_owned()]));
        assert!(!at.join("back/run.dbbd").exists());
        let again = archive(at, &["push", "runs"]);
        assert_eq!(
            (again.status.code(), codes(&again)),
            (Some(3), vec!["I2413".to_owned(), "W2423".to_owned()])
        );
        assert_eq!(archive(at, &["get", &run, "--out", "back"]).status.code(), Some(0));
        fs::remove_dir_all(at.join("back")).unwrap();
    }
}

#[test]
fn runs_wait_in_the_spool_and_are_pushed_once() {
    let dir = plant_of(2);
    let at = dir.path();
    let away = [("DBBD_ARCHIVE", "sqlite:no/such/plant.db"), ("DBBD_STORE", "file:objects")];
    let refused = archive_with(at, &["push", "runs"], &away);
    assert_eq!((refused.status.code(), codes(&refused)), (Some(1), vec!["E2404".to_owned()]));
    for _ in 0..2 {
        let waits = archive_with(at, &["push", "runs", "--spool", "spool"], &away);
        assert_eq!((waits.status.code(), codes(&waits)), (Some(3), vec!["W2412".to_owned(); 2]));
        assert_eq!(fs::read_dir(at.join("spool")).unwrap().count(), 2);
    }
    // A partial run of a killed process is ignored.
    fs::create_dir(at.join(format!("spool/{}.part", "0".repeat(64)))).unwrap();
    // A damaged run does not block the others.
    let damaged = at.join("spool").join("0".repeat(64));
    fs::create_dir(&damaged).unwrap();
    fs::remove_dir_all(at.join("runs")).unwrap();
    let sent = archive(at, &["push", "--spool", "spool", "--json"]);
    assert_eq!((sent.status.code(), codes(&sent)), (Some(3), vec!["W2412".to_owned()]));
    assert_eq!(json(&sent)["new"].as_array().unwrap().len(), 2);
    let left: Vec<_> = fs::read_dir(at.join("spool")).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(left, [damaged]);
    assert_eq!(json(&archive(at, &["list", "--json"])).as_array().unwrap().len(), 2);
}

#[test]
fn invalid_commands_are_refused_with_a_code() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    fs::write(at.join("open"), "secret-of-the-plant").unwrap();
    fs::set_permissions(at.join("open"), fs::Permissions::from_mode(0o644)).unwrap();
    fs::write(at.join("closed"), "secret-of-the-plant").unwrap();
    fs::set_permissions(at.join("closed"), fs::Permissions::from_mode(0o600)).unwrap();
    fs::create_dir(at.join("blocked")).unwrap();
    fs::write(at.join("blocked/objects"), "").unwrap();
    let here = [("DBBD_ARCHIVE", "sqlite:plant.db"), ("DBBD_STORE", "file:objects")];
    let with = |name: &'static str, value: &'static str| [here[0], here[1], (name, value)];
    let big = "postgres://cell@127.0.0.1:1/plant";
    type Case<'a> = (&'a [&'a str], &'a [(&'a str, &'a str)], &'a str);
    let cases: &[Case<'_>] = &[
        (&["list"], &[], "E2402"),
        (&["list", "--archive", "mysql://x", "--store", "file:o"], &[], "E2402"),
        (&["list", "--archive", "postgres://cell@:x/", "--store", "file:o"], &[], "E2402"),
        (&["list", "--store", "s3:///x"], &here, "E2402"),
        (&["list", "--archive", "postgres://cell@db.plant/x"], &here, "E2402"),
        (&["list", "--archive", "postgres://cell@db.plant/x?sslmode=prefer"], &here, "E2402"),
        (&["list", "--archive", "postgres://cell:secret-of-the-plant@db/x"], &here, "E2403"),
        (
            &["list", "--archive", "postgres://cell@db/x?password=secret-of-the-plant&sslmode=disable"],
            &here,
            "E2403",
        ),
        (&["list", "--store", "s3://key:secret-of-the-plant@bucket"], &here, "E2403"),
        (&["list", "--archive", big], &with("DBBD_ARCHIVE_PASSWORD_FILE", "open"), "E2403"),
        (&["list", "--archive", big], &with("DBBD_ARCHIVE_PASSWORD_FILE", "none"), "E2403"),
        (&["list", "--store", "s3://bucket"], &with("DBBD_STORE_SECRET_FILE", "closed"), "E2403"),
        (&["list", "--archive", big], &with("DBBD_ARCHIVE_PASSWORD_FILE", "closed"), "E2404"),
        (&["list"], &here, "E2407"),
        (&["init"], &here, ""),
        (&["init"], &here, ""),
        (&["show", "123"], &here, "E2409"),
        (&["show", "xxxxxxxx"], &here, "E2409"),
        (&["show", "00000000"], &here, "E2409"),
        (&["push", "."], &here, "E2410"),
        (&["push", "none"], &here, "E2410"),
        (&["init", "--store", "file:blocked"], &here, "E2406"),
    ];
    for (args, variables, code) in cases {
        let output = archive_with(at, args, variables);
        let expected: Vec<String> =
            Some(code.to_string()).filter(|code| !code.is_empty()).into_iter().collect();
        assert_eq!(codes(&output), expected, "{args:?}");
        assert_eq!(output.status.code(), Some(i32::from(!code.is_empty())));
        let said = [output.stdout, output.stderr].concat();
        assert!(!String::from_utf8_lossy(&said).contains("secret-of-the-plant"), "{args:?}");
    }
}
