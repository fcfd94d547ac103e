//! A robot is usable as soon as its file is there.

use dbbd_job::plan::{Job, Plan, PlanningPrior, PoseKind};
use dbbd_model::robot::{AXES, Pose, Robot};

/// A short arc about a ball in front of the robot, level with its shoulder.
fn small_job(robot: &Robot) -> Job {
    let reach = robot.reach_mm();
    let text = format!(
        "robot = \"any\"\n[bar]\nlength_mm = {:.1}\nstroke_mm = [-5.0, 5.0]\n[[centre]]\nid = 1\nxyz_mm = [{:.1}, {:.1}, {:.1}]\n\
         [[circle]]\nplane = \"XY\"\npoints = 3\narc_deg = 60.0\norientation = \"fixed\"\ntilt_deg = 20.0\n\
         [limits]\nmin_overhead_mm = 20.0\nmax_stroke_risk = 0.1\n",
        0.15 * reach,
        0.55 * reach,
        0.1 * reach,
        robot.geometry.rows[0].d,
    );
    Job::from_toml("job.toml", &text).unwrap()
}

#[test]
fn every_robot_has_a_plan() {
    for (name, _) in Robot::built_in() {
        let robot = Robot::by_name(name).unwrap().unwrap();
        let job = small_job(&robot);
        let plan = Plan::build(&job, &robot).unwrap_or_else(|refusal| panic!("{name}: {refusal:?}"));
        assert!(plan.rows.len() >= 3, "{name}");
        for row in &plan.rows {
            let there = robot.geometry.ball(&row.axes_deg.map(f64::to_radians));
            let commanded = Pose::from_kuka(row.xyz_mm, row.abc_deg);
            // The axis angles in the plan are those of the printed pose.
            assert!((there.position - commanded.position).norm() < 1e-6, "{name}");
            assert!(there.angle_to(&commanded) < 1e-9, "{name}");
            let within =
                |i: usize| (robot.limits_deg[i][0]..=robot.limits_deg[i][1]).contains(&row.axes_deg[i]);
            assert!((0..AXES).all(within), "{name}: {:?}", row.axes_deg);
        }
    }
}

/// A job of chosen poses about a ball in front of the robot.
fn chosen_job(robot: &Robot, seed: u32, candidates: u32) -> Job {
    let reach = robot.reach_mm();
    let text = format!(
        "robot = \"any\"\nseed = {seed}\n[bar]\nlength_mm = 300.0\nstroke_mm = [-15.0, 15.0]\nmargin_mm = 0.5\n\
         sigma_um = 20.0\n[[centre]]\nid = 1\nxyz_mm = [{:.1}, 0.0, {:.1}]\n\
         [optimise]\npoints = 60\ncandidates = {candidates}\n",
        0.55 * reach,
        0.3 * reach,
    );
    Job::from_toml("job.toml", &text).unwrap()
}

/// Number of poses to measure of a plan of 60, and the predicted mean 3-D error that its lengths leave, mm.
fn chosen(name: &str, seed: u32, candidates: u32) -> (usize, f64) {
    let robot = Robot::by_name(name).unwrap().unwrap();
    let job = chosen_job(&robot, seed, candidates);
    let mut plan = Plan::build(&job, &robot).unwrap_or_else(|refusal| panic!("{name} {seed}: {refusal:?}"));
    plan.predict(&robot, &PlanningPrior::datasheet(&job, &robot));
    let measured = plan.rows.iter().filter(|row| row.kind == PoseKind::Measure).count();
    (measured, plan.header.predictions.unwrap().identified_mm.mean)
}

/// Ways that keep the limits connect only parts of the poses of such an arm. Poses that are chosen without regard to the ways are
/// left out: 18 of these 60, or 40 where the start belongs to a small part. All 60 leave 0.83 and 0.82 mm, as an identification
/// is expected to state it.
#[test]
fn chosen_poses_are_those_that_the_robot_can_go_to() {
    let found = [1, 2].map(|seed| chosen("ur5e", seed, 600));
    assert!(found.iter().all(|(measured, mean_mm)| *measured >= 57 && *mean_mm < 0.9), "{found:?}");
}

/// Poses to measure, references and the ends of all ways between them.
#[test]
fn every_axis_keeps_its_margin() {
    let robot = Robot::by_name("kr60ha").unwrap().unwrap();
    let margin_deg = |min_axis_margin_deg: f64| {
        let mut job = chosen_job(&robot, 1, 600);
        job.limits.min_axis_margin_deg = min_axis_margin_deg;
        let plan = Plan::build(&job, &robot).unwrap_or_else(|refusal| panic!("{refusal:?}"));
        let margins = plan.rows.iter().flat_map(|row| {
            let limits = robot.limits_deg.iter().zip(row.axes_deg);
            limits.map(|([low, high], deg)| (deg - low).min(high - deg)).collect::<Vec<_>>()
        });
        margins.fold(f64::INFINITY, f64::min)
    };
    let [free, kept] = [0.0, 5.0].map(margin_deg);
    assert!((0.0..5.0).contains(&free) && kept >= 5.0, "{free}, {kept}");
}

/// Three seeds have other candidates, and nearly the same information.
#[test]
#[ignore = "a campaign: plans of all robots"]
fn chosen_poses_of_every_robot() {
    for (name, _) in Robot::built_in() {
        let found: Vec<(usize, f64)> = (1..=3).map(|seed| chosen(name, seed, 4000)).collect();
        eprintln!("{name}: {found:?}");
        let [min_mm, max_mm] =
            found.iter().fold([f64::INFINITY, 0.0], |[low, high], (_, mm)| [mm.min(low), mm.max(high)]);
        assert!(
            found.iter().all(|(measured, _)| *measured >= 57) && max_mm < 1.25 * min_mm,
            "{name}: {found:?}"
        );
    }
}
