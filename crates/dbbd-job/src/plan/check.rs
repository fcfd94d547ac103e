//! Safety checks along the path: each motion is followed in fine steps, and the worst value of each quantity is kept.

use super::cell::over_run;
use super::job::Job;
use super::path::ToolBallPath;
use super::quantity::{CheckQuantity, JUMP_DEG, PlanCheck};
use super::rig::unreachable;
use super::timing::{
    ACCELERATION_DEG_S2, ACCELERATION_MM_S2, MoveTime, PTP_ACCELERATION_PERCENT, move_times,
};
use super::{
    BarPresence, MotionKind, PathTiming, PlanKinematics, PlanRow, PlanningCell, PlanningPrior, StrokeMargin,
    pass,
};
use crate::plan::PlanFinding;
use dbbd_model::robot::inverse::{nearest, status};
use dbbd_model::robot::{AXES, Pose, Robot};

/// The worst value of each quantity on the way to one row.
struct WorstOfRow {
    row: u32,
    values: [Option<f64>; CheckQuantity::COUNT],
}

impl WorstOfRow {
    /// Position of the row in the plan, from 0.
    fn position(&self) -> usize {
        self.row.saturating_sub(1) as usize
    }

    fn note(&mut self, quantity: CheckQuantity, value: f64) {
        let kept = &mut self.values[quantity as usize];
        let worse = kept.is_none_or(|worst| (value < worst) == quantity.at_least() || value.is_nan());
        if worse {
            *kept = Some(value);
        }
    }

