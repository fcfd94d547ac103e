//! Detects whether the bar is mounted. The readings of a bar that is not mounted are meaningless.

use super::schedule::Schedule;
use crate::live::Alarm;

/// Time in the stroke after which a bar is mounted, s: longer than hands hold the bar within its stroke while they
/// mount it.
const SETTLED_S: f64 = 1.0;

#[derive(Clone, Copy, Debug)]
pub struct MountReading {
    pub t_s: f64,
    pub reading_mm: f64,
    /// Whether the bar flags the reading as valid.
    pub valid: bool,
    /// Number of completed dwells.
    pub dwells: u32,
}

/// A bar is mounted once its readings were valid and inside the stroke for a second. It is taken off when the dwells
/// before a planned removal are complete and its reading leaves the stroke. Without a plan it stays mounted.
#[derive(Clone, Debug, Default)]
pub struct MountDetector {
    mounted: bool,
    /// Since when the readings are valid and inside the stroke, s.
    inside_since_s: Option<f64>,
    /// Planned removals so far.
    removals: usize,
    /// Completed dwells at the last planned removal, while the bar is still on.
    removal_due: Option<u32>,
}

impl MountDetector {
    /// The alarm of a mounted bar; `None` if no bar is mounted.
    pub fn alarm(&mut self, schedule: &Schedule, now: MountReading) -> Option<Alarm> {
        let MountReading { t_s, reading_mm, valid, dwells } = now;
        let alarm = schedule.alarm(reading_mm);
        let inside = valid && alarm != Alarm::Over;
        self.inside_since_s = inside.then(|| self.inside_since_s.unwrap_or(t_s));
        let removals = schedule.taken_off.iter().filter(|off| **off <= dwells).count();
        if removals != self.removals {
            self.removals = removals;
            self.removal_due = self.mounted.then_some(dwells);
            self.mounted = false;
        }
        match self.removal_due {
            // The bar was not taken off.
            Some(since) if inside && dwells > since => (self.removal_due, self.mounted) = (None, true),
            Some(_) if inside => {}
            Some(_) => self.removal_due = None,
            None => {
                let settled = self.inside_since_s.is_some_and(|since| t_s - since >= SETTLED_S);
                self.mounted |= settled && (removals == 0 || removals < schedule.taken_off.len());
            }
        }
        if self.mounted { Some(alarm) } else { inside.then_some(Alarm::None) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two base balls with three dwells each, from the bar's case and back.
    #[test]
    fn only_a_mounted_bar_raises_an_alarm() {
        let mut schedule = Schedule::bare(Some([-1.0, 1.0]), 0.9);
        schedule.taken_off = vec![3, 6];
        let mut detector = MountDetector::default();
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
            assert_eq!(
                detector.alarm(&schedule, MountReading { t_s, reading_mm, valid, dwells }),
                alarm,
                "at {t_s} s"
            );
        }
        // The bar is left on between two balls: the next dwell shows it.
        let mut detector = MountDetector::default();
        for (t_s, dwells) in [(0.0, 0), (1.0, 0), (3.0, 3), (4.0, 4)] {
            assert_eq!(
                detector.alarm(&schedule, MountReading { t_s, reading_mm: 0.0, valid: true, dwells }),
                fine
            );
        }
        assert_eq!(
            detector.alarm(&schedule, MountReading { t_s: 5.0, reading_mm: 1.0, valid: false, dwells: 4 }),
            over
        );
    }

    /// Readings of a bar in the middle of its stroke or at its end, at times in s.
    fn play(
        detector: &mut MountDetector,
        schedule: &Schedule,
        readings: &[(f64, f64, u32)],
    ) -> Option<Alarm> {
        let mut last = None;
        for &(t_s, reading_mm, dwells) in readings {
            last = detector.alarm(schedule, MountReading { t_s, reading_mm, valid: true, dwells });
        }
        last
    }

    #[test]
    fn bar_is_mounted_after_a_second_without_interruption() {
        let schedule = Schedule::bare(Some([-1.0, 3.0]), 0.9);
        for (readings, expected) in [
            (vec![(0.0, 0.0, 0), (0.99, 0.0, 0), (0.995, 3.0, 0)], None),
            (vec![(0.0, 0.0, 0), (1.0, 0.0, 0), (1.005, 3.0, 0)], Some(Alarm::Over)),
            // Interrupted: the second in the stroke begins again.
            (vec![(0.0, 0.0, 0), (0.6, 3.0, 0), (0.7, 0.0, 0), (1.6, 0.0, 0), (1.65, 3.0, 0)], None),
            (vec![(0.0, 0.0, 0), (1.0, 0.0, 0), (1.5, 2.9, 0)], Some(Alarm::Near)),
        ] {
            assert_eq!(play(&mut MountDetector::default(), &schedule, &readings), expected, "{readings:?}");
        }
    }
}
