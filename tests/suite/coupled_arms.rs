//! Arms whose controller displays axis 3 relative to the horizontal: their files, limits, exports and an identification.

use std::fmt::Write;
use std::fs;

use dbbd_job::report::export::urdf::urdf;
use dbbd_job::sim::truth;
use dbbd_model::estimation::Workspace;
use dbbd_model::math::aligned_distances;
use dbbd_model::measurement::{Datum, Measurement, Measurements, TargetId};
use dbbd_model::robot::inverse::turns_within;
use dbbd_model::robot::{Approach, AxisAngles, BallId, BarId, Geometry, PayloadId, Robot};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;
use tempfile::tempdir;

use crate::cell::{codes, dbbd, named, stderr};
use crate::hands_the_robot_back::ball_of;

fn rad(deg: [f64; 6]) -> [f64; 6] {
    deg.map(f64::to_radians)
}

/// Changes of the file of an M-10iD/12, and whether the file is still valid.
const FILES: [(&str, &str, bool); 7] = [
    ("axis = 2, factor = 1", "axis = 2, factor = -1", true),
    (", limits_deg = [-90.0, 222.0]", "", true),
    ("axis = 2, factor = 1", "axis = 1, factor = 1", false),
    ("axis = 2, factor = 1", "axis = 3, factor = 1", false),
    ("axis = 2, factor = 1", "axis = 2, factor = 2", false),
    ("limits_deg = [-90.0, 222.0]", "limits_deg = [222.0, -90.0]", false),
    ("limits_deg = [-90.0, 222.0]", "limits_deg = [600.0, 700.0]", false),
];

#[test]
fn couplings_are_checked_and_read_back() {
    let dir = tempdir().unwrap();
    let sound = Robot::built_in_file("m10id12").unwrap();
    for (from, to, is_sound) in FILES {
        let text = sound.replacen(from, to, 1);
        assert_ne!(text, sound, "{from}");
        fs::write(dir.path().join("robot.toml"), &text).unwrap();
        let output = dbbd(dir.path(), &["robots", "check", "robot.toml"]);
        let expected = if is_sound { (Some(0), vec![]) } else { (Some(1), vec!["E0505".to_owned()]) };
        assert_eq!((output.status.code(), codes(&output)), expected, "{to}");
        if is_sound {
            let robot = Robot::from_toml("robot.toml", &text).unwrap();
            assert_eq!(Robot::from_toml("robot.toml", &robot.to_toml().unwrap()).unwrap(), robot);
        }
    }
}

/// Joint 3 of an M-10iD/12 turns from -90 to 222 degrees: at A2 = 100 axis 3 may be between -190 and 122.
#[test]
fn limits_of_a_coupled_axis_depend_on_the_second_axis() {
    let robot = named("m10id12");
    let at = |a2, a3| rad([0.0, a2, a3, 0.0, 0.0, 0.0]);
    for (a2, a3, margin_deg) in
        [(100.0, -180.0, 10.0), (100.0, -195.0, -5.0), (100.0, 125.0, -3.0), (-80.0, -20.0, -10.0)]
    {
        assert!((robot.limit_margin_deg(&at(a2, a3)) - margin_deg).abs() < 1e-9, "{a2} {a3}");
    }
    // Axis 3 has the full turn that the joint allows.
    let turns = |a2, a3| turns_within(&at(a2, a3), &robot).len();
    assert_eq!([turns(100.0, -180.0), turns(100.0, 180.0), turns(100.0, -195.0)], [3, 3, 0]);
    let dir = tempdir().unwrap();
    for (a3, expected) in [(-180.0, (Some(0), vec![])), (-195.0, (Some(3), vec!["W1281".to_owned()]))] {
        let table = format!("a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg\n0,100,{a3},0,30,0\n");
        fs::write(dir.path().join("axes.csv"), table).unwrap();
        let output = dbbd(
            dir.path(),
            &["predict", "axes.csv", "--robot", "m10id12", "--tool", "0,0,0", "--out", "p.csv"],
        );
        assert_eq!((output.status.code(), codes(&output)), expected, "{}", stderr(&output));
    }
    // The poses of a workspace are within the limits.
    assert!(Workspace::uniform(&robot, 1000, 1).iter().all(|axes| robot.is_within_limits(axes)));
}

