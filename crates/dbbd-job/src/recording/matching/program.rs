//! The program as the alignment sees it: dwells with the moves before them, and the probability of a time between two
//! dwells.

use crate::plan::timing::SPREAD_S;
use crate::plan::{MODULE_DWELLS, Plan, PlanRow, PoseKind};

/// A commanded dwell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CommandedDwell {
    /// Duration of all moves since the dwell before, at full override, s.
    pub move_s: f64,
    /// Duration of the rest at this pose, s.
    pub wait_s: f64,
    /// Index of the program module; each is started by hand.
    pub module: usize,
}

/// The dwell rows of a plan and their timing, in order.
pub(super) struct DwellPoses<'a> {
    pub(super) rows: Vec<&'a PlanRow>,
    pub(super) commanded: Vec<CommandedDwell>,
    pub(super) program: CommandedTimes,
}

/// The program waits this long after a dwell, s.
pub(super) const AFTER_S: f64 = 0.1;

/// Whether the robot stops at a row to be measured.
pub(super) fn stops(row: &PlanRow) -> bool {
    row.kind != PoseKind::Transit && !row.is_passed()
}

impl<'a> DwellPoses<'a> {
    pub(super) fn of(plan: &'a Plan) -> Self {
        let settle_s = plan.header.job.motion.settle_s;
        let (mut rows, mut commanded) = (Vec::new(), Vec::new());
        let (mut move_s, mut module, mut dwells, mut circle) = (0.0, 0, 0, 0);
        for (at, row) in plan.rows.iter().enumerate() {
            move_s += plan.header.moves.get(at).map_or(0.0, |time| time.duration_s);
            // Rows of no circle (the start, the transit) belong to the running module.
            let next_circle = row.circle != 0 && circle != 0 && row.circle != circle;
            if row.circle != 0 {
                circle = row.circle;
            }
            if dwells > 0 && (next_circle || dwells == MODULE_DWELLS) {
                module += 1;
                dwells = 0;
            }
            if !stops(row) {
                continue;
            }
            dwells += 1;
            rows.push(row);
            commanded.push(CommandedDwell { move_s, wait_s: settle_s + row.dwell_s + AFTER_S, module });
            move_s = 0.0;
        }
        let program = CommandedTimes::new(&commanded);
        Self { rows, commanded, program }
    }
}

/// The commanded dwells as cumulative sums, so that any interval is a difference.
pub(super) struct CommandedTimes {
    pub(super) code: TimeCode,
    moves_s: Vec<f64>,
    waits_s: Vec<f64>,
    modules: Vec<usize>,
}

/// The time code that the program is assumed to have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TimeCode {
    /// The time code of the plan.
    Own,
    /// The time code of the plan except for some intervals, in which something else happened (a stop, another
    /// override).
    Mostly,
    /// The time code of another plan: the durations of the moves are those of this plan plus any change that a code can
    /// make.
    Other,
}

/// Standard deviation of the difference between two time codes in a move: each adds a time that is uniform within
/// [`SPREAD_S`].
const CODE_SD_S: f64 = SPREAD_S * 0.408_248_290_463_863; // 1 / sqrt(6)
/// Share of the intervals of [`TimeCode::Mostly`] that follow the code.
const CODED: f64 = 0.9;

impl TimeCode {
    /// Time by which an interval may be shorter than commanded, s.
    pub(super) fn early_s(self) -> f64 {
        match self {
            Self::Own => 1.5,
            Self::Mostly | Self::Other => SPREAD_S,
        }
    }

    /// Density of a duration that differs by `residual_s` from the duration that the plan commands, 1/s. `sigma_s` is
    /// the standard deviation of the duration, `code_sd_s` the standard deviation of the difference between two codes.
    fn density(self, residual_s: f64, sigma_s: f64, code_sd_s: f64) -> f64 {
        let other = || normal(residual_s, sigma_s.hypot(code_sd_s));
        match self {
            Self::Own => normal(residual_s, sigma_s),
            Self::Mostly => CODED * normal(residual_s, sigma_s) + (1.0 - CODED) * other(),
            Self::Other => other(),
        }
    }
}

/// Density of a normal distribution, cut off at nine standard deviations.
fn normal(residual: f64, sigma: f64) -> f64 {
    let standard = residual / sigma;
    if standard.abs() < 9.0 {
        (-0.5 * standard * standard).exp() / (sigma * std::f64::consts::TAU.sqrt())
    } else {
        0.0
    }
}

#[derive(Clone, Copy)]
pub(super) struct ProgramPace {
    /// Ratio of the duration of a move to the planned one: 1 / override.
    pub(super) stretch: f64,
    /// Standard deviation of a duration about the stretched one, as a share of it.
    pub(super) slack: f64,
}

/// Time between the starts of two detected dwells.
#[derive(Clone, Copy, Default)]
pub(super) struct ElapsedTime {
    pub(super) seen_s: f64,
    /// Variance due to the detection of both starts, s2.
    pub(super) variance_s2: f64,
    /// Whether the clock broke in the interval, so that `seen_s` is meaningless.
    pub(super) clock_broke: bool,
}

