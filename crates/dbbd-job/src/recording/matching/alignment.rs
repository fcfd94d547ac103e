//! Aligns detected dwells with commanded poses.
//!
//! A hidden Markov model over (pose, dwell): from one matched pair to the next, with missed poses and spurious
//! dwells between them. Its evidence is the INTERVALS between the starts of dwells, because absolute times drift
//! apart with every pause. Forward and backward sums give the posterior of each pair, and a pair is kept if it is
//! nearly certain. The best (Viterbi) path does not suffice: it exists even if nothing can be identified.
//!
//! A commanded dwell lasts as long as the program waits, unless it is split in two, merges with the next ones, or the
//! operator pauses in it. A pause leaves a still interval of its own duration. All these causes are weighed against a
//! spurious interval, which a fast robot leaves between moves.

use std::cell::Cell;

use super::program::{
    BROKEN, CommandedDwell, CommandedTimes, Densities, DwellInterval, ElapsedTime, MAX_LOG_DENSITY,
    ProgramPace, TimeCode,
};

/// Evidence of a detected dwell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DwellEvidence {
    /// Start, s of the stream.
    pub start_s: f64,
    /// Standard deviation of the start, s.
    pub start_sd_s: f64,
    /// Duration, s, if it is known.
    pub duration_s: Option<f64>,
    /// Reading plus length of the bar, mm.
    pub length_mm: f64,
    /// Whether the clock broke since the dwell before.
    pub after_break: bool,
}

/// Lengths that a model predicts for each pose.
#[derive(Clone, Copy, Debug)]
pub struct ExpectedLengths<'a> {
    pub length_mm: &'a [f64],
    /// Standard deviation of the predicted lengths, mm.
    pub sigma_mm: f64,
}

/// The pairing of a pose: the dwell (index from 0) and its posterior; for an ambiguous pose the most probable dwell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pairing {
    Dwell { dwell: usize, posterior: f64 },
    None { posterior: f64 },
    Ambiguous { dwell: usize, posterior: f64 },
}

#[derive(Clone, Debug, PartialEq)]
pub struct PoseAlignment {
    /// One pairing for each pose.
    pub pairings: Vec<Pairing>,
    /// Speed override of the moves, 0..1.
    pub override_factor: f64,
}

/// Least posterior of a pair that is kept.
pub(super) const MIN_PAIR_POSTERIOR: f64 = 0.99;
/// Least posterior for reporting that a pose has no dwell.
pub(super) const MIN_NONE_POSTERIOR: f64 = 0.9;
/// Beam while only the override is searched.
const SEARCH_BEAM: f64 = 10.0;
/// The override is searched in the middle of a long run: more dwells do not determine it better.
const SEARCH_DWELLS: usize = 160;
/// Ratio of neighbours on the grid of overrides.
const STEP: f64 = 1.1;

/// Aligns dwells with poses, both in order of time.
pub fn align(
    poses: &[CommandedDwell],
    dwells: &[DwellEvidence],
    expected: Option<ExpectedLengths<'_>>,
) -> PoseAlignment {
    let nothing =
        PoseAlignment { pairings: vec![Pairing::None { posterior: 1.0 }; poses.len()], override_factor: 1.0 };
    if poses.is_empty() || dwells.is_empty() {
        return nothing;
    }
    let trellis = Trellis::new(poses, dwells, expected);
    let starts = likely_stretches(poses, dwells, expected);
    let answers: Vec<TrellisPosterior> = starts.into_iter().map(|stretch| trellis.answer(stretch)).collect();
    let best = answers.iter().map(|answer| answer.evidence).fold(f64::NEG_INFINITY, f64::max);
    let Some(likeliest) = answers.iter().find(|answer| answer.evidence == best) else { return nothing };
    let total: f64 = answers.iter().map(|answer| (answer.evidence - best).exp()).sum();
    let mut posterior = vec![0.0; poses.len() * dwells.len()];
    for answer in &answers {
        let weight = (answer.evidence - best).exp() / total;
        for (sum, part) in posterior.iter_mut().zip(&answer.posterior) {
            *sum += weight * part;
        }
    }
    let pairings = posterior.chunks(dwells.len()).map(pairing).collect();
    PoseAlignment { pairings, override_factor: (1.0 / likeliest.stretch).min(1.0) }
}

