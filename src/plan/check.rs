//! Is it safe? Each motion is followed finely, and what comes nearest to a limit is kept.

use super::cell::{Cell, Mounted, StrokeMargin};
use super::job::Job;
use super::path::Path;
use super::quantity::{Check, JUMP_DEG, Quantity, limit};
use super::risk::over_run;
use super::timing::{ACCELERATION_DEG_S2, ACCELERATION_MM_S2, PTP_ACCELERATION_PERCENT, Pace};
use super::{Motion, MoveTime, PlanRow};
use crate::catalogue::PlanFinding;
use crate::robot::inverse::{Unsolved, nearest, status};
use crate::robot::{AXES, Pose, Robot};

/// Finest step along a path: 1 mm and 1 degree, be it of the tool or (PTP) of an axis.
const STEP_MM: f64 = 1.0;
const STEP_DEG: f64 = 1.0;

/// The worst of each quantity on the way to one row.
pub(crate) struct Worst {
    row: u32,
    values: [Option<f64>; Quantity::ALL.len()],
}

impl Worst {
    /// Position of the row in the plan, from 0.
    pub(crate) fn position(&self) -> usize {
        self.row.saturating_sub(1) as usize
    }

    pub(crate) fn note(&mut self, quantity: Quantity, value: f64) {
        let kept = &mut self.values[quantity as usize];
        let worse = match *kept {
            None => true,
            Some(worst) => (value < worst) == quantity.at_least() || value.is_nan(),
        };
        if worse {
            *kept = Some(value);
        }
    }
}

/// A pose that has no axis angles.
pub(crate) fn unreachable(row: u32, xyz_mm: [f64; 3], why: &Unsolved) -> PlanFinding {
    let [x_mm, y_mm, z_mm] = xyz_mm;
    PlanFinding::Unreachable { row, x_mm, y_mm, z_mm, why: why.to_string() }
}

/// Follows the motions of a run of rows in which the bar stays on.
pub(crate) struct Inspector<'a> {
    cell: &'a Cell<'a>,
    robot: &'a Robot,
    began: u8,
    strayed: bool,
    pub(crate) margins: Vec<StrokeMargin>,
    pub(crate) worst: Vec<Worst>,
    pub(crate) findings: Vec<PlanFinding>,
}

/// What the axes do along one motion, step by step.
struct Stepper {
    parts: u32,
    start: [f64; AXES],
    last: [f64; AXES],
    before: Option<[f64; AXES]>,
    axis_s: f64,
    slope_s2: f64,
    bend_s2: f64,
}

impl Stepper {
    fn new(path: &Path, row: &PlanRow, start: [f64; AXES]) -> Self {
        let there = row.axes_deg.map(f64::to_radians);
        let widest = (0..AXES).map(|i| (there[i] - start[i]).abs().to_degrees()).fold(0.0, f64::max);
        let turn = if row.motion == Motion::Ptp { widest } else { path.turn_deg() };
        let parts = (path.length_mm() / STEP_MM).max(turn / STEP_DEG).ceil().clamp(1.0, 1e5) as u32;
        Self { parts, start, last: start, before: None, axis_s: 0.0, slope_s2: 0.0, bend_s2: 0.0 }
    }

    /// Takes the step to `axes`: the greatest speeds and accelerations of an axis along the path.
    fn advance(&mut self, axes: [f64; AXES], robot: &Robot, worst: &mut Worst) {
        let parts = f64::from(self.parts);
        for i in 0..AXES {
            // What the robot's file does not say is no limit.
            let greatest = robot.max_acceleration_deg_s2[i].unwrap_or(f64::INFINITY);
            let travel = (axes[i] - self.last[i]).abs().to_degrees();
            worst.note(Quantity::AxisJumpDeg, travel);
            self.axis_s = self.axis_s.max(travel * parts / robot.max_speed_deg_s[i]);
            self.slope_s2 = self.slope_s2.max(travel * parts / greatest);
            if let Some(before) = self.before {
                let bend = (axes[i] - 2.0 * self.last[i] + before[i]).abs().to_degrees();
                self.bend_s2 = self.bend_s2.max(bend * parts * parts / greatest);
            }
        }
        self.before = Some(self.last);
        self.last = axes;
    }
}

impl<'a> Inspector<'a> {
    pub(crate) fn new(cell: &'a Cell<'a>, robot: &'a Robot, start: &PlanRow) -> Self {
        let (margins, worst, findings) = (Vec::new(), Vec::new(), Vec::new());
        Self { cell, robot, began: start.status, strayed: false, margins, worst, findings }
    }

    /// Ends the run: its risk as a whole is noted at its last row.
    pub(crate) fn finish(&mut self) {
        let risk = over_run(&self.margins);
        if let Some(last) = self.worst.last_mut() {
            last.note(Quantity::RunRisk, risk);
        }
    }

