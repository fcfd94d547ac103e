//! The demo runs the whole job on files. Each step reads the files of the previous one, and fails without them.
#![cfg(unix)]

use std::fs;
use std::path::Path;

use dbbd_model::estimation::CalibrationResult;
use tempfile::tempdir;

use crate::cell::{codes, dbbd, stderr};
use crate::process::Simulator;
use crate::support::spoken::assert_spoken;

/// The same three circles with few points, so that the test is short.
fn short_job(dir: &Path) {
    let mut job = include_str!("../../examples/circles.toml").to_owned();
    job = job.replace("points = 80", "points = 12");
    fs::write(dir.join("job.toml"), job).unwrap();
}

fn step(dir: &Path, args: &[&str]) {
    let output = dbbd(dir, args);
    assert!(matches!(output.status.code(), Some(0 | 3)), "dbbd {}: {}", args.join(" "), stderr(&output));
}

/// What `dbbd demo --json` compares, with these further options.
fn compared(dir: &Path, options: &[&str], code: i32) -> serde_json::Value {
    let output = dbbd(dir, &[&["demo", "--json"], options].concat());
    assert_eq!(output.status.code(), Some(code), "{}", stderr(&output));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn result_of(dir: &Path) -> CalibrationResult {
    serde_json::from_str(&fs::read_to_string(dir.join("demo-out/result/result.json")).unwrap()).unwrap()
}

/// The mean 3-D error before and after, mm.
fn means_mm(comparison: &serde_json::Value) -> [f64; 2] {
    ["nominal_error_mm", "identified_error_mm"].map(|key| comparison[key][0].as_f64().unwrap())
}

/// Three balls and a long bar identify a robot with errors of its joints over its whole workspace, and the result says how well.
#[test]
fn the_demo_leaves_a_tenth_of_a_millimetre() {
    let dir = tempdir().unwrap();
    let comparison = compared(dir.path(), &[], 0);
    let [before, after] = means_mm(&comparison);
    assert!(before > 1.0 && after < 0.1, "{comparison}");
    let predicted = comparison["predicted_error_mm"].as_f64().unwrap();
    assert!((0.5..1.5).contains(&(after / predicted)), "{after} mm, predicted {predicted} mm");
    let page = fs::read_to_string(dir.path().join("demo-out/result/report.html")).unwrap();
    assert_spoken(&page);
    // Another demo takes its place: one circle does not determine the paper's parameters over the whole workspace.
    assert_eq!(compared(dir.path(), &["--paper"], 3)["parameters"].as_array().unwrap().len(), 13);
    assert!(result_of(dir.path()).findings.iter().any(|finding| finding.code() == "W1319"));
}

#[test]
fn the_demo_of_circles_compares_result_and_truth() {
    let dir = tempdir().unwrap();
    let comparison = compared(dir.path(), &["--circles"], 0);
    let [before, after] = means_mm(&comparison);
    assert!(after < 0.5 * before, "{comparison}");
    // Each identified parameter is within a plausible multiple of its standard deviation.
    for row in comparison["parameters"].as_array().unwrap() {
        let [truth, found, sd] =
            ["true_correction", "correction", "sd"].map(|key| row[key].as_f64().unwrap());
        assert!((found - truth).abs() < 5.0 * sd + 1e-4, "{row}");
    }
    let text = fs::read_to_string(dir.path().join("demo-out/result/result.json")).unwrap();
    let made: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(made["provenance"]["identity"]["laboratory"], "Example laboratory");
    let result = result_of(dir.path());
    // The file is the result as it is, beside what it was made from.
    let mut kept = made.clone();
    kept.as_object_mut()
        .unwrap()
        .retain(|key, _| !["budget", "provenance", "sha256"].contains(&key.as_str()));
    assert_eq!(serde_json::to_value(&result).unwrap(), kept);
    assert!(result.residual_mm.after.rms < 0.03 && result.residual_mm.before.rms > 0.05);
    let page = fs::read_to_string(dir.path().join("demo-out/result/report.html")).unwrap();
    assert!(page.contains("<svg") && page.contains("Circle 1"));
    assert_spoken(&page);
}

/// Each command needs the file of the previous step.
#[test]
fn missing_inputs_are_refused() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    short_job(at);
    let steps: &[(&[&str], &str)] = &[
        (&["plan", "job.toml", "--out", "plan"], "job.toml"),
        (&["krl", "plan/plan.csv", "--out", "krl"], "plan/plan.csv"),
        (&["krl", "plan/plan.csv", "--out", "krl"], "plan/plan.json"),
        (&["simulate", "--program", "krl/DBB_MAIN.src"], "krl/DBB_C001.src"),
        (&["simulate", "--program", "krl/DBB_MAIN.src"], "krl/DBB_MAIN.src"),
        (&["sync", "run.dbbd", "--out", "obs.csv"], "run.dbbd"),
        (
            &[
                "identify",
                "obs.csv",
                "--robot",
                "kr60ha",
                "--tool",
                "30,20,10",
                "--centres",
                "plan/centres.csv",
                "--out",
                "result",
            ],
            "obs.csv",
        ),
        (
            &[
                "identify",
                "obs.csv",
                "--robot",
                "kr60ha",
                "--tool",
                "30,20,10",
                "--centres",
                "plan/centres.csv",
                "--out",
                "result",
            ],
            "plan/centres.csv",
        ),
    ];
    step(at, steps[0].0);
    step(at, steps[1].0);
    measure(at);
    step(at, steps[5].0);
    step(at, steps[6].0);
    for (args, file) in steps {
        let (path, aside) = (at.join(file), at.join("aside"));
        fs::rename(&path, &aside).unwrap();
        let output = dbbd(at, args);
        assert_eq!(output.status.code(), Some(1), "dbbd {} without {file}", args.join(" "));
        let name = file.rsplit('/').next().unwrap();
        let stem = name.rsplit_once('.').unwrap().0;
        assert!(stderr(&output).contains(stem), "{file} is not named: {}", stderr(&output));
        fs::rename(&aside, &path).unwrap();
    }
}

