//! Errors of the joints: found by the evidence where they are, not where they are not, and predicted.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use dbbd_job::sim::truth;
use dbbd_model::math::aligned_distances;
use dbbd_model::measurement::{Datum, Measurement, Measurements, TargetId};
use dbbd_model::robot::{
    Approach, AxisAngles, BallId, BarId, Joint, JointErrorModel, JointErrors, PayloadId, Ripple, Robot,
    SmoothJointError,
};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;
use tempfile::tempdir;

use crate::cell::{dbbd, kr60, stderr};

const BALLS: [[f64; 3]; 3] = [[1300.0, 0.0, 400.0], [900.0, 800.0, 700.0], [1100.0, -700.0, 1000.0]];
const SIGMA_MM: f64 = 0.01;
/// Half of the reversal error of axis 1, rad.
const BACKLASH: f64 = 8e-5;

/// A robot within its tolerance, its joints with backlash, a smooth error and ripple.
fn with_joint_errors(seed: u64) -> Robot {
    let mut robot = truth::draw_true_robot(&kr60(), seed, 0.5);
    let mut joints = [(); 6].map(|()| JointErrorModel::default());
    joints[0].backlash = BACKLASH;
    joints[0].smooth =
        SmoothJointError { centre: 0.0, half_width: 3.3, coefficients: vec![0.0, 0.0, 0.0, 1.5e-4, -1e-4] };
    joints[1].smooth =
        SmoothJointError { centre: -0.9, half_width: 2.2, coefficients: vec![0.0, 0.0, 1e-4, -1e-4] };
    joints[2].ripple = vec![Ripple { order: 11, cos: 4e-5, sin: 3e-5 }];
    robot.geometry.joint_errors = JointErrors::new(joints);
    robot
}

/// Lengths to all balls at random poses in the order of the seed.
fn lengths(truth: &Robot, poses: usize, seed: u64) -> Measurements {
    lengths_with(truth, poses, seed, |_| None)
}

/// As [`lengths`], with axis 1 at the angle (degrees) that `first` has for the number of a pose.
fn lengths_with(
    truth: &Robot,
    poses: usize,
    seed: u64,
    first: impl Fn(usize) -> Option<f64>,
) -> Measurements {
    let mut random = Pcg64::seed_from_u64(seed);
    let ranges =
        [[-70.0, 70.0], [-110.0, -40.0], [60.0, 130.0], [-90.0, 90.0], [-90.0, 90.0], [-120.0, 120.0]];
    let mut axes_deg: Vec<[f64; 6]> =
        (0..poses).map(|_| ranges.map(|[low, high]| random.random_range(low..high))).collect();
    for (pose, axes) in axes_deg.iter_mut().enumerate() {
        axes[0] = first(pose).unwrap_or(axes[0]);
    }
    let radians = |axes: &[f64; 6]| axes.map(f64::to_radians);
    let approaches: Vec<Approach> = Approach::along(axes_deg.iter().map(radians)).collect();
    let mut rows = Vec::new();
    for (axes, approach) in axes_deg.iter().zip(approaches) {
        for (ball, place) in BALLS.into_iter().enumerate() {
            let there = truth.geometry.approached(approach);
            let noise: f64 = random.sample(StandardNormal);
            rows.push(Measurement {
                index: rows.len() as u32 + 1,
                datum: Datum::Ball(BallId::at(ball), BarId::FIRST),
                target: TargetId::FIRST,
                axes: AxisAngles::from_degrees(*axes),
                approach,
                length_mm: there.length(&radians(axes), &Vector3::from(place), 0.0) + SIGMA_MM * noise,
                sigma_mm: Some(SIGMA_MM),
                payload: PayloadId::FIRST,
                context: None,
            });
        }
    }
    Measurements { rows, ..Measurements::default() }
}

/// The result of `identify` on lengths, and where its files are.
fn identify(dir: &Path, data: &Measurements, more: &[&str]) -> serde_json::Value {
    fs::write(dir.join("obs.csv"), data.to_csv()).unwrap();
    let mut centres = String::from("centre,x_mm,y_mm,z_mm\n");
    for (at, [x, y, z]) in BALLS.into_iter().enumerate() {
        writeln!(centres, "{},{},{},{}", at + 1, x + 3.0, y - 2.0, z + 1.0).unwrap();
    }
    fs::write(dir.join("c.csv"), centres).unwrap();
    let given = [
        "identify",
        "obs.csv",
        "--robot",
        "kr60ha",
        "--tool",
        "30,20,10",
        "--centres",
        "c.csv",
        "--out",
        "out",
        "--folds",
        "0",
    ];
    let output = dbbd(dir, &[&given[..], more].concat());
    assert!(matches!(output.status.code(), Some(0 | 3)), "{}", stderr(&output));
    serde_json::from_str(&fs::read_to_string(dir.join("out/result.json")).unwrap()).unwrap()
}

/// Nine of ten poses have axis 1 at one angle: what `identify` writes, the other commands read.
#[test]
fn a_robot_of_poses_at_one_angle_is_read_back() {
    let dir = tempdir().unwrap();
    let truth = with_joint_errors(3);
    let data = lengths_with(&truth, 60, 3, |pose| (pose % 10 > 0).then_some(45.0));
    identify(dir.path(), &data, &["--quiet"]);
    let read = dbbd(dir.path(), &["info", "out/robot-identified.toml"]);
    assert!(matches!(read.status.code(), Some(0 | 3)), "{}", stderr(&read));
    let text = fs::read_to_string(dir.path().join("out/robot-identified.toml")).unwrap();
    assert!(text.contains("[joint.smooth]"), "the robot has no errors of joints");
}

