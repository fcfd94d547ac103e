//! Payloads: a robot that was identified without one states more for it, and less once rows were measured with it.

use std::fs;
use std::path::Path;

use dbbd_model::measurement::{Datum, Measurement, Measurements};
use dbbd_model::robot::{Approach, AxisAngles, BallId, BarId, Payload, PayloadId, Robot, TargetId};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;
use tempfile::tempdir;

use crate::cell::{codes, dbbd, stderr};

const BALLS: [[f64; 3]; 2] = [[1300.0, 0.0, 800.0], [300.0, 1300.0, 400.0]];

const PAYLOADS: &str = "
[[payload]]
name = \"bar\"
kg = 0.0
centre_mm = [0.0, 0.0, 0.0]

[[payload]]
name = \"gripper\"
kg = 50.0
centre_mm = [0.0, 0.0, 150.0]
";

/// The kr60ha that carries nothing or 50 kg, whose joints 2 and 3 give way.
fn truth() -> Robot {
    let text = format!("{}{PAYLOADS}", crate::cell::KR60HA);
    let mut robot = Robot::from_toml("robot.toml", &text).unwrap();
    let errors = [("a1", 0.3), ("d4", -0.2), ("theta2", 5e-4), ("theta3", -6e-4), ("alpha4", 4e-4)];
    for (name, error) in errors.into_iter().chain([("compliance2", 2e-7), ("compliance3", 3e-7)]) {
        *robot.geometry.value_mut(name.parse().unwrap()).unwrap() += error;
    }
    robot
}

/// Lengths of a robot at 60 poses to each ball, with the payload of this place in its file.
fn lengths(robot: &Robot, payload: usize, first: u32) -> Vec<Measurement> {
    let mut random = Pcg64::seed_from_u64(7);
    let ranges =
        [[-70.0, 70.0], [-110.0, -40.0], [60.0, 130.0], [-90.0, 90.0], [-90.0, 90.0], [-120.0, 120.0]];
    let mut robot = robot.clone();
    robot.geometry.load.payloads.swap(0, payload);
    let mut rows = Vec::new();
    for _ in 0..60 {
        let axes = AxisAngles::from_degrees(ranges.map(|[low, high]| random.random_range(low..high)));
        for (ball, place) in BALLS.into_iter().enumerate() {
            let noise_mm = 0.005 * random.sample::<f64, _>(StandardNormal);
            rows.push(Measurement {
                index: first + rows.len() as u32,
                datum: Datum::Ball(BallId::at(ball), BarId::FIRST),
                target: TargetId::FIRST,
                axes,
                approach: Approach::default(),
                length_mm: robot.geometry.length(&axes.radians(), &Vector3::from(place), 0.0) + noise_mm,
                sigma_mm: Some(0.005),
                payload: PayloadId::at(payload),
                context: None,
            });
        }
    }
    rows
}

/// Identifies from lengths of the unloaded arm, and of the loaded one too if `loaded`.
fn identify(at: &Path, loaded: bool) {
    let mut rows = lengths(&truth(), 0, 1);
    if loaded {
        rows.extend(lengths(&truth(), 1, 1 + rows.len() as u32));
    }
    let payloads = if loaded { vec!["bar".into(), "gripper".into()] } else { Vec::new() };
    let data = Measurements { rows, payloads, ..Measurements::default() };
    let robot = format!("{}{PAYLOADS}", crate::cell::KR60HA);
    fs::write(at.join("robot.toml"), robot).unwrap();
    fs::write(at.join("obs.csv"), data.to_csv()).unwrap();
    let [[x, y, z], [u, v, w]] = BALLS;
    let balls = format!("centre,x_mm,y_mm,z_mm\n1,{x},{y},{z}\n2,{u},{v},{w}\n");
    fs::write(at.join("centres.csv"), balls).unwrap();
    let args = ["identify", "obs.csv", "--robot", "robot.toml", "--centres", "centres.csv", "--out", "o"];
    let done = dbbd(at, &[&args[..], &["--bar-u", "0.002", "--folds", "0"]].concat());
    assert!(matches!(done.status.code(), Some(0 | 3)), "{}", stderr(&done));
}

/// Mean `sd_mm` and `sd_mrad`, and the places, mm.
fn predict(at: &Path, more: &[&str], code: i32) -> ([f64; 2], Vec<Vector3<f64>>) {
    let poses = "a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg\n0,-60,90,10,40,0\n30,-40,70,-20,60,30\n-40,-90,100,0,50,10\n";
    fs::write(at.join("axes.csv"), poses).unwrap();
    let args = ["predict", "axes.csv", "--robot", "o/robot-identified.toml", "--out", "p.csv"];
    let done = dbbd(at, &[&args[..], more].concat());
    assert_eq!(done.status.code(), Some(code), "{more:?} {}", stderr(&done));
    let text = fs::read_to_string(at.join("p.csv")).unwrap();
    let rows: Vec<Vec<f64>> = text
        .lines()
        .skip(1)
        .map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect())
        .collect();
    let mean = |column: usize| rows.iter().map(|row| row[column]).sum::<f64>() / rows.len() as f64;
    ([mean(15), mean(16)], rows.iter().map(|row| Vector3::new(row[12], row[13], row[14])).collect())
}

