//! Aligns detected dwells with commanded poses.
//!
//! A hidden Markov model over (pose, dwell): from one matched pair to the next, with missed poses and spurious
//! dwells between them. Its evidence is the INTERVALS between the starts of dwells, because absolute times drift
//! apart with every pause. Forward and backward sums give the posterior of each pair, and a pair is kept if it is
//! nearly certain. The best (Viterbi) path does not suffice: it exists even if nothing can be identified.

use super::evidence::{DwellEvidence, ExpectedLengths};
use super::program::{CommandedDwell, ProgramPace};
use super::trellis::{BEAM, MAX_OVERRIDE, MIN_OVERRIDE, SEARCH_SLACK, Trellis, TrellisPosterior};

/// The dwell of a pose (index from 0) and its posterior; of an ambiguous pose the most probable dwell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pairing {
    Dwell { dwell: usize, posterior: f64 },
    None { posterior: f64 },
    Ambiguous { dwell: usize, posterior: f64 },
}

#[derive(Clone, Debug, PartialEq)]
pub struct PoseAlignment {
    /// One for each pose.
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

/// Local maxima of the evidence over the override that are nearly as good as the best.
fn likely_stretches(
    poses: &[CommandedDwell],
    dwells: &[DwellEvidence],
    expected: Option<ExpectedLengths<'_>>,
) -> Vec<f64> {
    let from = dwells.len().saturating_sub(SEARCH_DWELLS) / 2;
    let search = Trellis::new(poses, &dwells[from..dwells.len().min(from + SEARCH_DWELLS)], expected);
    let steps = ((MAX_OVERRIDE / MIN_OVERRIDE).ln() / STEP.ln()).ceil() as i32;
    let stretches: Vec<f64> = (0..=steps).map(|step| 1.0 / (MIN_OVERRIDE * STEP.powi(step))).collect();
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
