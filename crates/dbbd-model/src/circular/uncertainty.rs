//! Uncertainty. G, F and H are extremes, for which the law of propagation does not hold: Monte Carlo (GUM Supplement
//! 1). Centre and radius are linear in the lengths and follow from the fit.
//!
//! The Monte Carlo draws about a smoothed form of the circle. If it drew about the lengths, an extreme that noise has
//! raised would be raised again, and the noise would seem to add least where it has added most. Only the intervals use
//! the smoothed form.

use nalgebra::Vector3;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use super::noise::TraceNoise;
use super::quantities::{
    FacingTraces, FitConditions, QUANTITY_NAMES, QuantityValues, RadialTraces, TRACE_NAMES, evaluate,
};
use super::reference_circle::{RadialMeasurement, fit_circle, outermost};
use super::trace::CircularSettings;
use crate::math::distributions::COVERAGE_95;

/// If a trace has more points than this, only its outermost points are drawn.
const MANY: usize = 4000;
const SHARE: f64 = 0.95;
/// Quantities that are not negative.
const WIDTHS: [&str; 4] = ["G_lsc", "G_mzc", "Gb", "H"];

/// The half widths of the 95 % intervals of the values of [`QuantityValues::row`], mm; `None` without draws.
pub(super) fn u95(
    rays: &RadialTraces,
    values: &QuantityValues,
    allowed: FitConditions,
    noise: &TraceNoise,
    settings: &CircularSettings,
) -> Option<Vec<f64>> {
    if settings.draws < 2 {
        return None;
    }
    let (base, sigma_mm, left) = if rays.traces.iter().any(|trace| trace.len() > MANY) {
        let (few, sigma_mm) = outermost_of(rays, noise);
        (few, sigma_mm, 1.0)
    } else {
        let (traces, left) = smoothed(rays, &noise.sigma_mm);
        let base = RadialTraces { traces, pairs: rays.pairs.clone(), centre: rays.centre };
        (base, noise.sigma_mm.clone(), left)
    };
    let drawn = draw_noise(&base, &sigma_mm, allowed, settings)?;
    let student = noise.student();
    let mut u95: Vec<f64> =
        drawn.into_iter().map(|mut added| student * half_width(&mut added, left)).collect();
    // A width that noise alone can cause may be zero.
    let few = CircularSettings { draws: settings.draws / 4 + 1, ..*settings };
    let alone = draw_noise(&round(&base), &sigma_mm, allowed, &few)?;
    let names = QUANTITY_NAMES.iter().chain(TRACE_NAMES.iter().cycle());
    for (((u95, value), mut alone), name) in u95.iter_mut().zip(values.row()).zip(alone).zip(names) {
        if WIDTHS.contains(name) && value <= student * within(&mut alone) {
            *u95 = u95.max(value);
        }
    }
    let mut linear = |names: &[&str], first: usize, rays: &[RadialMeasurement], sigma_mm: &[f64]| {
        let deviations = fitted(rays, sigma_mm, settings.bar_u_mm);
        for (name, sd) in ["x", "y", "D"].into_iter().zip(deviations) {
            if let Some(at) = names.iter().position(|known| *known == name) {
                u95[first + at] = student * COVERAGE_95 * sd;
            }
        }
    };
    linear(&QUANTITY_NAMES, 0, &rays.traces.concat(), &noise.sigma_mm.concat());
    for (at, (rays, sigma_mm)) in rays.traces.iter().zip(&noise.sigma_mm).enumerate() {
        linear(&TRACE_NAMES, QUANTITY_NAMES.len() + at * TRACE_NAMES.len(), rays, sigma_mm);
    }
    Some(u95)
}

/// Candidate numbers of neighbours on either side for the smoothing.
const REACHES: [usize; 8] = [0, 1, 2, 3, 4, 6, 8, 12];

/// The traces with their deviations replaced by means over neighbours, and the share of the variance of the noise that
/// is left. The number of neighbours has the least expected squared error by Stein's unbiased estimate.
fn smoothed(rays: &RadialTraces, sigma_mm: &[Vec<f64>]) -> (Vec<Vec<RadialMeasurement>>, f64) {
    let RadialTraces { traces, centre, .. } = rays;
    let deviations: Vec<Vec<f64>> =
        traces.iter().map(|trace| trace.iter().map(|ray| ray.deviation(*centre)).collect()).collect();
    let mut best = (f64::INFINITY, 0, 1.0);
    for reach in REACHES {
        let (mut risk, mut left, mut count) = (0.0, 0.0, 0.0);
        for (deviations, sigma_mm) in deviations.iter().zip(sigma_mm) {
            for ((at, deviation), sigma) in deviations.iter().enumerate().zip(sigma_mm) {
                let (mean, weight) = mean(deviations, at, reach);
                risk += (deviation - mean).powi(2) + 2.0 * sigma * sigma * weight;
                left += weight;
                count += 1.0;
            }
        }
        if risk < best.0 {
            best = (risk, reach, left / count);
        }
    }
    let (_, reach, left) = best;
    let traces = traces
        .iter()
        .zip(&deviations)
        .map(|(trace, deviations)| {
            let smooth = |(at, ray): (usize, &RadialMeasurement)| {
                let length_mm = ray.length_mm - deviations[at] + mean(deviations, at, reach).0;
                RadialMeasurement { length_mm, ..*ray }
            };
            trace.iter().enumerate().map(smooth).collect()
        })
        .collect();
    (traces, left)
}

