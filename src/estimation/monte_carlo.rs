//! Uncertainties by Monte Carlo (GUM supplement 1): lengths are drawn about the solution and fitted anew.
//!
//! What the linear standard deviations count is drawn: the lengths' noise (with a sigma that was itself
//! estimated, by its chi-square), the tolerance of what was fixed as poorly observable, and the rows of the prior.

use rand_distr::{ChiSquared, Distribution, StandardNormal};
use rand_pcg::Pcg64;

use super::estimate::Estimate;
use super::lengths::{Lengths, Sigma};
use super::priors::Priors;
use super::result::{MonteCarlo, ParameterDraws, ParameterResult};
use super::solver::{Loss, Problem, minimise};
use crate::math::map_items;
use crate::measurement::{LengthModel, PreparedMeasurement};
use crate::robot::ParamId;

/// Every trial has a stream of this seed.
const SEED: u128 = 1;
/// Half of the 5 % outside an interval.
const TAIL: f64 = 0.025;
/// Ends of intervals that differ by more than this share of the half width disagree,
const AGREE: f64 = 0.1;
/// and by more than so many standard errors of the drawn end.
const CHANCE: f64 = 4.0;
/// Density of the standard normal distribution at 1.96.
const DENSITY: f64 = 0.058_4;

/// What fits of drawn data sets scatter by.
pub(super) struct Draws {
    trials: usize,
    used: usize,
    ids: Vec<ParamId>,
    /// Of each parameter, sorted.
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

    /// Of a parameter; `None` of one that was not estimated, or fewer than two draws.
    pub(super) fn parameter(&self, id: ParamId) -> Option<ParameterDraws> {
        let at = self.ids.iter().position(|other| *other == id)?;
        scatter(&self.values[at])
    }

    /// Beside the linear intervals.
    pub(super) fn summary(&self, parameters: &[ParameterResult]) -> MonteCarlo {
        let disagrees = |parameter: &&ParameterResult| {
            let ends = parameter.interval95.zip(parameter.monte_carlo);
            ends.is_some_and(|(linear, drawn)| differ(linear, drawn.interval95, self.used))
        };
        let disagree = parameters.iter().filter(disagrees).map(|parameter| parameter.id).collect();
        MonteCarlo { trials: self.trials, used: self.used, disagree }
    }
}

/// The estimated parameters of each trial whose fit came to rest.
fn draw(priors: &Priors, estimate: &Estimate, lengths: &Lengths, trials: usize) -> Vec<Vec<f64>> {
    let model = &estimate.fit.model;
    let weighted = estimate.used(lengths);
    let used = weighted.sigmas().enumerate().filter(|(_, sigma)| *sigma != f64::INFINITY);
    let (used, sigma): (Vec<PreparedMeasurement>, Vec<f64>) =
        used.map(|(at, sigma)| (lengths.reading(at), sigma)).unzip();
    let exact: Vec<PreparedMeasurement> = predicted(model, used.into_iter());
    let freedom = estimate.noise.freedom.and_then(|freedom| Some((freedom, ChiSquared::new(freedom).ok()?)));
    // Where a prior carries what is weak, nothing fixed leaks into the linear figures either.
    let fixed: Vec<_> = if estimate.prior.is_some() { vec![] } else { estimate.poorly_observable.clone() };
    let trial = |number: usize| {
        let mut random = Pcg64::new(SEED, number as u128);
        let normal = |random: &mut Pcg64| -> f64 { StandardNormal.sample(random) };
        let factor =
            freedom.as_ref().map_or(1.0, |(freedom, chi)| (freedom / chi.sample(&mut random)).sqrt());
        let mut readings = exact.clone();
        if !fixed.is_empty() {
            let mut truth = model.clone();
            fixed.iter().for_each(|id| truth.shift(*id, priors.fixed_sd(*id) * normal(&mut random)));
            readings = predicted(&truth, readings.into_iter());
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
        solution.converged.then(|| estimate.kept.iter().map(|id| solution.model.value(*id)).collect())
    };
    let numbers: Vec<usize> = (0..trials).collect();
    map_items(&numbers, |number| trial(*number)).into_iter().flatten().collect()
}

/// The readings with the lengths that a model predicts.
fn predicted(
    model: &LengthModel,
    readings: impl Iterator<Item = PreparedMeasurement>,
) -> Vec<PreparedMeasurement> {
    let prepared = model.prepare();
    readings.map(|reading| PreparedMeasurement { length_mm: prepared.length(&reading), ..reading }).collect()
}

/// Standard deviation and 95 % interval of sorted draws; `None` of fewer than two.
fn scatter(sorted: &[f64]) -> Option<ParameterDraws> {
    let n = sorted.len();
    if n < 2 {
        return None;
    }
    let mean = sorted.iter().sum::<f64>() / n as f64;
    let variance = sorted.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (n - 1) as f64;
    // Between the two draws beside the place (Hyndman and Fan's seventh definition, The American Statistician 50, 1996).
    let quantile = |share: f64| {
        let place = share * (n - 1) as f64;
        let below = place.floor() as usize;
        let above = (below + 1).min(n - 1);
        sorted[below] + (place - below as f64) * (sorted[above] - sorted[below])
    };
    Some(ParameterDraws { sd: variance.sqrt(), interval95: [quantile(TAIL), quantile(1.0 - TAIL)] })
}

/// Whether an end of the drawn interval is further from the linear one than chance and a tenth of its half width.
fn differ(linear: [f64; 2], drawn: [f64; 2], draws: usize) -> bool {
    let half = 0.5 * (linear[1] - linear[0]);
    // Standard error of a drawn end, as a share of the half width of 1.96 standard deviations.
    let error = (TAIL * (1.0 - TAIL) / draws as f64).sqrt() / DENSITY / 1.96;
    linear.iter().zip(drawn).any(|(linear, drawn)| (drawn - linear).abs() > half * (AGREE + CHANCE * error))
}
