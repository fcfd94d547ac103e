//! The likelihood of the duration of a still interval.
//!
//! A commanded dwell lasts as long as the program waits, unless it is split in two, merges with the next ones, or the
//! operator pauses in it. A pause leaves a still interval of its own duration. All these are weighed against a
//! spurious interval, which a fast robot leaves between moves.

/// Rate of spurious dwells, 1/s.
pub(super) const SPURIOUS: f64 = 0.02;
/// Probability that a commanded dwell is not detected.
pub(super) const MISSED: f64 = 0.08;

/// Standard deviation of the duration of a dwell of known cause, s.
const SIGMA_S: f64 = 0.2;
/// Shares of dwells that last as the program waits, that are split in two, and that merge with the next.
const TRUE_TO_PLAN: f64 = 0.85;
const SPLIT: f64 = 0.03;
const MERGED: f64 = 0.03;
/// Most poses that one dwell merges with.
const MAX_MERGED_POSES: usize = 4;
/// Longest gap in a split dwell, s.
const SPLIT_GAP_S: f64 = 0.5;
/// Probability that a pause shows as a still interval.
const PAUSE_SEEN: f64 = 0.9;
/// Limit of the evidence for a pause.
const MAX_PAUSE_EVIDENCE: f64 = 1e3;

/// A still interval: start, duration, and the density of this duration if it is spurious.
#[derive(Clone, Copy)]
pub(super) struct StillInterval {
    pub(super) start_s: f64,
    lasts_s: f64,
    spurious: f64,
}

impl StillInterval {
    pub(super) fn new(start_s: f64, lasts_s: f64) -> Self {
        Self { start_s, lasts_s, spurious: spurious(lasts_s) }
    }

    /// Likelihood ratio of a dwell of `wait_s` to a spurious interval.
    pub(super) fn dwell(&self, wait_s: f64) -> f64 {
        duration(self.lasts_s, wait_s) / self.spurious
    }

    /// Likelihood ratio of one split dwell of `wait_s` (this and `next`) to a dwell followed by a spurious interval.
    pub(super) fn split(&self, next: &Self, wait_s: f64) -> f64 {
        let gap_s = next.start_s - self.start_s - self.lasts_s;
        if self.lasts_s > wait_s || gap_s > SPLIT_GAP_S {
            return 0.0;
        }
        let whole_s = next.start_s + next.lasts_s - self.start_s;
        let split = SPLIT / (wait_s * SPLIT_GAP_S) * normal(whole_s - wait_s);
        if split > 0.0 { split / (SPURIOUS * next.spurious * duration(self.lasts_s, wait_s)) } else { 0.0 }
    }

    /// Likelihood ratio of a dwell of `wait_s` that merged with some of the next poses to one after which they
    /// were missed. `spans_s` are the times from its start to the end of each of them.
    pub(super) fn merged(&self, wait_s: f64, spans_s: impl Iterator<Item = f64>) -> f64 {
        if self.lasts_s < wait_s + SIGMA_S {
            return 0.0;
        }
        let mut ratio = 1.0;
        let merged: f64 = spans_s
            .take(MAX_MERGED_POSES)
            .map(|span_s| {
                ratio *= MERGED / MISSED;
                ratio * normal(self.lasts_s - span_s)
            })
            .sum();
        merged / duration(self.lasts_s, wait_s)
    }

    /// Likelihood ratio of a pause of `pause_s` after the start of this dwell of `wait_s` that left a trace here
    /// or in a span `between`, to a pause without a trace.
    pub(super) fn paused(&self, wait_s: f64, pause_s: f64, move_s: f64, between: &[Self]) -> f64 {
        let trace = |span: &Self| normal(span.lasts_s - pause_s) / span.spurious;
        let between = between.iter().map(trace).sum::<f64>() / (SPURIOUS * move_s.max(1.0));
        let here = normal(self.lasts_s - wait_s - pause_s);
        let here = if here > 0.0 { here / duration(self.lasts_s, wait_s) } else { 0.0 };
        (1.0 - PAUSE_SEEN + 0.5 * PAUSE_SEEN * (between + here)).min(MAX_PAUSE_EVIDENCE)
    }
}

/// Density of the duration of a spurious interval, 1/s: about that of a move, or very long.
fn spurious(lasts_s: f64) -> f64 {
    const MIN_SPURIOUS_S: f64 = 0.5;
    const MEAN_S: f64 = 1.2;
    const LONG: f64 = 0.1;
    const LONG_S: f64 = 20.0;
    let short = (1.0 - LONG) / MEAN_S * (-(lasts_s - MIN_SPURIOUS_S).max(0.0) / MEAN_S).exp();
    short + LONG / LONG_S * (-lasts_s / LONG_S).exp().max(1e-6)
}

/// Density of the duration of a commanded dwell, 1/s, with all other causes.
fn duration(lasts_s: f64, wait_s: f64) -> f64 {
    const LONGER_S: f64 = 10.0;
    let longer_s = lasts_s - wait_s;
    let other = if longer_s < 0.0 {
        0.5 / wait_s.max(SIGMA_S)
    } else {
        0.5 / LONGER_S * (-longer_s / LONGER_S).exp().max(1e-6)
    };
    TRUE_TO_PLAN * normal(longer_s) + (1.0 - TRUE_TO_PLAN) * other
}

/// Density of the deviation of a duration, 1/s.
fn normal(deviation_s: f64) -> f64 {
    let standard = deviation_s / SIGMA_S;
    if standard.abs() > 6.0 {
        return 0.0;
    }
    (-0.5 * standard * standard).exp() / (SIGMA_S * std::f64::consts::TAU.sqrt())
}
