//! What a plan states is what an identification of its lengths states in the mean, and what is true.
//!
//! Robots are drawn from the priors of an identification: geometry, tool ball and errors of the joints. Each plan is measured on
//! them in memory, with a pose that repeats as the robot's file says and a bar with its sigma.

use dbbd_job::plan::{Job, Plan, PlanningPrior, PoseKind};
use dbbd_job::sim::truth;
use dbbd_model::estimation::{
    AngleSource, Calibration, CompletedCalibration, Input, Options, Prior, Workspace, with_drawn_joint_errors,
};
use dbbd_model::math::aligned_distances;
use dbbd_model::measurement::{Datum, LengthModel, Measurement, Measurements};
use dbbd_model::robot::{AxisAngles, BarId, Geometry, PayloadId, Robot, TargetId};
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

const SIGMA_MM: f64 = 0.002;
/// Robots, with their length to a usual base ball: shares of their reach.
const ROBOTS: [&str; 3] = ["kr60ha", "ur10", "irb4600-60-205"];
/// Places of base balls as shares of the reach.
const BALLS: [[f64; 3]; 3] = [[0.62, 0.0, 0.38], [0.45, 0.33, 0.52], [0.48, -0.43, 0.24]];

/// A job of circles, with the tool tilted by this angle, or of chosen poses about the first balls.
pub(crate) fn job(robot: &Robot, balls: usize, is_chosen: bool, tilt_deg: f64) -> Job {
    let reach = robot.reach_mm();
    let mut text = format!(
        "robot = \"any\"\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = 300.0\nlength_u_mm = 0.002\nstroke_mm = [-25.0, 25.0]\n\
         sigma_um = {}\n[limits]\nmin_overhead_mm = 50.0\n",
        1e3 * SIGMA_MM
    );
    for (id, place) in (1..).zip(&BALLS[..balls]) {
        let [x, y, z] = place.map(|share| (share * reach).round());
        text += &format!("[[centre]]\nid = {id}\nxyz_mm = [{x:?}, {y:?}, {z:?}]\n");
    }
    if is_chosen {
        text += &format!("[optimise]\npoints = {}\ncandidates = 1500\n", 60 + 30 * balls);
        return Job::from_toml("job.toml", &text).unwrap();
    }
    for centre in 1..=balls {
        for plane in ["XY", "XZ"] {
            text += &format!(
                "[[circle]]\ncentre = {centre}\nplane = \"{plane}\"\npoints = 40\narc_deg = 120.0\nstart_deg = 20.0\namplitude_deg = 25.0\ntilt_deg = {tilt_deg:?}\n"
            );
        }
    }
    Job::from_toml("job.toml", &text).unwrap()
}

/// The stated and the true mean errors of one run, mm.
#[derive(Clone, Copy, Debug)]
struct Stated {
    planned: f64,
    result: f64,
    truth: f64,
}

fn mean_error_mm(truth: &Geometry, found: &Geometry, robot: &Robot) -> f64 {
    mean_error_at_mm(truth, found, &Workspace::uniform(robot, 1000, 7))
}

/// The mean distance of the tool ball at poses (axis angles, rad), aligned over these.
pub(crate) fn mean_error_at_mm(truth: &Geometry, found: &Geometry, poses: &[[f64; 6]]) -> f64 {
    let balls = |geometry: &Geometry| -> Vec<Vector3<f64>> {
        poses.iter().map(|axes| geometry.ball(axes).position).collect()
    };
    let off = aligned_distances(&balls(truth), &balls(found));
    off.iter().sum::<f64>() / off.len() as f64
}

/// The lengths of a plan on a drawn robot.
fn measured(plan: &Plan, robot: &Robot, truth: &Robot, random: &mut Pcg64) -> Measurements {
    let mut normal = |sd: f64| sd * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, random);
    let pose_mm = robot.repeatability_sd_mm().unwrap_or(0.03);
    let job = &plan.header.job;
    let length = |(row, approach): (&dbbd_job::plan::PlanRow, dbbd_model::robot::Approach)| {
        let axes = AxisAngles::from_degrees(row.axes_deg);
        let ball = truth.geometry.approached(approach).ball(&axes.radians()).position;
        let ball = ball + Vector3::from_fn(|_, _| normal(pose_mm));
        let centre = Vector3::from(job.centres[row.centre.index()].xyz_mm);
        Measurement {
            index: row.index,
            datum: Datum::Ball(row.centre, BarId::FIRST),
            target: TargetId::FIRST,
            axes,
            approach,
            length_mm: (ball - centre).norm() + normal(SIGMA_MM),
            sigma_mm: Some(SIGMA_MM),
            payload: PayloadId::FIRST,
            context: None,
        }
    };
    let rows = plan.rows.iter().zip(plan.approaches());
    let rows = rows.filter(|(row, _)| row.kind != PoseKind::Transit).map(length).collect();
    Measurements { rows, ..Measurements::default() }
}

