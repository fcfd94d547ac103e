//! The frames from which a controller counts, beside those of the table.

use serde::{Deserialize, Serialize};

use super::Pose;
use crate::base::fixed_array::fixed_array;
use crate::diagnostic::Diagnostic;
use crate::plausibility::Quantity;

/// The frames of a controller. A table in modified DH begins on axis 1 and ends on axis 6; bases of programs count from the World of the
/// cell, in which the robot stands, and tools from the flange of the maker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControllerFrames {
    /// The robot base in the World of the controller.
    pub base: Pose,
    /// The flange of the controller in the flange frame of the table.
    pub flange: Pose,
}

impl Default for ControllerFrames {
    fn default() -> Self {
        Self { base: Pose::identity(), flange: Pose::identity() }
    }
}

impl ControllerFrames {
    /// A base of a program, which is given in the World, in the robot base.
    pub fn in_robot_base(&self, base: &Pose) -> Pose {
        self.base.inverse().then(base)
    }

    /// A tool of a program, which is given in the flange of the controller, in the flange frame of the table.
    pub fn on_table_flange(&self, tool: &Pose) -> Pose {
        self.flange.then(tool)
    }
}

/// A frame in a file: mm, and KUKA's A, B, C in degrees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FrameTable {
    #[serde(default, deserialize_with = "fixed_array")]
    pub(super) xyz_mm: [f64; 3],
    #[serde(default, deserialize_with = "fixed_array")]
    pub(super) abc_deg: [f64; 3],
}

impl FrameTable {
    pub(super) fn of(pose: &Pose) -> Self {
        Self { xyz_mm: pose.position.into(), abc_deg: pose.abc_deg() }
    }

    pub(super) fn pose(&self) -> Result<Pose, Diagnostic> {
        self.xyz_mm.into_iter().try_for_each(|mm| Quantity::WorldCoordinate.check("xyz_mm", mm))?;
        self.abc_deg.into_iter().try_for_each(|deg| Quantity::FrameAngle.check("abc_deg", deg))?;
        Ok(Pose::from_kuka(self.xyz_mm, self.abc_deg))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A robot on a pedestal of 500 mm that is turned by 90 degrees: the origin of the World is 500 mm below its base, and X of the World is
    /// its -Y. A flange that is turned by 180 degrees about X sees a tool of 100 mm behind it.
    #[test]
    fn frames_of_the_controller_become_frames_of_the_table() {
        let frames = ControllerFrames {
            base: Pose::from_kuka([0.0, 0.0, 500.0], [90.0, 0.0, 0.0]),
            flange: Pose::from_kuka([0.0; 3], [0.0, 0.0, 180.0]),
        };
        let base = frames.in_robot_base(&Pose::from_kuka([1000.0, 0.0, 0.0], [0.0; 3]));
        let tool = frames.on_table_flange(&Pose::from_kuka([10.0, 20.0, 100.0], [0.0; 3]));
        for (found, expected) in [(base, [0.0, -1000.0, -500.0]), (tool, [10.0, -20.0, -100.0])] {
            assert!((found.position - nalgebra::Vector3::from(expected)).norm() < 1e-9, "{found:?}");
        }
        let none = ControllerFrames::default();
        assert_eq!((none.in_robot_base(&base), none.on_table_flange(&tool)), (base, tool));
    }
}
