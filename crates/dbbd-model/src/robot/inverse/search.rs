//! All branches of an arm without a closed form.
//!
//! If axes 2 and 3 are parallel and axes 5 and 6 meet, an angle of joint 4 fixes the arm, whatever offset the wrist
//! has: the point where axes 5 and 6 meet follows from the pose, joints 1 to 3 bring it there (two shoulders, two
//! elbows), and axes 5 and 6 must then be at their angle. The branches are the zeros of that condition over a turn of
//! joint 4. Any other arm is searched by damped iteration from many starts.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::{Matrix3, Vector3};

use super::iterate::{numeric, twin};
use crate::robot::pose::{Pose, rot_x, rot_z};
use crate::robot::{AXES, Coupling, DhRow, Geometry};

/// Largest deviation of twist 2 from a right angle and of twist 3 from zero, rad, and largest distance of axes 5 and 6,
/// mm.
const NEAR_RAD: f64 = 0.3;
const NEAR_MM: f64 = 10.0;
/// Least sine of the angle between axes 5 and 6.
const MIN_SINE: f64 = 0.1;
/// Angles of joint 4 that are tried in a turn; least number in an interval of it, and halvings of one.
const TRIED: usize = 90;
const MIN_TRIED: usize = 8;
const HALVINGS: usize = 30;
/// A condition that comes this near to zero without a change of sign is searched for two zeros.
const NEAR_ZERO: f64 = 0.3;
/// Largest difference of the conditions of an arm from those of the ideal arm nearby, and the largest interval beyond
/// the ideal arm's reach that the arm may reach, rad.
const TOUCHING: f64 = 0.05;
const BEYOND: f64 = 0.3;
/// Number of starts of the search for an arm without any special form.
const STARTS: usize = 400;
/// Axis angles nearer than this are one branch, rad.
const SAME_RAD: f64 = 1e-6;

/// An arm whose branches are zeros over joint 4.
struct OffsetArm {
    rows: [DhRow; AXES],
    coupling: Coupling,
    /// The point where axes 5 and 6 meet, and the direction of axis 5, in frame 4.
    wrist: Vector3<f64>,
    fifth: Vector3<f64>,
    fold: f64,
    twist: f64,
    /// Sine and cosine of twist 4.
    fourth: (f64, f64),
    /// A condition that turns back this near to zero may have two zeros for the given arm.
    touching: f64,
}

/// A pose before joint 1, out of the base's tilt and shift.
struct WristTarget {
    wrist: Vector3<f64>,
    sixth: Vector3<f64>,
    rotation: Matrix3<f64>,
}

/// Cosine and sine.
type CosSin = [f64; 2];

/// The link from joint 3 to where axes 5 and 6 meet, in frame 3, for one angle of joint 4.
struct Forearm {
    end: Vector3<f64>,
    fifth: Vector3<f64>,
    /// Distance of the arm's plane from axis 1, mm.
    side: f64,
}

/// One of two shoulders or elbows.
#[derive(Clone, Copy)]
enum ArmSide {
    First,
    Second,
}

impl ArmSide {
    const BOTH: [Self; 2] = [Self::First, Self::Second];

    fn of(self, value: f64) -> f64 {
        match self {
            Self::First => value,
            Self::Second => -value,
        }
    }
}

/// Joint 1, and from joint 2 to the wrist in the plane of the arm.
struct Shoulder {
    first: CosSin,
    to_wrist: [f64; 2],
    /// Cosine of the angle between upper arm and forearm.
    bend: f64,
    /// Not negative where the arm reaches the wrist; the more it is, the further the arm is from a singular position.
    room: f64,
}

/// Joints 1 to 3 for one angle of joint 4.
struct WristReach {
    /// Error of the angle between axes 5 and 6, as a difference of cosines.
    miss: f64,
    first: CosSin,
    second: CosSin,
    /// Joints 2 and 3 together, in the plane of the arm.
    both: CosSin,
}