    /// Follows the motion into `row`: from which row, and on which path. The bar is on all the way, but
    /// for a PTP motion, at whose end it is mounted.
    pub(crate) fn follow(&mut self, motion: Option<(&PlanRow, Path)>, row: &PlanRow) -> Option<Pace> {
        let mut worst = Worst { row: row.index, values: [None; Quantity::ALL.len()] };
        let there = row.axes_deg.map(f64::to_radians);
        let Some((from, path)) = motion else {
            self.margins.extend(self.look(&mut worst, &there, row.centre, Mounted::Yes));
            self.worst.push(worst);
            return None;
        };
        let mounted = if row.motion == Motion::Ptp { Mounted::No } else { Mounted::Yes };
        let mut stepper = Stepper::new(&path, row, from.axes_deg.map(f64::to_radians));
        let mut least: Option<StrokeMargin> = None;
        for part in 1..=stepper.parts {
            let share = f64::from(part) / f64::from(stepper.parts);
            let axes = match path.pose(share) {
                _ if part == stepper.parts && path.length_mm() == 0.0 => there,
                None => std::array::from_fn(|i| stepper.start[i] + (there[i] - stepper.start[i]) * share),
                Some(pose) => match nearest(&self.cell.rig.controller.geometry, &pose, &stepper.last) {
                    Ok(axes) => axes,
                    Err(reason) => {
                        self.findings.push(unreachable(row.index, pose.position.into(), &reason));
                        return None;
                    }
                },
            };
            stepper.advance(axes, self.robot, &mut worst);
            let margin = self.look(&mut worst, &axes, row.centre, mounted);
            if margin.as_ref().is_some_and(|one| least.as_ref().is_none_or(|kept| one.risk > kept.risk)) {
                least = margin;
            }
            let became = status(&self.cell.rig.controller.geometry, &axes);
            if became != self.began && row.motion != Motion::Ptp && !self.strayed {
                // What follows from it is not reported again.
                self.strayed = true;
                self.findings.push(PlanFinding::BranchLeft { row: row.index, began: self.began, became });
                break;
            }
        }
        // The fine path must end where the row says that it does, full turns included.
        let last = stepper.last;
        let astray = (0..AXES).map(|i| (last[i] - there[i]).abs().to_degrees()).fold(0.0, f64::max);
        if astray > 1.0 {
            worst.note(Quantity::AxisJumpDeg, astray.max(JUMP_DEG * 2.0));
        }
        self.worst.push(worst);
        self.margins.extend(least);
        let Stepper { axis_s, slope_s2, bend_s2, .. } = stepper;
        Some(Pace { path, axis_s, slope_s2, bend_s2 })
    }

    fn look(
        &self,
        worst: &mut Worst,
        axes: &[f64; AXES],
        centre: u32,
        mounted: Mounted,
    ) -> Option<StrokeMargin> {
        self.cell.look(axes, centre, mounted, &mut |quantity, value| {
            worst.note(quantity, value);
            Some(())
        })
    }
}

/// The path that the controller takes into a row.
pub fn path(from: &PlanRow, aux: Option<&PlanRow>, row: &PlanRow) -> Path {
    let pose = |row: &PlanRow| Pose::from_kuka(row.xyz_mm, row.abc_deg);
    match (row.motion, aux) {
        (Motion::Ptp, _) => {
            Path::Axes { from: from.axes_deg.map(f64::to_radians), to: row.axes_deg.map(f64::to_radians) }
        }
        (Motion::Circ, Some(aux)) => Path::arc(pose(from), &aux.xyz_mm.into(), pose(row)),
        (Motion::Circ | Motion::Lin, _) => Path::Line { from: pose(from), to: pose(row) },
    }
}

/// All checks: the worst of each quantity on the way to each row.
pub(crate) fn judge(job: &Job, rows: &[PlanRow], worst: &[Worst]) -> Vec<Check> {
    let mut checks = Vec::new();
    for there in worst {
        let (row, centre) = (there.row, rows.get(there.position()).map_or(1, |row| row.centre));
        for quantity in Quantity::ALL {
            if let Some(worst) = there.values[quantity as usize] {
                checks.push(Check { quantity, worst, limit: limit(job, centre, quantity), row });
            }
        }
    }
    checks
}

/// Of each quantity the check that is nearest to its limit.
pub(crate) fn summary(checks: &[Check]) -> Vec<Check> {
    let slack = |check: &Check| {
        if check.quantity.at_least() { check.worst - check.limit } else { check.limit - check.worst }
    };
    Quantity::ALL
        .iter()
        .filter_map(|quantity| {
            let same = checks.iter().filter(|check| check.quantity == *quantity);
            same.min_by(|a, b| slack(a).total_cmp(&slack(b))).cloned()
        })
        .collect()
}

/// The greatest axis speed and acceleration on the way to a row at the speeds chosen, percent of the greatest.
pub(crate) fn note_speed(worst: &mut Worst, pace: &Pace, time: &MoveTime) {
    let (speed, acceleration) = match pace.path {
        Path::Axes { .. } => (time.axis_percent, PTP_ACCELERATION_PERCENT),
        Path::Line { .. } | Path::Arc { .. } => {
            let share = |speed: f64, whole: f64| if whole > 0.0 { speed / whole } else { f64::INFINITY };
            let (length, turn) = (pace.path.length_mm(), pace.path.turn_deg());
            let rate = share(time.feed_mm_s, length).min(share(time.turn_deg_s, turn));
            let ramp = share(ACCELERATION_MM_S2, length).min(share(ACCELERATION_DEG_S2, turn));
            if rate.is_finite() && ramp.is_finite() {
                (rate * pace.axis_s, pace.slope_s2 * ramp + pace.bend_s2 * rate * rate)
            } else {
                (0.0, 0.0)
            }
        }
    };
    let percent = if matches!(pace.path, Path::Axes { .. }) { 1.0 } else { 100.0 };
    worst.note(Quantity::AxisSpeedPercent, percent * speed);
    worst.note(Quantity::AxisAccelerationPercent, percent * acceleration);
}
