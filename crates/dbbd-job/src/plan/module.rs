//! A module of chosen poses: it goes from pose to pose on the sphere about one base ball, with sync markers; the start
//! pose is the reference.
//!
//! The ways between the poses are short and continuous, with the ball always on the sphere about its base ball. The
//! ball goes along a great circle. First one arc is tried, with the orientation turning about one axis, as the
//! controller does it. Where that fails, short chords are tried, whose orientation follows the axes from one pose to
//! the next, so that the wrist does not pass its singularity. The last try goes past the cup's axis. Every way is
//! checked before it is taken.

use std::f64::consts::PI;

use nalgebra::{Rotation3, Vector3};

use super::circle::REFERENCE_EVERY;
use super::path::{ToolBallPath, between};
use super::steps::{DETOUR, MarkerPosition, room, safe_marker};
use super::timing::MIN_CODED_DWELLS;
use super::{PlanningCell, PoseKind, RouteLeg, StepBuilder};
use crate::plan::PlanFinding;
use dbbd_model::design::Candidate;
use dbbd_model::robot::inverse::{nearest, status};
use dbbd_model::robot::{AXES, BallId, Pose, max_axis_difference};

/// Poses that are tried in order when the next one cannot be reached.
const AHEAD: usize = 12;
/// Most dwells of a module: the index of a dwell goes out on eight outputs.
pub const MODULE_DWELLS: u32 = 255;
/// After this number of steps another module begins: a controller limits the lines of one module.
const MAX_MODULE_STEPS: usize = 400;
/// Greatest turn of an axis in one chord, rad.
const CHORD_TURN: f64 = 0.2;
/// Greatest turn of an axis in one arc, rad: after a larger one the full turns are ambiguous.
const ARC_TURN: f64 = 1.5;
/// Greatest deviation of an axis at the end of a way, rad: a larger one is another turn of the axis.
const ASTRAY: f64 = 0.01;

/// What a module visits.
pub(super) struct ModuleVisits {
    /// The start, and the chosen poses to which there is a path.
    pub(super) visited: Vec<Candidate>,
    /// The chosen poses to which there is no path.
    pub(super) left_out: Vec<Candidate>,
    /// Visits of the reference to which there is no path.
    missed: usize,
}

impl ModuleVisits {
    /// Findings about poses that were left out.
    pub(super) fn notes(&self, ball: BallId) -> impl Iterator<Item = PlanFinding> {
        let (ball, left_out) = (ball.number(), self.left_out.len());
        let chosen = self.visited.len() + left_out;
        let poses = PlanFinding::PosesLeftOut { ball, left_out, chosen };
        let references = PlanFinding::ReferencesLeftOut { ball, left_out: self.missed };
        [(left_out, poses), (self.missed, references)]
            .into_iter()
            .filter_map(|(count, finding)| (count > 0).then_some(finding))
    }
}

/// Appends one module, or several where it grows long: sync markers, the poses in order with visits of the reference pose,
/// sync markers. `risk` is the greatest stroke risk of a pose. `None` if the job has no such ball.
pub(super) fn module(
    walk: &mut StepBuilder,
    cell: &PlanningCell<'_>,
    start: &Candidate,
    mut poses: Vec<Candidate>,
    risk: f64,
) -> Option<ModuleVisits> {
    let router = RoutePlanner::new(cell, start.ball.number(), risk)?;
    poses.insert(0, start.clone());
    order(&mut poses);
    let mut visited = poses.clone();
    (walk.circle, walk.centre) = (walk.circle + 1, start.ball.number());
    let began = walk.steps.len();
    walk.ptp(start.pose, start.axes);
    let mut chain = ModulePath { walk, router, start, here: poses.remove(0), began, dwells: 1, missed: 0 };
    chain.markers(MarkerPosition::Start);
    // The start is the first pose to be measured, and the reference.
    chain.step_aside(PoseKind::Measure);
    chain.visit(&mut poses);
    chain.missed += usize::from(!chain.reference());
    chain.revisit(&visited);
    chain.markers(MarkerPosition::Finish);
    let missed = chain.missed;
    visited.retain(|pose| !poses.contains(pose));
    Some(ModuleVisits { visited, left_out: poses, missed })
}

