//! From lengths to parameters: what can be told, what is too weak, the fit, and the lengths' sigma.

use std::cmp::Ordering;

use super::covariance::{beyond_chance, spread, too_weak, weak_limit};
use super::fit::{self, Fit};
use super::options::{Options, Prior, tolerance};
use super::prior;
use super::solver::PriorRows;
use crate::identifiability::{Analysis, analyse};
use crate::linalg::Triangle;
use crate::model::parameter::{self, SetUp};
use crate::model::{LengthModel, ParamId, Reading, Robot, Selection};

/// Lengths with the standard deviations they are weighted by.
#[derive(Clone, Debug)]
pub(super) struct Lengths {
    pub(super) readings: Vec<Reading>,
    /// As given, mm; 1 where nothing is known.
    pub(super) given: Vec<f64>,
    /// Whether the user vouches for them, so that they are not brought to what the residuals show.
    pub(super) vouched: bool,
    /// Whether anything is known of them at all.
    pub(super) known: bool,
}

/// An estimate, and how it came about.
#[derive(Clone, Debug)]
pub(super) struct Estimate {
    /// The nominal robot with the free part of the set-up fitted.
    pub(super) before: LengthModel,
    pub(super) analysis: Analysis,
    /// Parameters that were estimated, in canonical order.
    pub(super) kept: Vec<ParamId>,
    /// Parameters held because the data are too weak, weakest first.
    pub(super) weak: Vec<ParamId>,
    pub(super) prior: Option<PriorRows>,
    pub(super) fit: Fit,
    /// Standard deviation of each length that the fit went by, mm.
    pub(super) sigma: Vec<f64>,
    /// Degrees of freedom of these, where the residuals gave them; none where they are as given.
    pub(super) freedom: Option<f64>,
}

/// Why there is no estimate.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum IdentifyError {
    /// A number on the way is not finite.
    #[error(
        "a length or its derivative is not finite: check angles, lengths, tool and centres for absurd values"
    )]
    NotFinite,
    /// Nothing asked for can be told.
    #[error(
        "none of the parameters asked for changes a length in these poses; ask for others, or vary the poses"
    )]
    NothingToEstimate,
}

/// The parameters asked for, without the optional groups that nobody named.
pub(super) fn asked(robot: &Robot, set_up: SetUp, options: &Options) -> Vec<ParamId> {
    let mut ids = match &options.estimate {
        Some(list) => list.clone(),
        None => parameter::all(&robot.parallel_joints(), set_up),
    };
    ids.retain(|id| !options.hold.contains(id));
    ids.sort();
    ids
}

