//! Joints that turn with a second axis of the controller.
//!
//! A FANUC displays axis 3 relative to the horizontal: its joint 3 turns by A3 + A2. The drive in the joint turns by that sum,
//! so the errors of a coupled joint are functions of it.

use std::fmt;

use super::{AXES, Approach, Joint};

/// The second axis of a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoupledAxis {
    /// It is nearer to the base than the joint.
    pub axis: Joint,
    /// +1 or -1.
    pub factor: f64,
}

impl fmt::Display for CoupledAxis {
    /// The second term of the sum: ` + A2`.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, " {} A{}", if self.factor < 0.0 { '-' } else { '+' }, self.axis.number())
    }
}

/// Converts axis angles A of the controller to the own angles of the joints: A_i + factor A_axis for a coupled joint, else A_i.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Coupling([Option<CoupledAxis>; AXES]);

impl Coupling {
    /// The coupling from the second axis of each joint, base to flange.
    pub fn new(joints: [Option<CoupledAxis>; AXES]) -> Self {
        Self(joints)
    }

    pub fn is_none(&self) -> bool {
        self.0.iter().all(Option::is_none)
    }

    pub fn of(&self, joint: Joint) -> Option<CoupledAxis> {
        self.0[joint.index()]
    }

    /// Index of each coupled joint, index of its second axis, factor.
    fn pairs(&self) -> impl Iterator<Item = (usize, usize, f64)> {
        let places = self.0.iter().enumerate();
        places.filter_map(|(place, coupled)| coupled.map(|by| (place, by.axis.index(), by.factor)))
    }

    /// The part that the second axis adds to the angle of a joint (by its index) at axis angles.
    pub(super) fn added(&self, joint: usize, axes: &[f64; AXES]) -> f64 {
        self.0[joint].map_or(0.0, |by| by.factor * axes[by.axis.index()])
    }

    /// The own angles of the joints at axis angles, in the same unit and with the senses of the axes.
    pub fn joints(&self, axes: &[f64; AXES]) -> [f64; AXES] {
        let mut joints = *axes;
        for (place, ..) in self.pairs() {
            joints[place] += self.added(place, axes);
        }
        joints
    }

    /// The axis angles at own angles of the joints: the inverse of [`Self::joints`].
    pub fn axes(&self, joints: &[f64; AXES]) -> [f64; AXES] {
        let mut axes = *joints;
        // The second axis is nearer to the base: its angle is an axis angle already.
        for (place, ..) in self.pairs() {
            axes[place] -= self.added(place, &axes);
        }
        axes
    }

    /// Derivatives with respect to the axis angles from those with respect to the joints' angles.
    pub(super) fn by_axis<T: Copy + std::ops::AddAssign + std::ops::Mul<f64, Output = T>>(
        &self,
        by_joint: [T; AXES],
    ) -> [T; AXES] {
        let mut by_axis = by_joint;
        for (place, axis, factor) in self.pairs() {
            by_axis[axis] += by_joint[place] * factor;
        }
        by_axis
    }

    /// Sine and cosine of the joints' angles, from those of the axis angles.
    #[inline]
    pub fn sin_cos(&self, axes: &[[f64; 2]; AXES]) -> [[f64; 2]; AXES] {
        let mut joints = *axes;
        for (place, axis, factor) in self.pairs() {
            let ([sin, cos], [other_sin, other_cos]) = (axes[place], axes[axis]);
            let other_sin = factor * other_sin;
            joints[place] = [sin * other_cos + cos * other_sin, cos * other_cos - sin * other_sin];
        }
        joints
    }

    /// The senses in which the joints approached a pose. The sense of a sum is unknown if its axes moved in opposite
    /// senses.
    pub fn senses(&self, approach: Approach) -> Approach {
        let senses = approach.senses();
        let mut joints = senses;
        for (place, axis, factor) in self.pairs() {
            if f64::from(senses[axis]) * factor != f64::from(senses[place]) {
                joints[place] = 0;
            }
        }
        Approach::new(joints)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Joint 3 turns by A3 + A2, joint 6 by A6 - A5.
    fn coupling() -> Coupling {
        let by = |axis, factor| Some(CoupledAxis { axis, factor });
        Coupling::new([None, None, by(Joint::J2, 1.0), None, None, by(Joint::J5, -1.0)])
    }

    #[test]
    fn joints_are_sums_of_axes() {
        let axes = [10.0, 40.0, -60.0, 5.0, 30.0, 70.0];
        let joints = [10.0, 40.0, -20.0, 5.0, 30.0, 40.0];
        assert_eq!(coupling().joints(&axes), joints);
        assert_eq!(coupling().axes(&joints), axes);
        assert_eq!(coupling().by_axis([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), [1.0, 5.0, 3.0, 4.0, -1.0, 6.0]);
        let sin_cos = coupling().sin_cos(&axes.map(|angle| angle.to_radians().sin_cos().into()));
        for (found, joint) in sin_cos.iter().zip(joints) {
            let (sin, cos) = joint.to_radians().sin_cos();
            assert!((found[0] - sin).abs() < 1e-15 && (found[1] - cos).abs() < 1e-15);
        }
    }

    #[test]
    fn sense_of_a_sum_is_unknown_if_its_axes_move_in_opposite_senses() {
        let of = |senses| coupling().senses(Approach::new(senses)).senses();
        assert_eq!(of([1, 1, 1, 1, 1, 1]), [1, 1, 1, 1, 1, 0]);
        assert_eq!(of([1, -1, 1, 0, -1, 1]), [1, -1, 0, 0, -1, 1]);
        assert_eq!(of([0, 0, 1, 0, 0, -1]), [0; AXES]);
    }

    #[test]
    fn a_coupling_names_its_second_axis() {
        assert!(Coupling::default().is_none() && !coupling().is_none());
        assert_eq!(coupling().of(Joint::J3).map(|by| by.to_string()).as_deref(), Some(" + A2"));
        assert_eq!(coupling().of(Joint::J6).map(|by| by.to_string()).as_deref(), Some(" - A5"));
        assert_eq!(coupling().of(Joint::J1), None);
        let axes = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        assert_eq!([0, 2, 5].map(|joint| coupling().added(joint, &axes)), [0.0, 2.0, -5.0]);
    }
}