/// The path through chosen poses about one base ball.
struct ModulePath<'a, 'c> {
    walk: &'a mut StepBuilder,
    router: RoutePlanner<'c>,
    start: &'a Candidate,
    here: Candidate,
    /// The first step of the module.
    began: usize,
    dwells: u32,
    /// Visits of the reference to which there is no path.
    missed: usize,
}

impl ModulePath<'_, '_> {
    /// Visits the poses; poses that cannot be reached are left in `poses`.
    fn visit(&mut self, poses: &mut Vec<Candidate>) {
        let (mut count, mut skipped) = (1_u32, 0);
        while !poses.is_empty() {
            let ahead = poses.len().min(AHEAD);
            let next = (0..ahead).find_map(|at| Some((at, self.router.way(&self.here, &poses[at])?)));
            let Some((at, way)) = next else {
                // Nothing ahead can be reached from here: try these poses again at the end.
                skipped += ahead;
                poses.rotate_left(ahead);
                if skipped >= poses.len() {
                    // Most poses have a way from the start.
                    if self.here == *self.start || !self.reference() {
                        return;
                    }
                    skipped = 0;
                }
                continue;
            };
            skipped = 0;
            let pose = poses.remove(at);
            self.walk.go(way, &pose, PoseKind::Measure);
            self.here = pose;
            (count, self.dwells) = (count + 1, self.dwells + 1);
            // Leave room for a visit of the reference, the last pose and the last visit.
            let full =
                self.walk.steps.len() - self.began > MAX_MODULE_STEPS || self.dwells + 2 >= MODULE_DWELLS;
            if full && !poses.is_empty() {
                self.next_module();
            }
            if count % REFERENCE_EVERY == 0 && !poses.is_empty() {
                self.missed += usize::from(!self.reference());
            }
        }
    }

    /// Visits poses again where there are too few dwells for the time code.
    fn revisit(&mut self, visited: &[Candidate]) {
        /// Limit of the tries, because some poses may have no way to them.
        const MAX_TRIES: usize = 4 * MIN_CODED_DWELLS;
        for pose in visited.iter().cycle().skip(1).take(MAX_TRIES) {
            if self.walk.dwell_count() >= MIN_CODED_DWELLS {
                return;
            }
            if self.here != *pose
                && let Some(way) = self.router.way(&self.here, pose)
            {
                self.walk.go(way, pose, PoseKind::Reference);
                self.here = pose.clone();
                self.dwells += 1;
            }
        }
    }

    /// Begins another module; the bar stays on.
    fn next_module(&mut self) {
        self.markers(MarkerPosition::Finish);
        (self.began, self.dwells) = (self.walk.steps.len(), 0);
        self.walk.circle += 1;
        self.walk.ptp(self.here.pose, self.here.axes);
        self.markers(MarkerPosition::Start);
    }

    /// The sync markers of an end of the module, at the current pose.
    fn markers(&mut self, end: MarkerPosition) {
        let (router, rest) = (&self.router, self.here.pose);
        let along = router.direction(&rest);
        let out = |length: f64| Pose { rotation: rest.rotation, position: rest.position + along * length };
        let bar = &router.cell.rig.job.bar;
        let length = safe_marker(bar, router.radius, |length| router.has_line(&self.here, &out(length)));
        self.walk.markers(end, rest, out(length));
    }

    /// Goes to a pose nearby and back, with a dwell at the current pose. Where there is no such way, the plan's check names
    /// the limit that prevents it.
    fn step_aside(&mut self, kind: PoseKind) {
        let pose = self.here.pose;
        let asides = asides(&pose, &self.router.ball);
        let aside = asides.iter().find(|aside| self.router.has_line(&self.here, aside)).unwrap_or(&asides[0]);
        self.walk.line(PoseKind::Transit, *aside);
        self.walk.line(kind, pose);
    }

    /// Visits the reference pose; whether there is a way to it. If the robot is there already, it steps aside and comes back.
    fn reference(&mut self) -> bool {
        if self.here == *self.start {
            self.step_aside(PoseKind::Reference);
        } else if let Some(way) = self.router.way(&self.here, self.start) {
            self.walk.go(way, self.start, PoseKind::Reference);
        } else {
            return false;
        }
        self.here = self.start.clone();
        self.dwells += 1;
        true
    }
}

