//! What the table of lengths and angles alone leaves out of a robot.

use nalgebra::Vector3;

use super::Workspace;
use crate::math::aligned_distances;
use crate::robot::{AXES, Approach, At, Chain, Geometry, JointErrors, JointSinCos, Robot};

/// Poses over which it is taken, and their seed.
const POSES: usize = 200;
const SEED: u64 = 1;

/// How far the tool ball of a robot is from that of its table alone, without compliance and errors of the joints, mm:
/// the mean over poses of the workspace, one after the other, after the best rigid alignment. `None` where it has neither.
pub fn left_out_mm(robot: &Robot) -> Option<f64> {
    let whole = &robot.geometry;
    let table = Geometry {
        compliance: [0.0; AXES],
        gear: [[0.0; 2]; AXES],
        joint_errors: JointErrors::default(),
        ..whole.clone()
    };
    if table == *whole {
        return None;
    }
    let poses = Workspace::uniform(robot, POSES, SEED);
    let balls = |geometry: &Geometry| -> Vec<Vector3<f64>> {
        let chain = Chain::new(geometry);
        let approached = poses.iter().zip(Approach::along(poses.iter().copied()));
        let ball = |(axes, approach): (&[f64; AXES], Approach)| {
            chain.ball(&At { axes, sin_cos: &JointSinCos::of(axes), approach, target: &geometry.tool })
        };
        approached.map(ball).collect()
    };
    Some(aligned_distances(&balls(whole), &balls(&table)).iter().sum::<f64>() / POSES as f64)
}
