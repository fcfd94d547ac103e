//! Joints that turn with a second axis of the controller.
//!
//! A FANUC shows axis 3 against the horizontal: its joint 3 turns by A3 + A2. What a drive in the joint turns is that sum,
//! so the errors of a coupled joint are functions of it.

use std::fmt;

use super::{AXES, Approach, Joint};

/// The second axis of a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoupledAxis {
    /// Nearer to the base than the joint.
    pub axis: Joint,
    /// +1 or -1: a full turn of the axis is one of the joint.
    pub factor: f64,
}

impl fmt::Display for CoupledAxis {
    /// As the second term of a sum.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, " {} A{}", if self.factor < 0.0 { '-' } else { '+' }, self.axis.number())
    }
}

/// From the controller's axis angles A to the joints' own: A_i + factor A_axis for a coupled joint, A_i for any other.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Coupling([Option<CoupledAxis>; AXES]);

impl Coupling {
    /// By joint, base to flange.
    pub fn new(joints: [Option<CoupledAxis>; AXES]) -> Self {
        Self(joints)
    }

    pub fn is_none(&self) -> bool {
        self.0.iter().all(Option::is_none)
    }

    pub fn of(&self, joint: Joint) -> Option<CoupledAxis> {
        self.0[joint.index()]
    }

    /// The coupled joints by their place, from 0, with the place of the second axis and its factor.
    fn pairs(&self) -> impl Iterator<Item = (usize, usize, f64)> {
        let places = self.0.iter().enumerate();
        places.filter_map(|(place, coupled)| coupled.map(|by| (place, by.axis.index(), by.factor)))
    }

    /// What the second axis adds to the angle of a joint (by its place, from 0) at axis angles.
    pub fn added(&self, place: usize, axes: &[f64; AXES]) -> f64 {
        self.0[place].map_or(0.0, |by| by.factor * axes[by.axis.index()])
    }

    /// The joints' own angles at axis angles, both in one unit, in the senses of the axes.
    pub fn joints(&self, axes: &[f64; AXES]) -> [f64; AXES] {
        let mut joints = *axes;
        for (place, ..) in self.pairs() {
            joints[place] += self.added(place, axes);
        }
        joints
    }

    /// The axis angles at which the joints have these angles.
    pub fn axes(&self, joints: &[f64; AXES]) -> [f64; AXES] {
        let mut axes = *joints;
        // The second axis comes before the joint, so that it is an axis angle already.
        for (place, ..) in self.pairs() {
            axes[place] -= self.added(place, &axes);
        }
        axes
    }

    /// Derivatives by the joints' angles as those by the axis angles.
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

    /// Sine and cosine of the joints' angles from those of the axis angles.
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

    /// The senses in which the joints came, where those of the axes say it: that of a sum is not known where the axes
    /// moved against each other.
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
    fn axes_and_joints_are_sums_and_differences() {
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
    fn axes_against_each_other_leave_the_sense_of_their_sum_open() {
        let of = |senses| coupling().senses(Approach::new(senses)).senses();
        assert_eq!(of([1, 1, 1, 1, 1, 1]), [1, 1, 1, 1, 1, 0]);
        assert_eq!(of([1, -1, 1, 0, -1, 1]), [1, -1, 0, 0, -1, 1]);
        assert_eq!(of([0, 0, 1, 0, 0, -1]), [0; AXES]);
    }
}
