//! The closed loop: a robot drawn from the tolerance, identified from lengths with noise, and a
//! production program before and after it was compensated.

use dbbd::identifiability::aligned_distances;
use dbbd::identify::{Options, Prior, identify};
use dbbd::krl::compensate::compensate;
use dbbd::krl::production::{Files, Given, Position, Text, read};
use dbbd::model::{Centre, Geometry, ParamId, Pose, Robot, inverse};
use dbbd::sim::truth;
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

use crate::cell::{CENTRE, Circle, kr60, measure, three_planes};

/// Standard deviation of a length, mm.
const SIGMA_MM: f64 = 0.02;

/// `true_robot` identified from lengths on circles, with noise.
fn identified(true_robot: &Robot, circles: &[Circle], points: usize, prior: Prior, seed: u64) -> Robot {
    let mut random = Pcg64::seed_from_u64(seed);
    let mut lengths = measure(true_robot, circles, points, 45.0);
    for row in &mut lengths.rows {
        row.length_mm += SIGMA_MM * random.sample::<f64, _>(StandardNormal);
    }
    let mut centres: Vec<Centre> = circles
        .iter()
        .map(|circle| Centre { id: circle.number, position: Vector3::from(circle.centre) })
        .collect();
    centres.dedup_by_key(|centre| centre.id);
    // The bar's length is known: lengths about one value tell it and the robot's size only together.
    let hold = vec![ParamId::BarOffset(1)];
    let options = Options { sigma_mm: Some(SIGMA_MM), folds: Some(0), prior, hold, ..Options::default() };
    identify(&kr60(), &lengths, &centres, None, &options).unwrap().robot
}

/// A program of PTP motions to `count` random poses with the tool within 30 deg of straight down (the whole
/// workspace: any orientation), and what it moves to, by the robot's nominal tool ball.
fn production(count: usize, cube: bool, seed: u64) -> String {
    let robot = kr60();
    let mut random = Pcg64::seed_from_u64(seed);
    let [x, y, z] = <[f64; 3]>::from(robot.geometry.tool);
    let frame = |[x, y, z]: [f64; 3]| format!("{{X {x:.3},Y {y:.3},Z {z:.3},A 0.0,B 0.0,C 0.0}}");
    let mut program = format!("DEF P ( )\n$TOOL={}\n$BASE={}\n", frame([x, y, z]), frame([0.0; 3]));
    let mut written = 0;
    while written < count {
        let axes = if cube {
            let xyz_mm = CENTRE.map(|middle| middle + random.random_range(-500.0..500.0));
            let [a, b, c] = [180.0, 30.0, 30.0].map(|range| random.random_range(-range..range));
            let ball = Pose::from_kuka(xyz_mm, [a, b, 180.0 + c]);
            let Ok(all) = inverse::branches(&robot.geometry, &ball) else { continue };
            // The branch in front with the elbow up: S 2, as on the circles.
            let front = all.into_iter().find(|axes| inverse::status(&robot.geometry, axes) == 2);
            let Some(axes) = front else { continue };
            axes
        } else {
            std::array::from_fn(|i| {
                let [low, high] = robot.limits_deg[i];
                random.random_range(low..high).to_radians()
            })
        };
        // Away from limits, from a straight wrist, and from signs that a correction would change.
        let inside = (0..6).all(|i| {
            let ([low, high], deg) = (robot.limits_deg[i], axes[i].to_degrees());
            (low + 1.0..high - 1.0).contains(&deg) && deg.abs() > 1.0
        });
        let clear = inverse::clearance(&robot.geometry, &axes).unwrap();
        if !inside
            || clear.wrist.to_degrees() < 10.0
            || clear.elbow.to_degrees() < 10.0
            || clear.overhead < 200.0
        {
            continue;
        }
        let ball = robot.geometry.ball(&axes);
        let ([x, y, z], [a, b, c]) = (<[f64; 3]>::from(ball.position), ball.abc_deg());
        let (s, t) = (inverse::status(&robot.geometry, &axes), inverse::turn(&axes));
        program.push_str(&format!(
            "PTP {{X {x:.3},Y {y:.3},Z {z:.3},A {a:.4},B {b:.4},C {c:.4},S {s},T {t}}}\n"
        ));
        written += 1;
    }
    program + "END\n"
}