/// Natural logarithm of the odds that the dwells are from a program with the time code of these poses, against a
/// program with another code. If the dwells are from another code, the odds are `n` or more with a probability of at
/// most `1 / n`.
pub(super) fn code_log_odds(poses: &[CommandedDwell], dwells: &[DwellEvidence]) -> f64 {
    if poses.is_empty() || dwells.is_empty() {
        return 0.0;
    }
    let [own, other] = [TimeCode::Mostly, TimeCode::Other].map(|code| {
        let mut trellis = Trellis::new(poses, middle(dwells), None);
        trellis.program.code = code;
        trellis.greatest_evidence()
    });
    own - other
}

/// The middle of a long run.
fn middle(dwells: &[DwellEvidence]) -> &[DwellEvidence] {
    let from = dwells.len().saturating_sub(SEARCH_DWELLS) / 2;
    &dwells[from..dwells.len().min(from + SEARCH_DWELLS)]
}

/// Ratios of the duration of a move to the planned duration, in steps that [`SEARCH_SLACK`] contains.
fn stretches() -> Vec<f64> {
    let steps = ((MAX_OVERRIDE / MIN_OVERRIDE).ln() / STEP.ln()).ceil() as i32;
    (0..=steps).map(|step| 1.0 / (MIN_OVERRIDE * STEP.powi(step))).collect()
}

/// Local maxima of the evidence over the override that are nearly as good as the best.
fn likely_stretches(
    poses: &[CommandedDwell],
    dwells: &[DwellEvidence],
    expected: Option<ExpectedLengths<'_>>,
) -> Vec<f64> {
    let search = Trellis::new(poses, middle(dwells), expected);
    let stretches = stretches();
    let pace = |stretch: &f64| ProgramPace { stretch: *stretch, slack: SEARCH_SLACK };
    let evidence: Vec<f64> =
        stretches.iter().map(|stretch| search.evidence(pace(stretch), SEARCH_BEAM)).collect();
    let best = evidence.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let is_peak = |at: usize| {
        let lower = |other: Option<usize>| {
            other.and_then(|at| evidence.get(at)).is_none_or(|next| *next <= evidence[at])
        };
        evidence[at] > best - BEAM && lower(at.checked_sub(1)) && lower(Some(at + 1))
    };
    (0..stretches.len()).filter(|at| is_peak(*at)).map(|at| stretches[at]).collect()
}

fn pairing(row: &[f64]) -> Pairing {
    let (dwell, posterior) = row
        .iter()
        .copied()
        .enumerate()
        .fold((0, 0.0), |best, next| if next.1 > best.1 { next } else { best });
    let none = (1.0 - row.iter().sum::<f64>()).clamp(0.0, 1.0);
    if posterior > MIN_PAIR_POSTERIOR {
        Pairing::Dwell { dwell, posterior }
    } else if none > MIN_NONE_POSTERIOR {
        Pairing::None { posterior: none }
    } else {
        Pairing::Ambiguous { dwell, posterior }
    }
}

/// Probability that an outage of the bar starts at a pose, and that it continues at the next. It is low, because a
/// pause of the operator must not pass for an outage.
const OUTAGE: f64 = 1e-6;
const OUTAGE_GOES_ON: f64 = 0.8;
/// Most spurious dwells in a row.
const SPURIOUS_RUN: usize = 8;
/// The same limit between two modules, where the operator handles the bar, and the most poses missed there.
const SPURIOUS_BY_HAND: usize = 60;
const LOST_BY_HAND: usize = 4;
/// Most missed poses in a row where time does not limit them.
const MISSED_RUN: usize = 60;
/// States worse than the best by more than this (natural logarithm) are pruned.
const BEAM: f64 = 45.0;
/// Range of the override.
const MIN_OVERRIDE: f64 = 0.27;
const MAX_OVERRIDE: f64 = 1.03;
/// Standard deviation of the duration of a move, as a share of the duration.
pub(super) const SLACK: f64 = 0.01;
/// The same during the search; it contains the step of the grid.
const SEARCH_SLACK: f64 = 0.03;
/// Least standard deviation of a start, s: waits and outputs of the controller jitter.
const MIN_TRELLIS_START_SD_S: f64 = 0.02;

