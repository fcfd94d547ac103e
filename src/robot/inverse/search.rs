//! All branches of an arm without a closed form.
//!
//! Where axes 2 and 3 are parallel and axes 5 and 6 meet, whatever offset the wrist has, an angle of joint 4
//! fixes the arm: the point where axes 5 and 6 meet follows from the pose, joints 1 to 3 bring it there (two
//! shoulders, two elbows), and axes 5 and 6 must then be at their angle. The branches are the zeros of that
//! condition over a turn of joint 4. Any other arm is searched by damped iteration from many starts.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::{Matrix3, Vector3};

use super::iterate::numeric;
use crate::robot::pose::{Pose, rot_x, rot_z};
use crate::robot::{AXES, DhRow, Geometry};

/// How far twists 2 and 3 may be from a right angle and from none, rad, and axes 5 and 6 from meeting, mm.
const NEAR_RAD: f64 = 0.3;
const NEAR_MM: f64 = 10.0;
/// Least sine of the angle between axes 5 and 6.
const LEAST_SINE: f64 = 0.1;
/// Angles of joint 4 that are tried in a turn, and halvings of an interval with a zero or an end.
const TRIED: usize = 240;
const HALVINGS: usize = 30;
/// Starts of the search for an arm with nothing to go by.
const STARTS: usize = 400;
/// Axis angles nearer than this are one branch, rad.
const SAME_RAD: f64 = 1e-6;

/// An arm whose branches are zeros over joint 4.
struct Offset {
    rows: [DhRow; AXES],
    /// Where axes 5 and 6 meet, and the direction of axis 5, in frame 4.
    wrist: Vector3<f64>,
    fifth: Vector3<f64>,
    fold: f64,
    twist: f64,
}

/// A pose before joint 1, out of the base's tilt and shift.
struct Target {
    wrist: Vector3<f64>,
    sixth: Vector3<f64>,
    rotation: Matrix3<f64>,
}

/// Cosine and sine.
type Turn = [f64; 2];

/// Joints 1 to 3 for one angle of joint 4.
struct Reach {
    /// By how much the angle between axes 5 and 6 is missed, as a cosine.
    miss: f64,
    first: Turn,
    second: Turn,
    /// Joints 2 and 3 together, in the plane of the arm.
    both: Turn,
}

/// `a` turned back by `b`.
fn minus(a: Turn, b: Turn) -> Turn {
    [a[0] * b[0] + a[1] * b[1], a[1] * b[0] - a[0] * b[1]]
}

fn angle([cos, sin]: Turn) -> f64 {
    sin.atan2(cos)
}

impl Offset {
    fn near(geometry: &Geometry) -> Option<Self> {
        let mut rows = geometry.rows;
        let off = |i: usize, ideal: f64| (rows[i].alpha - ideal).sin().abs() > NEAR_RAD.sin();
        let bent = rows.iter().any(|row| row.beta.abs() > NEAR_RAD);
        if bent || off(1, FRAC_PI_2) || off(2, 0.0) || rows[5].a.abs() > NEAR_MM {
            return None;
        }
        if rows[5].alpha.sin().abs() < LEAST_SINE {
            return None;
        }
        let (sin, cos) = rows[4].alpha.sin_cos();
        rows[5].a = 0.0;
        let fifth = Vector3::new(0.0, -sin, cos);
        let wrist = Vector3::x() * rows[4].a + fifth * rows[4].d;
        let (fold, twist) = (rows[2].alpha.cos().signum(), rows[1].alpha.sin().signum());
        Some(Self { rows, wrist, fifth, fold, twist })
    }

    fn target(&self, geometry: &Geometry, ball: &Pose) -> Target {
        let rows = &self.rows;
        let untilt = rot_x(rows[0].alpha).transpose();
        let rotation = untilt * ball.rotation;
        let sixth: Vector3<f64> = rotation.column(2).into();
        let flange = untilt * ball.position - rotation * geometry.tool;
        let shift = Vector3::new(rows[0].a, 0.0, rows[0].d);
        Target { wrist: flange - sixth * rows[5].d - shift, sixth, rotation }
    }

