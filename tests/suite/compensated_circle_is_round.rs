//! A circular program before and after its compensation, evaluated by the circular test of ISO 230-4.

use std::fs;

use dbbd_job::program::Correction;
use dbbd_job::program::krl::{Files, Given, Program, Text, compensate, read};
use dbbd_job::sim::{SimulatedController, truth};
use dbbd_model::robot::{Geometry, Pose, Robot, inverse};
use nalgebra::Vector3;
use tempfile::tempdir;

use crate::cell::{CENTRE, RADIUS, dbbd, kr60, stderr};
use crate::support::production::{chosen, identified};

/// A full circle in each direction, vertical, in `arcs` arcs with a constant orientation of the tool.
fn circle(arcs: u32) -> String {
    let robot = kr60();
    let [x, y, z] = <[f64; 3]>::from(robot.geometry.tool);
    let at = |share: f64| {
        let (sin, cos) = (std::f64::consts::TAU * share).sin_cos();
        [CENTRE[0] + RADIUS * cos, CENTRE[1] + RADIUS * sin, CENTRE[2]]
    };
    let point = |share: f64| {
        let [x, y, z] = at(share);
        format!("{{X {x:.3},Y {y:.3},Z {z:.3},A 0.0000,B 20.0000,C 180.0000}}")
    };
    // The branch of production programs: in front of axis 1 with the elbow up.
    let branches = inverse::branches(&robot.geometry, &Pose::from_kuka(at(0.0), [0.0, 20.0, 180.0])).unwrap();
    let near = branches.into_iter().find(|axes| inverse::status(&robot.geometry, axes) == 2).unwrap();
    let [a1, a2, a3, a4, a5, a6] = near.map(f64::to_degrees);
    let mut text = format!(
        "DEF P ( )\n$TOOL={{X {x:.3},Y {y:.3},Z {z:.3},A 0.0,B 0.0,C 0.0}}\n$BASE=$NULLFRAME\n$VEL.CP=0.05\n\
         PTP {{A1 {a1:.4},A2 {a2:.4},A3 {a3:.4},A4 {a4:.4},A5 {a5:.4},A6 {a6:.4}}}\nLIN {}\n",
        point(0.0)
    );
    for sense in [1.0, -1.0] {
        for arc in 0..arcs {
            let share = |half: f64| sense * (f64::from(arc) + half) / f64::from(arcs);
            text.push_str(&format!("SCIRC {},{}\n", point(share(0.5)), point(share(1.0))));
        }
    }
    text + "END\n"
}

/// Radial deviation (LSC, both directions) by `dbbd circle` of the robot's motion under the program, mm.
fn deviation(program: &str, robot: &Robot) -> f64 {
    let program = program.replace("$NULLFRAME", "{X 0.0,Y 0.0,Z 0.0,A 0.0,B 0.0,C 0.0}");
    let program =
        Program::open("P", |name| Ok((name == "P.src").then(|| ("P.src".into(), program.clone())))).unwrap();
    let nominal = kr60();
    let true_arm = Geometry { tool: nominal.geometry.tool, ..robot.geometry.clone() };
    let mut controller = SimulatedController::new(program, &nominal, 100.0).unwrap();
    let mut csv = "run,direction,angle_deg,length_mm\n".to_owned();
    let mut before: Option<f64> = None;
    loop {
        let moment = controller.step(0.1).unwrap();
        if moment.done {
            break;
        }
        let found = nominal.geometry.ball(&moment.axes).position - Vector3::from(CENTRE);
        let angle = found.y.atan2(found.x).to_degrees();
        let moved =
            before.replace(angle).map_or(0.0, |before| (angle - before + 540.0).rem_euclid(360.0) - 180.0);
        if moment.motions < 3 || moved.abs() < 1e-3 {
            continue;
        }
        let length = (true_arm.ball(&moment.axes).position - Vector3::from(CENTRE)).norm();
        csv.push_str(&format!("1,{},{angle},{length}\n", if moved > 0.0 { "ccw" } else { "cw" }));
    }
    let dir = tempdir().unwrap();
    fs::write(dir.path().join("c.csv"), csv).unwrap();
    let output =
        dbbd(dir.path(), &["circle", "c.csv", "--radius", "300", "--monte-carlo", "0", "--out", "o"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let json = fs::read_to_string(dir.path().join("o/circle.json")).unwrap();
    serde_json::from_str::<serde_json::Value>(&json).unwrap()["G_lsc"].as_f64().unwrap()
}

/// Radial deviation before and after, mm, of circles of 2 and of 12 arcs, for each robot.
fn deviations(seeds: std::ops::RangeInclusive<u64>) -> [Vec<[f64; 2]>; 2] {
    let plan = chosen(1, 80, true);
    let mut pairs = [Vec::new(), Vec::new()];
    for seed in seeds {
        let robot = truth::draw_true_robot(&kr60(), seed, 1.0);
        let found = identified(&robot, &plan, seed);
        for (arcs, pairs) in [2, 12].into_iter().zip(&mut pairs) {
            let program = circle(arcs);
            let files = Files { source: Text { file: "P.src", text: &program }, data: None, config: None };
            let points = read(files, Given::default()).unwrap();
            let corrected = compensate(files, &points, Correction::of(&found.robot, 10.0)).unwrap().source;
            pairs.push([&program, &corrected].map(|program| deviation(program, &robot)));
        }
    }
    pairs
}

#[test]
fn compensated_circle_has_a_smaller_radial_deviation() {
    let [few, many] = deviations(1..=3);
    assert!(few.iter().all(|[before, after]| *after < before / 1.5), "{few:?}");
    assert!(many.iter().all(|[before, after]| *after < before / 4.0), "{many:?}");
}

/// `cargo test --release --test suite circles_of_twenty -- --ignored --nocapture`: docs/evidence/README.md.
#[test]
#[ignore = "prints figures"]
fn circles_of_twenty_robots() {
    for (arcs, mut pairs) in [2, 12].into_iter().zip(deviations(1..=20)) {
        pairs.sort_by(|a, b| (a[0] / a[1]).total_cmp(&(b[0] / b[1])));
        let mean = |at: usize| pairs.iter().map(|pair| pair[at]).sum::<f64>() / 20.0;
        let most = |at: usize| pairs.iter().map(|pair| pair[at]).fold(0.0, f64::max);
        eprintln!(
            "{arcs} arcs: before {:.4} mm ({:.4} at most), after {:.4} ({:.4}); factor {:.1} in the middle, {:.1} at least",
            mean(0),
            most(0),
            mean(1),
            most(1),
            pairs[10][0] / pairs[10][1],
            pairs[0][0] / pairs[0][1]
        );
    }
}
