//! How a run looks on a terminal: length against stroke, poses, gaps.

use std::path::Path;

use crate::daemon::{ALARM_SHARE, Course, Progress, Watch};
use crate::files;
use crate::live::Alarm;
use crate::plan::Plan;

/// Width of the gauge in characters.
const WIDTH: usize = 41;

/// What the plan says about the run; nothing where it cannot be read, which is told elsewhere.
pub(super) fn course(plan: Option<&Path>) -> Course {
    let read = |csv: &Path| {
        let json = csv.with_extension("json");
        let (rows, header) = (files::read(csv).ok()?, files::read(&json).ok()?);
        Plan::from_files("plan.csv", &rows, "plan.json", &header).ok()
    };
    let plan = plan.and_then(read);
    plan.map_or_else(Course::default, |plan| Course::of(&plan, ALARM_SHARE))
}

/// The reading against the stroke, and below it poses, rate and losses; `bar` has seen what was shown before.
pub(super) fn lines(progress: &Progress, course: &Course, bar: &mut Watch) -> String {
    let Some(reading_mm) = progress.reading_mm.filter(|_| !progress.gone) else {
        return super::status(progress);
    };
    let poses = match course.poses() {
        Some(poses) => format!("{} of {poses} poses", progress.dwells),
        None => format!("{} dwells", progress.dwells),
    };
    let (elapsed_s, rate_hz) = (progress.elapsed_s, progress.rate_hz);
    let below = format!("  {elapsed_s:.0} s, {poses}, {rate_hz:.0} Hz{}", super::losses(progress));
    let reading = format!("{reading_mm:+9.4} mm");
    let alarm = bar.alarm(course, progress.elapsed_s, reading_mm, progress.valid, progress.dwells);
    if alarm.is_none() {
        return format!("{reading}  no bar mounted: reading invalid\n{below}");
    }
    let Some([low, high]) = course.stroke_mm else { return format!("{reading}\n{below}") };
    let share = (reading_mm - low) / (high - low);
    // A share beyond the stroke stands at its end.
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
    let line = format!("{reading}  {low:+} [{gauge}] {high:+}  {:.0} % of the stroke", 100.0 * share);
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

    #[test]
    fn the_gauge_follows_the_reading() {
        let course = Course::bare(Some([-1.0, 1.0]), 0.9);
        let mut bar = Watch::default();
        let mut elapsed_s = 0.0;
        let mut at = |mm: f64| {
            elapsed_s += 1.0;
            let progress = Progress { reading_mm: Some(mm), valid: true, elapsed_s, ..Progress::default() };
            lines(&progress, &course, &mut bar)
        };
        assert!(at(-1.2).contains("no bar mounted: reading invalid"));
        assert!(at(0.0).contains("[--------------------#--------------------]"), "{}", at(0.0));
        assert!(at(0.0).contains("50 % of the stroke"));
        assert!(at(-1.2).contains("[#---") && at(-1.2).contains("OVER THE STROKE"));
        assert!(at(0.95).contains("NEAR ITS END") && at(0.95).ends_with("\n  7 s, 0 dwells, 0 Hz"));
    }
}
