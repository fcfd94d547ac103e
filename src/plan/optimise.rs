//! Poses chosen from what can be reached, as steps: one module for each base ball.

use nalgebra::{DMatrix, Rotation3, Vector3};

use super::build::Knowledge;
use super::candidates::{Candidate, in_cell, moves, rows};
use super::cell::Cell;
use super::circle::REFERENCE_EVERY;
use super::job::{self, Job, Optimise};
use super::prediction::{length_sigma_mm, workspace};
use super::route::{Router, order};
use super::solve::Rig;
use super::steps::{DETOUR, Step, Walk, knock, room};
use crate::identifiability::{Criterion, Exchange};
use crate::model::Pose;

/// Poses of the workspace over which the 3-D error is made least.
const POSES: usize = 400;
/// Start poses that are tried where the bar is set to zero at the start.
const STARTS: usize = 40;
/// Following poses that are tried when the next cannot be reached.
const AHEAD: usize = 12;
/// More poses than this many for the same gain are not worth a measurement: a tenth less error for twice as many.
const ENOUGH: f64 = 0.9;

/// The steps of the chosen poses, and what there is to say about them.
///
/// # Errors
/// Why none could be chosen.
pub(crate) fn steps(job: &Job, rig: &Rig<'_>, known: &Knowledge) -> Result<(Vec<Step>, Vec<String>), String> {
    let Some(wanted) = &job.optimise else { return Ok((Vec::new(), Vec::new())) };
    // The risk of the whole run is shared among its poses.
    let risk = job.limits.max_stroke_risk / f64::from(wanted.points.max(1));
    let share = wanted.candidates as usize / job.centres.len().max(1);
    let mut notes = Vec::new();
    let mut cells = Vec::new();
    let mut pool: Vec<Candidate> = Vec::new();
    for table in &job.centres {
        let start = start(job, rig, known, table.id, risk).ok_or_else(|| {
            format!("no pose about base ball {} can be reached within the limits and the stroke", table.id)
        })?;
        let cell = Cell::new(job, rig, &known.belief, known.measured, (table.id, &start.axes));
        let found = in_cell(&cell, table.id, share, risk);
        if found.len() < share {
            notes.push(format!(
                "base ball {}: {} of {share} candidates can be reached within the limits and the stroke",
                table.id,
                found.len()
            ));
        }
        pool.extend(found);
        cells.push((cell, start));
    }
    if pool.len() < wanted.points as usize {
        return Err(format!(
            "{} poses can be reached within the limits and the stroke, {} are wanted",
            pool.len(),
            wanted.points
        ));
    }
    let chosen = choose(job, rig, known, &pool, wanted, &mut notes);
    let mut walk = Walk::new(job);
    for (number, (cell, start)) in (job.circles.len() as u32 + 1..).zip(&cells) {
        let about: Vec<Candidate> = chosen.iter().filter(|c| c.centre == start.centre).cloned().collect();
        if about.is_empty() {
            notes.push(format!("base ball {}: no pose about it was worth choosing", start.centre));
            continue;
        }
        module(&mut walk, cell, start, about, number, risk, &mut notes);
    }
    if walk.steps.is_empty() {
        return Err("none of the chosen poses can be reached from another".into());
    }
    Ok((walk.steps, notes))
}

/// The pose at which the bar is mounted: where nothing is measured yet, that from which the others swing
/// least; else any.
fn start(job: &Job, rig: &Rig<'_>, known: &Knowledge, centre: u32, risk: f64) -> Option<Candidate> {
    // A cell whose bar was set to zero anywhere: only the limits and the rest of the cell count.
    let anywhere = Cell::new(job, rig, &known.belief, true, (centre, &[0.0; 6]));
    let found = in_cell(&anywhere, centre, STARTS, if known.measured { risk } else { 1.0 });
    let swing = |start: &Candidate| {
        let cell = Cell::new(job, rig, &known.belief, known.measured, (centre, &start.axes));
        found.iter().filter(|other| cell.allows(&other.axes, centre, risk)).count()
    };
    let best = found.iter().map(|start| (start, swing(start))).max_by_key(|(_, count)| *count)?;
    Some(best.0.clone())
}

/// The poses that tell most.
fn choose(
    job: &Job,
    rig: &Rig<'_>,
    known: &Knowledge,
    pool: &[Candidate],
    wanted: &Optimise,
    notes: &mut Vec<String>,
) -> Vec<Candidate> {
    let robot = rig.controller;
    let sigma_mm = length_sigma_mm(job, robot);
    let belief = &known.belief;
    let candidates = rows(belief, pool, sigma_mm);
    let moved = moves(belief, &workspace(job, robot, POSES));
    let count = wanted.points as usize;
    let criterion = match wanted.criterion {
        job::Criterion::D => Criterion::D,
        job::Criterion::I => Criterion::I,
    };
    let exchange = exchanged(&candidates, &moved, count, criterion);
    notes.push(enough(&candidates, &moved, count, criterion, exchange.rms_error_mm()));
    exchange.chosen().iter().filter_map(|&at| pool.get(at).cloned()).collect()
}

/// D-optimal as a start, then the criterion asked for.
fn exchanged<'a>(
    candidates: &'a DMatrix<f64>,
    moved: &DMatrix<f64>,
    count: usize,
    criterion: Criterion,
) -> Exchange<'a> {
    let mut exchange = Exchange::new(candidates, moved);
    exchange.extend(count, Criterion::D);
    exchange.improve(Criterion::D);
    if criterion == Criterion::I {
        exchange.improve(Criterion::I);
    }
    exchange
}

/// How the error falls with the number of poses.
fn enough(
    candidates: &DMatrix<f64>,
    moved: &DMatrix<f64>,
    count: usize,
    criterion: Criterion,
    error_mm: f64,
) -> String {
    let at = |count: usize| exchanged(candidates, moved, count, criterion).rms_error_mm();
    let (half, twice) = (at(count.div_ceil(2)), at((2 * count).min(candidates.ncols())));
    let judged = if twice > ENOUGH * error_mm {
        "that many are enough; a calibrated bar (length_u_mm) or a second base ball at another radius and height would tell more"
    } else {
        "more would tell more"
    };
    format!(
        "root mean square 3-D error predicted: {half:.4} mm with {} poses, {error_mm:.4} mm with {count}, \
         {twice:.4} mm with {}; {judged}",
        count.div_ceil(2),
        2 * count
    )
}

/// One module: to the start pose, knocks, the poses in order with visits of the first as reference, knocks.
fn module(
    walk: &mut Walk,
    cell: &Cell<'_>,
    start: &Candidate,
    mut poses: Vec<Candidate>,
    number: u32,
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
    let wanted = poses.len() - 1;
    (walk.circle, walk.centre) = (number, start.centre);
    walk.ptp(start.pose, start.axes);
    let out = knock(&job.bar, radius);
    walk.radial_knocks(true, &start.pose, &ball, out);

    let mut here = poses.remove(0);
    let mut first: Option<Candidate> = None;
    let (mut count, mut skipped, mut missed) = (0_u32, 0, 0);
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
        walk.go(way, pose.pose, super::Kind::Measure);
        here = pose;
        count += 1;
        let origin = first.get_or_insert_with(|| here.clone()).clone();
        if count % REFERENCE_EVERY == 0 || poses.is_empty() {
            match reference(&router, walk, &here, &origin) {
                true => here = origin,
                false => missed += 1,
            }
        }
    }
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
        walk.lines(vec![aside, here.pose], super::Kind::Reference);
        return true;
    }
    match router.way(here, origin) {
        Some(way) => {
            walk.go(way, origin.pose, super::Kind::Reference);
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
