//! The closed form: shoulder, two parallel axes, spherical wrist.
//!
//! The wrist centre W lies where axes 4, 5 and 6 meet. Seen in frame 1, its side offset is that of
//! the arm, which leaves two angles of joint 1; joints 2 and 3 are a planar two-link arm from the
//! shoulder to W (two elbows); what rotation is left is that of the wrist (two flips).

use nalgebra::{Matrix3, Vector3};

use super::Unsolved;
use crate::robot::pose::{Pose, rot_x, rot_z};
use crate::robot::{AXES, DhRow, Geometry};

/// How far a twist may be from a right angle, rad, and the wrist's axes from meeting, mm, for the arm to
/// count as near one with a closed form: far above any real robot's errors, far below a design.
const NEAR_RAD: f64 = 0.3;
const NEAR_MM: f64 = 60.0;

/// Below this sine the wrist is straight: axes 4 and 6 turn about one line.
const STRAIGHT: f64 = 1e-9;

/// An arm that has the closed form exactly.
pub(super) struct Arm {
    rows: [DhRow; AXES],
    tool: Vector3<f64>,
    exact: bool,
}

impl Arm {
    /// The arm itself where it has the closed form, else the ideal one nearby, if there is one.
    pub(super) fn near(geometry: &Geometry) -> Option<Self> {
        let mut rows = geometry.rows;
        let mut exact = geometry.compliance.iter().all(|c| *c == 0.0) || geometry.masses.is_empty();
        exact &= geometry.gear.iter().flatten().all(|part| *part == 0.0);
        for (i, row) in rows.iter_mut().enumerate() {
            exact &= row.beta == 0.0;
            if row.beta.abs() > NEAR_RAD {
                return None;
            }
            row.beta = 0.0;
            // The base may be tilted at will; after it every twist is a right angle or none.
            if i > 0 {
                let quarters = (row.alpha / std::f64::consts::FRAC_PI_2).round();
                let ideal = quarters * std::f64::consts::FRAC_PI_2;
                let parallel = i == 2;
                let off = (row.alpha - ideal).abs();
                if off > NEAR_RAD || (quarters.rem_euclid(2.0) == 0.0) != parallel {
                    return None;
                }
                exact &= off < 1e-12;
                row.alpha = ideal;
            }
        }
        let offsets = [rows[4].a, rows[5].a, rows[4].d];
        if !offsets.iter().all(|offset| offset.abs() <= NEAR_MM) {
            return None;
        }
        exact &= offsets.iter().all(|offset| offset.abs() < 1e-12);
        (rows[4].a, rows[5].a, rows[4].d) = (0.0, 0.0, 0.0);
        Some(Self { rows, tool: geometry.tool, exact })
    }

    /// Whether it is the arm that was given, to the last digit.
    pub(super) fn is_exact(&self) -> bool {
        self.exact
    }

    /// The forearm in frame 3, from joint 3 to the wrist centre, mm.
    fn forearm(&self) -> Vector3<f64> {
        let DhRow { alpha, a, d, .. } = self.rows[3];
        Vector3::new(a, -alpha.sin() * d, alpha.cos() * d)
    }

    /// +1 when axis 3 points as axis 2 does, -1 when it points the other way.
    fn fold(&self) -> f64 {
        self.rows[2].alpha.cos().signum()
    }

    /// The angle between upper arm and forearm at an axis angle of joint 3, rad, in (-pi, pi]; 0 is
    /// stretched, and it grows with the controller's axis angle.
    pub(super) fn elbow(&self, a3: f64) -> f64 {
        let forearm = self.forearm();
        let row = &self.rows[2];
        let joint = row.sign * a3 + row.theta + forearm.y.atan2(forearm.x);
        super::wrapped(row.sign * joint)
    }

    /// The angle of joint 5 from a straight wrist, rad.
    pub(super) fn wrist(&self, a5: f64) -> f64 {
        let row = &self.rows[4];
        row.sign * a5 + row.theta
    }

