//! Mistakes of users: each is refused, or gives a warning with a code and exit code 3.

use std::fs;
use std::path::PathBuf;
use std::process::Output;

use serde_json::Value;

use super::on_one_machine::{json, objects, plant_of};
use super::{archive, plant};
use crate::cell::{codes, stderr};
use crate::nothing_wrong_is_silent::says;

fn pushed(runs: u64) -> tempfile::TempDir {
    let dir = plant_of(runs);
    let output = archive(dir.path(), &["push", "runs"]);
    assert_eq!((output.status.code(), codes(&output)), (Some(0), vec![]), "{}", stderr(&output));
    dir
}

fn ends(output: &Output, exit: i32, expected: &[&str]) {
    let said = codes(output);
    assert!(output.status.code() == Some(exit) && said == expected, "{expected:?}: {}", stderr(output));
}

#[test]
fn empty_selections_give_a_reason() {
    let dir = pushed(2);
    let at = dir.path();
    for (choice, exit, code) in [
        (&["--since", "01.01.2026"][..], 1, &["E2418"][..]),
        (&["--since", "2026-1-1"], 1, &["E2418"]),
        (&["--until", "2026-02-30"], 1, &["E2418"]),
        (&["--since", "2026-01-02", "--until", "2026-01-01"], 1, &["E2418"]),
        (&["--since", "2399-01-01"], 1, &["E2418"]),
        (&["--limit", "0"], 2, &[]),
        (&["--robot", "r1"], 3, &["W2419"]),
        (&["--type", "KR 60"], 3, &["W2419"]),
        (&["--bar", "B9"], 3, &["W2419"]),
        (&["--cell", "cell 9"], 3, &["W2419"]),
        (&["--robot", "R0", "--bar", "B1"], 0, &["I2420"]),
        (&["--search", "nothing"], 0, &["I2420"]),
        (&["--since", "2026-01-01T12:00:00Z"], 0, &[]),
    ] {
        for verb in [&["list"][..], &["export", "--out", "tables"], &["reprocess", "--ask-only"]] {
            let output = archive(at, &[verb, choice].concat());
            // The command line parser refuses wrong usage.
            ends(&output, exit, if exit == 2 { &[] } else { code });
        }
    }
    // The limit applies to every command: the newest runs.
    let asked = archive(at, &["reprocess", "--ask-only", "--limit", "1", "--prior", "none", "--json"]);
    assert_eq!(json(&asked)["asked"], 1);
}

#[test]
fn invalid_settings_create_no_jobs() {
    let dir = pushed(1);
    let at = dir.path();
    for (settings, code) in [
        (&["--prior", "datasheets"][..], "E2411"),
        (&["--model", "geometry"], "E2411"),
        (&["--estimate", "alpha1-5,a9"], "E0501"),
        (&["--hold", "nothing"], "E0501"),
    ] {
        ends(&archive(at, &[&["reprocess", "--ask-only"], settings].concat()), 1, &[code]);
    }
    // A failed job is counted by the call that requested it, not by the next one.
    let bad = archive(at, &["reprocess", "--estimate", "centre9_x", "--prior", "none"]);
    says(&bad, 3, "W2414");
    ends(&archive(at, &["reprocess"]), 0, &[]);
}

#[test]
fn missing_data_of_a_run_give_warnings() {
    let dir = plant_of(3);
    let at = dir.path();
    let capture = at.join("runs/run-0/run.dbbd");
    let whole = fs::read(&capture).unwrap();
    fs::write(&capture, &whole[..whole.len() - 30]).unwrap();
    ends(&archive(at, &["push", "runs/run-0"]), 3, &["W0410", "W0411"]);
    // Names that the archive does not take, and directories in directories.
    let run = at.join("runs/run-1");
    fs::create_dir_all(run.join("identify/deep")).unwrap();
    fs::write(run.join("identify/deep/result.json"), "{}").unwrap();
    fs::write(run.join("remarks of the operator.txt"), "the bar fell").unwrap();
    fs::write(run.join(".archive"), "").unwrap();
    ends(&archive(at, &["push", "runs/run-1"]), 3, &["W2421"; 2]);
    fs::write(at.join("runs/run-2/check/check.json"), "{\"decision\":\"passed\"}").unwrap();
    ends(&archive(at, &["push", "runs/run-2"]), 3, &["W2422"]);
    // An identity with a blank text cannot be read: the archive does not know the robot.
    let case = plant::Case { robot: String::new(), ..plant::Case::number(5) };
    plant::write(&at.join("unnamed.dbbd"), &plant::plan(8), &crate::cell::kr60().geometry, &case);
    ends(&archive(at, &["push", "unnamed.dbbd"]), 3, &["W2422", "I2426"]);
}

