//! The identified joints in a user's URDF: its flange is where the model's is, and no other byte changes.

use std::fs;

use dbbd_model::robot::pose::{rot_x, rot_y, rot_z};
use dbbd_model::robot::{Pose, Robot};
use nalgebra::{Rotation3, Unit, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use tempfile::tempdir;

use crate::cell::{codes, dbbd, kr60, stderr, with_errors};

const SLIDING: &str = "<robot name=\"r\"><joint name=\"j\" type=\"prismatic\"/></robot>";

/// What is done to the file, the exit code, and the code.
const REFUSED: &[(&str, &str, i32, &str)] = &[
    ("<robot name=\"r\">", "<robot name=\"r\"", 1, "E1720"),
    ("type=\"revolute\"", "type=\"fixed\"", 1, "E1721"),
    ("type=\"revolute\"", "type=\"prismatic\"", 1, "E1720"),
    ("xyz=\"0", "xyz=\"1,5", 1, "E1720"),
    ("<axis xyz=\"", "<axis xyz=\"9 9 9\" other=\"", 1, "E1721"),
];

fn pose(rotation: [f64; 3], position: [f64; 3]) -> Pose {
    let [x, y, z] = rotation;
    Pose { rotation: rot_z(z) * rot_y(y) * rot_x(x), position: Vector3::from(position) }
}

fn tag(pose: &Pose) -> String {
    let p = pose.position * 1e-3;
    let (roll, pitch, yaw) = Rotation3::from_matrix_unchecked(pose.rotation).euler_angles();
    format!("<origin rpy=\"{roll} {pitch} {yaw}\"   xyz=\"{} {} {}\" />", p.x, p.y, p.z)
}

/// A URDF of a robot as its maker could have written it: other link frames, fixed joints between, a gripper.
struct Users {
    text: String,
    /// The root link in the robot base, and link 6 in the flange.
    root: Pose,
    tip: Pose,
    axes: [Vector3<f64>; 6],
}

fn users(robot: &Robot, root: Pose, seed: u64) -> Users {
    let mut random = Pcg64::seed_from_u64(seed);
    let mut turn = || random.random_range(-3.0..3.0);
    let mut text = String::from(
        "<?xml version=\"1.0\"?>\n<!-- the maker's -->\n<robot name=\"r\">\n  <link name=\"world\"/>\n",
    );
    let (mut before, mut axes) = (root, [Vector3::zeros(); 6]);
    for (at, row) in robot.geometry.rows.iter().enumerate() {
        let turned = rot_y(row.beta) * rot_x(row.alpha);
        let rotation = turned * rot_z(row.theta);
        let position = turned.column(0) * row.a + rotation.column(2) * row.d;
        let own = pose([turn(), turn(), turn()], [0.0, 0.0, 50.0 * turn()]);
        let whole = before.inverse().then(&Pose { rotation, position }).then(&own);
        let bracket = pose([turn(), turn(), turn()], [10.0 * turn(), 20.0, 30.0]);
        axes[at] = own.rotation.transpose() * Vector3::z() * row.sign;
        let parent = if at == 0 { "world".into() } else { format!("l{at}") };
        let n = at + 1;
        text += &format!(
            "<joint name=\"f{n}\" type=\"fixed\"><parent link=\"{parent}\"/><child link=\"b{n}\"/>{}</joint>\n<link name=\"b{n}\"/>\n\
             <joint name=\"joint_{n}\" type=\"revolute\">\n\t<parent link=\"b{n}\"/><child link=\"l{n}\"/>\n\t{} <!-- kept -->\r\n\
             <axis xyz=\"{} {} {}\"/></joint>\n<link name=\"l{n}\"><visual><geometry><mesh filename=\"package://a/b.stl\"/></geometry></visual></link>\n",
            tag(&bracket),
            tag(&bracket.inverse().then(&whole)),
            axes[at].x,
            axes[at].y,
            axes[at].z,
        );
        before = own;
    }
    text += "<joint name=\"finger\" type=\"revolute\"><parent link=\"l6\"/><child link=\"g\"/><axis xyz=\"0 1 0\"/></joint><link name=\"g\"/>\n</robot>\n";
    Users { text, root, tip: before, axes }
}

/// Link 6 in the root link by the URDF's own definition: origin, then a turn about the axis.
fn link_6(urdf: &str, directions: &[Vector3<f64>; 6], axes: &[f64; 6]) -> Pose {
    let mut turning = directions.iter().zip(axes);
    urdf.split("<joint ").skip(1).take(12).fold(Pose::identity(), |frame, joint| {
        let numbers = |attribute: &str| -> [f64; 3] {
            let after =
                joint.split("<origin").nth(1).unwrap().split(&format!("{attribute}=\"")).nth(1).unwrap();
            let values: Vec<f64> =
                after.split('"').next().unwrap().split(' ').map(|word| word.parse().unwrap()).collect();
            values.try_into().unwrap()
        };
        let origin = frame.then(&pose(numbers("rpy"), numbers("xyz").map(|metres| metres * 1e3)));
        if !joint.contains("revolute") {
            return origin;
        }
        let (axis, angle) = turning.next().unwrap();
        let turn = Rotation3::from_axis_angle(&Unit::new_normalize(*axis), *angle);
        origin.then(&Pose { rotation: turn.into_inner(), position: Vector3::zeros() })
    })
}

/// The text without its origins.
fn rest(urdf: &str) -> String {
    let tags = urdf.split("<joint ").map(|joint| match joint.split_once("<origin") {
        Some((head, tail)) => format!("{head}{}", tail.split_once("/>").unwrap().1),
        None => joint.to_owned(),
    });
    tags.collect::<Vec<_>>().join("<joint ")
}

fn identified() -> Robot {
    let found =
        with_errors([("beta2", 0.002), ("theta3", 0.004), ("alpha5", 0.001), ("d2", 0.7), ("d6", -0.3)]);
    Robot { nominal: Some(Box::new(kr60())), ..found }
}

#[test]
fn the_flange_is_where_the_model_has_it() {
    let robot = identified();
    let roots = [
        pose([0.0; 3], [0.0; 3]),
        pose([0.0, 0.0, std::f64::consts::PI], [0.0; 3]),
        pose([0.3, -0.2, 1.0], [500.0, -200.0, 800.0]),
    ];
    for (seed, root) in (1..).zip(roots) {
        let dir = tempdir().unwrap();
        let users = users(&kr60(), root, seed);
        fs::write(dir.path().join("arm.urdf"), &users.text).unwrap();
        fs::write(dir.path().join("robot.toml"), robot.to_toml().unwrap()).unwrap();
        let output = dbbd(
            dir.path(),
            &["export", "--replace", "robot.toml", "--urdf-in", "arm.urdf", "--out", "out", "--json"],
        );
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        let patched = fs::read_to_string(dir.path().join("out/arm.urdf")).unwrap();
        assert_eq!(rest(&patched), rest(&users.text));
        let mut random = Pcg64::seed_from_u64(seed);
        for _ in 0..100 {
            let axes = robot.limits_deg.map(|[low, high]| random.random_range(low..high).to_radians());
            let expected = robot.geometry.flange(&axes).then(&users.tip);
            let found = users.root.then(&link_6(&patched, &users.axes, &axes));
            let off = (found.position - expected.position).norm();
            assert!(off < 1e-6 && found.angle_to(&expected) < 1e-9, "root {seed}: {off} mm");
        }
    }
}

#[test]
fn a_urdf_of_another_robot_is_refused() {
    let dir = tempdir().unwrap();
    let good = users(&kr60(), pose([0.0; 3], [0.0; 3]), 1).text;
    fs::write(dir.path().join("robot.toml"), identified().to_toml().unwrap()).unwrap();
    let patch = |text: &str, more: &[&str]| {
        fs::write(dir.path().join("arm.urdf"), text).unwrap();
        let args = ["export", "--replace", "robot.toml", "--urdf-in", "arm.urdf", "--out", "out"];
        dbbd(dir.path(), &[&args, more].concat())
    };
    for (from, to, exit, code) in REFUSED {
        let output = patch(&good.replacen(from, to, 1), &[]);
        assert_eq!(output.status.code(), Some(*exit), "{to}");
        assert_eq!(codes(&output), [*code], "{to}");
    }
    assert_eq!(codes(&patch(SLIDING, &[])), ["E1720"]);
    // A second arm on the same root: the six joints are named, or it is refused.
    let second = good
        .replace("<joint name=\"", "<joint name=\"right_")
        .replace("link=\"l", "link=\"r")
        .replace("link=\"b", "link=\"c");
    let second = second.split("<link name=\"world\"/>").nth(1).unwrap().replace("</robot>", "");
    let both = good.replace("</robot>", &second) + "</robot>";
    assert_eq!(codes(&patch(&both, &[])), ["E1720"]);
    let names = "joint_1,joint_2,joint_3,joint_4,joint_5,joint_6";
    assert_eq!(patch(&both, &["--joints", names]).status.code(), Some(0));
    assert!(fs::read_to_string(dir.path().join("out/arm.urdf")).unwrap().ends_with(&(second + "\n</robot>")));
    // Names that are not there, and a chain from the flange to the base.
    for wrong in [names.replace("_6", "_7"), "joint_6,joint_5,joint_4,joint_3,joint_2,joint_1".into()] {
        let output = patch(&good, &["--joints", &wrong]);
        assert_eq!(codes(&output), ["E1720"]);
        assert!(!stderr(&output).contains("0 chains"), "{wrong}");
    }
    // The file itself is not written over.
    fs::write(dir.path().join("arm.urdf"), &good).unwrap();
    let output = dbbd(dir.path(), &["export", "robot.toml", "--urdf-in", "arm.urdf", "--out", "."]);
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(fs::read_to_string(dir.path().join("arm.urdf")).unwrap(), good);
}

/// A compliant robot: what a URDF leaves out is said in millimetres.
#[test]
fn effects_that_a_urdf_cannot_model_are_reported() {
    let dir = tempdir().unwrap();
    let mut robot = identified();
    robot.geometry.gear[1] = [1e-3, 0.0];
    fs::write(dir.path().join("arm.urdf"), users(&kr60(), pose([0.0; 3], [0.0; 3]), 1).text).unwrap();
    fs::write(dir.path().join("robot.toml"), robot.to_toml().unwrap()).unwrap();
    let output = dbbd(
        dir.path(),
        &["export", "--replace", "robot.toml", "--urdf-in", "arm.urdf", "--out", "out", "--json"],
    );
    assert_eq!(codes(&output), ["I1722"]);
    let document: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let most = document["left_out"]["max_mm"].as_f64().unwrap();
    // At most 1 mrad at the arm's reach from axis 2.
    assert!(most > 1.0 && most < 1e-3 * robot.reach_mm(), "{most}");
}