/// An interval between the starts of two dwells, commanded and observed.
#[derive(Clone, Copy)]
pub(super) struct DwellInterval {
    /// Duration of the moves at full override, s.
    pub(super) move_s: f64,
    pub(super) wait_s: f64,
    /// Number of poses that are skipped.
    pub(super) passed: usize,
    pub(super) code: TimeCode,
    /// Whether a module ends in the interval: the operator starts the next one.
    pub(super) by_hand: bool,
    pub(super) elapsed: ElapsedTime,
}

/// Share of the intervals in which the operator pauses, and the mean of the pauses, s.
const PAUSES: f64 = 0.01;
const PAUSE_S: f64 = 30.0;
/// Share of the starts that were detected badly, and their error, s.
const BAD: f64 = 0.02;
const BAD_S: f64 = 0.5;
/// Mean time until the operator starts the next module, s.
const BY_HAND_S: f64 = 90.0;
/// Flat density of an interval across a broken clock, 1/s.
pub(super) const BROKEN: f64 = 1.0 / 120.0;

/// Upper bound of the log density of an interval: slightly above the peak of a normal distribution of the least sigma
/// (two starts known to 20 ms).
pub(super) const MAX_LOG_DENSITY: f64 = 3.0;

/// Densities of an interval without and with a pause, 1/s.
#[derive(Clone, Copy)]
pub(super) struct Densities {
    pub(super) running: f64,
    pub(super) paused: f64,
}

impl CommandedTimes {
    pub(super) fn new(poses: &[CommandedDwell]) -> Self {
        let sums = |part: fn(&CommandedDwell) -> f64| {
            let add = |sum: &mut f64, pose| {
                *sum += part(pose);
                Some(*sum)
            };
            poses.iter().scan(0.0, add).collect()
        };
        Self {
            code: TimeCode::Own,
            moves_s: sums(|pose| pose.move_s),
            waits_s: sums(|pose| pose.wait_s),
            modules: poses.iter().map(|pose| pose.module).collect(),
        }
    }

    /// Duration of the rest at a pose, s.
    pub(super) fn wait_s(&self, pose: usize) -> f64 {
        self.waits_s[pose] - pose.checked_sub(1).map_or(0.0, |before| self.waits_s[before])
    }

    /// Time from the start of one pose's dwell to the end of another's, s.
    pub(super) fn span_s(&self, from: usize, to: usize, pace: ProgramPace) -> f64 {
        self.waits_s[to] - self.waits_s[from]
            + self.wait_s(from)
            + pace.stretch * (self.moves_s[to] - self.moves_s[from])
    }

    /// Time from the start of one pose's dwell to the start of another's, s.
    pub(super) fn takes_s(&self, from: usize, to: usize, pace: ProgramPace) -> f64 {
        // The residual of an interval that is observed as 0 is minus the commanded time.
        -self.interval(from, to, ElapsedTime::default()).residual_s(pace)
    }

    pub(super) fn interval(&self, from: usize, to: usize, elapsed: ElapsedTime) -> DwellInterval {
        // A wait comes before the moves that follow it: the waits from `from` up to the pose before `to` count.
        let wait = |at: usize| if at == 0 { 0.0 } else { self.waits_s[at - 1] };
        DwellInterval {
            move_s: self.moves_s[to] - self.moves_s[from],
            wait_s: wait(to) - wait(from),
            passed: to - from - 1,
            code: self.code,
            by_hand: self.modules[from] != self.modules[to],
            elapsed,
        }
    }
}

impl DwellInterval {
    /// Observed less commanded time, s.
    pub(super) fn residual_s(&self, pace: ProgramPace) -> f64 {
        self.elapsed.seen_s - self.wait_s - pace.stretch * self.move_s
    }

    /// Standard deviation of the residual without a pause, s.
    pub(super) fn sigma_s(&self, pace: ProgramPace) -> f64 {
        let steps = (self.passed + 1) as f64;
        (self.elapsed.variance_s2 + (pace.slack * pace.stretch * self.move_s).powi(2) / steps).sqrt()
    }

    /// Probability that the program did not pause.
    pub(super) fn unpaused(&self, pace: ProgramPace) -> f64 {
        let Densities { running, paused } = self.densities(pace);
        if self.elapsed.clock_broke || running <= 0.0 { 0.0 } else { running / (running + paused) }
    }

