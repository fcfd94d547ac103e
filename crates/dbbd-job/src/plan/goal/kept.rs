//! How the error that drawn robots keep depends on the error of the search: a curve through the runs that were judged.

/// A run with one of the bars about one of the sets of balls.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct GoalRun {
    pub(super) bar: usize,
    pub(super) set: usize,
    /// Number of balls in the set.
    pub(super) balls: usize,
    pub(super) poses: usize,
}

/// The runs with one bar and one number of balls.
pub(super) type RunClass = (usize, usize);

impl GoalRun {
    /// Whether it has the bar and the balls of another run.
    pub(super) fn is_about(&self, other: &Self) -> bool {
        (self.bar, self.set) == (other.bar, other.set)
    }

    /// The smallest number of poses that are more than nearly as many.
    pub(super) fn with_more_poses(&self) -> usize {
        (self.poses as f64 * (1.0 + NEARLY)).floor() as usize + 1
    }

    pub(super) fn class(&self) -> RunClass {
        (self.bar, self.balls)
    }
}

/// A run with the root mean square of the position error by the search, and the error that drawn robots keep, mm.
#[derive(Clone, Copy, Debug)]
pub(super) struct JudgedRun {
    pub(super) run: GoalRun,
    pub(super) search_mm: f64,
    pub(super) kept_mm: f64,
}

/// The runs that were judged.
#[derive(Clone, Debug, Default)]
pub(super) struct KeptErrors(Vec<JudgedRun>);

/// A run with nearly as many poses as a judged one is judged by that.
const NEARLY: f64 = 0.1;
/// Beyond the judged runs both errors are taken as proportional.
const PROPORTIONAL: f64 = 1.0;

impl KeptErrors {
    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub(super) fn add(&mut self, judged: JudgedRun) {
        // A plan supersedes what was judged of the same run before.
        self.0.retain(|other| other.run != judged.run);
        self.0.push(judged);
    }

    /// Whether a run about the same balls with nearly as many poses was judged.
    pub(super) fn has(&self, run: &GoalRun) -> bool {
        let is_near = |judged: &JudgedRun| {
            judged.run.is_about(run)
                && judged.run.poses.abs_diff(run.poses) as f64 <= NEARLY * run.poses as f64
        };
        self.0.iter().any(is_near)
    }

    /// The error of the search that is wanted of a run so that robots keep `kept_mm`.
    pub(super) fn wanted_mm(&self, run: &GoalRun, kept_mm: f64) -> f64 {
        along(self.of(run).map(|judged| [judged.kept_mm, judged.search_mm]), kept_mm)
    }

    /// The error that robots keep after a run with this error of the search.
    pub(super) fn kept_mm(&self, run: &GoalRun, search_mm: f64) -> f64 {
        along(self.of(run).map(|judged| [judged.search_mm, judged.kept_mm]), search_mm)
    }

    /// The runs by which a run is judged: those about the same balls, else those of its class, else those with its bar, else all.
    fn of(&self, run: &GoalRun) -> impl Iterator<Item = &JudgedRun> {
        let likeness = |JudgedRun { run: other, .. }: &JudgedRun| {
            (other.is_about(run), other.class() == run.class(), other.bar == run.bar)
        };
        let best = self.0.iter().map(likeness).max();
        self.0.iter().filter(move |judged| Some(likeness(judged)) == best)
    }
}

/// The value at `x` of a curve through points that are straight in logarithms, and proportional beyond them; `x` without points.
fn along(points: impl Iterator<Item = [f64; 2]>, x: f64) -> f64 {
    let mut points: Vec<[f64; 2]> = points.map(|point| point.map(f64::ln)).collect();
    points.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let ln = x.ln();
    let through = |[x, y]: [f64; 2], slope: f64| (y + slope * (ln - x)).exp();
    let above = points.iter().position(|[at, _]| *at >= ln).unwrap_or(points.len());
    match (above.checked_sub(1).and_then(|below| points.get(below)), points.get(above)) {
        (Some(&[x0, y0]), Some([x1, y1])) => through([x0, y0], (y1 - y0) / (x1 - x0).max(f64::EPSILON)),
        (Some(end), None) | (None, Some(end)) => through(*end, PROPORTIONAL),
        (None, None) => x,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Between errors of 0.1 and 0.4 mm that keep 0.2 and 3.2 mm the kept error is 20 times the square of the other.
    #[test]
    fn curve_is_straight_in_logarithms_and_proportional_beyond() {
        let run = |bar, set, poses| GoalRun { bar, set, balls: 1 + set, poses };
        let mut judged = KeptErrors::default();
        assert_eq!(judged.kept_mm(&run(0, 0, 20), 0.3), 0.3);
        judged.add(JudgedRun { run: run(0, 0, 90), search_mm: 0.1, kept_mm: 0.2 });
        judged.add(JudgedRun { run: run(0, 0, 20), search_mm: 0.4, kept_mm: 3.2 });
        for (search_mm, kept_mm) in [(0.05, 0.1), (0.1, 0.2), (0.2, 0.8), (0.4, 3.2), (0.8, 6.4)] {
            assert!((judged.kept_mm(&run(0, 0, 50), search_mm) / kept_mm - 1.0).abs() < 1e-12, "{search_mm}");
            assert!((judged.wanted_mm(&run(0, 0, 50), kept_mm) / search_mm - 1.0).abs() < 1e-12, "{kept_mm}");
        }
        // Another set with this bar is judged alike, until it is judged itself; so is another bar.
        judged.add(JudgedRun { run: run(0, 1, 50), search_mm: 0.2, kept_mm: 0.3 });
        assert!((judged.kept_mm(&run(0, 1, 60), 0.1) - 0.15).abs() < 1e-12);
        assert!((judged.kept_mm(&run(1, 0, 60), 0.05) - 0.1).abs() < 1e-12);
        assert!(judged.has(&run(0, 1, 55)) && !judged.has(&run(0, 1, 57)) && !judged.has(&run(1, 1, 50)));
        // A run that falls short is followed by one of a tenth more poses.
        assert_eq!([12, 50, 200].map(|poses| run(0, 1, poses).with_more_poses()), [14, 56, 221]);
        // A plan of the same run replaces what was judged before.
        judged.add(JudgedRun { run: run(0, 1, 50), search_mm: 0.2, kept_mm: 0.4 });
        assert!((judged.kept_mm(&run(0, 1, 60), 0.1) - 0.2).abs() < 1e-12);
    }
}
