//! The HMM trellis over (dwell, pose): states, transitions, forward and backward sums at one override.

use std::cell::Cell;

use super::duration::{MISSED, SPURIOUS, StillInterval};
use super::evidence::{DwellEvidence, ExpectedLengths};
use super::program::{
    BROKEN, CommandedDwell, CommandedTimes, Densities, DwellInterval, ElapsedTime, MAX_LOG_DENSITY,
    ProgramPace,
};

/// Probability that an outage of the bar starts at a pose, and that it continues at the next. It is low, because a
/// pause of the operator must not pass for an outage.
const OUTAGE: f64 = 1e-6;
const OUTAGE_GOES_ON: f64 = 0.8;
/// Most spurious dwells in a row.
const SPURIOUS_RUN: usize = 8;
/// The same between two modules, where the operator handles the bar, and the most poses missed there.
const SPURIOUS_BY_HAND: usize = 60;
const LOST_BY_HAND: usize = 4;
/// Most missed poses in a row where time does not limit them.
const MISSED_RUN: usize = 60;
/// An interval may be shorter than commanded by this, s.
const EARLY_S: f64 = 1.5;
/// States worse than the best by more than this (natural logarithm) are pruned.
pub(super) const BEAM: f64 = 45.0;
/// Range of the override.
pub(super) const MIN_OVERRIDE: f64 = 0.27;
pub(super) const MAX_OVERRIDE: f64 = 1.03;
/// Standard deviation of the duration of a move, as a share of it.
pub(super) const SLACK: f64 = 0.01;
/// The same during the search; it contains the step of the grid.
pub(super) const SEARCH_SLACK: f64 = 0.03;
/// Least standard deviation of a start, s: waits and outputs of the controller jitter.
const MIN_TRELLIS_START_SD_S: f64 = 0.02;

/// Variance of the time between two starts with these standard deviations, s2.
pub(super) fn interval_variance_s2(start_sd_s: [f64; 2]) -> f64 {
    start_sd_s.iter().map(|sd_s| sd_s.max(MIN_TRELLIS_START_SD_S).powi(2)).sum()
}

/// The dwell belongs to the pose.
#[derive(Clone, Copy)]
struct TrellisState {
    dwell: usize,
    pose: usize,
}

/// Terms of a transition that depend on its origin only.
struct TransitionOrigin {
    from: TrellisState,
    pace: ProgramPace,
    next_module: usize,
    /// Odds that the next dwell is the rest of this one, and that this one ran into the next poses.
    split: f64,
    merged: f64,
}

/// Posterior of the states at one override, by pose, then dwell.
pub(super) struct TrellisPosterior {
    pub(super) stretch: f64,
    pub(super) evidence: f64,
    pub(super) posterior: Vec<f64>,
}

/// Logarithms of the forward sums, by dwell, then pose, and of the total.
struct ForwardSums {
    sums: Vec<f64>,
    best: Vec<f64>,
    evidence: f64,
}

/// Logarithms of the backward sums, and the override that fits the states best.
struct BackwardSums {
    sums: Vec<f64>,
    stretch: f64,
}

/// Everything that does not depend on the override.
pub(super) struct Trellis<'a> {
    program: CommandedTimes,
    poses: usize,
    dwells: &'a [DwellEvidence],
    /// Durations of the dwells, if all are known.
    spans: Option<Vec<StillInterval>>,
    /// Number of clock breaks up to each dwell.
    epochs: Vec<usize>,
    /// Log weight of each state by duration and length of the dwell, by dwell, then pose.
    emissions: Vec<f64>,
    most_emission: f64,
    /// The program may start at any time of the run, and any number of poses may be missing at both ends.
    log_prior: f64,
    /// Log weight of skipping 0, 1, .. poses.
    passed: Vec<f64>,
    /// For each pose the first pose of the next module, or the number of poses.
    next_modules: Vec<usize>,
}

