//! The identity of a measurement (who, what, where, when) is carried from the job to the result.

use std::fs;
use std::path::Path;

use serde_json::Value;
use tempfile::tempdir;

use crate::cell::{codes, dbbd, kr60, stderr};

/// One short circle with a complete identity.
pub(crate) const JOB: &str = r#"robot = "robot.toml"
[bar]
length_mm = 300.0
stroke_mm = [-5.0, 5.0]
margin_mm = 0.5
length_u_mm = 0.002
temperature_c = 20.0
expansion_per_k = 12e-6
serial = "B-1"
certificate = "K-77"
certified_on = "2026-03-01"
certified_by = "Length laboratory"
[[centre]]
id = 1
xyz_mm = [1300.0, 0.0, 800.0]
serial = "S-21"
[[circle]]
plane = "XY"
points = 24
tilt_deg = 30.0
amplitude_deg = 25.0
[identity]
laboratory = "Laboratory of the job"
operator = "Operator of the job"
load_kg = 12.5
[[identity.temperature]]
of = "bar"
celsius = 20.1
u_k = 0.2
device = "T-3"
"#;

/// The robot file with serial numbers of robot and controller.
pub(crate) fn robot() -> String {
    let mut robot = kr60();
    (robot.serial, robot.controller_serial) = (Some("KR-1".into()), Some("C-1".into()));
    robot.to_toml().unwrap()
}

fn info(dir: &Path, file: &str) -> Value {
    let output = dbbd(dir, &["info", file, "--json"]);
    serde_json::from_slice::<Value>(&output.stdout).unwrap()["provenance"]["identity"].clone()
}

#[test]
fn identity_is_in_capture_and_result() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    fs::write(at.join("robot.toml"), robot()).unwrap();
    fs::write(at.join("job.toml"), JOB).unwrap();
    fs::write(at.join("shift.toml"), "operator = 'Operator of the shift'\ncell = 'cell 7'\n").unwrap();
    for step in [
        &["plan", "job.toml", "--out", "plan"][..],
        &[
            "acquire",
            "--port",
            "sim",
            "--plan",
            "plan/plan.csv",
            "--identity",
            "shift.toml",
            "--out",
            "run.dbbd",
        ],
        &["identify", "run.dbbd", "--estimate", "a1-3,bar", "--folds", "0", "--out", "result"],
    ] {
        let output = dbbd(at, step);
        assert!(matches!(output.status.code(), Some(0 | 3)), "{step:?}: {}", stderr(&output));
    }
    let planned = info(at, "plan/plan.json");
    assert_eq!((&planned["operator"], &planned["measured"]), (&"Operator of the job".into(), &Value::Null));
    for file in ["run.dbbd", "result/result.json", "result/robot-identified.toml"] {
        let found = info(at, file);
        for (key, value) in [
            ("/robot", "KR-1"),
            ("/controller", "C-1"),
            ("/laboratory", "Laboratory of the job"),
            ("/operator", "Operator of the shift"),
            ("/cell", "cell 7"),
            ("/bar/serial", "B-1"),
            ("/bar/certificate", "K-77"),
            ("/bar/certified_on", "2026-03-01"),
            ("/balls/1", "S-21"),
            ("/temperature/0/device", "T-3"),
        ] {
            assert_eq!(found.pointer(key).and_then(Value::as_str), Some(value), "{file}: {key} in {found}");
        }
        assert_eq!(found["load_kg"], 12.5);
        // The date is that of the capture's clock, in the form of ISO 8601.
        let date = found["measured"].as_str().unwrap();
        assert!(date.starts_with("20") && date.ends_with('Z') && date.len() == 20, "{date}");
    }
    // The same capture gives the same bytes.
    let first = fs::read(at.join("result/result.json")).unwrap();
    dbbd(at, &["identify", "run.dbbd", "--estimate", "a1-3,bar", "--folds", "0", "--out", "result"]);
    assert_eq!(fs::read(at.join("result/result.json")).unwrap(), first);
    // A new measurement with the identified robot has its serial numbers, and nothing else of the old one.
    dbbd(at, &["plan", "job.toml", "--robot", "result/robot-identified.toml", "--out", "next"]);
    let next = info(at, "next/plan.json");
    assert_eq!((&next["robot"], &next["measured"]), (&"KR-1".into(), &Value::Null));
    assert_eq!(next["operator"], "Operator of the job");
}

/// A replacement in the job, the code and the line.
const WRONG: &[(&str, &str, &str, usize)] = &[
    ("certified_on = \"2026-03-01\"", "certified_on = \"2026-02-29\"", "E0680", 11),
    ("serial = \"S-21\"", "serial = \"\"", "E0680", 16),
    ("serial = \"S-21\"", "serial = \"S\\u202e21\"", "E0680", 16),
    ("operator = \"Operator of the job\"", "measured = \"yesterday\"", "E0680", 24),
    ("celsius = 20.1", "celsius = 2010", "E0130", 28),
    ("load_kg = 12.5", "load_kg = -1", "E0130", 25),
];

#[test]
fn implausible_identity_is_refused_with_its_line() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    fs::write(at.join("robot.toml"), robot()).unwrap();
    for (from, to, code, line) in WRONG {
        assert!(JOB.contains(from));
        fs::write(at.join("job.toml"), JOB.replace(from, to)).unwrap();
        let output = dbbd(at, &["plan", "job.toml", "--out", "plan"]);
        assert_eq!((output.status.code(), codes(&output)), (Some(1), vec![(*code).to_owned()]), "{to}");
        assert!(stderr(&output).contains(&format!("job.toml:{line}:")), "{to}: {}", stderr(&output));
    }
    fs::write(at.join("shift.toml"), "operator = ''\n").unwrap();
    fs::write(at.join("job.toml"), JOB).unwrap();
    let args = ["acquire", "--port", "no-such-port", "--identity", "shift.toml", "--out", "run.dbbd"];
    assert_eq!(codes(&dbbd(at, &args)), ["E0680"]);
    assert!(!at.join("run.dbbd").exists());
    fs::write(at.join("dbbd.toml"), "[identity]\nlaboratory = ''\n").unwrap();
    assert_eq!(codes(&dbbd(at, &["serve", "--config", "dbbd.toml", "--check"])), ["E0680"]);
}