/// `a` turned back by `b`.
fn minus(a: CosSin, b: CosSin) -> CosSin {
    [a[0] * b[0] + a[1] * b[1], a[1] * b[0] - a[0] * b[1]]
}

fn angle([cos, sin]: CosSin) -> f64 {
    sin.atan2(cos)
}

impl OffsetArm {
    fn near(geometry: &Geometry) -> Option<Self> {
        let mut rows = geometry.rows;
        let off = |i: usize, ideal: f64| (rows[i].alpha - ideal).sin().abs();
        let bent = |most: f64| rows.iter().any(|row| row.beta.abs() > most);
        if bent(NEAR_RAD) || off(1, FRAC_PI_2).max(off(2, 0.0)) > NEAR_RAD.sin() || rows[5].a.abs() > NEAR_MM
        {
            return None;
        }
        if rows[5].alpha.sin().abs() < MIN_SINE {
            return None;
        }
        let exact = geometry.is_rigid()
            && !bent(0.0)
            && off(1, FRAC_PI_2).max(off(2, 0.0)) < 1e-12
            && rows[5].a == 0.0;
        let touching = if exact { 0.0 } else { TOUCHING };
        let (sin, cos) = rows[4].alpha.sin_cos();
        rows[5].a = 0.0;
        let fifth = Vector3::new(0.0, -sin, cos);
        let wrist = Vector3::x() * rows[4].a + fifth * rows[4].d;
        let (fold, twist) = (rows[2].alpha.cos().signum(), rows[1].alpha.sin().signum());
        let (coupling, fourth) = (geometry.coupling, rows[3].alpha.sin_cos());
        Some(Self { rows, coupling, wrist, fifth, fold, twist, fourth, touching })
    }

    fn target(&self, geometry: &Geometry, ball: &Pose) -> WristTarget {
        let rows = &self.rows;
        let untilt = rot_x(rows[0].alpha).transpose();
        let rotation = untilt * ball.rotation;
        let sixth: Vector3<f64> = rotation.column(2).into();
        let flange = untilt * ball.position - rotation * geometry.tool;
        let shift = Vector3::new(rows[0].a, 0.0, rows[0].d);
        WristTarget { wrist: flange - sixth * rows[5].d - shift, sixth, rotation }
    }

    fn forearm(&self, theta4: f64) -> Forearm {
        let rows = &self.rows;
        let (sin, cos) = theta4.sin_cos();
        let (sin4, cos4) = self.fourth;
        let in_third = |v: &Vector3<f64>| {
            let (x, y) = (cos * v.x - sin * v.y, sin * v.x + cos * v.y);
            Vector3::new(x, cos4 * y - sin4 * v.z, sin4 * y + cos4 * v.z)
        };
        let end = Vector3::new(rows[3].a, -sin4 * rows[3].d, cos4 * rows[3].d) + in_third(&self.wrist);
        Forearm { fifth: in_third(&self.fifth), side: rows[1].d + self.fold * (rows[2].d + end.z), end }
    }

    fn shoulder(&self, target: &WristTarget, forearm: &Forearm, shoulder: ArmSide) -> Shoulder {
        let (wrist, side) = (&target.wrist, forearm.side);
        let square = wrist.x * wrist.x + wrist.y * wrist.y;
        let left = square - side * side;
        let forward = shoulder.of(left.max(0.0).sqrt());
        let first = minus([wrist.x / square, wrist.y / square], [forward, -self.twist * side]);
        let [x, y] = [forward - self.rows[1].a, self.twist * wrist.z];
        let (upper, lower) = (self.rows[2].a, forearm.end.x.hypot(forearm.end.y));
        let bend = (x * x + y * y - upper * upper - lower * lower) / (2.0 * upper * lower);
        let left = left / square;
        let room = if left < 0.0 { left } else { left.min(1.0 - bend * bend) };
        Shoulder { first, to_wrist: [x, y], bend, room }
    }

