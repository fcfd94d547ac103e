//! The progress of a run on a terminal: length against stroke, poses, losses.

use crate::daemon::{MountDetector, MountReading, RunProgress, Schedule};
use crate::live::Alarm;

/// Width of the gauge in characters.
const WIDTH: usize = 41;

/// The reading against the stroke, and below it poses, rate and losses. `mount` must have seen all earlier readings.
pub(super) fn progress_lines(
    progress: &RunProgress,
    schedule: &Schedule,
    mount: &mut MountDetector,
) -> String {
    let Some(reading_mm) = progress.counts.reading_mm else { return super::status(progress) };
    if progress.counts.gone {
        // The last value is struck out: it is not that of the bar any more.
        let away = format!("\x1b[9m{reading_mm:+9.4} mm\x1b[0m\x1b[1;31m  THE BAR IS AWAY\x1b[0m");
        return format!("{away}\n  {}", super::status(progress));
    }
    let poses = match schedule.poses() {
        Some(poses) => format!("{} of {poses} poses", progress.counts.dwells),
        None => format!("{} dwells", progress.counts.dwells),
    };
    let (elapsed_s, rate_hz) = (progress.counts.elapsed_s, progress.counts.rate_hz);
    let below = format!("  {elapsed_s:.0} s, {poses}, {rate_hz:.0} Hz{}", super::losses(progress));
    let shown = format!("{reading_mm:+9.4} mm");
    let (valid, dwells) = (progress.valid, progress.counts.dwells);
    let alarm = mount.alarm(schedule, MountReading { t_s: elapsed_s, reading_mm, valid, dwells });
    if alarm.is_none() {
        return format!("{shown}  no bar mounted: reading invalid\n{below}");
    }
    let Some([low, high]) = schedule.stroke_mm else { return format!("{shown}\n{below}") };
    let share = (reading_mm - low) / (high - low);
    // A reading beyond the stroke is shown at its end.
    let at = (share * (WIDTH - 1) as f64).round().clamp(0.0, (WIDTH - 1) as f64) as usize;
    let gauge: String = (0..WIDTH)
        .map(|cell| {
            if cell == at {
                '#'
            } else if cell == WIDTH / 2 {
                '+'
            } else {
                '-'
            }
        })
        .collect();
    let line = format!("{shown}  {low:+} [{gauge}] {high:+}  {:.0} % of the stroke", 100.0 * share);
    let line = match alarm.unwrap_or_default() {
        Alarm::None => line,
        Alarm::Near => format!("\x1b[33m{line}  NEAR ITS END\x1b[0m"),
        Alarm::Over => format!("\x1b[1;31m{line}  OVER THE STROKE\x1b[0m"),
    };
    format!("{line}\n{below}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::live::RunCounts;

    #[test]
    fn gauge_shows_the_reading() {
        let schedule = Schedule::bare(Some([-1.0, 1.0]), 0.9);
        let mut mount = MountDetector::default();
        let mut elapsed_s = 0.0;
        let mut at = |mm: f64| {
            elapsed_s += 1.0;
            let counts = RunCounts { reading_mm: Some(mm), elapsed_s, ..RunCounts::default() };
            let progress = RunProgress { counts, valid: true, ..RunProgress::default() };
            progress_lines(&progress, &schedule, &mut mount)
        };
        assert!(at(-1.2).contains("no bar mounted: reading invalid"));
        assert!(at(0.0).contains("[--------------------#--------------------]"), "{}", at(0.0));
        assert!(at(0.0).contains("50 % of the stroke"));
        assert!(at(-1.2).contains("[#---") && at(-1.2).contains("OVER THE STROKE"));
        assert!(at(0.95).contains("NEAR ITS END") && at(0.95).ends_with("\n  7 s, 0 dwells, 0 Hz"));
    }

    #[test]
    fn the_last_reading_of_a_bar_that_is_away_is_struck_out() {
        let counts = RunCounts { reading_mm: Some(0.25), gone: true, ..RunCounts::default() };
        let progress = RunProgress { counts, valid: true, ..RunProgress::default() };
        let shown = progress_lines(&progress, &Schedule::default(), &mut MountDetector::default());
        assert!(
            shown.starts_with("\x1b[9m  +0.2500 mm\x1b[0m") && shown.contains("THE BAR IS AWAY"),
            "{shown}"
        );
    }
}
