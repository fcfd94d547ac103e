//! A row of the table of a robot.

use nalgebra::Vector3;

use super::pose::{rot_x, rot_y};

/// One row of the modified-DH table: `Ry(beta) Rx(alpha) Tx(a) Rz(theta) Tz(d)`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DhRow {
    /// Twist before the joint, rad.
    pub alpha: f64,
    /// Link length before the joint, mm.
    pub a: f64,
    /// Joint angle at axis angle zero, rad.
    pub theta: f64,
    /// Link offset along the joint, mm.
    pub d: f64,
    /// Hayati's turn about y before the row, rad.
    pub beta: f64,
    /// +1 or -1: the sense of the controller's axis angle.
    pub sign: f64,
}

impl DhRow {
    /// The distance between the origins of the row's frame and the frame before, mm.
    pub(super) fn length(&self) -> f64 {
        self.a.hypot(self.d)
    }

    /// The origin of the row's frame in the frame before, mm: it does not depend on the joint.
    pub(super) fn origin(&self) -> Vector3<f64> {
        rot_y(self.beta) * rot_x(self.alpha) * Vector3::new(self.a, 0.0, self.d)
    }
}