    /// Joints 1 to 3 where joint 4 has this angle; beyond the reach as at its end.
    fn reach(&self, target: &WristTarget, theta4: f64, [shoulder, elbow]: [ArmSide; 2]) -> WristReach {
        let forearm = self.forearm(theta4);
        let Shoulder { first, to_wrist: [x, y], bend, .. } = self.shoulder(target, &forearm, shoulder);
        let (upper, lower) = (self.rows[2].a, forearm.end.x.hypot(forearm.end.y));
        let sine = elbow.of((1.0 - bend * bend).max(0.0).sqrt());
        let far = x * x + y * y;
        // Axis 6 in the plane of the arm.
        let [along, across] = minus([target.sixth.x, target.sixth.y], first);
        let sixth = [along, self.twist * target.sixth.z];
        let second = minus([x / far, y / far], [upper + lower * bend, lower * sine]);
        let hand = [(x - upper * second[0]) / lower, (y - upper * second[1]) / lower];
        let both = minus(hand, [forearm.end.x / lower, self.fold * forearm.end.y / lower]);
        let [u, v] = minus(sixth, both);
        let fifth = forearm.fifth;
        let cosine = fifth.x * u + self.fold * (fifth.y * v - fifth.z * self.twist * across);
        WristReach { miss: cosine - self.rows[5].alpha.cos(), first, second, both }
    }

    /// The controller's axis angles.
    fn axes(&self, target: &WristTarget, theta4: f64, reach: &WristReach) -> [f64; AXES] {
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
        self.coupling.axes(&std::array::from_fn(|i| rows[i].sign * (thetas[i] - rows[i].theta)))
    }

    /// Axis angles at and near every zero.
    fn starts(&self, geometry: &Geometry, ball: &Pose) -> Vec<[f64; AXES]> {
        let target = self.target(geometry, ball);
        let mut found = Vec::with_capacity(16);
        for shoulder in ArmSide::BOTH {
            let room = |theta4: f64| self.shoulder(&target, &self.forearm(theta4), shoulder).room;
            for (from, to) in reached(self.touching, room) {
                for elbow in ArmSide::BOTH {
                    let branch = [shoulder, elbow];
                    let half = 0.5 * (to - from);
                    // Like a square root where the reach ends, the condition is smooth over the angle of a half turn.
                    let theta4 = |t: f64| from + half * (1.0 - t.cos());
                    let miss = |t: f64| self.reach(&target, theta4(t), branch).miss;
                    let tried = MIN_TRIED.max((0.25 * (to - from) * TRIED as f64).ceil() as usize);
                    let (end, ends, near) = (PI, IntervalEnds::Apart, NEAR_ZERO);
                    let search = ZeroSearch { end, tried, ends, near, touching: self.touching };
                    search.zeros(miss, &mut |t| {
                        let theta4 = theta4(t);
                        found.push(self.axes(&target, theta4, &self.reach(&target, theta4, branch)));
                    });
                }
            }
        }
        found
    }
}

/// The kind of ends of the searched interval.
#[derive(Clone, Copy, PartialEq)]
enum IntervalEnds {
    Apart,
    /// The end is the begin again.
    Joined,
}

/// The intervals of joint 4 with room.
fn reached(touching: f64, room: impl Fn(f64) -> f64) -> Vec<(f64, f64)> {
    let mut ends = Vec::new();
    let search =
        ZeroSearch { end: TAU, tried: TRIED, ends: IntervalEnds::Joined, near: f64::INFINITY, touching };
    search.zeros(&room, &mut |end| ends.push(end));
    ends.sort_by(f64::total_cmp);
    let Some(first) = ends.first().copied() else {
        return if room(0.0) >= 0.0 { vec![(0.0, TAU)] } else { Vec::new() };
    };
    ends.push(first + TAU);
    let between = ends.windows(2).map(|ends| (ends[0], ends[1]));
    let least = |from: f64, to: f64| if to - from < BEYOND { -touching } else { 0.0 };
    between.filter(|(from, to)| room(0.5 * (from + to)) >= least(*from, *to)).collect()
}

