//! Where a program sends the robot.

use crate::robot::{AXES, Pose};

/// A commanded position, to the digits that are written.
#[derive(Clone, Debug, PartialEq)]
pub enum Target {
    /// Axis angles, degrees.
    Axes([f64; AXES]),
    /// A pose of the tool in the base frame.
    Pose {
        xyz_mm: [f64; 3],
        /// KUKA's A, B, C.
        abc_deg: [f64; 3],
        /// KUKA's status bits, where they are given.
        status: Option<i64>,
        /// KUKA's turn bits, where they are given.
        turn: Option<i64>,
    },
}

impl Target {
    /// A1 to A6, or X, Y, Z, A, B, C.
    pub fn numbers(&self) -> [f64; 6] {
        match *self {
            Self::Axes(axes_deg) => axes_deg,
            Self::Pose { xyz_mm: [x, y, z], abc_deg: [a, b, c], .. } => [x, y, z, a, b, c],
        }
    }
}

/// The frames under which a pose is commanded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frames {
    /// In the flange frame.
    pub tool: Pose,
    /// In the robot's base.
    pub base: Pose,
}

impl Frames {
    /// The pose of the flange in the robot's base for one of the tool in the base frame.
    pub fn flange(&self, tool: &Pose) -> Pose {
        self.base.then(tool).then(&self.tool.inverse())
    }

    /// The opposite of [`Frames::flange`].
    pub fn tool(&self, flange: &Pose) -> Pose {
        self.base.inverse().then(flange).then(&self.tool)
    }
}
