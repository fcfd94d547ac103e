//! How the tool is held at the points of a circle whose orientation is optimal: of many draws those that tell most.

use std::ops::Range;

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::Knowledge;
use super::candidates::{Candidate, moves, rows};
use super::cell::Cell;
use super::circle::Circle;
use super::datasheet::length_sigma_mm;
use super::job::{CircleTable, Job, Orientation};
use super::rig::Rig;
use super::workspace::workspace;
use crate::identifiability::{Criterion, Exchange};
use crate::model::inverse::{branches, nearest, status, turns_within};
use crate::model::{AXES, Pose};

/// Draws for each point; the first is no turn.
const DRAWS: usize = 24;
/// Poses of the workspace over which the 3-D error is made least.
const POSES: usize = 300;

/// A pose that may be taken, and how the tool is turned for it, degrees about Z, Y, X.
struct Draw {
    pose: Candidate,
    turn_deg: [f64; 3],
}

/// The job with the turns of its optimal circles chosen; all of them together make the 3-D error least.
///
/// # Errors
/// The circle with a point at which no draw can be reached within the limits and the stroke.
pub(crate) fn held(job: &Job, rig: &Rig<'_>, known: &Knowledge) -> Result<Job, String> {
    let mut held = job.clone();
    let mut draws: Vec<Draw> = Vec::new();
    let mut groups: Vec<(usize, usize, Range<usize>)> = Vec::new();
    for (at, table) in job.circles.iter().enumerate() {
        if table.orientation != Orientation::Optimal || !table.turns_deg.is_empty() {
            continue;
        }
        for (point, found) in points(job, rig, known, table, at)? {
            let first = draws.len();
            draws.extend(found);
            groups.push((at, point, first..draws.len()));
        }
    }
    if groups.is_empty() {
        return Ok(held);
    }
    let poses: Vec<Candidate> = draws.iter().map(|draw| draw.pose.clone()).collect();
    let columns = rows(&known.belief, &poses, length_sigma_mm(job, rig.controller));
    let moved = moves(&known.belief, &workspace(job, rig.controller, POSES));
    let ranges: Vec<Range<usize>> = groups.iter().map(|(.., range)| range.clone()).collect();
    let mut exchange = Exchange::new(&columns, &moved);
    exchange.one_of_each(&ranges, Criterion::I);
    for ((circle, point, _), chosen) in groups.iter().zip(exchange.chosen()) {
        if let (Some(table), Some(draw)) = (held.circles.get_mut(*circle), draws.get(*chosen)) {
            let turns = &mut table.turns_deg;
            turns.resize(turns.len().max(point + 1), [0.0; 3]);
            if let Some(turn) = turns.get_mut(*point) {
                *turn = draw.turn_deg;
            }
        }
    }
    Ok(held)
}

/// For each point of a circle the draws that can be taken, in the branch in which the circle begins.
fn points(
    job: &Job,
    rig: &Rig<'_>,
    known: &Knowledge,
    table: &CircleTable,
    at: usize,
) -> Result<Vec<(usize, Vec<Draw>)>, String> {
    let number = at as u32 + 1;
    let circle = Circle::new(job, table, number).ok_or("a circle without a plane")?;
    let risk = job.limits.max_stroke_risk;
    let first = circle.pose(0.0, 0.0);
    let start = branches(rig.arm, &first)
        .unwrap_or_default()
        .iter()
        .flat_map(|axes| turns_within(axes, &rig.controller.limits_deg))
        .min_by(|a, b| largest(a).total_cmp(&largest(b)))
        .ok_or_else(|| format!("circle {number}: its first point cannot be reached within the limits"))?;
    let cell = Cell::new(job, rig, known, table.centre, &start);
    let branch = status(rig.arm, &start);
    let mut near = start;
    let passed = table.angles().into_iter().take(table.points as usize);
    passed
        .map(|angle| {
            let point = circle.point(angle);
            let position: Vector3<f64> = circle.pose(angle, 0.0).position;
            let mut random = Pcg64::seed_from_u64(u64::from(job.seed) << 32 | u64::from(number) << 16 | point);
            let mut found: Vec<Draw> = Vec::new();
            for draw in 0..DRAWS {
                let q = circle.amplitude();
                let turn = [(); 3].map(|()| if draw == 0 { 0.0 } else { random.random_range(-q..=q) });
                let pose = Pose { rotation: circle.turned(turn), position };
                let Ok(axes) = nearest(rig.arm, &pose, &near) else { continue };
                if draw == 0 {
                    near = axes;
                }
                if status(rig.arm, &axes) == branch && cell.allows(&axes, table.centre, risk) {
                    let pose = Candidate { centre: table.centre, axes, pose };
                    found.push(Draw { pose, turn_deg: turn.map(f64::to_degrees) });
                }
            }
            if found.is_empty() {
                Err(format!(
                    "circle {number}: at {:.0} degrees no turn of the tool within amplitude_deg keeps the limits and the \
                     stroke",
                    angle.to_degrees() + table.start_deg
                ))
            } else {
                Ok((point as usize, found))
            }
        })
        .collect()
}

/// The greatest axis angle, rad.
fn largest(axes: &[f64; AXES]) -> f64 {
    axes.iter().map(|angle| angle.abs()).fold(0.0, f64::max)
}
