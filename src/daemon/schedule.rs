//! The schedule of a run according to its plan: counted stops, modules, stroke, and removals of the bar.
//!
//! A counted stop is a dwell or the end of a pass: the program raises the strobe once for each. The live state calls both a
//! dwell.

use std::collections::BTreeSet;

use super::TelegramMismatch;
use crate::live::{Alarm, NextPose, Point};
use dbbd_job::plan::{Plan, PoseKind};
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
    /// The counted stops of the plan, in order.
    stops: Vec<PlannedStop>,
    /// Time of the whole plan, s.
    duration_s: Option<f64>,
    /// Completed dwells at each removal of the bar.
    pub(super) taken_off: Vec<u32>,
    program: Option<ScheduledProgram>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct PlannedStop {
    /// The row of the plan; of a pass the row at which it ends.
    index: u32,
    /// 0: a chosen pose.
    circle: u32,
    angle_deg: Option<f64>,
    clockwise: bool,
    /// `None` for a pass: the mean of its readings is no length of a pose.
    length_mm: Option<f64>,
    /// Remaining time of the plan after the stop, s.
    left_s: f64,
}

/// The program of the plan.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ScheduledProgram {
    /// Number of modules: one per circle of the plan.
    modules: usize,
    /// The run number in the telegrams of the program.
    run: Option<u32>,
}

impl ScheduledProgram {
    fn of(plan: &Plan) -> Self {
        let circles: BTreeSet<u32> =
            plan.rows.iter().map(|row| row.circle).filter(|circle| *circle != 0).collect();
        Self { modules: circles.len(), run: run_number(&plan.header.hash) }
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
        let left: Vec<f64> = left.collect();
        let stops = plan.counted_stops().map(|stop| {
            let (row, pass) = (stop.row, stop.pass);
            // Rows are numbered from 1.
            let at = (row.index as usize).saturating_sub(1);
            let place = places.get(at).copied().flatten();
            PlannedStop {
                index: row.index,
                circle: if pass.is_some() || place.is_some() { row.circle } else { 0 },
                // A reference pose is not drawn on the circle.
                angle_deg: place.filter(|_| row.kind == PoseKind::Measure).map(|place| place.angle_deg),
                clockwise: pass.map_or(place.is_some_and(|place| place.clockwise), |pass| pass.clockwise),
                length_mm: pass.is_none().then_some(row.length_mm),
                left_s: left.get(at).copied().unwrap_or(0.0),
            }
        });
        let bar = &plan.header.job.bar;
        Self {
            bar_length_mm: Some(bar.length_mm),
            stroke_mm: Some(bar.stroke_mm),
            alarm_share,
            stops: stops.collect(),
            duration_s: Some(duration_s),
            // A plan without a program is not driven.
            taken_off: plan.removals().unwrap_or_default(),
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
            _ => {
                let is_reported = self.stops.iter().any(|stop| stop.index == telegram.index);
                (!is_reported).then_some(TelegramMismatch::NoDwell)
            }
        }
    }

    /// Whether the row is the last one that the program reports.
    pub(super) fn is_last(&self, index: u32) -> bool {
        self.stops.last().is_some_and(|stop| stop.index == index)
    }

    /// Number of counted stops of the plan.
    pub fn poses(&self) -> Option<u32> {
        self.bar_length_mm.and_then(|_| u32::try_from(self.stops.len()).ok())
    }

    /// Remaining time of the plan after so many dwells, at full override, s.
    pub(super) fn left_s(&self, dwells: u32) -> Option<f64> {
        match (dwells as usize).checked_sub(1) {
            None => self.duration_s,
            Some(last) => self.duration_s.map(|_| self.stops.get(last).map_or(0.0, |stop| stop.left_s)),
        }
    }

