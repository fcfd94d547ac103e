//! The closed loop through the commands: plan, krl, simulate, acquire, sync, identify and compensate on files; the simulated
//! controller executes the production program before and after.
#![cfg(unix)]

use std::fs;
use std::path::Path;

use dbbd_job::program::krl::Program;
use dbbd_job::sim::{SimulatedController, truth};
use dbbd_model::estimation::Workspace;
use dbbd_model::math::aligned_distances;
use dbbd_model::robot::{Geometry, Robot};
use nalgebra::Vector3;
use tempfile::tempdir;

use crate::cell::{RADIUS, dbbd, kr60, stderr};
use crate::process::Simulator;
use crate::support::production::{BALLS, OFF_MM, job, production, sagging, taught};

/// Error of each coordinate of the tool ball at each stop, which is the noise of a length; that of the bar is negligible.
const WORLD: &str = "repeatability_um = 20.0\n[bar]\nstroke_mm = [-15.0, 15.0]\nnoise_um = 1.0\n";

/// Runs a step; exit code 3 (a warning) is a result as well.
fn step(dir: &Path, args: &[&str]) -> Option<i32> {
    let output = dbbd(dir, args);
    assert!(matches!(output.status.code(), Some(0 | 3)), "dbbd {}: {}", args.join(" "), stderr(&output));
    output.status.code()
}

/// Plan and program of a job, and the production program with a stop at each point.
fn prepare(dir: &Path, bar_mm: f64, balls: usize, points: usize, cube: bool) {
    fs::write(dir.join("job.toml"), job(bar_mm, balls, points, cube)).unwrap();
    step(dir, &["plan", "job.toml", "--out", "plan", "--quiet"]);
    step(dir, &["krl", "plan/plan.csv", "--out", "krl", "--sync", "output", "--quiet"]);
    let program: String = production(200, cube, 7)
        .lines()
        .map(|line| format!("{line}\n{}", if line.starts_with("PTP") { "WAIT SEC 0.5\n" } else { "" }))
        .collect();
    fs::write(dir.join("P.src"), program).unwrap();
    let centre = |at: usize| {
        let [x, y, z]: [f64; 3] = std::array::from_fn(|axis| BALLS[at][axis] + OFF_MM[axis]);
        format!("[[centre]]\nid = {}\nxyz_mm = [{x:?}, {y:?}, {z:?}]\n", at + 1)
    };
    let world: String = (0..balls).map(centre).collect();
    fs::write(dir.join("world.toml"), WORLD.to_owned() + &world).unwrap();
}

/// The positions of the robot at the stops of a production program, mm.
fn stops(dir: &Path, program: &str, robot: &Robot) -> Vec<Vector3<f64>> {
    let program = Program::open("P", |name| {
        let file = dir.join(program).join(name);
        Ok(file.is_file().then(|| (name.to_owned(), fs::read_to_string(file).unwrap())))
    })
    .unwrap();
    let there = Geometry { tool: kr60().geometry.tool, ..robot.geometry.clone() };
    let mut controller = SimulatedController::new(program, &kr60(), 100.0).unwrap();
    let mut stops: Vec<Vector3<f64>> = Vec::new();
    loop {
        let moment = controller.step(0.2).unwrap();
        if moment.done {
            return stops;
        }
        // At the last moment of a motion the robot is at rest at its end.
        stops.resize(moment.motions as usize, Vector3::zeros());
        if let Some(stop) = stops.last_mut() {
            *stop = there.ball(&moment.axes).position;
        }
    }
}

fn loop_closed(dir: &Path, robot: &Robot, seed: u64) -> ClosedLoop {
    for left in ["run.dbbd", "link"] {
        let _ = fs::remove_file(dir.join(left));
    }
    fs::write(dir.join("truth.toml"), robot.to_toml().unwrap()).unwrap();
    let truth = ["--robot", "truth.toml", "--world", "world.toml", "--seed", &seed.to_string()];
    let program = ["--program", "krl/DBB_MAIN.src", "--speed", "0", "--link", "link", "--quiet"];
    let simulator = Simulator::start(dir, &[&program[..], &truth].concat());
    step(dir, &["acquire", "--port", "link", "--plan", "plan/plan.csv", "--out", "run.dbbd", "--quiet"]);
    assert!(simulator.finished().status.success());
    step(dir, &["sync", "run.dbbd", "--out", "obs.csv", "--quiet"]);
    let identify = "identify obs.csv --robot kr60ha --tool 30,20,10 --centres plan/centres.csv --sigma 0.02 --hold bar --prior datasheet \
                    --folds 0 --out result --quiet";
    let has_warnings =
        step(dir, &identify.split(' ').filter(|word| !word.is_empty()).collect::<Vec<_>>()) == Some(3);
    let compensate =
        "compensate P.src --robot result/robot-identified.toml --limit 50 --out new --replace --json";
    let output = dbbd(dir, &compensate.split(' ').collect::<Vec<_>>());
    let corrected: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let predicted =
        |what: &str| corrected["predicted_position_uncertainty_mm"][what]["mean"].as_f64().unwrap();
    // The flange of this robot is as exact as an identification assumes.
    let flange = predicted("flange");
    let predicted = ["before", "after"].map(|when| (predicted(when).powi(2) - flange * flange).sqrt());
    let program = fs::read_to_string(dir.join("P.src")).unwrap();
    let wanted: Vec<_> = taught(&program).into_iter().map(|(ball, _)| ball.position).collect();
    let errors = [".", "new"].map(|program| {
        let off = aligned_distances(&stops(dir, program, robot), &wanted);
        off.iter().sum::<f64>() / off.len() as f64
    });
    ClosedLoop { errors, predicted, has_warnings }
}

