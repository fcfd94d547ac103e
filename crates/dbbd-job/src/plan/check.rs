//! Safety checks along the path: each motion is followed in fine steps, and the worst value of each quantity is kept.

use super::cell::{BarPresence, PlanningCell, StrokeMargin};
use super::job::Job;
use super::path::ToolBallPath;
use super::quantity::{CheckQuantity, JUMP_DEG, PlanCheck};
use super::rig::{PlanKinematics, unreachable};
use super::risk::over_run;
use super::timing::{ACCELERATION_DEG_S2, ACCELERATION_MM_S2, PTP_ACCELERATION_PERCENT, PathTiming};
use super::{MotionKind, MoveTime, PlanRow, PlanningPrior, pass};
use crate::plan::PlanFinding;
use dbbd_model::robot::inverse::{nearest, status};
use dbbd_model::robot::{AXES, Pose, Robot};

/// Finest step along a path, of the ball and of the tool's orientation or (PTP) of an axis.
const STEP_MM: f64 = 1.0;
const STEP_DEG: f64 = 1.0;

/// The worst of each quantity on the way to one row.
pub(crate) struct WorstOfRow {
    row: u32,
    values: [Option<f64>; CheckQuantity::COUNT],
}

impl WorstOfRow {
    /// Position of the row in the plan, from 0.
    pub(crate) fn position(&self) -> usize {
        self.row.saturating_sub(1) as usize
    }

    pub(crate) fn note(&mut self, quantity: CheckQuantity, value: f64) {
        let kept = &mut self.values[quantity as usize];
        let worse = kept.is_none_or(|worst| (value < worst) == quantity.at_least() || value.is_nan());
        if worse {
            *kept = Some(value);
        }
    }

    /// The greatest axis speed and acceleration on the way to the row at the speeds chosen, percent of the limits.
    pub(crate) fn note_speed(&mut self, pace: &PathTiming, time: &MoveTime) {
        let (speed, acceleration) = match pace.path {
            ToolBallPath::Axes { .. } => (time.axis_percent, PTP_ACCELERATION_PERCENT),
            ToolBallPath::Line { .. } | ToolBallPath::Arc { .. } => {
                let share = |speed: f64, whole: f64| if whole > 0.0 { speed / whole } else { f64::INFINITY };
                let (length, turn) = (pace.path.length_mm(), pace.path.turn_deg());
                let rate = share(time.feed_mm_s, length).min(share(time.turn_deg_s, turn));
                let ramp = share(ACCELERATION_MM_S2, length).min(share(ACCELERATION_DEG_S2, turn));
                if rate.is_finite() && ramp.is_finite() {
                    let acceleration = pace.slope_s2 * ramp + pace.bend_s2 * rate * rate;
                    (100.0 * (rate * pace.axis_s), 100.0 * acceleration)
                } else {
                    (0.0, 0.0)
                }
            }
        };
        self.note(CheckQuantity::AxisSpeedPercent, speed);
        self.note(CheckQuantity::AxisAccelerationPercent, acceleration);
    }
}

/// Rows with what their motions come near to.
#[derive(Default)]
pub(crate) struct Inspection {
    pub(crate) rows: Vec<PlanRow>,
    pub(crate) paces: Vec<Option<PathTiming>>,
    pub(crate) worst: Vec<WorstOfRow>,
    /// Poses and paths that cannot be reached.
    pub(crate) findings: Vec<PlanFinding>,
    /// The pose of the greatest stroke risk of each row.
    pub(crate) margins: Vec<StrokeMargin>,
}

impl Inspection {
    pub(crate) fn refused(finding: PlanFinding) -> Self {
        Self { findings: vec![finding], ..Self::default() }
    }