#[test]
fn a_payload_that_was_never_measured_is_a_wider_number_and_a_warning() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    identify(at, false);
    let ([own, turned], there) = predict(at, &[], 0);
    let ([loaded, _], below) = predict(at, &["--payload", "gripper"], 3);
    assert!(loaded > 1.2 * own && turned > 0.0, "{own} {loaded}");
    // 50 kg at the end of the arm press it down by some tenths of a millimetre.
    let sag = there.iter().zip(&below).map(|(there, below)| there.z - below.z).fold(0.0, f64::max);
    assert!((0.1..2.0).contains(&sag), "{sag}");
    // The same by its numbers; and as much as the holder of a bar is no other payload.
    let ([by_numbers, _], _) = predict(at, &["--payload", "50,0,0,150"], 3);
    assert!((by_numbers - loaded).abs() < 1e-9);
    predict(at, &["--payload", "2,0,0,50"], 0);

    let args = ["predict", "axes.csv", "--robot", "o/robot-identified.toml", "--out", "p.csv"];
    let warned = dbbd(at, &[&args[..], &["--payload", "gripper"]].concat());
    assert!(codes(&warned).contains(&"W0583".to_owned()), "{}", stderr(&warned));
    for (wrong, code) in [("grippr", "E0582"), ("50", "E0582"), ("50,0,0", "E0582"), ("-5,0,0,0", "E0130")] {
        let refused = dbbd(at, &[&args[..], &["--payload", wrong]].concat());
        assert_eq!((refused.status.code(), codes(&refused)), (Some(1), vec![code.to_owned()]), "{wrong}");
    }

    // A row with a name that the robot file does not have.
    let rows = fs::read_to_string(at.join("obs.csv")).unwrap();
    let named: String = rows
        .lines()
        .enumerate()
        .map(|(at, row)| format!("{row},{}\n", if at == 0 { "payload" } else { "fork" }))
        .collect();
    fs::write(at.join("named.csv"), named).unwrap();
    let args = ["identify", "named.csv", "--robot", "robot.toml", "--centres", "centres.csv", "--out", "n"];
    let refused = dbbd(at, &args);
    assert_eq!((refused.status.code(), codes(&refused)), (Some(1), vec!["E0582".to_owned()]));
    assert!(stderr(&refused).contains("bar, gripper"), "{}", stderr(&refused));

    // Measured with it: no warning, and the number is that of the load itself.
    identify(at, true);
    let identified = fs::read_to_string(at.join("o/robot-identified.toml")).unwrap();
    let identified = Robot::from_toml("robot-identified.toml", &identified).unwrap();
    let payloads: Vec<(&str, bool)> = identified
        .geometry
        .load
        .payloads
        .iter()
        .map(|Payload { name, is_measured, .. }| (name.as_str(), *is_measured))
        .collect();
    assert_eq!(payloads, [("bar", true), ("gripper", true)]);
    let ([measured, _], place) = predict(at, &["--payload", "gripper"], 0);
    assert!(measured < loaded, "{measured} {loaded}");
    let true_sag = |axes: [f64; 6]| {
        let mut carrying = truth();
        let axes = axes.map(f64::to_radians);
        let free = carrying.geometry.ball(&axes).position.z;
        carrying.geometry.load.carry("gripper").unwrap();
        free - carrying.geometry.ball(&axes).position.z
    };
    let (_, free) = predict(at, &[], 0);
    for (at, axes) in
        [[0.0, -60.0, 90.0, 10.0, 40.0, 0.0], [30.0, -40.0, 70.0, -20.0, 60.0, 30.0]].into_iter().enumerate()
    {
        let (found, true_sag) = (free[at].z - place[at].z, true_sag(axes));
        assert!((found - true_sag).abs() < 0.15 * true_sag, "{found} for {true_sag}");
    }
}

/// A point of the tool, whose place on the flange is exact, turns with the flange.
#[test]
fn any_point_of_a_tool_is_predicted() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    identify(at, false);
    let (_, near) = predict(at, &["--tool", "0,0,100"], 0);
    let ([far_sd, turned], far) = predict(at, &["--tool", "0,0,600,0,90,0"], 0);
    let ([near_sd, again], _) = predict(at, &["--tool", "0,0,100"], 0);
    assert!(near.iter().zip(&far).all(|(near, far)| ((far - near).norm() - 500.0).abs() < 1e-6));
    assert!(far_sd > near_sd && (turned - again).abs() < 1e-12, "{near_sd} {far_sd}");
    let wrong = dbbd(at, &["predict", "axes.csv", "--robot", "kr60ha", "--tool", "1,2", "--out", "q.csv"]);
    assert_eq!(wrong.status.code(), Some(2), "{}", stderr(&wrong));
}

