//! The controller, whose axis angles a plan has, and the arm that then moves.

use crate::robot::inverse::{Unsolved, nearest};
use crate::robot::{AXES, Geometry, Pose, Robot};

/// The controller that will be commanded, and the arm that will move.
pub(crate) struct Rig<'a> {
    /// What the controller computes with.
    pub(crate) controller: &'a Robot,
    /// The arm as well as it is known.
    pub(crate) arm: &'a Geometry,
    /// Whether the two differ.
    identified: bool,
}

impl<'a> Rig<'a> {
    pub(crate) fn new(robot: &'a Robot) -> Self {
        Self { controller: robot.controller(), arm: &robot.geometry, identified: robot.nominal.is_some() }
    }

    /// The pose that must be commanded for the arm to come to `pose`, near axis angles in rad.
    ///
    /// # Errors
    /// The arm does not reach it.
    pub(crate) fn commanded(&self, pose: &Pose, near: &[f64; AXES]) -> Result<Pose, Unsolved> {
        Ok(if self.identified {
            self.controller.geometry.ball(&nearest(self.arm, pose, near)?)
        } else {
            *pose
        })
    }
}
