//! The closed forms: shoulder, two parallel axes, and a spherical wrist or a third parallel axis.
//!
//! The point where axes 5 and 6 meet follows from the pose. Its side offset in frame 1 is the side offset of the arm,
//! which leaves two angles of joint 1. With a spherical wrist joints 2 and 3 are a planar two-link arm to that point
//! (two elbows), and the remaining rotation is made by the wrist (two flips). If axis 4 is parallel to axes 2 and 3,
//! the rotation gives joints 5, 6 and the sum of 2, 3 and 4 first (two flips); then joints 2 and 3 are the two-link arm
//! to axis 4 (two elbows).

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Matrix3, Vector3};

use super::Unsolved;
use crate::robot::pose::{Pose, rot_x, rot_z};
use crate::robot::{AXES, Coupling, DhRow, Geometry};

/// Largest deviation of a twist from a right angle, rad, and largest distance of axes that shall meet, mm, for the arm
/// to count as near one with a closed form: far above any real robot's errors, far below a design.
const NEAR_RAD: f64 = 0.3;
const NEAR_MM: f64 = 10.0;

/// Below this sine the wrist is straight: axes 4 and 6 are parallel.
const STRAIGHT: f64 = 1e-9;

/// The relation of axis 4 to the axes around it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FourthAxis {
    /// It meets axes 5 and 6 in one point.
    Wrist,
    /// It is parallel to axes 2 and 3.
    Parallel,
}

/// An arm that has a closed form exactly.
pub(super) struct ClosedFormArm {
    rows: [DhRow; AXES],
    coupling: Coupling,
    tool: Vector3<f64>,
    fourth: FourthAxis,
    exact: bool,
}

impl ClosedFormArm {
    /// The arm itself where it has a closed form, else the ideal one nearby, if there is one.
    pub(super) fn near(geometry: &Geometry) -> Option<Self> {
        let mut rows = geometry.rows;
        let mut exact = geometry.is_rigid();
        let is_parallel = |alpha: f64| quarters(alpha).rem_euclid(2.0) == 0.0;
        let fourth = if is_parallel(rows[3].alpha) { FourthAxis::Parallel } else { FourthAxis::Wrist };
        for (i, row) in rows.iter_mut().enumerate() {
            exact &= row.beta == 0.0;
            if row.beta.abs() > NEAR_RAD {
                return None;
            }
            row.beta = 0.0;
            // The base may be tilted at will; after it every twist is a right angle or none.
            if i > 0 {
                let ideal = quarters(row.alpha) * FRAC_PI_2;
                let off = (row.alpha - ideal).abs();
                let parallel = i == 2 || i == 3 && fourth == FourthAxis::Parallel;
                if off > NEAR_RAD || is_parallel(row.alpha) != parallel {
                    return None;
                }
                exact &= off < 1e-12;
                row.alpha = ideal;
            }
        }
        let [.., five, six] = &mut rows;
        let offsets = match fourth {
            FourthAxis::Wrist => vec![&mut five.a, &mut five.d, &mut six.a],
            FourthAxis::Parallel => vec![&mut six.a],
        };
        for offset in offsets {
            if offset.abs() > NEAR_MM {
                return None;
            }
            exact &= offset.abs() < 1e-12;
            *offset = 0.0;
        }
        Some(Self { rows, coupling: geometry.coupling, tool: geometry.tool, fourth, exact })
    }

    /// Whether it is the arm that was given, to the last digit.
    pub(super) fn is_exact(&self) -> bool {
        self.exact
    }

    /// The forearm in frame 3, mm.
    fn forearm(&self) -> Vector3<f64> {
        forearm(&self.rows)
    }

    /// +1 when axis 3 points as axis 2 does, -1 when it points the other way.
    fn fold(&self) -> f64 {
        self.rows[2].alpha.cos().signum()
    }

    /// Whether axes 4, 5 and 6 meet; otherwise axes 2, 3 and 4 are parallel.
    pub(super) fn has_wrist(&self) -> bool {
        matches!(self.fourth, FourthAxis::Wrist)
    }

    /// As [`elbow`], at axis angles.
    pub(super) fn elbow(&self, axes: &[f64; AXES]) -> f64 {
        elbow(&self.rows, &self.coupling.joints(axes))
    }

