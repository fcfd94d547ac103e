//! The circles of a run, as input of the circular test.

use std::collections::BTreeMap;

use super::RecordedRun;
use crate::plan::{Plan, PlanRow, PoseKind};
use crate::recording::matching::MatchingFinding;
use crate::recording::matching::PoseOutcome;
use dbbd_model::circular::{CirclePoint, CircleSense, CircleTrace, DriveState};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::{AXES, Robot};

/// A circle of the plan with its measurements.
#[derive(Clone, Debug)]
pub struct MeasuredCircle {
    /// Number of the circle in the plan, from 1.
    pub number: u32,
    pub radius_mm: f64,
    /// Lengths (mm, as read) by direction.
    pub traces: Vec<CircleTrace>,
    /// Number of poses without a length.
    pub lost: usize,
}

/// The circles of a run, and the findings of its matching.
pub struct MeasuredCircles {
    /// The circles, in the plan's order.
    pub circles: Vec<MeasuredCircle>,
    pub findings: Vec<MatchingFinding>,
}

impl RecordedRun {
    /// The circles with their lengths as read: the circular test corrects the lengths itself and reports both.
    pub fn circles(&self) -> Result<MeasuredCircles, Diagnostic> {
        let matching = self.matching_as_read(None)?;
        let robot = self.robot()?;
        let reading = |pose: &PoseOutcome| Some((pose.index, pose.reading()?.middle_s()));
        let times: BTreeMap<u32, f64> = matching.outcomes.iter().filter_map(reading).collect();
        let measured: BTreeMap<_, _> =
            matching.observations.rows.iter().map(|row| (row.index, row)).collect();
        let mut lost: BTreeMap<u32, usize> = BTreeMap::new();
        let mut circles: Vec<MeasuredCircle> = Vec::new();
        for (row, place) in self.plan.rows.iter().zip(&self.plan.circle_places()) {
            let (Some(place), PoseKind::Measure) = (place, row.kind) else { continue };
            if circles.last().is_none_or(|last| last.number != row.circle) {
                circles.push(MeasuredCircle::new(row.circle, place.radius_mm));
            }
            let Some(observation) = measured.get(&row.index) else {
                *lost.entry(row.circle).or_default() += 1;
                continue;
            };
            let point = CirclePoint {
                angle_deg: place.angle_deg,
                // The printed pose is up to a micrometre off the circle, which is no error of the robot.
                length_mm: observation.length_mm - (row.length_mm - place.radius_mm),
                sigma_mm: observation.sigma_mm,
                t_s: None,
                temp_c: times.get(&row.index).and_then(|t_s| self.temperature_at(*t_s)),
                axes_deg: Some(observation.axes.degrees()),
                drives: drives(&self.plan, &robot, row),
            };
            let sense = if place.clockwise { CircleSense::Clockwise } else { CircleSense::CounterClockwise };
            if let Some(circle) = circles.last_mut() {
                circle.add(sense, point);
            }
        }
        for circle in &mut circles {
            circle.lost = lost.get(&circle.number).copied().unwrap_or(0);
        }
        Ok(MeasuredCircles { circles, findings: matching.findings })
    }
}

impl MeasuredCircle {
    fn new(number: u32, radius_mm: f64) -> Self {
        Self { number, radius_mm, traces: Vec::new(), lost: 0 }
    }

    /// Number of poses with a length.
    pub fn measured(&self) -> usize {
        self.traces.iter().map(|trace| trace.points.len()).sum()
    }

    fn add(&mut self, sense: CircleSense, point: CirclePoint) {
        match self.traces.iter_mut().find(|trace| trace.sense == sense) {
            Some(trace) => trace.points.push(point),
            None => self.traces.push(CircleTrace { run: "1".into(), sense, points: vec![point] }),
        }
    }
}

/// The effect of each joint on the length at a pose, and the direction from which it arrived.
pub fn drives(plan: &Plan, robot: &Robot, row: &PlanRow) -> Option<[DriveState; AXES]> {
    /// Half of the step of the derivative, rad.
    const STEP: f64 = 1e-5;
    /// Least motion of a joint, degrees.
    const STILL_DEG: f64 = 1e-3;
    let ball = plan.header.job.centres.iter().find(|ball| ball.id == row.centre.number())?;
    let at = (row.index as usize).checked_sub(1)?;
    let neighbour = |at: Option<usize>| at.and_then(|at| plan.rows.get(at)).map(|row| row.axes_deg);
    let (before, after) = (neighbour(at.checked_sub(1)), neighbour(Some(at + 1)));
    let axes = row.axes_deg.map(f64::to_radians);
    Some(std::array::from_fn(|joint| {
        let length = |step: f64| {
            let mut moved = axes;
            moved[joint] += step;
            robot.geometry.length(&moved, &ball.xyz_mm.into(), 0.0)
        };
        let lever_mm = (length(STEP) - length(-STEP)) / (2.0 * STEP);
        let sense = |from: f64, to: f64| match to - from {
            step if step >= STILL_DEG => 1,
            step if step <= -STILL_DEG => -1,
            _ => 0,
        };
        let came = before.map_or(0, |before| sense(before[joint], row.axes_deg[joint]));
        let goes = after.map_or(0, |after| sense(row.axes_deg[joint], after[joint]));
        // Near a reversal the joint may have reversed already.
        DriveState { lever_mm, sense: if came == goes { came } else { 0 } }
    }))
}
