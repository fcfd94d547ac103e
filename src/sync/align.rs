//! Which dwell belongs to which commanded pose.
//!
//! A hidden Markov model over (pose, dwell): from one matched pair to the next, with poses that left no
//! dwell and dwells that no pose commanded between them. What speaks are the INTERVALS between the
//! begins of dwells, since absolute times drift apart with every pause. The forward and backward sums
//! give each pair's probability; a pair is kept when it is nearly certain. The best path is not enough:
//! it exists also where nothing can be told.

use std::cell::Cell;

use super::interval::{Commanded, Interval, MOST_LOG_DENSITY, Pace, Program};

/// A dwell that was seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Its begin, s of the stream.
    pub start_s: f64,
    /// Standard deviation of the begin, s; below [`LEAST_START_SD_S`] counts as that.
    pub start_sd_s: f64,
    /// How long it stood still, s, where that can be told.
    pub lasts_s: Option<f64>,
    /// Its reading plus the bar's length, mm.
    pub length_mm: f64,
    /// Whether the clock broke since the dwell before.
    pub after_break: bool,
}

/// Lengths that are expected, for each pose.
#[derive(Clone, Copy, Debug)]
pub struct Expected<'a> {
    /// Expected lengths, mm.
    pub length_mm: &'a [f64],
    /// Their standard deviation, mm.
    pub sigma_mm: f64,
}

/// What became of a pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pairing {
    /// It is the dwell of this number (from 0).
    Dwell {
        /// Number of the dwell.
        dwell: usize,
        /// Probability of the pair.
        posterior: f64,
    },
    /// It has no dwell.
    None {
        /// Probability of that.
        posterior: f64,
    },
    /// More than one answer is possible.
    Ambiguous {
        /// The likeliest dwell, if any.
        dwell: usize,
        /// Its probability.
        posterior: f64,
    },
}

/// The alignment of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Alignment {
    /// What became of each pose.
    pub pairings: Vec<Pairing>,
    /// The override that the moves were driven with, 0..1.
    pub override_factor: f64,
}

/// No begin is known better, s: the controller's own waits and outputs jitter.
pub const LEAST_START_SD_S: f64 = 0.02;
/// Pairs less certain are dropped.
pub(super) const KEEP: f64 = 0.99;
/// A pose is said to have no dwell from this probability on.
const NONE: f64 = 0.9;
/// Probability that a commanded dwell is not seen, and the density of dwells that nobody commanded, 1/s.
const MISSED: f64 = 0.08;
const SPURIOUS: f64 = 0.02;
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
const BEAM: f64 = 45.0;
/// The same while only the override is sought.
const SEARCH_BEAM: f64 = 20.0;
/// The override's range, and the grid's step as a ratio.
const OVERRIDES: (f64, f64) = (0.27, 1.03);
const STEP: f64 = 1.1;
/// How far a move's duration may be from the plan's, as a share; while the override is sought it takes
/// up the grid's step as well.
pub(super) const SLACK: f64 = 0.01;
const SEARCH_SLACK: f64 = 0.03;

