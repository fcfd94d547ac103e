//! Exports of the identified robot: the URDF agrees with the model, the mastering offsets have the sense of the axes, the data list
//! is KRL.
//! `tests/independent/urdf.py` reads the same URDF with Pinocchio.

use std::fs;

use dbbd_job::program::{Language, krl};
use dbbd_job::report::ReportFinding;
use dbbd_job::report::export::hand_back::{HandBack, HandBackTarget};
use dbbd_job::report::export::urdf::urdf;
use dbbd_job::sim::truth;
use dbbd_model::estimation::Workspace;
use dbbd_model::provenance::Provenance;
use dbbd_model::robot::pose::{rot_x, rot_y, rot_z};
use dbbd_model::robot::{ArmLoad, Joint, Mass, Pose, Robot};
use nalgebra::{Rotation3, Unit, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use tempfile::tempdir;

use crate::cell::{
    CENTRE, centres_csv, codes, dbbd, kr60, measure, named, stderr, three_planes, with_errors,
};

/// The numbers of an attribute in a fragment of XML.
fn numbers(xml: &str, attribute: &str) -> Vec<f64> {
    let after = xml.split(&format!("{attribute}=\"")).nth(1).unwrap();
    after.split('"').next().unwrap().split(' ').map(|number| number.parse().unwrap()).collect()
}

/// The ball by the definition of URDF (origin, then rotation about the axis), mm.
pub(crate) fn ball_of(urdf: &str, axes: &[f64; 6]) -> Vector3<f64> {
    let mut frame = Pose::identity();
    let mut turning = axes.iter();
    for joint in urdf.split("<joint ").skip(1).filter(|joint| joint.contains("<parent")) {
        let joint = joint.split("</joint>").next().unwrap();
        let (xyz, rpy) = (numbers(joint, "xyz"), numbers(joint, "rpy"));
        let origin = Pose {
            rotation: rot_z(rpy[2]) * rot_y(rpy[1]) * rot_x(rpy[0]),
            position: Vector3::from_column_slice(&xyz) * 1e3,
        };
        frame = frame.then(&origin);
        if joint.contains("revolute") {
            let axis = numbers(joint.split("<axis").nth(1).unwrap(), "xyz");
            let axis = Unit::new_normalize(Vector3::from_column_slice(&axis));
            let turn = Rotation3::from_axis_angle(&axis, *turning.next().unwrap());
            frame = frame.then(&Pose { rotation: *turn.matrix(), position: Vector3::zeros() });
        }
    }
    frame.position
}

fn agrees(robot: &Robot) {
    let text = urdf(robot);
    let mut random = Pcg64::seed_from_u64(1);
    for _ in 0..100 {
        let axes = robot.limits_deg.map(|[low, high]| random.random_range(low..high).to_radians());
        let off = (ball_of(&text, &axes) - robot.geometry.ball(&axes).position).norm();
        assert!(off < 1e-9, "{off} mm");
    }
}

#[test]
fn urdf_agrees_with_the_model() {
    agrees(&kr60());
    let mut robot =
        with_errors([("beta2", 0.002), ("beta4", -0.003), ("theta3", 0.004), ("alpha5", 0.001), ("d2", 0.7)]);
    agrees(&robot);
    // A pitch of a right angle, at which roll and yaw have the same axis, and a pitch very near it.
    for off in [0.0, 1e-9, 1e-6] {
        robot.geometry.rows[3].theta = std::f64::consts::FRAC_PI_2 + off;
        agrees(&robot);
    }
}

#[test]
fn masses_are_part_of_the_links() {
    let mut robot = kr60();
    robot.name = "-- \"<KR>\"".into();
    let mass = |joint, kg, x| Mass { joint, kg, centre: Vector3::new(x, 0.0, 150.0) };
    robot.geometry.load = ArmLoad::known(vec![mass(Joint::J6, 20.0, -100.0), mass(Joint::J6, 20.0, 100.0)]);
    let text = urdf(&robot);
    let link = text.split("<link name=\"link_6\">").nth(1).unwrap();
    // Two points of 20 kg at a distance of 0.2 m: 40 kg * (0.1 m)^2 about y and z, and 0.01 kg m^2 about every axis, without which
    // MuJoCo refuses the link. The frame of the link is 170 mm before the flange.
    assert_eq!(numbers(link, "value"), [40.0]);
    assert!((numbers(link, "iyy")[0] - 0.41).abs() < 1e-12 && (numbers(link, "ixx")[0] - 0.01).abs() < 1e-12);
    assert!((numbers(link, "xyz")[2] - 0.32).abs() < 1e-12);
    assert!(
        !text.contains("<KR>")
            && !text.split("<!--").nth(1).unwrap().split("-->").next().unwrap().contains("--")
    );
}

/// A zero of axis 3 that is 0.1 degrees off moves the wrist, 820 mm along the forearm, by 1.431 mm across it, and so does `a4`: entered
/// alone, the zero takes away what hid the length.
#[test]
fn what_each_file_brings_is_said() {
    let zero = 0.1f64.to_radians();
    let mut robot = kr60();
    robot.nominal = Some(Box::new(kr60()));
    robot.geometry.rows[2].theta += zero;
    robot.geometry.rows[3].a += 820.0 * zero;
    let result = identified_by_circles(&robot);
    let output = dbbd(result.path(), &["export", "out", "--for", "kuka", "--out", "kuka", "--json"]);
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    assert!(codes(&output).contains(&"W1726".to_owned()), "{}", stderr(&output));
    let document: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let steps = document["steps"].as_array().unwrap();
    let of = |at: usize, key: &str| steps[at][key].as_f64().unwrap();
    assert_eq!(steps[0]["files"], serde_json::json!(["mastering.csv"]));
    // The wrist is 1.4 mm off after it, and was 0.25 mm off along the forearm and as far at the ball by the turn.
    assert!(of(0, "before_mm") < 0.6 && of(0, "after_mm") > 0.8, "{steps:?}");
    assert_eq!(steps[1]["files"], serde_json::json!(["mastering.csv", "machine-data.txt"]));
    assert!(of(1, "after_mm") < 0.1 && of(1, "before_mm") == of(0, "before_mm"), "{steps:?}");
}

/// A directory with the result `out` of exact lengths of a robot on three circles.
fn identified_by_circles(truth: &Robot) -> tempfile::TempDir {
    let circles = three_planes(1, CENTRE);
    let dir = tempdir().unwrap();
    fs::write(dir.path().join("obs.csv"), measure(truth, &circles, 27, 25.0).to_csv()).unwrap();
    fs::write(dir.path().join("centres.csv"), centres_csv(&circles)).unwrap();
    let args = ["identify", "obs.csv", "--robot", "kr60ha", "--tool", "30,20,10", "--centres", "centres.csv"];
    // Offsets and URDF have no errors of the joints.
    let more =
        ["--out", "out", "--folds", "0", "--sigma", "0.001", "--hold", "bar_offset", "--model", "geometric"];
    let output = dbbd(dir.path(), &[&args[..], &more].concat());
    assert!(matches!(output.status.code(), Some(0 | 3)), "{}", stderr(&output));
    dir
}

/// Errors of the zero position of joints of either sense: an axis that displays A is at A + offset, so the nominal robot at A + offset
/// is where the true one is at A.
#[test]
fn mastering_offsets_have_the_sense_of_the_axes() {
    let (two, four) = (0.05f64.to_radians(), 0.03f64.to_radians());
    let truth = with_errors([("theta2", two), ("theta4", four)]);
    let dir = identified_by_circles(&truth);
    let output = dbbd(dir.path(), &["export", "out", "--for", "kuka", "--out", "kuka"]);
    assert!(codes(&output).contains(&"I1722".to_owned()), "{}", stderr(&output));
    let table = fs::read_to_string(dir.path().join("kuka/mastering.csv")).unwrap();
    let rows: Vec<Vec<&str>> = table.lines().skip(1).map(|line| line.split(',').collect()).collect();
    let offset: Vec<f64> = rows.iter().map(|row| row[1].parse().unwrap()).collect();
    // The angle of the table is sign * A + offset, and joint 4 of a KUKA has the opposite sense of its axis.
    for (found, expected) in offset.iter().zip([0.0, 0.05, 0.0, -0.03, 0.0, 0.0]) {
        assert!((found - expected).abs() < 2e-3, "{offset:?}");
    }
    let identified: Vec<&str> = rows.iter().map(|row| row[3]).collect();
    assert_eq!(identified, ["no", "yes", "yes", "yes", "yes", "no"]);
    let shown = [10.0f64, -70.0, 80.0, 20.0, 40.0, -30.0];
    let stands: [f64; 6] = std::array::from_fn(|i| (shown[i] + offset[i]).to_radians());
    let truly = truth.geometry.ball(&shown.map(f64::to_radians)).position;
    assert!((kr60().geometry.ball(&stands).position - truly).norm() < 0.05);

    let data = fs::read_to_string(dir.path().join("kuka/DBB_RESULT.dat")).unwrap();
    assert!(data.is_ascii() && data.lines().all(|line| line.len() < 200) && data.contains("\r\n"));
    let parsed = krl::parse_data("DBB_RESULT.dat", &data).unwrap();
    let text = format!("{parsed:?}");
    for name in ["DBB_TOOL", "DBB_BALL1", "DBB_MASTERING"] {
        assert!(text.contains(name), "{name}");
    }
    // The URDF is of the identified robot.
    let output = dbbd(dir.path(), &["export", "out", "--for", "urdf", "--out", "urdf"]);
    assert!(!codes(&output).contains(&"I1722".to_owned()), "{}", stderr(&output));
    let urdf = fs::read_to_string(dir.path().join("urdf/robot-identified.urdf")).unwrap();
    let toml = fs::read_to_string(dir.path().join("out/robot-identified.toml")).unwrap();
    let found = Robot::from_toml("robot-identified.toml", &toml).unwrap();
    let axes = shown.map(f64::to_radians);
    assert!((ball_of(&urdf, &axes) - found.geometry.ball(&axes).position).norm() < 1e-9);
}

/// The largest number of a kind that the document of an export has under `left_out`.
fn left_out_mm(output: &std::process::Output) -> Option<f64> {
    let document: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    document["left_out"]["max_mm"].as_f64()
}

/// A calibrated arm of Universal Robots: the YAML is read back as the same arm.
#[test]
fn the_file_of_ros_is_read_back() {
    let dir = tempdir().unwrap();
    let nominal = named("ur10e");
    let found =
        Robot { nominal: Some(Box::new(nominal.clone())), ..truth::draw_true_robot(&nominal, 3, 1.0) };
    let mut found = Robot { geometry: found.geometry.rigid(), ..found };
    // Where the base is in the room is not part of the file's form.
    (found.geometry.rows[0].alpha, found.geometry.rows[0].a) = (0.0, 0.0);
    fs::write(dir.path().join("found.toml"), found.to_toml().unwrap()).unwrap();
    let output = dbbd(dir.path(), &["export", "found.toml", "--for", "ros", "--out", "ros", "--json"]);
    assert_eq!((output.status.code(), left_out_mm(&output)), (Some(0), None), "{}", stderr(&output));
    let yaml = "ros/robot_calibration.yaml";
    assert!(dir.path().join("ros/robot-identified.urdf").is_file());
    let output = dbbd(dir.path(), &["robots", "import", yaml, "--robot", "ur10e", "--out", "again.toml"]);
    assert!(matches!(output.status.code(), Some(0 | 3)), "{}", stderr(&output));
    let again = fs::read_to_string(dir.path().join("again.toml")).unwrap();
    let again = Robot::from_toml("again.toml", &again).unwrap();
    for axes in Workspace::uniform(&nominal, 50, 1) {
        let off = (again.geometry.flange(&axes).position - found.geometry.flange(&axes).position).norm();
        assert!(off < 1e-6, "{off} mm");
    }
    // A KUKA has no such file.
    fs::write(dir.path().join("kuka.toml"), kr60().to_toml().unwrap()).unwrap();
    assert_eq!(
        dbbd(dir.path(), &["export", "kuka.toml", "--for", "ros", "--out", "no"]).status.code(),
        Some(0)
    );
    assert!(!dir.path().join("no/robot_calibration.yaml").exists());
}

/// Zeros need the result, machine data a KUKA.
#[test]
fn what_a_target_needs_is_asked_for() {
    let dir = tempdir().unwrap();
    let found = with_errors([("theta2", 1e-3), ("a2", 0.5)]);
    let found = Robot { nominal: Some(Box::new(kr60())), ..found };
    fs::write(dir.path().join("found.toml"), found.to_toml().unwrap()).unwrap();
    for target in ["kuka", "fanuc", "abb", "yaskawa", "staubli"] {
        let output = dbbd(dir.path(), &["export", "found.toml", "--for", target, "--out", "out"]);
        assert_eq!((output.status.code(), codes(&output)), (Some(1), vec!["E1725".to_owned()]), "{target}");
    }
    let fanuc = HandBackTarget::ZerosOnly(Some(Language::Fanuc));
    let refused = HandBack::of(fanuc, &found, None, &Provenance::default()).err().unwrap();
    assert!(matches!(refused.finding::<ReportFinding>(), Some(ReportFinding::OtherMake { .. })), "{refused}");
    let output = dbbd(dir.path(), &["export", "kr60ha", "--for", "robodk", "--out", "dk", "--json"]);
    assert_eq!((output.status.code(), left_out_mm(&output)), (Some(0), None), "{}", stderr(&output));
    let table = fs::read_to_string(dir.path().join("dk/robodk.csv")).unwrap();
    assert!(table.contains("\n2,-90.0,350.0,0.0,0.0,0.0,1.0\n"), "{table}");
    let again = dbbd(dir.path(), &["export", "kr60ha", "--for", "robodk", "--out", "dk"]);
    assert_eq!(again.status.code(), Some(1));
}

/// By lengths and angles alone the ball is that of the URDF, and what these leave out is part of the standard deviation.
#[test]
fn a_prediction_by_the_table_is_the_ball_of_the_urdf() {
    let dir = tempdir().unwrap();
    let mut found = Robot { nominal: Some(Box::new(kr60())), ..with_errors([("theta2", 1e-3)]) };
    found.geometry.gear[1] = [1e-3, 0.0];
    fs::write(dir.path().join("found.toml"), found.to_toml().unwrap()).unwrap();
    fs::write(
        dir.path().join("axes.csv"),
        "a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg\n10,-70,80,20,40,-30\n",
    )
    .unwrap();
    let output = dbbd(dir.path(), &["export", "found.toml", "--for", "mujoco", "--out", "out", "--json"]);
    assert_eq!(codes(&output), ["I1722"]);
    assert!(left_out_mm(&output).unwrap() > 0.5 && dir.path().join("out/joint-errors.csv").is_file());
    let predict = |model: &[&str]| {
        let given = ["predict", "axes.csv", "--robot", "found.toml", "--out", "p.csv"];
        let output = dbbd(dir.path(), &[&given[..], model].concat());
        assert!(matches!(output.status.code(), Some(0 | 3)), "{}", stderr(&output));
        let table = fs::read_to_string(dir.path().join("p.csv")).unwrap();
        let row: Vec<f64> =
            table.lines().nth(1).unwrap().split(',').map(|cell| cell.parse().unwrap()).collect();
        (Vector3::new(row[12], row[13], row[14]), row[15])
    };
    let ((whole, sd), (table, table_sd)) = (predict(&[]), predict(&["--model", "geometric"]));
    let axes = [10.0f64, -70.0, 80.0, 20.0, 40.0, -30.0].map(f64::to_radians);
    let urdf = fs::read_to_string(dir.path().join("out/robot-identified.urdf")).unwrap();
    assert!((ball_of(&urdf, &axes) - table).norm() < 1e-9);
    let left_out = (whole - table).norm();
    // A milliradian times the cosine of A2, at more than a metre from axis 2.
    assert!((0.3..1.0).contains(&left_out), "{left_out}");
    assert!((table_sd - sd.hypot(left_out)).abs() < 1e-9);
}
