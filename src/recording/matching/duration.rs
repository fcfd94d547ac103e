//! What the duration of a still interval says about it.
//!
//! A commanded dwell lasts as long as the program waits, unless it is torn in two, runs together with
//! the next ones, or the operator pauses in it. A pause leaves a still interval as long as itself. All that is
//! weighed against a spurious one, as a fast robot leaves some between its moves.

/// Density of spurious dwells, 1/s.
pub(super) const SPURIOUS: f64 = 0.02;
/// Probability that a commanded dwell is not detected.
pub(super) const MISSED: f64 = 0.08;

/// Standard deviation of a dwell's duration where its cause is known, s.
const SIGMA_S: f64 = 0.2;
/// Share of the dwells that last as the program waits, are torn in two, and run together with the next.
const TRUE_TO_PLAN: f64 = 0.85;
const TORN: f64 = 0.03;
const MERGED: f64 = 0.03;
/// Most poses that one dwell runs over.
const MOST_MERGED: usize = 4;
/// What tears a dwell in two is no longer, s.
const TEAR_S: f64 = 0.5;
/// Probability that a pause shows as a still interval.
const PAUSE_SEEN: f64 = 0.9;
/// No evidence for a pause counts for more than this.
const MOST_EVIDENCE: f64 = 1e3;

/// A still interval: its begin, its duration, and the density of that if it is spurious.
#[derive(Clone, Copy)]
pub(super) struct Span {
    pub(super) start_s: f64,
    lasts_s: f64,
    spurious: f64,
}

impl Span {
    pub(super) fn new(start_s: f64, lasts_s: f64) -> Self {
        Self { start_s, lasts_s, spurious: spurious(lasts_s) }
    }

    /// Ratio of densities: that this is a dwell of `wait_s`, and that it is spurious.
    pub(super) fn dwell(&self, wait_s: f64) -> f64 {
        duration(self.lasts_s, wait_s) / self.spurious
    }

    /// Ratio of densities: that this and the `next` are one dwell of `wait_s`, torn, and that it is a dwell
    /// and the next is spurious.
    pub(super) fn torn(&self, next: &Self, wait_s: f64) -> f64 {
        let gap_s = next.start_s - self.start_s - self.lasts_s;
        if self.lasts_s > wait_s || gap_s > TEAR_S {
            return 0.0;
        }
        let whole_s = next.start_s + next.lasts_s - self.start_s;
        let torn = TORN / (wait_s * TEAR_S) * normal(whole_s - wait_s);
        if torn > 0.0 { torn / (SPURIOUS * next.spurious * duration(self.lasts_s, wait_s)) } else { 0.0 }
    }

    /// Ratio of probabilities: that this dwell of `wait_s` ran together with some of the next poses, and that
    /// it did not and those were missed. `spans_s` are the times from its begin to each of their ends.
    pub(super) fn merged(&self, wait_s: f64, spans_s: impl Iterator<Item = f64>) -> f64 {
        if self.lasts_s < wait_s + SIGMA_S {
            return 0.0;
        }
        let mut ratio = 1.0;
        let merged: f64 = spans_s
            .take(MOST_MERGED)
            .map(|span_s| {
                ratio *= MERGED / MISSED;
                ratio * normal(self.lasts_s - span_s)
            })
            .sum();
        merged / duration(self.lasts_s, wait_s)
    }

    /// Ratio of probabilities: that the program paused for `pause_s` after the begin of this dwell of `wait_s`
    /// and that left its trace here or in a span `between`, and that it paused and nothing need show it.
    pub(super) fn paused(&self, wait_s: f64, pause_s: f64, move_s: f64, between: &[Self]) -> f64 {
        let trace = |span: &Self| normal(span.lasts_s - pause_s) / span.spurious;
        let between = between.iter().map(trace).sum::<f64>() / (SPURIOUS * move_s.max(1.0));
        let here = normal(self.lasts_s - wait_s - pause_s);
        let here = if here > 0.0 { here / duration(self.lasts_s, wait_s) } else { 0.0 };
        (1.0 - PAUSE_SEEN + 0.5 * PAUSE_SEEN * (between + here)).min(MOST_EVIDENCE)
    }
}

/// Density of a spurious interval's duration, 1/s: about as long as a move, or very long.
fn spurious(lasts_s: f64) -> f64 {
    const LEAST_S: f64 = 0.5;
    const MEAN_S: f64 = 1.2;
    const LONG: f64 = 0.1;
    const LONG_S: f64 = 20.0;
    let short = (1.0 - LONG) / MEAN_S * (-(lasts_s - LEAST_S).max(0.0) / MEAN_S).exp();
    short + LONG / LONG_S * (-lasts_s / LONG_S).exp().max(1e-6)
}

/// Density of a commanded dwell's duration, 1/s, whatever else may have changed it.
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

/// Density of a duration's deviation from what was expected, 1/s.
fn normal(deviation_s: f64) -> f64 {
    let standard = deviation_s / SIGMA_S;
    if standard.abs() > 6.0 {
        return 0.0;
    }
    (-0.5 * standard * standard).exp() / (SIGMA_S * std::f64::consts::TAU.sqrt())
}
