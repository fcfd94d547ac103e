//! A module of chosen poses: from the start, which is the reference, from pose to pose on the sphere about one base ball, with its marks and reference.

use nalgebra::{Rotation3, Vector3};

use super::Kind;
use super::candidates::Candidate;
use super::cell::Cell;
use super::circle::REFERENCE_EVERY;
use super::route::{Router, order};
use super::steps::{DETOUR, Walk, room, safe_knock};
use crate::model::Pose;

/// Following poses that are tried when the next cannot be reached.
const AHEAD: usize = 12;
/// Dwells that a module numbers at most: their index goes out on eight outputs.
pub const MODULE_DWELLS: u32 = 255;
/// After so many steps another module begins: a controller takes so many lines in one.
const MOST_STEPS: usize = 400;

/// One module, or several where it grows long: to the start pose, knocks, the poses in order with visits of the first as reference, knocks.
pub(crate) fn module(
    walk: &mut Walk,
    cell: &Cell<'_>,
    start: &Candidate,
    mut poses: Vec<Candidate>,
    risk: f64,
    notes: &mut Vec<String>,
) {
    let job = cell.job;
    let Some(table) = job.centres.get(start.centre.saturating_sub(1) as usize) else { return };
    let ball = Vector3::from(table.xyz_mm);
    let radius = job.bar.length_mm;
    let inwards = room(&job.bar, radius);
    let sagitta = (0.25 * inwards).clamp(0.02, 0.2);
    let router = Router { cell, centre: start.centre, ball, radius, risk, sagitta };
    poses.insert(0, start.clone());
    order(&mut poses);
    let wanted = poses.len();
    (walk.circle, walk.centre) = (walk.circle + 1, start.centre);
    let mut began = walk.steps.len();
    walk.ptp(start.pose, start.axes);
    let out = safe_knock(&job.bar, radius, risk, |out| cell.risk_out(start, out));
    walk.radial_knocks(true, &start.pose, &ball, out);

    // The start is the first to be measured, and the reference.
    let mut here = poses.remove(0);
    walk.lines(vec![aside(&here.pose, &ball), here.pose], Kind::Measure);
    let (mut count, mut skipped, mut missed) = (1_u32, 0, 0);
    let mut dwells = 1;
    while !poses.is_empty() {
        let next = (0..poses.len().min(AHEAD)).find_map(|at| Some((at, router.way(&here, &poses[at])?)));
        let Some((at, way)) = next else {
            // Nothing ahead can be reached from here: what stands first waits till the end, once.
            skipped += 1;
            poses.rotate_left(1);
            if skipped > poses.len() {
                break;
            }
            continue;
        };
        skipped = 0;
        let pose = poses.remove(at);
        walk.go(way, &pose, Kind::Measure);
        here = pose;
        (count, dwells) = (count + 1, dwells + 1);
        // A visit of the reference, the last pose and the last visit may follow.
        let full = walk.steps.len() - began > MOST_STEPS || dwells + 2 >= MODULE_DWELLS;
        if full && !poses.is_empty() {
            // Another module, the bar stays on.
            let out = safe_knock(&job.bar, radius, risk, |out| cell.risk_out(&here, out));
            walk.radial_knocks(false, &here.pose, &ball, out);
            (began, dwells) = (walk.steps.len(), 0);
            walk.circle += 1;
            walk.ptp(here.pose, here.axes);
            walk.radial_knocks(true, &here.pose, &ball, out);
        }
        if count % REFERENCE_EVERY == 0 && !poses.is_empty() {
            match reference(&router, walk, &here, start) {
                true => (here, dwells) = (start.clone(), dwells + 1),
                false => missed += 1,
            }
        }
    }
    match reference(&router, walk, &here, start) {
        true => here = start.clone(),
        false => missed += 1,
    }
    let out = safe_knock(&job.bar, radius, risk, |out| cell.risk_out(&here, out));
    walk.radial_knocks(false, &here.pose, &ball, out);
    if !poses.is_empty() {
        notes.push(format!(
            "base ball {}: {} of {wanted} chosen poses were left out: no path to them keeps the limits",
            start.centre,
            poses.len()
        ));
    }
    if missed > 0 {
        notes.push(format!(
            "base ball {}: {missed} visit(s) of the reference pose were left out",
            start.centre
        ));
    }
}

/// Back to the reference pose; at it already, a step aside and back.
fn reference(router: &Router<'_>, walk: &mut Walk, here: &Candidate, origin: &Candidate) -> bool {
    if here == origin {
        let aside = aside(&here.pose, &router.ball);
        walk.lines(vec![aside, here.pose], Kind::Reference);
        return true;
    }
    match router.way(here, origin) {
        Some(way) => {
            walk.go(way, origin, Kind::Reference);
            true
        }
        None => false,
    }
}

/// The pose a little further on the sphere.
fn aside(pose: &Pose, ball: &Vector3<f64>) -> Pose {
    let along = pose.position - ball;
    let across = if along.x.abs() < 0.9 * along.norm() { Vector3::x() } else { Vector3::y() };
    let turn = Rotation3::from_scaled_axis(along.cross(&across).normalize() * DETOUR);
    Pose { rotation: pose.rotation, position: ball + turn * along }
}