/// Aligns the dwells that were seen with the poses that were commanded, both in order of time.
pub fn align(poses: &[Commanded], seen: &[Seen], expected: Option<Expected<'_>>) -> Alignment {
    let nothing =
        Alignment { pairings: vec![Pairing::None { posterior: 1.0 }; poses.len()], override_factor: 1.0 };
    if poses.is_empty() || seen.is_empty() {
        return nothing;
    }
    let model = Model::new(poses, seen, expected);
    let steps = ((OVERRIDES.1 / OVERRIDES.0).ln() / STEP.ln()).ceil() as i32;
    let grid: Vec<(f64, f64)> = (0..=steps)
        .map(|step| 1.0 / (OVERRIDES.0 * STEP.powi(step)))
        .map(|stretch| (stretch, model.forward(Pace { stretch, slack: SEARCH_SLACK }, SEARCH_BEAM).evidence))
        .collect();
    let best = grid.iter().map(|(_, evidence)| *evidence).fold(f64::NEG_INFINITY, f64::max);
    // Every override that explains the run about as well has its say.
    let mut answers: Vec<Answer> = Vec::new();
    for (at, &(stretch, evidence)) in grid.iter().enumerate() {
        let lower =
            |other: Option<usize>| other.and_then(|at| grid.get(at)).is_none_or(|next| next.1 <= evidence);
        if evidence > best - BEAM && lower(at.checked_sub(1)) && lower(Some(at + 1)) {
            answers.push(model.answer(stretch));
        }
    }
    let best = answers.iter().map(|answer| answer.evidence).fold(f64::NEG_INFINITY, f64::max);
    let Some(likeliest) = answers.iter().find(|answer| answer.evidence == best) else { return nothing };
    let total: f64 = answers.iter().map(|answer| (answer.evidence - best).exp()).sum();
    let mut posterior = vec![0.0; poses.len() * seen.len()];
    for answer in &answers {
        let weight = (answer.evidence - best).exp() / total;
        for (sum, part) in posterior.iter_mut().zip(&answer.posterior) {
            *sum += weight * part;
        }
    }
    let pairings = posterior.chunks(seen.len()).map(pairing).collect();
    Alignment { pairings, override_factor: (1.0 / likeliest.stretch).min(1.0) }
}

fn pairing(row: &[f64]) -> Pairing {
    let (dwell, posterior) = row
        .iter()
        .copied()
        .enumerate()
        .fold((0, 0.0), |best, next| if next.1 > best.1 { next } else { best });
    let none = (1.0 - row.iter().sum::<f64>()).clamp(0.0, 1.0);
    if posterior > KEEP {
        Pairing::Dwell { dwell, posterior }
    } else if none > NONE {
        Pairing::None { posterior: none }
    } else {
        Pairing::Ambiguous { dwell, posterior }
    }
}

/// One override's answer: probabilities of the pairs, by pose, then dwell.
struct Answer {
    stretch: f64,
    evidence: f64,
    posterior: Vec<f64>,
}

/// Logarithms of the forward sums, by dwell, then pose, and of the whole.
struct Forward {
    sums: Vec<f64>,
    best: Vec<f64>,
    evidence: f64,
}

struct Model<'a> {
    program: Program,
    poses: usize,
    seen: &'a [Seen],
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

