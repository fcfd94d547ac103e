//! Axis angles for a pose: closed forms for a spherical wrist and for three parallel axes, a search for any other arm,
//! damped least squares from a neighbour.
//!
//! An identified robot is not exact in any closed form's sense: its twists are not quite right
//! angles, its wrist axes do not quite meet. Its branches are those of the ideal arm nearby, each
//! carried over by the damped iteration.

mod closed;
mod configuration;
mod iterate;
mod search;

use std::f64::consts::TAU;

use super::pose::Pose;
use super::{AXES, Geometry, max_axis_difference};

pub use crate::robot::RobotFinding as Unsolved;
pub use configuration::{
    SingularityClearance, clearance, from_quadrants, from_status_turn, quadrants, status, turn, turns_within,
};
pub use iterate::numeric;

/// Without a closed form, what the damped iteration reaches with no axis turned by more has stayed in its branch, rad.
const FOLLOWED: f64 = 0.3;

/// All branches (up to eight with a closed form) that put the tool ball at `ball` with the flange's orientation; axis
/// angles of the controller, rad, each in (-pi, pi]. Where the wrist is straight and
/// axes 4 and 6 turn alike, axis 4 is 0 (axis 6 of an arm with three parallel axes).
///
/// # Errors
/// Out of reach.
pub fn branches(geometry: &Geometry, ball: &Pose) -> Result<Vec<[f64; AXES]>, Unsolved> {
    let Some(arm) = closed::ClosedFormArm::near(geometry) else {
        let found = search::branches(geometry, ball);
        return if found.is_empty() { Err(Unsolved::OutOfReach) } else { Ok(found) };
    };
    let ideal = arm.branches(ball, &[0.0; AXES])?;
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
    let Some(arm) = closed::ClosedFormArm::near(geometry) else {
        let followed =
            numeric(geometry, ball, near).ok().filter(|axes| max_axis_difference(axes, near) < FOLLOWED);
        return followed.map_or_else(|| nearest_of(&branches(geometry, ball)?, near), Ok);
    };
    let ideal = arm.branches(ball, near);
    match ideal.and_then(|ideal| nearest_of(&ideal, near)) {
        ideal if arm.is_exact() => ideal,
        Ok(axes) => numeric(geometry, ball, &axes).or_else(|_| numeric(geometry, ball, near)),
        // The true arm may just reach what the ideal one does not.
        Err(_) => numeric(geometry, ball, near),
    }
}

/// The branch that is nearest to `near`, turns included.
fn nearest_of(branches: &[[f64; AXES]], near: &[f64; AXES]) -> Result<[f64; AXES], Unsolved> {
    let unwound = branches.iter().map(|axes| unwound(axes, near));
    let nearest =
        unwound.min_by(|a, b| max_axis_difference(a, near).total_cmp(&max_axis_difference(b, near)));
    nearest.ok_or(Unsolved::OutOfReach)
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
