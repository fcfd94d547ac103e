//! From lengths to parameters: what can be told, what is too weak, the fit, and the lengths' sigma.

use super::covariance::{spread, too_weak};
use super::fit::{self, Fit};
use super::lengths::{Lengths, Sigma, Weighted};
use super::options::{Options, Prior, Tolerances, tolerance};
use super::places::{hardly_told, is_place, well_told};
use super::prior::{self, PriorRows};
use super::sigma::{first_sigma, shown_sigma};
use crate::identifiability::{Analysis, analyse};
use crate::model::parameter::{self, SetUp};
use crate::model::{LengthModel, ParamId, Robot};

/// An estimate, and how it came about.
#[derive(Clone, Debug)]
pub(super) struct Estimate {
    /// The nominal robot with the free part of the set-up fitted.
    pub(super) before: LengthModel,
    pub(super) analysis: Analysis,
    /// Parameters that were estimated, in canonical order.
    pub(super) kept: Vec<ParamId>,
    /// Those of them that are independent for the lengths alone; a prior shares what is told among more.
    pub(super) base: Vec<ParamId>,
    /// Parameters held because the data are too weak, weakest first.
    pub(super) weak: Vec<ParamId>,
    pub(super) prior: Option<PriorRows>,
    pub(super) fit: Fit,
    /// The standard deviations of the lengths that the fit went by.
    pub(super) sigma: Sigma,
    /// Degrees of freedom of these, where the residuals gave them; none where they are as given.
    pub(super) freedom: Option<f64>,
}

impl Estimate {
    /// One standard deviation of a parameter before the lengths; `None` of what is free or not estimated.
    pub(super) fn prior_sd(&self, id: ParamId) -> Option<f64> {
        self.prior.as_ref()?.sd(self.kept.iter().position(|kept| *kept == id)?)
    }

    /// The lengths that the fit used, as it weighed them.
    pub(super) fn used<'a>(&'a self, lengths: &'a Lengths) -> Weighted<'a> {
        lengths.weighted(self.sigma, &self.fit.out)
    }
}

/// Why there is no estimate.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum IdentifyError {
    /// A number on the way is not finite.
    #[error(
        "a length or its derivative is not finite: check angles, lengths, sigmas, tool and centres for absurd values"
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

/// Which parameters an estimate is of.
#[derive(Clone, Debug, PartialEq)]
struct Choice {
    kept: Vec<ParamId>,
    base: Vec<ParamId>,
    weak: Vec<ParamId>,
    /// Bars whose offset the lengths do not tell, so that a prior binds it.
    untold_bars: Vec<ParamId>,
}

/// Estimates what the data tell of `asked`, from the nominal robot and a rough set-up.
pub(super) fn estimate(
    robot: &Robot,
    given_start: &LengthModel,
    lengths: &Lengths,
    asked: &[ParamId],
    options: &Options,
) -> Result<Estimate, IdentifyError> {
    let follow_list = options.follows_list();
    let mut loose = Vec::new();
    let mut free = asked.to_vec();
    if !follow_list {
        free = well_told(robot, given_start, &lengths.plain(), asked).ok_or(IdentifyError::NotFinite)?;
    }
    let mut set_up = fit::set_up(lengths, &free, given_start);
    let analysis = loop {
        let judged: Vec<ParamId> = asked.iter().copied().filter(|id| !loose.contains(id)).collect();
        let analysis = analyse(&set_up.model, &lengths.plain(), &judged).ok_or(IdentifyError::NotFinite)?;
        let places: Vec<ParamId> = analysis.kept().into_iter().filter(is_place).collect();
        let more =
            if follow_list { vec![] } else { hardly_told(robot, &set_up.model, &lengths.plain(), places) };
        if more.is_empty() {
            break analysis;
        }
        loose.extend(more);
    };
    let base = analysis.kept();
    if base.is_empty() {
        return Err(IdentifyError::NothingToEstimate);
    }
    let mut sigma = if follow_list { Sigma::Given } else { first_sigma(lengths, &set_up, &base) };
    let mut start = set_up.model.clone();
    let mut iterations = set_up.iterations;
    let mut implausible: Vec<ParamId> = loose.clone();
    let mut reached: Option<(Choice, Fit, Sigma)> = None;
    for round in 0.. {
        let weighted = lengths.weighted(sigma, &[]);
        let choice = match options.prior {
            Prior::None if follow_list => Choice::all(&base),
            Prior::None => {
                Choice::told(options.tolerances(robot), &set_up.model, &weighted, &base, &implausible)
            }
            _ => Choice::bound(robot, &set_up.model, &weighted, (&analysis, &base), &loose, options),
        };
        if let Some((before, fit, weights)) = reached.take()
            && (round == ROUNDS || before == choice && same_weights(lengths, weights, sigma, options))
        {
            let prior = prior::rows(robot, options, &before.untold_bars, &before.kept, given_start);
            let freedom = (sigma != Sigma::Given)
                .then(|| lengths.weighted(sigma, &fit.out).count() as f64 - before.base.len() as f64);
            return Ok(Estimate {
                before: set_up.model,
                analysis,
                kept: before.kept,
                base: before.base,
                weak: before.weak,
                prior,
                fit: Fit { iterations, ..fit },
                sigma,
                freedom,
            });
        }
        let bars: Vec<ParamId> =
            choice.weak.iter().chain(&choice.untold_bars).copied().filter(is_bar).collect();
        if bars.iter().any(|id| set_up.model.value(*id) != given_start.value(*id)) {
            // Without the offset of a bar the balls stand elsewhere.
            free.retain(|id| !bars.contains(id));
            set_up = fit::set_up(lengths, &free, given_start);
            start = set_up.model.clone();
        }
        // A parameter held now may have moved in the round before.
        for id in base.iter().filter(|id| !choice.kept.contains(id)) {
            start.shift(*id, set_up.model.value(*id) - start.value(*id));
        }
        let prior = prior::rows(robot, options, &choice.untold_bars, &choice.kept, given_start);
        let fit = fit::all(lengths, sigma, (&choice.kept, choice.base.len()), prior.as_ref(), &start);
        iterations += fit.iterations;
        let weights = sigma;
        sigma = match prior {
            // Residuals that the prior has widened say nothing about the lengths.
            Some(_) => first_sigma(lengths, &fit, &base),
            None => shown_sigma(lengths, &fit, choice.kept.len()),
        };
        if !follow_list && options.prior == Prior::None {
            let weighted = lengths.weighted(sigma, &[]);
            let least = most_implausible(robot, &set_up.model, &fit, &weighted, &choice.kept);
            implausible.extend(least);
        }
        start = fit.model.clone();
        reached = Some((choice, fit, weights));
    }
    Err(IdentifyError::NotFinite)
}

