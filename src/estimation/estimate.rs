//! From lengths to parameters: what is identifiable, what is poorly observable, the fit, and the lengths' sigma.

use super::fit::{self, Fit, Unknowns};
use super::joint_fit::JointFit;
use super::lengths::{Lengths, Sigma, Weighted};
use super::prior::{self, PriorRows};
use super::priors::Prior;
use super::selection::{Choice, is_bar, is_place, most_implausible, open_places, without_open_places};
use super::setting::Setting;
use super::sigma::Noise;
use super::{Analysis, analyse};
use crate::catalogue::EstimationFinding;
use crate::math::distributions::ChiSquare;
use crate::measurement::LengthModel;
use crate::robot::ParamId;

/// Rounds of fitting and judging after which the last fit is taken.
const ROUNDS: usize = 8;
/// Standard deviations that are equal to this share weigh alike.
const SAME_WEIGHT: f64 = 0.02;

/// An estimate, and how it came about.
#[derive(Clone, Debug)]
pub(crate) struct Estimate {
    /// The nominal robot with the free part of the set-up fitted.
    pub(crate) before: LengthModel,
    pub(crate) analysis: Analysis,
    /// Parameters that were estimated, in canonical order.
    pub(crate) kept: Vec<ParamId>,
    /// Those of them that are independent for the lengths alone; a prior shares a combination among more.
    pub(crate) base: Vec<ParamId>,
    /// Fixed because they are poorly observable, weakest first.
    pub(crate) poorly_observable: Vec<ParamId>,
    pub(super) prior: Option<PriorRows>,
    pub(super) fit: Fit,
    /// By what the fit weighted the lengths.
    pub(super) noise: Noise,
    /// Errors of the joints, where the evidence speaks for them.
    pub(super) joints: Option<JointFit>,
}

impl Estimate {
    /// The same with the errors of the joints that `found` holds.
    pub(super) fn with_joints(self, lengths: &Lengths, found: JointFit) -> Self {
        let sigma = if lengths.vouched { Sigma::Given } else { Sigma::All(found.sigma_mm) };
        let count = self.used(lengths).count() as f64;
        Self {
            kept: found.ids.clone(),
            prior: Some(found.prior.clone()),
            fit: Fit { model: found.model.clone(), ..self.fit },
            noise: Noise {
                sigma,
                freedom: (!lengths.vouched).then_some((count - found.effective_parameters).max(1.0)),
            },
            joints: Some(found),
            ..self
        }
    }

    /// One standard deviation of a parameter before the lengths; `None` of what is free or not estimated.
    pub(super) fn prior_sd(&self, id: ParamId) -> Option<f64> {
        self.prior.as_ref()?.sd(self.kept.iter().position(|kept| *kept == id)?)
    }

    /// How many times as large the corrections are as the prior allows, where that is beyond chance.
    pub(super) fn beyond_prior(&self) -> Option<f64> {
        let prior = self.prior.as_ref()?;
        let count = prior.count() as f64;
        let ratio = prior.deviates(&self.fit.model, &self.kept).norm_squared() / count;
        (count > 0.0 && ChiSquare::of(ratio, count) == ChiSquare::Greater).then(|| ratio.sqrt())
    }

    /// The lengths that the fit used, as it weighed them.
    pub(crate) fn used<'a>(&'a self, lengths: &'a Lengths) -> Weighted<'a> {
        lengths.weighted(self.noise.sigma, &self.fit.out)
    }
}

/// Estimates what the data determine of `asked`, from the nominal robot and a rough set-up.
///
/// # Errors
/// Numbers that are not finite, nothing to estimate.
pub(super) fn estimate(
    setting: &Setting<'_>,
    lengths: &Lengths,
    asked: &[ParamId],
) -> Result<Estimate, EstimationFinding> {
    let mut search = Search::new(setting, lengths, asked)?;
    let mut reached: Option<Reached> = None;
    for round in 0..=ROUNDS {
        let choice = Choice::of(&search);
        if let Some(before) = reached.take()
            && (round == ROUNDS || before.choice == choice && search.weighs_as(before.noise))
        {
            return Ok(search.estimate(before));
        }
        reached = Some(search.fit(choice));
    }
    Err(EstimationFinding::NotFinite)
}

/// An estimate on its way.
pub(super) struct Search<'a> {
    pub(super) setting: &'a Setting<'a>,
    pub(super) lengths: &'a Lengths<'a>,
    pub(super) analysis: Analysis,
    pub(super) base: Vec<ParamId>,
    /// Places of balls that the poses leave open.
    pub(super) open: Vec<ParamId>,
    /// These and what came out implausible.
    pub(super) implausible: Vec<ParamId>,
    pub(super) set_up: Fit,
    pub(super) noise: Noise,
    /// What is fitted of the set-up.
    free: Vec<ParamId>,
    start: LengthModel,
    iterations: usize,
}

/// A fit with what it was of.
struct Reached {
    choice: Choice,
    fit: Fit,
    noise: Noise,
}

