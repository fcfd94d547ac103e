//! Rigid poses and their representations: KUKA's A, B, C, quaternions, rotation vectors.

use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};

/// The pose of a frame in a reference frame: `rotation` maps coordinates of the frame to those of the reference frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    pub rotation: Matrix3<f64>,
    /// The origin of the frame, mm.
    pub position: Vector3<f64>,
}

impl Pose {
    /// The pose of the reference frame itself.
    pub fn identity() -> Self {
        Self { rotation: Matrix3::identity(), position: Vector3::zeros() }
    }

    /// From a frame of KUKA: X, Y, Z in mm and A, B, C in degrees, R = Rz(A) Ry(B) Rx(C).
    pub fn from_kuka(xyz_mm: [f64; 3], abc_deg: [f64; 3]) -> Self {
        let [a, b, c] = abc_deg.map(f64::to_radians);
        Self { rotation: rot_z(a) * rot_y(b) * rot_x(c), position: Vector3::from(xyz_mm) }
    }

    /// From X, Y, Z, A, B, C: see [`Pose::from_kuka`].
    pub fn from_xyzabc([x, y, z, a, b, c]: [f64; 6]) -> Self {
        Self::from_kuka([x, y, z], [a, b, c])
    }

    /// X, Y, Z in mm and KUKA's A, B, C in degrees.
    pub fn xyzabc(&self) -> [f64; 6] {
        let ([x, y, z], [a, b, c]) = (self.position.into(), self.abc_deg());
        [x, y, z, a, b, c]
    }

    /// KUKA's A, B, C in degrees; at |B| = 90, where only a combination of A and C is defined, C is 0.
    pub fn abc_deg(&self) -> [f64; 3] {
        let r = &self.rotation;
        let cos_b = r[(0, 0)].hypot(r[(1, 0)]);
        let b = (-r[(2, 0)]).atan2(cos_b);
        let (a, c) = if cos_b > 1e-10 {
            (r[(1, 0)].atan2(r[(0, 0)]), r[(2, 1)].atan2(r[(2, 2)]))
        } else {
            ((-r[(0, 1)]).atan2(r[(1, 1)]), 0.0)
        };
        [a, b, c].map(f64::to_degrees)
    }

    /// From a position in mm and a quaternion, real part first, which need not be normalised; `None` if it is zero.
    pub fn from_quaternion(xyz_mm: [f64; 3], [w, x, y, z]: [f64; 4]) -> Option<Self> {
        let turn = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-6)?;
        Some(Self { rotation: *turn.to_rotation_matrix().matrix(), position: Vector3::from(xyz_mm) })
    }

    /// The orientation as a unit quaternion, real part first and not negative.
    pub fn quaternion(&self) -> [f64; 4] {
        let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(self.rotation));
        let sign = if turn.w < 0.0 { -1.0 } else { 1.0 };
        [turn.w, turn.i, turn.j, turn.k].map(|part| sign * part)
    }

    /// From a position in mm and a rotation vector: the axis times the angle in rad.
    pub fn from_rotation_vector(xyz_mm: [f64; 3], turn: [f64; 3]) -> Self {
        let rotation = *Rotation3::new(Vector3::from(turn)).matrix();
        Self { rotation, position: Vector3::from(xyz_mm) }
    }

    /// The pose in the reference frame of `next`, which is given in this frame.
    pub fn then(&self, next: &Pose) -> Pose {
        Pose {
            rotation: self.rotation * next.rotation,
            position: self.position + self.rotation * next.position,
        }
    }

    /// The pose of the reference frame in this frame.
    pub fn inverse(&self) -> Pose {
        let transposed = self.rotation.transpose();
        Pose { rotation: transposed, position: -(transposed * self.position) }
    }

    /// The angle of the rotation between the two orientations, rad, in 0..=pi.
    pub fn angle_to(&self, other: &Pose) -> f64 {
        rotation_vector(&(self.rotation.transpose() * other.rotation)).norm()
    }
}

/// Whether a number is a multiple of an eighth of a turn in radians: where degrees are expected, it was probably given in
/// radians.
pub fn is_part_of_turn(value: f64) -> bool {
    use std::f64::consts::FRAC_PI_4;
    /// Of a number with five significant digits.
    const ROUNDED: f64 = 5e-5;
    let parts = (value / FRAC_PI_4).round();
    (1.0..=8.0).contains(&parts.abs()) && (value - parts * FRAC_PI_4).abs() < ROUNDED
}

/// The axis of a rotation times its angle (rad, 0..=pi). Unlike the arc cosine of the trace it keeps its accuracy near
/// zero, and it is finite if rounding has made the trace greater than three.
pub fn rotation_vector(rotation: &Matrix3<f64>) -> Vector3<f64> {
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*rotation));
    let (axis, cosine) = (turn.imag(), turn.w);
    let sine = axis.norm();
    if sine == 0.0 {
        Vector3::zeros()
    } else {
        axis * (2.0 * sine.atan2(cosine.abs()) * cosine.signum() / sine)
    }
}

/// Rotation about x by `angle` rad.
pub fn rot_x(angle: f64) -> Matrix3<f64> {
    let (s, c) = angle.sin_cos();
    Matrix3::new(1.0, 0.0, 0.0, 0.0, c, -s, 0.0, s, c)
}

/// Rotation about y by `angle` rad.
pub fn rot_y(angle: f64) -> Matrix3<f64> {
    let (s, c) = angle.sin_cos();
    Matrix3::new(c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c)
}

/// Rotation about z by `angle` rad.
pub fn rot_z(angle: f64) -> Matrix3<f64> {
    let (s, c) = angle.sin_cos();
    Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0)
}
