//! `dbbd robots import`: a URDF and the factory calibration of a controller become robot files.

use std::fs;
use std::io::Write;
use std::net::TcpListener;
use std::path::Path;

use dbbd_model::robot::{ControllerModel, Pose, Robot, max_axis_difference};
use tempfile::tempdir;

use crate::cell::{codes, dbbd, named, stderr};
use crate::nothing_wrong_is_silent::says;

/// The joints of a UR10 in a URDF, with the base that turns by half a turn as in those of its maker.
fn urdf() -> String {
    let origins = [
        ("0 0 0.1273", "0 0 0"),
        ("0 0 0", "1.570796326794897 0 0"),
        ("-0.612 0 0", "0 0 0"),
        ("-0.5723 0 0.163941", "0 0 0"),
        ("0 -0.1157 0", "1.570796326794897 0 0"),
        ("0 0.0922 0", "1.570796326794897 3.141592653589793 3.141592653589793"),
    ];
    let joint = |(at, (xyz, rpy)): (usize, &(&str, &str))| {
        format!(
            "<joint name='j{n}' type='revolute'><parent link='l{at}'/><child link='l{n}'/><origin xyz='{xyz}' rpy='{rpy}'/>\
             <axis xyz='0 0 1'/><limit lower='-6.28' upper='6.28' velocity='2.09' effort='1'/></joint>\n",
            n = at + 1
        )
    };
    let joints: String = origins.iter().enumerate().map(joint).collect();
    format!(
        "<robot name='arm'>\n<link name='base_link'/>\n<joint name='b' type='fixed'><parent link='base_link'/>\
         <child link='l0'/><origin xyz='0 0 0' rpy='0 0 3.141592653589793'/></joint>\n{joints}\
         <joint name='t' type='fixed'><parent link='l6'/><child link='tool0'/><origin xyz='0 0 0' rpy='0 0 0'/></joint>\n</robot>\n"
    )
}

fn read(path: &Path) -> Robot {
    Robot::from_toml("robot.toml", &fs::read_to_string(path).unwrap()).unwrap()
}

#[test]
fn a_urdf_becomes_a_robot_with_the_same_flange() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    fs::write(at.join("arm.urdf"), urdf()).unwrap();
    let output = dbbd(at, &["robots", "import", "arm.urdf", "--out", "arm.toml"]);
    assert_eq!((output.status.code(), codes(&output)), (Some(0), vec![]));
    let (robot, nominal) = (read(&at.join("arm.toml")), named("ur10"));
    assert!((robot.limits_deg[0][1] - 359.8).abs() < 0.1 && (robot.max_speed_deg_s[3] - 119.7).abs() < 0.1);
    let axes = [0.3, -1.2, 1.5, -0.7, 1.1, 0.4];
    // The base link is turned by half a turn against the controller's base.
    let turned = Pose::from_kuka([0.0; 3], [180.0, 0.0, 0.0]).then(&nominal.geometry.flange(&axes));
    let found = robot.geometry.flange(&axes);
    assert!((found.position - turned.position).norm() < 1e-6 && found.angle_to(&turned) < 1e-9, "{found:?}");
    // It can be planned with.
    assert_eq!(dbbd(at, &["robots", "check", "arm.toml"]).status.code(), Some(0));
    // An inclined base has no place in a table.
    fs::write(at.join("wall.urdf"), urdf().replace("rpy='0 0 3.141592653589793'", "rpy='0.5 0.2 0'"))
        .unwrap();
    says(&dbbd(at, &["robots", "import", "wall.urdf", "--out", "wall.toml"]), 3, "W0593");
    // A seventh joint: an arm of seven, or a gripper.
    let seventh = "<link name='l7'/><joint name='j7' type='revolute'><parent link='tool0'/><child link='l7'/>\
                   <axis xyz='0 0 1'/></joint></robot>";
    fs::write(at.join("more.urdf"), urdf().replace("</robot>", seventh)).unwrap();
    says(&dbbd(at, &["robots", "import", "more.urdf", "--out", "no.toml"]), 1, "E1720");
    let named = ["robots", "import", "more.urdf", "--joints", "j1,j2,j3,j4,j5,j6", "--out", "more.toml"];
    assert_eq!(dbbd(at, &named).status.code(), Some(0));
    for (from, to) in
        [("revolute", "prismatic"), ("<robot", "<model"), ("velocity='2.09'", "velocity='fast'")]
    {
        let wrong = urdf()
            .replace(from, to)
            .replace("</robot", &format!("</{}", if to == "<model" { "model" } else { "robot" }));
        fs::write(at.join("wrong.urdf"), wrong).unwrap();
        says(&dbbd(at, &["robots", "import", "wrong.urdf", "--out", "no.toml"]), 1, "E1720");
    }
    says(&dbbd(at, &["robots", "import", "arm.urdf", "--out", "arm.urdf", "--replace"]), 1, "E0180");
    assert!(!at.join("no.toml").exists() && fs::read_to_string(at.join("arm.urdf")).unwrap() == urdf());
}