/// Four poses nearby on the sphere, with the same orientation.
fn asides(pose: &Pose, ball: &Vector3<f64>) -> [Pose; 4] {
    let along = pose.position - ball;
    let across = if along.x.abs() < 0.9 * along.norm() { Vector3::x() } else { Vector3::y() };
    let first = along.cross(&across).normalize();
    let second = along.normalize().cross(&first);
    [first, -first, second, -second].map(|axis| {
        let turn = Rotation3::from_scaled_axis(axis * DETOUR);
        Pose { rotation: pose.rotation, position: ball + turn * along }
    })
}

/// Finds ways about one base ball.
pub(super) struct RoutePlanner<'a> {
    cell: &'a PlanningCell<'a>,
    centre: u32,
    ball: Vector3<f64>,
    radius: f64,
    /// Greatest risk of one pose.
    risk: f64,
    /// Greatest sagitta of a chord, mm.
    sagitta: f64,
}

impl<'a> RoutePlanner<'a> {
    /// `None` if the job has no such ball.
    pub(super) fn new(cell: &'a PlanningCell<'a>, centre: u32, risk: f64) -> Option<Self> {
        let (bar, ball) = (&cell.rig.job.bar, Vector3::from(cell.rig.job.ball(centre)?.xyz_mm));
        let sagitta = (0.25 * room(bar, bar.length_mm)).clamp(0.02, 0.2);
        Some(Self { cell, centre, ball, radius: bar.length_mm, risk, sagitta })
    }

    /// The way from one pose to another, if there is one.
    pub(super) fn way(&self, from: &Candidate, to: &Candidate) -> Option<RouteLeg> {
        let (u, v) = (self.direction(&from.pose), self.direction(&to.pose));
        let bend = arc_angle(&u, &v);
        let turn = max_axis_difference(&from.axes, &to.axes);
        if bend < PI - 0.1 && bend > 1e-3 && turn < ARC_TURN {
            let rotation = between(&from.pose.rotation, &to.pose.rotation, 0.5);
            let aux = Pose { rotation, position: self.ball + on_arc(&u, &v, 0.5) * self.radius };
            // The arc is an arc of the controller's model, not of the arm's.
            let half: [f64; AXES] = std::array::from_fn(|i| 0.5 * (from.axes[i] + to.axes[i]));
            let rig = self.cell.rig;
            let [start, end] = [from, to].map(|pose| rig.controller.geometry.ball(&pose.axes));
            let path = ToolBallPath::arc(start, &rig.commanded(&aux, &half).ok()?.position, end);
            if self.passes(&path, &from.axes).is_some_and(|end| max_axis_difference(&end, &to.axes) < ASTRAY)
            {
                return Some(RouteLeg::Arc(aux));
            }
        }
        let table = self.cell.rig.job.ball(self.centre)?;
        let up = table.cup_axis.map_or(Vector3::z(), |axis| Vector3::from(axis).normalize());
        let over = (u + v + up * 1.5).try_normalize(1e-6)?;
        self.chords(from, to, &[u, v]).or_else(|| self.chords(from, to, &[u, over, v])).map(RouteLeg::Chords)
    }

