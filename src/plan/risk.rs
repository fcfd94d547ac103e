//! The probability that a run leaves the stroke anywhere.
//!
//! The readings of one robot move together, so that the sum of the risks of all poses would be far too
//! much and the largest too little. Robots are drawn from what is known, each row's worst pose is
//! evaluated to first order, and the share that leaves the stroke at any of them is counted.

use nalgebra::DVector;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use super::cell::Near;

/// Robots drawn: at a risk of 1e-3 the share is known to a fifth of itself.
const ROBOTS: usize = 20_000;
/// Poses of less risk than this share of the largest do not count: all of them together are less.
const NEGLIGIBLE: f64 = 1e-4;

/// The share of robots drawn that leave the stroke at any of the poses; the sum of the poses' risks where
/// that is less.
pub(crate) fn over_run(poses: &[Near]) -> f64 {
    let sum: f64 = poses.iter().map(|near| near.risk).sum();
    let largest = poses.iter().map(|near| near.risk).fold(0.0, f64::max);
    // What so many robots could not show needs none.
    if sum < 1.0 / ROBOTS as f64 {
        return sum;
    }
    let telling: Vec<&Near> = poses.iter().filter(|near| near.risk > NEGLIGIBLE * largest).collect();
    let unknowns = telling.first().map_or(0, |near| near.swing.len());
    let mut random = Pcg64::seed_from_u64(1);
    let mut robot = DVector::zeros(unknowns);
    let mut leave = 0_u32;
    for _ in 0..ROBOTS {
        robot.iter_mut().for_each(|value| *value = StandardNormal.sample(&mut random));
        let leaves = |near: &&Near| {
            let moved = near.swing.dot(&robot);
            moved > near.room[1] || moved < -near.room[0]
        };
        leave += u32::from(telling.iter().any(leaves));
    }
    (f64::from(leave) / ROBOTS as f64).min(sum)
}
