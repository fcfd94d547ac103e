//! The schedule of a run according to its plan: dwells, modules, stroke, and removals of the bar.

use std::collections::BTreeSet;

use super::TelegramMismatch;
use crate::live::{Alarm, NextPose, Point};
use dbbd_job::plan::{MotionKind, Plan, PoseKind};
use dbbd_job::recording::{Telegram, run_number};

/// Share of the half stroke beyond which the alarm is raised.
pub const ALARM_SHARE: f64 = 0.9;

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Schedule {
    /// Length of the bar at reading zero, mm.
    pub bar_length_mm: Option<f64>,
    /// Lowest and highest reading, mm.
    pub stroke_mm: Option<[f64; 2]>,
    /// Share of the half stroke beyond which the alarm is raised.
    pub alarm_share: f64,
    dwells: Vec<PlannedDwell>,
    /// Time of the whole plan, s.
    duration_s: Option<f64>,
    /// Completed dwells at each removal of the bar.
    pub(super) taken_off: Vec<u32>,
    program: Option<ScheduledProgram>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct PlannedDwell {
    index: u32,
    circle: u32,
    angle_deg: Option<f64>,
    clockwise: bool,
    length_mm: f64,
    /// Remaining time of the plan after the dwell, s.
    left_s: f64,
}

/// The program of the plan.
#[derive(Clone, Debug, PartialEq)]
struct ScheduledProgram {
    /// Number of modules: one per circle of the plan.
    modules: usize,
    /// The run number in the telegrams of the program.
    run: Option<u32>,
    /// The rows whose end the program reports: dwells, and ends of passes without stops.
    reported: BTreeSet<u32>,
}

impl ScheduledProgram {
    fn of(plan: &Plan) -> Self {
        let circles: BTreeSet<u32> =
            plan.rows.iter().map(|row| row.circle).filter(|circle| *circle != 0).collect();
        let dwells = plan.rows.iter().filter(|row| row.kind != PoseKind::Transit).map(|row| row.index);
        let reported = dwells.chain(plan.header.passes.iter().map(|pass| pass.end)).collect();
        Self { modules: circles.len(), run: run_number(&plan.header.hash), reported }
    }
}

impl Schedule {
    /// A schedule without a plan.
    pub fn bare(stroke_mm: Option<[f64; 2]>, alarm_share: f64) -> Self {
        Self { stroke_mm, alarm_share, ..Self::default() }
    }

    pub fn of(plan: &Plan, alarm_share: f64) -> Self {
        let places = plan.circle_places();
        let duration_s = plan.duration_s();
        let left = plan.row_times_s().scan(duration_s, |left_s, row_s| {
            *left_s -= row_s;
            Some(left_s.max(0.0))
        });
        let rows =
            plan.rows.iter().zip(&places).zip(left).filter(|((row, _), _)| row.kind != PoseKind::Transit);
        let dwells = rows.map(|((row, place), left_s)| PlannedDwell {
            index: row.index,
            circle: row.circle,
            // A reference pose is not drawn on the circle.
            angle_deg: place.filter(|_| row.kind == PoseKind::Measure).map(|place| place.angle_deg),
            clockwise: place.is_some_and(|place| place.clockwise),
            length_mm: row.length_mm,
            left_s,
        });
        // The bar is off during every PTP motion, and after the end.
        let off = plan.rows.iter().filter(|row| row.motion == MotionKind::Ptp).map(|row| row.index);
        let over = |index: u32| {
            plan.rows.iter().filter(|row| row.kind != PoseKind::Transit && row.index < index).count() as u32
        };
        let mut taken_off: Vec<u32> = off.chain([u32::MAX]).map(over).filter(|dwells| *dwells > 0).collect();
        taken_off.dedup();
        let bar = &plan.header.job.bar;
        Self {
            bar_length_mm: Some(bar.length_mm),
            stroke_mm: Some(bar.stroke_mm),
            alarm_share,
            dwells: dwells.collect(),
            duration_s: Some(duration_s),
            taken_off,
            program: Some(ScheduledProgram::of(plan)),
        }
    }

    pub(super) fn modules(&self) -> Option<usize> {
        self.program.as_ref().map(|program| program.modules)
    }

    /// Why the telegram does not belong to the program of the plan; `None` if it does, or without a plan.
    pub(super) fn mismatch(&self, telegram: &Telegram) -> Option<TelegramMismatch> {
        let program = self.program.as_ref()?;
        match program.run {
            Some(expected) if expected != telegram.run => Some(TelegramMismatch::Run { expected }),
            _ => (!program.reported.contains(&telegram.index)).then_some(TelegramMismatch::NoDwell),
        }
    }

    /// Whether the row is the last one that the program reports.
    pub(super) fn is_last(&self, index: u32) -> bool {
        self.program.as_ref().is_some_and(|program| program.reported.last() == Some(&index))
    }

    /// Number of dwells of the plan.
    pub fn poses(&self) -> Option<u32> {
        self.bar_length_mm.and_then(|_| u32::try_from(self.dwells.len()).ok())
    }

    /// Remaining time of the plan after so many dwells, at full override, s.
    pub(super) fn left_s(&self, dwells: u32) -> Option<f64> {
        match (dwells as usize).checked_sub(1) {
            None => self.duration_s,
            Some(last) => self.duration_s.map(|_| self.dwells.get(last).map_or(0.0, |dwell| dwell.left_s)),
        }
    }

    /// The pose of the next dwell.
    pub(super) fn next(&self, dwells: u32) -> Option<NextPose> {
        let PlannedDwell { index, circle, angle_deg, .. } = *self.dwells.get(dwells as usize)?;
        Some(NextPose { index, circle, angle_deg })
    }

    pub fn alarm(&self, reading_mm: f64) -> Alarm {
        let Some([low, high]) = self.stroke_mm else { return Alarm::None };
        let share = (reading_mm - 0.5 * (low + high)).abs() / (0.5 * (high - low));
        // A bar at its end stop reads the end of its stroke.
        if share >= 1.0 {
            Alarm::Over
        } else if share > self.alarm_share {
            Alarm::Near
        } else {
            Alarm::None
        }
    }

    /// The dwell of number `dwell` (from 1) with its mean reading.
    pub(super) fn point(&self, dwell: u32, reading_mm: f64) -> Point {
        let planned = (dwell as usize).checked_sub(1).and_then(|at| self.dwells.get(at));
        let lengths_mm = planned.map(|planned| planned.length_mm).zip(self.bar_length_mm);
        Point {
            dwell,
            index: planned.map(|planned| planned.index),
            circle: planned.map(|planned| planned.circle),
            angle_deg: planned.and_then(|planned| planned.angle_deg),
            clockwise: planned.is_some_and(|planned| planned.clockwise),
            reading_mm,
            deviation_mm: lengths_mm.map(|(planned_mm, bar_mm)| bar_mm + reading_mm - planned_mm),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn alarms_depend_on_the_share_of_the_stroke() {
        let schedule = Schedule::bare(Some([-1.0, 3.0]), 0.9);
        for (reading, alarm) in [
            (1.0, Alarm::None),
            (2.79, Alarm::None),
            (2.81, Alarm::Near),
            (-0.9, Alarm::Near),
            (3.0, Alarm::Over),
            (-1.01, Alarm::Over),
        ] {
            assert_eq!(schedule.alarm(reading), alarm, "{reading}");
        }
        assert_eq!(Schedule::bare(None, 0.9).alarm(1e9), Alarm::None);
    }

    /// Two circles with a module each: dwells of the rows 3, 5 and 9, after which 30, 20 and 2 s are left.
    fn schedule() -> Schedule {
        let dwell = |index, circle, angle_deg, length_mm, left_s| PlannedDwell {
            index,
            circle,
            angle_deg,
            clockwise: index == 5,
            length_mm,
            left_s,
        };
        Schedule {
            bar_length_mm: Some(300.0),
            dwells: vec![
                dwell(3, 1, Some(10.0), 300.5, 30.0),
                dwell(5, 1, Some(20.0), 299.0, 20.0),
                dwell(9, 2, None, 301.0, 2.0),
            ],
            duration_s: Some(42.0),
            program: Some(ScheduledProgram { modules: 2, run: Some(77), reported: [3, 5, 9].into() }),
            ..Schedule::bare(Some([-2.0, 6.0]), 0.9)
        }
    }

    #[test]
    fn time_is_left_until_the_last_dwell() {
        let schedule = schedule();
        let left: Vec<Option<f64>> = (0..5).map(|dwells| schedule.left_s(dwells)).collect();
        assert_eq!(left, [Some(42.0), Some(30.0), Some(20.0), Some(2.0), Some(0.0)]);
        assert_eq!(Schedule::bare(None, 0.9).left_s(1), None);
        assert_eq!((schedule.poses(), Schedule::bare(None, 0.9).poses()), (Some(3), None));
    }

    #[test]
    fn next_pose_is_that_of_the_dwell_after_the_completed_ones() {
        let next = |dwells| schedule().next(dwells).map(|pose| (pose.index, pose.circle, pose.angle_deg));
        assert_eq!([next(0), next(2), next(3)], [Some((3, 1, Some(10.0))), Some((9, 2, None)), None]);
    }

    /// The bar of 300 mm that reads 0.2 is 300.2 mm long: 0.3 mm short of the 300.5 mm of the plan.
    #[test]
    fn point_deviates_from_the_planned_length() {
        let point = schedule().point(1, 0.2);
        assert_eq!(
            (point.index, point.circle, point.angle_deg, point.clockwise),
            (Some(3), Some(1), Some(10.0), false)
        );
        assert!((point.deviation_mm.expect("the length is planned") + 0.3).abs() < 1e-9);
        let second = schedule().point(2, -0.9);
        assert!(second.clockwise);
        assert!((second.deviation_mm.expect("the length is planned") - 0.1).abs() < 1e-9);
        let beyond = schedule().point(4, 0.0);
        assert_eq!((beyond.index, beyond.deviation_mm), (None, None));
        assert_eq!(schedule().point(0, 0.0).index, None);
    }

    #[test]
    fn telegram_belongs_to_the_plan_by_its_run_and_row() {
        let telegram = |run, index| Telegram { run, index, phase: 2, axes_deg: [0.0; 6] };
        let mismatch = |run, index| schedule().mismatch(&telegram(run, index));
        assert_eq!(mismatch(77, 5), None);
        assert_eq!(mismatch(78, 5), Some(TelegramMismatch::Run { expected: 77 }));
        assert_eq!(mismatch(77, 4), Some(TelegramMismatch::NoDwell));
        assert_eq!(Schedule::bare(None, 0.9).mismatch(&telegram(1, 1)), None);
        assert_eq!([5, 9].map(|index| schedule().is_last(index)), [false, true]);
        assert_eq!(schedule().modules(), Some(2));
    }
}