    /// Chords along great circles past these directions, with an orientation that follows the axes.
    fn chords(
        &self,
        from: &Candidate,
        to: &Candidate,
        past: &[Vector3<f64>],
    ) -> Option<Vec<(Pose, [f64; AXES])>> {
        let widest = 2.0 * (1.0 - self.sagitta / self.radius).clamp(-1.0, 1.0).acos();
        let legs: Vec<f64> = past.windows(2).map(|pair| arc_angle(&pair[0], &pair[1])).collect();
        let whole: f64 = legs.iter().sum();
        let count = (whole / widest)
            .max(max_axis_difference(&from.axes, &to.axes) / CHORD_TURN)
            .ceil()
            .clamp(1.0, 200.0);
        let (rig, arm) = (self.cell.rig, &self.cell.rig.controller.geometry);
        let mut ends = Vec::with_capacity(count as usize);
        let mut axes = from.axes;
        for chord in 1..=count as u32 {
            let share = f64::from(chord) / count;
            let next = if chord == count as u32 {
                to.pose
            } else {
                let guide: [f64; AXES] =
                    std::array::from_fn(|i| from.axes[i] + (to.axes[i] - from.axes[i]) * share);
                let rotation = rig.arm.ball(&guide).rotation;
                Pose { rotation, position: self.ball + along(past, &legs, share * whole) * self.radius }
            };
            let end = rig.commanded(&next, &axes).ok()?;
            axes = nearest(arm, &end, &axes).ok().filter(|axes| self.allows(axes))?;
            ends.push((next, end));
        }
        // The ends of the chords alone show most ways that fail.
        if max_axis_difference(&axes, &to.axes) >= ASTRAY {
            return None;
        }
        let (mut here, mut axes) = (arm.ball(&from.axes), from.axes);
        let mut between = Vec::with_capacity(ends.len());
        for (next, end) in ends {
            axes = self.passes(&ToolBallPath::Line { from: here, to: end }, &axes)?;
            between.push((next, axes));
            here = end;
        }
        between.pop();
        (max_axis_difference(&axes, &to.axes) < ASTRAY).then_some(between)
    }

    /// Whether the straight line to a pose nearby keeps all limits and its branch.
    fn has_line(&self, from: &Candidate, to: &Pose) -> bool {
        let rig = self.cell.rig;
        let start = rig.controller.geometry.ball(&from.axes);
        let end = rig.commanded(to, &from.axes);
        end.is_ok_and(|to| self.passes(&ToolBallPath::Line { from: start, to }, &from.axes).is_some())
    }

    /// The axis angles at the end of a path, if it keeps all limits and its branch.
    fn passes(&self, path: &ToolBallPath, start: &[f64; AXES]) -> Option<[f64; AXES]> {
        let arm = &self.cell.rig.controller.geometry;
        let began = status(arm, start);
        let parts = path.steps();
        let mut axes = *start;
        for part in 1..=parts {
            let next = nearest(arm, &path.pose(f64::from(part) / f64::from(parts))?, &axes).ok()?;
            // A larger turn in one step means that the wrist flips.
            let fits = max_axis_difference(&next, &axes) < 0.3 && status(arm, &next) == began;
            if !(fits && self.allows(&next)) {
                return None;
            }
            axes = next;
        }
        Some(axes)
    }

    fn allows(&self, axes: &[f64; AXES]) -> bool {
        self.cell.allows(axes, self.centre, self.risk)
    }

    fn direction(&self, pose: &Pose) -> Vector3<f64> {
        (pose.position - self.ball).normalize()
    }
}

/// Orders the poses so that the axes turn little: nearest neighbour, then 2-opt. The first pose stays first.
fn order(poses: &mut [Candidate]) {
    for at in 1..poses.len() {
        let next = (at..poses.len()).min_by(|&a, &b| {
            let far = |k: usize| max_axis_difference(&poses[at - 1].axes, &poses[k].axes);
            far(a).total_cmp(&far(b))
        });
        poses.swap(at, next.unwrap_or(at));
    }
    let far = |a: &Candidate, b: Option<&Candidate>| b.map_or(0.0, |b| max_axis_difference(&a.axes, &b.axes));
    for _ in 0..20 {
        let mut shorter = false;
        for i in 1..poses.len() {
            for k in i + 1..poses.len() {
                let now = far(&poses[i - 1], poses.get(i)) + far(&poses[k], poses.get(k + 1));
                let then = far(&poses[i - 1], poses.get(k)) + far(&poses[i], poses.get(k + 1));
                if then < now - 1e-9 {
                    poses[i..=k].reverse();
                    shorter = true;
                }
            }
        }
        if !shorter {
            return;
        }
    }
}

fn arc_angle(u: &Vector3<f64>, v: &Vector3<f64>) -> f64 {
    u.cross(v).norm().atan2(u.dot(v))
}

/// The unit vector at `share` of the great circle from u to v.
fn on_arc(u: &Vector3<f64>, v: &Vector3<f64>, share: f64) -> Vector3<f64> {
    let normal = u.cross(v);
    match normal.try_normalize(1e-9) {
        Some(axis) => Rotation3::from_scaled_axis(axis * (arc_angle(u, v) * share)) * u,
        None => *u,
    }
}