    /// Notes the greatest axis speed and acceleration on the way to the row at the chosen speeds, percent of the
    /// limits.
    fn note_speed(&mut self, pace: &PathTiming, time: &MoveTime) {
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

/// Rows with the worst values of the checked quantities along their motions.
#[derive(Default)]
pub(super) struct Inspection {
    pub(super) rows: Vec<PlanRow>,
    paces: Vec<Option<PathTiming>>,
    worst: Vec<WorstOfRow>,
    /// Poses and paths that cannot be reached.
    pub(super) findings: Vec<PlanFinding>,
    /// The pose of the greatest stroke risk of each row.
    margins: Vec<StrokeMargin>,
}

impl Inspection {
    pub(super) fn refused(finding: PlanFinding) -> Self {
        Self { findings: vec![finding], ..Self::default() }
    }

    /// Follows a run of rows from where the robot is at row `before`.
    pub(super) fn new(
        rig: &PlanKinematics<'_>,
        prior: &PlanningPrior,
        rows: Vec<PlanRow>,
        before: Option<&PlanRow>,
    ) -> Self {
        let Some(start) = rows.first() else { return Self::default() };
        let cell =
            PlanningCell::new(*rig, prior, start.centre.number(), &start.axes_deg.map(f64::to_radians));
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

    /// Notes the risk of all rows together at the last row, and returns it.
    pub(super) fn note_run_risk(&mut self) -> f64 {
        let risk = over_run(&self.margins);
        if let Some(last) = self.worst.last_mut() {
            last.note(CheckQuantity::RunRisk, risk);
        }
        risk
    }

    /// Chooses the speeds and durations of the moves, and notes their axis speeds and accelerations.
    pub(super) fn time_moves(&mut self, job: &Job, robot: &Robot, pose_hash: u64) -> Vec<MoveTime> {
        let moves = move_times(&self.rows, &self.paces, &job.motion, robot, pose_hash);
        for worst in &mut self.worst {
            let at = worst.position();
            if let (Some(Some(pace)), Some(time)) = (self.paces.get(at), moves.get(at)) {
                worst.note_speed(pace, time);
            }
        }
        moves
    }

    pub(super) fn append(&mut self, mut run: Self) {
        self.rows.append(&mut run.rows);
        self.paces.append(&mut run.paces);
        self.worst.append(&mut run.worst);
        self.findings.append(&mut run.findings);
        self.margins.append(&mut run.margins);
    }

    /// The worst value of each quantity on the way to each row, with its limit.
    pub(super) fn checks(&self, job: &Job) -> Vec<PlanCheck> {
        let mut checks = Vec::new();
        for there in &self.worst {
            let ball = self.rows.get(there.position()).map_or(1, |row| row.centre.number());
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

    pub(super) fn is_safe(&self, job: &Job) -> bool {
        self.findings.is_empty() && self.checks(job).iter().all(PlanCheck::holds)
    }
}

/// For each quantity, the check that is nearest to its limit.
pub(super) fn summary(checks: &[PlanCheck]) -> Vec<PlanCheck> {
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

/// Follows the axes along one motion, step by step.
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
    fn new(path: &ToolBallPath, start: [f64; AXES]) -> Self {
        let parts = path.steps();
        Self { parts, start, last: start, before: None, axis_s: 0.0, slope_s2: 0.0, bend_s2: 0.0 }
    }

    /// Steps to `axes`, and keeps the greatest speeds and accelerations of an axis along the path.
    fn advance(&mut self, axes: [f64; AXES], robot: &Robot, worst: &mut WorstOfRow) {
        let parts = f64::from(self.parts);
        for i in 0..AXES {
            // A limit that the robot's file does not state does not bind.
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
    /// Follows the motion into `row`: `motion` has the row before and the path. The bar is on all the way, except in a
    /// PTP motion, at whose end it is mounted.
    fn follow(&mut self, motion: Option<(&PlanRow, ToolBallPath)>, row: &PlanRow) -> Option<PathTiming> {
        let mut worst = WorstOfRow { row: row.index, values: [None; CheckQuantity::COUNT] };
        let there = row.axes_deg.map(f64::to_radians);
        let Some((from, path)) = motion else {
            self.found.margins.extend(self.evaluate(
                &mut worst,
                &there,
                row.centre.number(),
                BarPresence::Yes,
            ));
            self.found.worst.push(worst);
            return None;
        };
        let PlanKinematics { controller, robot, .. } = self.cell.rig;
        let mounted = if row.motion == MotionKind::Ptp { BarPresence::No } else { BarPresence::Yes };
        let mut stepper = MotionStepper::new(&path, from.axes_deg.map(f64::to_radians));
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
            let margin = self.evaluate(&mut worst, &axes, row.centre.number(), mounted);
            if margin.as_ref().is_some_and(|one| least.as_ref().is_none_or(|kept| one.risk > kept.risk)) {
                least = margin;
            }
            let (began, became) = (self.began, status(&controller.geometry, &axes));
            if became != began && row.motion != MotionKind::Ptp && !self.strayed {
                // Findings that follow from this one are not reported again.
                self.strayed = true;
                self.found.findings.push(PlanFinding::BranchLeft { row: row.index, began, became });
                break;
            }
        }
        // The fine path must end at the axis angles of the row, full turns included.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::example::{job, robot};

    fn worst() -> WorstOfRow {
        WorstOfRow { row: 1, values: [None; CheckQuantity::COUNT] }
    }

    fn line(length_mm: f64, turn_deg: f64) -> ToolBallPath {
        let from = Pose::from_kuka([0.0; 3], [0.0; 3]);
        ToolBallPath::Line { from, to: Pose::from_kuka([length_mm, 0.0, 0.0], [turn_deg, 0.0, 0.0]) }
    }

    fn assert_near(found: Option<f64>, expected: f64) {
        let found = found.expect("it was noted");
        assert!((found - expected).abs() < 1e-9, "{found}, not {expected}");
    }

    #[test]
    fn worst_is_the_least_or_the_greatest_by_the_quantity() {
        let mut worst = worst();
        for value in [3.0, 1.0, 2.0] {
            worst.note(CheckQuantity::WristDeg, value);
            worst.note(CheckQuantity::CupDeg, value);
        }
        assert_eq!(worst.values[CheckQuantity::WristDeg as usize], Some(1.0));
        assert_eq!(worst.values[CheckQuantity::CupDeg as usize], Some(3.0));
        worst.note(CheckQuantity::WristDeg, f64::NAN);
        assert!(worst.values[CheckQuantity::WristDeg as usize].is_some_and(f64::is_nan));
    }

    /// With the share s(t) of the path, the axis has the speed q' ds/dt and the acceleration q' d2s/dt2 + q''
    /// (ds/dt)^2.
    #[test]
    fn axis_speed_and_acceleration_follow_from_the_rate_of_the_path() {
        let time = |turn_deg_s| MoveTime {
            index: 1,
            feed_mm_s: 40.0,
            turn_deg_s,
            axis_percent: 10.0,
            duration_s: 0.0,
        };
        let noted = |turn_deg: f64, turn_deg_s: f64| {
            let pace = PathTiming { path: line(100.0, turn_deg), axis_s: 2.0, slope_s2: 0.5, bend_s2: 3.0 };
            let mut worst = worst();
            worst.note_speed(&pace, &time(turn_deg_s));
            [CheckQuantity::AxisSpeedPercent, CheckQuantity::AxisAccelerationPercent]
                .map(|quantity| worst.values[quantity as usize])
        };
        // 0.4 of the path per second and 2 of it per second^2; then 0.2 and 5/3 by the orientation.
        let [speed, acceleration] = noted(0.0, 12.0);
        assert_near(speed, 80.0);
        assert_near(acceleration, 100.0 * (0.5 * 2.0 + 3.0 * 0.16));
        let [speed, acceleration] = noted(60.0, 12.0);
        assert_near(speed, 40.0);
        assert_near(acceleration, 100.0 * (0.5 * 5.0 / 3.0 + 3.0 * 0.04));
    }

    /// Steps of a quarter of the path: 1, 2 and 0.5 degrees are 4, 8 and 2 degrees per path, and their differences 16
    /// and -24 degrees per path^2. Axis 1 has 128 degrees/s.
    #[test]
    fn derivatives_of_the_axes_are_taken_from_the_steps() {
        let mut robot = robot();
        robot.max_acceleration_deg_s2[0] = Some(200.0);
        let mut stepper = MotionStepper::new(&line(3.6, 0.0), [0.0; AXES]);
        assert_eq!(stepper.parts, 4);
        let mut worst = worst();
        for deg in [1.0, 3.0, 3.5] {
            let mut axes = [0.0; AXES];
            (axes[0], axes[3]) = (f64::to_radians(deg), f64::to_radians(deg));
            stepper.advance(axes, &robot, &mut worst);
        }
        assert_near(Some(stepper.axis_s), 8.0 / 128.0);
        assert_near(Some(stepper.slope_s2), 8.0 / 200.0);
        assert_near(Some(stepper.bend_s2), 24.0 / 200.0);
        assert_near(worst.values[CheckQuantity::AxisJumpDeg as usize], 2.0);
    }

    #[test]
    fn summary_has_the_check_nearest_to_its_limit() {
        let check = |quantity, worst, row| PlanCheck { quantity, worst, limit: 5.0, row };
        let found = summary(&[
            check(CheckQuantity::WristDeg, 9.0, 1),
            check(CheckQuantity::WristDeg, 6.0, 2),
            check(CheckQuantity::CupDeg, 1.0, 3),
            check(CheckQuantity::CupDeg, 4.0, 4),
        ]);
        assert_eq!(found.iter().map(|check| check.row).collect::<Vec<_>>(), [2, 4]);
    }

    #[test]
    fn reading_on_the_way_is_checked_and_not_only_at_its_ends() {
        // A chord between two points of the circle passes inside it: 300 (1 - cos 15 degrees) are 10.2 mm.
        let (job, robot) = (
            job("[[circle]]\nplane = \"XY\"\npoints = 12\ntilt_deg = 30.0\namplitude_deg = 25.0\n"),
            robot(),
        );
        let rig = PlanKinematics::new(&job, &robot);
        let prior = PlanningPrior::datasheet(&job, &robot);
        let mut steps = crate::plan::steps::circle_steps(&job).expect("the job is possible");
        steps.truncate(9);
        let last = steps.remove(8);
        steps.remove(7);
        steps.push(crate::plan::PlanStep { motion: MotionKind::Lin, ..last });
        let starts = rig.starts(&steps[0]).expect("it is in reach").into_iter();
        let runs = starts.filter_map(|start| rig.follow(&steps, 1, &start).ok()).flat_map(|run| run.starts);
        let (_, start) = runs.max_by(|(a, _), (b, _)| a.total_cmp(b)).expect("a branch can be followed");
        let rows = rig.follow(&steps, 1, &start).expect("it is in reach").rows;
        let found = Inspection::new(&rig, &prior, rows, None);
        let low =
            found.checks(&job).into_iter().filter(|check| check.quantity == CheckQuantity::ReadingLowMm);
        let worst = low.min_by(|a, b| a.worst.total_cmp(&b.worst)).expect("readings are checked");
        let sagitta = 300.0 * (1.0 - 15.0_f64.to_radians().cos());
        assert!((worst.worst + sagitta).abs() < 0.05, "{}", worst.worst);
        assert_eq!((worst.row, found.is_safe(&job)), (8, false));
    }
}