impl<'a> Search<'a> {
    /// The set-up fitted to the nominal robot, and the base set there.
    fn new(
        setting: &'a Setting<'a>,
        lengths: &'a Lengths<'a>,
        asked: &[ParamId],
    ) -> Result<Self, EstimationFinding> {
        let (priors, follows_list) = (&setting.priors, setting.options.follows_list());
        let mut free = asked.to_vec();
        if !follows_list {
            free = without_open_places(priors, setting.start, &lengths.plain(), asked)
                .ok_or(EstimationFinding::NotFinite)?;
        }
        // What an earlier run determined is not given up to a fit of the set-up alone.
        free.retain(|id| !priors.is_of_posterior(*id));
        let set_up = fit::set_up(lengths, &free, setting.start);
        let mut open = Vec::new();
        let analysis = loop {
            let judged: Vec<ParamId> = asked.iter().copied().filter(|id| !open.contains(id)).collect();
            let analysis =
                analyse(&set_up.model, &lengths.plain(), &judged).ok_or(EstimationFinding::NotFinite)?;
            let places: Vec<ParamId> = analysis
                .kept()
                .into_iter()
                .filter(|id| is_place(id) && !priors.is_of_posterior(*id))
                .collect();
            let more = if follows_list {
                vec![]
            } else {
                open_places(priors, &set_up.model, &lengths.plain(), places)
            };
            if more.is_empty() {
                break analysis;
            }
            open.extend(more);
        };
        let base = analysis.kept();
        if base.is_empty() {
            return Err(EstimationFinding::NothingToEstimate);
        }
        Ok(Self {
            setting,
            lengths,
            noise: if follows_list { Noise::GIVEN } else { Noise::of_linear_fit(lengths, &set_up, &base) },
            analysis,
            base,
            implausible: open.clone(),
            open,
            start: set_up.model.clone(),
            iterations: set_up.iterations,
            set_up,
            free,
        })
    }

    /// Fits what was chosen, then the standard deviation of the lengths.
    fn fit(&mut self, choice: Choice) -> Reached {
        self.free_of_bars(&choice);
        // A parameter fixed now may have moved in the round before.
        for id in self.base.iter().filter(|id| !choice.kept.contains(id)) {
            self.start.shift(*id, self.set_up.model.value(*id) - self.start.value(*id));
        }
        let prior = self.prior(&choice);
        let unknowns = Unknowns { free: &choice.kept, determined: choice.base.len(), prior: prior.as_ref() };
        let fit = fit::all(self.lengths, self.noise.sigma, &unknowns, &self.start);
        self.iterations += fit.iterations;
        let noise = self.noise;
        self.noise = match prior {
            // Residuals that the prior has widened say nothing about the lengths.
            Some(_) => Noise::of_linear_fit(self.lengths, &fit, &self.base),
            None => Noise::of_fit(self.lengths, &fit, choice.kept.len()),
        };
        let options = &self.setting.options;
        if !options.follows_list() && options.prior == Prior::None {
            let weighted = self.lengths.weighted(self.noise.sigma, &[]);
            let least = most_implausible(self, &fit.model, &weighted, &choice.kept);
            self.implausible.extend(least);
        }
        self.start = fit.model.clone();
        Reached { choice, fit, noise }
    }

    /// Without the offset of a bar the balls are elsewhere: the set-up is fitted anew.
    fn free_of_bars(&mut self, choice: &Choice) {
        let given = self.setting.start;
        let bars: Vec<ParamId> = choice
            .poorly_observable
            .iter()
            .chain(&choice.undetermined_bars)
            .copied()
            .filter(is_bar)
            .collect();
        if bars.iter().any(|id| self.set_up.model.value(*id) != given.value(*id)) {
            self.free.retain(|id| !bars.contains(id));
            self.set_up = fit::set_up(self.lengths, &self.free, given);
            self.start = self.set_up.model.clone();
        }
    }

    fn prior(&self, choice: &Choice) -> Option<PriorRows> {
        prior::rows(self.setting, &choice.undetermined_bars, &choice.kept)
    }

    /// Whether a fit with the sigmas found since would be the same: equal to 2 %, or, where no prior is weighed
    /// against them, all changed alike.
    fn weighs_as(&self, old: Noise) -> bool {
        let lengths = self.lengths;
        let mut changes = (0..lengths.len())
            .map(|at| lengths.given(at))
            .map(|given| self.noise.sigma.of(given) / old.sigma.of(given));
        let is_free = self.setting.options.prior == Prior::None;
        let common = if is_free { changes.clone().next().unwrap_or(1.0) } else { 1.0 };
        changes.all(|change| (change / common - 1.0).abs() < SAME_WEIGHT)
    }

    fn estimate(self, reached: Reached) -> Estimate {
        let Reached { choice, fit, .. } = reached;
        let prior = self.prior(&choice);
        Estimate {
            before: self.set_up.model,
            analysis: self.analysis,
            kept: choice.kept,
            base: choice.base,
            poorly_observable: choice.poorly_observable,
            prior,
            fit: Fit { iterations: self.iterations, ..fit },
            noise: self.noise,
            joints: None,
        }
    }
}
