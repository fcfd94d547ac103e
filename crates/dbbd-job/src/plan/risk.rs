//! The probability that a run leaves the stroke anywhere.
//!
//! The readings of one robot are correlated: the sum of the risks of all poses is far too large, the greatest one too small.
//! Robots are drawn from the prior, the worst pose of each row is evaluated to first order, and the share of robots that
//! leave the stroke at any of them is counted.

use nalgebra::DVector;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use super::cell::StrokeMargin;

/// Robots drawn: at a risk of 1e-3 the share has a relative standard deviation of a fifth.
const ROBOTS: usize = 20_000;
/// Poses with less than this share of the greatest risk are neglected.
const NEGLIGIBLE: f64 = 1e-4;

/// The share of drawn robots that leave the stroke at any of the poses; the sum of the risks if that is less.
pub(crate) fn over_run(poses: &[StrokeMargin]) -> f64 {
    let sum: f64 = poses.iter().map(|pose| pose.risk).sum();
    let largest = poses.iter().map(|pose| pose.risk).fold(0.0, f64::max);
    // A smaller risk is below the resolution of the draws.
    if sum < 1.0 / ROBOTS as f64 {
        return sum;
    }
    let critical: Vec<&StrokeMargin> = poses.iter().filter(|pose| pose.risk > NEGLIGIBLE * largest).collect();
    let unknowns = critical.first().map_or(0, |pose| pose.design_row.len());
    let mut random = Pcg64::seed_from_u64(1);
    let mut robot = DVector::zeros(unknowns);
    let mut leave = 0_u32;
    for _ in 0..ROBOTS {
        robot.iter_mut().for_each(|value| *value = StandardNormal.sample(&mut random));
        let leaves = |pose: &&StrokeMargin| {
            let moved = pose.design_row.dot(&robot);
            moved > pose.room[1] || moved < -pose.room[0]
        };
        leave += u32::from(critical.iter().any(leaves));
    }
    (f64::from(leave) / ROBOTS as f64).min(sum)
}