    /// The angle of joint 5 from a straight wrist at axis angles, rad, in (-pi, pi], in the sense of the controller's axis angle; errors
    /// of the joint's zero do not count.
    pub(super) fn wrist(&self, axes: &[f64; AXES]) -> f64 {
        let row = &self.rows[4];
        super::wrapped(self.coupling.joints(axes)[4] + row.sign * quarters(row.theta) * FRAC_PI_2)
    }

    /// The angle of joint `i`, from 0, in the table's sense at the joints' own angles.
    fn joint(&self, i: usize, joints: &[f64; AXES]) -> f64 {
        self.rows[i].sign * joints[i] + self.rows[i].theta
    }

    /// The branches at `ball`; where the wrist is straight, the axis that may be chosen (4, or 6 of an arm with
    /// three parallel axes) is that of `near`. Angles in rad, not wrapped.
    pub(super) fn branches(&self, ball: &Pose, near: &[f64; AXES]) -> Result<Vec<[f64; AXES]>, Unsolved> {
        let rows = &self.rows;
        let near = &self.coupling.joints(near);
        let flange = ball.position - ball.rotation * self.tool;
        let wrist = flange - ball.rotation.column(2) * rows[5].d;
        // Before joint 1: out of the base's tilt and shift.
        let tilt = rot_x(rows[0].alpha);
        let mut seen = tilt.transpose() * wrist;
        seen.x -= rows[0].a;
        seen.z -= rows[0].d;

        let side = rows[1].d + self.fold() * (rows[2].d + self.forearm().z);
        let twist = rows[1].alpha.sin().signum();
        let radius_squared = seen.x * seen.x + seen.y * seen.y;
        let Some(forward) = root(radius_squared - side * side, radius_squared) else {
            return Err(Unsolved::OutOfReach);
        };
        let mut found = Vec::with_capacity(8);
        for forward in [forward, -forward] {
            let theta1 = seen.y.atan2(seen.x) - (-twist * side).atan2(forward);
            // After the twist of row 2: the plane of the arm.
            let turned = tilt * rot_z(theta1) * rot_x(rows[1].alpha);
            let wrist = [forward - rows[1].a, twist * seen.z];
            let others = match self.fourth {
                FourthAxis::Wrist => self.with_wrist(wrist, &turned, &ball.rotation, near),
                FourthAxis::Parallel => {
                    self.with_parallel(wrist, &(turned.transpose() * ball.rotation), near)
                }
            };
            for [theta2, theta3, theta4, theta5, theta6] in others {
                let thetas = [theta1, theta2, theta3, theta4, theta5, theta6];
                let joints = std::array::from_fn(|i| rows[i].sign * (thetas[i] - rows[i].theta));
                found.push(self.coupling.axes(&joints));
            }
        }
        if found.is_empty() { Err(Unsolved::OutOfReach) } else { Ok(found) }
    }

    /// Joints 2 to 6 of an arm with a spherical wrist, its plane `turned`.
    fn with_wrist(
        &self,
        wrist: [f64; 2],
        turned: &Matrix3<f64>,
        rotation: &Matrix3<f64>,
        near: &[f64; AXES],
    ) -> Vec<[f64; 5]> {
        let rows = &self.rows;
        let mut found = Vec::with_capacity(4);
        for (theta2, theta3) in self.elbows(wrist) {
            let carried =
                turned * rot_z(theta2) * rot_x(rows[2].alpha) * rot_z(theta3) * rot_x(rows[3].alpha);
            let flips = self.flips(&(carried.transpose() * rotation), rows[4].alpha, near);
            found.extend(
                flips.into_iter().map(|[theta4, theta5, theta6]| [theta2, theta3, theta4, theta5, theta6]),
            );
        }
        found
    }

    /// Joints 2 to 6 of an arm with three parallel axes.
    fn with_parallel(&self, wrist: [f64; 2], rotation: &Matrix3<f64>, near: &[f64; AXES]) -> Vec<[f64; 5]> {
        let rows = &self.rows;
        let folded = rows[2].alpha + rows[3].alpha;
        let mut found = Vec::with_capacity(4);
        for [sum, theta5, theta6] in self.flips(rotation, folded + rows[4].alpha, near) {
            // From the wrist back to axis 4, in the plane.
            let fourth = rot_z(sum) * rot_x(folded);
            let back = fourth * (Vector3::x() * rows[4].a + rot_x(rows[4].alpha).column(2) * rows[4].d);
            for (theta2, theta3) in self.elbows([wrist[0] - back.x, wrist[1] - back.y]) {
                let theta4 = folded.cos().signum() * (sum - theta2 - self.fold() * theta3);
                found.push([theta2, theta3, theta4, theta5, theta6]);
            }
        }
        found
    }

