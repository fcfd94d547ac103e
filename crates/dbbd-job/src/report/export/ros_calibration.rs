//! The calibration file of ROS for a Universal Robots arm (`kinematics` of `ur_description`): the place of each segment
//! in the segment before it, with its joint at zero. Each joint turns about the z of its segment.
//!
//! Row i of the table, `Ry(beta) Rx(alpha) Tx(a) Rz(theta) Tz(d)`, is such a segment: its joint may be moved along the
//! joint's axis.

use std::fmt::Write;

use super::urdf::roll_pitch_yaw;
use super::urdf_patch::row_pose;
use crate::program::Language;
use crate::robot_description::universal::{COORDINATES, SEGMENTS};
use dbbd_model::base::hash::sha256;
use dbbd_model::robot::Robot;

/// Hexadecimal digits of a hash of 64 bits.
const HASH_DIGITS: usize = 16;

/// The YAML of a robot; `None` if the form cannot hold the robot: it is of another make, or an axis turns against its
/// sense.
pub(super) fn ros_calibration(robot: &Robot) -> Option<String> {
    let is_universal = robot.controller_language() == Some(Language::Urscript.name());
    let has_senses = robot.geometry.rows.iter().all(|row| row.sign > 0.0);
    if !(is_universal && has_senses && robot.geometry.coupling.is_none()) {
        return None;
    }
    let mut segments = String::new();
    for (name, row) in SEGMENTS.iter().zip(&robot.geometry.rows) {
        let pose = row_pose(row);
        let place: [f64; 3] = (pose.position * 1e-3).into();
        let values = place.into_iter().chain(roll_pitch_yaw(&pose.rotation));
        let _ = writeln!(segments, "  {name}:");
        for (coordinate, value) in COORDINATES.iter().zip(values) {
            // Numbers are written with a decimal point: a whole number would be read as another type.
            let _ = writeln!(segments, "    {coordinate}: {:?}", value + 0.0);
        }
    }
    // The driver compares this hash with the hash of the controller's own calibration, which differs.
    let hash = sha256(segments.as_bytes());
    let hash = u64::from_str_radix(hash.get(..HASH_DIGITS)?, 16).ok()?;
    Some(format!(
        "# {}: identified by dbbd, m and rad. The driver reports that the hash is not the controller's: this is not its factory calibration.\n\
         kinematics:\n{segments}  hash: calib_{hash}\n",
        robot.name.replace(char::is_control, " ")
    ))
}
