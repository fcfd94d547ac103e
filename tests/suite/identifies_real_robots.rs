//! Real robots, measured by a laser tracker and a draw-wire sensor. The measurements of UR5 and UR10 are part of the project.
//! Those of KR 60 and IRB 120 have no licence and are not: tests of these are ignored, and fail where the data are missing.

use std::fs;
use std::path::{Path, PathBuf};

use dbbd_model::estimation::CalibrationResult;
use dbbd_model::estimation::result::Status;
use dbbd_model::robot::ParamUnit;
use tempfile::tempdir;

use crate::cell::{codes, dbbd, stderr};

/// Measurements that are not part of the project, in the directory that `DBBD_SHARED` names, or beside the checkout.
pub(crate) fn data(name: &str) -> PathBuf {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared");
    let path = std::env::var_os("DBBD_SHARED").map_or_else(beside, PathBuf::from).join("data").join(name);
    assert!(path.is_file(), "{} is not there: DBBD_SHARED names its directory", path.display());
    path
}

fn identify(dir: &Path, data: &Path, args: &[&str]) -> (CalibrationResult, String) {
    let mut all = vec!["identify", data.to_str().unwrap(), "--centres", "C.csv", "--out", "out"];
    all.extend(args);
    let output = dbbd(dir, &all);
    assert!(matches!(output.status.code(), Some(0 | 3)), "{}", stderr(&output));
    let result = fs::read_to_string(dir.join("out/result.json")).unwrap();
    (serde_json::from_str(&result).unwrap(), stderr(&output))
}

/// Base balls as a user would tape them, true to 10 mm, moved off by up to 50 mm more.
const TAPED: &str = "centre,x_mm,y_mm,z_mm\n1,300,-1530,500\n2,720,-1600,1080\n3,390,-960,1190\n";

#[test]
#[ignore = "needs data that are not part of the project: .ci/night"]
fn three_balls_give_small_residuals_and_plausible_corrections() {
    let data = data("kr60/three_balls.csv");
    let dir = tempdir().unwrap();
    fs::write(dir.path().join("C.csv"), TAPED).unwrap();
    let (result, _) =
        identify(dir.path(), &data, &["--robot", "kr60ha", "--tool", "30,-40,134", "--prior", "datasheet"]);
    assert!((result.residual_mm.before.rms - 0.27).abs() < 0.01);
    assert!(result.residual_mm.after.rms < 0.07, "{}", result.residual_mm.after.rms);
    assert!(result.folds.unwrap().rms < 0.075);
    let corrections = result.parameters.iter().filter(|p| {
        p.unit == ParamUnit::Mm
            && !p.name.to_string().starts_with("centre")
            && !p.name.to_string().starts_with("tool")
    });
    assert!(corrections.clone().all(|p| p.correction.abs() < 2.0), "{:?}", corrections.collect::<Vec<_>>());
    // What leans on the balls' places alone stays; what is told of a sum is shared.
    assert!(result.parameters.iter().any(|p| p.status == Status::Dependent));
    let shared = result.parameters.iter().find(|p| p.name.to_string() == "d3").unwrap();
    assert!(shared.status == Status::SupportedByPrior && shared.correction != 0.0, "{shared:?}");
}

#[test]
#[ignore = "needs data that are not part of the project: .ci/night"]
fn one_ball_does_not_determine_the_position() {
    let data = data("kr60/one_ball.csv");
    let dir = tempdir().unwrap();
    fs::write(dir.path().join("C.csv"), "centre,x_mm,y_mm,z_mm\n1,270,-1490,530\n").unwrap();
    let (result, said) =
        identify(dir.path(), &data, &["--robot", "kr60ha", "--tool", "0,0,104", "--prior", "datasheet"]);
    assert!(result.residual_mm.after.rms < 0.07);
    assert!(said.contains("W1319"), "{said}");
}

/// The gearless table of an ABB IRB 120 from its drawing; the tolerance is what uncalibrated ones
/// of its kind show: some 3 mm of mean position error.
const IRB120: &str = r#"
name = "ABB IRB 120"
convention = "modified-dh"
joint = [
  { alpha_deg = 0, a_mm = 0, theta_offset_deg = 0, d_mm = 290, sign = 1, limits_deg = [-165, 165], max_speed_deg_s = 250 },
  { alpha_deg = -90, a_mm = 0, theta_offset_deg = -90, d_mm = 0, sign = 1, limits_deg = [-110, 110], max_speed_deg_s = 250 },
  { alpha_deg = 0, a_mm = 270, theta_offset_deg = 0, d_mm = 0, sign = 1, limits_deg = [-110, 70], max_speed_deg_s = 250 },
  { alpha_deg = -90, a_mm = 70, theta_offset_deg = 0, d_mm = 302, sign = 1, limits_deg = [-160, 160], max_speed_deg_s = 320 },
  { alpha_deg = 90, a_mm = 0, theta_offset_deg = 0, d_mm = 0, sign = 1, limits_deg = [-120, 120], max_speed_deg_s = 320 },
  { alpha_deg = -90, a_mm = 0, theta_offset_deg = 180, d_mm = 72, sign = 1, limits_deg = [-400, 400], max_speed_deg_s = 420 },
]
[tool]
ball_mm = [7, -2, 48]
[tolerance]
length_mm = 1.0
angle_deg = 0.1
"#;