/// Where the program is taught to go, and where `robot` comes under the nominal controller, mm.
fn positions(program: &str, robot: &Robot) -> Vec<(Vector3<f64>, Vector3<f64>)> {
    let nominal = kr60();
    let files = Files { source: Text { file: "P.src", text: program }, data: None, config: None };
    let points = read(files, Given::default()).unwrap().points;
    let come = points.iter().map(|point| {
        let Position::Pose { numbers, status, turn, .. } = &point.position else { panic!("no pose") };
        let [x, y, z, a, b, c] = numbers.each_ref().map(|number| number.value);
        let ball = Pose::from_kuka([x, y, z], [a, b, c]);
        let (s, t) = (status.unwrap() as u8, turn.unwrap() as u8);
        let axes = inverse::from_status_turn(&nominal, &ball, s, t).unwrap();
        let there = Geometry { tool: nominal.geometry.tool, ..robot.geometry.clone() };
        (ball.position, there.ball(&axes).position)
    });
    come.collect()
}

/// Mean 3-D error after one rigid alignment, before and after the compensation, mm.
fn errors(true_robot: &Robot, found: &Robot, cube: bool) -> [f64; 2] {
    let program = production(200, cube, 7);
    let files = Files { source: Text { file: "P.src", text: &program }, data: None, config: None };
    let points = read(files, Given::default()).unwrap();
    let corrected = compensate(files, &points, found, 50.0).map_err(|refused| refused.to_string()).unwrap();
    let wanted: Vec<_> = positions(&program, true_robot).into_iter().map(|(taught, _)| taught).collect();
    [program, corrected.source].map(|program| {
        let come: Vec<_> = positions(&program, true_robot).into_iter().map(|(_, come)| come).collect();
        let off = aligned_distances(&come, &wanted);
        off.iter().sum::<f64>() / off.len() as f64
    })
}

/// One ball in the cube, or three balls.
fn circles(balls: usize) -> Vec<Circle> {
    // The second and third at other radii and heights.
    let centres = [CENTRE, [1000.0, 500.0, 1300.0], [1500.0, -300.0, 400.0]];
    centres.iter().take(balls).enumerate().flat_map(|(at, centre)| three_planes(at + 1, *centre)).collect()
}

fn loop_once(seed: u64, balls: usize, points: usize, prior: Prior, cube: bool) -> [f64; 2] {
    let true_robot = truth::draw(&kr60(), seed, 1.0);
    let found = identified(&true_robot, &circles(balls), points, prior, seed);
    errors(&true_robot, &found, cube)
}

#[test]
fn a_compensated_program_is_more_accurate() {
    for seed in [1, 2] {
        let [before, after] = loop_once(seed, 1, 27, Prior::None, true);
        assert!(before > 8.0 * after, "seed {seed}: {before:.3} mm before, {after:.3} mm after");
    }
}

/// `cargo test --release --test suite closed_loop -- --ignored --nocapture`: the figures of docs/krl.md.
#[test]
#[ignore = "prints figures"]
fn closed_loop_over_twenty_robots() {
    for (balls, points, cube) in [(1, 27, true), (3, 27, false), (3, 27, true)] {
        for prior in [Prior::None, Prior::Datasheet] {
            let factors: Vec<[f64; 3]> = (1..=20)
                .map(|seed| {
                    let [before, after] = loop_once(seed, balls, points, prior.clone(), cube);
                    [before / after, before, after]
                })
                .collect();
            let least = factors.iter().map(|f| f[0]).fold(f64::INFINITY, f64::min);
            let mean = |at: usize| factors.iter().map(|f| f[at]).sum::<f64>() / factors.len() as f64;
            eprintln!(
                "{balls} ball(s), {} poses, {}, {prior:?}: least factor {least:.1}, mean {:.1}; \
                 mean error {:.4} mm before, {:.4} mm after",
                balls * 3 * points,
                if cube { "cube" } else { "whole workspace" },
                mean(0),
                mean(1),
                mean(2)
            );
        }
    }
}
