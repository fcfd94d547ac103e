//! Errors of a joint that depend on its own angle and on the sense of its last move: a smooth function, backlash and
//! transmission ripple.
//!
//! The true angle of a joint is the angle that its axis reports plus a correction D(q, d). Here q is the joint's own
//! angle (the controller's axis angle; for a coupled joint a sum of two axis angles) and d is the sense of the joint's
//! last move: D = sum_m w_m phi_m(q) + u d + sum_n (c_n cos n q + s_n sin n q), rad, in the sense of the DH table.
//! Where d is not known, its expected value is used: an axis comes to its highest angles from below. The phi_m are the
//! eigenfunctions of the Laplacian on [c - L, c + L]: with them a few coefficients describe a Gaussian process (Solin
//! and Sarkka, Statistics and Computing 30, 2020). Outside that interval nothing is known of the smooth part, and it is
//! zero. The first harmonic of the angle belongs to the geometry (`gear`).

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};

use super::{AXES, Approach, Joint};

#[derive(Clone, Debug, Default, PartialEq)]
pub struct JointErrorModel {
    pub smooth: SmoothJointError,
    /// Half of the reversal error, rad: the joint's angle is larger by this when its axis came through rising angles.
    pub backlash: f64,
    /// The angles at the poses of the program. They give the expected sense of approach where the sense is not known.
    pub visited: VisitedAngles,
    pub ripple: Vec<Ripple>,
}

/// The angles of a joint at the poses of a program: a logistic distribution. A scale of 0 means that they are not
/// known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VisitedAngles {
    /// Median, rad.
    #[serde(rename = "middle_rad")]
    pub middle: f64,
    /// Scale, rad.
    #[serde(rename = "scale_rad")]
    pub scale: f64,
}

/// A smooth function of an axis angle: zero without coefficients.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SmoothJointError {
    /// Middle of the interval, rad.
    #[serde(rename = "centre_rad")]
    pub centre: f64,
    /// Half of the interval, rad.
    #[serde(rename = "half_width_rad")]
    pub half_width: f64,
    /// Coefficients of the basis functions 1, 2, .., rad sqrt(rad).
    pub coefficients: Vec<f64>,
}

/// A periodic error that repeats `order` times a turn of the axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ripple {
    pub order: u32,
    /// Cosine and sine part, rad.
    #[serde(rename = "cos_rad")]
    pub cos: f64,
    #[serde(rename = "sin_rad")]
    pub sin: f64,
}

/// The errors of all joints; empty if no error is known.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JointErrors(Option<Box<[JointErrorModel; AXES]>>);

/// The part of a joint's error to which a coefficient belongs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TermKind {
    /// A basis function of the smooth function, with this angular frequency, 1/rad.
    Smooth {
        frequency: f64,
    },
    Backlash,
    Ripple {
        order: u32,
    },
}

/// One coefficient of the errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointTerm {
    pub joint: Joint,
    pub kind: TermKind,
}

impl VisitedAngles {
    /// The distribution that has the median and the middle two thirds of these angles (rad); not known if those are one angle.
    pub fn of(mut angles: Vec<f64>) -> Self {
        /// F(x) = 5/6 at x = scale ln 5.
        const SIXTH: f64 = 1.0 / 6.0;
        angles.sort_by(f64::total_cmp);
        let at = |share: f64| angles.get((share * angles.len() as f64) as usize).copied().unwrap_or(0.0);
        let width = at(1.0 - SIXTH) - at(SIXTH);
        if width > 0.0 { Self { middle: at(0.5), scale: width / (2.0 * 5f64.ln()) } } else { Self::default() }
    }

    /// The mean sense of an axis that comes to an angle (rad) from another pose of the program: F - (1 - F), with F the
    /// distribution function.
    fn expected_sense(self, angle: f64) -> f64 {
        if self.scale > 0.0 { (0.5 * (angle - self.middle) / self.scale).tanh() } else { 0.0 }
    }
}