/// The mean over a point and its neighbours, and the weight of each.
fn mean(values: &[f64], at: usize, reach: usize) -> (f64, f64) {
    let reach = reach.min(at).min(values.len() - 1 - at);
    let weight = 1.0 / (2 * reach + 1) as f64;
    (values[at - reach..=at + reach].iter().sum::<f64>() * weight, weight)
}

/// The change of each value by each draw of noise, mm; `None` if the points determine no circle.
fn draw_noise(
    base: &RadialTraces,
    sigma_mm: &[Vec<f64>],
    allowed: FitConditions,
    settings: &CircularSettings,
) -> Option<Vec<Vec<f64>>> {
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

/// The half width from the changes of a value by draws of noise. Noise increases extremes in proportion to its standard
/// deviation. The smoothed form still has the share `left` of the variance of the noise. So a part of the bias is there
/// before the draw, and the draw shows only sqrt(1 + left) - sqrt(left) of the bias. NaN if a draw is not a number.
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

/// The 95th percentile; NaN without values.
fn within(values: &mut [f64]) -> f64 {
    let at = ((SHARE * values.len() as f64).ceil() as usize).clamp(1, values.len().max(1)) - 1;
    if at < values.len() { *values.select_nth_unstable_by(at, f64::total_cmp).1 } else { f64::NAN }
}

/// The rays without any deviation.
fn round(rays: &RadialTraces) -> RadialTraces {
    let mut round = rays.clone();
    round.traces.iter_mut().flatten().for_each(|ray| ray.length_mm = ray.reach(rays.centre).0);
    round
}

/// Standard uncertainties of x, y and D of the fitted circle, mm. `bar_mm` is common to all lengths and affects D only.
fn fitted(rays: &[RadialMeasurement], sigma_mm: &[f64], bar_mm: f64) -> [f64; 3] {
    let Some(circle) = fit_circle(rays.iter().copied()) else { return [f64::NAN; 3] };
    let mut variance = [0.0, 0.0, bar_mm * bar_mm];
    for (ray, sigma) in rays.iter().zip(sigma_mm) {
        let [x, y] = ray.reach(circle.centre).1;
        let change = circle.covariance * Vector3::new(-x, -y, 1.0);
        variance.iter_mut().zip(&change).for_each(|(sum, change)| *sum += (sigma * change).powi(2));
    }
    variance.map(f64::sqrt)
}

fn outermost_of(rays: &RadialTraces, noise: &TraceNoise) -> (RadialTraces, Vec<Vec<f64>>) {
    let pairs = rays.pairs.iter().map(FacingTraces::unresolved).collect();
    let mut few = RadialTraces { traces: Vec::new(), pairs, centre: rays.centre };
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

#[cfg(test)]
mod tests {
    use super::*;

    use super::super::trace::{CirclePoint, CircleSense, CircleTrace};

    fn rays(deviations: &[f64]) -> RadialTraces {
        let step = 360.0 / deviations.len() as f64;
        let point = |(at, deviation): (usize, &f64)| CirclePoint {
            angle_deg: step * at as f64,
            length_mm: 100.0 + deviation,
            sigma_mm: None,
            t_s: None,
            temp_c: None,
            axes_deg: None,
            drives: None,
        };
        let points = deviations.iter().enumerate().map(point).collect();
        RadialTraces::new(&[CircleTrace { run: "1".into(), sense: CircleSense::Clockwise, points }], 100.0)
    }

    #[test]
    fn means_over_neighbours_are_symmetric() {
        let values = [1.0, 2.0, 4.0, 8.0, 16.0];
        for (reach, sum, count) in [(0, 4.0, 1.0), (1, 14.0, 3.0), (2, 31.0, 5.0)] {
            let (mean, weight) = mean(&values, 2, reach);
            assert!((mean - sum / count).abs() < 1e-14 && (weight - 1.0 / count).abs() < 1e-15);
        }
        // At the ends there are fewer neighbours on both sides.
        assert_eq!([mean(&values, 0, 3), mean(&values, 4, 3)], [(1.0, 1.0), (16.0, 1.0)]);
        assert_eq!(mean(&values, 3, 3), (28.0 * (1.0 / 3.0), 1.0 / 3.0));
    }

    /// The rank of the 95th percentile of 20 values is 19.
    #[test]
    fn within_is_the_95th_percentile() {
        let mut values: Vec<f64> = (1..=20).rev().map(f64::from).collect();
        assert_eq!(within(&mut values), 19.0);
        let mut values: Vec<f64> = (1..=21).map(f64::from).collect();
        assert_eq!(within(&mut values), 20.0);
        assert_eq!(within(&mut [3.0]), 3.0);
        assert!(within(&mut []).is_nan());
    }

    /// The draws show sqrt(1 + left) - sqrt(left) of the bias: with left = 9/16 that is 1/2, so a mean of 2 becomes 4.
    #[test]
    fn half_width_contains_the_bias_that_the_draws_do_not_show() {
        assert_eq!(half_width(&mut [1.0, 2.0, 3.0], 0.5625), 5.0);
        assert_eq!(half_width(&mut [1.0, 2.0, 3.0], 0.0), 3.0);
        assert_eq!(half_width(&mut [-1.0, 1.0], 1.0), 1.0);
        assert!(half_width(&mut [1.0, f64::NAN], 0.0).is_nan() && half_width(&mut [], 0.0).is_nan());
    }

    /// n points around: var x = var y = 2 sigma^2 / n, var D = sigma^2 / n + u_bar^2.
    #[test]
    fn centre_and_radius_have_their_linear_uncertainties() {
        let found = fitted(&rays(&[0.0; 18]).traces[0], &[0.003; 18], 0.004);
        let mean = 0.003 / 18f64.sqrt();
        for (found, expected) in
            found.into_iter().zip([2f64.sqrt() * mean, 2f64.sqrt() * mean, mean.hypot(0.004)])
        {
            assert!((found - expected).abs() < 1e-12, "{found} for {expected}");
        }
        assert!(fitted(&[], &[], 0.0)[0].is_nan());
    }

    #[test]
    fn smoothing_removes_noise_and_keeps_a_form() {
        // The mean of nine values of alternating sign is a ninth; the ends keep their own.
        let noise: Vec<f64> = (0..60).map(|at| if at % 2 == 0 { 0.002 } else { -0.002 }).collect();
        let (traces, left) = smoothed(&rays(&noise), &[vec![0.002; 60]]);
        assert!(left < 0.2, "{left}");
        let middle = traces[0][30].deviation([0.0; 2]);
        assert!((middle - 0.002 / 9.0).abs() < 1e-9, "{middle}");
        // A step that is much larger than the noise stays.
        let step: Vec<f64> = (0..60).map(|at| if at < 30 { 0.0 } else { 0.5 }).collect();
        let (traces, left) = smoothed(&rays(&step), &[vec![1e-4; 60]]);
        assert_eq!(left, 1.0);
        assert!((traces[0][30].deviation([0.0; 2]) - 0.5).abs() < 1e-9);
    }

    #[test]
    fn a_round_circle_has_no_deviation() {
        let mut rays = rays(&[0.1, -0.2, 0.3, 0.0]);
        rays.centre = [0.5, 0.0];
        let found = round(&rays);
        assert!((0..4).all(|at| found.deviation(0, at) == 0.0));
        let noise = TraceNoise {
            sigma_mm: vec![vec![0.001, 0.002, 0.003, 0.004]],
            source: crate::circular::noise::LengthSigmaSource::Given,
            freedom: None,
        };
        let (few, sigma_mm) = outermost_of(&rays, &noise);
        assert_eq!((few.traces, sigma_mm), (rays.traces.clone(), noise.sigma_mm));
    }

    /// sd of the mean of n draws: the bar's uncertainty is common, that of the lengths is averaged.
    #[test]
    fn draws_have_the_standard_deviations_of_lengths_and_bar() {
        let rays = rays(&[0.0; 16]);
        let allowed = FitConditions { free_centre: true, full: true, both: true };
        let settings = CircularSettings { draws: 4000, bar_u_mm: 0.003, ..CircularSettings::new(100.0) };
        let added = draw_noise(&rays, &[vec![0.008; 16]], allowed, &settings).unwrap();
        let of = |name: &str| {
            let at = QUANTITY_NAMES.iter().position(|known| *known == name).unwrap();
            (added[at].iter().map(|value| value * value).sum::<f64>() / 4000.0).sqrt()
        };
        // The standard deviation of an estimate from 4000 draws is 1.1 %.
        for (name, expected) in
            [("D", 0.002f64.hypot(0.003)), ("x", 0.008 / 8f64.sqrt()), ("y", 0.008 / 8f64.sqrt())]
        {
            assert!((of(name) / expected - 1.0).abs() < 0.05, "{name}: {} for {expected}", of(name));
        }
    }
}
