//! The course of a run as its plan has it: the dwells to come, the stroke, and when the bar is on.

use crate::live::{Alarm, Point};
use crate::plan::{Kind, Motion, Plan};

/// Share of the stroke from its middle beyond which the alarm is raised.
pub const ALARM_SHARE: f64 = 0.9;

/// What a plan says about the dwells to come.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Course {
    /// Length of the bar at reading zero, mm.
    pub bar_length_mm: Option<f64>,
    /// Lowest and highest reading that the bar allows, mm.
    pub stroke_mm: Option<[f64; 2]>,
    /// Share of the stroke from its middle beyond which the alarm is raised.
    pub alarm_share: f64,
    dwells: Vec<Expected>,
    /// How many dwells are over when the bar is taken off, each time.
    taken_off: Vec<u32>,
}

/// A dwell of the plan.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Expected {
    index: u32,
    circle: u32,
    angle_deg: Option<f64>,
    clockwise: bool,
    length_mm: f64,
}

impl Course {
    /// Without a plan.
    pub fn bare(stroke_mm: Option<[f64; 2]>, alarm_share: f64) -> Self {
        Self { stroke_mm, alarm_share, ..Self::default() }
    }

    /// Of a plan.
    pub fn of(plan: &Plan, alarm_share: f64) -> Self {
        let places = plan.circle_places();
        let dwells = plan.rows.iter().zip(&places).filter(|(row, _)| row.kind != Kind::Transit);
        let dwells = dwells.map(|(row, place)| Expected {
            index: row.index,
            circle: row.circle,
            // A reference pose is no part of the circle's picture.
            angle_deg: place.filter(|_| row.kind == Kind::Measure).map(|place| place.angle_deg),
            clockwise: place.is_some_and(|place| place.clockwise),
            length_mm: row.length_mm,
        });
        // The bar is off on every PTP, and after the end.
        let off = plan.rows.iter().filter(|row| row.motion == Motion::Ptp).map(|row| row.index);
        let over = |index: u32| {
            plan.rows.iter().filter(|row| row.kind != Kind::Transit && row.index < index).count() as u32
        };
        let mut taken_off: Vec<u32> = off.chain([u32::MAX]).map(over).filter(|dwells| *dwells > 0).collect();
        taken_off.dedup();
        let bar = &plan.header.job.bar;
        Self {
            bar_length_mm: Some(bar.length_mm),
            stroke_mm: Some(bar.stroke_mm),
            alarm_share,
            dwells: dwells.collect(),
            taken_off,
        }
    }

    /// Dwells of the plan; none without a plan.
    pub fn poses(&self) -> Option<u32> {
        self.bar_length_mm.and_then(|_| u32::try_from(self.dwells.len()).ok())
    }

    /// How near a reading is to the end of the stroke.
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
        let expected = (dwell as usize).checked_sub(1).and_then(|at| self.dwells.get(at));
        Point {
            dwell,
            index: expected.map(|expected| expected.index),
            circle: expected.map(|expected| expected.circle),
            angle_deg: expected.and_then(|expected| expected.angle_deg),
            clockwise: expected.is_some_and(|expected| expected.clockwise),
            reading_mm,
            deviation_mm: expected
                .zip(self.bar_length_mm)
                .map(|(expected, length_mm)| length_mm + reading_mm - expected.length_mm),
        }
    }
}

/// Tells a bar between its balls from one that is not mounted yet, or no more: that one's reading means nothing.
///
/// It counts as mounted once its readings were valid and inside the stroke for a second, until the dwells that the plan
/// has before it is taken off are over and it reads something else. Without a plan it stays mounted.
#[derive(Clone, Debug, Default)]
pub struct Watch {
    mounted: bool,
    /// Since when it reads what a mounted bar may read, s.
    inside: Option<f64>,
    /// How often it was to be taken off, by the dwells; how many were over the last time, if it is still on.
    times: usize,
    leaving: Option<u32>,
}

/// Hands that mount a bar do not hold it still for so long, s.
const SETTLED_S: f64 = 1.0;