#[test]
fn urdf_takes_own_angles_of_the_joints() {
    let dir = tempdir().unwrap();
    let nominal = named("crx10ia");
    let found =
        Robot { nominal: Some(Box::new(nominal.clone())), ..truth::draw_true_robot(&nominal, 5, 1.0) };
    fs::write(dir.path().join("found.toml"), found.to_toml().unwrap()).unwrap();
    // The URDF of the user is that of the nominal robot.
    fs::write(dir.path().join("user.urdf"), urdf(&nominal)).unwrap();
    let output = dbbd(dir.path(), &["export", "found.toml", "--urdf-in", "user.urdf", "--out", "out"]);
    assert_eq!((output.status.code(), codes(&output)), (Some(0), vec!["I1723".to_owned()]));
    let patched = fs::read_to_string(dir.path().join("out/user.urdf")).unwrap();
    for axes in Workspace::uniform(&nominal, 20, 1) {
        let there = found.geometry.ball(&axes).position;
        for text in [&patched, &urdf(&found)] {
            let off = (ball_of(text, &found.geometry.coupling.joints(&axes)) - there).norm();
            assert!(off < 1e-6, "{off} mm");
        }
    }
}

const BALLS: [[f64; 3]; 3] = [[900.0, 0.0, 100.0], [600.0, 600.0, 350.0], [700.0, -550.0, 500.0]];
const SIGMA_MM: f64 = 0.01;

/// Lengths of a true robot at poses in front of it, each from all balls.
fn lengths(truth: &Robot, poses: usize) -> Measurements {
    let mut random = Pcg64::seed_from_u64(1);
    let ranges =
        [[-60.0, 60.0], [-40.0, 70.0], [-60.0, 50.0], [-90.0, 90.0], [-110.0, 110.0], [-120.0, 120.0]];
    let mut rows = Vec::new();
    for _ in 0..poses {
        let axes = ranges.map(|[low, high]| random.random_range(low..high));
        for (ball, place) in BALLS.into_iter().enumerate() {
            let noise: f64 = random.sample(StandardNormal);
            rows.push(Measurement {
                index: rows.len() as u32 + 1,
                datum: Datum::Ball(BallId::at(ball), BarId::FIRST),
                target: TargetId::FIRST,
                axes: AxisAngles::from_degrees(axes),
                approach: Approach::default(),
                length_mm: truth.geometry.length(&rad(axes), &Vector3::from(place), 0.0) + SIGMA_MM * noise,
                sigma_mm: Some(SIGMA_MM),
                payload: PayloadId::FIRST,
                context: None,
            });
        }
    }
    Measurements { rows, ..Measurements::default() }
}

/// Robots within the tolerance, and one whose joint 3 has a transmission error with the period of its drive.
#[test]
fn coupled_arm_is_identified() {
    for (name, gear) in [("m10id12", 0.0), ("crx10ia", 0.0), ("m10id12", 4e-4)] {
        let dir = tempdir().unwrap();
        let mut nominal = named(name);
        nominal.geometry.tool = Vector3::new(30.0, 20.0, 60.0);
        let mut truth = truth::draw_true_robot(&nominal, 7, 1.0);
        truth.geometry.gear[2] = [0.0, gear];
        fs::write(dir.path().join("nominal.toml"), nominal.to_toml().unwrap()).unwrap();
        fs::write(dir.path().join("obs.csv"), lengths(&truth, 120).to_csv()).unwrap();
        let mut centres = String::from("centre,x_mm,y_mm,z_mm\n");
        for (at, [x, y, z]) in BALLS.into_iter().enumerate() {
            writeln!(centres, "{},{},{},{}", at + 1, x + 2.0, y - 1.0, z + 1.0).unwrap();
        }
        fs::write(dir.path().join("c.csv"), centres).unwrap();
        let args =
            "identify obs.csv --robot nominal.toml --centres c.csv --prior datasheet --folds 0 --out out";
        let output = dbbd(dir.path(), &args.split(' ').collect::<Vec<_>>());
        assert!(matches!(output.status.code(), Some(0 | 3)), "{}", stderr(&output));
        let text = fs::read_to_string(dir.path().join("out/robot-identified.toml")).unwrap();
        let found = Robot::from_toml("robot-identified.toml", &text).unwrap();
        assert_eq!(found.geometry.coupling, nominal.geometry.coupling);
        assert_eq!(found.coupled_limits_deg, nominal.coupled_limits_deg);
        let poses = lengths(&nominal, 200).rows;
        let balls = |geometry: &Geometry| -> Vec<Vector3<f64>> {
            poses.iter().map(|row| geometry.ball(&row.axes.radians()).position).collect()
        };
        let [before, after] = [&nominal, &found].map(|robot| {
            let off = aligned_distances(&balls(&truth.geometry), &balls(&robot.geometry));
            off.iter().sum::<f64>() / off.len() as f64
        });
        eprintln!("{name}, gear {gear}: {before:.3} mm before, {after:.4} mm after");
        assert!(before > 0.5 && after < 0.03, "{name}: {before} {after}");
        // The error of the drive is found at its joint.
        let sin = found.geometry.gear[2][1];
        assert!((sin - gear).abs() < 1e-4, "{name}: {sin}");
    }
}