    /// The branches at `ball`; `a4` is axis 4 where the wrist is straight. Angles in rad, not wrapped.
    pub(super) fn branches(&self, ball: &Pose, a4: f64) -> Result<Vec<[f64; AXES]>, Unsolved> {
        let rows = &self.rows;
        let flange = ball.position - ball.rotation * self.tool;
        let wrist = flange - ball.rotation.column(2) * rows[5].d;
        // Before joint 1: out of the base's tilt and shift.
        let tilt = rot_x(rows[0].alpha);
        let mut seen = tilt.transpose() * wrist;
        seen.x -= rows[0].a;
        seen.z -= rows[0].d;

        let forearm = self.forearm();
        let fold = self.fold();
        let side = rows[1].d + fold * (rows[2].d + forearm.z);
        let twist = rows[1].alpha.sin().signum();
        let radius_squared = seen.x * seen.x + seen.y * seen.y;
        let Some(forward) = root(radius_squared - side * side, radius_squared) else {
            return Err(Unsolved::OutOfReach);
        };
        let mut found = Vec::with_capacity(8);
        for forward in [forward, -forward] {
            let theta1 = seen.y.atan2(seen.x) - (-twist * side).atan2(forward);
            let target = (forward - rows[1].a, twist * seen.z);
            for (theta2, theta3) in self.elbows(target, &forearm, fold) {
                let carried = tilt
                    * rot_z(theta1)
                    * rot_x(rows[1].alpha)
                    * rot_z(theta2)
                    * rot_x(rows[2].alpha)
                    * rot_z(theta3)
                    * rot_x(rows[3].alpha);
                for [theta4, theta5, theta6] in self.flips(&(carried.transpose() * ball.rotation), a4) {
                    let thetas = [theta1, theta2, theta3, theta4, theta5, theta6];
                    found.push(std::array::from_fn(|i| rows[i].sign * (thetas[i] - rows[i].theta)));
                }
            }
        }
        if found.is_empty() { Err(Unsolved::OutOfReach) } else { Ok(found) }
    }

    /// Joints 2 and 3 that bring the wrist centre to `target` in the plane of the arm, from joint 2.
    fn elbows(&self, target: (f64, f64), forearm: &Vector3<f64>, fold: f64) -> Vec<(f64, f64)> {
        let (upper, lower) = (self.rows[2].a, forearm.x.hypot(forearm.y));
        let bend = forearm.y.atan2(forearm.x);
        let product = 2.0 * upper * lower;
        if product == 0.0 {
            return Vec::new();
        }
        let cos = (target.0 * target.0 + target.1 * target.1 - upper * upper - lower * lower) / product;
        let Some(sin) = root(1.0 - cos * cos, 1.0) else {
            return Vec::new();
        };
        [sin, -sin]
            .map(|sin| {
                let theta2 = target.1.atan2(target.0) - (lower * sin).atan2(upper + lower * cos);
                (theta2, fold * sin.atan2(cos) - bend)
            })
            .to_vec()
    }

    /// Joints 4, 5 and 6 for the rotation `left` after joint 3's frame and the twist of row 4.
    fn flips(&self, left: &Matrix3<f64>, a4: f64) -> Vec<[f64; 3]> {
        let (twist5, twist6) = (self.rows[4].alpha.sin().signum(), self.rows[5].alpha.sin().signum());
        let sine = left[(0, 2)].hypot(left[(1, 2)]);
        let cosine = -twist5 * twist6 * left[(2, 2)];
        let rest = |theta4: f64, theta5: f64| {
            let before =
                rot_z(theta4) * rot_x(self.rows[4].alpha) * rot_z(theta5) * rot_x(self.rows[5].alpha);
            let last = before.transpose() * left;
            [theta4, theta5, last[(1, 0)].atan2(last[(0, 0)])]
        };
        if sine < STRAIGHT {
            let theta4 = self.rows[3].sign * a4 + self.rows[3].theta;
            return vec![rest(theta4, sine.atan2(cosine))];
        }
        let flip = |sign: f64| {
            let side = sign * twist6;
            rest((side * left[(1, 2)]).atan2(side * left[(0, 2)]), (sign * sine).atan2(cosine))
        };
        vec![flip(1.0), flip(-1.0)]
    }
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
