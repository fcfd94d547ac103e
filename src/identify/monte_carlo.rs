//! Uncertainties by Monte Carlo (GUM supplement 1): lengths are drawn about the solution and fitted anew.
//!
//! What the linear standard deviations count is drawn: the lengths' noise (with a sigma that was itself
//! estimated, by its chi-square), the tolerance of what was held as too weak, and the rows of the prior.

use nalgebra::DVector;
use rand_distr::{ChiSquared, Distribution, StandardNormal};
use rand_pcg::Pcg64;

use super::estimate::Estimate;
use super::lengths::{Lengths, Sigma};
use super::options::Tolerances;
use super::prior::PriorRows;
use super::result::{Identification, MonteCarlo, ParameterDraws, Warning, WarningKind};
use super::solver::{Loss, Problem, minimise};
use crate::linalg::map_items;
use crate::model::{LengthModel, ParamId, Reading};

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

/// Draws `trials` data sets and writes what they scatter by into the result, beside the linear figures.
pub(super) fn tell(
    result: &mut Identification,
    tolerances: Tolerances,
    estimate: &Estimate,
    lengths: &Lengths,
    trials: usize,
) {
    let draws = draw(tolerances, estimate, lengths, trials);
    let drawn = draws.len();
    let mut disagree = Vec::new();
    for (k, id) in estimate.kept.iter().enumerate() {
        let name = id.to_string();
        let Some(parameter) = result.parameters.iter_mut().find(|parameter| parameter.name == name) else {
            continue;
        };
        let mut values: Vec<f64> = draws.iter().map(|values| values[k]).collect();
        values.sort_by(f64::total_cmp);
        let Some(told) = told(&values) else { continue };
        if let Some(linear) = parameter.interval95
            && differ(linear, told.interval95, drawn)
        {
            disagree.push(name);
        }
        parameter.monte_carlo = Some(told);
    }
    let mut say = |kind, text| result.warnings.push(Warning { kind, text });
    if drawn < trials {
        let failed = trials - drawn;
        say(
            WarningKind::Doubt,
            format!("{failed} of {trials} Monte Carlo fits did not come to rest and do not count"),
        );
    }
    if !disagree.is_empty() {
        say(
            WarningKind::Note,
            format!(
                "Monte Carlo and linear 95 % intervals disagree for {}: the lengths bend there; go by the Monte Carlo's",
                disagree.join(", ")
            ),
        );
    }
    result.monte_carlo = Some(MonteCarlo { trials, used: drawn, disagree });
}

/// The estimated parameters of each trial whose fit came to rest.
fn draw(tolerances: Tolerances, estimate: &Estimate, lengths: &Lengths, trials: usize) -> Vec<Vec<f64>> {
    let model = &estimate.fit.model;
    let weighted = estimate.used(lengths);
    let used = weighted.sigmas().enumerate().filter(|(_, sigma)| *sigma != f64::INFINITY);
    let (used, sigma): (Vec<Reading>, Vec<f64>) =
        used.map(|(at, sigma)| (lengths.reading(at), sigma)).unzip();
    let exact: Vec<Reading> = predicted(model, used.into_iter());
    let freedom = estimate.freedom.and_then(|freedom| Some((freedom, ChiSquared::new(freedom).ok()?)));
    // Where a prior carries what is weak, nothing held leaks into the linear figures either.
    let held: Vec<_> = if estimate.prior.is_some() { vec![] } else { estimate.weak.clone() };
    let trial = |number: usize| {
        let mut random = Pcg64::new(SEED, number as u128);
        let normal = |random: &mut Pcg64| -> f64 { StandardNormal.sample(random) };
        let factor =
            freedom.as_ref().map_or(1.0, |(freedom, chi)| (freedom / chi.sample(&mut random)).sqrt());
        let mut readings = exact.clone();
        if !held.is_empty() {
            let mut truth = model.clone();
            held.iter().for_each(|id| truth.shift(*id, tolerances.held(*id) * normal(&mut random)));
            readings = predicted(&truth, readings.into_iter());
        }
        for (reading, sigma) in readings.iter_mut().zip(&sigma) {
            reading.length += factor * sigma * normal(&mut random);
        }
        let prior =
            estimate.prior.as_ref().map(|prior| about(prior, model, &estimate.kept, || normal(&mut random)));
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
fn predicted(model: &LengthModel, readings: impl Iterator<Item = Reading>) -> Vec<Reading> {
    let prepared = model.prepare();
    readings.map(|reading| Reading { length: prepared.length(&reading), ..reading }).collect()
}

/// The same prior about a draw around the model.
fn about(
    prior: &PriorRows,
    model: &LengthModel,
    ids: &[ParamId],
    mut normal: impl FnMut() -> f64,
) -> PriorRows {
    let mut mean = DVector::from_fn(ids.len(), |k, _| model.value(ids[k]));
    for k in prior.bound() {
        mean[k] += normal() / prior.weights[k];
    }
    PriorRows { weights: prior.weights.clone(), mean }
}

/// Standard deviation and 95 % interval of sorted draws; `None` of fewer than two.
fn told(sorted: &[f64]) -> Option<ParameterDraws> {
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