impl Watch {
    /// How near the reading (mm) at a time (s) is to the end of the stroke; `None` where no bar is mounted. `valid`: the
    /// bar vouches for it; `dwells` are over.
    pub fn alarm(
        &mut self,
        course: &Course,
        t_s: f64,
        reading_mm: f64,
        valid: bool,
        dwells: u32,
    ) -> Option<Alarm> {
        let alarm = course.alarm(reading_mm);
        let inside = valid && alarm != Alarm::Over;
        self.inside = inside.then(|| self.inside.unwrap_or(t_s));
        let times = course.taken_off.iter().filter(|off| **off <= dwells).count();
        if times != self.times {
            self.times = times;
            self.leaving = self.mounted.then_some(dwells);
            self.mounted = false;
        }
        match self.leaving {
            // It was on all the time.
            Some(since) if inside && dwells > since => (self.leaving, self.mounted) = (None, true),
            Some(_) if inside => {}
            Some(_) => self.leaving = None,
            None => {
                let settled = self.inside.is_some_and(|since| t_s - since >= SETTLED_S);
                self.mounted |= settled && (times == 0 || times < course.taken_off.len());
            }
        }
        if self.mounted { Some(alarm) } else { inside.then_some(Alarm::None) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_alarm_follows_the_stroke() {
        let course = Course::bare(Some([-1.0, 3.0]), 0.9);
        for (reading, alarm) in [
            (1.0, Alarm::None),
            (2.79, Alarm::None),
            (2.81, Alarm::Near),
            (-0.9, Alarm::Near),
            (3.0, Alarm::Over),
            (-1.01, Alarm::Over),
        ] {
            assert_eq!(course.alarm(reading), alarm, "{reading}");
        }
        assert_eq!(Course::bare(None, 0.9).alarm(1e9), Alarm::None);
    }

    /// Two balls with three dwells each: what the bar reads from its box to its box.
    #[test]
    fn only_a_mounted_bar_raises_the_alarm() {
        let course = Course { taken_off: vec![3, 6], ..Course::bare(Some([-1.0, 1.0]), 0.9) };
        let mut watch = Watch::default();
        let (off, fine, near, over) = (None, Some(Alarm::None), Some(Alarm::Near), Some(Alarm::Over));
        for (t_s, reading_mm, valid, dwells, alarm) in [
            (0.0, 1.0, false, 0, off),  // at its end stop
            (1.0, 1.0, true, 0, off),   // and of a kind that does not say so
            (2.0, 0.95, true, 0, fine), // in the hand
            (2.5, 0.2, true, 0, fine),
            (2.6, 1.0, false, 0, off),
            (3.0, 0.95, true, 0, fine),
            (4.0, 0.95, true, 0, near), // mounted, and badly
            (5.0, 0.95, true, 1, near),
            (5.1, 1.0, false, 1, over), // pulled out between the dwells
            (6.0, 0.2, true, 2, fine),
            (7.0, 0.2, true, 3, fine), // still on after the last dwell
            (7.1, 0.95, true, 3, fine),
            (7.2, 1.0, false, 3, off), // taken off
            (8.0, 0.1, true, 3, fine), // on the second ball
            (9.0, 0.1, true, 3, fine),
            (9.1, 1.0, false, 3, over),
            (10.0, 0.1, true, 6, fine),
            (11.0, 1.0, false, 6, off),
            (12.0, 0.3, true, 6, fine), // handled after the end
            (15.0, 0.3, true, 6, fine),
            (16.0, 1.0, false, 6, off),
        ] {
            assert_eq!(watch.alarm(&course, t_s, reading_mm, valid, dwells), alarm, "at {t_s} s");
        }
        // Left on between two balls: the next dwell tells.
        let mut watch = Watch::default();
        for (t_s, dwells) in [(0.0, 0), (1.0, 0), (3.0, 3), (4.0, 4)] {
            assert_eq!(watch.alarm(&course, t_s, 0.0, true, dwells), fine);
        }
        assert_eq!(watch.alarm(&course, 5.0, 1.0, false, 4), over);
    }
}