#[test]
fn a_built_in_robot_becomes_a_file() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    let import = || dbbd(at, &["robots", "import", "kr60ha", "--out", "mine.toml"]);
    assert_eq!(import().status.code(), Some(0));
    assert_eq!(read(&at.join("mine.toml")), Robot::by_name("kr60ha").unwrap().unwrap());
    // What applies to others is not ignored, and a mistyped name is not taken for a file.
    for more in [["--robot", "ur10"], ["--joints", "a,b"]] {
        let import = ["robots", "import", "kr60ha", "--out", "other.toml"];
        says(&dbbd(at, &[&import[..], &more].concat()), 1, "E1982");
    }
    let mistyped = dbbd(at, &["robots", "import", "kr60a", "--out", "other.toml"]);
    says(&mistyped, 1, "E0503");
    assert!(stderr(&mistyped).contains("did you mean `kr60ha`?"), "{}", stderr(&mistyped));
    assert!(!at.join("other.toml").exists());
    // A file that somebody has changed since is kept.
    fs::write(at.join("mine.toml"), "serial = \"4711\"").unwrap();
    says(&import(), 1, "E0182");
    assert_eq!(fs::read_to_string(at.join("mine.toml")).unwrap(), "serial = \"4711\"");
}

const CONF: &str = "[mounting]\ndelta_theta = [0.0004, 0, 0, 0, 0, 0]\ndelta_a = [0, 0.0009, 0, 0, 0, 0]\n\
    delta_d = [0, 0, 0, 0, 0, 0]\ndelta_alpha = [0, 0, 0, 0, 0, 0]\n";

#[test]
fn a_factory_calibration_is_the_table_of_the_controller() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    fs::write(at.join("calibration.conf"), CONF).unwrap();
    let import = |from: &str, more: &[&str]| {
        dbbd(at, &[&["robots", "import", from, "--out", "mine.toml", "--replace"][..], more].concat())
    };
    says(&import("calibration.conf", &[]), 1, "E0591");
    let like = ["--robot", "ur10"];
    assert_eq!(import("calibration.conf", &like).status.code(), Some(0));
    let robot = read(&at.join("mine.toml"));
    assert_eq!(robot.controller_model, ControllerModel::Calibrated);
    assert!((robot.geometry.rows[2].a - (-612.0 + 0.9)).abs() < 1e-9);
    assert!((robot.geometry.rows[0].theta - 0.0004).abs() < 1e-12);
    assert_eq!(robot.geometry.load, named("ur10").geometry.load);
    fs::write(at.join("short.conf"), CONF.replace("delta_d = [0,", "delta_d = [")).unwrap();
    says(&import("short.conf", &like), 1, "E0590");
    says(&import("ur://127.0.0.1:1", &like), 1, "E0592");
    let joints = ["--robot", "ur10", "--joints", "a,b,c,d,e,f"];
    says(&import("calibration.conf", &joints), 1, "E1982");
    says(&import("ur://127.0.0.1:1", &joints), 1, "E1982");
    fs::write(at.join("arm.urdf"), urdf()).unwrap();
    says(&import("arm.urdf", &like), 1, "E1982");
}

/// The state of a robot as the primary interface sends it, with the table of the UR10 e as it is made.
#[test]
fn a_controller_is_asked_for_its_table() {
    let nominal = named("ur10e");
    let rows = &nominal.geometry.rows;
    let next = |at: usize, of: fn(&dbbd_model::robot::DhRow) -> f64| rows.get(at + 1).map_or(0.0, of);
    let mut part = vec![5];
    part.extend([7; 24]);
    let columns: [[f64; 6]; 4] = [
        [0.01, 0.0, 0.0, 0.0, 0.0, 0.0],
        std::array::from_fn(|at| 1e-3 * next(at, |row| row.a)),
        std::array::from_fn(|at| 1e-3 * rows[at].d),
        std::array::from_fn(|at| next(at, |row| row.alpha)),
    ];
    part.extend(columns.iter().flatten().flat_map(|value| value.to_be_bytes()));
    let with_length = |bytes: &[u8]| [&(bytes.len() as u32 + 4).to_be_bytes()[..], bytes].concat();
    // The version comes first, then a state.
    let state = with_length(&[&[16][..], &with_length(&part)].concat());
    let version = with_length(&[20, 1, 2, 3]);
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let controller = std::thread::spawn(move || {
        let (mut client, _) = listener.accept().unwrap();
        client.write_all(&[version, state].concat()).unwrap();
    });
    let dir = tempdir().unwrap();
    let from = format!("ur://{address}");
    let output = dbbd(dir.path(), &["robots", "import", &from, "--robot", "ur10e", "--out", "mine.toml"]);
    assert_eq!((output.status.code(), codes(&output)), (Some(0), vec![]));
    controller.join().unwrap();
    let robot = read(&dir.path().join("mine.toml"));
    let turned = [0.3, -1.2, 1.5, -0.7, 1.1, 0.4];
    let mut axes = turned;
    axes[0] += 0.01;
    let [found, expected] = [robot.geometry.flange(&turned), nominal.geometry.flange(&axes)];
    assert!((found.position - expected.position).norm() < 1e-6, "{found:?}");
    assert!(max_axis_difference(&turned, &axes) > 0.009);
}