impl SmoothJointError {
    /// The interval of the smooth function is this many times as wide as the range of the measured angles, and wider by this margin on
    /// each side, rad: the functions are zero at its ends, which must be a length scale or so away from what was measured.
    const WIDER: f64 = 1.15;
    const MARGIN: f64 = 0.3;

    /// A function that is zero, with `count` basis functions.
    pub fn new(centre: f64, half_width: f64, count: usize) -> Self {
        Self { centre, half_width, coefficients: vec![0.0; count] }
    }

    /// Half of the width of the interval for angles measured from `low` to `high`, rad.
    pub(crate) fn half_width_for([low, high]: [f64; 2]) -> f64 {
        Self::WIDER * 0.5 * (high - low) + Self::MARGIN
    }

    /// The angle in the range of the measured angles that is nearest to `angle`, rad.
    pub(crate) fn nearest_measured(&self, angle: f64) -> f64 {
        let reach = ((self.half_width - Self::MARGIN) / Self::WIDER).max(0.0);
        self.centre + (angle - self.centre).clamp(-reach, reach)
    }

    /// Whether both have the same basis functions.
    pub(crate) fn is_alike(&self, other: &Self) -> bool {
        self.centre == other.centre && self.half_width == other.half_width
    }

    /// Whether the function has coefficients and its interval contains an angle, rad.
    pub fn covers(&self, angle: f64) -> bool {
        (angle - self.centre).abs() <= self.half_width && !self.coefficients.is_empty()
    }

    /// Angular frequency of the basis function `order`, from 1, 1/rad.
    fn frequency(&self, order: usize) -> f64 {
        PI * order as f64 / (2.0 * self.half_width)
    }

    /// Gives the value of each basis function at an angle (rad) to `each`, in order, 1/sqrt(rad).
    fn basis(&self, angle: f64, mut each: impl FnMut(f64)) {
        if !self.covers(angle) {
            self.coefficients.iter().for_each(|_| each(0.0));
            return;
        }
        let (sin, cos) = (self.frequency(1) * (angle - self.centre + self.half_width)).sin_cos();
        let norm = self.half_width.sqrt().recip();
        // sin (m + 1) x = 2 cos x sin m x - sin (m - 1) x
        let (mut before, mut here) = (0.0, sin * norm);
        for _ in &self.coefficients {
            each(here);
            (before, here) = (here, 2.0 * cos * here - before);
        }
    }

    /// The value of the function at an angle (rad), rad.
    pub fn value(&self, angle: f64) -> f64 {
        let (mut sum, mut coefficients) = (0.0, self.coefficients.iter());
        self.basis(angle, |value| sum += coefficients.next().map_or(0.0, |weight| weight * value));
        sum
    }
}

impl JointErrorModel {
    /// The correction of the joint at an axis angle (rad) to which the axis came in this sense (-1, 0 not known, 1), rad.
    pub(super) fn correction(&self, angle: f64, sense: i8) -> f64 {
        self.of_angle(angle) + self.sense(angle, sense) * self.backlash
    }

    /// The sense of approach, or its expected value if it is not known (0).
    fn sense(&self, angle: f64, sense: i8) -> f64 {
        if sense == 0 { self.visited.expected_sense(angle) } else { f64::from(sense) }
    }

    /// The part that the angle alone determines, rad.
    pub(crate) fn of_angle(&self, angle: f64) -> f64 {
        let ripple = self.ripple.iter().map(|ripple| {
            let (sin, cos) = (f64::from(ripple.order) * angle).sin_cos();
            ripple.cos * cos + ripple.sin * sin
        });
        self.smooth.value(angle) + ripple.sum::<f64>()
    }

    /// The number of coefficients: of the smooth function, of backlash, then cosine and sine of each ripple.
    fn count(&self) -> usize {
        self.smooth.coefficients.len() + 1 + 2 * self.ripple.len()
    }

    /// The derivative of the correction by each coefficient.
    fn derivatives(&self, angle: f64, sense: i8, each: &mut impl FnMut(f64)) {
        self.smooth.basis(angle, &mut *each);
        each(self.sense(angle, sense));
        for ripple in &self.ripple {
            let (sin, cos) = (f64::from(ripple.order) * angle).sin_cos();
            each(cos);
            each(sin);
        }
    }