#[test]
fn lost_objects_are_restored_and_reported() {
    let dir = pushed(1);
    let at = dir.path();
    let worked = archive(at, &["reprocess"]);
    assert_eq!(worked.status.code(), Some(0), "{}", stderr(&worked));
    let listed = json(&archive(at, &["list", "--json"]));
    let run = listed[0]["sha256"].as_str().unwrap().to_owned();
    fs::remove_file(objects(at).into_iter().find(|path| path.ends_with(&run)).unwrap()).unwrap();
    ends(&archive(at, &["push", "runs"]), 3, &["I2413", "W2423"]);
    // Of a result: it is named, and made again.
    let is_result = |path: &PathBuf| {
        let json = serde_json::from_slice::<Value>(&fs::read(path).unwrap());
        json.is_ok_and(|json| json["residual_mm"].is_object())
    };
    let result = objects(at).into_iter().find(is_result).unwrap();
    fs::remove_file(&result).unwrap();
    ends(&archive(at, &["push", "runs"]), 3, &["I2413", "W2423"]);
    let worked = archive(at, &["reprocess"]);
    assert_eq!(worked.status.code(), Some(0), "{}", stderr(&worked));
    assert!(result.is_file());
    ends(&archive(at, &["push", "runs"]), 0, &["I2413"]);
}

#[test]
fn an_uninitialised_store_is_refused() {
    let dir = pushed(1);
    let at = dir.path();
    for verb in [&["push", "runs"][..], &["worker", "--until-empty"], &["reprocess"]] {
        ends(&archive(at, &[verb, &["--store", "file:object"]].concat()), 1, &["E2407"]);
    }
    for address in [["--archive", "sqlite:"], ["--archive", "sqlite::memory:"], ["--store", "file:"]] {
        ends(&archive(at, &[&["list"][..], &address].concat()), 1, &["E2402"]);
    }
    for spool in ["objects", "objects/spool"] {
        ends(&archive(at, &["push", "runs", "--spool", spool]), 1, &["E2402"]);
    }
    let config =
        "[archive]\ndatabase = \"sqlite:plant.db\"\nstore = \"file:objects\"\nspool = \"objects/spool\"\n";
    fs::write(at.join("dbbd.toml"), config).unwrap();
    ends(&crate::cell::dbbd(at, &["serve", "--config", "dbbd.toml", "--check"]), 1, &["E2402"]);
    for (verb, option, value) in [
        ("serve", "--limit", "800"),
        ("serve", "--interval", "0.5"),
        ("serve", "--interval", "15552000"),
        ("worker", "--lease", "1e30"),
        ("worker", "--lease", "0.001"),
    ] {
        assert_eq!(archive(at, &[verb, option, value]).status.code(), Some(2), "{option} {value}");
    }
}

/// The only copy of another run, and a table of the user's.
#[test]
fn existing_files_are_not_replaced() {
    let dir = pushed(1);
    let at = dir.path();
    let listed = json(&archive(at, &["list", "--json"]));
    let run = listed[0]["sha256"].as_str().unwrap().to_owned();
    fs::create_dir(at.join("back")).unwrap();
    fs::write(at.join("back/run.dbbd"), "another").unwrap();
    ends(&archive(at, &["get", &run, "--out", "back"]), 1, &["E0181"]);
    assert_eq!(fs::read(at.join("back/run.dbbd")).unwrap(), b"another");
    assert!(!at.join("back/check").exists());
    let export = |format: &str| archive(at, &["export", "--format", format, "--out", "back"]);
    for _ in 0..2 {
        ends(&export("csv"), 0, &[]);
        ends(&export("parquet"), 0, &[]);
    }
    fs::write(at.join("back/results.csv"), "mine,yours\n").unwrap();
    ends(&export("csv"), 1, &["E0181"]);
    ends(&export("parquet"), 0, &[]);
}