/// A production program before and after its correction.
struct ClosedLoop {
    /// Mean 3-D error, mm.
    errors: [f64; 2],
    /// What `compensate` expects of it.
    predicted: [f64; 2],
    /// Whether the result has warnings.
    has_warnings: bool,
}

#[test]
fn one_robot_is_more_accurate_after_correction() {
    let dir = tempdir().unwrap();
    prepare(dir.path(), RADIUS, 1, 40, true);
    let ClosedLoop { errors: [before, after], predicted, .. } =
        loop_closed(dir.path(), &truth::draw_true_robot(&kr60(), 1, 1.0), 1);
    assert!(before > 0.3 && after < before / 8.0, "{before} {after}");
    // Of one robot: before is known from the correction. The prediction after it reckons with errors of joints, which this
    // robot does not have.
    assert!((predicted[0] / before - 1.0).abs() < 0.15, "{predicted:?} {before}");
    assert!((0.5..3.5).contains(&(predicted[1] / after)), "{predicted:?} {after}");
    // The points lie near each other: aligned over the whole robot they share an error.
    let pose = |axes: [f64; 6]| axes.map(|angle| angle.to_degrees().to_string()).join(",") + "\n";
    let poses: String = Workspace::uniform(&kr60(), 2000, 1).into_iter().map(pose).collect();
    let table = format!("a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg\n{poses}");
    fs::write(dir.path().join("poses.csv"), table).unwrap();
    let in_datum = |datum: &str| {
        let compensate = "compensate P.src --robot result/robot-identified.toml --limit 50 --out new --replace --json --datum";
        let output = dbbd(dir.path(), &[&compensate.split(' ').collect::<Vec<_>>()[..], &[datum]].concat());
        let corrected: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(corrected["datum"], datum);
        corrected["predicted_position_uncertainty_mm"]["after"]["mean"].as_f64().unwrap()
    };
    let [program, workspace, table] = ["program", "workspace", "poses.csv"].map(in_datum);
    assert!(program >= predicted[1] && workspace > 1.2 * program, "{program} {workspace}");
    // The same poses, with the digits of a table.
    assert!((table / workspace - 1.0).abs() < 1e-6, "{table} {workspace}");
}

/// `cargo test --release --test suite through_the_programs -- --ignored --nocapture`: docs/evidence/README.md.
#[test]
#[ignore = "takes minutes"]
fn twenty_robots_through_the_programs() {
    for (bar_mm, balls, points, cube) in
        [(RADIUS, 1, 80, true), (RADIUS, 1, 320, true), (600.0, 1, 80, true), (RADIUS, 3, 240, false)]
    {
        let dir = tempdir().unwrap();
        prepare(dir.path(), bar_mm, balls, points, cube);
        for sag in [false, true] {
            let mut all: Vec<([f64; 2], bool)> = (1..=20)
                .map(|seed| {
                    let drawn = truth::draw_true_robot(&kr60(), seed, 1.0);
                    let found = loop_closed(dir.path(), &if sag { sagging(drawn) } else { drawn }, seed);
                    (found.errors, found.has_warnings)
                })
                .collect();
            all.sort_by(|([a, b], _), ([c, d], _)| (a / b).total_cmp(&(c / d)));
            let factor = |at: usize| all[at].0[0] / all[at].0[1];
            let mean = |at: usize| all.iter().map(|(pair, _)| pair[at]).sum::<f64>() / 20.0;
            eprintln!(
                "bar of {bar_mm} mm, {balls} ball(s), {points} poses, {}{}: before {:.3} mm, after {:.4}; factor {:.1} in the middle, {:.1} at \
                 least ({:.3} -> {:.4} mm); {} of 20 with a warning",
                if cube { "cube" } else { "whole workspace" },
                if sag { ", sag" } else { "" },
                mean(0),
                mean(1),
                factor(10),
                factor(0),
                all[0].0[0],
                all[0].0[1],
                all.iter().filter(|(_, has_warnings)| *has_warnings).count()
            );
        }
    }
}