/// A search for the zeros of a smooth function from 0 to `end`.
struct ZeroSearch {
    end: f64,
    tried: usize,
    ends: IntervalEnds,
    /// An extremum between samples is looked for where the function is nearer to zero than this.
    near: f64,
    /// The value of `touching` of the arm.
    touching: f64,
}

impl ZeroSearch {
    /// Two zeros between samples are found by the extremum between them.
    fn zeros(&self, f: impl Fn(f64) -> f64, add: &mut impl FnMut(f64)) {
        let step = self.end / self.tried as f64;
        let at = |k: usize| step * k as f64;
        let mut values: Vec<f64> = (0..self.tried).map(|k| f(at(k))).collect();
        values.push(if self.ends == IntervalEnds::Joined { values[0] } else { f(self.end) });
        for (k, pair) in values.windows(2).enumerate() {
            if pair[0] * pair[1] <= 0.0 {
                add(zero(at(k), at(k + 1), [pair[0], pair[1]], &f));
            }
        }
        let last = if self.ends == IntervalEnds::Joined { self.tried - 1 } else { self.tried };
        for (k, here) in values.iter().copied().enumerate().take(last + 1) {
            let before = match k.checked_sub(1) {
                None if self.ends == IntervalEnds::Joined => Some(self.tried - 1),
                before => before,
            };
            let turns = |other: Option<&f64>| {
                other.is_none_or(|other| other * here > 0.0 && other.abs() >= here.abs())
            };
            let (before, after) = (before.and_then(|before| values.get(before)), values.get(k + 1));
            if here.abs() < self.near && turns(before) && turns(after) {
                let low = at(k) - if before.is_some() { step } else { 0.0 };
                let high = at(k) + if after.is_some() { step } else { 0.0 };
                let is_end = before.is_none() || after.is_none();
                let touching = if is_end && self.touching > 0.0 { self.near } else { self.touching };
                turned([low, high], touching, |t| here.signum() * f(t), add);
            }
        }
    }
}

/// The two zeros about the minimum of a function that is positive at both ends. If it has no zero and the minimum is
/// less than `touching`, two points next to the minimum.
fn turned([low, high]: [f64; 2], touching: f64, f: impl Fn(f64) -> f64, add: &mut impl FnMut(f64)) {
    let (lowest, value) = lowest(low, high, &f);
    if value <= 0.0 {
        add(zero(low, lowest, [f(low), value], &f));
        add(zero(lowest, high, [value, f(high)], &f));
    } else if value < touching {
        add(0.5 * (low + lowest));
        add(0.5 * (lowest + high));
    }
}

/// The place where a function with one minimum between `low` and `high` is least, or not positive, by golden sections.
fn lowest(mut low: f64, mut high: f64, f: impl Fn(f64) -> f64) -> (f64, f64) {
    const SECTION: f64 = 0.381_966_011_250_105_2;
    let (mut a, mut b) = (low + SECTION * (high - low), high - SECTION * (high - low));
    let (mut at_a, mut at_b) = (f(a), f(b));
    for _ in 0..HALVINGS {
        if at_a <= 0.0 || at_b <= 0.0 {
            break;
        }
        if at_a < at_b {
            (high, b, at_b) = (b, a, at_a);
            a = low + SECTION * (high - low);
            at_a = f(a);
        } else {
            (low, a, at_a) = (a, b, at_b);
            b = high - SECTION * (high - low);
            at_b = f(b);
        }
    }
    if at_a < at_b { (a, at_a) } else { (b, at_b) }
}

