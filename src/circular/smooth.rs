//! The form of a circle with less noise than the lengths have: what the Monte Carlo draws about.
//!
//! Drawn about the lengths themselves, an extreme that noise has raised is drawn too high again, and what noise
//! adds to it seems least just where it added most. Only intervals rest on this; values are never smoothed.

use super::fit::Ray;
use super::quantities::Rays;

pub(super) struct Form {
    /// The traces with their deviations replaced by means over neighbours.
    pub(super) traces: Vec<Vec<Ray>>,
    /// Share of the lengths' variance of noise that is left in it.
    pub(super) left: f64,
}

/// Neighbours on either side that may be taken, in the order driven.
const REACHES: [usize; 8] = [0, 1, 2, 3, 4, 6, 8, 12];

/// The means over as many neighbours as the least expected error asks for: Stein's unbiased estimate of it,
/// the squared change less the noise taken out.
pub(super) fn form(rays: &Rays, sigma_mm: &[Vec<f64>]) -> Form {
    let Rays { traces, centre, .. } = rays;
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
            let smooth = |(at, ray): (usize, &Ray)| {
                let length_mm = ray.length_mm - deviations[at] + mean(deviations, at, reach).0;
                Ray { length_mm, ..*ray }
            };
            trace.iter().enumerate().map(smooth).collect()
        })
        .collect();
    Form { traces, left }
}

/// Mean over the neighbours, as many on either side, and the weight of each.
fn mean(values: &[f64], at: usize, reach: usize) -> (f64, f64) {
    let reach = reach.min(at).min(values.len() - 1 - at);
    let weight = 1.0 / (2 * reach + 1) as f64;
    (values[at - reach..=at + reach].iter().sum::<f64>() * weight, weight)
}
