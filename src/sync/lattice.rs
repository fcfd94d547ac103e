//! The hidden Markov model over (dwell, pose): forward and backward sums at one override.

use std::cell::Cell;

use super::duration::{MISSED, SPURIOUS, Span};
use super::interval::{BROKEN, Commanded, Interval, MOST_LOG_DENSITY, Pace, Program};
use super::seen::{Expected, LEAST_START_SD_S, Seen};

/// Probability that an outage of the bar begins at a pose, and that it goes on for another. It is rated
/// low, since a pause of the operator must not pass for an outage.
const OUTAGE: f64 = 1e-6;
const OUTAGE_GOES_ON: f64 = 0.8;
/// Most dwells that nobody commanded in one row.
const SPURIOUS_RUN: usize = 8;
/// The same between two modules, where the operator handles the bar, and how many poses may be lost there.
const SPURIOUS_BY_HAND: usize = 60;
const LOST_BY_HAND: usize = 4;
/// Most poses without a dwell in one row where the time does not limit them.
const MISSED_RUN: usize = 60;
/// An interval may be shorter than commanded by no more, s.
const EARLY_S: f64 = 1.5;
/// Hypotheses so much worse than the best (in natural logarithms) are not followed up.
pub(super) const BEAM: f64 = 45.0;
/// The override's range.
pub(super) const OVERRIDES: (f64, f64) = (0.27, 1.03);
/// How far a move's duration may be from the plan's, as a share.
pub(super) const SLACK: f64 = 0.01;

/// One override's answer: probabilities of the pairs, by pose, then dwell.
pub(super) struct Answer {
    pub(super) stretch: f64,
    pub(super) evidence: f64,
    pub(super) posterior: Vec<f64>,
}

/// Logarithms of the forward sums, by dwell, then pose, and of the whole.
struct Forward {
    sums: Vec<f64>,
    best: Vec<f64>,
    evidence: f64,
}

/// The same backward, and the override that the pairs ask for.
struct Backward {
    sums: Vec<f64>,
    stretch: f64,
}

/// Poses and dwells, and what does not depend on the override.
pub(super) struct Lattice<'a> {
    program: Program,
    poses: usize,
    seen: &'a [Seen],
    /// The dwells as stretches, where their durations are known.
    stretches: Option<Vec<Span>>,
    /// Number of clock breaks up to each dwell.
    epochs: Vec<usize>,
    /// Log weight of a pair by its duration and length, by dwell, then pose.
    pairs: Vec<f64>,
    /// The greatest of them.
    most_pair: f64,
    /// The program may begin at any time of the run, and any poses at either end may be lost.
    log_prior: f64,
    /// Log weight of passing over 0, 1, .. poses.
    passed: Vec<f64>,
    /// For each pose, the first pose of the next module (or the number of poses).
    next_modules: Vec<usize>,
}

