//! Axis angles for a pose: closed forms for a spherical wrist and for three parallel axes, a search for any other arm,
//! damped least squares from a neighbour.
//!
//! An identified robot has no exact closed form: its twists are not quite right angles, and its wrist axes do not quite
//! meet. Its branches start from those of the ideal arm nearby; the damped iteration carries each over to the real arm.

mod closed;
mod configuration;
mod iterate;
mod search;

use std::f64::consts::TAU;

use super::pose::Pose;
use super::{AXES, Geometry, max_axis_difference};

pub use crate::robot::RobotFinding as Unsolved;
pub use configuration::{
    FanucConfiguration, SingularityClearance, clearance, from_fanuc, from_quadrants, from_status_turn,
    quadrants, status, turn, turns_within,
};
pub use iterate::numeric;

/// For an arm without a closed form: if the damped iteration turned no axis by more than this, it stayed in its branch,
/// rad.
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
        // The true arm may just reach a pose that the ideal one does not reach.
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    use crate::robot::Robot;

    fn geometry(name: &str) -> Geometry {
        Robot::by_name(name).unwrap().unwrap().geometry
    }

    #[test]
    fn angles_are_wrapped_to_half_a_turn_and_unwound_to_a_neighbour() {
        for (angle, expected) in [(0.5, 0.5), (PI, PI), (-PI, PI), (4.0, 4.0 - TAU), (-9.0, -9.0 + TAU)] {
            assert!((wrapped(angle) - expected).abs() < 1e-12, "{angle}");
        }
        let axes = unwound(&[3.0, -3.0, 0.0, 7.0, 0.1, -6.0], &[-3.0, 3.0, 0.0, 0.5, 6.4, 0.0]);
        let expected = [3.0 - TAU, -3.0 + TAU, 0.0, 7.0 - TAU, 0.1 + TAU, -6.0 + TAU];
        assert!(max_axis_difference(&axes, &expected) < 1e-12, "{axes:?}");
    }

    /// A spherical wrist has two shoulders, two elbows and two flips; so have three parallel axes.
    #[test]
    fn all_eight_branches_reach_the_pose() {
        for (name, axes) in [
            ("kr60ha", [0.3, -1.9, 2.0, 0.4, 0.9, -0.5]),
            ("irb120", [-0.6, 0.3, 0.2, 1.0, -0.8, 0.7]),
            ("ur10e", [0.4, -1.3, 1.4, -0.7, 1.1, 0.2]),
        ] {
            let geometry = geometry(name);
            let ball = geometry.ball(&axes);
            let found = branches(&geometry, &ball).unwrap();
            assert_eq!(found.len(), 8, "{name}");
            for branch in &found {
                let there = geometry.ball(branch);
                assert!((there.position - ball.position).norm() < 1e-8, "{name} {branch:?}");
                assert!(there.angle_to(&ball) < 1e-9, "{name} {branch:?}");
                assert!(branch.iter().all(|angle| *angle > -PI && *angle <= PI));
            }
            assert!(found.iter().any(|branch| max_axis_difference(branch, &axes) < 1e-9), "{name}");
            let different = |a: usize, b: usize| max_axis_difference(&found[a], &found[b]) > 1e-3;
            assert!((0..8).all(|a| (0..a).all(|b| different(a, b))), "{name}");
        }
    }

    #[test]
    fn nearest_keeps_branch_and_turn() {
        for name in ["kr60ha", "ur10e", "crx10ia"] {
            let geometry = geometry(name);
            let axes = [0.3, -1.2, 1.5, 0.4 + TAU, 0.9, -0.5 - TAU];
            let near = axes.map(|angle| angle + 0.02);
            let found = nearest(&geometry, &geometry.ball(&axes), &near).unwrap();
            assert!(max_axis_difference(&found, &axes) < 1e-8, "{name} {found:?}");
        }
    }

    #[test]
    fn an_arm_with_errors_is_solved_to_the_last_nanometre() {
        let mut geometry = geometry("kr60ha");
        geometry.rows[2].beta = 2e-3;
        geometry.rows[4].a = 0.3;
        geometry.rows[3].alpha += 1e-3;
        let axes = [0.3, -1.9, 2.0, 0.4, 0.9, -0.5];
        let ball = geometry.ball(&axes);
        let found = branches(&geometry, &ball).unwrap();
        assert_eq!(found.len(), 8);
        assert!(found.iter().all(|branch| (geometry.ball(branch).position - ball.position).norm() < 1e-8));
        assert!(found.iter().any(|branch| max_axis_difference(branch, &axes) < 1e-9));
        let start = axes.map(|angle| angle - 0.05);
        assert!(max_axis_difference(&numeric(&geometry, &ball, &start).unwrap(), &axes) < 1e-9);
    }

    #[test]
    fn poses_beyond_the_arm_are_refused() {
        let geometry = geometry("kr60ha");
        let far = Pose { position: nalgebra::Vector3::new(5000.0, 0.0, 0.0), ..Pose::identity() };
        assert!(matches!(branches(&geometry, &far), Err(Unsolved::OutOfReach)));
        assert!(matches!(nearest(&geometry, &far, &[0.0; AXES]), Err(Unsolved::OutOfReach)));
        assert!(matches!(numeric(&geometry, &far, &[0.1; AXES]), Err(Unsolved::NotConverged { .. })));
    }
}