/// Simulates in one process and acquires in another, over the pseudo-terminal that the first one prints.
fn measure(dir: &Path) {
    let program = [
        "--program",
        "krl/DBB_MAIN.src",
        "--robot",
        "kr60ha",
        "--tool",
        "30,20,10",
        "--speed",
        "0",
        "--quiet",
    ];
    let simulator = Simulator::start(dir, &program);
    step(dir, &["acquire", "--port", &simulator.port, "--plan", "plan/plan.csv", "--out", "run.dbbd"]);
    assert!(simulator.finished().status.success());
}

/// Whether two results are equal; their numbers to a fraction of 1e-6.
fn are_alike(one: &serde_json::Value, other: &serde_json::Value) -> bool {
    use serde_json::Value::{Array, Number, Object};
    match (one, other) {
        (Number(a), Number(b)) => {
            let [a, b] = [a, b].map(|number| number.as_f64().unwrap());
            (a - b).abs() <= 1e-6 * a.abs().max(b.abs()) + 1e-12
        }
        (Array(a), Array(b)) => a.len() == b.len() && a.iter().zip(b).all(|(a, b)| are_alike(a, b)),
        (Object(a), Object(b)) => {
            a.len() == b.len() && a.iter().all(|(key, a)| b.get(key).is_some_and(|b| are_alike(a, b)))
        }
        (one, other) => one == other,
    }
}

/// The capture contains robot, balls and plan: alone it gives the same result as the single steps.
#[test]
fn capture_alone_suffices() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    short_job(at);
    step(at, &["plan", "job.toml", "--out", "plan"]);
    step(at, &["acquire", "--port", "sim", "--plan", "plan/plan.csv", "--out", "run.dbbd"]);
    step(at, &["identify", "run.dbbd", "--prior", "datasheet", "--out", "at-once"]);
    step(at, &["sync", "run.dbbd", "--out", "obs.csv"]);
    step(
        at,
        &[
            "identify",
            "obs.csv",
            "--robot",
            "kr60ha",
            "--tool",
            "30,20,10",
            "--centres",
            "plan/centres.csv",
            "--prior",
            "datasheet",
            "--out",
            "by-steps",
        ],
    );
    let read = |name: &str| fs::read_to_string(at.join(name).join("result.json")).unwrap();
    let result: CalibrationResult = serde_json::from_str(&read("at-once")).unwrap();
    assert!(result.measurements > 36, "{} observations", result.measurements);
    // Equal except for the provenance; the times of a table, which enter what changes with time, have fewer digits.
    let by_steps: CalibrationResult = serde_json::from_str(&read("by-steps")).unwrap();
    let [one, other] = [&result, &by_steps].map(|result| serde_json::to_value(result).unwrap());
    assert!(are_alike(&one, &other), "{one}\n{other}");
    // Lengths that agree with an identified robot raise no suspicion of an accuracy model in the controller.
    let known =
        dbbd(at, &["identify", "run.dbbd", "--robot", "at-once/robot-identified.toml", "--out", "again"]);
    assert!(!stderr(&known).contains("accuracy model"), "{}", stderr(&known));
    let again: CalibrationResult = serde_json::from_str(&read("again")).unwrap();
    assert!(again.residual_mm.before.rms < 0.03, "{}", again.residual_mm.before.rms);
    // Poses of one robot are no data of another; the result has this warning too.
    let other = dbbd(at, &["identify", "run.dbbd", "--robot", "kr16-2", "--out", "other", "--json"]);
    assert!(other.status.code() == Some(3) && codes(&other).contains(&"W1328".into()), "{}", stderr(&other));
    // Findings of the run and of the result are in one list.
    let printed: serde_json::Value = serde_json::from_slice(&other.stdout).unwrap();
    let printed: Vec<_> = printed["findings"].as_array().unwrap().iter().map(|one| &one["code"]).collect();
    assert!(["W1328", "W1311"].iter().all(|code| printed.contains(&&(*code).into())), "{printed:?}");
    let warned: CalibrationResult = serde_json::from_str(&read("other")).unwrap();
    let planned = warned.findings.iter().find(|finding| finding.code() == "W1328").unwrap().values();
    assert_eq!((&planned["planned"], &planned["given"]), (&"KUKA KR 60 HA".into(), &"KUKA KR 16-2".into()));
}