/// A robot that is drawn from the priors of an identification, what an identification of the plan's lengths finds, and the mean error
/// that it states, mm.
pub(crate) fn identified(plan: &Plan, robot: &Robot, seed: u64) -> (Geometry, Geometry, f64) {
    let mut random = Pcg64::seed_from_u64(seed);
    let mut truth = with_drawn_joint_errors(&truth::draw_true_robot(robot, seed, 1.0), seed);
    let off = Vector3::from_fn(|_, _| {
        robot.ball_u_mm * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut random)
    });
    truth.geometry.tool += off;
    let found = identified_from(plan, robot, &truth, &mut random);
    let stated_mm = found.result.predicted_position_uncertainty_mm.identified.mean;
    (truth.geometry, found.robot.geometry, stated_mm)
}

/// What an identification of the plan's lengths on a true robot finds.
pub(crate) fn identified_from(
    plan: &Plan,
    robot: &Robot,
    truth: &Robot,
    random: &mut Pcg64,
) -> CompletedCalibration {
    let (job, lengths) = (&plan.header.job, measured(plan, robot, truth, random));
    let input = Input {
        robot,
        observations: &lengths,
        start: &LengthModel::new(robot.geometry.clone(), &job.balls()),
        validation: None,
        options: &Options {
            folds: Some(0),
            prior: Prior::Datasheet,
            bar_u_mm: job.bar.u_mm(),
            ..Options::default()
        },
        axes: AngleSource::Commanded,
    };
    Calibration::new(&input).unwrap().complete(Vec::new(), Vec::new())
}

fn kind(name: &str, balls: usize, is_chosen: bool, seeds: std::ops::Range<u64>) -> Vec<Stated> {
    let robot = Robot::by_name_with_tool(name, [30.0, 20.0, 10.0]).unwrap().unwrap();
    // Of these tilts each robot has one with which it reaches all poses.
    let plans = [30.0, 0.0, -30.0, 15.0].map(|tilt_deg| job(&robot, balls, is_chosen, tilt_deg)).into_iter();
    let mut plans = plans.filter_map(|job| Some((Plan::build(&job, &robot).ok()?, job)));
    let (mut plan, job) = plans.next().unwrap_or_else(|| panic!("{name}, {balls} balls: no plan"));
    plan.predict(&robot, &PlanningPrior::datasheet(&job, &robot));
    let planned = plan.header.predictions.as_ref().unwrap().identified_mm.mean;
    let run = |seed: u64| {
        let (truth, found, result) = identified(&plan, &robot, seed);
        Stated { planned, result, truth: mean_error_mm(&truth, &found, &robot) }
    };
    seeds.map(run).collect()
}

fn mean(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let count = values.clone().count();
    values.sum::<f64>() / count as f64
}

/// Mean planned over stated, and mean stated over true, error of kinds.
fn campaign(robots: &[&str], seeds: std::ops::Range<u64>) -> Vec<(String, [f64; 2])> {
    let mut found = Vec::new();
    for name in robots {
        for balls in [1, 3] {
            for is_chosen in [false, true] {
                let runs = kind(name, balls, is_chosen, seeds.clone());
                let what = format!("{name}, {balls} balls, {}", if is_chosen { "chosen" } else { "circles" });
                let [planned, result, truth] = [
                    mean(runs.iter().map(|run| run.planned)),
                    mean(runs.iter().map(|run| run.result)),
                    mean(runs.iter().map(|run| run.truth)),
                ];
                eprintln!(
                    "{what}: planned {planned:.3}, stated {result:.3}, true {truth:.3} mm; planned/stated {:.2}, stated/true {:.2}",
                    planned / result,
                    result / truth
                );
                found.push((what, [planned / result, result / truth]));
            }
        }
    }
    found
}

/// `PLANNED=1..41 cargo test --release --test suite twelve_kinds_of_plans -- --ignored --nocapture`
#[test]
#[ignore = "takes minutes"]
fn twelve_kinds_of_plans_state_their_results() {
    let range = std::env::var("PLANNED").unwrap_or("1..41".into());
    let (first, past) = range.split_once("..").unwrap();
    let found = campaign(&ROBOTS, first.parse().unwrap()..past.parse().unwrap());
    for (what, [planned, _]) in &found {
        assert!((0.85..=1.18).contains(planned), "{what}: {planned}");
    }
    let pooled = mean(found.iter().map(|(_, [_, honest])| *honest));
    assert!((0.9..=1.15).contains(&pooled), "{pooled}");
}