#[test]
#[ignore = "needs data that are not part of the project: .ci/night"]
fn draw_wire_lengths_of_clustered_poses() {
    let data = data("irb120_drawwire/lengths.csv");
    let dir = tempdir().unwrap();
    fs::write(dir.path().join("irb120.toml"), IRB120).unwrap();
    fs::write(dir.path().join("C.csv"), "centre,x_mm,y_mm,z_mm\n1,220,-470,-40\n").unwrap();
    let (result, said) =
        identify(dir.path(), &data, &["--robot", "irb120.toml", "--prior", "datasheet", "--folds", "5"]);
    assert!(result.folds.unwrap().rms < 0.35, "{:?}", result.folds);
    assert!(said.contains("W1319"), "{said}");
    // With `--prior none`, what the clustered poses cannot carry has the tolerance instead of running away.
    let (result, _) = identify(dir.path(), &data, &["--robot", "irb120.toml", "--prior", "none"]);
    let robots_own = result.parameters.iter().filter(|p| {
        p.status == Status::Identified
            && p.unit == ParamUnit::Mm
            && p.name.to_string().starts_with(['a', 'd'])
    });
    assert!(robots_own.clone().all(|p| p.correction.abs() < 3.0), "{:?}", robots_own.collect::<Vec<_>>());
    assert!(result.parameters.iter().any(|p| p.status == Status::SupportedByPrior));
}

/// A third of the poses is the check of a calibration by the others: it passes, and finds a joint whose angles are off.
#[test]
#[ignore = "needs data that are not part of the project: .ci/night"]
fn a_check_of_the_real_robot_passes_and_finds_a_moved_joint() {
    let data = data("kr60/three_balls.csv");
    let dir = tempdir().unwrap();
    let at = dir.path();
    fs::write(at.join("C.csv"), TAPED).unwrap();
    let text = fs::read_to_string(data).unwrap();
    let (header, rows) = text.split_once('\n').unwrap();
    let pose = |row: &str| row.split(',').skip(2).take(6).map(str::to_owned).collect::<Vec<_>>();
    let mut poses: Vec<Vec<String>> = Vec::new();
    let (mut calibration, mut check, mut moved) = (header.to_owned(), header.to_owned(), header.to_owned());
    for row in rows.lines() {
        let known = poses.iter().position(|known| *known == pose(row));
        let number = known.unwrap_or_else(|| {
            poses.push(pose(row));
            poses.len() - 1
        });
        if number % 3 != 0 {
            calibration += &format!("\n{row}");
            continue;
        }
        check += &format!("\n{row}");
        let mut cells: Vec<String> = row.split(',').map(str::to_owned).collect();
        cells[4] = (cells[4].parse::<f64>().unwrap() + 0.02).to_string();
        moved += &format!("\n{}", cells.join(","));
    }
    for (name, text) in [("calibration.csv", &calibration), ("check.csv", &check), ("moved.csv", &moved)] {
        fs::write(at.join(name), text).unwrap();
    }
    identify(at, &at.join("calibration.csv"), &["--robot", "kr60ha", "--tool", "0,0,104"]);
    let run = |lengths: &str| {
        let robot = ["check", lengths, "--robot", "out/robot-identified.toml", "--centres", "C.csv"];
        let output = dbbd(at, &[&robot[..], &["--out", "check", "--bar-u", "0.001"]].concat());
        let found: serde_json::Value =
            serde_json::from_str(&fs::read_to_string(at.join("check/check.json")).unwrap()).unwrap();
        (output.status.code(), found)
    };
    let (code, found) = run("check.csv");
    assert_eq!(code, Some(0), "{found}");
    let (code, found) = run("moved.csv");
    let likeliest = &found["changes"][0];
    assert_eq!((code, &likeliest["parameters"][0]), (Some(4), &"theta3".into()), "{found}");
    // The controller's angles are 0.02 degrees too large: the offset is that much smaller.
    let [change, sd] = ["change", "sd"].map(|key| likeliest[key][0].as_f64().unwrap().to_degrees());
    assert!((change + 0.02).abs() < 3.0 * sd && sd < 0.01, "{change} {sd}");
}

/// The mean 3-D error at the kept poses was 0.0511 mm (UR5, 20 poses) and 0.0942 mm (UR10, 2464 poses). For the UR5 another
/// method is published: 0.1549 mm. The target of the UR5 seems to move early in the series (W1331).
#[test]
fn the_demo_of_real_robots_is_as_accurate_as_stated() {
    let dir = tempdir().unwrap();
    for (robot, warnings, kept_poses, mean_mm) in
        [("ur5", vec!["W1331"], 20, 0.0511), ("ur10", vec![], 2464, 0.0942)]
    {
        let output = dbbd(dir.path(), &["demo", "--real", robot, "--json"]);
        let said = codes(&output).into_iter().filter(|code| code.starts_with('W')).collect::<Vec<_>>();
        assert_eq!(said, warnings, "{}", stderr(&output));
        assert_eq!(output.status.code(), Some(if warnings.is_empty() { 0 } else { 3 }));
        let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let value = |key: &str| found[key].as_f64().unwrap();
        assert_eq!(found["kept_poses"], kept_poses);
        assert!(value("mean_mm") < 1.1 * mean_mm, "{found}");
        let ratio = value("predicted_rms_mm") / value("rms_mm");
        assert!((0.6..1.5).contains(&ratio), "{ratio} {found}");
        let published = &found["published"]["after_mm"];
        assert!(published.as_f64().is_none_or(|published| value("mean_mm") < published), "{found}");
        let licence = dir.path().join("demo-out").join(robot).join("LICENSE");
        assert!(fs::read_to_string(licence).unwrap().contains("MIT License"));
    }
}
