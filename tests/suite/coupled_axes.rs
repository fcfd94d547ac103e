//! Arms whose controller displays axis 3 relative to the horizontal, so that joint 3 turns by A3 + A2: poses, inverse kinematics,
//! limits, sag, joint errors, exports and an identification.

use std::fmt::Write;
use std::fs;

use dbbd_job::report::export::urdf::urdf;
use dbbd_job::sim::truth;
use dbbd_model::estimation::Workspace;
use dbbd_model::math::aligned_distances;
use dbbd_model::measurement::{Datum, Measurement, Measurements, TargetId};
use dbbd_model::robot::inverse::{branches, turns_within};
use dbbd_model::robot::kinematics::Mass;
use dbbd_model::robot::{
    Approach, AxisAngles, BallId, BarId, Geometry, Joint, JointErrorModel, JointErrors, Pose, Ripple, Robot,
};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;
use tempfile::tempdir;

use crate::cell::{codes, dbbd, stderr};
use crate::hands_the_robot_back::ball_of;
use crate::rapid_and_urscript::named;

pub(crate) fn provoked() -> Vec<&'static str> {
    vec!["I1723", "E0505", "W1281"]
}

fn rad(deg: [f64; 6]) -> [f64; 6] {
    deg.map(f64::to_radians)
}

/// A pose as a FANUC displays it: mm, and rotations about the fixed X, Y and Z in degrees, which are KUKA's C, B and A.
fn shown([x, y, z, w, p, r]: [f64; 6]) -> Pose {
    Pose::from_kuka([x, y, z], [r, p, w])
}

/// J1 to J6 and the flange of an M-20iD/25 from the virtual controller of the maker (ROBOGUIDE), published by the project robconv
/// (tests/fixtures/probes/results/CFGPROBE_roboguide.LS).
const ROBOGUIDE: [([f64; 6], [f64; 6]); 16] = [
    ([0.0, 0.0, 0.0, 0.0, -90.0, 0.0], [965.0, 0.0, 965.0, -180.0, 0.0, 0.0]),
    ([0.0, 0.0, 0.0, 0.0, 90.0, 0.0], [965.0, 0.0, 1145.0, 0.0, 0.0, -180.0]),
    ([0.0, 0.0, 0.0, 0.0, -30.0, 0.0], [1042.942, 0.0, 1010.0, 180.0, -60.0, 0.0]),
    ([0.0, 0.0, 0.0, 0.0, 30.0, 0.0], [1042.942, 0.0, 1100.0, 0.0, -60.0, 180.0]),
    ([0.0, 0.0, 0.0, 185.0, -90.0, 0.0], [965.0, 7.844, 1144.657, -5.0, 0.0, 0.0]),
    ([0.0, 0.0, 0.0, -185.0, -90.0, 0.0], [965.0, -7.844, 1144.657, 5.0, 0.0, 0.0]),
    ([0.0, 0.0, 0.0, 0.0, -90.0, 190.0], [965.0, 0.0, 965.0, 180.0, 0.0, -170.0]),
    ([0.0, 0.0, 0.0, 0.0, -90.0, -190.0], [965.0, 0.0, 965.0, -180.0, 0.0, 170.0]),
    ([0.0, 0.0, 0.0, 0.0, -90.0, 350.0], [965.0, 0.0, 965.0, 180.0, 0.0, -10.0]),
    ([0.0, 40.0, 60.0, 0.0, -90.0, 0.0], [951.688, 0.0, 1476.74, 180.0, -60.0, 0.0]),
    ([0.0, 40.0, -60.0, 0.0, -90.0, 0.0], [1168.195, 0.0, -64.785, -180.0, 60.0, 0.0]),
    ([0.0, -60.0, -80.0, 0.0, -90.0, 0.0], [-374.813, 0.0, -434.773, -180.0, 80.0, 0.0]),
    ([0.0, -60.0, 80.0, 0.0, -90.0, 0.0], [-621.015, 0.0, 1318.185, 180.0, -80.0, 0.0]),
    ([0.0, 60.0, 80.0, 0.0, -90.0, 0.0], [833.907, 0.0, 1318.185, 180.0, -80.0, 0.0]),
    ([90.0, 0.0, 0.0, 0.0, -90.0, 0.0], [0.0, 965.0, 965.0, -180.0, 0.0, 90.0]),
    ([-150.0, 0.0, 0.0, 0.0, -90.0, 0.0], [-835.714, -482.5, 965.0, -180.0, 0.0, -150.0]),
];

#[test]
fn flange_agrees_with_the_virtual_controller_of_the_maker() {
    let robot = named("m20id25");
    for (axes, pose) in ROBOGUIDE {
        let (there, shown) = (robot.geometry.flange(&rad(axes)), shown(pose));
        let (mm, turn) = ((there.position - shown.position).norm(), there.angle_to(&shown).to_degrees());
        assert!(mm < 1e-3 && turn < 1e-3, "{axes:?}: {mm} mm, {turn} degrees");
    }
}

