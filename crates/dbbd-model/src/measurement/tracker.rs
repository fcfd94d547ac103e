//! The frame of a tracker in the robot base, and its coordinate planes.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::MeasuredPosition;
use crate::math::RigidAlignment;
use crate::robot::{Geometry, TrackerPlane};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tracker {
    /// Origin of the tracker's frame in the robot base, mm.
    pub origin: Vector3<f64>,
    /// Rotation vector, rad.
    pub turn: Vector3<f64>,
}

impl Tracker {
    /// The frame in which the positions of the lowest target best fit the tool ball of `geometry`; `None` without positions.
    /// If these positions coincide, the frame is that of the robot base.
    pub(super) fn located(geometry: &Geometry, positions: &[MeasuredPosition]) -> Option<Self> {
        let first = positions.iter().map(|position| position.target).min()?;
        let leading = || positions.iter().filter(|position| position.target == first);
        let measured: Vec<Vector3<f64>> = leading().map(|position| position.place).collect();
        let balls: Vec<Vector3<f64>> =
            leading().map(|position| geometry.ball(&position.axes).position).collect();
        Some(match RigidAlignment::of(&measured, &balls) {
            Some(motion) => Self { origin: motion.shift, turn: motion.rotation.scaled_axis() },
            None => Self { origin: Vector3::zeros(), turn: Vector3::zeros() },
        })
    }

    /// The planes on which x, y and z are zero.
    pub(super) fn planes(&self) -> [TrackerPlane; 3] {
        let axes = Rotation3::new(self.turn);
        let by_turn = left_jacobian(&self.turn);
        [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| {
            let normal = axes * axis;
            let normal_by_turn = [0, 1, 2].map(|k| by_turn.column(k).cross(&normal));
            TrackerPlane { origin: self.origin, normal, normal_by_turn }
        })
    }

    /// Transforms a point of the tracker's frame to the robot base, mm.
    pub(super) fn in_base(&self, place: &Vector3<f64>) -> Vector3<f64> {
        Rotation3::new(self.turn) * place + self.origin
    }
}

/// The left Jacobian of SO(3), from the rate of a rotation vector to the angular velocity (Chirikjian, Stochastic Models,
/// Information Theory, and Lie Groups 2, 10.86).
fn left_jacobian(turn: &Vector3<f64>) -> Matrix3<f64> {
    let (angle, cross) = (turn.norm(), turn.cross_matrix());
    if angle < 1e-4 {
        return Matrix3::identity() + cross * 0.5 + cross * cross / 6.0;
    }
    let (square, cube) = (angle * angle, angle.powi(3));
    Matrix3::identity()
        + cross * ((1.0 - angle.cos()) / square)
        + cross * cross * ((angle - angle.sin()) / cube)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivative_of_a_normal_matches_differences() {
        for turn in [Vector3::new(0.3, -2.0, 1.1), Vector3::new(1e-6, 0.0, 2e-6), Vector3::new(0.0, 3.1, 0.1)]
        {
            let at = |turn| Tracker { origin: Vector3::zeros(), turn }.planes();
            for (axis, plane) in at(turn).iter().enumerate() {
                for k in 0..3 {
                    let step = Vector3::ith(k, 1e-6);
                    let difference = (at(turn + step)[axis].normal - at(turn - step)[axis].normal) / 2e-6;
                    assert!((difference - plane.normal_by_turn[k]).norm() < 1e-8, "{turn} {axis} {k}");
                }
            }
        }
    }

    #[test]
    fn planes_are_the_coordinates_of_a_point() {
        let tracker = Tracker { origin: Vector3::new(10.0, -20.0, 30.0), turn: Vector3::new(0.3, -2.0, 1.1) };
        let place = Vector3::new(100.0, 200.0, -50.0);
        let in_base = tracker.in_base(&place);
        for (axis, plane) in tracker.planes().iter().enumerate() {
            assert!((plane.normal.dot(&(in_base - plane.origin)) - place[axis]).abs() < 1e-12);
        }
        // A quarter turn about z maps x to y.
        let quarter = Tracker { turn: Vector3::z() * std::f64::consts::FRAC_PI_2, ..tracker };
        assert!((quarter.in_base(&Vector3::x()) - Vector3::new(10.0, -19.0, 30.0)).norm() < 1e-14);
        assert!(
            Tracker::located(&crate::robot::Robot::by_name("ur5e").unwrap().unwrap().geometry, &[]).is_none()
        );
    }
}
