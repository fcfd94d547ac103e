//! Is it safe? Each motion is followed finely, and what comes nearest to a limit is kept.

use super::cell::{Cell, Near};
use super::job::Job;
use super::path::Path;
use super::quantity::{Check, JUMP_DEG, Quantity, limit};
use super::risk::over_run;
use super::timing::{ACCELERATION_DEG_S2, ACCELERATION_MM_S2, PTP_ACCELERATION_PERCENT, Pace};
use super::{Motion, MoveTime, PlanRow};
use crate::model::inverse::{Unsolved, nearest, status};
use crate::model::{AXES, Pose, Robot};

/// Finest step along a path: 1 mm and 1 degree, be it of the tool or (PTP) of an axis.
const STEP_MM: f64 = 1.0;
const STEP_DEG: f64 = 1.0;

/// Why a plan is refused.
#[derive(Clone, Debug, PartialEq)]
pub enum Finding {
    /// A limit is not kept.
    Beyond(Check),
    /// A pose has no axis angles.
    Unsolved {
        /// The row, or the one to which the path leads.
        row: u32,
        /// Where, mm.
        xyz_mm: [f64; 3],
        /// Why not.
        reason: Unsolved,
    },
    /// The path leaves the branch in which it began.
    Branch {
        /// The row to which the path leads.
        row: u32,
        /// Status at the start of the run.
        began: u8,
        /// Status on the way.
        became: u8,
    },
}

impl std::fmt::Display for Finding {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Beyond(check) => check.fmt(out),
            Self::Unsolved { row, xyz_mm: [x, y, z], reason } => {
                write!(out, "row {row}: at ({x:.1}, {y:.1}, {z:.1}) mm: {reason}")
            }
            Self::Branch { row, began, became } => {
                write!(
                    out,
                    "row {row}: the arm changes its branch on the way: status {became}, must stay {began}"
                )
            }
        }
    }
}

/// The worst of each quantity on the way to one row.
pub(crate) struct Facts {
    row: u32,
    worst: [Option<f64>; Quantity::ALL.len()],
}

impl Facts {
    /// Position of the row in the plan, from 0.
    pub(crate) fn position(&self) -> usize {
        self.row.saturating_sub(1) as usize
    }

    pub(crate) fn note(&mut self, quantity: Quantity, value: f64) {
        let kept = &mut self.worst[quantity as usize];
        let worse = match *kept {
            None => true,
            Some(worst) => (value < worst) == quantity.at_least() || value.is_nan(),
        };
        if worse {
            *kept = Some(value);
        }
    }
}

/// Follows the motions of a run of rows in which the bar stays on.
pub(crate) struct Inspector<'a> {
    cell: &'a Cell<'a>,
    robot: &'a Robot,
    began: u8,
    strayed: bool,
    pub(crate) nears: Vec<Near>,
    pub(crate) facts: Vec<Facts>,
    pub(crate) findings: Vec<Finding>,
}

impl<'a> Inspector<'a> {
    pub(crate) fn new(cell: &'a Cell<'a>, robot: &'a Robot, start: &PlanRow) -> Self {
        Self {
            cell,
            robot,
            began: start.status,
            strayed: false,
            nears: Vec::new(),
            facts: Vec::new(),
            findings: Vec::new(),
        }
    }

    /// Ends the run: its risk as a whole stands at its last row.
    pub(crate) fn finish(&mut self) {
        let risk = over_run(&self.nears);
        if let Some(last) = self.facts.last_mut() {
            last.note(Quantity::RunRisk, risk);
        }
    }

