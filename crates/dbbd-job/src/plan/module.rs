//! A module of chosen poses: from pose to pose on the sphere about one base ball, with sync markers; the start pose is the
//! reference.

use nalgebra::{Rotation3, Vector3};

use super::PoseKind;
use super::cell::PlanningCell;
use super::circle::REFERENCE_EVERY;
use super::route::{RoutePlanner, order};
use super::steps::{DETOUR, MarkerPosition, StepBuilder, safe_marker};
use crate::plan::PlanFinding;
use dbbd_model::design::Candidate;
use dbbd_model::robot::Pose;

/// Poses that are tried in order when the next one cannot be reached.
const AHEAD: usize = 12;
/// Most dwells of a module: their index goes out on eight outputs.
pub const MODULE_DWELLS: u32 = 255;
/// After so many steps another module begins: a controller limits the lines of one.
const MAX_MODULE_STEPS: usize = 400;

/// Appends one module, or several where it grows long: sync markers, the poses in order with visits of the reference pose,
/// sync markers. `risk` is the greatest stroke risk of a pose. Returns findings about poses that were left out.
pub(crate) fn module(
    walk: &mut StepBuilder,
    cell: &PlanningCell<'_>,
    start: &Candidate,
    mut poses: Vec<Candidate>,
    risk: f64,
) -> Vec<PlanFinding> {
    let Some(router) = RoutePlanner::new(cell, start.ball.number(), risk) else {
        return vec![PlanFinding::NothingChosen { ball: start.ball.number() }];
    };
    poses.insert(0, start.clone());
    order(&mut poses);
    let chosen = poses.len();
    (walk.circle, walk.centre) = (walk.circle + 1, start.ball.number());
    let began = walk.steps.len();
    walk.ptp(start.pose, start.axes);
    let mut chain = ModulePath { walk, router, start, here: poses.remove(0), began, dwells: 1, missed: 0 };
    chain.markers(MarkerPosition::Start);
    // The start is the first to be measured, and the reference.
    let here = chain.here.pose;
    chain.walk.lines(vec![aside(&here, &chain.router.ball), here], PoseKind::Measure);
    chain.visit(&mut poses);
    chain.reference();
    chain.markers(MarkerPosition::Finish);
    let (ball, missed) = (start.ball.number(), chain.missed);
    let mut notes = Vec::new();
    if !poses.is_empty() {
        notes.push(PlanFinding::PosesLeftOut { ball, left_out: poses.len(), chosen });
    }
    if missed > 0 {
        notes.push(PlanFinding::ReferencesLeftOut { ball, left_out: missed });
    }
    notes
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
    /// Visits the poses; those that cannot be reached are left in `poses`.
    fn visit(&mut self, poses: &mut Vec<Candidate>) {
        let (mut count, mut skipped) = (1_u32, 0);
        while !poses.is_empty() {
            let ahead = 0..poses.len().min(AHEAD);
            let next = ahead.into_iter().find_map(|at| Some((at, self.router.way(&self.here, &poses[at])?)));
            let Some((at, way)) = next else {
                // Nothing ahead can be reached from here: try the first pose again at the end.
                skipped += 1;
                poses.rotate_left(1);
                if skipped > poses.len() {
                    return;
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
                self.reference();
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
        let RoutePlanner { cell, ball, radius, risk, .. } = self.router;
        let length = safe_marker(&cell.rig.job.bar, radius, risk, |out| cell.risk_out(&self.here, out));
        let rest = self.here.pose;
        let along = (rest.position - ball).normalize();
        let out = Pose { rotation: rest.rotation, position: rest.position + along * length };
        self.walk.markers(end, rest, out);
    }

    /// Visits the reference pose; from the pose itself by a step aside and back.
    fn reference(&mut self) {
        if self.here == *self.start {
            let pose = self.here.pose;
            self.walk.lines(vec![aside(&pose, &self.router.ball), pose], PoseKind::Reference);
        } else if let Some(way) = self.router.way(&self.here, self.start) {
            self.walk.go(way, self.start, PoseKind::Reference);
        } else {
            self.missed += 1;
            return;
        }
        self.here = self.start.clone();
        self.dwells += 1;
    }
}

/// A pose nearby on the sphere.
fn aside(pose: &Pose, ball: &Vector3<f64>) -> Pose {
    let along = pose.position - ball;
    let across = if along.x.abs() < 0.9 * along.norm() { Vector3::x() } else { Vector3::y() };
    let turn = Rotation3::from_scaled_axis(along.cross(&across).normalize() * DETOUR);
    Pose { rotation: pose.rotation, position: ball + turn * along }
}