impl<'a> Trellis<'a> {
    pub(super) fn new(
        poses: &[CommandedDwell],
        dwells: &'a [DwellEvidence],
        expected: Option<ExpectedLengths<'_>>,
    ) -> Self {
        let epochs = dwells
            .iter()
            .scan(0, |epoch, dwell| {
                *epoch += usize::from(dwell.after_break);
                Some(*epoch)
            })
            .collect();
        let begin_s = |dwell: Option<&DwellEvidence>| dwell.map_or(0.0, |dwell| dwell.start_s);
        let span_s = begin_s(dwells.last()) - begin_s(dwells.first());
        let span = |dwell: &DwellEvidence| Some(StillInterval::new(dwell.start_s, dwell.duration_s?));
        let spans: Option<Vec<StillInterval>> = dwells.iter().map(span).collect();
        let emissions = emissions(poses, dwells, spans.as_deref(), expected);
        let passed = (0..=MISSED_RUN as i32)
            .map(|poses| MISSED.powi(poses).max(OUTAGE * OUTAGE_GOES_ON.powi(poses)).ln())
            .collect();
        let next_modules = poses
            .chunk_by(|a, b| a.module == b.module)
            .scan(0, |first, module| {
                *first += module.len();
                Some(vec![*first; module.len()])
            })
            .flatten()
            .collect();
        Self {
            program: CommandedTimes::new(poses),
            poses: poses.len(),
            dwells,
            epochs,
            most_emission: emissions.iter().copied().fold(0.0, f64::max),
            emissions,
            log_prior: (span_s.max(1.0) * (poses.len() * poses.len()) as f64).ln(),
            passed,
            next_modules,
            spans,
        }
    }

    fn cell(&self, TrellisState { dwell, pose }: TrellisState) -> usize {
        dwell * self.poses + pose
    }

    fn departure(&self, from: TrellisState, pace: ProgramPace) -> TransitionOrigin {
        let next_module = self.next_modules[from.pose];
        let (split, merged) = (self.split(from), self.merged(from, next_module, pace));
        TransitionOrigin { from, pace, next_module, split, merged }
    }

    /// Calls `visit(state, log weight, interval)` for every possible successor, unless `worth(dwell, upper bound
    /// of the log weight)` prunes it.
    fn successors(
        &self,
        from: TrellisState,
        pace: ProgramPace,
        worth: impl Fn(usize, f64) -> bool,
        mut visit: impl FnMut(TrellisState, f64, &DwellInterval),
    ) {
        let departure = self.departure(from, pace);
        let next_module = departure.next_module;
        let by_hand = next_module < self.poses && from.pose + LOST_BY_HAND >= next_module - 1;
        let most = 1 + if by_hand { SPURIOUS_BY_HAND } else { SPURIOUS_RUN };
        let most_log = MAX_LOG_DENSITY + self.most_emission + (1.0 + departure.split + departure.merged).ln();
        for dwell in from.dwell + 1..self.dwells.len().min(from.dwell + 1 + most) {
            let elapsed = self.elapsed(from.dwell, dwell);
            let between = dwell - from.dwell - 1;
            let spurious = between as f64 * SPURIOUS.ln();
            let (first, end) = if between <= SPURIOUS_RUN {
                (from.pose + 1, from.pose + 1 + self.passed.len())
            } else {
                (next_module, next_module + 1 + LOST_BY_HAND)
            };
            for pose in first..self.poses.min(end) {
                let interval = self.program.interval(from.pose, pose, elapsed);
                if !elapsed.clock_broke && interval.residual_s(pace) < -EARLY_S {
                    break;
                }
                let skipped = spurious + self.passed[interval.passed.min(MISSED_RUN)];
                if !worth(dwell, skipped + most_log) {
                    continue;
                }
                let to = TrellisState { dwell, pose };
                let density = self.density(&departure, to, &interval);
                let weight = skipped + density.max(1e-300).ln() + self.emissions[self.cell(to)];
                visit(to, weight, &interval);
            }
        }
    }

