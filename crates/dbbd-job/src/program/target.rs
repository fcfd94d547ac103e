//! The targets of motions and the frames in which they are given.

use dbbd_model::robot::{AXES, ControllerFrames, Pose};

/// A commanded position as it is written.
#[derive(Clone, Debug, PartialEq)]
pub enum Target {
    /// Axis angles, degrees.
    Axes([f64; AXES]),
    /// A pose of the tool in the base frame.
    Pose {
        xyz_mm: [f64; 3],
        /// KUKA's A, B, C.
        abc_deg: [f64; 3],
        /// KUKA's status bits.
        status: Option<i64>,
        /// KUKA's turn bits.
        turn: Option<i64>,
    },
}

impl Target {
    /// A pose without status and turn.
    pub(super) fn pose(pose: &Pose) -> Self {
        Self::Pose { xyz_mm: pose.position.into(), abc_deg: pose.abc_deg(), status: None, turn: None }
    }

    /// A1 to A6, or X, Y, Z, A, B, C.
    pub fn numbers(&self) -> [f64; 6] {
        match *self {
            Self::Axes(axes_deg) => axes_deg,
            Self::Pose { xyz_mm: [x, y, z], abc_deg: [a, b, c], .. } => [x, y, z, a, b, c],
        }
    }
}

/// The frames in which a pose is commanded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frames {
    /// Tool in the flange of the controller.
    pub tool: Pose,
    /// Base in the World of the controller.
    pub base: Pose,
}

impl Frames {
    /// These frames of a program for the table of its robot.
    pub fn for_table(&self, frames: &ControllerFrames) -> Self {
        Self { tool: frames.on_table_flange(&self.tool), base: frames.in_robot_base(&self.base) }
    }

    /// The pose of the flange in the robot base at a pose of the tool in the base frame.
    pub fn flange(&self, tool: &Pose) -> Pose {
        self.base.then(tool).then(&self.tool.inverse())
    }

    /// The pose of the tool in the base frame at a pose of the flange in the robot base.
    pub fn tool(&self, flange: &Pose) -> Pose {
        self.base.inverse().then(flange).then(&self.tool)
    }
}

/// The base ball and the bar that are named in a module of dbbd (in KRL, in its `.dat`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setup {
    /// Number of the base ball, from 1.
    pub ball: u32,
    /// Centre of the base ball in the robot base, mm.
    pub centre_mm: [f64; 3],
    /// Distance between the ball centres at reading zero, mm.
    pub length_mm: f64,
    /// Lowest and highest reading, mm.
    pub stroke_mm: [f64; 2],
}
