//! The closed loop: a robot drawn from the tolerance, measured with noise at the poses of a plan, identified, and a production program
//! before and after its compensation.

use dbbd_job::plan::Plan;
use dbbd_job::program::Correction;
use dbbd_job::program::krl::{Files, Given, Text, compensate, read};
use dbbd_job::sim::truth;
use dbbd_model::diagnostic::Severity;
use dbbd_model::estimation::CompletedCalibration;
use dbbd_model::math::aligned_distances;
use dbbd_model::robot::{Geometry, Robot};
use nalgebra::Vector3;

use crate::test_support::cell::kr60;
use crate::test_support::production::{chosen, identified, production, sagging, taught};

/// The positions that `robot` reaches under the nominal controller, mm.
fn reached(program: &str, robot: &Robot) -> Vec<Vector3<f64>> {
    let there = Geometry { tool: kr60().geometry.tool, ..robot.geometry.clone() };
    taught(program).iter().map(|(_, axes)| there.ball(axes).position).collect()
}

/// Mean 3-D error after one rigid alignment, before and after the compensation, mm.
fn errors(true_robot: &Robot, found: &Robot, program: &str) -> [f64; 2] {
    let files = Files { source: Text { file: "P.src", text: program }, data: None, config: None };
    let points = read(files, Given::default()).unwrap();
    let corrected = compensate(files, &points, Correction::of(found, 50.0)).unwrap();
    let wanted: Vec<_> = taught(program).into_iter().map(|(ball, _)| ball.position).collect();
    [program, corrected.source.as_str()].map(|program| {
        let off = aligned_distances(&reached(program, true_robot), &wanted);
        off.iter().sum::<f64>() / off.len() as f64
    })
}

fn warnings(found: &CompletedCalibration) -> usize {
    found.diagnostics().filter(|finding| finding.code().severity() == Severity::Warning).count()
}

/// For each robot the reduction factor of its mean error, the errors before and after, and the number of warnings about the result.
fn campaign(plan: &Plan, cube: bool, robots: u64, sag: bool) -> Vec<[f64; 4]> {
    let program = production(200, cube, 7);
    (1..=robots)
        .map(|seed| {
            let drawn = truth::draw_true_robot(&kr60(), seed, 1.0);
            let true_robot = if sag { sagging(drawn) } else { drawn };
            let found = identified(&true_robot, plan, seed);
            let [before, after] = errors(&true_robot, &found.robot, &program);
            [before / after, before, after, warnings(&found) as f64]
        })
        .collect()
}

#[test]
fn compensated_program_is_more_accurate() {
    let plan = chosen(1, 80, true);
    // The smallest factor is that of a robot whose error is only 0.35 mm. Of twelve such robots 0.030 mm are left in the mean. Poses
    // that are chosen for the geometry alone leave 0.029 mm of them, but 0.123 in place of 0.098 mm of robots with errors of joints.
    for [factor, before, after, warnings] in campaign(&plan, true, 3, false) {
        assert!(
            factor > 9.0 && warnings == 0.0,
            "{before:.3} mm before, {after:.4} mm after, {warnings} warnings"
        );
    }
}

/// `cargo test --release --test suite closed_loop -- --ignored --nocapture`: the figures of docs/evidence/README.md.
#[test]
#[ignore = "200 identifications: see docs/evidence/README.md"]
fn closed_loop_over_twenty_robots() {
    // The largest mean error after the correction, mm: without sag and with it.
    for (balls, points, cube, max_mm) in [
        (1, 80, true, [0.035, 0.039]),
        (1, 320, true, [0.026, 0.029]),
        (3, 240, false, [0.098, 0.176]),
        (3, 240, true, [0.027, 0.029]),
        (1, 80, false, [0.203, 0.249]),
    ] {
        let plan = chosen(balls, points, cube);
        for (sag, max_mm) in [false, true].into_iter().zip(max_mm) {
            let mut factors = campaign(&plan, cube, 20, sag);
            let mean = |at: usize| factors.iter().map(|f| f[at]).sum::<f64>() / factors.len() as f64;
            let (before, after) = (mean(1), mean(2));
            let worst = factors.iter().map(|f| f[2]).fold(0.0, f64::max);
            let noticed = factors.iter().filter(|f| f[3] > 0.0).count();
            factors.sort_by(|a, b| a[0].total_cmp(&b[0]));
            eprintln!(
                "{balls} ball(s), {points} poses, {}{}: factor {:.1} at least, {:.1} in the middle; mean error {before:.3} mm \
                 before, {after:.4} mm after ({worst:.4} mm of the worst robot); {noticed} of 20 results with a warning",
                if cube { "cube" } else { "whole workspace" },
                if sag { ", sag" } else { "" },
                factors[0][0],
                factors[factors.len() / 2][0],
            );
            assert!(after < max_mm && factors[0][0] > 2.0, "{after} {factors:?}");
        }
    }
}
