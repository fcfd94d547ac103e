//! Uncertainties by Monte Carlo (GUM Supplement 1): lengths are drawn about the solution and fitted again.
//!
//! The sources are those of the linearised standard deviations: the noise of the lengths (an estimated standard
//! deviation is drawn from its chi-square distribution), and the uncertainty of the robot.

use rand_distr::{ChiSquared, Distribution, StandardNormal};
use rand_pcg::Pcg64;

use super::estimator::{Estimate, refit};
use super::lengths::Lengths;
use super::posterior::Posterior;
use super::result::{MonteCarlo, ParameterDraws, ParameterResult};
use crate::math::distributions::{COVERAGE_95, NORMAL_DENSITY_AT_975};
use crate::math::map_items;
use crate::robot::ParamId;

/// Each trial has a random stream of its own with this seed.
const SEED: u128 = 1;
/// Probability below a 95 % interval, and above it.
const TAIL: f64 = 0.025;
/// The ends of two intervals disagree if they differ by more than this fraction of the half width
const AGREE: f64 = 0.1;
/// plus this number of standard errors of the drawn end.
const STANDARD_ERRORS: f64 = 4.0;

/// The parameters fitted in each trial.
pub(super) struct Draws {
    trials: usize,
    used: usize,
    ids: Vec<ParamId>,
    /// Sorted values of each parameter.
    values: Vec<Vec<f64>>,
}

impl Draws {
    pub(super) fn of(estimate: &Estimate, lengths: &Lengths, trials: usize) -> Self {
        let draws = draw(estimate, lengths, trials);
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

/// The estimated parameters of each trial. A robot is drawn from the posterior, and its lengths with their noise are
/// estimated again. The difference between that estimate and its first linearisation is added to the drawn robot.
fn draw(estimate: &Estimate, lengths: &Lengths, trials: usize) -> Vec<Vec<f64>> {
    let model = &estimate.fit.model;
    let weighted = estimate.used(lengths);
    let used = weighted.sigmas().enumerate().filter(|(_, sigma)| *sigma != f64::INFINITY);
    let (places, sigma): (Vec<usize>, Vec<f64>) = used.unzip();
    let used = lengths.at(&places);
    let freedom = estimate.freedom.and_then(|freedom| Some((freedom, ChiSquared::new(freedom).ok()?)));
    let posterior = Posterior::with_root(model.clone(), &estimate.kept, estimate.root.clone());
    let numbers: Vec<usize> = (0..trials).collect();
    let drawn = map_items(&numbers, |number| {
        let mut random = Pcg64::new(SEED, *number as u128);
        let normal = |random: &mut Pcg64| -> f64 { StandardNormal.sample(random) };
        let factor =
            freedom.as_ref().map_or(1.0, |(freedom, chi)| (freedom / chi.sample(&mut random)).sqrt());
        let truth = posterior.drawn(|| factor * normal(&mut random));
        let prepared = truth.prepare();
        let exact = |at: usize| prepared.length(&used.reading(at));
        let lengths_mm =
            (0..used.len()).map(|at| exact(at) + factor * sigma[at] * normal(&mut random)).collect();
        let [linear, at_rest] = refit(&used.with_lengths(lengths_mm), estimate)?;
        // To first order the error is a draw from the posterior. The next linearisations add the part that is not
        // linear.
        let value = |id: &ParamId| truth.value(*id) + at_rest.value(*id) - linear.value(*id);
        Some(estimate.kept.iter().map(value).collect())
    });
    drawn.into_iter().flatten().collect()
}

/// Whether an end of the drawn interval differs from the linearised one beyond chance and a tenth of the half width.
fn differ(linear: [f64; 2], drawn: [f64; 2], draws: usize) -> bool {
    let half = 0.5 * (linear[1] - linear[0]);
    // Standard error of a drawn end relative to the half width of the interval.
    let error = (TAIL * (1.0 - TAIL) / draws as f64).sqrt() / NORMAL_DENSITY_AT_975 / COVERAGE_95;
    let most = half * (AGREE + STANDARD_ERRORS * error);
    linear.iter().zip(drawn).any(|(linear, drawn)| (drawn - linear).abs() > most)
}
