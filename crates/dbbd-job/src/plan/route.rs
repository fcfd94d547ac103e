//! Ways between chosen poses: short, continuous, the ball always on the sphere about its base ball.
//!
//! The ball goes along a great circle: as one arc with the orientation turning about one axis, as the controller does it, or
//! where that fails in short chords whose orientation follows the axes from one pose to the next, so that the wrist does
//! not pass its singularity. The last try goes past the cup's axis. Every way is checked before it is taken.

use std::f64::consts::PI;

use nalgebra::{Rotation3, Vector3};

use super::cell::PlanningCell;
use super::path::{RouteLeg, ToolBallPath, between};
use super::steps::room;
use dbbd_model::design::Candidate;
use dbbd_model::robot::inverse::{nearest, status};
use dbbd_model::robot::{AXES, Pose, max_axis_difference};

/// Steps in which a way is tried, mm and degrees; the plan's own check is finer.
const STEP_MM: f64 = 2.0;
const STEP_DEG: f64 = 2.0;
/// Greatest turn of an axis in one chord, rad.
const CHORD_TURN: f64 = 0.2;
/// Greatest turn of an axis in one arc, rad: after a larger one the full turns are ambiguous.
const ARC_TURN: f64 = 1.5;
/// Greatest deviation of an axis at the end of a way, rad: more is another turn of it.
const ASTRAY: f64 = 0.01;

/// Ways about one base ball.
pub(crate) struct RoutePlanner<'a> {
    pub(crate) cell: &'a PlanningCell<'a>,
    pub(crate) centre: u32,
    pub(crate) ball: Vector3<f64>,
    pub(crate) radius: f64,
    /// Greatest risk of one pose.
    pub(crate) risk: f64,
    /// Greatest sagitta of a chord, mm.
    pub(crate) sagitta: f64,
}

impl<'a> RoutePlanner<'a> {
    /// `None` where the job has no such ball.
    pub(crate) fn new(cell: &'a PlanningCell<'a>, centre: u32, risk: f64) -> Option<Self> {
        let (bar, ball) = (&cell.rig.job.bar, Vector3::from(cell.rig.job.ball(centre)?.xyz_mm));
        let sagitta = (0.25 * room(bar, bar.length_mm)).clamp(0.02, 0.2);
        Some(Self { cell, centre, ball, radius: bar.length_mm, risk, sagitta })
    }

    /// The way from one pose to another, if there is one.
    pub(crate) fn way(&self, from: &Candidate, to: &Candidate) -> Option<RouteLeg> {
        let (u, v) = (self.direction(&from.pose), self.direction(&to.pose));
        let bend = arc_angle(&u, &v);
        let turn = max_axis_difference(&from.axes, &to.axes);
        if bend < PI - 0.1 && bend > 1e-3 && turn < ARC_TURN {
            let rotation = between(&from.pose.rotation, &to.pose.rotation, 0.5);
            let aux = Pose { rotation, position: self.ball + on_arc(&u, &v, 0.5) * self.radius };
            // The arc is one of the controller's model, and not of the arm's.
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

    /// Chords past these directions, with an orientation that follows the axes.
    fn chords(&self, from: &Candidate, to: &Candidate, past: &[Vector3<f64>]) -> Option<Vec<Pose>> {
        let widest = 2.0 * (1.0 - self.sagitta / self.radius).clamp(-1.0, 1.0).acos();
        let legs: Vec<f64> = past.windows(2).map(|pair| arc_angle(&pair[0], &pair[1])).collect();
        let whole: f64 = legs.iter().sum();
        let count = (whole / widest)
            .max(max_axis_difference(&from.axes, &to.axes) / CHORD_TURN)
            .ceil()
            .clamp(1.0, 200.0);
        let mut poses = Vec::with_capacity(count as usize);
        let (mut here, mut axes) = (self.cell.rig.controller.geometry.ball(&from.axes), from.axes);
        for chord in 1..=count as u32 {
            let share = f64::from(chord) / count;
            let next = if chord == count as u32 {
                to.pose
            } else {
                let guide: [f64; AXES] =
                    std::array::from_fn(|i| from.axes[i] + (to.axes[i] - from.axes[i]) * share);
                let rotation = self.cell.rig.arm.ball(&guide).rotation;
                Pose { rotation, position: self.ball + along(past, &legs, share * whole) * self.radius }
            };
            let end = self.cell.rig.commanded(&next, &axes).ok()?;
            axes = self.passes(&ToolBallPath::Line { from: here, to: end }, &axes)?;
            poses.push(next);
            here = end;
        }
        (max_axis_difference(&axes, &to.axes) < ASTRAY).then_some(poses)
    }

    /// The axis angles at the end of a path, if it keeps all limits and its branch.
    fn passes(&self, path: &ToolBallPath, start: &[f64; AXES]) -> Option<[f64; AXES]> {
        let arm = &self.cell.rig.controller.geometry;
        let began = status(arm, start);
        let parts =
            (path.length_mm() / STEP_MM).max(path.turn_deg() / STEP_DEG).ceil().clamp(1.0, 1000.0) as u32;
        let mut axes = *start;
        for part in 1..=parts {
            let next = nearest(arm, &path.pose(f64::from(part) / f64::from(parts))?, &axes).ok()?;
            // A larger turn than this in one step is a wrist that flips.
            let fits = max_axis_difference(&next, &axes) < 0.3 && status(arm, &next) == began;
            if !(fits && self.cell.allows(&next, self.centre, self.risk)) {
                return None;
            }
            axes = next;
        }
        Some(axes)
    }

    fn direction(&self, pose: &Pose) -> Vector3<f64> {
        (pose.position - self.ball).normalize()
    }
}

/// Orders the poses so that the axes turn little: nearest neighbour, then 2-opt. The first stays first.
pub(crate) fn order(poses: &mut [Candidate]) {
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

/// The unit vector after `angle` rad along the great circles past the directions.
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