    /// Follows a run of rows from where the robot is at row `before`.
    pub(crate) fn new(
        rig: &PlanKinematics<'_>,
        prior: &PlanningPrior,
        rows: Vec<PlanRow>,
        before: Option<&PlanRow>,
    ) -> Self {
        let Some(start) = rows.first() else { return Self::default() };
        let cell = PlanningCell::new(*rig, prior, start.centre, &start.axes_deg.map(f64::to_radians));
        let mut inspector = Inspector { cell, began: start.status, strayed: false, found: Self::default() };
        let passes = match pass::groups(&rows) {
            Ok(passes) => passes,
            Err(ungrouped) => return Self::refused(ungrouped.finding),
        };
        let (mut from, mut aux) = (before, None);
        for (at, row) in rows.iter().enumerate() {
            let pass = passes.iter().find(|pass| pass.holds(at));
            // Between the ends of a pass, and at the auxiliary point of an arc, no motion ends.
            if pass.map_or(row.is_auxiliary(), |pass| at != pass.end) {
                aux = pass.is_none().then_some(row);
                inspector.found.paces.push(None);
                continue;
            }
            let path = match pass {
                Some(pass) => pass.path(rig.job, from, &rows),
                None => from.map(|from| path(from, aux.take(), row)),
            };
            let pace = inspector.follow(from.zip(path), row);
            inspector.found.paces.push(pace);
            from = Some(row);
        }
        let mut found = Self { rows, ..inspector.found };
        found.note_run_risk();
        found
    }

    /// Notes the risk of all rows together at the last one.
    pub(crate) fn note_run_risk(&mut self) -> f64 {
        let risk = over_run(&self.margins);
        if let Some(last) = self.worst.last_mut() {
            last.note(CheckQuantity::RunRisk, risk);
        }
        risk
    }

    pub(crate) fn append(&mut self, mut run: Self) {
        self.rows.append(&mut run.rows);
        self.paces.append(&mut run.paces);
        self.worst.append(&mut run.worst);
        self.findings.append(&mut run.findings);
        self.margins.append(&mut run.margins);
    }

    /// The worst of each quantity on the way to each row, with its limit.
    pub(crate) fn checks(&self, job: &Job) -> Vec<PlanCheck> {
        let mut checks = Vec::new();
        for there in &self.worst {
            let ball = self.rows.get(there.position()).map_or(1, |row| row.centre);
            for quantity in CheckQuantity::all() {
                if let Some(worst) = there.values[quantity as usize] {
                    checks.push(PlanCheck {
                        quantity,
                        worst,
                        limit: quantity.limit(job, ball),
                        row: there.row,
                    });
                }
            }
        }
        checks
    }

    pub(crate) fn is_safe(&self, job: &Job) -> bool {
        self.findings.is_empty() && self.checks(job).iter().all(PlanCheck::holds)
    }
}

/// Of each quantity the check that is nearest to its limit.
pub(crate) fn summary(checks: &[PlanCheck]) -> Vec<PlanCheck> {
    let worst = |quantity: CheckQuantity| {
        let same = checks.iter().filter(|check| check.quantity == quantity);
        same.min_by(|a, b| a.slack().total_cmp(&b.slack())).cloned()
    };
    CheckQuantity::all().filter_map(worst).collect()
}

/// Follows the motions of a run of rows in which the bar stays on.
struct Inspector<'a> {
    cell: PlanningCell<'a>,
    /// Status bits of the first row.
    began: u8,
    /// Whether a change of the status was reported.
    strayed: bool,
    found: Inspection,
}

/// What the axes do along one motion, step by step.
struct MotionStepper {
    parts: u32,
    start: [f64; AXES],
    last: [f64; AXES],
    before: Option<[f64; AXES]>,
    axis_s: f64,
    slope_s2: f64,
    bend_s2: f64,
}

impl MotionStepper {
    fn new(path: &ToolBallPath, row: &PlanRow, start: [f64; AXES]) -> Self {
        let turn = if row.motion == MotionKind::Ptp {
            widest_deg(&row.axes_deg.map(f64::to_radians), &start)
        } else {
            path.turn_deg()
        };
        let parts = (path.length_mm() / STEP_MM).max(turn / STEP_DEG).ceil().clamp(1.0, 1e5) as u32;
        Self { parts, start, last: start, before: None, axis_s: 0.0, slope_s2: 0.0, bend_s2: 0.0 }
    }