/// Estimates what the data tell of `asked`, from the nominal robot and a rough set-up.
pub(super) fn estimate(
    robot: &Robot,
    given_start: &LengthModel,
    lengths: &Lengths,
    asked: &[ParamId],
    options: &Options,
) -> Result<Estimate, IdentifyError> {
    let readings = &lengths.readings;
    let mut set_up = fit::set_up(readings, &lengths.given, asked, given_start);
    let analysis = analyse(&set_up.model, readings, asked).ok_or(IdentifyError::NotFinite)?;
    let base = analysis.kept();
    if base.is_empty() {
        return Err(IdentifyError::NothingToEstimate);
    }
    let follow_list = options.follows_list();
    let mut sigma = if follow_list { lengths.given.clone() } else { first_sigma(lengths, &set_up, &base) };
    let mut start = set_up.model.clone();
    let mut iterations = set_up.iterations;
    let mut implausible: Vec<ParamId> = Vec::new();
    let mut reached: Option<(Vec<ParamId>, Fit, Vec<f64>)> = None;
    for round in 0.. {
        let mut weak = implausible.clone();
        if !follow_list && options.prior == Prior::None {
            let rest: Vec<ParamId> = base.iter().copied().filter(|id| !implausible.contains(id)).collect();
            weak.extend(too_weak(robot, &set_up.model, readings, &rest, &sigma));
        } else if !follow_list {
            weak.extend(weak_bars(robot, &base, &set_up.model, readings, &sigma));
        }
        let kept: Vec<ParamId> = base.iter().copied().filter(|id| !weak.contains(id)).collect();
        if let Some((before, fit, weights)) = reached.take()
            && (round == ROUNDS || before == kept && same_weights(&weights, &sigma, options))
        {
            let prior = prior::rows(robot, options, &analysis, &before, &set_up.model);
            let fit = Fit { iterations, ..fit };
            // When the rounds are up the last judgement has not been acted on.
            weak.retain(|id| !before.contains(id));
            let freedom = (sigma != lengths.given).then(|| {
                let used = fit.used.iter().filter(|used| **used).count();
                used as f64 - if prior.is_some() { base.len() } else { before.len() } as f64
            });
            return Ok(Estimate {
                before: set_up.model,
                analysis,
                kept: before,
                weak,
                prior,
                fit,
                sigma,
                freedom,
            });
        }
        let held = |id: &ParamId| matches!(id, ParamId::BarOffset(_)) && weak.contains(id);
        if base.iter().any(|id| held(id) && set_up.model.value(*id) != given_start.value(*id)) {
            // Without the offset of a bar the balls stand elsewhere.
            let free: Vec<ParamId> = asked.iter().copied().filter(|id| !held(id)).collect();
            set_up = fit::set_up(readings, &lengths.given, &free, given_start);
            start = set_up.model.clone();
        }
        // A parameter held now may have moved in the round before.
        for id in base.iter().filter(|id| !kept.contains(id)) {
            start.shift(*id, set_up.model.value(*id) - start.value(*id));
        }
        let prior = prior::rows(robot, options, &analysis, &kept, &set_up.model);
        let fit = fit::all(readings, &sigma, &kept, prior.as_ref(), &start);
        iterations += fit.iterations;
        let weights = std::mem::take(&mut sigma);
        sigma = match prior {
            // Residuals that the prior has widened say nothing about the lengths.
            Some(_) => first_sigma(lengths, &fit, &base),
            None => shown_sigma(lengths, &fit, kept.len()),
        };
        if !follow_list && options.prior == Prior::None {
            implausible.extend(most_implausible(robot, &set_up.model, &fit, readings, &kept, &sigma));
        }
        start = fit.model.clone();
        reached = Some((kept, fit, weights));
    }
    Err(IdentifyError::NotFinite)
}

/// Rounds of fitting and judging after which the last fit stands.
const ROUNDS: usize = 8;

/// Whether a fit with the new sigmas would be the same: equal to 2 %, or, where no prior stands
/// against them, all changed alike.
fn same_weights(old: &[f64], new: &[f64], options: &Options) -> bool {
    let common = match (options.prior == Prior::None, old, new) {
        (true, [first, ..], [now, ..]) => now / first,
        _ => 1.0,
    };
    old.iter().zip(new).all(|(old, new)| (new / old / common - 1.0).abs() < 0.02)
}

/// The parameter whose correction is least believable, if one is: the data tell it worse than its
/// tolerance, and it is further off than five times what tolerance and data allow together. It
/// carries what the model lacks, or what is held.
fn most_implausible(
    robot: &Robot,
    nominal: &LengthModel,
    fit: &Fit,
    readings: &[Reading],
    kept: &[ParamId],
    sigma: &[f64],
) -> Option<ParamId> {
    let sd = spread(&fit.model, readings, kept, sigma, None)?.data_sd;
    kept.iter()
        .zip(sd)
        .filter_map(|(id, sd)| {
            let tolerance = tolerance(robot, *id)?;
            let off = (fit.model.value(*id) - nominal.value(*id)).abs() / tolerance.hypot(sd);
            (sd > tolerance && off > 5.0).then_some((*id, off))
        })
        .max_by(|(_, a), (_, b)| a.total_cmp(b))
        .map(|(id, _)| id)
}

