//! Damped least squares (Levenberg-Marquardt) to a pose, for any arm.

use nalgebra::{Matrix6, Vector6};

use super::Unsolved;
use crate::robot::pose::{Pose, rotation_vector};
use crate::robot::{AXES, Geometry};

/// The iteration stops at this distance (mm) and rotation (rad) from the pose.
const NEAR_MM: f64 = 0.9e-9;
const NEAR_RAD: f64 = 1e-11;

/// Lever that makes a turn comparable to a distance, mm/rad: the size of an industrial arm.
const LEVER_MM: f64 = 1000.0;

/// Steps before the iteration gives up.
const MAX_INVERSE_STEPS: usize = 100;

/// For two branches that meet: number of multiplications by the inverse that give their direction, step of a difference
/// and largest distance, rad.
const POWERS: usize = 6;
const DIFFERENCE: f64 = 1e-4;
const MAX_BRANCH_DISTANCE_RAD: f64 = 1.0;

/// The axis angles (rad) for `ball` that the damped iteration reaches from `start`, to 1e-9 mm (with room for rounding) and
/// 1e-11 rad; they stay in the branch and turn of `start` when that is near.
///
/// # Errors
/// No convergence: out of reach, or a start on the far side of a singularity.
pub fn numeric(geometry: &Geometry, ball: &Pose, start: &[f64; AXES]) -> Result<[f64; AXES], Unsolved> {
    let mut axes = *start;
    let mut error = miss(geometry, ball, &axes);
    let mut damping = 1e-6;
    for _ in 0..MAX_INVERSE_STEPS {
        let (distance, turn) = (error.fixed_rows::<3>(0).norm(), error.fixed_rows::<3>(3).norm() / LEVER_MM);
        if distance < NEAR_MM && turn < NEAR_RAD {
            return Ok(axes);
        }
        let jacobian = jacobian(geometry, &axes);
        let mut normal = jacobian.transpose() * jacobian;
        for i in 0..AXES {
            normal[(i, i)] += damping * LEVER_MM * LEVER_MM;
        }
        let Some(step) = normal.cholesky().map(|factor| factor.solve(&(jacobian.transpose() * error))) else {
            damping *= 10.0;
            continue;
        };
        let tried: [f64; AXES] = std::array::from_fn(|i| axes[i] + step[i]);
        let missed = miss(geometry, ball, &tried);
        if missed.norm() < error.norm() {
            (axes, error) = (tried, missed);
            damping = (damping * 0.1).max(1e-15);
        } else {
            damping *= 10.0;
        }
    }
    Err(Unsolved::NotConverged { distance_mm: error.fixed_rows::<3>(0).norm() })
}

/// The other one of two branches that meet near `axes`, to second order. It lies along the direction in which the pose
/// hardly changes, where the curvature of the pose undoes its slope.
pub(super) fn twin(geometry: &Geometry, axes: &[f64; AXES]) -> Option<[f64; AXES]> {
    let here = jacobian(geometry, axes);
    let inverse = here.try_inverse()?;
    let mut along = Vector6::from_element(1.0);
    for _ in 0..POWERS {
        along = (inverse * (inverse.transpose() * along)).try_normalize(0.0)?;
    }
    let slope = (here * along).norm();
    let changes = here * along / slope;
    let at = |t: f64| std::array::from_fn(|i| axes[i] + t * along[i]);
    let turned = (jacobian(geometry, &at(DIFFERENCE)) - jacobian(geometry, &at(-DIFFERENCE))) * along;
    let curvature = changes.dot(&turned) / (2.0 * DIFFERENCE);
    let far = -2.0 * slope / curvature;
    (far.abs() < MAX_BRANCH_DISTANCE_RAD).then(|| at(far))
}

/// Six columns of shift in mm and turn times the lever, per rad of each axis.
fn jacobian(geometry: &Geometry, axes: &[f64; AXES]) -> Matrix6<f64> {
    let mut jacobian = Matrix6::zeros();
    for (i, (shift, turn)) in geometry.axis_jacobian(axes).iter().enumerate() {
        jacobian.fixed_view_mut::<3, 1>(0, i).copy_from(shift);
        jacobian.fixed_view_mut::<3, 1>(3, i).copy_from(&(turn * LEVER_MM));
    }
    jacobian
}

/// The difference from the pose at `axes` to `ball`: the shift in mm, then the rotation times the lever. Values that
/// are not finite count as far away.
fn miss(geometry: &Geometry, ball: &Pose, axes: &[f64; AXES]) -> Vector6<f64> {
    let there = geometry.ball(axes);
    let shift = ball.position - there.position;
    let turn = rotation_vector(&(ball.rotation * there.rotation.transpose()));
    let mut miss = Vector6::zeros();
    miss.fixed_rows_mut::<3>(0).copy_from(&shift);
    miss.fixed_rows_mut::<3>(3).copy_from(&(turn * LEVER_MM));
    miss
}