/// Flange poses of a CRX-10iA, each with all axis angles that reach it (Abbes and Poisson, Geometric approach for inverse
/// kinematics of the FANUC CRX collaborative robot, Robotics 13, 91, 2024, tables 4 and 6).
const EIGHT: ([f64; 6], [[f64; 6]; 8]) = (
    [80.321, 287.676, 394.356, -131.819, -45.268, 61.453],
    [
        [44.611, 89.087, 109.193, 94.703, 121.416, 121.782],
        [35.162, 88.468, 140.150, -108.846, -111.920, -91.804],
        [29.462, -39.473, -8.392, 117.682, 85.679, -119.224],
        [78.0, -41.0, 17.0, -42.0, -60.0, 10.0],
        [-135.389, -89.087, 70.807, -85.297, 121.416, 121.782],
        [-144.839, -88.468, 39.850, 71.154, -111.920, -91.804],
        [-150.538, 39.473, 188.392, -62.318, 85.679, -119.224],
        [-102.0, 41.0, 163.0, 138.0, -60.0, 10.0],
    ],
);
const SIXTEEN: ([f64; 6], [[f64; 6]; 16]) = (
    [209.470, -42.894, 685.496, -95.378, -64.226, -56.402],
    [
        [-60.125, 62.707, 112.015, 90.165, 92.586, 132.291],
        [-63.318, 62.684, 143.064, -93.111, -89.750, -78.691],
        [11.855, 54.151, 144.007, -28.773, -142.889, -48.616],
        [49.247, 46.825, 135.954, 29.379, -134.512, -5.010],
        [-62.156, -40.094, 14.333, 92.039, 91.458, -129.964],
        [47.115, -53.924, 35.922, 28.105, -41.924, -48.121],
        [0.0, -45.0, 44.0, -37.0, -53.0, 0.0],
        [-47.369, -40.310, 45.272, -78.410, -81.969, 17.952],
        [119.875, -62.707, 67.985, -89.835, 92.586, 132.291],
        [116.682, -62.684, 36.936, 86.889, -89.750, -78.691],
        [-168.145, -54.151, 35.993, 151.227, -142.889, -48.616],
        [-130.753, -46.825, 44.046, -150.621, -134.512, -5.01],
        [117.844, 40.094, 165.667, -87.961, 91.458, -129.964],
        [-132.885, 53.924, 144.078, -151.895, -41.924, -48.121],
        [-180.0, 45.0, 136.0, 143.0, -53.0, 0.0],
        [132.631, 40.310, 134.728, 101.590, -81.969, 17.952],
    ],
);

#[test]
fn all_published_axis_angles_of_an_offset_wrist_are_found() {
    let robot = named("crx10ia");
    let cases = [(EIGHT.0, &EIGHT.1[..]), (SIXTEEN.0, &SIXTEEN.1[..])];
    for (pose, published) in cases {
        let found = branches(&robot.geometry, &shown(pose)).unwrap();
        assert_eq!(found.len(), published.len());
        for axes in published {
            let off = |branch: &[f64; 6]| {
                let apart = branch.iter().zip(axes).map(|(a, b)| (a.to_degrees() - b).rem_euclid(360.0));
                apart.map(|apart| apart.min(360.0 - apart)).fold(0.0, f64::max)
            };
            let nearest = found.iter().map(off).fold(f64::MAX, f64::min);
            // The published pose and angles have three decimals.
            assert!(nearest < 0.01, "{axes:?}: {nearest} degrees");
        }
    }
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
        let output = dbbd(dir.path(), &["predict", "axes.csv", "--robot", "m10id12", "--out", "p.csv"]);
        assert_eq!((output.status.code(), codes(&output)), expected, "{}", stderr(&output));
    }
    // The poses of a workspace are within the limits.
    assert!(Workspace::uniform(&robot, 1000, 1).iter().all(|axes| robot.is_within_limits(axes)));
}

/// At A3 = 0 the forearm is level whatever the angle of the upper arm: its weight deflects joint 3 by the same angle.
#[test]
fn level_forearm_has_the_same_sag() {
    let rigid = named("m10id12").geometry;
    let mut soft = rigid.clone();
    // 10 kg in the wrist: 9.80665 * 10 * 0.7 = 68.647 N m about joint 3.
    soft.masses = vec![Mass { joint: Joint::J5, kg: 10.0, centre: Vector3::zeros() }];
    soft.compliance[2] = 1e-6;
    for a2 in [-30.0, 0.0, 40.0, 90.0] {
        let axes = rad([0.0, a2, 0.0, 0.0, 0.0, 0.0]);
        let sag = rigid.flange(&axes).position.z - soft.flange(&axes).position.z;
        // The flange is 775 mm in front of joint 3.
        assert!((sag - 68.647e-6 * 775.0).abs() < 1e-5, "{a2}: {sag} mm");
    }
}

/// The drive of joint 3 turns by A3 + A2, and only axis 3 can correct its errors.
#[test]
fn joint_errors_are_functions_of_the_own_angle() {
    let sound = named("m10id12").geometry;
    let ripple = Ripple { order: 11, cos: 2e-4, sin: -1e-4 };
    let mut joints = [(); 6].map(|()| JointErrorModel::default());
    joints[2] = JointErrorModel { backlash: 1e-4, ripple: vec![ripple], ..JointErrorModel::default() };
    let mut wrong = Geometry { joint_errors: JointErrors::new(joints), ..sound.clone() };
    wrong.gear[2] = [3e-4, 5e-4];
    for (a2, a3, senses, sense) in
        [(20.0, -35.0, [1, 1, 1], 1.0), (-40.0, 60.0, [1, -1, 1], 0.0), (70.0, 10.0, [0, -1, -1], -1.0)]
    {
        let mut axes = rad([10.0, a2, a3, 20.0, -50.0, 30.0]);
        let approach = Approach::new([senses[0], senses[1], senses[2], 0, 0, 0]);
        let there = wrong.approached(approach).ball(&axes);
        let own = (a2 + a3).to_radians();
        let error =
            3e-4 * own.cos() + 5e-4 * own.sin() + 2e-4 * (11.0 * own).cos() - 1e-4 * (11.0 * own).sin();
        axes[2] += sound.rows[2].sign * (error + sense * 1e-4);
        let undone = sound.ball(&axes);
        assert!((there.position - undone.position).norm() < 1e-9 && there.angle_to(&undone) < 1e-12);
    }
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