impl<'a> Model<'a> {
    fn new(poses: &[Commanded], seen: &'a [Seen], expected: Option<Expected<'_>>) -> Self {
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
        let weight = |dwell: &Seen, pose: usize| {
            let lasts = dwell.lasts_s.map_or(0.0, |lasts_s| duration_weight(lasts_s - poses[pose].wait_s));
            let length = expected.map_or(0.0, |expected| {
                length_weight(dwell.length_mm - expected.length_mm[pose], expected.sigma_mm)
            });
            lasts + length
        };
        let pairs: Vec<f64> =
            seen.iter().flat_map(|dwell| (0..poses.len()).map(move |pose| weight(dwell, pose))).collect();
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
        }
    }

    fn pair(&self, dwell: usize, pose: usize) -> f64 {
        self.pairs[dwell * self.poses + pose]
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
                if !worth(next_dwell, skipped + MOST_LOG_DENSITY + self.most_pair) {
                    continue;
                }
                let weight = skipped + interval.log_density(pace) + self.pair(next_dwell, next_pose);
                visit(next_dwell, next_pose, weight, &interval);
            }
        }
    }

    fn first(&self, dwell: usize, pose: usize) -> f64 {
        dwell as f64 * SPURIOUS.ln() - self.log_prior + self.pair(dwell, pose)
    }

    fn last(&self, dwell: usize) -> f64 {
        (self.seen.len() - 1 - dwell) as f64 * SPURIOUS.ln()
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
                let from = sums[dwell * self.poses + pose];
                if from < best[dwell].get() - beam {
                    continue;
                }
                evidence = log_sum(evidence, from + self.last(dwell));
                let worth = |next_dwell: usize, most: f64| from + most >= best[next_dwell].get() - beam;
                self.successors((dwell, pose), pace, worth, |next_dwell, next_pose, weight, _| {
                    let to = &mut sums[next_dwell * self.poses + next_pose];
                    *to = log_sum(*to, from + weight);
                    best[next_dwell].set(best[next_dwell].get().max(*to));
                });
            }
        }
        Forward { sums, best, evidence }
    }

    fn backward(&self, forward: &Forward, pace: Pace) -> Vec<f64> {
        let mut sums = vec![f64::NEG_INFINITY; forward.sums.len()];
        for dwell in (0..self.seen.len()).rev() {
            for pose in 0..self.poses {
                let cell = dwell * self.poses + pose;
                let from = forward.sums[cell];
                if from < forward.best[dwell] - BEAM {
                    continue;
                }
                let worth = |next_dwell: usize, most: f64| from + most >= forward.best[next_dwell] - BEAM;
                let mut sum = self.last(dwell);
                self.successors((dwell, pose), pace, worth, |next_dwell, next_pose, weight, _| {
                    sum = log_sum(sum, weight + sums[next_dwell * self.poses + next_pose]);
                });
                sums[cell] = sum;
            }
        }
        sums
    }

    /// Refines the override near `stretch` and gives the probabilities there.
    fn answer(&self, mut stretch: f64) -> Answer {
        const ROUNDS: usize = 4;
        let mut round = 0;
        loop {
            let pace = Pace { stretch, slack: SLACK };
            let forward = self.forward(pace, BEAM);
            let backward = self.backward(&forward, pace);
            round += 1;
            let refined = if round < ROUNDS { self.refined(&forward, &backward, pace) } else { stretch };
            if (refined / stretch - 1.0).abs() < 1e-4 {
                let mut posterior = vec![0.0; forward.sums.len()];
                for dwell in 0..self.seen.len() {
                    for pose in 0..self.poses {
                        let cell = dwell * self.poses + pose;
                        posterior[pose * self.seen.len() + dwell] =
                            (forward.sums[cell] + backward[cell] - forward.evidence).exp();
                    }
                }
                return Answer { stretch, evidence: forward.evidence, posterior };
            }
            stretch = refined;
        }
    }

    /// Least squares of what the intervals took over what was commanded, weighted with their probability.
    fn refined(&self, forward: &Forward, backward: &[f64], pace: Pace) -> f64 {
        let (mut products, mut squares) = (0.0, 0.0);
        for dwell in 0..self.seen.len() {
            for pose in 0..self.poses {
                let from = forward.sums[dwell * self.poses + pose];
                if from < forward.best[dwell] - BEAM {
                    continue;
                }
                let worth = |next_dwell: usize, most: f64| from + most >= forward.best[next_dwell] - BEAM;
                self.successors((dwell, pose), pace, worth, |next_dwell, next_pose, weight, interval| {
                    let sigma_s = interval.sigma_s(pace);
                    if interval.broken || interval.residual_s(pace).abs() > 4.0 * sigma_s {
                        return;
                    }
                    let to = backward[next_dwell * self.poses + next_pose];
                    let weight = (from + weight + to - forward.evidence).exp() / (sigma_s * sigma_s);
                    products += weight * interval.move_s * (interval.seen_s - interval.wait_s);
                    squares += weight * interval.move_s * interval.move_s;
                });
            }
        }
        if squares > 0.0 {
            (products / squares).clamp(1.0 / OVERRIDES.1, 1.0 / OVERRIDES.0)
        } else {
            pace.stretch
        }
    }
}

/// Log of the ratio of a pair's density of duration to that of a stretch that nobody commanded. Many
/// dwells are cut, split, or prolonged by a pause, so a wrong duration says little, a right one more.
fn duration_weight(difference_s: f64) -> f64 {
    const SIGMA_S: f64 = 0.2;
    const ANY: f64 = 0.1;
    const TRUE_TO_PLAN: f64 = 0.85;
    let standard = difference_s / SIGMA_S;
    let normal = (-0.5 * standard * standard).exp() / (SIGMA_S * std::f64::consts::TAU.sqrt());
    (TRUE_TO_PLAN * normal / ANY + 1.0 - TRUE_TO_PLAN).ln()
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