    /// The pose of the next dwell.
    pub(super) fn next(&self, dwells: u32) -> Option<NextPose> {
        let PlannedStop { index, circle, angle_deg, .. } = *self.stops.get(dwells as usize)?;
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

    /// The dwell or pass of number `dwell` (from 1) with its mean reading.
    pub(super) fn point(&self, dwell: u32, reading_mm: f64) -> Point {
        let planned = (dwell as usize).checked_sub(1).and_then(|at| self.stops.get(at));
        let lengths_mm = planned.and_then(|planned| planned.length_mm).zip(self.bar_length_mm);
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
    use dbbd_job::plan::Job;
    use dbbd_model::robot::{BallId, Robot};

    use super::*;
    use crate::daemon::mount_detector::{MountDetector, MountReading};

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
        let dwell = |index, circle, angle_deg, length_mm, left_s| PlannedStop {
            index,
            circle,
            angle_deg,
            clockwise: index == 5,
            length_mm: Some(length_mm),
            left_s,
        };
        Schedule {
            bar_length_mm: Some(300.0),
            stops: vec![
                dwell(3, 1, Some(10.0), 300.5, 30.0),
                dwell(5, 1, Some(20.0), 299.0, 20.0),
                dwell(9, 2, None, 301.0, 2.0),
            ],
            duration_s: Some(42.0),
            program: Some(ScheduledProgram { modules: 2, run: Some(77) }),
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

    /// A continuous circle out and back, with 36 points in each pass.
    fn plan_of_passes() -> Plan {
        let text = "robot = \"kr60ha\"\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = 300.0\nstroke_mm = [-6.0, 6.0]\n[[centre]]\nid = 1\n\
                    xyz_mm = [1300.0, 0.0, 800.0]\n[[circle]]\nplane = \"XY\"\npoints = 36\n\
                    orientation = \"fixed\"\ntilt_deg = 20.0\ndirection = \"both\"\nmode = \"continuous\"\n\
                    [motion]\nfeed_mm_s = 60.0\n";
        let robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        Plan::build(&Job::from_toml("job.toml", text).unwrap(), &robot)
            .unwrap_or_else(|refused| panic!("{refused}"))
    }

    /// The same circle twice. The second one begins where the first one ends, about the ball of this number.
    fn plan_of_two_circles(ball: u32) -> Plan {
        let mut plan = plan_of_passes();
        let again = plan.clone();
        let (shift, end) = (again.rows.len() as u32, again.rows[again.rows.len() - 1].axes_deg);
        plan.header.job.circles.extend(again.header.job.circles);
        plan.rows.extend(again.rows);
        let second = &mut plan.rows[shift as usize..];
        second[0].axes_deg = end;
        for row in second {
            row.index += shift;
            row.circle = 2;
            row.centre = BallId::new(ball).unwrap();
        }
        plan.header.moves.extend(again.header.moves);
        for mut pass in again.header.passes {
            pass.circle = 2;
            pass.end += shift;
            plan.header.passes.push(pass);
        }
        plan
    }

    #[test]
    fn a_pass_is_one_stop() {
        let plan = plan_of_passes();
        let schedule = Schedule::of(&plan, ALARM_SHARE);
        let [out, back] = plan.header.passes[..] else { panic!("there are two passes") };
        assert_eq!((schedule.poses(), schedule.taken_off.as_slice()), (Some(2), [2].as_slice()));
        let next = |dwells| schedule.next(dwells).map(|pose| (pose.index, pose.circle, pose.angle_deg));
        let expected = [Some((out.end, 1, None)), Some((back.end, 1, None)), None];
        assert_eq!([next(0), next(1), next(2)], expected);
        let telegram = |index| Telegram {
            run: run_number(&plan.header.hash).unwrap(),
            index,
            phase: 2,
            axes_deg: [0.0; 6],
        };
        let mismatch = |index| schedule.mismatch(&telegram(index));
        assert_eq!([out.end, back.end].map(mismatch), [None, None]);
        assert_eq!([out.points[0], back.points[1]].map(mismatch), [Some(TelegramMismatch::NoDwell); 2]);
        assert_eq!([out.end, back.end].map(|index| schedule.is_last(index)), [false, true]);
    }

    /// What is left after a pass is the time of the rows after its end: after the last pass only the end mark.
    #[test]
    fn time_is_left_until_the_last_pass() {
        let plan = plan_of_passes();
        let schedule = Schedule::of(&plan, ALARM_SHARE);
        let after = |end: u32| plan.row_times_s().skip(end as usize).sum::<f64>();
        for (dwells, end) in [(0, 0), (1, plan.header.passes[0].end), (2, plan.header.passes[1].end)] {
            let left_s = schedule.left_s(dwells).unwrap();
            assert!((left_s - after(end)).abs() < 1e-6, "{left_s} {}", after(end));
        }
        assert!(schedule.left_s(1).unwrap() > plan.header.passes[1].duration_s);
        assert!(schedule.left_s(2).unwrap() < plan.header.passes[1].duration_s);
    }

    /// Poses that were chosen are on no circle, whatever module drives to them.
    #[test]
    fn a_chosen_pose_is_on_no_circle() {
        let text = "robot = \"kr60ha\"\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = 300.0\nlength_u_mm = 0.002\n\
                    stroke_mm = [-8.0, 8.0]\n[[centre]]\nid = 1\nxyz_mm = [1300.0, 0.0, 800.0]\n\
                    [optimise]\npoints = 12\ncandidates = 200\n";
        let robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        let plan = Plan::build(&Job::from_toml("job.toml", text).unwrap(), &robot);
        let schedule = Schedule::of(&plan.unwrap_or_else(|refused| panic!("{refused}")), ALARM_SHARE);
        assert!(schedule.poses() > Some(11));
        for dwell in 1..=12 {
            let point = schedule.point(dwell, 0.2);
            assert_eq!((point.circle, point.angle_deg), (Some(0), None));
            assert!(point.deviation_mm.is_some());
        }
    }

    /// The mean of a circle of readings is no length of a pose.
    #[test]
    fn a_pass_has_no_deviation() {
        let plan = plan_of_passes();
        let schedule = Schedule::of(&plan, ALARM_SHARE);
        for (dwell, pass) in (1..).zip(&plan.header.passes) {
            let point = schedule.point(dwell, 0.2);
            let shown = (point.index, point.circle, point.angle_deg, point.clockwise, point.deviation_mm);
            assert_eq!(shown, (Some(pass.end), Some(1), None, pass.clockwise, None));
            assert_eq!(point.reading_mm, 0.2);
        }
    }

    /// Readings in the middle of the stroke and beyond it, with the bar mounted at first. Between two circles about one ball
    /// it stays on; before another ball it is taken off.
    #[test]
    fn bar_is_over_its_stroke_in_every_pass() {
        for (ball, taken_off, between) in [(1, vec![4], Some(Alarm::Over)), (2, vec![2, 4], None)] {
            let schedule = Schedule::of(&plan_of_two_circles(ball), ALARM_SHARE);
            assert_eq!(schedule.taken_off, taken_off);
            let mut mount = MountDetector::default();
            for (t_s, reading_mm, dwells, alarm) in [
                (0.0, 0.0, 0, Some(Alarm::None)),
                (2.0, 0.0, 0, Some(Alarm::None)),
                (3.0, 7.0, 0, Some(Alarm::Over)), // in the first pass
                (4.0, 0.0, 1, Some(Alarm::None)),
                (5.0, 7.0, 1, Some(Alarm::Over)),
                (6.0, 0.0, 2, Some(Alarm::None)),
                (7.0, 7.0, 2, between),
                (8.0, 0.0, 2, Some(Alarm::None)),
                (10.0, 0.0, 2, Some(Alarm::None)),
                (11.0, 7.0, 2, Some(Alarm::Over)), // in the first pass of the second circle
                (12.0, 0.0, 3, Some(Alarm::None)),
                (13.0, 7.0, 3, Some(Alarm::Over)),
                (14.0, 0.0, 4, Some(Alarm::None)),
                (15.0, 7.0, 4, None), // taken off at the end
            ] {
                let now = MountReading { t_s, reading_mm, valid: true, dwells };
                assert_eq!(mount.alarm(&schedule, now), alarm, "ball {ball} at {t_s} s");
            }
        }
    }
}
