//! Axis angles for a pose: closed form for a spherical wrist, damped least squares for any arm.
//!
//! An identified robot is not exact in any closed form's sense: its twists are not quite right
//! angles, its wrist axes do not quite meet. Its branches are those of the ideal arm nearby, each
//! carried over by the damped iteration.

mod closed;
mod configuration;
mod iterate;

use std::f64::consts::TAU;

use super::pose::Pose;
use super::{AXES, Geometry};

pub use crate::catalogue::RobotFinding as Unsolved;
pub use configuration::{Clearance, clearance, from_status_turn, status, turn, turns_within};
pub use iterate::numeric;

/// All branches (up to eight) that put the tool ball at `ball` with the flange's orientation; axis
/// angles of the controller, rad, each in (-pi, pi]. Where the wrist is straight and only the sum of
/// axes 4 and 6 is defined, axis 4 is 0.
///
/// # Errors
/// Out of reach, or an arm that is not near one with a closed form.
pub fn branches(geometry: &Geometry, ball: &Pose) -> Result<Vec<[f64; AXES]>, Unsolved> {
    branches_near(geometry, ball, 0.0)
}

/// As [`branches`], with axis 4 at `a4` (rad) where the wrist is straight.
fn branches_near(geometry: &Geometry, ball: &Pose, a4: f64) -> Result<Vec<[f64; AXES]>, Unsolved> {
    let arm = closed::Arm::near(geometry).ok_or(Unsolved::NotAnalytic)?;
    let ideal = arm.branches(ball, a4)?;
    if arm.is_exact() {
        return Ok(ideal.into_iter().map(|axes| axes.map(wrapped)).collect());
    }
    let carried: Vec<[f64; AXES]> = ideal
        .iter()
        .filter_map(|start| numeric(geometry, ball, start).ok())
        .map(|axes| axes.map(wrapped))
        .collect();
    if carried.is_empty() { Err(Unsolved::OutOfReach) } else { Ok(carried) }
}

/// The axis angles (rad) for `ball` that lie nearest to `near`, turns included: the closed form's
/// branch where there is one, else the damped iteration from `near`.
///
/// # Errors
/// Out of reach, or no convergence.
pub fn nearest(geometry: &Geometry, ball: &Pose, near: &[f64; AXES]) -> Result<[f64; AXES], Unsolved> {
    let Some(arm) = closed::Arm::near(geometry) else {
        return numeric(geometry, ball, near);
    };
    let ideal = arm.branches(ball, near[3]);
    let chosen = ideal.as_ref().ok().and_then(|ideal| {
        let unwound = ideal.iter().map(|axes| unwound(axes, near));
        unwound.min_by(|a, b| distance(a, near).total_cmp(&distance(b, near)))
    });
    match (chosen, ideal) {
        (Some(axes), _) if arm.is_exact() => Ok(axes),
        (Some(axes), _) => numeric(geometry, ball, &axes).or_else(|_| numeric(geometry, ball, near)),
        (None, Err(reason)) if arm.is_exact() => Err(reason),
        // The true arm may just reach what the ideal one does not.
        (None, _) => numeric(geometry, ball, near),
    }
}

/// The greatest difference of an axis, rad.
fn distance(a: &[f64; AXES], b: &[f64; AXES]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// The same pose with every axis within half a turn of `near`.
fn unwound(axes: &[f64; AXES], near: &[f64; AXES]) -> [f64; AXES] {
    std::array::from_fn(|i| axes[i] + TAU * ((near[i] - axes[i]) / TAU).round())
}

/// An angle in (-pi, pi].
fn wrapped(angle: f64) -> f64 {
    let angle = angle - TAU * (angle / TAU).round();
    if angle <= -std::f64::consts::PI { angle + TAU } else { angle }
}