impl Choice {
    /// The whole base set, as the user's list is followed.
    fn all(base: &[ParamId]) -> Self {
        Self { kept: base.to_vec(), base: base.to_vec(), weak: vec![], untold_bars: vec![] }
    }

    /// What these lengths tell, without what is implausible already.
    fn told(
        tolerances: Tolerances,
        model: &LengthModel,
        lengths: &Weighted,
        base: &[ParamId],
        implausible: &[ParamId],
    ) -> Self {
        let left = |out: &[ParamId]| -> Vec<ParamId> {
            base.iter().copied().filter(|id| !out.contains(id)).collect()
        };
        let judged = too_weak(tolerances, model, lengths, &left(implausible));
        let weak = [implausible, judged.as_slice()].concat();
        Self { weak: weak.clone(), ..Self::all(&left(&weak)) }
    }

    /// All that a prior binds or the lengths tell.
    fn bound(
        robot: &Robot,
        model: &LengthModel,
        lengths: &Weighted,
        (analysis, base): (&Analysis, &[ParamId]),
        loose: &[ParamId],
        options: &Options,
    ) -> Self {
        let mut untold_bars = weak_bars(options.tolerances(robot), base, model, lengths);
        untold_bars.extend(analysis.dependent().into_iter().filter(is_bar));
        let mut kept = [base, prior::sharing(robot, options, &untold_bars, analysis).as_slice()].concat();
        kept.sort();
        Self { kept, weak: loose.to_vec(), untold_bars, ..Self::all(base) }
    }
}

/// Whether a parameter is a bar's.
fn is_bar(id: &ParamId) -> bool {
    matches!(id, ParamId::BarOffset(_))
}

/// Rounds of fitting and judging after which the last fit stands.
const ROUNDS: usize = 8;

/// Whether a fit with the new sigmas would be the same: equal to 2 %, or, where no prior stands
/// against them, all changed alike.
fn same_weights(lengths: &Lengths, old: Sigma, new: Sigma, options: &Options) -> bool {
    let mut changes =
        (0..lengths.len()).map(|at| lengths.given(at)).map(|given| new.of(given) / old.of(given));
    let common = if options.prior == Prior::None { changes.clone().next().unwrap_or(1.0) } else { 1.0 };
    changes.all(|change| (change / common - 1.0).abs() < 0.02)
}

/// The parameter whose correction is least believable, if one is: the data tell it worse than its
/// tolerance, and it is further off than five times what tolerance and data allow together. It
/// carries what the model lacks, or what is held.
fn most_implausible(
    robot: &Robot,
    nominal: &LengthModel,
    fit: &Fit,
    lengths: &Weighted,
    kept: &[ParamId],
) -> Option<ParamId> {
    let sd = spread(&fit.model, lengths, kept, kept, None)?.data_sd;
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
    tolerances: Tolerances,
    base: &[ParamId],
    model: &LengthModel,
    lengths: &Weighted,
) -> Vec<ParamId> {
    let bars = (0..base.len()).filter(|&at| is_bar(&base[at]));
    if bars.clone().next().is_none() {
        return vec![];
    }
    let sd = spread(model, lengths, base, base, None).map(|spread| spread.data_sd);
    let limit = |id| tolerances.weak_limit(id).unwrap_or(f64::INFINITY);
    bars.filter(|&bar| sd.as_ref().is_none_or(|sd| sd[bar] > limit(base[bar]))).map(|bar| base[bar]).collect()
}