/// Variance of the time between two starts with these standard deviations, s2.
pub(super) fn interval_variance_s2(start_sd_s: [f64; 2]) -> f64 {
    start_sd_s.iter().map(|sd_s| sd_s.max(MIN_TRELLIS_START_SD_S).powi(2)).sum()
}

/// State of the model: the dwell belongs to the pose.
#[derive(Clone, Copy)]
struct TrellisState {
    dwell: usize,
    pose: usize,
}

/// Terms of a transition that depend only on its origin.
struct TransitionOrigin {
    from: TrellisState,
    pace: ProgramPace,
    next_module: usize,
    /// Odds that the next dwell is the rest of this dwell, and odds that this dwell merged with the next poses.
    split: f64,
    merged: f64,
}

/// Posterior of the states at one override, by pose, then dwell.
struct TrellisPosterior {
    stretch: f64,
    evidence: f64,
    posterior: Vec<f64>,
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

/// The data of the model that do not depend on the override.
struct Trellis<'a> {
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
    /// Logarithm of the number of ways to begin and end: the program may start at any time of the run, and any number
    /// of poses may be missing at both ends.
    log_prior: f64,
    /// Log weight of skipping 0, 1, .. poses.
    passed: Vec<f64>,
    /// For each pose the first pose of the next module, or the number of poses.
    next_modules: Vec<usize>,
}

