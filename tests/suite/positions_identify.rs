//! Positions of a tracker identify a robot, alone and with lengths; contradictions are found.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use dbbd_job::sim::truth;
use dbbd_model::estimation::CalibrationResult;
use dbbd_model::math::aligned_distances;
use dbbd_model::measurement::Tracker;
use dbbd_model::robot::{Geometry, Robot};
use nalgebra::{Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;
use tempfile::tempdir;

use crate::cell::{dbbd, kr60, stderr};

const BALLS: [[f64; 3]; 2] = [[1300.0, 0.0, 400.0], [900.0, 800.0, 700.0]];
const CENTRES: &str = "centre,x_mm,y_mm,z_mm\n1,1303,-5,398\n2,905,806,693\n";
const LENGTHS: &str = "index,centre,a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg,length_mm,sigma_mm\n";
const POSITIONS: &str = "a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg,x_mm,y_mm,z_mm,sigma_mm,target\n";
/// A second target in the flange frame.
const FURTHER: [f64; 3] = [-90.0, 60.0, 180.0];

fn tracker() -> Tracker {
    Tracker { origin: Vector3::new(-2500.0, 1800.0, 900.0), turn: Vector3::new(0.7, -1.1, 2.2) }
}

fn poses(count: usize, seed: u64) -> Vec<[f64; 6]> {
    let mut random = Pcg64::seed_from_u64(seed);
    let ranges =
        [[-70.0, 70.0], [-110.0, -40.0], [60.0, 130.0], [-90.0, 90.0], [-90.0, 90.0], [-120.0, 120.0]];
    (0..count).map(|_| ranges.map(|[low, high]| random.random_range(low..high))).collect()
}

fn cells(axes: &[f64; 6]) -> String {
    axes.map(|deg| deg.to_string()).join(",")
}

fn ball(geometry: &Geometry, axes: &[f64; 6]) -> Vector3<f64> {
    geometry.ball(&axes.map(f64::to_radians)).position
}

/// Positions of so many targets with this noise, mm.
fn positions(truth: &Robot, poses: &[[f64; 6]], targets: usize, noise_mm: f64) -> String {
    let mut random = Pcg64::seed_from_u64(5);
    let mut text = POSITIONS.to_owned();
    for axes in poses {
        for target in 0..targets {
            let mut arm = truth.geometry.clone();
            if target == 1 {
                arm.tool = FURTHER.into();
            }
            let turned = Rotation3::new(tracker().turn).inverse() * (ball(&arm, axes) - tracker().origin);
            let [x, y, z] =
                [0, 1, 2].map(|axis| turned[axis] + noise_mm * random.sample::<f64, _>(StandardNormal));
            let sigma_mm = noise_mm.max(0.001);
            writeln!(text, "{},{x},{y},{z},{sigma_mm},{}", cells(axes), target + 1).unwrap();
        }
    }
    text
}

fn lengths(truth: &Robot, poses: &[[f64; 6]], noise_mm: f64) -> String {
    let mut random = Pcg64::seed_from_u64(6);
    let mut text = LENGTHS.to_owned();
    for (at, axes) in poses.iter().enumerate() {
        let length = (ball(&truth.geometry, axes) - Vector3::from(BALLS[at % 2])).norm();
        let length = length + noise_mm * random.sample::<f64, _>(StandardNormal);
        writeln!(text, "{},{},{},{length},{noise_mm}", at + 1, at % 2 + 1, cells(axes)).unwrap();
    }
    text
}

/// Runs `identify` in a directory with `--out o`; its exit code and the result.
fn identify(at: &Path, arguments: &[&str]) -> (Option<i32>, Option<CalibrationResult>, String) {
    let output = dbbd(
        at,
        &[&["identify"], arguments, &["--robot", "kr60ha", "--tool", "30,20,10", "--out", "o"]].concat(),
    );
    let result = fs::read_to_string(at.join("o/result.json")).ok();
    (output.status.code(), result.map(|text| serde_json::from_str(&text).unwrap()), stderr(&output))
}

/// The largest 3-D error of the identified robot at other poses, mm.
fn error_mm(at: &Path, truth: &Robot) -> f64 {
    let file = at.join("o/robot-identified.toml");
    let found = Robot::from_toml(file.to_str().unwrap(), &fs::read_to_string(&file).unwrap()).unwrap();
    let set =
        |robot: &Robot| poses(100, 77).iter().map(|axes| ball(&robot.geometry, axes)).collect::<Vec<_>>();
    aligned_distances(&set(truth), &set(&found)).into_iter().fold(0.0, f64::max)
}

/// Positions by a tracker that is `off_mm` from where it was at a row.
pub(crate) fn moved_tracker(off_mm: impl Fn(usize) -> f64) -> String {
    let text = positions(&truth(), &poses(70, 4), 1, 0.02);
    let row = |(at, line): (usize, &str)| {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        if at > 0 {
            cells[7] = (cells[7].parse::<f64>().unwrap() + off_mm(at)).to_string();
        }
        cells.join(",") + "\n"
    };
    text.lines().enumerate().map(row).collect()
}

fn truth() -> Robot {
    truth::draw_true_robot(&kr60(), 3, 0.5)
}

#[test]
fn exact_positions_identify_robot_and_targets() {
    let (dir, truth) = (tempdir().unwrap(), truth());
    let at = dir.path();
    fs::write(at.join("p.csv"), positions(&truth, &poses(60, 1), 2, 0.0)).unwrap();
    let (code, result, said) = identify(at, &["p.csv", "--model", "geometric", "--prior", "none"]);
    let result = result.unwrap();
    assert_eq!(code, Some(0), "{said}");
    let made_from = result.made_from;
    assert_eq!((made_from.lengths, made_from.positions, made_from.targets), (0, 120, 2));
    assert!(error_mm(at, &truth) < 1e-4, "{}", error_mm(at, &truth));
    // The second target has its true place relative to the first.
    let value =
        |name: &str| result.parameters.iter().find(|p| p.name.to_string() == name).unwrap().identified;
    let place = |stem: &str| Vector3::from(["x", "y", "z"].map(|axis| value(&format!("{stem}_{axis}"))));
    let apart = (place("target2") - place("tool")).norm();
    assert!((apart - (Vector3::from(FURTHER) - truth.geometry.tool).norm()).abs() < 1e-4);
    // The used positions are written as they were read.
    let written = fs::read_to_string(at.join("o/positions.csv")).unwrap();
    assert_eq!(written.lines().count(), 121);
    assert!(!at.join("o/lengths.csv").exists());
}

#[test]
fn positions_with_lengths_lower_the_error() {
    let (dir, truth) = (tempdir().unwrap(), truth());
    let at = dir.path();
    fs::write(at.join("l.csv"), lengths(&truth, &poses(40, 1), 0.01)).unwrap();
    fs::write(at.join("p.csv"), positions(&truth, &poses(40, 2), 1, 0.03)).unwrap();
    fs::write(at.join("C.csv"), CENTRES).unwrap();
    let plain = ["--model", "geometric", "--prior", "datasheet", "--folds", "0"];
    let runs: [&[&str]; 3] = [
        &["l.csv", "--centres", "C.csv"],
        &["p.csv"],
        &["l.csv", "--centres", "C.csv", "--positions", "p.csv"],
    ];
    let [alone, tracked, both] = runs.map(|input| {
        let (code, result, said) = identify(at, &[input, &plain].concat());
        assert!(matches!(code, Some(0 | 3)), "{said}");
        (error_mm(at, &truth), result.unwrap())
    });
    assert_eq!((both.1.made_from.lengths, both.1.made_from.positions), (40, 40));
    assert!(both.0 < alone.0 && both.0 < 1.2 * tracked.0, "{} {} {}", alone.0, tracked.0, both.0);
    // Weighted by their own noise, both fit one robot.
    assert!(both.1.findings.iter().all(|warning| warning.code() != "W1362"));
}

/// Two draw-wire sensors with zeros of their own, their wires hooked to three places of the tool in turn.
#[test]
fn wires_to_several_hooks() {
    const HOOKS: [[f64; 3]; 2] = [[-90.0, 60.0, 180.0], [60.0, -80.0, 120.0]];
    const ZERO_MM: [f64; 2] = [0.21, -0.15];
    let (dir, truth) = (tempdir().unwrap(), truth());
    let at = dir.path();
    let mut random = Pcg64::seed_from_u64(8);
    let arms = [truth.geometry.tool, HOOKS[0].into(), HOOKS[1].into()];
    let arms = arms.map(|tool| Geometry { tool, ..truth.geometry.clone() });
    let mut text = LENGTHS.trim_end().to_owned() + ",bar,target\n";
    for (row, axes) in poses(120, 1).iter().enumerate() {
        let (wire, hook) = (row % 2, row / 2 % 3);
        let length = (ball(&arms[hook], axes) - Vector3::from(BALLS[wire])).norm() + ZERO_MM[wire];
        let length = length + 0.02 * random.sample::<f64, _>(StandardNormal);
        let cells = cells(axes);
        writeln!(text, "{},{},{cells},{length},0.02,{},{}", row + 1, wire + 1, wire + 1, hook + 1).unwrap();
    }
    fs::write(at.join("l.csv"), text).unwrap();
    fs::write(at.join("C.csv"), CENTRES).unwrap();
    let plain = ["--model", "geometric", "--prior", "datasheet", "--bar-u", "0.5", "--folds", "0"];
    let (code, result, said) = identify(at, &[&["l.csv", "--centres", "C.csv"][..], &plain].concat());
    assert!(matches!(code, Some(0 | 3)), "{said}");
    let result = result.unwrap();
    assert_eq!((result.made_from.lengths, result.made_from.targets), (120, 3));
    let value = |name: &str| result.parameters.iter().find(|p| p.name.to_string() == name).unwrap();
    let place =
        |stem: &str| Vector3::from(["x", "y", "z"].map(|axis| value(&format!("{stem}_{axis}")).identified));
    for (stem, hook) in ["target2", "target3"].into_iter().zip(HOOKS) {
        let apart = (place(stem) - place("tool")).norm();
        let off = apart - (Vector3::from(hook) - truth.geometry.tool).norm();
        assert!(off.abs() < 0.3, "{stem} {off}");
    }
    let set =
        |robot: &Robot| poses(100, 77).iter().map(|axes| ball(&robot.geometry, axes)).collect::<Vec<_>>();
    let before = aligned_distances(&set(&truth), &set(&kr60())).into_iter().fold(0.0, f64::max);
    assert!(error_mm(at, &truth) < 0.3 * before, "{} of {before}", error_mm(at, &truth));
}

#[test]
fn a_wrong_coordinate_rejects_its_position() {
    let (dir, truth) = (tempdir().unwrap(), truth());
    let at = dir.path();
    let text = positions(&truth, &poses(50, 1), 1, 0.02);
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    let mut cells: Vec<String> = lines[20].split(',').map(str::to_owned).collect();
    cells[7] = (cells[7].parse::<f64>().unwrap() + 5.0).to_string();
    lines[20] = cells.join(",");
    fs::write(at.join("p.csv"), lines.join("\n")).unwrap();
    let (_, result, said) = identify(at, &["p.csv", "--model", "geometric", "--prior", "datasheet"]);
    let result = result.unwrap();
    assert_eq!((result.outliers.len(), result.made_from.positions), (1, 49), "{said}");
    assert_eq!((result.outliers[0].index, result.outliers[0].ball), (20, None));
    assert!((result.outliers[0].residual_mm - 5.0).abs() < 0.5);
}

/// The table p.csv, the arguments and the code of each case.
fn cases() -> Vec<(&'static str, String, Vec<&'static str>)> {
    let (truth, poses) = (truth(), poses(30, 1));
    let sound = positions(&truth, &poses, 1, 0.02);
    let changed = |change: &dyn Fn(&mut Vec<f64>)| {
        let mut text = POSITIONS.to_owned();
        for line in sound.lines().skip(1) {
            let mut numbers: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
            change(&mut numbers);
            writeln!(text, "{}", numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(",")).unwrap();
        }
        text
    };
    let metres = changed(&|row| row[6..9].iter_mut().for_each(|value| *value *= 1e-3));
    let radians = changed(&|row| row[..6].iter_mut().for_each(|value| *value = value.to_radians()));
    let mirrored = changed(&|row| row[7] = -row[7]);
    let gap = changed(&|row| row[10] = 3.0);
    let elsewhere = changed(&|row| row.swap(0, 2));
    let twice = format!("{sound}{}", &sound[POSITIONS.len()..]);
    let beside = vec!["l.csv", "--centres", "C.csv", "--positions", "p.csv"];
    vec![
        ("E1204", metres.clone(), vec!["p.csv"]),
        ("E1204", metres, beside.clone()),
        ("E1204", radians, vec!["p.csv"]),
        ("E1360", mirrored, vec!["p.csv"]),
        ("E1360", elsewhere, vec!["p.csv"]),
        ("E1202", gap, vec!["p.csv"]),
        ("E1361", sound.clone(), vec!["p.csv", "--positions", "p.csv"]),
        ("E1203", sound.clone(), vec!["l.csv", "--centres", "C.csv", "--validate", "p.csv"]),
        ("E0502", sound.clone(), vec!["p.csv", "--hold", "target2_x"]),
        ("W1209", twice, vec!["p.csv"]),
        ("W1362", positions(&truth::draw_true_robot(&kr60(), 9, 1.0), &poses, 1, 0.02), beside),
    ]
}

#[test]
fn contradictory_inputs_are_found() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    fs::write(at.join("l.csv"), lengths(&truth(), &poses(60, 4), 0.01)).unwrap();
    fs::write(at.join("C.csv"), CENTRES).unwrap();
    for (code, table, arguments) in cases() {
        fs::write(at.join("p.csv"), table).unwrap();
        let options = ["--model", "geometric", "--prior", "datasheet", "--folds", "0"];
        let (exit, _, said) = identify(at, &[&arguments[..], &options].concat());
        assert!(said.contains(code), "{code}: {arguments:?}: {said}");
        assert_eq!(exit, Some(if code.starts_with('E') { 1 } else { 3 }), "{code}: {said}");
    }
    let (_, result, said) = identify(at, &["l.csv", "--centres", "C.csv", "--folds", "0"]);
    assert!(result.is_some(), "{said}");
    let check = dbbd(at, &["check", "p.csv", "--robot", "o", "--centres", "C.csv", "--out", "c"]);
    assert!(stderr(&check).contains("E1361"), "{}", stderr(&check));
}
