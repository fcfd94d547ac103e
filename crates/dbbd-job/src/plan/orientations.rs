//! Optimal orientation patterns: the most informative combination of many random orientations at each point of a
//! circle.

use std::ops::Range;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::job::{CircleTable, Job, OrientationPattern};
use super::prior::length_sigma_mm;
use super::workspace::workspace;
use super::{PlanKinematics, PlannedCircle, PlanningCell, PlanningPrior};
use crate::plan::PlanFinding;
use dbbd_model::design::candidates::largest;
use dbbd_model::design::{Candidate, Criterion, Exchange, design_rows, workspace_rows};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::inverse::{branches, nearest, status, turns_within};
use dbbd_model::robot::{AXES, BallId, Pose};

/// Draws for each point; the first is the base orientation.
const DRAWS: usize = 24;
/// Poses of the workspace over which the 3-D error is minimised.
const ORIENTATION_WORKSPACE_POSES: usize = 300;

/// A safe pose, and the turn of the tool from its base orientation, degrees about Z, Y, X.
struct DrawnOrientation {
    pose: Candidate,
    turn_deg: [f64; 3],
}

/// The job with the turns of its optimal circles chosen so that together they minimise the 3-D error.
pub(super) fn chosen(rig: &PlanKinematics<'_>, prior: &PlanningPrior) -> Result<Job, Diagnostic> {
    let mut job = rig.job.clone();
    let mut draws: Vec<DrawnOrientation> = Vec::new();
    // For each point: position of the circle in the job, number of the point on it, its draws.
    let (mut points, mut ranges): (Vec<[usize; 2]>, Vec<Range<usize>>) = (Vec::new(), Vec::new());
    for (number, table) in (1_u32..).zip(&rig.job.circles) {
        if table.orientation != OrientationPattern::Optimal || !table.turns_deg.is_empty() {
            continue;
        }
        let circle = PlannedCircle::new(rig.job, table, number)?;
        let drawer = OrientationSampler::new(rig, prior, table, &circle)?;
        let mut near = drawer.start;
        for angle in table.angles().into_iter().take(table.points as usize) {
            let first = draws.len();
            draws.extend(drawer.draws(angle, &mut near)?);
            points.push([number as usize - 1, circle.point(angle) as usize]);
            ranges.push(first..draws.len());
        }
    }
    if points.is_empty() {
        return Ok(job);
    }
    let poses: Vec<Candidate> = draws.iter().map(|draw| draw.pose.clone()).collect();
    let columns = design_rows(&prior.posterior, &poses, length_sigma_mm(rig.job, rig.controller));
    let moved =
        workspace_rows(&prior.posterior, &workspace(rig.job, rig.controller, ORIENTATION_WORKSPACE_POSES));
    let mut exchange = Exchange::new(&columns, &moved);
    exchange.one_of_each(&ranges, Criterion::I);
    for ([circle, point], chosen) in points.into_iter().zip(exchange.chosen()) {
        if let (Some(table), Some(draw)) = (job.circles.get_mut(circle), draws.get(*chosen)) {
            let turns = &mut table.turns_deg;
            turns.resize(turns.len().max(point + 1), [0.0; 3]);
            turns[point] = draw.turn_deg;
        }
    }
    Ok(job)
}

/// Draws orientations at the points of one circle, in the branch of its first point.
struct OrientationSampler<'a> {
    table: &'a CircleTable,
    ball: BallId,
    circle: &'a PlannedCircle<'a>,
    cell: PlanningCell<'a>,
    start: [f64; AXES],
}

impl<'a> OrientationSampler<'a> {
    fn new(
        rig: &PlanKinematics<'a>,
        prior: &PlanningPrior,
        table: &'a CircleTable,
        circle: &'a PlannedCircle<'a>,
    ) -> Result<Self, PlanFinding> {
        let (number, balls) = (table.centre, rig.job.centres.len());
        let ball = BallId::new(number).ok_or(PlanFinding::NoSuchBall { ball: number, balls })?;
        let start = branches(rig.arm, &circle.pose(0.0, 0.0))
            .unwrap_or_default()
            .iter()
            .flat_map(|axes| turns_within(axes, rig.controller))
            .min_by(|a, b| largest(a).total_cmp(&largest(b)))
            .ok_or(PlanFinding::FirstPointUnreachable { circle: circle.number })?;
        Ok(Self { table, ball, circle, cell: PlanningCell::new(*rig, prior, table.centre, &start), start })
    }

    /// The safe draws at an angle. `near` holds the axis angles of the point before, and is set to those of this point.
    fn draws(&self, angle: f64, near: &mut [f64; AXES]) -> Result<Vec<DrawnOrientation>, PlanFinding> {
        let Self { table, ball, circle, cell, .. } = self;
        let PlanKinematics { job, arm, .. } = cell.rig;
        let position = circle.pose(angle, 0.0).position;
        let branch = status(arm, &self.start);
        let mut random = Pcg64::seed_from_u64(circle.seed(angle));
        let mut safe = Vec::new();
        for draw in 0..DRAWS {
            let q = circle.amplitude;
            let turn = [(); 3].map(|()| if draw == 0 { 0.0 } else { random.random_range(-q..=q) });
            let pose = Pose { rotation: circle.turned(turn), position };
            let Ok(axes) = nearest(arm, &pose, near) else { continue };
            if draw == 0 {
                *near = axes;
            }
            if status(arm, &axes) == branch && cell.allows(&axes, table.centre, job.limits.max_stroke_risk) {
                let pose = Candidate { ball: *ball, axes, pose };
                safe.push(DrawnOrientation { pose, turn_deg: turn.map(f64::to_degrees) });
            }
        }
        if safe.is_empty() {
            let angle_deg = angle.to_degrees() + table.start_deg;
            return Err(PlanFinding::NoOrientation { circle: circle.number, angle_deg });
        }
        Ok(safe)
    }
}
