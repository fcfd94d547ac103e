//! Where the tool ball is at poses, and how parameters and joints move it.

use nalgebra::{DMatrix, Vector3};

use crate::measurement::ApproachedPose;
use crate::robot::{
    AXES, Approach, AxesAtPose, Geometry, Joint, JointSinCos, KinematicChain, ParamId, PayloadId,
};

/// The predicted positions of the tool ball in the robot base, mm, with the first payload.
pub fn tool_balls(geometry: &Geometry, poses: &[ApproachedPose]) -> Vec<Vector3<f64>> {
    let poses: Vec<_> = poses.iter().map(|pose| (pose.axes.radians(), pose.approach)).collect();
    BallMotion::new(geometry, &poses, &[]).balls
}

/// Derivatives of the tool ball's position at poses.
pub(super) struct BallMotion {
    /// Derivatives by parameters, then by coefficients of the joints' errors: 3 rows for each pose, mm per unit.
    pub(super) jacobian: DMatrix<f64>,
    /// Positions of the tool ball in the robot base, mm.
    pub(super) balls: Vec<Vector3<f64>>,
    /// Derivatives by the angle of each joint, mm/rad.
    pub(super) by_joint: Vec<[Vector3<f64>; AXES]>,
}

impl BallMotion {
    /// The derivatives at axis angles (rad) with the sense of approach.
    pub(super) fn new(geometry: &Geometry, poses: &[([f64; AXES], Approach)], ids: &[ParamId]) -> Self {
        let chain = KinematicChain::new(geometry);
        let own = ids.len();
        let mut jacobian = DMatrix::zeros(3 * poses.len(), own + geometry.joint_errors.count());
        let (mut balls, mut joints) = (Vec::new(), Vec::new());
        let ids: Vec<ParamId> = ids.iter().copied().chain(Joint::ALL.map(ParamId::Theta)).collect();
        for (at, (axes, approach)) in poses.iter().enumerate() {
            let mut by_joint = [Vector3::zeros(); AXES];
            chain.ball_jacobian(axes, &ids, |column, moved| match column.checked_sub(own) {
                None => jacobian.fixed_view_mut::<3, 1>(3 * at, column).copy_from(&moved),
                Some(joint) => by_joint[joint] = moved,
            });
            let mut column = own;
            geometry.error_derivatives(axes, *approach, |place, value| {
                jacobian.fixed_view_mut::<3, 1>(3 * at, column).copy_from(&(by_joint[place] * value));
                column += 1;
            });
            joints.push(by_joint);
            let (sin_cos, approach, target) = (&JointSinCos::of(axes), *approach, &geometry.tool);
            balls.push(chain.ball(&AxesAtPose {
                axes,
                sin_cos,
                approach,
                target,
                payload: PayloadId::FIRST,
            }));
        }
        Self { jacobian, balls, by_joint: joints }
    }
}