    fn elapsed(&self, from: usize, to: usize) -> ElapsedTime {
        ElapsedTime {
            seen_s: self.dwells[to].start_s - self.dwells[from].start_s,
            variance_s2: interval_variance_s2([from, to].map(|at| self.dwells[at].start_sd_s)),
            clock_broke: self.epochs[to] != self.epochs[from],
        }
    }

    /// Density of the transition, 1/s.
    fn density(&self, departure: &TransitionOrigin, to: TrellisState, interval: &DwellInterval) -> f64 {
        let &TransitionOrigin { from, pace, split, merged, .. } = departure;
        // By the duration of the first: the rest of it comes next, or poses that it ran into.
        let lasting = 1.0
            + if to.dwell > from.dwell + 1 { split } else { 0.0 }
            + if interval.passed > 0 { merged } else { 0.0 };
        if interval.elapsed.clock_broke {
            return BROKEN * lasting;
        }
        let Densities { running, paused } = interval.densities(pace);
        running * lasting + paused * self.pause_evidence(departure, to.dwell, interval).unwrap_or(lasting)
    }

    /// Odds that the next dwell is the rest of this one against that it is spurious.
    fn split(&self, TrellisState { dwell, pose }: TrellisState) -> f64 {
        let Some(spans) = &self.spans else { return 0.0 };
        let (Some(here), Some(next)) = (spans.get(dwell), spans.get(dwell + 1)) else { return 0.0 };
        here.split(next, self.program.wait_s(pose))
    }

    /// Odds that this dwell ran into the next poses against that they were missed.
    fn merged(
        &self,
        TrellisState { dwell, pose }: TrellisState,
        next_module: usize,
        pace: ProgramPace,
    ) -> f64 {
        let Some(here) = self.spans.as_ref().and_then(|spans| spans.get(dwell)) else { return 0.0 };
        let ends_s = (pose + 1..next_module).map(|last| self.program.span_s(pose, last, pace));
        here.merged(self.program.wait_s(pose), ends_s)
    }

    /// Evidence for a pause that fills the interval, from the durations; `None` if they are unknown.
    fn pause_evidence(
        &self,
        departure: &TransitionOrigin,
        next_dwell: usize,
        interval: &DwellInterval,
    ) -> Option<f64> {
        let &TransitionOrigin { from, pace, .. } = departure;
        let spans = self.spans.as_ref().filter(|_| !interval.by_hand)?;
        let (here, between) = spans.get(from.dwell..next_dwell)?.split_first()?;
        let move_s = pace.stretch * interval.move_s;
        Some(here.paused(self.program.wait_s(from.pose), interval.residual_s(pace), move_s, between))
    }

    fn first(&self, state: TrellisState) -> f64 {
        state.dwell as f64 * SPURIOUS.ln() - self.log_prior + self.emissions[self.cell(state)]
    }

    fn last(&self, state: TrellisState) -> f64 {
        (self.dwells.len() - 1 - state.dwell) as f64 * SPURIOUS.ln() + self.split(state).ln_1p()
    }

    /// Logarithm of the probability of all dwells at this pace.
    pub(super) fn evidence(&self, pace: ProgramPace, beam: f64) -> f64 {
        self.forward(pace, beam).evidence
    }

    fn forward(&self, pace: ProgramPace, beam: f64) -> ForwardSums {
        let states = (0..self.dwells.len())
            .flat_map(|dwell| (0..self.poses).map(move |pose| TrellisState { dwell, pose }));
        let mut sums: Vec<f64> = states.map(|state| self.first(state)).collect();
        let most = |row: &[f64]| row.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let mut best: Vec<f64> = sums.chunks(self.poses).map(most).collect();
        // The hypothesis that no dwell belongs to the program.
        let mut evidence = self.dwells.len() as f64 * SPURIOUS.ln();
        for dwell in 0..self.dwells.len() {
            let best = Cell::from_mut(&mut best[..]).as_slice_of_cells();
            for pose in 0..self.poses {
                let state = TrellisState { dwell, pose };
                let from = sums[self.cell(state)];
                if from < best[dwell].get() - beam {
                    continue;
                }
                evidence = log_sum(evidence, from + self.last(state));
                let worth = |next: usize, most: f64| from + most >= best[next].get() - beam;
                self.successors(state, pace, worth, |to, weight, _| {
                    let sum = &mut sums[self.cell(to)];
                    *sum = log_sum(*sum, from + weight);
                    best[to.dwell].set(best[to.dwell].get().max(*sum));
                });
            }
        }
        ForwardSums { sums, best, evidence }
    }