    /// Joints 2 and 3 that bring the end of the forearm to `target` in the plane of the arm, from joint 2.
    fn elbows(&self, target: [f64; 2]) -> Vec<(f64, f64)> {
        let forearm = self.forearm();
        let (upper, lower) = (self.rows[2].a, forearm.x.hypot(forearm.y));
        let bend = forearm.y.atan2(forearm.x);
        let product = 2.0 * upper * lower;
        if product == 0.0 {
            return Vec::new();
        }
        let [x, y] = target;
        let cos = (x * x + y * y - upper * upper - lower * lower) / product;
        let Some(sin) = root(1.0 - cos * cos, 1.0) else {
            return Vec::new();
        };
        [sin, -sin]
            .map(|sin| {
                let theta2 = y.atan2(x) - (lower * sin).atan2(upper + lower * cos);
                (theta2, self.fold() * sin.atan2(cos) - bend)
            })
            .to_vec()
    }

    /// The first angle, theta 5 and theta 6 for which `left` is `Rz Rx(twist) Rz(theta5) Rx(alpha6) Rz(theta6)`; the
    /// twist is an odd number of right angles.
    fn flips(&self, left: &Matrix3<f64>, twist: f64, near: &[f64; AXES]) -> Vec<[f64; 3]> {
        let last = rot_x(self.rows[5].alpha);
        let (twist5, twist6) = (twist.sin().signum(), self.rows[5].alpha.sin().signum());
        let sine = left[(0, 2)].hypot(left[(1, 2)]);
        let cosine = -twist5 * twist6 * left[(2, 2)];
        let about_z = |rotation: Matrix3<f64>| rotation[(1, 0)].atan2(rotation[(0, 0)]);
        let with_first = |first: f64, theta5: f64| {
            let before = rot_z(first) * rot_x(twist) * rot_z(theta5) * last;
            [first, theta5, about_z(before.transpose() * left)]
        };
        if sine >= STRAIGHT {
            let flip = |sign: f64| {
                let side = sign * twist6;
                with_first((side * left[(1, 2)]).atan2(side * left[(0, 2)]), (sign * sine).atan2(cosine))
            };
            return vec![flip(1.0), flip(-1.0)];
        }
        let theta5 = sine.atan2(cosine);
        vec![match self.fourth {
            FourthAxis::Wrist => with_first(self.joint(3, near), theta5),
            FourthAxis::Parallel => {
                let theta6 = self.joint(5, near);
                let after = rot_x(twist) * rot_z(theta5) * last * rot_z(theta6);
                [about_z(left * after.transpose()), theta5, theta6]
            }
        }]
    }
}

/// The forearm in frame 3, from joint 3 to the wrist centre or to axis 4, mm.
fn forearm(rows: &[DhRow; AXES]) -> Vector3<f64> {
    let DhRow { alpha, a, d, .. } = rows[3];
    Vector3::new(a, -alpha.sin() * d, alpha.cos() * d)
}

/// The angle between upper arm and forearm at the joints' own angles, rad, in (-pi, pi]; 0 is stretched, and it grows with
/// the controller's axis angle.
pub(super) fn elbow(rows: &[DhRow; AXES], joints: &[f64; AXES]) -> f64 {
    let (row, forearm) = (&rows[2], forearm(rows));
    let joint = row.sign * joints[2] + row.theta + forearm.y.atan2(forearm.x);
    super::wrapped(row.sign * joint + if row.a < 0.0 { PI } else { 0.0 })
}

/// The number of right angles that is nearest to an angle.
fn quarters(angle: f64) -> f64 {
    (angle / FRAC_PI_2).round()
}

/// The square root of a value that rounding may have pushed below zero: within 1e-12 of `scale`.
fn root(value: f64, scale: f64) -> Option<f64> {
    if value >= 0.0 {
        Some(value.sqrt())
    } else if value > -1e-12 * scale {
        Some(0.0)
    } else {
        None
    }
}