/// Two runs of one cell, with another payload each, and a bar that pulls: each row says so, and together they are one measurement.
#[test]
fn a_run_names_its_payload_and_the_pull_of_its_bar() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    let robot = format!("{}{PAYLOADS}", crate::cell::KR60HA);
    fs::write(at.join("robot.toml"), robot).unwrap();
    let job = |payload: &str, force: &str| {
        format!(
            "robot = \"robot.toml\"\n{payload}[bar]\nlength_mm = 300.0\nstroke_mm = [-5.0, 5.0]\nmargin_mm = 0.5\n{force}\
             [[centre]]\nid = 1\nxyz_mm = [1300.0, 0.0, 800.0]\n\
             [[circle]]\nplane = \"XY\"\npoints = 12\ntilt_deg = 30.0\namplitude_deg = 25.0\n"
        )
    };
    for (payload, seed) in [("bar", "1"), ("gripper", "2")] {
        let text = job(&format!("payload = \"{payload}\"\n"), "force_n = 20.0\n");
        fs::write(at.join(format!("{payload}.toml")), text).unwrap();
        let plan = dbbd(at, &["plan", &format!("{payload}.toml"), "--out", payload]);
        assert!(matches!(plan.status.code(), Some(0 | 3)), "{}", stderr(&plan));
        assert!(String::from_utf8_lossy(&plan.stdout).contains(&format!("carries `{payload}`")));
        let (plan, run) = (format!("{payload}/plan.csv"), format!("{payload}.dbbd"));
        let measured =
            dbbd(at, &["acquire", "--port", "sim", "--seed", seed, "--plan", &plan, "--out", &run]);
        assert!(matches!(measured.status.code(), Some(0 | 3)), "{}", stderr(&measured));
    }
    let args =
        ["identify", "bar.dbbd", "gripper.dbbd", "--estimate", "a1-2,bar", "--folds", "0", "--out", "o"];
    let done = dbbd(at, &args);
    assert!(matches!(done.status.code(), Some(0 | 3)), "{}", stderr(&done));
    let table = fs::read_to_string(at.join("o/lengths.csv")).unwrap();
    let table = Measurements::from_csv("lengths.csv", &table).unwrap();
    let carried = |name: &str| {
        let is_of = |row: &&Measurement| table.payloads[row.payload.index()] == name;
        table.rows.iter().filter(is_of).count()
    };
    assert!(
        carried("bar") >= 10 && carried("bar") == carried("gripper"),
        "{} {}",
        carried("bar"),
        table.rows.len()
    );
    assert_eq!(carried("bar") + carried("gripper"), table.rows.len());
    assert!(table.rows.iter().all(|row| row.context.as_ref().unwrap().force_n == Some(20.0)));

    for (payload, force, code) in [
        ("payload = \"fork\"\n", "", "E0582"),
        ("", "force_n = 5000.0\n", "E0130"),
        ("payload = 3\n", "", "E0120"),
    ] {
        fs::write(at.join("wrong.toml"), job(payload, force)).unwrap();
        let refused = dbbd(at, &["plan", "wrong.toml", "--out", "wrong"]);
        assert_eq!(
            (refused.status.code(), codes(&refused)),
            (Some(1), vec![code.to_owned()]),
            "{payload}{force}"
        );
    }
}

/// A centre in metres, an uncertainty in grams.
#[test]
fn payloads_in_other_units_are_refused() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    let check = |payload: &str| {
        let text = format!("{}[payload]\nname = \"gripper\"\n{payload}\n", crate::cell::KR60HA);
        fs::write(at.join("robot.toml"), text).unwrap();
        let checked = dbbd(at, &["robots", "check", "robot.toml"]);
        (checked.status.code(), codes(&checked))
    };
    assert_eq!(check("kg = 50.0\ncentre_mm = [0.0, 0.0, 150.0]\nu_kg = 0.5").0, Some(0));
    assert_eq!(check("kg = 0.0\ncentre_mm = [0.0, 0.0, 0.0]\nu_kg = 0.5").0, Some(0));
    assert_eq!(check("kg = 50.0\ncentre_mm = [0.0, 0.0, 0.15]"), (Some(1), vec!["E0130".into()]));
    assert_eq!(
        check("kg = 50.0\ncentre_mm = [0.0, 0.0, 150.0]\nu_kg = 500.0"),
        (Some(1), vec!["E0505".into()])
    );
}