    fn coefficients_mut(&mut self) -> impl Iterator<Item = &mut f64> {
        let ripple = self.ripple.iter_mut().flat_map(|ripple| [&mut ripple.cos, &mut ripple.sin]);
        self.smooth.coefficients.iter_mut().chain([&mut self.backlash]).chain(ripple)
    }

    fn kinds(&self) -> impl Iterator<Item = TermKind> {
        let smooth = (1..=self.smooth.coefficients.len())
            .map(|order| TermKind::Smooth { frequency: self.smooth.frequency(order) });
        let ripple = self.ripple.iter().flat_map(|ripple| [TermKind::Ripple { order: ripple.order }; 2]);
        smooth.chain([TermKind::Backlash]).chain(ripple)
    }
}

impl JointErrors {
    /// The errors of all joints, base to flange; empty if no joint has an error.
    pub fn new(joints: [JointErrorModel; AXES]) -> Self {
        let none = joints.iter().all(|joint| *joint == JointErrorModel::default());
        Self((!none).then(|| Box::new(joints)))
    }

    pub fn is_none(&self) -> bool {
        self.0.is_none()
    }

    /// The error of a joint; `None` if no joint has an error.
    pub fn of(&self, joint: Joint) -> Option<&JointErrorModel> {
        self.at(joint.index())
    }

    /// The error of the joint at this place (from 0); `None` if no joint has an error.
    pub fn at(&self, place: usize) -> Option<&JointErrorModel> {
        self.0.as_ref().map(|joints| &joints[place])
    }

    /// The correction of the joint at this place (from 0), rad.
    pub(super) fn correction(&self, place: usize, angle: f64, sense: i8) -> f64 {
        self.0.as_ref().map_or(0.0, |joints| joints[place].correction(angle, sense))
    }

    /// The number of coefficients of all joints.
    pub fn count(&self) -> usize {
        self.0.iter().flat_map(|joints| joints.iter()).map(JointErrorModel::count).sum()
    }

    /// The joint and the kind of each coefficient, joint by joint.
    pub(crate) fn terms(&self) -> Vec<JointTerm> {
        let of = |joint: Joint| {
            let kinds = self.of(joint).map(|error| error.kinds().collect::<Vec<_>>()).unwrap_or_default();
            kinds.into_iter().map(move |kind| JointTerm { joint, kind })
        };
        Joint::ALL.into_iter().flat_map(of).collect()
    }

    /// The place of each joint's backlash coefficient in [`JointErrors::terms`]; `None` for a joint without one.
    pub(crate) fn backlash_places(&self) -> [Option<usize>; AXES] {
        let terms = self.terms();
        let is_of = |joint: Joint, term: &JointTerm| term.joint == joint && term.kind == TermKind::Backlash;
        Joint::ALL.map(|joint| terms.iter().position(|term| is_of(joint, term)))
    }

    /// The derivative of each joint's correction by each of its coefficients, in the order of [`JointErrors::terms`], to
    /// `each` with the joint's place (from 0), at the joints' own angles (rad) and senses.
    pub(crate) fn derivatives(
        &self,
        angles: &[f64; AXES],
        senses: Approach,
        mut each: impl FnMut(usize, f64),
    ) {
        let joints = self.0.iter().flat_map(|joints| joints.iter()).enumerate();
        for (place, joint) in joints {
            joint.derivatives(angles[place], senses.senses()[place], &mut |value| each(place, value));
        }
    }

    /// Takes the backlash out of the joint at this place (from 0), rad.
    pub(super) fn take_backlash(&mut self, place: usize) -> f64 {
        self.0.as_mut().map_or(0.0, |joints| std::mem::take(&mut joints[place].backlash))
    }

    /// Adds a ripple of amplitude zero to a joint.
    pub fn push(&mut self, joint: Joint, order: u32) {
        let joints = self.0.get_or_insert_with(Box::default);
        joints[joint.index()].ripple.push(Ripple { order, ..Ripple::default() });
    }

