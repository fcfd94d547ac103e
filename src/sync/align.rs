//! Which dwell belongs to which commanded pose.
//!
//! A hidden Markov model over (pose, dwell): from one matched pair to the next, with poses that left no
//! dwell and dwells that no pose commanded between them. What speaks are the INTERVALS between the
//! begins of dwells, since absolute times drift apart with every pause. The forward and backward sums
//! give each pair's probability; a pair is kept when it is nearly certain. The best path is not enough:
//! it exists also where nothing can be told.

use super::interval::{Commanded, Pace};
use super::lattice::{Answer, BEAM, Lattice, OVERRIDES};
use super::seen::{Expected, Seen};

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

/// Pairs less certain are dropped.
pub(super) const KEEP: f64 = 0.99;
/// A pose is said to have no dwell from this probability on.
const NONE: f64 = 0.9;
/// Hypotheses so much worse than the best are not followed up while only the override is sought.
const SEARCH_BEAM: f64 = 10.0;
/// The override is sought in the middle of a long run: more dwells do not tell it better.
const SEARCH_DWELLS: usize = 160;
/// The override's grid, as a ratio of steps; the slack of a move's duration takes up the step as well.
const STEP: f64 = 1.1;
const SEARCH_SLACK: f64 = 0.03;

/// Aligns the dwells that were seen with the poses that were commanded, both in order of time.
pub fn align(poses: &[Commanded], seen: &[Seen], expected: Option<Expected<'_>>) -> Alignment {
    let nothing =
        Alignment { pairings: vec![Pairing::None { posterior: 1.0 }; poses.len()], override_factor: 1.0 };
    if poses.is_empty() || seen.is_empty() {
        return nothing;
    }
    let from = seen.len().saturating_sub(SEARCH_DWELLS) / 2;
    let search = Lattice::new(poses, &seen[from..seen.len().min(from + SEARCH_DWELLS)], expected);
    let steps = ((OVERRIDES.1 / OVERRIDES.0).ln() / STEP.ln()).ceil() as i32;
    let grid: Vec<(f64, f64)> = (0..=steps)
        .map(|step| 1.0 / (OVERRIDES.0 * STEP.powi(step)))
        .map(|stretch| (stretch, search.evidence(Pace { stretch, slack: SEARCH_SLACK }, SEARCH_BEAM)))
        .collect();
    let best = grid.iter().map(|(_, evidence)| *evidence).fold(f64::NEG_INFINITY, f64::max);
    // Every override that explains the run about as well has its say.
    let lattice = Lattice::new(poses, seen, expected);
    let mut answers: Vec<Answer> = Vec::new();
    for (at, &(stretch, evidence)) in grid.iter().enumerate() {
        let lower =
            |other: Option<usize>| other.and_then(|at| grid.get(at)).is_none_or(|next| next.1 <= evidence);
        if evidence > best - BEAM && lower(at.checked_sub(1)) && lower(Some(at + 1)) {
            answers.push(lattice.answer(stretch));
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