    pub(super) fn densities(&self, pace: ProgramPace) -> Densities {
        let residual_s = self.residual_s(pace);
        let sigma_s = self.sigma_s(pace);
        let steps = (self.passed + 1) as f64;
        let pauses = if self.by_hand { 0.95 } else { (PAUSES * steps).min(0.95) };
        let mut running = 0.0;
        if residual_s.abs() < 30.0 * BAD_S {
            running += BAD / (2.0 * BAD_S) * (-residual_s.abs() / BAD_S).exp();
        }
        let code_sd_s = pace.stretch * CODE_SD_S * steps.sqrt();
        running += (1.0 - pauses - BAD).max(0.01) * self.code.density(residual_s, sigma_s, code_sd_s);
        let paused = if residual_s <= 0.0 {
            0.0
        } else if self.by_hand {
            pauses / BY_HAND_S * (-residual_s / BY_HAND_S).exp()
        } else {
            // A gamma distribution of order two.
            let scale_s = 0.5 * PAUSE_S;
            pauses * residual_s / (scale_s * scale_s) * (-residual_s / scale_s).exp()
        };
        Densities { running, paused }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times() -> CommandedTimes {
        let pose = |(move_s, wait_s, module)| CommandedDwell { move_s, wait_s, module };
        CommandedTimes::new(&[(0.0, 0.5, 0), (1.0, 0.6, 0), (2.0, 0.7, 1)].map(pose))
    }

    fn near(value: f64, expected: f64) {
        assert!((value - expected).abs() <= 1e-9 * expected.abs(), "{value} {expected}");
    }

    #[test]
    fn interval_holds_the_waits_before_its_moves() {
        let interval = times().interval(0, 2, ElapsedTime::default());
        near(interval.move_s, 3.0);
        near(interval.wait_s, 1.1);
        assert_eq!((interval.passed, interval.by_hand), (1, true));
        let interval = times().interval(0, 1, ElapsedTime::default());
        near(interval.wait_s, 0.5);
        assert_eq!((interval.passed, interval.by_hand), (0, false));
    }

    /// At half speed the moves of 3 s take 6 s; waits do not change.
    #[test]
    fn moves_stretch_and_waits_do_not() {
        let pace = ProgramPace { stretch: 2.0, slack: 0.0 };
        near(times().takes_s(0, 2, pace), 7.1);
        near(times().span_s(0, 2, pace), 7.8);
        near(times().span_s(1, 2, pace), 5.3);
        near(times().wait_s(0), 0.5);
        near(times().wait_s(1), 0.6);
    }

    fn interval(seen_s: f64, by_hand: bool) -> DwellInterval {
        let elapsed = ElapsedTime { seen_s, variance_s2: 0.0008, clock_broke: false };
        DwellInterval { move_s: 5.0, wait_s: 4.0, passed: 1, code: TimeCode::Own, by_hand, elapsed }
    }

    const PACE: ProgramPace = ProgramPace { stretch: 1.2, slack: 0.01 };

    /// Values by the formulas in Python: 50 ms late of 6 s of moves in two steps.
    #[test]
    fn densities_of_an_interval() {
        let seen = interval(10.05, false);
        near(seen.residual_s(PACE), 0.05);
        near(seen.sigma_s(PACE), 0.050_990_195_135_927_85);
        let Densities { running, paused } = seen.densities(PACE);
        near(running, 4.662_171_492_505_352);
        assert!((paused - 4.429_654_293_575_723e-6).abs() < 1e-12);
        near(seen.unpaused(PACE), 0.999_999_049_854_057_3);
    }

    /// A pause of 12 s has the density of a gamma distribution of order two and mean 30 s.
    #[test]
    fn densities_of_a_pause() {
        near(interval(22.0, false).densities(PACE).paused, 0.000_479_284_228_391_703);
        near(interval(70.0, true).densities(PACE).paused, 0.005_419_402_923_121_805);
        assert_eq!(interval(9.9, false).densities(PACE).paused, 0.0);
        // 30 times half a second are too far for a start that was detected badly.
        assert_eq!(interval(25.01, false).densities(PACE).running, 0.0);
        assert!(interval(24.99, false).densities(PACE).running > 0.0);
    }

    /// Two codes add times that are uniform within 2.2 s: their difference is triangular with the variance 2.2^2 / 6.
    /// For two moves the variance is twice that, at a pace of 1.2 times 1.2^2. With the sigma of the interval: sqrt(2
    /// (1.2 * 0.898146)^2 + 0.05099^2).
    #[test]
    fn another_code_makes_any_duration_as_likely() {
        let density = |code: TimeCode, seen_s: f64| {
            DwellInterval { code, ..interval(seen_s, false) }.densities(PACE).running
        };
        let sd_s = (2.0 * (1.2 * 0.898_146_2_f64).powi(2) + 0.050_990_2_f64.powi(2)).sqrt();
        let bad = |late_s: f64| 0.02 * (-2.0 * late_s).exp();
        let normal = |late_s: f64, sd_s: f64| {
            0.96 / (sd_s * std::f64::consts::TAU.sqrt()) * (-0.5 * (late_s / sd_s).powi(2)).exp()
        };
        let close =
            |value: f64, expected: f64| assert!((value / expected - 1.0).abs() < 1e-5, "{value} {expected}");
        for late_s in [0.05, 1.3] {
            close(density(TimeCode::Other, 10.0 + late_s), normal(late_s, sd_s) + bad(late_s));
        }
        close(density(TimeCode::Own, 11.3), bad(1.3));
        close(density(TimeCode::Mostly, 11.3), 0.1 * normal(1.3, sd_s) + bad(1.3));
    }

    #[test]
    fn interval_across_a_broken_clock_shows_no_pace() {
        let mut broken = interval(10.0, false);
        broken.elapsed.clock_broke = true;
        assert_eq!(broken.unpaused(PACE), 0.0);
    }
}