    /// Follows the motion into `row`: from which row, and on which path. The bar is on all the way, but
    /// for a PTP motion, at whose end it is mounted.
    pub(crate) fn follow(&mut self, motion: Option<(&PlanRow, Path)>, row: &PlanRow) -> Option<Pace> {
        let mut facts = Facts { row: row.index, worst: [None; Quantity::ALL.len()] };
        let mut nearest_end: Option<Near> = None;
        let there = row.axes_deg.map(f64::to_radians);
        let Some((from, path)) = motion else {
            self.nears.extend(self.look(&mut facts, &there, row.centre, true));
            self.facts.push(facts);
            return None;
        };
        let mut last = from.axes_deg.map(f64::to_radians);
        let widest = (0..AXES).map(|i| (there[i] - last[i]).abs().to_degrees()).fold(0.0, f64::max);
        let turn = if row.motion == Motion::Ptp { widest } else { path.turn_deg() };
        let parts = (path.length_mm() / STEP_MM).max(turn / STEP_DEG).ceil().clamp(1.0, 1e5) as u32;
        let mut axis_s: f64 = 0.0;
        let (mut slope_s2, mut bend_s2): (f64, f64) = (0.0, 0.0);
        let mut before: Option<[f64; AXES]> = None;
        // What the robot's file does not say is no limit.
        let greatest = self.robot.max_acceleration_deg_s2.map(|limit| limit.unwrap_or(f64::INFINITY));
        for part in 1..=parts {
            let share = f64::from(part) / f64::from(parts);
            let axes = match path.pose(share) {
                _ if part == parts && path.length_mm() == 0.0 => there,
                None => std::array::from_fn(|i| {
                    let begin = from.axes_deg[i].to_radians();
                    begin + (there[i] - begin) * share
                }),
                Some(pose) => match nearest(&self.cell.rig.controller.geometry, &pose, &last) {
                    Ok(axes) => axes,
                    Err(reason) => {
                        let xyz_mm = pose.position.into();
                        self.findings.push(Finding::Unsolved { row: row.index, xyz_mm, reason });
                        return None;
                    }
                },
            };
            for i in 0..AXES {
                let travel = (axes[i] - last[i]).abs().to_degrees();
                facts.note(Quantity::AxisJumpDeg, travel);
                axis_s = axis_s.max(travel * f64::from(parts) / self.robot.max_speed_deg_s[i]);
                slope_s2 = slope_s2.max(travel * f64::from(parts) / greatest[i]);
                if let Some(before) = before {
                    let bend = (axes[i] - 2.0 * last[i] + before[i]).abs().to_degrees();
                    bend_s2 = bend_s2.max(bend * f64::from(parts) * f64::from(parts) / greatest[i]);
                }
            }
            before = Some(last);
            let near = self.look(&mut facts, &axes, row.centre, row.motion != Motion::Ptp);
            if near.as_ref().is_some_and(|near| nearest_end.as_ref().is_none_or(|kept| near.risk > kept.risk))
            {
                nearest_end = near;
            }
            let became = status(&self.cell.rig.controller.geometry, &axes);
            if became != self.began && row.motion != Motion::Ptp && !self.strayed {
                // What follows from it is not told again.
                self.strayed = true;
                self.findings.push(Finding::Branch { row: row.index, began: self.began, became });
                break;
            }
            last = axes;
        }
        // The fine path must end where the row says that it does, full turns included.
        let astray = (0..AXES).map(|i| (last[i] - there[i]).abs().to_degrees()).fold(0.0, f64::max);
        if astray > 1.0 {
            facts.note(Quantity::AxisJumpDeg, astray.max(JUMP_DEG * 2.0));
        }
        self.facts.push(facts);
        self.nears.extend(nearest_end);
        Some(Pace { path, axis_s, slope_s2, bend_s2 })
    }

    fn look(&self, facts: &mut Facts, axes: &[f64; AXES], centre: u32, bar_on: bool) -> Option<Near> {
        self.cell.look(axes, centre, bar_on, &mut |quantity, value| {
            facts.note(quantity, value);
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
pub(crate) fn judge(job: &Job, rows: &[PlanRow], facts: &[Facts]) -> Vec<Check> {
    let mut checks = Vec::new();
    for facts in facts {
        let centre = rows.get(facts.row.saturating_sub(1) as usize).map_or(1, |row| row.centre);
        for quantity in Quantity::ALL {
            if let Some(worst) = facts.worst[quantity as usize] {
                checks.push(Check { quantity, worst, limit: limit(job, centre, quantity), row: facts.row });
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
pub(crate) fn note_speed(facts: &mut Facts, pace: &Pace, time: &MoveTime) {
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
    facts.note(Quantity::AxisSpeedPercent, percent * speed);
    facts.note(Quantity::AxisAccelerationPercent, percent * acceleration);
}