/// The zero between `a` and `b`, where the values have different signs.
fn zero(mut a: f64, mut b: f64, [mut at_a, mut at_b]: [f64; 2], f: impl Fn(f64) -> f64) -> f64 {
    for _ in 0..HALVINGS {
        if at_a == at_b {
            break;
        }
        // Regula falsi, the side that stays counted half (Illinois).
        let next = (a * at_b - b * at_a) / (at_b - at_a);
        let value = f(next);
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

/// The branches that are found.
struct FoundBranches<'a> {
    geometry: &'a Geometry,
    ball: &'a Pose,
    branches: Vec<[f64; AXES]>,
}

impl FoundBranches<'_> {
    fn add(&mut self, start: [f64; AXES]) {
        let Ok(axes) = numeric(self.geometry, self.ball, &start) else { return };
        let axes = axes.map(super::wrapped);
        let is = |other: &[f64; AXES]| (0..AXES).all(|i| super::wrapped(axes[i] - other[i]).abs() < SAME_RAD);
        if !self.branches.iter().any(is) {
            self.branches.push(axes);
        }
    }
}

/// All branches at `ball` that are found; axis angles in rad, each in (-pi, pi]. Each is reached to 1e-9 mm and 1e-11 rad
/// forward.
pub(super) fn branches(geometry: &Geometry, ball: &Pose) -> Vec<[f64; AXES]> {
    let mut found = FoundBranches { geometry, ball, branches: Vec::new() };
    match OffsetArm::near(geometry) {
        Some(arm) => arm.starts(geometry, ball).into_iter().for_each(|start| found.add(start)),
        None => anywhere().for_each(|start| found.add(start)),
    }
    // The zeros of a periodic function are even in number: a branch that met another is missing.
    if found.branches.len() % 2 == 1 {
        for axes in found.branches.clone() {
            twin(geometry, &axes).into_iter().for_each(|start| found.add(start));
        }
    }
    found.branches
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Robot;

    fn arm(change: impl Fn(&mut Geometry)) -> Option<OffsetArm> {
        let mut geometry = Robot::by_name("crx10ia").unwrap().unwrap().geometry;
        change(&mut geometry);
        OffsetArm::near(&geometry)
    }

    /// Twists off by 0.3 rad, axes 5 and 6 that miss each other by 10 mm, and a sine of 0.1 between them.
    #[test]
    fn an_arm_with_an_offset_wrist_is_recognised_within_bounds() {
        assert!(arm(|_| {}).is_some());
        for (within, rad) in [(true, 0.29), (false, 0.31)] {
            assert_eq!(arm(|arm| arm.rows[1].alpha += rad).is_some(), within);
            assert_eq!(arm(|arm| arm.rows[2].alpha -= rad).is_some(), within);
            assert_eq!(arm(|arm| arm.rows[3].beta = rad).is_some(), within);
        }
        for (within, mm) in [(true, -9.9), (false, -10.1), (false, 10.1)] {
            assert_eq!(arm(|arm| arm.rows[5].a = mm).is_some(), within);
        }
        for (within, alpha) in [(true, FRAC_PI_2), (true, 0.11), (true, -0.11), (false, 0.09), (false, -0.09)]
        {
            assert_eq!(arm(|arm| arm.rows[5].alpha = alpha).is_some(), within, "{alpha}");
        }
    }

    /// Rx(0.5) (0, 0, 100) = 100 (0, -sin 0.5, cos 0.5), behind a shift of 3 mm along x.
    #[test]
    fn the_wrist_is_where_its_row_puts_it() {
        let found = arm(|arm| (arm.rows[4].a, arm.rows[4].alpha, arm.rows[4].d) = (3.0, 0.5, 100.0)).unwrap();
        let expected = Vector3::new(3.0, -47.942_553_860_420_3, 87.758_256_189_037_27);
        assert!((found.wrist - expected).norm() < 1e-12, "{}", found.wrist);
        assert_eq!(found.touching, 0.0);
        // An arm beside the ideal one gets room, and is solved as if axes 5 and 6 met.
        let beside = arm(|arm| arm.rows[5].a = 1.0).unwrap();
        assert_eq!((beside.touching, beside.rows[5].a), (TOUCHING, 0.0));
    }
}
