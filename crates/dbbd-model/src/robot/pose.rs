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

    /// The pose from a frame of KUKA: X, Y, Z in mm and A, B, C in degrees, R = Rz(A) Ry(B) Rx(C).
    pub fn from_kuka(xyz_mm: [f64; 3], abc_deg: [f64; 3]) -> Self {
        let [a, b, c] = abc_deg.map(f64::to_radians);
        Self { rotation: rot_z(a) * rot_y(b) * rot_x(c), position: Vector3::from(xyz_mm) }
    }

    /// The pose from X, Y, Z, A, B, C: see [`Pose::from_kuka`].
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

    /// The pose from a position in mm and a quaternion, real part first, which need not be normalised; `None` if it is
    /// zero.
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

    /// The pose from a position in mm and a rotation vector: the axis times the angle in rad.
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

#[cfg(test)]
mod tests {
    use super::*;

    fn close<const N: usize>(found: [f64; N], expected: [f64; N]) {
        let apart = found.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(apart < 1e-12, "{found:?} for {expected:?}");
    }

    /// scipy: Rotation.from_euler("ZYX", [30, -40, 110], degrees=True), as_quat and as_rotvec.
    #[test]
    fn kukas_angles_quaternion_and_rotation_vector_match_scipy() {
        let pose = Pose::from_kuka([1.0, 2.0, 3.0], [30.0, -40.0, 110.0]);
        let [x, y, z, w] = [0.7942962447824291, 0.00973604843989426, 0.4101197816203296, 0.44810763172367507];
        close(pose.quaternion(), [w, x, y, z]);
        let turn = [1.9656151156986257, 0.02409343378662478, 1.0149080362588818];
        close(rotation_vector(&pose.rotation).into(), turn);
        close(pose.xyzabc(), [1.0, 2.0, 3.0, 30.0, -40.0, 110.0]);
        for same in [
            Pose::from_quaternion([1.0, 2.0, 3.0], [-2.0 * w, -2.0 * x, -2.0 * y, -2.0 * z]).unwrap(),
            Pose::from_rotation_vector([1.0, 2.0, 3.0], turn),
            Pose::from_xyzabc(pose.xyzabc()),
        ] {
            assert!((same.rotation - pose.rotation).norm() < 1e-14);
            assert_eq!(same.position, pose.position);
        }
        assert!(Pose::from_quaternion([0.0; 3], [0.0; 4]).is_none());
    }

    #[test]
    fn angles_at_the_singularity_keep_the_rotation() {
        for (abc, expected) in
            [([30.0, 90.0, 20.0], [10.0, 90.0, 0.0]), ([30.0, -90.0, 20.0], [50.0, -90.0, 0.0])]
        {
            // Rz(A) Ry(+90) Rx(C) depends on A - C only, with -90 on A + C.
            let pose = Pose::from_kuka([0.0; 3], abc);
            let found = pose.abc_deg();
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{found:?}");
        }
    }

    #[test]
    fn poses_chain_and_invert() {
        let base = Pose::from_kuka([100.0, 0.0, 0.0], [90.0, 0.0, 0.0]);
        let next = Pose::from_kuka([10.0, 20.0, 30.0], [0.0, 0.0, 90.0]);
        let both = base.then(&next);
        // Rz(90) maps (10, 20, 30) to (-20, 10, 30).
        close(both.position.into(), [80.0, 10.0, 30.0]);
        close(both.abc_deg(), [90.0, 0.0, 90.0]);
        let back = both.then(&both.inverse());
        assert!((back.rotation - Matrix3::identity()).norm() < 1e-15 && back.position.norm() < 1e-13);
        // Two right angles about z and x are a third of a turn about their diagonal.
        let third = std::f64::consts::TAU / 3.0;
        assert!((Pose::identity().angle_to(&both) - third).abs() < 1e-14);
        assert!((base.angle_to(&both) - std::f64::consts::FRAC_PI_2).abs() < 1e-14);
    }

    #[test]
    fn rotation_vectors_are_accurate_near_zero_and_half_a_turn() {
        for turn in [Vector3::new(1e-9, -2e-9, 0.0), Vector3::new(0.0, 3.13, 0.01), Vector3::zeros()] {
            let pose = Pose::from_rotation_vector([0.0; 3], turn.into());
            assert!((rotation_vector(&pose.rotation) - turn).norm() < 1e-14 * (1.0 + turn.norm()), "{turn}");
        }
    }
}