/// The unit vector after `angle` rad along the great circles from direction to direction.
fn along(past: &[Vector3<f64>], legs: &[f64], angle: f64) -> Vector3<f64> {
    let mut left = angle;
    for (pair, leg) in past.windows(2).zip(legs) {
        if left <= *leg {
            return on_arc(&pair[0], &pair[1], if *leg > 0.0 { left / leg } else { 0.0 });
        }
        left -= leg;
    }
    past.last().copied().unwrap_or_else(Vector3::z)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;

    fn unit(angle_deg: f64) -> Vector3<f64> {
        let (sine, cosine) = angle_deg.to_radians().sin_cos();
        Vector3::new(0.0, cosine, sine)
    }

    #[test]
    fn great_circle_is_divided_by_its_angle() {
        assert!((arc_angle(&unit(10.0), &unit(130.0)).to_degrees() - 120.0).abs() < 1e-9);
        assert!((on_arc(&unit(10.0), &unit(130.0), 0.25) - unit(40.0)).norm() < 1e-12);
        assert_eq!(on_arc(&unit(10.0), &unit(10.0), 0.7), unit(10.0));
    }

    /// 40 degrees forward, then 90 degrees back.
    #[test]
    fn way_past_a_direction_has_two_legs() {
        let past = [unit(0.0), unit(40.0), unit(-50.0)];
        let legs = [40.0_f64.to_radians(), FRAC_PI_2];
        for (angle_deg, expected_deg) in
            [(0.0, 0.0), (30.0, 30.0), (40.0, 40.0), (70.0, 10.0), (130.0, -50.0)]
        {
            let found = along(&past, &legs, f64::to_radians(angle_deg));
            assert!((found - unit(expected_deg)).norm() < 1e-9, "{angle_deg}");
        }
        assert_eq!(along(&past, &legs, 9.0), unit(-50.0));
    }

    fn poses(angles: &[f64]) -> Vec<Candidate> {
        let pose = |angle: &f64| Candidate {
            ball: BallId::FIRST,
            axes: [*angle, 0.0, 0.0, 0.0, 0.0, 0.0],
            pose: Pose::identity(),
        };
        angles.iter().map(pose).collect()
    }

    fn ordered(angles: &[f64]) -> Vec<f64> {
        let mut poses = poses(angles);
        order(&mut poses);
        poses.iter().map(|pose| pose.axes[0]).collect()
    }

    #[test]
    fn poses_are_visited_by_the_nearest_neighbour() {
        assert_eq!(ordered(&[0.0, 0.9, 0.3, 0.6]), [0.0, 0.3, 0.6, 0.9]);
        assert_eq!(ordered(&[0.5]), [0.5]);
    }

    /// The nearest neighbours are 0, 0.2, -0.3, 1: 0.2 + 0.5 + 1.3. The other way is 0.3 + 0.5 + 0.8.
    #[test]
    fn detour_of_the_nearest_neighbour_is_undone() {
        assert_eq!(ordered(&[0.0, 0.2, -0.3, 1.0]), [0.0, -0.3, 0.2, 1.0]);
    }

    /// 0.035 rad of 300 mm are 10.5 mm along the sphere.
    #[test]
    fn step_aside_stays_on_the_sphere() {
        let ball = Vector3::new(5.0, 6.0, 7.0);
        for along in [Vector3::x(), Vector3::y(), Vector3::z()] {
            let pose = Pose { position: ball + along * 300.0, ..Pose::identity() };
            let beside = asides(&pose, &ball);
            for aside in &beside {
                assert!(((aside.position - ball).norm() - 300.0).abs() < 1e-9);
                assert!(((aside.position - ball).angle(&along) - 0.035).abs() < 1e-9);
                assert_eq!(aside.rotation, pose.rotation);
            }
            // Two opposite pairs at right angles; the chords of the sphere lean inwards by half of the angle.
            let moved = beside.map(|aside| aside.position - pose.position);
            for pair in [[0, 1], [2, 3]] {
                assert!((moved[pair[0]].angle(&moved[pair[1]]) - (PI - 0.035)).abs() < 1e-9);
            }
            assert!((moved[0].angle(&moved[2]) - FRAC_PI_2).abs() < 0.001);
        }
    }
}
