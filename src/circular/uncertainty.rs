//! Uncertainty by Monte Carlo (GUM Supplement 1): G and F are extremes, for which the law of
//! propagation does not hold.

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use super::fit::Circle;
use super::noise::Noise;
use super::quantities::{Allowed, Facing, Quantities, Rays, evaluate};
use super::zone::outermost;
use super::{NAMES, Settings};

/// Traces with more points are drawn by their outermost points alone.
const MANY: usize = 4000;
const SHARE: f64 = 0.95;
/// The same for a normal distribution, in standard deviations.
const NORMAL: f64 = 1.96;

/// For each value of [`Quantities::row`] the half width of its 95 % interval, mm;
/// `None` without draws.
pub(super) fn u95(
    rays: &Rays,
    values: &Quantities,
    joint: &Circle,
    allowed: Allowed,
    noise: &Noise,
    settings: &Settings,
) -> Option<Vec<f64>> {
    if settings.draws < 2 {
        return None;
    }
    let thin = rays.traces.iter().any(|trace| trace.len() > MANY);
    let (rays, sigma_mm) =
        if thin { outermost_of(rays, noise, joint) } else { (rays.clone(), noise.sigma_mm.clone()) };
    let nominal = if thin { evaluate(&rays, allowed)? } else { values.clone() };
    let nominal: Vec<f64> = nominal.row().collect();
    let mut random = Pcg64::seed_from_u64(settings.seed);
    let mut away: Vec<Vec<f64>> = vec![Vec::with_capacity(settings.draws); nominal.len()];
    let mut drawn = rays.clone();
    for _ in 0..settings.draws {
        let bar: f64 = StandardNormal.sample(&mut random);
        let common = settings.bar_u_mm * bar;
        for ((to, from), sigma) in drawn.traces.iter_mut().zip(&rays.traces).zip(&sigma_mm) {
            for ((to, from), sigma) in to.iter_mut().zip(from).zip(sigma) {
                let error: f64 = StandardNormal.sample(&mut random);
                to.length_mm = from.length_mm + common + sigma * error;
            }
        }
        let Some(values) = evaluate(&drawn, allowed) else { continue };
        for ((away, value), nominal) in away.iter_mut().zip(values.row()).zip(&nominal) {
            away.push(value - nominal);
        }
    }
    let mut u95: Vec<f64> = away.iter_mut().map(|away| half_width(away)).collect();
    if thin {
        // Centre and radius rest on all points, and are linear in them.
        let sd = |at: usize| noise.mean() * joint.covariance[(at, at)].sqrt();
        let exact = [("x", sd(0)), ("y", sd(1)), ("D", sd(2).hypot(settings.bar_u_mm))];
        for (name, sd) in exact {
            if let Some(at) = NAMES.iter().position(|known| *known == name) {
                u95[at] = NORMAL * sd;
            }
        }
    }
    Some(u95)
}

/// Half width from the draws' differences to the value. Noise makes extremes greater, and the value has
/// that bias already: it grows as the noise's standard deviation, so what a second dose of noise adds,
/// divided by sqrt(2) - 1, is what the first one added. NaN when a draw is not a number.
fn half_width(differences: &mut [f64]) -> f64 {
    if differences.is_empty() || differences.iter().any(|value| value.is_nan()) {
        return f64::NAN;
    }
    let count = differences.len();
    let added = differences.iter().sum::<f64>() / count as f64;
    differences.iter_mut().for_each(|value| *value = (*value - added).abs());
    let at = ((SHARE * count as f64).ceil() as usize).clamp(1, count) - 1;
    let spread = *differences.select_nth_unstable_by(at, f64::total_cmp).1;
    added.abs() / (2f64.sqrt() - 1.0) + spread
}

fn outermost_of(rays: &Rays, noise: &Noise, joint: &Circle) -> (Rays, Vec<Vec<f64>>) {
    let mut few = Rays { traces: Vec::new(), pairs: rays.pairs.iter().map(Facing::unresolved).collect() };
    let mut sigma_mm = Vec::new();
    for (trace, sigma) in rays.traces.iter().zip(&noise.sigma_mm) {
        let mut chosen: Vec<usize> =
            if trace.len() > MANY { outermost(trace, joint.centre) } else { (0..trace.len()).collect() };
        chosen.dedup();
        few.traces.push(chosen.iter().map(|&at| trace[at]).collect());
        sigma_mm.push(chosen.iter().map(|&at| sigma[at]).collect());
    }
    (few, sigma_mm)
}