#[test]
fn backlash_of_unknown_sense_is_noise_of_its_joint() {
    let dir = tempdir().unwrap();
    let mut data = lengths(&with_joint_errors(3), 70, 1);
    data.rows.iter_mut().for_each(|row| row.approach = Approach::default());
    let result = identify(dir.path(), &data, &[]);
    let noise: Vec<f64> =
        serde_json::from_value(result["joint_errors"]["backlash_noise_rad"].clone()).unwrap();
    assert!((noise[0] / BACKLASH - 1.0).abs() < 0.3, "{noise:?}");
    assert!(noise[1..].iter().all(|sd| *sd < 0.5 * BACKLASH), "{noise:?}");
}

#[test]
fn errors_of_joints_are_found_and_predicted() {
    let truth = with_joint_errors(3);
    let dir = tempdir().unwrap();
    let result = identify(dir.path(), &lengths(&truth, 70, 1), &[]);
    let group = |name: &str| {
        let groups = result["groups"].as_array().unwrap();
        groups
            .iter()
            .find(|group| group["name"] == name)
            .unwrap_or_else(|| panic!("{name}: {groups:?}"))
            .clone()
    };
    assert!(group("backlash")["effective_parameters"].as_f64().unwrap() > 0.8);
    assert!(group("smooth")["share"].as_f64().unwrap() > 0.05);
    let text = fs::read_to_string(dir.path().join("out/robot-identified.toml")).unwrap();
    let found = Robot::from_toml("robot-identified.toml", &text).unwrap();
    let backlash = found.geometry.joint_errors.of(Joint::J1).unwrap().backlash;
    assert!((backlash - BACKLASH).abs() < 0.2 * BACKLASH, "{backlash}");
    // Poses that the fit did not see, by rising and falling angles.
    let unseen = lengths(&truth, 40, 2);
    fs::write(dir.path().join("axes.csv"), unseen.to_csv()).unwrap();
    let arguments = ["predict", "axes.csv", "--robot", "out/robot-identified.toml", "--out", "p.csv"];
    let output = dbbd(dir.path(), &arguments);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let mut table = csv::Reader::from_path(dir.path().join("p.csv")).unwrap();
    let names: Vec<String> = table.headers().unwrap().iter().map(str::to_owned).collect();
    let column = |name: &str| names.iter().position(|own| own == name).unwrap();
    let (mut predicted, mut balls, mut expected) = (Vec::new(), Vec::new(), 0.0);
    for (row, record) in unseen.rows.iter().zip(table.records().map(Result::unwrap)) {
        let number = |name: &str| record[column(name)].parse::<f64>().unwrap();
        predicted.push(Vector3::new(number("x_mm"), number("y_mm"), number("z_mm")));
        balls.push(truth.geometry.approached(row.approach).ball(&row.axes.radians()).position);
        expected += number("sd_mm").powi(2);
    }
    // Lengths do not determine where the base is.
    let squares: f64 = aligned_distances(&balls, &predicted).iter().map(|distance| distance.powi(2)).sum();
    let ratio = (expected / squares).sqrt();
    assert!((squares / unseen.rows.len() as f64).sqrt() < 0.12, "{squares}");
    assert!((0.3..3.0).contains(&ratio), "{ratio}");
}

#[test]
fn errors_of_joints_shrink_where_there_are_none() {
    let dir = tempdir().unwrap();
    let data = lengths(&truth::draw_true_robot(&kr60(), 5, 0.5), 40, 4);
    let result = identify(dir.path(), &data, &[]);
    let groups = result["groups"].as_array().unwrap();
    let of_joints = groups.iter().filter(|group| group["name"] != "tolerance" && group["name"] != "tool");
    for group in of_joints {
        assert!(group["rms_mm"].as_f64().unwrap() < 0.5 * SIGMA_MM, "{group}");
    }
    let geometric = identify(dir.path(), &data, &["--model", "geometric"]);
    assert!(geometric["joint_errors"].is_null() && geometric["model"] == "geometric");
    let mean = |result: &serde_json::Value| {
        result["predicted_position_uncertainty_mm"]["identified"]["mean"].as_f64().unwrap()
    };
    assert!(mean(&result) < 2.0 * mean(&geometric), "{} mm, {} mm", mean(&result), mean(&geometric));
}

#[test]
fn a_lost_zero_is_not_taken_for_errors_of_joints() {
    let dir = tempdir().unwrap();
    let mut data = lengths(&truth::draw_true_robot(&kr60(), 5, 0.5), 140, 4);
    data.rows.retain(|row| row.datum == Datum::Ball(BallId::FIRST, BarId::FIRST));
    for (index, row) in (1..).zip(&mut data.rows) {
        let mut axes_deg = row.axes.degrees();
        axes_deg[2] += 1.5;
        (row.index, row.axes) = (index, AxisAngles::from_degrees(axes_deg));
    }
    let result = identify(dir.path(), &data, &["--prior", "datasheet"]);
    let codes: Vec<&str> = result["findings"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(|finding| finding["code"].as_str())
        .collect();
    assert!(codes.contains(&"W1312"), "{codes:?}");
    let predicted = &result["predicted_position_uncertainty_mm"];
    assert!(predicted["identified"]["mean"].as_f64().unwrap() < 1.0, "{predicted}");
}