    /// The errors with these coefficients, in the order of `JointErrors::terms`.
    pub fn with(&self, coefficients: impl IntoIterator<Item = f64>) -> Self {
        let mut with = self.clone();
        let joints = with.0.iter_mut().flat_map(|joints| joints.iter_mut());
        joints
            .flat_map(JointErrorModel::coefficients_mut)
            .zip(coefficients)
            .for_each(|(own, value)| *own = value);
        with
    }

    /// The coefficients, in the order of [`JointErrors::terms`].
    pub(crate) fn coefficients(&self) -> Vec<f64> {
        let mut of = self.clone();
        let joints = of.0.iter_mut().flat_map(|joints| joints.iter_mut());
        joints.flat_map(JointErrorModel::coefficients_mut).map(|own| *own).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_is_expected_to_come_to_its_highest_angles_from_below() {
        let angles: Vec<f64> =
            (0..600).map(|at| f64::from(at) / 599.0).map(|p| (p / (1.0 - p)).ln()).collect();
        let visited = VisitedAngles::of(angles.into_iter().map(|angle| 2.0 + 0.3 * angle).collect());
        assert!((visited.middle - 2.0).abs() < 0.01 && (visited.scale - 0.3).abs() < 0.01, "{visited:?}");
        // Five of six poses are below: five come from below for one that comes from above.
        assert!((visited.expected_sense(2.0 + 0.3 * 5f64.ln()) - 2.0 / 3.0).abs() < 0.02);
        assert_eq!(VisitedAngles::of(Vec::new()).expected_sense(1.0), 0.0);
    }

    fn errors() -> JointErrors {
        JointErrors::new(std::array::from_fn(|joint| JointErrorModel {
            smooth: SmoothJointError::new(0.1 * joint as f64, 2.0, 4 + joint),
            backlash: 0.0,
            visited: VisitedAngles { middle: 0.1, scale: 0.2 },
            ripple: vec![Ripple { order: 13, cos: 0.0, sin: 0.0 }; joint % 2],
        }))
    }

    #[test]
    fn a_correction_is_linear_in_its_coefficients() {
        let empty = errors();
        let values: Vec<f64> = (0..empty.count()).map(|at| (1.0 + at as f64).sin()).collect();
        let errors = empty.with(values.iter().copied());
        assert_eq!(errors.coefficients(), values);
        assert_eq!(errors.terms().len(), errors.count());
        let axes = [0.3, -0.9, 1.4, 0.2, -1.5, 2.0];
        let approach = Approach::new([1, -1, 0, 1, -1, 1]);
        let (mut sums, mut at) = ([0.0; AXES], 0);
        errors.derivatives(&axes, approach, |place, value| {
            sums[place] += values[at] * value;
            at += 1;
        });
        for (place, sum) in sums.into_iter().enumerate() {
            let correction = errors.correction(place, axes[place], approach.senses()[place]);
            assert!((correction - sum).abs() < 1e-12, "{place}");
        }
    }

    #[test]
    fn basis_functions_are_orthonormal_and_vanish_outside() {
        let smooth = SmoothJointError::new(0.4, 1.5, 6);
        let steps = 4000;
        let mut gram = [[0.0; 6]; 6];
        for step in 0..steps {
            let angle = 0.4 - 1.5 + 3.0 * (step as f64 + 0.5) / f64::from(steps);
            let mut values = Vec::new();
            smooth.basis(angle, |value| values.push(value));
            for i in 0..6 {
                for j in 0..6 {
                    gram[i][j] += values[i] * values[j] * 3.0 / f64::from(steps);
                }
            }
        }
        for (i, row) in gram.iter().enumerate() {
            for (j, value) in row.iter().enumerate() {
                assert!((value - if i == j { 1.0 } else { 0.0 }).abs() < 1e-6);
            }
        }
        assert_eq!(smooth.value(2.0), 0.0);
        assert!(!smooth.covers(2.0) && smooth.covers(-1.0));
    }

    /// phi_m(q) = sin(pi m (q - c + L) / (2 L)) / sqrt(L) of Solin and Sarkka, with c = 0.4, L = 1.5.
    #[test]
    fn smooth_function_is_the_sum_of_its_basis_functions() {
        let smooth = SmoothJointError { centre: 0.4, half_width: 1.5, coefficients: vec![0.3, -0.2, 0.7] };
        let angle = 1.1_f64;
        let phi = |m: f64| (PI * m * (angle - 0.4 + 1.5) / 3.0).sin() / 1.5_f64.sqrt();
        let expected = 0.3 * phi(1.0) - 0.2 * phi(2.0) + 0.7 * phi(3.0);
        assert!((smooth.value(angle) - expected).abs() < 1e-14);
        // Zero at both ends and beyond.
        assert!(smooth.value(-1.1).abs() < 1e-14 && smooth.value(1.9).abs() < 1e-14);
        assert_eq!((smooth.value(-1.2), smooth.value(2.0)), (0.0, 0.0));
        assert!(!SmoothJointError::default().covers(0.0));
        // Angular frequencies pi m / (2 L).
        let kinds: Vec<TermKind> = JointErrorModel { smooth, ..JointErrorModel::default() }.kinds().collect();
        let TermKind::Smooth { frequency } = kinds[1] else { panic!("{kinds:?}") };
        assert!((frequency - 2.0 * PI / 3.0).abs() < 1e-15);
        assert_eq!((kinds.len(), kinds[3]), (4, TermKind::Backlash));
    }

    #[test]
    fn the_interval_is_wider_than_that_of_the_angles() {
        assert!((SmoothJointError::half_width_for([-1.0, 3.0]) - 2.6).abs() < 1e-15);
        let smooth = SmoothJointError::new(1.0, 2.6, 2);
        let nearest = [-5.0, 0.5, 4.0].map(|angle| smooth.nearest_measured(angle));
        assert!(nearest.iter().zip([-1.0, 0.5, 3.0]).all(|(one, other)| (one - other).abs() < 1e-15));
        assert!(smooth.is_alike(&SmoothJointError::new(1.0, 2.6, 5)));
        assert!(!smooth.is_alike(&SmoothJointError::new(1.0, 3.1, 2)));
        assert!(!smooth.is_alike(&SmoothJointError::new(1.1, 2.6, 2)));
    }

    #[test]
    fn ripple_and_backlash_of_a_joint() {
        let error = JointErrorModel {
            backlash: 2e-4,
            visited: VisitedAngles { middle: 0.5, scale: 0.25 },
            ripple: vec![Ripple { order: 3, cos: 1e-4, sin: -4e-4 }],
            ..JointErrorModel::default()
        };
        let of_angle = 1e-4 * 2.1_f64.cos() - 4e-4 * 2.1_f64.sin();
        assert!((error.of_angle(0.7) - of_angle).abs() < 1e-18);
        assert!((error.correction(0.7, 1) - of_angle - 2e-4).abs() < 1e-18);
        assert!((error.correction(0.7, -1) - of_angle + 2e-4).abs() < 1e-18);
        // The expected sense is F - (1 - F) of a logistic distribution: 2 / (1 + e^-0.8) - 1.
        let sense = 2.0 / (1.0 + (-0.8_f64).exp()) - 1.0;
        assert!((error.correction(0.7, 0) - of_angle - 2e-4 * sense).abs() < 1e-17);
    }

    #[test]
    fn backlash_has_its_place_among_the_coefficients() {
        // Joint i has 4 + i basis functions, a backlash, and two parts of a ripple if i is odd.
        let places = errors().backlash_places();
        assert_eq!(places, [Some(4), Some(10), Some(19), Some(27), Some(38), Some(48)]);
        assert_eq!(errors().count(), 51);
        let mut one = JointErrors::default();
        assert!(one.is_none() && one.at(0).is_none());
        one.push(Joint::J4, 7);
        assert_eq!((one.count(), one.backlash_places()[3]), (8, Some(3)));
        let ripple = &one.of(Joint::J4).unwrap().ripple;
        assert_eq!(ripple[..], [Ripple { order: 7, cos: 0.0, sin: 0.0 }]);
    }
}
