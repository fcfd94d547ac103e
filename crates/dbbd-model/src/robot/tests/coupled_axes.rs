//! Arms whose controller displays axis 3 relative to the horizontal, so that joint 3 turns by A3 + A2: poses, inverse kinematics, sag and
//! joint errors.

use dbbd_model::robot::Mass;
use dbbd_model::robot::inverse::branches;
use dbbd_model::robot::{Approach, Geometry, Joint, JointErrorModel, JointErrors, Pose, Ripple};
use nalgebra::Vector3;

use crate::test_support::cell::named;

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

/// At A3 = 0 the forearm is level whatever the angle of the upper arm: its weight deflects joint 3 by the same angle.
#[test]
fn level_forearm_has_the_same_sag() {
    let rigid = named("m10id12").geometry;
    let mut soft = rigid.clone();
    // 10 kg in the wrist: 9.80665 * 10 * 0.7 = 68.647 N m about joint 3.
    soft.load.masses = vec![Mass { joint: Joint::J5, kg: 10.0, centre: Vector3::zeros() }];
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