    /// Takes the step to `axes`: the greatest speeds and accelerations of an axis along the path.
    fn advance(&mut self, axes: [f64; AXES], robot: &Robot, worst: &mut WorstOfRow) {
        let parts = f64::from(self.parts);
        for i in 0..AXES {
            // What the robot's file does not say is no limit.
            let greatest = robot.max_acceleration_deg_s2[i].unwrap_or(f64::INFINITY);
            let travel = (axes[i] - self.last[i]).abs().to_degrees();
            worst.note(CheckQuantity::AxisJumpDeg, travel);
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

/// The widest turn of an axis between two sets of axis angles in rad, degrees.
fn widest_deg(a: &[f64; AXES], b: &[f64; AXES]) -> f64 {
    (0..AXES).map(|i| (a[i] - b[i]).abs().to_degrees()).fold(0.0, f64::max)
}

impl Inspector<'_> {
    /// Follows the motion into `row`: from which row, and on which path. The bar is on all the way, except in a PTP
    /// motion, at whose end it is mounted.
    fn follow(&mut self, motion: Option<(&PlanRow, ToolBallPath)>, row: &PlanRow) -> Option<PathTiming> {
        let mut worst = WorstOfRow { row: row.index, values: [None; CheckQuantity::COUNT] };
        let there = row.axes_deg.map(f64::to_radians);
        let Some((from, path)) = motion else {
            self.found.margins.extend(self.evaluate(&mut worst, &there, row.centre, BarPresence::Yes));
            self.found.worst.push(worst);
            return None;
        };
        let PlanKinematics { controller, robot, .. } = self.cell.rig;
        let mounted = if row.motion == MotionKind::Ptp { BarPresence::No } else { BarPresence::Yes };
        let mut stepper = MotionStepper::new(&path, row, from.axes_deg.map(f64::to_radians));
        let mut least: Option<StrokeMargin> = None;
        for part in 1..=stepper.parts {
            let share = f64::from(part) / f64::from(stepper.parts);
            let axes = match path.pose(share) {
                _ if part == stepper.parts && path.length_mm() == 0.0 => there,
                None => std::array::from_fn(|i| stepper.start[i] + (there[i] - stepper.start[i]) * share),
                Some(pose) => match nearest(&controller.geometry, &pose, &stepper.last) {
                    Ok(axes) => axes,
                    Err(reason) => {
                        self.found.findings.push(unreachable(row.index, pose.position.into(), &reason));
                        return None;
                    }
                },
            };
            stepper.advance(axes, robot, &mut worst);
            let margin = self.evaluate(&mut worst, &axes, row.centre, mounted);
            if margin.as_ref().is_some_and(|one| least.as_ref().is_none_or(|kept| one.risk > kept.risk)) {
                least = margin;
            }
            let (began, became) = (self.began, status(&controller.geometry, &axes));
            if became != began && row.motion != MotionKind::Ptp && !self.strayed {
                // What follows from it is not reported again.
                self.strayed = true;
                self.found.findings.push(PlanFinding::BranchLeft { row: row.index, began, became });
                break;
            }
        }
        // The fine path must end where the row says that it does, full turns included.
        let astray = widest_deg(&stepper.last, &there);
        if astray > 1.0 {
            worst.note(CheckQuantity::AxisJumpDeg, astray.max(JUMP_DEG * 2.0));
        }
        self.found.worst.push(worst);
        self.found.margins.extend(least);
        let MotionStepper { axis_s, slope_s2, bend_s2, .. } = stepper;
        Some(PathTiming { path, axis_s, slope_s2, bend_s2 })
    }

    fn evaluate(
        &self,
        worst: &mut WorstOfRow,
        axes: &[f64; AXES],
        centre: u32,
        mounted: BarPresence,
    ) -> Option<StrokeMargin> {
        self.cell.evaluate(axes, centre, mounted, &mut |quantity, value| {
            worst.note(quantity, value);
            Some(())
        })
    }
}

/// The path that the controller takes into a row.
pub fn path(from: &PlanRow, aux: Option<&PlanRow>, row: &PlanRow) -> ToolBallPath {
    let pose = |row: &PlanRow| Pose::from_kuka(row.xyz_mm, row.abc_deg);
    match (row.motion, aux) {
        (MotionKind::Ptp, _) => ToolBallPath::Axes {
            from: from.axes_deg.map(f64::to_radians),
            to: row.axes_deg.map(f64::to_radians),
        },
        (MotionKind::Circ, Some(aux)) => ToolBallPath::arc(pose(from), &aux.xyz_mm.into(), pose(row)),
        (MotionKind::Circ | MotionKind::Lin, _) => ToolBallPath::Line { from: pose(from), to: pose(row) },
    }
}