    /// Also fits the override: least squares of observed over commanded move times, weighted with the posteriors.
    fn backward(&self, forward: &ForwardSums, pace: ProgramPace) -> BackwardSums {
        let mut sums = vec![f64::NEG_INFINITY; forward.sums.len()];
        let (mut products, mut squares) = (0.0, 0.0);
        for dwell in (0..self.dwells.len()).rev() {
            for pose in 0..self.poses {
                let state = TrellisState { dwell, pose };
                let from = forward.sums[self.cell(state)];
                if from < forward.best[dwell] - BEAM {
                    continue;
                }
                let worth = |next: usize, most: f64| from + most >= forward.best[next] - BEAM;
                let mut sum = self.last(state);
                self.successors(state, pace, worth, |to, weight, interval| {
                    let onward = weight + sums[self.cell(to)];
                    sum = log_sum(sum, onward);
                    let log_posterior = from + onward - forward.evidence;
                    let sigma_s = interval.sigma_s(pace);
                    let far = interval.residual_s(pace).abs() > 4.0 * sigma_s;
                    if log_posterior < -BEAM || interval.elapsed.clock_broke || far {
                        return;
                    }
                    let weight = log_posterior.exp() / (sigma_s * sigma_s);
                    products += weight * interval.move_s * (interval.elapsed.seen_s - interval.wait_s);
                    squares += weight * interval.move_s * interval.move_s;
                });
                sums[self.cell(state)] = sum;
            }
        }
        let stretch = if squares > 0.0 {
            (products / squares).clamp(1.0 / MAX_OVERRIDE, 1.0 / MIN_OVERRIDE)
        } else {
            pace.stretch
        };
        BackwardSums { sums, stretch }
    }

    /// Refines the override from `stretch` and gives the posterior there.
    pub(super) fn answer(&self, stretch: f64) -> TrellisPosterior {
        const ROUNDS: usize = 5;
        // The grid may be several narrow standard deviations off, where nothing would pull the override closer.
        let mut pace = ProgramPace { stretch, slack: SEARCH_SLACK };
        let mut round = 1;
        loop {
            let forward = self.forward(pace, BEAM);
            let backward = self.backward(&forward, pace);
            let settled = (backward.stretch / pace.stretch - 1.0).abs() < 1e-4 && pace.slack == SLACK;
            if round == ROUNDS || settled {
                let posterior = (0..self.poses)
                    .flat_map(|pose| (0..self.dwells.len()).map(move |dwell| TrellisState { dwell, pose }))
                    .map(|state| self.cell(state))
                    .map(|cell| (forward.sums[cell] + backward.sums[cell] - forward.evidence).exp())
                    .collect();
                return TrellisPosterior { stretch: pace.stretch, evidence: forward.evidence, posterior };
            }
            pace = ProgramPace { stretch: backward.stretch, slack: SLACK };
            round += 1;
        }
    }
}