    /// Joints 1 to 3 where joint 4 has this angle, in each of two shoulders and two elbows.
    fn reach(&self, target: &Target, theta4: f64) -> [Option<Reach>; 4] {
        let rows = &self.rows;
        let (sin, cos) = theta4.sin_cos();
        let (sin4, cos4) = rows[3].alpha.sin_cos();
        let in_third = |v: &Vector3<f64>| {
            let (x, y) = (cos * v.x - sin * v.y, sin * v.x + cos * v.y);
            Vector3::new(x, cos4 * y - sin4 * v.z, sin4 * y + cos4 * v.z)
        };
        let forearm = Vector3::new(rows[3].a, -sin4 * rows[3].d, cos4 * rows[3].d) + in_third(&self.wrist);
        let fifth = in_third(&self.fifth);
        let wrist = &target.wrist;
        let side = rows[1].d + self.fold * (rows[2].d + forearm.z);
        let square = wrist.x * wrist.x + wrist.y * wrist.y;
        let (upper, lower) = (rows[2].a, forearm.x.hypot(forearm.y));
        let mut found = [None, None, None, None];
        let forward = (square - side * side).sqrt();
        if forward.is_nan() || upper * lower == 0.0 || square == 0.0 {
            return found;
        }
        for (s, forward) in [forward, -forward].into_iter().enumerate() {
            let first = minus([wrist.x / square, wrist.y / square], [forward, -self.twist * side]);
            let [x, y] = [forward - rows[1].a, self.twist * wrist.z];
            let far = x * x + y * y;
            let bend = (far - upper * upper - lower * lower) / (2.0 * upper * lower);
            let straight = (1.0 - bend * bend).sqrt();
            if straight.is_nan() || far == 0.0 {
                continue;
            }
            // Axis 6 in the plane of the arm.
            let [along, across] = minus([target.sixth.x, target.sixth.y], first);
            let sixth = [along, self.twist * target.sixth.z];
            for (e, sine) in [straight, -straight].into_iter().enumerate() {
                let second = minus([x / far, y / far], [upper + lower * bend, lower * sine]);
                let hand = [(x - upper * second[0]) / lower, (y - upper * second[1]) / lower];
                let both = minus(hand, [forearm.x / lower, self.fold * forearm.y / lower]);
                let [u, v] = minus(sixth, both);
                let cosine = fifth.x * u + self.fold * (fifth.y * v - fifth.z * self.twist * across);
                let miss = cosine - rows[5].alpha.cos();
                found[2 * s + e] = Some(Reach { miss, first, second, both });
            }
        }
        found
    }

    /// The controller's axis angles.
    fn axes(&self, target: &Target, theta4: f64, reach: &Reach) -> [f64; AXES] {
        let rows = &self.rows;
        let (theta1, theta2) = (angle(reach.first), angle(reach.second));
        let theta3 = self.fold * angle(minus(reach.both, reach.second));
        let ideal = |sign: f64| rot_x(if sign < 0.0 { PI } else { 0.0 });
        let carried = rot_z(theta1)
            * rot_x(self.twist * FRAC_PI_2)
            * rot_z(theta2)
            * ideal(self.fold)
            * rot_z(theta3)
            * rot_x(rows[3].alpha)
            * rot_z(theta4)
            * rot_x(rows[4].alpha);
        let left = carried.transpose() * target.rotation;
        let sense = rows[5].alpha.sin().signum();
        let theta5 = (sense * left[(0, 2)]).atan2(-sense * left[(1, 2)]);
        let theta6 = (sense * left[(2, 0)]).atan2(sense * left[(2, 1)]);
        let thetas = [theta1, theta2, theta3, theta4, theta5, theta6];
        std::array::from_fn(|i| rows[i].sign * (thetas[i] - rows[i].theta))
    }

