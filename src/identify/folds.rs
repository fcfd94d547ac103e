//! Cross-validation: lengths that the fit did not see.

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_pcg::Pcg64;

use super::estimate::{IdentifyError, Lengths, estimate};
use super::options::Options;
use super::result::Folds;
use crate::model::{LengthModel, Reading, Robot};

/// Number of folds when the user does not say, and lengths per parameter below which there are none.
pub(super) const DEFAULT_FOLDS: usize = 5;
pub(super) const LENGTHS_PER_PARAMETER: usize = 3;

/// Fits without each fold in turn and predicts its lengths. Rows with equal axis angles (one pose
/// measured to several balls) stay together: a fold must not know its own poses.
pub(super) fn cross_validate(
    robot: &Robot,
    start: &LengthModel,
    lengths: &Lengths,
    used: &[bool],
    options: &Options,
    folds: usize,
) -> Result<Option<Folds>, IdentifyError> {
    let Some(fold_of) = assign(&lengths.readings, folds) else { return Ok(None) };
    let mut sum = 0.0;
    let mut count = 0;
    for fold in 0..folds {
        let take = |chosen: bool| -> Vec<usize> {
            (0..lengths.readings.len()).filter(|&at| used[at] && (fold_of[at] == fold) == chosen).collect()
        };
        let (held_out, rest) = (take(true), take(false));
        let training = Lengths {
            readings: rest.iter().map(|&at| lengths.readings[at]).collect(),
            given: rest.iter().map(|&at| lengths.given[at]).collect(),
            ..*lengths
        };
        let model = estimate(robot, start, &training, options)?.fit.model;
        let prepared = model.prepare();
        for at in held_out {
            let residual = lengths.readings[at].length - prepared.length(&lengths.readings[at]);
            sum += residual * residual;
            count += 1;
        }
    }
    Ok(Some(Folds { folds, rms: (sum / f64::from(count.max(1))).sqrt() }))
}

/// The fold of each reading: poses shuffled by a fixed seed, dealt in turn; `None` when there are fewer poses
/// than folds.
fn assign(readings: &[Reading], folds: usize) -> Option<Vec<usize>> {
    let bits = |reading: &Reading| reading.axes.map(f64::to_bits);
    let mut poses: Vec<[u64; 6]> = readings.iter().map(bits).collect();
    poses.sort_unstable();
    poses.dedup();
    if poses.len() < folds {
        return None;
    }
    let mut dealt: Vec<usize> = (0..poses.len()).map(|at| at % folds).collect();
    dealt.shuffle(&mut Pcg64::seed_from_u64(1));
    Some(
        readings
            .iter()
            .map(|reading| poses.binary_search(&bits(reading)).map_or(0, |at| dealt[at]))
            .collect(),
    )
}
