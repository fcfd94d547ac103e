//! Uncertainties by Monte Carlo (GUM Supplement 1): lengths are drawn about the solution and fitted again.
//!
//! The same sources are drawn that the linearised standard deviations contain: the noise of the lengths (an estimated
//! standard deviation by its chi-square distribution), the errors of poorly observable parameters that were fixed, and the
//! prior.

use rand_distr::{ChiSquared, Distribution, StandardNormal};
use rand_pcg::Pcg64;

use super::estimate::Estimate;
use super::lengths::{Lengths, Sigma};
use super::priors::Priors;
use super::result::{MonteCarlo, ParameterDraws, ParameterResult};
use super::solver::{Loss, Problem, minimise};
use crate::math::distributions::{COVERAGE_95, NORMAL_DENSITY_AT_975};
use crate::math::map_items;
use crate::measurement::{LengthModel, PreparedMeasurement};
use crate::robot::ParamId;

/// Each trial has a random stream of its own with this seed.
const SEED: u128 = 1;
/// Probability below a 95 % interval, and above it.
const TAIL: f64 = 0.025;
/// The ends of two intervals disagree if they differ by more than this fraction of the half width
const AGREE: f64 = 0.1;
/// plus so many standard errors of the drawn end.
const STANDARD_ERRORS: f64 = 4.0;

/// The parameters fitted in each trial.
pub(super) struct Draws {
    trials: usize,
    used: usize,
    ids: Vec<ParamId>,
    /// Sorted, for each parameter.
    values: Vec<Vec<f64>>,
}

impl Draws {
    pub(super) fn of(priors: &Priors, estimate: &Estimate, lengths: &Lengths, trials: usize) -> Self {
        let draws = draw(priors, estimate, lengths, trials);
        let sorted = |k: usize| {
            let mut values: Vec<f64> = draws.iter().map(|values| values[k]).collect();
            values.sort_by(f64::total_cmp);
            values
        };
        Self {
            trials,
            used: draws.len(),
            ids: estimate.kept.clone(),
            values: (0..estimate.kept.len()).map(sorted).collect(),
        }
    }

    /// Standard deviation and 95 % interval of a parameter; `None` if it was not estimated, or with fewer than two draws.
    pub(super) fn parameter(&self, id: ParamId) -> Option<ParameterDraws> {
        let sorted = &self.values[self.ids.iter().position(|other| *other == id)?];
        let n = sorted.len();
        if n < 2 {
            return None;
        }
        let mean = sorted.iter().sum::<f64>() / n as f64;
        let variance = sorted.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (n - 1) as f64;
        // Definition 7 of Hyndman and Fan, The American Statistician 50, 1996.
        let quantile = |share: f64| {
            let place = share * (n - 1) as f64;
            let below = place.floor() as usize;
            let above = (below + 1).min(n - 1);
            sorted[below] + (place - below as f64) * (sorted[above] - sorted[below])
        };
        Some(ParameterDraws { sd: variance.sqrt(), interval95: [quantile(TAIL), quantile(1.0 - TAIL)] })
    }

    /// Compares the drawn intervals with the linearised ones.
    pub(super) fn summary(&self, parameters: &[ParameterResult]) -> MonteCarlo {
        let disagrees = |parameter: &&ParameterResult| {
            let ends = parameter.interval95.zip(parameter.monte_carlo);
            ends.is_some_and(|(linear, drawn)| differ(linear, drawn.interval95, self.used))
        };
        let disagree = parameters.iter().filter(disagrees).map(|parameter| parameter.name).collect();
        MonteCarlo { trials: self.trials, used: self.used, disagree }
    }
}

/// The estimated parameters of each trial whose fit converged.
fn draw(priors: &Priors, estimate: &Estimate, lengths: &Lengths, trials: usize) -> Vec<Vec<f64>> {
    let model = &estimate.fit.model;
    let weighted = estimate.used(lengths);
    let used = weighted.sigmas().enumerate().filter(|(_, sigma)| *sigma != f64::INFINITY);
    let (used, sigma): (Vec<PreparedMeasurement>, Vec<f64>) =
        used.map(|(at, sigma)| (lengths.reading(at), sigma)).unzip();
    let exact = predicted(model, &used);
    let freedom = estimate.noise.freedom.and_then(|freedom| Some((freedom, ChiSquared::new(freedom).ok()?)));
    // With a prior no errors of fixed parameters are in the linearised standard deviations.
    let fixed: &[ParamId] = if estimate.prior.is_some() { &[] } else { &estimate.poorly_observable };
    let numbers: Vec<usize> = (0..trials).collect();
    let drawn = map_items(&numbers, |number| {
        let mut random = Pcg64::new(SEED, *number as u128);
        let normal = |random: &mut Pcg64| -> f64 { StandardNormal.sample(random) };
        let factor =
            freedom.as_ref().map_or(1.0, |(freedom, chi)| (freedom / chi.sample(&mut random)).sqrt());
        let mut readings = exact.clone();
        if !fixed.is_empty() {
            let mut truth = model.clone();
            fixed.iter().for_each(|id| truth.shift(*id, priors.fixed_sd(*id) * normal(&mut random)));
            readings = predicted(&truth, &readings);
        }
        for (reading, sigma) in readings.iter_mut().zip(&sigma) {
            reading.length_mm += factor * sigma * normal(&mut random);
        }
        let prior =
            estimate.prior.as_ref().map(|prior| prior.drawn(model, &estimate.kept, || normal(&mut random)));
        let drawn = Lengths::few(readings, sigma.clone());
        let problem = Problem {
            lengths: drawn.weighted(Sigma::Given, &[]),
            ids: &estimate.kept,
            loss: Loss::Squares,
            prior: prior.as_ref(),
        };
        let solution = minimise(&problem, model);
        let values = estimate.kept.iter().map(|id| solution.model.value(*id)).collect();
        solution.converged.then_some(values)
    });
    drawn.into_iter().flatten().collect()
}

/// The readings with the lengths that a model predicts.
fn predicted(model: &LengthModel, readings: &[PreparedMeasurement]) -> Vec<PreparedMeasurement> {
    let prepared = model.prepare();
    let exact = |reading| PreparedMeasurement { length_mm: prepared.length(reading), ..*reading };
    readings.iter().map(exact).collect()
}

/// Whether an end of the drawn interval differs from the linearised one beyond chance and a tenth of the half width.
fn differ(linear: [f64; 2], drawn: [f64; 2], draws: usize) -> bool {
    let half = 0.5 * (linear[1] - linear[0]);
    // Standard error of a drawn end relative to the half width of the interval.
    let error = (TAIL * (1.0 - TAIL) / draws as f64).sqrt() / NORMAL_DENSITY_AT_975 / COVERAGE_95;
    let most = half * (AGREE + STANDARD_ERRORS * error);
    linear.iter().zip(drawn).any(|(linear, drawn)| (drawn - linear).abs() > most)
}
