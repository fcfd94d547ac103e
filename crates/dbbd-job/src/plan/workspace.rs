//! The workspace over which the 3-D error is computed.

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::Job;
use dbbd_model::estimation::{ToolPoses, Workspace};
use dbbd_model::robot::inverse::nearest;
use dbbd_model::robot::pose::{rot_x, rot_y, rot_z};
use dbbd_model::robot::{AXES, Pose, Robot};

/// Seed of the poses, as in an identification.
const WORKSPACE_POSES_SEED: u64 = 1;

/// Axis vectors (rad) over which an error is computed: in the job's box if it has one, else uniform within the limits.
pub fn workspace(job: &Job, robot: &Robot, count: usize) -> Vec<[f64; AXES]> {
    let limits = robot.controller();
    let of_goal = job.goal.as_ref().and_then(|goal| goal.region_mm);
    let of_poses = job.optimise.as_ref().and_then(|optimise| optimise.workspace_mm);
    let Some([low, high]) = of_goal.or(of_poses) else {
        return Workspace::uniform(limits, count, WORKSPACE_POSES_SEED);
    };
    in_box(robot, low, high, count)
}

/// The tools whose position matters by the job's goal, each at about `count` poses: the points of its program, else each tool in the
/// workspace. A job without a goal has the tool ball in its workspace.
pub(super) fn goal_poses(job: &Job, robot: &Robot, count: usize) -> Vec<ToolPoses> {
    let goal = job.goal.as_ref();
    if let Some(goal) = goal.filter(|goal| !goal.of_program.is_empty()) {
        let every = |poses: usize| poses.div_ceil(count.max(1)).max(1);
        let thinned = |ToolPoses { tool_mm, poses }: &ToolPoses| ToolPoses {
            tool_mm: *tool_mm,
            poses: poses.iter().step_by(every(poses.len())).copied().collect(),
        };
        return goal.of_program.iter().map(thinned).collect();
    }
    let tools = goal.iter().flat_map(|goal| &goal.tools).map(|tool| Vector3::from(tool.xyz_mm));
    let of_tool = |tool: Vector3<f64>| {
        let poses = workspace(job, &robot.clone().with_tool(tool.into()), count);
        ToolPoses { tool_mm: Some(tool), poses }
    };
    let found: Vec<ToolPoses> = tools.map(of_tool).collect();
    if found.is_empty() {
        vec![ToolPoses { tool_mm: None, poses: workspace(job, robot, count) }]
    } else {
        found
    }
}

/// Axis vectors (rad) of up to `count` poses with the ball uniform in a box (mm), the tool down and turned by up to 45 degrees
/// about each axis, the arm in front and its elbow up, as in production work.
pub fn in_box(robot: &Robot, low: [f64; 3], high: [f64; 3], count: usize) -> Vec<[f64; AXES]> {
    let mut random = Pcg64::seed_from_u64(WORKSPACE_POSES_SEED);
    let home = [0.0, -60.0, 90.0, 0.0, 60.0, 0.0].map(f64::to_radians);
    let controller = robot.controller();
    // A box far from the arm has few poses, or no poses.
    let mut found = Vec::with_capacity(count);
    for _ in 0..20 * count {
        let position = Vector3::from_fn(|i, _| random.random_range(low[i]..high[i]));
        let mut turn = || random.random_range(-std::f64::consts::FRAC_PI_4..std::f64::consts::FRAC_PI_4);
        let rotation = rot_z(turn()) * rot_y(turn()) * rot_x(turn()) * rot_x(std::f64::consts::PI);
        if let Ok(axes) = nearest(&robot.geometry, &Pose { rotation, position }, &home)
            && controller.is_within_limits(&axes)
        {
            found.push(axes);
        }
        if found.len() == count {
            break;
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::example::{job, robot};

    /// Turns of up to 45 degrees about X and Y leave at least half of the tool's axis downwards: cos^2 45 degrees.
    #[test]
    fn poses_of_a_box_have_the_ball_in_it_and_the_tool_down() {
        let (low, high) = ([1000.0, -300.0, 500.0], [1500.0, 400.0, 700.0]);
        let poses = in_box(&robot(), low, high, 60);
        assert_eq!(poses.len(), 60);
        for axes in &poses {
            let pose = robot().geometry.ball(axes);
            assert!((0..3).all(|i| (low[i] - 1e-6..high[i] + 1e-6).contains(&pose.position[i])));
            assert!(pose.rotation[(2, 2)] <= -0.5 + 1e-9);
            assert!(robot().is_within_limits(axes));
        }
        let highest =
            poses.iter().map(|axes| robot().geometry.ball(axes).position.y).fold(f64::MIN, f64::max);
        assert!(highest > 250.0, "{highest}");
        // Out of reach there are no poses.
        assert!(in_box(&robot(), [9000.0; 3], [9500.0; 3], 5).is_empty());
    }

    #[test]
    fn workspace_is_the_box_of_the_job_or_all_of_the_reach() {
        let table =
            "[optimise]\npoints = 20\nworkspace_mm = [[1000.0, -100.0, 500.0], [1200.0, 100.0, 700.0]]\n";
        let inside = |axes: &[f64; AXES]| (1000.0..1200.0).contains(&robot().geometry.ball(axes).position.x);
        assert!(workspace(&job(table), &robot(), 30).iter().all(inside));
        let anywhere = workspace(&job(""), &robot(), 30);
        assert!(anywhere.len() == 30 && !anywhere.iter().all(inside));
    }
}