impl<'a> Trellis<'a> {
    fn new(
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
                if !elapsed.clock_broke && interval.residual_s(pace) < -self.program.code.early_s() {
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
        // By the duration of the first dwell: the rest of it comes next, or it merged with the poses between.
        let lasting = 1.0
            + if to.dwell > from.dwell + 1 { split } else { 0.0 }
            + if interval.passed > 0 { merged } else { 0.0 };
        if interval.elapsed.clock_broke {
            return BROKEN * lasting;
        }
        let Densities { running, paused } = interval.densities(pace);
        running * lasting + paused * self.pause_evidence(departure, to.dwell, interval).unwrap_or(lasting)
    }

    /// Odds that the next dwell is the rest of this dwell, against odds that the next dwell is spurious.
    fn split(&self, TrellisState { dwell, pose }: TrellisState) -> f64 {
        let Some(spans) = &self.spans else { return 0.0 };
        let (Some(here), Some(next)) = (spans.get(dwell), spans.get(dwell + 1)) else { return 0.0 };
        here.split(next, self.program.wait_s(pose))
    }

    /// Odds that this dwell merged with the next poses, against odds that these poses were missed.
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

    /// Evidence for a pause that fills the interval, from the durations of the dwells; `None` if they are unknown.
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
    fn evidence(&self, pace: ProgramPace, beam: f64) -> f64 {
        self.forward(pace, beam).evidence
    }

    /// The evidence at the override that explains the dwells best.
    fn greatest_evidence(&self) -> f64 {
        /// Steps between neighbours of the grid, which the narrow slack contains.
        const FINE: i32 = 6;
        let at = |stretch: f64, slack: f64, beam: f64| self.evidence(ProgramPace { stretch, slack }, beam);
        let coarse = stretches().into_iter().map(|stretch| (stretch, at(stretch, SEARCH_SLACK, SEARCH_BEAM)));
        let Some((best, _)) = coarse.max_by(|a, b| a.1.total_cmp(&b.1)) else { return f64::NEG_INFINITY };
        let fine = (-FINE..=FINE).map(|step| best * STEP.powf(f64::from(step) / f64::from(FINE)));
        fine.map(|stretch| at(stretch, SLACK, BEAM)).fold(f64::NEG_INFINITY, f64::max)
    }

    fn forward(&self, pace: ProgramPace, beam: f64) -> ForwardSums {
        let states = (0..self.dwells.len())
            .flat_map(|dwell| (0..self.poses).map(move |pose| TrellisState { dwell, pose }));
        let mut sums: Vec<f64> = states.map(|state| self.first(state)).collect();
        let most = |row: &[f64]| row.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let mut best: Vec<f64> = sums.chunks(self.poses).map(most).collect();
        // Evidence of the hypothesis that no dwell belongs to the program.
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

    /// The backward sums. Also fits the override: least squares of observed over commanded move times, weighted with
    /// the posteriors.
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

    /// Refines the override from `stretch`, and returns the posterior at the refined override.
    fn answer(&self, stretch: f64) -> TrellisPosterior {
        const ROUNDS: usize = 5;
        // The grid may be several narrow standard deviations off: there, nothing would pull the override closer.
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

/// Logarithm of the ratio of two densities of a length: at its pose, and anywhere in the stroke.
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

/// Rate of spurious dwells, 1/s.
const SPURIOUS: f64 = 0.02;
/// Probability that a commanded dwell is not detected.
const MISSED: f64 = 0.08;

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
struct StillInterval {
    start_s: f64,
    lasts_s: f64,
    spurious: f64,
}

impl StillInterval {
    fn new(start_s: f64, lasts_s: f64) -> Self {
        Self { start_s, lasts_s, spurious: spurious(lasts_s) }
    }

    /// Likelihood ratio of a dwell of `wait_s` to a spurious interval.
    fn dwell(&self, wait_s: f64) -> f64 {
        duration(self.lasts_s, wait_s) / self.spurious
    }

    /// Likelihood ratio of one dwell of `wait_s` that is split into this interval and `next`, to a dwell followed by a
    /// spurious interval.
    fn split(&self, next: &Self, wait_s: f64) -> f64 {
        let gap_s = next.start_s - self.start_s - self.lasts_s;
        if self.lasts_s > wait_s || gap_s > SPLIT_GAP_S {
            return 0.0;
        }
        let whole_s = next.start_s + next.lasts_s - self.start_s;
        let split = SPLIT / (wait_s * SPLIT_GAP_S) * normal(whole_s - wait_s);
        if split > 0.0 { split / (SPURIOUS * next.spurious * duration(self.lasts_s, wait_s)) } else { 0.0 }
    }

    /// Likelihood ratio of a dwell of `wait_s` that merged with some of the next poses, to a dwell after which these
    /// poses were missed. `spans_s` are the times from the start of the dwell to the end of each of these poses.
    fn merged(&self, wait_s: f64, spans_s: impl Iterator<Item = f64>) -> f64 {
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

    /// Likelihood ratio of a pause of `pause_s` that leaves a trace, to a pause without a trace. The pause comes after
    /// the start of this dwell of `wait_s`; the trace is in this interval or in an interval `between`.
    fn paused(&self, wait_s: f64, pause_s: f64, move_s: f64, between: &[Self]) -> f64 {
        let trace = |span: &Self| normal(span.lasts_s - pause_s) / span.spurious;
        let between = between.iter().map(trace).sum::<f64>() / (SPURIOUS * move_s.max(1.0));
        let here = normal(self.lasts_s - wait_s - pause_s);
        let here = if here > 0.0 { here / duration(self.lasts_s, wait_s) } else { 0.0 };
        (1.0 - PAUSE_SEEN + 0.5 * PAUSE_SEEN * (between + here)).min(MAX_PAUSE_EVIDENCE)
    }
}

/// Density of the duration of a spurious interval, 1/s: about as long as a move, or very long.
fn spurious(lasts_s: f64) -> f64 {
    const MIN_SPURIOUS_S: f64 = 0.5;
    const MEAN_S: f64 = 1.2;
    const LONG: f64 = 0.1;
    const LONG_S: f64 = 20.0;
    let short = (1.0 - LONG) / MEAN_S * (-(lasts_s - MIN_SPURIOUS_S).max(0.0) / MEAN_S).exp();
    short + LONG / LONG_S * (-lasts_s / LONG_S).exp().max(1e-6)
}

/// Density of the duration of a commanded dwell, 1/s, including splits, merges and pauses.
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

    /// Each of 5 poses may be the first and the last, and the program may start at any second between the first dwell and the last.
    #[test]
    fn every_start_and_end_of_a_program_is_as_probable() {
        let log_prior = |dwells: &[DwellEvidence]| Trellis::new(&poses(), dwells, None).log_prior;
        assert!((log_prior(&dwells(&[])) - (10.0 * 25f64).ln()).abs() < 1e-12);
        assert!((log_prior(&dwells(&[1, 2, 3, 4])) - 25f64.ln()).abs() < 1e-12);
    }

    #[test]
    fn evidence_is_largest_at_the_driven_override() {
        let (poses, dwells) = (poses(), dwells(&[]));
        let trellis = Trellis::new(&poses, &dwells, None);
        let evidence = |stretch: f64| trellis.evidence(ProgramPace { stretch, slack: SLACK }, BEAM);
        assert!(evidence(1.0) > evidence(1.2) && evidence(1.0) > evidence(1.5));
        // The search starts from values between two steps of the grid.
        for stretch in [0.953, 1.03, 1.049] {
            assert!((trellis.answer(stretch).stretch - 1.0).abs() < 0.001);
        }
    }

    /// The probability of all dwells is the same from either end.
    #[test]
    fn forward_and_backward_sums_have_one_evidence() {
        let (poses, dwells) = (poses(), dwells(&[2]));
        let trellis = Trellis::new(&poses, &dwells, None);
        let pace = ProgramPace { stretch: 1.0, slack: SLACK };
        let forward = trellis.forward(pace, BEAM);
        let backward = trellis.backward(&forward, pace).sums;
        let states = (0..dwells.len())
            .flat_map(|dwell| (0..poses.len()).map(move |pose| TrellisState { dwell, pose }));
        let spurious = dwells.len() as f64 * SPURIOUS.ln();
        let from_its_end = states
            .fold(spurious, |sum, state| log_sum(sum, trellis.first(state) + backward[trellis.cell(state)]));
        near(from_its_end, forward.evidence);
    }

    /// Moves at an override of 99.5 %, fitted from 100 %. Intervals across a break of the clock, and intervals that
    /// last more than four standard deviations too long, have no part in the fit.
    #[test]
    fn the_override_is_fitted_to_the_moves() {
        let (poses, mut dwells) = (poses(), dwells(&[]));
        dwells.iter_mut().zip(0..).for_each(|(dwell, at)| {
            dwell.start_s = 5.0 + (dwell.start_s - 5.0 - f64::from(at)) * 1.005 + f64::from(at)
        });
        let fitted = |dwells: &[DwellEvidence]| {
            let trellis = Trellis::new(&poses, dwells, None);
            let pace = ProgramPace { stretch: 1.0, slack: SLACK };
            trellis.backward(&trellis.forward(pace, BEAM), pace).stretch
        };
        assert!((fitted(&dwells) - 1.005).abs() < 1e-4, "{}", fitted(&dwells));
        let off_s = 0.2;
        dwells[4].start_s += off_s;
        assert!((fitted(&dwells) - 1.005).abs() < 1e-4, "{}", fitted(&dwells));
        dwells[4].start_s -= off_s - 0.06;
        assert!((fitted(&dwells) - 1.005).abs() > 1e-3, "{}", fitted(&dwells));
        dwells[4].after_break = true;
        assert!((fitted(&dwells) - 1.005).abs() < 1e-4, "{}", fitted(&dwells));
    }

    #[test]
    fn log_sum_equals_the_log_of_the_sum() {
        assert!((log_sum(2f64.ln(), 3f64.ln()) - 5f64.ln()).abs() < 1e-15);
        assert_eq!(log_sum(f64::NEG_INFINITY, 1.0), 1.0);
    }

    fn near(value: f64, expected: f64) {
        assert!((value - expected).abs() <= 1e-9 * expected.abs().max(1.0), "{value} {expected}");
    }

    /// 1 / (0.2 sqrt(2 pi)), one sigma off, and the limit of six sigmas.
    #[test]
    fn deviation_of_a_duration_is_normal() {
        near(normal(0.0), 1.994_711_402_007_163_5);
        near(normal(-0.2), 1.209_853_622_595_716_8);
        assert!(normal(1.19) > 0.0 && normal(1.21) == 0.0 && normal(-1.21) == 0.0);
    }

    /// Values by the formulas in Python: shares, normal density, and the tails of the other causes.
    #[test]
    fn density_of_a_duration() {
        near(duration(1.0, 1.0), 1.703_004_691_706_089);
        near(duration(0.5, 1.0), 0.149_495_277_097_666_3);
        near(duration(0.05, 0.1), 2.018_339_496_412_109_3);
        near(duration(11.0, 1.0), 0.002_759_095_808_785_818);
        near(spurious(0.2), 0.754_950_249_168_745_9);
        near(spurious(2.9), 0.105_826_573_893_013_23);
        assert!((spurious(400.0) - 5e-9).abs() < 1e-15);
        near(StillInterval::new(0.0, 1.2).dwell(1.0), 2.447_166_760_506_404_5);
    }

    /// A dwell of 1 s in two parts, 0.4 s and 0.5 s with 0.2 s between.
    #[test]
    fn odds_of_a_split_dwell() {
        let (here, next) = (StillInterval::new(0.0, 0.4), StillInterval::new(0.6, 0.5));
        near(here.split(&next, 1.0), 74.554_193_355_229_27);
        // The first part is no longer than the dwell, the gap no longer than half a second.
        assert_eq!(here.split(&next, 0.39), 0.0);
        assert_eq!(here.split(&StillInterval::new(0.91, 0.5), 1.0), 0.0);
    }

    /// A dwell of 1 s that lasts 3.1 s: until the end of the next pose, or of the one after it.
    #[test]
    fn odds_of_a_merged_dwell() {
        let here = StillInterval::new(0.0, 3.1);
        near(here.merged(1.0, [3.0, 5.0].into_iter()), 108.583_817_325_154_44);
        near(here.merged(1.0, [2.9, 3.0].into_iter()), 115.347_424_994_708_94);
        assert_eq!(here.merged(1.0, [9.0, 9.0, 9.0, 9.0, 3.1].into_iter()), 0.0);
        assert_eq!(here.merged(2.91, [3.0].into_iter()), 0.0);
    }

    #[test]
    fn evidence_of_a_pause() {
        let (here, between) = (StillInterval::new(0.0, 1.0), StillInterval::new(1.0, 5.1));
        near(here.paused(1.0, 5.0, 2.0, &[between]), 985.229_498_554_638_1);
        near(here.paused(1.0, 5.0, 2.0, &[]), 0.1);
        near(StillInterval::new(0.0, 6.1).paused(1.0, 5.0, 2.0, &[]), 175.987_386_611_900_3);
        near(here.paused(1.0, 5.0, 0.1, &[between]), 1000.0);
    }

    /// ln(0.98 p 2 mm + 0.02) with the normal density p: at the pose, one sigma off, and anywhere.
    #[test]
    fn weight_of_a_length() {
        near(length_weight(0.0, 0.1), 2.059_145_551_422_343_4);
        near(length_weight(-0.1, 0.1), 1.560_799_238_910_175);
        near(length_weight(9.0, 0.1), 0.02f64.ln());
    }

    #[test]
    fn starts_are_known_to_20_ms_at_best() {
        near(interval_variance_s2([0.001, 0.02]), 0.0008);
        near(interval_variance_s2([0.03, 0.04]), 0.0025);
    }

    #[test]
    fn pose_has_a_certain_dwell_or_none_or_an_ambiguous_one() {
        assert_eq!(pairing(&[0.0, 0.995]), Pairing::Dwell { dwell: 1, posterior: 0.995 });
        assert_eq!(pairing(&[0.5, 0.45]), Pairing::Ambiguous { dwell: 0, posterior: 0.5 });
        assert_eq!(pairing(&[0.0, 0.985]), Pairing::Ambiguous { dwell: 1, posterior: 0.985 });
        let Pairing::None { posterior } = pairing(&[0.05, 0.04]) else { panic!("a dwell") };
        near(posterior, 0.91);
        assert_eq!(pairing(&[0.06, 0.05]), Pairing::Ambiguous { dwell: 0, posterior: 0.06 });
    }

    /// The program at 80 % speed without its second dwell. The first dwell, beyond that, is less certain.
    #[test]
    fn override_and_dwells_of_a_slow_program() {
        let mut driven = dwells(&[1]);
        let moves_s: Vec<f64> = poses().iter().map(|pose| pose.move_s).collect();
        let mut start_s = 5.0;
        let mut at = 0;
        for (pose, move_s) in moves_s.iter().enumerate() {
            start_s += move_s / 0.8 + if pose > 0 { 1.0 } else { 0.0 };
            if pose != 1 {
                driven[at].start_s = start_s;
                at += 1;
            }
        }
        let PoseAlignment { pairings, override_factor } = align(&poses(), &driven, None);
        assert!((override_factor - 0.8).abs() < 0.005, "{override_factor}");
        for (pose, dwell) in [(2, 1), (3, 2), (4, 3)] {
            assert!(
                matches!(pairings[pose], Pairing::Dwell { dwell: found, .. } if found == dwell),
                "{pairings:?}"
            );
        }
        assert!(matches!(pairings[1], Pairing::None { .. }));
    }
}
