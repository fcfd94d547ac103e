//! The warnings of a calibration are reported wherever its robot file is used; requests that a circle, a table or a file cannot
//! meet are reported.

use std::fs;
use std::path::Path;
use std::process::Output;

use serde_json::Value;
use tempfile::tempdir;

use crate::cell::{codes, dbbd, stderr};
use crate::nothing_wrong_is_silent::{JOB, cell, identify, says};

const PRIOR: [&str; 2] = ["--prior", "datasheet"];
const RUN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/captures/run.dbbd");

#[test]
fn warnings_of_a_robot_are_reported_by_every_command() {
    let (dir, data) = cell();
    let at = dir.path();
    fs::write(at.join("again.csv"), data.to_csv().replacen("\n1,", "\n101,", 1)).unwrap();
    assert_eq!(dbbd(at, &["plan", "job.toml", "--out", "plan"]).status.code(), Some(0));
    let program = "DEF P()\n$TOOL=$NULLFRAME\n$BASE=$NULLFRAME\nPTP XP1\nEND\n";
    let points = "DEFDAT P\nDECL E6POS XP1={X 1300.0,Y 0.0,Z 900.0,A 0.0,B 90.0,C 0.0,S 2,T 10}\nENDDAT\n";
    fs::write(at.join("P.src"), program).unwrap();
    fs::write(at.join("P.dat"), points).unwrap();
    let robot = "out/robot-identified.toml";
    let verbs = [
        &["compensate", "--replace", "P.src", "--robot", robot, "--out", "new", "--limit", "50"][..],
        &["export", "--replace", robot, "--urdf-in", "arm.urdf", "--out", "urdf"],
        &["export", "--replace", "out", "--for", "kuka", "--out", "kuka"],
        &["predict", "obs.csv", "--robot", robot, "--out", "p.csv"],
        &["check", "again.csv", "--robot", robot, "--centres", "C.csv", "--out", "check"],
        &["robots", "check", robot],
    ];
    let warned = || {
        verbs.map(|args| {
            let output = dbbd(at, args);
            assert_ne!(output.status.code(), Some(1), "{args:?}: {}", stderr(&output));
            codes(&output).contains(&"W1843".to_owned())
        })
    };
    assert_eq!(identify(at, &data.to_csv(), &PRIOR).status.code(), Some(0));
    assert_eq!(dbbd(at, &["export", "out", "--for", "urdf", "--out", "back"]).status.code(), Some(0));
    fs::copy(at.join("back/robot-identified.urdf"), at.join("arm.urdf")).unwrap();
    assert_eq!(warned(), [false; 6]);
    // Sorted lengths at the same poses fit no robot.
    let mut sorted = data.clone();
    let mut lengths: Vec<f64> = data.rows.iter().map(|row| row.length_mm).collect();
    lengths.sort_by(f64::total_cmp);
    sorted.rows.iter_mut().zip(lengths).for_each(|(row, length_mm)| row.length_mm = length_mm);
    let poor = identify(at, &sorted.to_csv(), &PRIOR);
    says(&poor, 3, "W1333");
    let file: toml::Table = fs::read_to_string(at.join(robot)).unwrap().parse().unwrap();
    let warnings: Vec<&str> =
        file["warnings"].as_array().unwrap().iter().map(|code| code.as_str().unwrap()).collect();
    let said = codes(&poor);
    assert!(warnings.contains(&"W1333") && warnings.iter().all(|code| said.contains(&(*code).to_owned())));
    let result: Value =
        serde_json::from_str(&fs::read_to_string(at.join("out/result.json")).unwrap()).unwrap();
    let of_result =
        result["findings"].as_array().unwrap().iter().filter(|found| found["severity"] == "warning");
    assert!(of_result.into_iter().all(|found| warnings.contains(&found["code"].as_str().unwrap())));
    assert_eq!(warned(), [true; 6]);
    assert_eq!(dbbd(at, &["robots", "check", robot]).status.code(), Some(3));
    // More lengths are the cure.
    let plan = dbbd(at, &["plan", "job.toml", "--robot", robot, "--out", "second"]);
    assert!(!codes(&plan).contains(&"W1843".to_owned()), "{}", stderr(&plan));
}

#[test]
fn export_takes_a_robot_or_a_capture() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    fs::copy(RUN, at.join("run.dbbd")).unwrap();
    fs::write(at.join("robot.toml"), crate::cell::KR60HA).unwrap();
    for robot in ["robot.toml", "kr60ha"] {
        says(&dbbd(at, &["export", robot, "--out", "e"]), 1, "E1724");
    }
    says(&dbbd(at, &["export", "run.dbbd", "--urdf-in", "arm.urdf", "--out", "e"]), 1, "E1724");
    says(&dbbd(at, &["export", "run.dbbd", "--for", "kuka", "--out", "e"]), 1, "E1724");
    assert!(!at.join("e").exists());
    // Inputs of another kind.
    fs::write(at.join("job.toml"), JOB).unwrap();
    says(&dbbd(at, &["export", "job.toml", "--out", "e"]), 1, "E0405");
}

