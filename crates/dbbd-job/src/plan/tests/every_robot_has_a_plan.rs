//! A robot is usable as soon as its file is there.

use dbbd_job::plan::{Job, Plan};
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