impl<'a> Lattice<'a> {
    pub(super) fn new(poses: &[Commanded], seen: &'a [Seen], expected: Option<Expected<'_>>) -> Self {
        let epochs = seen
            .iter()
            .scan(0, |epoch, dwell| {
                *epoch += usize::from(dwell.after_break);
                Some(*epoch)
            })
            .collect();
        let span_s =
            seen.last().map_or(0.0, |last| last.start_s) - seen.first().map_or(0.0, |first| first.start_s);
        let expected = expected.filter(|expected| expected.length_mm.len() == poses.len());
        let stretch = |dwell: &Seen| Some(Span::new(dwell.start_s, dwell.lasts_s?));
        let stretches: Option<Vec<Span>> = seen.iter().map(stretch).collect();
        let weight = |dwell: usize, pose: usize| {
            let stretch = stretches.as_ref().and_then(|stretches| stretches.get(dwell));
            let lasts = stretch.map_or(0.0, |stretch| stretch.dwell(poses[pose].wait_s).ln());
            let length = expected.map_or(0.0, |expected| {
                length_weight(seen[dwell].length_mm - expected.length_mm[pose], expected.sigma_mm)
            });
            lasts + length
        };
        let weight = &weight;
        let pairs: Vec<f64> =
            (0..seen.len()).flat_map(|dwell| (0..poses.len()).map(move |pose| weight(dwell, pose))).collect();
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
            program: Program::new(poses),
            poses: poses.len(),
            seen,
            epochs,
            most_pair: pairs.iter().copied().fold(0.0, f64::max),
            pairs,
            log_prior: (span_s.max(1.0) * (poses.len() * poses.len()) as f64).ln(),
            passed,
            next_modules,
            stretches,
        }
    }

    fn cell(&self, dwell: usize, pose: usize) -> usize {
        dwell * self.poses + pose
    }

    /// Calls `visit(dwell, pose, log weight, interval)` for every pair that may follow the given one,
    /// unless `worth(dwell, most log weight)` says that it cannot matter.
    fn successors(
        &self,
        (dwell, pose): (usize, usize),
        pace: Pace,
        worth: impl Fn(usize, f64) -> bool,
        mut visit: impl FnMut(usize, usize, f64, &Interval),
    ) {
        let next_module = self.next_modules[pose];
        let by_hand = next_module < self.poses && pose + LOST_BY_HAND >= next_module - 1;
        let most = 1 + if by_hand { SPURIOUS_BY_HAND } else { SPURIOUS_RUN };
        let torn = self.torn(dwell, pose);
        let merged = self.merged(dwell, pose, next_module, pace);
        let most_log = MOST_LOG_DENSITY + self.most_pair + (1.0 + torn + merged).ln();
        for next_dwell in dwell + 1..self.seen.len().min(dwell + 1 + most) {
            let seen_s = self.seen[next_dwell].start_s - self.seen[dwell].start_s;
            let sd_s = |at: usize| self.seen[at].start_sd_s.max(LEAST_START_SD_S);
            let variance_s2 = sd_s(dwell).powi(2) + sd_s(next_dwell).powi(2);
            let broken = self.epochs[next_dwell] != self.epochs[dwell];
            let between = next_dwell - dwell - 1;
            let spurious = between as f64 * SPURIOUS.ln();
            let (from, to) = if between <= SPURIOUS_RUN {
                (pose + 1, pose + 1 + self.passed.len())
            } else {
                (next_module, next_module + 1 + LOST_BY_HAND)
            };
            for next_pose in from..self.poses.min(to) {
                let interval = self.program.interval(pose, next_pose, seen_s, variance_s2, broken);
                if !broken && interval.residual_s(pace) < -EARLY_S {
                    break;
                }
                let skipped = spurious + self.passed[interval.passed.min(MISSED_RUN)];
                if !worth(next_dwell, skipped + most_log) {
                    continue;
                }
                // What the duration of the first tells: the rest of it comes next, or poses that it ran over.
                let lasting = 1.0
                    + if between > 0 { torn } else { 0.0 }
                    + if interval.passed > 0 { merged } else { 0.0 };
                let density = if broken {
                    BROKEN * lasting
                } else {
                    let (running, paused) = interval.densities(pace);
                    running * lasting + paused * self.trace(dwell, next_dwell, pose, &interval, pace, lasting)
                };
                let weight =
                    skipped + density.max(1e-300).ln() + self.pairs[self.cell(next_dwell, next_pose)];
                visit(next_dwell, next_pose, weight, &interval);
            }
        }
    }

    /// That the next stretch is the rest of this dwell, against that it is nobody's.
    fn torn(&self, dwell: usize, pose: usize) -> f64 {
        let Some(stretches) = &self.stretches else { return 0.0 };
        let (Some(here), Some(next)) = (stretches.get(dwell), stretches.get(dwell + 1)) else { return 0.0 };
        here.torn(next, self.program.wait_s(pose))
    }

    /// That this dwell ran together with the next poses, against that they were missed.
    fn merged(&self, dwell: usize, pose: usize, next_module: usize, pace: Pace) -> f64 {
        let Some(here) = self.stretches.as_ref().and_then(|stretches| stretches.get(dwell)) else {
            return 0.0;
        };
        let spans_s = (pose + 1..next_module).map(|last| self.program.span_s(pose, last, pace));
        here.merged(self.program.wait_s(pose), spans_s)
    }

    /// How much a pause that fills the interval is borne out by a stretch of its length.
    fn trace(
        &self,
        dwell: usize,
        next_dwell: usize,
        pose: usize,
        interval: &Interval,
        pace: Pace,
        lasting: f64,
    ) -> f64 {
        let stretches = self.stretches.as_ref().filter(|_| !interval.by_hand);
        let Some(stretches) = stretches.and_then(|stretches| stretches.get(dwell..next_dwell)) else {
            return lasting;
        };
        let Some((here, between)) = stretches.split_first() else { return lasting };
        let move_s = pace.stretch * interval.move_s;
        here.paused(self.program.wait_s(pose), interval.residual_s(pace), move_s, between)
    }

    fn first(&self, dwell: usize, pose: usize) -> f64 {
        dwell as f64 * SPURIOUS.ln() - self.log_prior + self.pairs[self.cell(dwell, pose)]
    }

    fn last(&self, dwell: usize, pose: usize) -> f64 {
        (self.seen.len() - 1 - dwell) as f64 * SPURIOUS.ln() + self.torn(dwell, pose).ln_1p()
    }

    /// Log of the probability of all dwells at this pace.
    pub(super) fn evidence(&self, pace: Pace, beam: f64) -> f64 {
        self.forward(pace, beam).evidence
    }

    fn forward(&self, pace: Pace, beam: f64) -> Forward {
        let firsts = (0..self.seen.len()).flat_map(|dwell| (0..self.poses).map(move |pose| (dwell, pose)));
        let mut sums: Vec<f64> = firsts.map(|(dwell, pose)| self.first(dwell, pose)).collect();
        let most = |row: &[f64]| row.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let mut best: Vec<f64> = sums.chunks(self.poses).map(most).collect();
        // That no dwell at all is the program's is possible as well.
        let mut evidence = self.seen.len() as f64 * SPURIOUS.ln();
        for dwell in 0..self.seen.len() {
            let best = Cell::from_mut(&mut best[..]).as_slice_of_cells();
            for pose in 0..self.poses {
                let from = sums[self.cell(dwell, pose)];
                if from < best[dwell].get() - beam {
                    continue;
                }
                evidence = log_sum(evidence, from + self.last(dwell, pose));
                let worth = |next_dwell: usize, most: f64| from + most >= best[next_dwell].get() - beam;
                self.successors((dwell, pose), pace, worth, |next_dwell, next_pose, weight, _| {
                    let to = &mut sums[self.cell(next_dwell, next_pose)];
                    *to = log_sum(*to, from + weight);
                    best[next_dwell].set(best[next_dwell].get().max(*to));
                });
            }
        }
        Forward { sums, best, evidence }
    }

    /// Beside the sums, least squares of what the intervals took over what was commanded, weighted with
    /// their probability.
    fn backward(&self, forward: &Forward, pace: Pace) -> Backward {
        let mut sums = vec![f64::NEG_INFINITY; forward.sums.len()];
        let (mut products, mut squares) = (0.0, 0.0);
        for dwell in (0..self.seen.len()).rev() {
            for pose in 0..self.poses {
                let cell = self.cell(dwell, pose);
                let from = forward.sums[cell];
                if from < forward.best[dwell] - BEAM {
                    continue;
                }
                let worth = |next_dwell: usize, most: f64| from + most >= forward.best[next_dwell] - BEAM;
                let mut sum = self.last(dwell, pose);
                self.successors((dwell, pose), pace, worth, |next_dwell, next_pose, weight, interval| {
                    let onward = weight + sums[self.cell(next_dwell, next_pose)];
                    sum = log_sum(sum, onward);
                    let log_posterior = from + onward - forward.evidence;
                    let sigma_s = interval.sigma_s(pace);
                    if log_posterior < -BEAM
                        || interval.broken
                        || interval.residual_s(pace).abs() > 4.0 * sigma_s
                    {
                        return;
                    }
                    let weight = log_posterior.exp() / (sigma_s * sigma_s);
                    products += weight * interval.move_s * (interval.seen_s - interval.wait_s);
                    squares += weight * interval.move_s * interval.move_s;
                });
                sums[cell] = sum;
            }
        }
        let stretch = if squares > 0.0 {
            (products / squares).clamp(1.0 / OVERRIDES.1, 1.0 / OVERRIDES.0)
        } else {
            pace.stretch
        };
        Backward { sums, stretch }
    }

    /// Refines the override near `stretch` and gives the probabilities there.
    pub(super) fn answer(&self, mut stretch: f64) -> Answer {
        const ROUNDS: usize = 4;
        let mut round = 1;
        loop {
            let pace = Pace { stretch, slack: SLACK };
            let forward = self.forward(pace, BEAM);
            let backward = self.backward(&forward, pace);
            if round == ROUNDS || (backward.stretch / stretch - 1.0).abs() < 1e-4 {
                let posterior = (0..self.poses)
                    .flat_map(|pose| (0..self.seen.len()).map(move |dwell| (dwell, pose)))
                    .map(|(dwell, pose)| self.cell(dwell, pose))
                    .map(|cell| (forward.sums[cell] + backward.sums[cell] - forward.evidence).exp())
                    .collect();
                return Answer { stretch, evidence: forward.evidence, posterior };
            }
            stretch = backward.stretch;
            round += 1;
        }
    }
}

/// Log of the ratio of a pair's length density to that of a dwell somewhere in the bar's stroke.
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