/// The bars for whose offset the lengths alone are too weak. A prior on the robot must not decide it: on
/// circles of one radius it would turn the maker's tolerance into a length of the bar.
fn weak_bars(
    robot: &Robot,
    base: &[ParamId],
    model: &LengthModel,
    readings: &[Reading],
    sigma: &[f64],
) -> Vec<ParamId> {
    let bars = (0..base.len()).filter(|&at| matches!(base[at], ParamId::BarOffset(_)));
    if bars.clone().next().is_none() {
        return vec![];
    }
    let sd = spread(model, readings, base, sigma, None).map(|spread| spread.data_sd);
    let limit = |id| weak_limit(robot, id).unwrap_or(f64::INFINITY);
    bars.filter(|&bar| sd.as_ref().is_none_or(|sd| sd[bar] > limit(base[bar]))).map(|bar| base[bar]).collect()
}

/// Before the fit: what a linear fit of the base set leaves, or what is given.
fn first_sigma(lengths: &Lengths, set_up: &Fit, base: &[ParamId]) -> Vec<f64> {
    if lengths.vouched {
        return lengths.given.clone();
    }
    let selection = Selection::new(base);
    let mut triangle = Triangle::new(base.len());
    let mut row = vec![0.0; base.len()];
    let mut count = 0;
    let prepared = set_up.model.prepare();
    for (at, reading) in lengths.readings.iter().enumerate().filter(|(at, _)| set_up.used[*at]) {
        let predicted = prepared.row(reading);
        selection.pick(&predicted, reading.centre, &mut row);
        row.iter_mut().for_each(|value| *value /= lengths.given[at]);
        triangle.push(&row, (reading.length - predicted.length) / lengths.given[at]);
        count += 1;
    }
    let freedom = f64::from(count) - base.len() as f64;
    let ratio = if freedom > 0.0 { triangle.residual_sum() / freedom } else { 1.0 };
    let factor = match beyond_chance(ratio, freedom) {
        _ if !lengths.known => ratio.sqrt().max(FLOOR_MM),
        Some(Ordering::Greater) => ratio.sqrt(),
        _ => 1.0,
    };
    lengths.given.iter().map(|sigma| sigma * factor).collect()
}

/// Lengths are not better than this, mm: it keeps exact data from a division by zero.
const FLOOR_MM: f64 = 1e-9;

/// After the fit: what is given, brought to what the residuals show. Where nothing is known, one
/// sigma for all; where the residuals are larger than the given sigmas and chance, a common further
/// deviation (repeatability, what the model lacks) is added in squares (Paule and Mandel, J. Res.
/// NBS 87, 1982).
fn shown_sigma(lengths: &Lengths, fit: &Fit, parameters: usize) -> Vec<f64> {
    if lengths.vouched {
        return lengths.given.clone();
    }
    let prepared = fit.model.prepare();
    let squares: Vec<(f64, f64)> = (0..lengths.readings.len())
        .filter(|&at| fit.used[at])
        .map(|at| {
            let residual = lengths.readings[at].length - prepared.length(&lengths.readings[at]);
            (residual * residual, lengths.given[at] * lengths.given[at])
        })
        .collect();
    let freedom = squares.len() as f64 - parameters as f64;
    if freedom <= 0.0 {
        return lengths.given.clone();
    }
    if !lengths.known {
        let sum: f64 = squares.iter().map(|(r2, _)| r2).sum();
        return vec![(sum / freedom).sqrt().max(FLOOR_MM); lengths.given.len()];
    }
    let chi = |common: f64| squares.iter().map(|(r2, s2)| r2 / (s2 + common)).sum::<f64>();
    if beyond_chance(chi(0.0) / freedom, freedom) != Some(Ordering::Greater) {
        return lengths.given.clone();
    }
    let (mut low, mut high) = (0.0, squares.iter().map(|(r2, _)| r2).sum::<f64>());
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        if chi(middle) > freedom { low = middle } else { high = middle }
    }
    lengths.given.iter().map(|sigma| (sigma * sigma + high).sqrt()).collect()
}
