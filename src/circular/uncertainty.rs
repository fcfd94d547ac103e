//! Uncertainty: G, F and H are extremes, for which the law of propagation does not hold, and are drawn by Monte Carlo
//! (GUM Supplement 1); centre and radius are linear in the lengths and follow from the fit.

use nalgebra::Vector3;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use super::fit::{Ray, fit};
use super::noise::Noise;
use super::quantities::{Allowed, Facing, Quantities, Rays, evaluate};
use super::smooth::form;
use super::zone::outermost;
use super::{NAMES, Settings, TRACE_NAMES};

/// Traces with more points are drawn by their outermost points alone.
const MANY: usize = 4000;
const SHARE: f64 = 0.95;
/// The same for a normal distribution, in standard deviations.
const NORMAL: f64 = 1.96;
/// Quantities that are never less than none.
const WIDTHS: [&str; 4] = ["G_lsc", "G_mzc", "Gb", "H"];

/// For each value of [`super::quantities::Quantities::row`] the half width of its 95 % interval, mm;
/// `None` without draws.
pub(super) fn u95(
    rays: &Rays,
    values: &Quantities,
    allowed: Allowed,
    noise: &Noise,
    settings: &Settings,
) -> Option<Vec<f64>> {
    if settings.draws < 2 {
        return None;
    }
    let (base, sigma_mm, left) = if rays.traces.iter().any(|trace| trace.len() > MANY) {
        let (few, sigma_mm) = outermost_of(rays, noise);
        (few, sigma_mm, 1.0)
    } else {
        let form = form(rays, &noise.sigma_mm);
        (
            Rays { traces: form.traces, pairs: rays.pairs.clone(), centre: rays.centre },
            noise.sigma_mm.clone(),
            form.left,
        )
    };
    let drawn = draw(&base, &sigma_mm, allowed, settings)?;
    let student = noise.student();
    let mut u95: Vec<f64> =
        drawn.into_iter().map(|mut added| student * half_width(&mut added, left)).collect();
    // A width that noise alone shows as well may be none.
    let few = Settings { draws: settings.draws / 4 + 1, ..*settings };
    let alone = draw(&round(&base), &sigma_mm, allowed, &few)?;
    let names = NAMES.iter().chain(TRACE_NAMES.iter().cycle());
    for (((u95, value), mut alone), name) in u95.iter_mut().zip(values.row()).zip(alone).zip(names) {
        if WIDTHS.contains(name) && value <= student * within(&mut alone) {
            *u95 = u95.max(value);
        }
    }
    let mut linear = |names: &[&str], first: usize, rays: &[Ray], sigma_mm: &[f64]| {
        let deviations = fitted(rays, sigma_mm, settings.bar_u_mm);
        for (name, sd) in ["x", "y", "D"].into_iter().zip(deviations) {
            if let Some(at) = names.iter().position(|known| *known == name) {
                u95[first + at] = student * NORMAL * sd;
            }
        }
    };
    linear(&NAMES, 0, &rays.traces.concat(), &noise.sigma_mm.concat());
    for (at, (rays, sigma_mm)) in rays.traces.iter().zip(&noise.sigma_mm).enumerate() {
        linear(&TRACE_NAMES, NAMES.len() + at * TRACE_NAMES.len(), rays, sigma_mm);
    }
    Some(u95)
}

/// For each value what every draw of noise adds to it, mm; `None` where the points determine no circle.
fn draw(base: &Rays, sigma_mm: &[Vec<f64>], allowed: Allowed, settings: &Settings) -> Option<Vec<Vec<f64>>> {
    let nominal: Vec<f64> = evaluate(base, allowed)?.row().collect();
    let mut random = Pcg64::seed_from_u64(settings.seed);
    let mut added: Vec<Vec<f64>> = vec![Vec::with_capacity(settings.draws); nominal.len()];
    let mut drawn = base.clone();
    for _ in 0..settings.draws {
        let bar: f64 = StandardNormal.sample(&mut random);
        let common = settings.bar_u_mm * bar;
        for ((to, from), sigma) in drawn.traces.iter_mut().zip(&base.traces).zip(sigma_mm) {
            for ((to, from), sigma) in to.iter_mut().zip(from).zip(sigma) {
                let error: f64 = StandardNormal.sample(&mut random);
                to.length_mm = from.length_mm + common + sigma * error;
            }
        }
        let Some(values) = evaluate(&drawn, allowed) else { continue };
        for ((added, value), nominal) in added.iter_mut().zip(values.row()).zip(&nominal) {
            added.push(value - nominal);
        }
    }
    Some(added)
}

/// Half width from what draws of noise added to the value. Noise makes extremes greater, and does so as its standard
/// deviation; of what the form has `left` (a share of the variance) one part of the bias is there before the draw, so that
/// the draw shows sqrt(1 + left) - sqrt(left) of it alone. NaN when a draw is not a number.
fn half_width(added: &mut [f64], left: f64) -> f64 {
    if added.is_empty() || added.iter().any(|value| value.is_nan()) {
        return f64::NAN;
    }
    let count = added.len();
    let mean = added.iter().sum::<f64>() / count as f64;
    let unseen = mean / ((1.0 + left).sqrt() - left.sqrt()) - mean;
    added.iter_mut().for_each(|value| *value = (*value + unseen).abs());
    within(added)
}

/// What 95 % of the values do not exceed; NaN without values.
fn within(values: &mut [f64]) -> f64 {
    let at = ((SHARE * values.len() as f64).ceil() as usize).clamp(1, values.len().max(1)) - 1;
    if at < values.len() { *values.select_nth_unstable_by(at, f64::total_cmp).1 } else { f64::NAN }
}

/// The rays on a circle without any deviation.
fn round(rays: &Rays) -> Rays {
    let mut round = rays.clone();
    round.traces.iter_mut().flatten().for_each(|ray| ray.length_mm = ray.reach(rays.centre).0);
    round
}

/// Standard uncertainties of x, y and D of the circle through the rays, mm; `bar_mm` is common to all lengths and so in D alone.
fn fitted(rays: &[Ray], sigma_mm: &[f64], bar_mm: f64) -> [f64; 3] {
    let Some(circle) = fit(rays.iter().copied()) else { return [f64::NAN; 3] };
    let mut variance = [0.0, 0.0, bar_mm * bar_mm];
    for (ray, sigma) in rays.iter().zip(sigma_mm) {
        let [x, y] = ray.reach(circle.centre).1;
        let change = circle.covariance * Vector3::new(-x, -y, 1.0);
        variance.iter_mut().zip(&change).for_each(|(sum, change)| *sum += (sigma * change).powi(2));
    }
    variance.map(f64::sqrt)
}

fn outermost_of(rays: &Rays, noise: &Noise) -> (Rays, Vec<Vec<f64>>) {
    let pairs = rays.pairs.iter().map(Facing::unresolved).collect();
    let mut few = Rays { traces: Vec::new(), pairs, centre: rays.centre };
    let mut sigma_mm = Vec::new();
    for (trace, sigma) in rays.traces.iter().zip(&noise.sigma_mm) {
        let mut chosen: Vec<usize> =
            if trace.len() > MANY { outermost(trace, rays.centre) } else { (0..trace.len()).collect() };
        chosen.dedup();
        few.traces.push(chosen.iter().map(|&at| trace[at]).collect());
        sigma_mm.push(chosen.iter().map(|&at| sigma[at]).collect());
    }
    (few, sigma_mm)
}