/// Log weights of the states by duration and length of the dwells, by dwell, then pose.
fn emissions(
    poses: &[CommandedDwell],
    dwells: &[DwellEvidence],
    spans: Option<&[StillInterval]>,
    expected: Option<ExpectedLengths<'_>>,
) -> Vec<f64> {
    let expected = expected.filter(|expected| expected.length_mm.len() == poses.len());
    let mut weights = Vec::with_capacity(poses.len() * dwells.len());
    for (at, dwell) in dwells.iter().enumerate() {
        let span = spans.and_then(|spans| spans.get(at));
        weights.extend(poses.iter().enumerate().map(|(pose, commanded)| {
            let duration = span.map_or(0.0, |span| span.dwell(commanded.wait_s).ln());
            let length = expected.map_or(0.0, |expected| {
                length_weight(dwell.length_mm - expected.length_mm[pose], expected.sigma_mm)
            });
            duration + length
        }));
    }
    weights
}

/// Log ratio of the density of a length at its pose to that of a length anywhere in the stroke.
fn length_weight(difference_mm: f64, sigma_mm: f64) -> f64 {
    const STROKE_MM: f64 = 2.0;
    const BAD: f64 = 0.02;
    let sigma_mm = sigma_mm.max(1e-6);
    let standard = difference_mm / sigma_mm;
    let normal = (-0.5 * standard * standard).exp() / (sigma_mm * std::f64::consts::TAU.sqrt());
    ((1.0 - BAD) * normal * STROKE_MM + BAD).ln()
}

/// `ln(exp(a) + exp(b))`.
fn log_sum(a: f64, b: f64) -> f64 {
    let (low, high) = if a < b { (a, b) } else { (b, a) };
    if high - low > 40.0 || low == f64::NEG_INFINITY { high } else { high + (low - high).exp().ln_1p() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn poses() -> Vec<CommandedDwell> {
        let moves = [0.0, 1.1, 2.3, 1.7, 0.9];
        moves.into_iter().map(|move_s| CommandedDwell { move_s, wait_s: 1.0, module: 0 }).collect()
    }

    /// The dwells of a program driven as planned, without the missed ones.
    fn dwells(lost: &[usize]) -> Vec<DwellEvidence> {
        let mut start_s = 5.0;
        let mut dwells = Vec::new();
        for (at, pose) in poses().iter().enumerate() {
            start_s += pose.move_s + if at > 0 { 1.0 } else { 0.0 };
            if !lost.contains(&at) {
                let (start_sd_s, length_mm) = (0.02, 0.0);
                let (duration_s, after_break) = (None, false);
                dwells.push(DwellEvidence { start_s, start_sd_s, duration_s, length_mm, after_break });
            }
        }
        dwells
    }

    #[test]
    fn posterior_of_each_dwell_sums_to_at_most_one() {
        let (poses, dwells) = (poses(), dwells(&[2]));
        let answer = Trellis::new(&poses, &dwells, None).answer(1.0);
        for dwell in 0..dwells.len() {
            let sum: f64 = (0..poses.len()).map(|pose| answer.posterior[pose * dwells.len() + dwell]).sum();
            assert!(sum < 1.0 + 1e-9, "{sum}");
        }
        for (pose, dwell) in [(0, 0), (1, 1), (3, 2), (4, 3)] {
            assert!(answer.posterior[pose * dwells.len() + dwell] > 0.99, "{:?}", answer.posterior);
        }
    }

    #[test]
    fn evidence_is_largest_at_the_driven_override() {
        let (poses, dwells) = (poses(), dwells(&[]));
        let trellis = Trellis::new(&poses, &dwells, None);
        let evidence = |stretch: f64| trellis.evidence(ProgramPace { stretch, slack: SLACK }, BEAM);
        assert!(evidence(1.0) > evidence(1.2) && evidence(1.0) > evidence(1.5));
        // From values between two steps of the grid.
        for stretch in [0.953, 1.03, 1.049] {
            assert!((trellis.answer(stretch).stretch - 1.0).abs() < 0.001);
        }
    }

    #[test]
    fn log_sum_equals_the_log_of_the_sum() {
        assert!((log_sum(2f64.ln(), 3f64.ln()) - 5f64.ln()).abs() < 1e-15);
        assert_eq!(log_sum(f64::NEG_INFINITY, 1.0), 1.0);
    }
}
