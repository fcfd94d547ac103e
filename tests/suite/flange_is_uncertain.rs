//! Lengths to the tool ball do not show whether an offset is that of the ball or of the flange. Where nobody states how exact the flange
//! is, the uncertainty of a tool that works says so.

use dbbd_job::plan::{Plan, PlanningPrior};
use dbbd_job::sim::truth::draw_true_robot;
use dbbd_model::estimation::{ProgramUncertainty, Workspace};
use dbbd_model::measurement::{ApproachedPose, ToolPoint};
use dbbd_model::robot::{Geometry, Robot};
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_pcg::Pcg64;

use super::plan_states_the_result::{identified_from, job, mean_error_at_mm};

/// A tool of 250 mm that is tilted by 45 degrees.
const TOOL_MM: [f64; 3] = [177.0, 0.0, 177.0];

/// The true mean error of the tool and the one that is stated, with the share of the flange, mm.
fn true_and_stated(robot: &Robot, plan: &Plan, seed: u64, tolerances: f64) -> (f64, ProgramUncertainty) {
    let mut truth = draw_true_robot(robot, seed, 1.0);
    let sign = if seed.is_multiple_of(2) { 1.0 } else { -1.0 };
    truth.geometry.rows[5].d += sign * tolerances * robot.tolerance.length_mm;
    truth.geometry.rows[5].theta += sign * tolerances * robot.tolerance.angle_deg.to_radians();
    let found = identified_from(plan, robot, &truth, &mut Pcg64::seed_from_u64(seed)).robot;
    let tool = Vector3::from(TOOL_MM);
    let poses: Vec<[f64; 6]> = Workspace::uniform(robot, 200, 9);
    let point = |axes: &[f64; 6]| ToolPoint { tool, pose: ApproachedPose::unapproached(axes) };
    let points: Vec<ToolPoint> = poses.iter().map(point).collect();
    let stated = ProgramUncertainty::of(&found, &points, &[]).unwrap();
    let with_tool = |geometry: &Geometry| Geometry { tool, ..geometry.clone() };
    (mean_error_at_mm(&with_tool(&truth.geometry), &with_tool(&found.geometry), &poses), stated)
}

#[test]
fn tool_that_works_is_as_uncertain_as_the_flange() {
    let mut robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
    let job = job(&robot, 3, true, 0.0);
    let plan = Plan::build_with(&job, &robot, &PlanningPrior::datasheet(&job, &robot)).unwrap();
    let mut covered = Vec::new();
    for seed in 1..7 {
        let (true_mm, ProgramUncertainty { after, flange, .. }) = true_and_stated(&robot, &plan, seed, 2.0);
        assert!(flange.mean > 0.5 * after.mean, "{flange:?} {after:?}");
        covered.push(true_mm / after.mean);
    }
    // Two standard deviations of the flange and no more.
    assert!(covered.iter().all(|ratio| *ratio < 2.2), "{covered:?}");
    assert!(covered.iter().any(|ratio| *ratio > 1.0), "{covered:?}");
    // A flange as exact as it is stated takes nothing from what is stated.
    robot.tolerance.state_flange();
    let (true_mm, ProgramUncertainty { after, flange, .. }) = true_and_stated(&robot, &plan, 1, 0.0);
    assert!(flange.mean == 0.0 && true_mm < 1.5 * after.mean, "{true_mm} {after:?}");
    let (true_mm, ProgramUncertainty { after, .. }) = true_and_stated(&robot, &plan, 1, 2.0);
    assert!(true_mm > 3.0 * after.mean, "{true_mm} {after:?}");
}