    /// Axis angles at and near every zero.
    fn starts(&self, geometry: &Geometry, ball: &Pose) -> Vec<[f64; AXES]> {
        let target = self.target(geometry, ball);
        let step = TAU / TRIED as f64;
        let at = |k: usize| -PI + step * k as f64;
        let tried: Vec<[Option<Reach>; 4]> = (0..TRIED).map(|k| self.reach(&target, at(k))).collect();
        let mut found = Vec::with_capacity(16);
        for branch in 0..4 {
            let one = |theta4: f64| -> Option<Reach> {
                let mut reach = self.reach(&target, theta4);
                reach[branch].take()
            };
            let mut add = |theta4: f64| {
                if let Some(reach) = one(theta4) {
                    found.push(self.axes(&target, theta4, &reach));
                }
            };
            let miss = |k: usize| tried[k % TRIED][branch].as_ref().map(|reach| reach.miss);
            for k in 0..TRIED {
                match (miss(k), miss(k + 1)) {
                    (Some(a), Some(b)) if a * b <= 0.0 => {
                        add(zero(at(k), at(k + 1), a, |theta4| one(theta4).map(|reach| reach.miss)));
                    }
                    (Some(a), Some(b)) => {
                        // Two zeros between: the condition turns back towards zero.
                        let turns = |before: Option<f64>, a: f64, b: f64| {
                            before.is_none_or(|before| before.abs() > a.abs()) && a.abs() <= b.abs()
                        };
                        if turns(miss(k + TRIED - 1), a, b) && a.abs() < 0.05 {
                            add(at(k) - 0.3 * step);
                            add(at(k) + 0.3 * step);
                        }
                        if miss(k + 2).is_none() && b.abs() <= a.abs() && b.abs() < 0.05 {
                            add(at(k + 1));
                        }
                    }
                    (Some(_), None) => edge(at(k), at(k + 1), one, miss(k), &mut add),
                    (None, Some(_)) => edge(at(k + 1), at(k), one, miss(k + 1), &mut add),
                    (None, None) => {}
                }
            }
        }
        found
    }
}

/// The zero between `a` and `b`, where the values have different signs.
fn zero(mut a: f64, mut b: f64, mut at_a: f64, miss: impl Fn(f64) -> Option<f64>) -> f64 {
    let Some(mut at_b) = miss(b) else { return a };
    for _ in 0..HALVINGS {
        if at_a == at_b {
            break;
        }
        // Regula falsi, the side that stays counted half (Illinois).
        let next = (a * at_b - b * at_a) / (at_b - at_a);
        let Some(value) = miss(next) else { break };
        if value.abs() < 1e-14 {
            return next;
        }
        if value * at_b < 0.0 {
            (a, at_a) = (b, at_b);
        } else {
            at_a *= 0.5;
        }
        (b, at_b) = (next, value);
        if (b - a).abs() < 1e-13 {
            break;
        }
    }
    b
}

/// Starts where the reach ends between `inside` and `outside`: two branches of the arm meet there.
fn edge(
    inside: f64,
    outside: f64,
    one: impl Fn(f64) -> Option<Reach>,
    at_inside: Option<f64>,
    add: &mut impl FnMut(f64),
) {
    let (mut within, mut beyond) = (inside, outside);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (within + beyond);
        if one(middle).is_some() {
            within = middle;
        } else {
            beyond = middle;
        }
    }
    let (Some(a), Some(end)) = (at_inside, one(within).map(|reach| reach.miss)) else { return };
    if a * end <= 0.0 {
        add(zero(inside, within, a, |theta4| one(theta4).map(|reach| reach.miss)));
    } else if end.abs() < 0.2 {
        add(0.5 * (inside + within));
        add(0.9 * within + 0.1 * inside);
    }
}

/// Axis angles all over the arm's turns, in a sequence with low discrepancy: multiples of the powers of the root of
/// x^7 = x + 1 (Roberts).
fn anywhere() -> impl Iterator<Item = [f64; AXES]> {
    const ROOT: f64 = 1.112_775_684_278_705_5;
    (1..=STARTS).map(|k| {
        std::array::from_fn(|i| {
            let share = (0.5 + k as f64 / ROOT.powi(i as i32 + 1)).fract();
            TAU * share - PI
        })
    })
}

/// All branches at `ball` that are found; axis angles in rad, each in (-pi, pi]. Each is reached to 1e-9 mm and 1e-11 rad
/// forward.
pub(super) fn branches(geometry: &Geometry, ball: &Pose) -> Vec<[f64; AXES]> {
    let mut found: Vec<[f64; AXES]> = Vec::new();
    let mut keep = |start: [f64; AXES]| {
        let Ok(axes) = numeric(geometry, ball, &start) else { return };
        let axes = axes.map(super::wrapped);
        let is = |other: &[f64; AXES]| (0..AXES).all(|i| super::wrapped(axes[i] - other[i]).abs() < SAME_RAD);
        if !found.iter().any(is) {
            found.push(axes);
        }
    };
    match Offset::near(geometry) {
        Some(arm) => arm.starts(geometry, ball).into_iter().for_each(&mut keep),
        None => anywhere().for_each(&mut keep),
    }
    found
}
