//! The frames of the program: poses as they are commanded, and back.

use super::{MotionTable, PlanRow};
use dbbd_model::robot::Pose;

/// $TOOL and $BASE. The tool's origin is the tool ball; only its orientation is the job's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanFrames {
    /// The tool's orientation, from the flange's, without a shift.
    tool: Pose,
    /// The base frame in the robot base.
    base: Pose,
    /// Whether both are null, so that poses are commanded as they are.
    null: bool,
}

impl MotionTable {
    /// The frames of the job; null where it gives none.
    pub fn frames(&self) -> PlanFrames {
        let [.., a, b, c] = self.tool.unwrap_or_default();
        let [x, y, z, u, v, w] = self.base.unwrap_or_default();
        PlanFrames {
            tool: Pose::from_kuka([0.0; 3], [a, b, c]),
            base: Pose::from_kuka([x, y, z], [u, v, w]),
            null: [a, b, c, x, y, z, u, v, w].iter().all(|value| *value == 0.0),
        }
    }
}

impl PlanFrames {
    /// X, Y, Z and A, B, C of a pose (tool ball with the flange's orientation, robot base) as KRL prints them.
    pub(crate) fn as_printed(&self, pose: &Pose) -> ([f64; 3], [f64; 3]) {
        let pose = if self.null { *pose } else { self.base.inverse().then(pose).then(&self.tool) };
        (<[f64; 3]>::from(pose.position).map(|x| rounded(x, 1e3)), pose.abc_deg().map(|x| rounded(x, 1e4)))
    }

    /// A row's numbers as KRL prints them.
    pub fn printed(&self, row: &PlanRow) -> ([f64; 3], [f64; 3]) {
        // At B = 90 degrees A and C are ambiguous: keep those of the row.
        if self.null {
            (row.xyz_mm, row.abc_deg)
        } else {
            self.as_printed(&Pose::from_kuka(row.xyz_mm, row.abc_deg))
        }
    }

    /// The pose that the controller drives for printed numbers, in the robot base: X, Y, Z and the flange's A, B, C.
    pub(crate) fn as_driven(&self, (xyz_mm, abc_deg): ([f64; 3], [f64; 3])) -> ([f64; 3], [f64; 3]) {
        if self.null {
            return (xyz_mm, abc_deg);
        }
        let pose = self.base.then(&Pose::from_kuka(xyz_mm, abc_deg)).then(&self.tool.inverse());
        (pose.position.into(), pose.abc_deg())
    }
}

/// Rounded to a fraction of 1, without a negative zero.
fn rounded(value: f64, parts: f64) -> f64 {
    (value * parts).round() / parts + 0.0
}
