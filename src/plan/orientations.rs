//! The orientation pattern of a circle whose orientation is optimal: of many draws at each point those that determine most.

use std::ops::Range;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::PlanningPrior;
use super::cell::Cell;
use super::circle::Circle;
use super::job::{CircleTable, Job, Orientation};
use super::prior::length_sigma_mm;
use super::rig::Rig;
use super::workspace::workspace;
use crate::catalogue::PlanFinding;
use crate::design::candidates::largest;
use crate::design::{Candidate, Criterion, Exchange, design_rows, workspace_rows};
use crate::diagnostic::Diagnostic;
use crate::robot::inverse::{branches, nearest, status, turns_within};
use crate::robot::{AXES, BallId, Pose};

/// Draws for each point; the first is no turn.
const DRAWS: usize = 24;
/// Poses of the workspace over which the 3-D error is made least.
const POSES: usize = 300;

/// A pose that may be taken, and how the tool is turned for it, degrees about Z, Y, X.
struct Draw {
    pose: Candidate,
    turn_deg: [f64; 3],
}

/// The draws of one point, by their places among all.
struct Point {
    /// Position of its circle in the job, and its own on the circle, from 0.
    circle: usize,
    point: usize,
    draws: Range<usize>,
}

/// The job with the turns of its optimal circles chosen; all of them together make the 3-D error least.
///
/// # Errors
/// The circle with a point at which no draw can be reached within the limits and the stroke.
pub(crate) fn chosen(job: &Job, rig: &Rig<'_>, prior: &PlanningPrior) -> Result<Job, Diagnostic> {
    let mut chosen = job.clone();
    let mut draws: Vec<Draw> = Vec::new();
    let mut points: Vec<Point> = Vec::new();
    for (number, table) in (1_u32..).zip(&job.circles) {
        if table.orientation != Orientation::Optimal || !table.turns_deg.is_empty() {
            continue;
        }
        let circle = Circle::new(job, table, number)?;
        let drawer = Drawer::new(job, rig, prior, table, &circle)?;
        let mut near = drawer.start;
        for angle in table.angles().into_iter().take(table.points as usize) {
            let first = draws.len();
            draws.extend(drawer.draws(angle, &mut near)?);
            let point = circle.point(angle) as usize;
            points.push(Point { circle: number as usize - 1, point, draws: first..draws.len() });
        }
    }
    if points.is_empty() {
        return Ok(chosen);
    }
    let poses: Vec<Candidate> = draws.iter().map(|draw| draw.pose.clone()).collect();
    let columns = design_rows(&prior.posterior, &poses, length_sigma_mm(job, rig.controller));
    let moved = workspace_rows(&prior.posterior, &workspace(job, rig.controller, POSES));
    let ranges: Vec<Range<usize>> = points.iter().map(|point| point.draws.clone()).collect();
    let mut exchange = Exchange::new(&columns, &moved);
    exchange.one_of_each(&ranges, Criterion::I);
    for (point, chosen_draw) in points.iter().zip(exchange.chosen()) {
        if let (Some(table), Some(draw)) = (chosen.circles.get_mut(point.circle), draws.get(*chosen_draw)) {
            let turns = &mut table.turns_deg;
            turns.resize(turns.len().max(point.point + 1), [0.0; 3]);
            turns[point.point] = draw.turn_deg;
        }
    }
    Ok(chosen)
}

/// Draws orientations at the points of one circle, in the branch in which it begins.
struct Drawer<'a> {
    job: &'a Job,
    rig: &'a Rig<'a>,
    table: &'a CircleTable,
    circle: &'a Circle,
    cell: Cell<'a>,
    start: [f64; AXES],
}

impl<'a> Drawer<'a> {
    fn new(
        job: &'a Job,
        rig: &'a Rig<'a>,
        prior: &PlanningPrior,
        table: &'a CircleTable,
        circle: &'a Circle,
    ) -> Result<Self, PlanFinding> {
        let start = branches(rig.arm, &circle.pose(0.0, 0.0))
            .unwrap_or_default()
            .iter()
            .flat_map(|axes| turns_within(axes, rig.controller))
            .min_by(|a, b| largest(a).total_cmp(&largest(b)))
            .ok_or(PlanFinding::FirstPointUnreachable { circle: circle.number })?;
        let cell = Cell::new(job, rig, prior, table.centre, &start);
        Ok(Self { job, rig, table, circle, cell, start })
    }

    /// The draws at an angle that can be taken; `near` are the axis angles of the point before, then of this one.
    fn draws(&self, angle: f64, near: &mut [f64; AXES]) -> Result<Vec<Draw>, PlanFinding> {
        let Self { job, rig, table, circle, .. } = *self;
        let (number, risk) = (u64::from(circle.number), job.limits.max_stroke_risk);
        let position = circle.pose(angle, 0.0).position;
        let branch = status(rig.arm, &self.start);
        let seed = u64::from(job.seed) << 32 | number << 16 | circle.point(angle);
        let mut random = Pcg64::seed_from_u64(seed);
        let ball = BallId::numbered(table.centre);
        let mut found = Vec::new();
        for draw in 0..DRAWS {
            let q = circle.amplitude();
            let turn = [(); 3].map(|()| if draw == 0 { 0.0 } else { random.random_range(-q..=q) });
            let pose = Pose { rotation: circle.turned(turn), position };
            let Ok(axes) = nearest(rig.arm, &pose, near) else { continue };
            if draw == 0 {
                *near = axes;
            }
            if status(rig.arm, &axes) == branch && self.cell.allows(&axes, table.centre, risk) {
                let pose = Candidate { ball, axes, pose };
                found.push(Draw { pose, turn_deg: turn.map(f64::to_degrees) });
            }
        }
        if found.is_empty() {
            let angle_deg = angle.to_degrees() + table.start_deg;
            return Err(PlanFinding::NoOrientation { circle: circle.number, angle_deg });
        }
        Ok(found)
    }
}