#[test]
fn column_names_and_whole_numbers() {
    let (dir, data) = cell();
    let at = dir.path();
    let table = data.to_csv();
    let (header, rows) = table.split_once('\n').unwrap();
    // An optional column in other upper and lower case is not ignored.
    for (from, to) in [("sigma_mm", "Sigma_mm"), ("length_mm", "LENGTH_MM")] {
        let other = format!("{}\n{rows}", header.replacen(from, to, 1));
        says(&identify(at, &other, &PRIOR), 1, "E0110");
    }
    // Whole numbers as written by programs that read a column with an empty cell as floats.
    let senses = ["1.0", "-1.0", "0.0", "", "1", "0"];
    let lines = rows.lines().map(|row| {
        let (index, rest) = row.split_once(',').unwrap();
        format!("{index}.0,{rest},{}\n", senses.join(","))
    });
    let names: Vec<String> = (1..=6).map(|axis| format!("approach{axis}")).collect();
    let floats = format!("{header},{}\n{}", names.join(","), lines.collect::<String>());
    let output = identify(at, &floats, &PRIOR);
    assert_ne!(output.status.code(), Some(1), "{}", stderr(&output));
    for (from, to) in [(",1.0,", ",1.5,"), (".0,", ".5,")] {
        assert_eq!(identify(at, &floats.replacen(from, to, 1), &PRIOR).status.code(), Some(1), "{to}");
    }
}

/// The angles of both directions, with a column of temperatures if `temp_c` gives one.
fn circle(at: &Path, ccw: &[f64], cw: &[f64], temp_c: &dyn Fn(usize) -> Option<f64>) {
    let form = |deg: f64| 0.3 * (2.0 * deg.to_radians()).cos() + 0.1 * (3.0 * deg.to_radians()).sin();
    let noise = |place: usize| 0.001 * (((place as f64 * 12.9898).sin() * 43758.5453).fract());
    let all = ccw.iter().map(|deg| ("ccw", deg)).chain(cw.iter().map(|deg| ("cw", deg)));
    let rows = all.enumerate().map(|(place, (direction, deg))| {
        let temp_c = temp_c(place).map_or(String::new(), |celsius| celsius.to_string());
        format!("1,{direction},{deg},{},{temp_c}\n", 300.0 + form(*deg) + noise(place))
    });
    let rows: String = rows.collect();
    fs::write(at.join("c.csv"), format!("run,direction,angle_deg,length_mm,temp_c\n{rows}")).unwrap();
}

fn evaluated(at: &Path, more: &[&str]) -> Output {
    dbbd(at, &[&["circle", "c.csv", "--radius", "300", "--out", "q"], more].concat())
}

#[test]
fn directions_of_a_circle() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    let there: Vec<f64> = (0..72).map(|point| f64::from(5 * point)).collect();
    let back: Vec<f64> = there.iter().rev().copied().collect();
    let file =
        || -> Value { serde_json::from_str(&fs::read_to_string(at.join("q/circle.json")).unwrap()).unwrap() };
    let refused = |refused: bool| {
        let file = file();
        for key in ["Gb", "H", "squareness_rad"] {
            assert_eq!(file[key].is_null(), refused, "{key}");
        }
        assert!(file["G_lsc"].is_number() && file["F_max"].is_number());
    };
    circle(at, &there, &back, &|_| None);
    let sound = evaluated(at, &[]);
    assert_eq!(sound.status.code(), Some(0), "{}", stderr(&sound));
    refused(false);
    // Cut off after a quarter of the second direction, which passes its start.
    let cut: Vec<f64> = (0..18).map(|point| (40.0 - 5.0 * f64::from(point)).rem_euclid(360.0)).collect();
    circle(at, &there, &cut, &|_| None);
    says(&evaluated(at, &[]), 3, "W1482");
    refused(true);
    // The few points of one direction may lie between those of the other.
    let few = |from: f64| -> Vec<f64> { (0..6).map(|point| from + 60.0 * f64::from(point)).collect() };
    let between: Vec<f64> = few(30.0).into_iter().rev().collect();
    circle(at, &few(0.0), &between, &|_| None);
    assert_eq!(evaluated(at, &[]).status.code(), Some(0));
    refused(false);
    // Both directions under one name.
    for wrong in [[&there[..], &back[..40]].concat(), [&there[..40], &back[..]].concat()] {
        circle(at, &wrong, &[], &|_| None);
        says(&evaluated(at, &[]), 3, "W1482");
    }
}

#[test]
fn options_of_a_circle() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    let there: Vec<f64> = (0..72).map(|point| f64::from(5 * point)).collect();
    let warm: [&[&str]; 2] =
        [&["--expansion", "12e-6", "--certified", "22"], &["--machine-expansion", "12e-6"]];
    circle(at, &there, &[], &|_| Some(24.0));
    for options in warm {
        assert_eq!(evaluated(at, options).status.code(), Some(0));
    }
    says(&evaluated(at, &["--certified", "22"]), 1, "E1481");
    // A single length without a temperature prevents the correction.
    circle(at, &there, &[], &|place| (place != 9).then_some(24.0));
    for options in warm {
        says(&evaluated(at, options), 1, "E1481");
    }
    // A form deviation of some tenths of a millimetre is not noise of the lengths.
    assert_eq!(evaluated(at, &["--sigma", "0.0005"]).status.code(), Some(0));
    for sigma in ["0.5", "5e-6"] {
        says(&evaluated(at, &["--sigma", sigma]), 3, "W1482");
    }
}
