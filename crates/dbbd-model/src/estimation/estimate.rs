//! The estimate: choice of parameters, fit, and noise of the lengths, iterated until they agree.

use super::fit::{self, Fit};
use super::joint_fit::JointFit;
use super::lengths::{Lengths, Sigma, Weighted};
use super::options::Setting;
use super::prior::{self, PriorRows};
use super::priors::Prior;
use super::selection::{Choice, is_bar, is_place, most_implausible, open_places, without_open_places};
use super::sigma::Noise;
use super::{Analysis, analyse};
use crate::estimation::EstimationFinding;
use crate::math::distributions::ChiSquareOutcome;
use crate::measurement::LengthModel;
use crate::robot::ParamId;

/// Rounds after which the last fit is accepted.
const ROUNDS: usize = 8;
/// Standard deviations that differ by less than this fraction count as equal.
const SAME_WEIGHT: f64 = 0.02;

#[derive(Clone, Debug)]
pub(crate) struct Estimate {
    /// The nominal robot with the free part of the set-up fitted.
    pub(crate) before: LengthModel,
    pub(crate) analysis: Analysis,
    /// The estimated parameters, in canonical order.
    pub(crate) kept: Vec<ParamId>,
    /// Those of them that are independent by the lengths alone.
    pub(crate) base: Vec<ParamId>,
    /// Fixed because they are poorly observable, weakest first.
    pub(crate) poorly_observable: Vec<ParamId>,
    pub(super) prior: Option<PriorRows>,
    pub(super) fit: Fit,
    /// The weights of the fit.
    pub(super) noise: Noise,
    /// Errors of the joints, if the evidence supports them.
    pub(super) joints: Option<JointFit>,
}

impl Estimate {
    pub(super) fn with_joints(self, lengths: &Lengths, joints: JointFit) -> Self {
        let noise = if lengths.vouched {
            Noise::GIVEN
        } else {
            let freedom = self.used(lengths).count() as f64 - joints.effective_parameters;
            Noise { sigma: Sigma::All(joints.sigma_mm), freedom: Some(freedom.max(1.0)) }
        };
        Self {
            kept: joints.ids.clone(),
            prior: Some(joints.prior.clone()),
            fit: Fit { model: joints.model.clone(), ..self.fit },
            noise,
            joints: Some(joints),
            ..self
        }
    }

    /// The prior standard deviation of a parameter; `None` if it is free or not estimated.
    pub(super) fn prior_sd(&self, id: ParamId) -> Option<f64> {
        self.prior.as_ref()?.sd(self.kept.iter().position(|kept| *kept == id)?)
    }

    /// The ratio of the corrections to the prior standard deviations (RMS), if it is significantly above 1.
    pub(super) fn beyond_prior(&self) -> Option<f64> {
        let prior = self.prior.as_ref()?;
        let count = prior.count() as f64;
        let ratio = prior.deviates(&self.fit.model, &self.kept).norm_squared() / count;
        (count > 0.0 && ChiSquareOutcome::of(ratio, count) == ChiSquareOutcome::Greater).then(|| ratio.sqrt())
    }

    /// The lengths with the weights of the fit, without outliers.
    pub(crate) fn used<'a>(&'a self, lengths: &'a Lengths) -> Weighted<'a> {
        lengths.weighted(self.noise.sigma, &self.fit.outliers)
    }
}

/// Estimates those of the parameters `asked` that the data determine, from the nominal robot and a rough set-up.
///
/// # Errors
/// A number is not finite, or there is nothing to estimate.
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

/// The state of the iteration.
pub(super) struct Search<'a> {
    pub(super) setting: &'a Setting<'a>,
    pub(super) lengths: &'a Lengths<'a>,
    pub(super) analysis: Analysis,
    pub(super) base: Vec<ParamId>,
    /// Places of the set-up that the poses leave open.
    pub(super) open: Vec<ParamId>,
    /// These, and parameters whose corrections were implausible.
    pub(super) implausible: Vec<ParamId>,
    pub(super) set_up: Fit,
    pub(super) noise: Noise,
    /// The parameters that are free in a fit of the set-up.
    free: Vec<ParamId>,
    start: LengthModel,
    iterations: usize,
}

/// A fit with its parameters and weights.
struct Reached {
    choice: Choice,
    fit: Fit,
    noise: Noise,
}

impl<'a> Search<'a> {
    /// Fits the set-up to the nominal robot and finds the base set there.
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
        // A fit of the set-up alone must not change what an earlier identification determined.
        free.retain(|id| !priors.is_of_posterior(*id));
        let set_up = fit::set_up(lengths, &free, setting.start);
        let mut open = Vec::new();
        let analysis = loop {
            let judged: Vec<ParamId> = asked.iter().copied().filter(|id| !open.contains(id)).collect();
            let analysis =
                analyse(&set_up.model, &lengths.plain(), &judged).ok_or(EstimationFinding::NotFinite)?;
            if follows_list {
                break analysis;
            }
            let mut places = analysis.kept();
            places.retain(|id| is_place(id) && !priors.is_of_posterior(*id));
            let more = open_places(priors, &set_up.model, &lengths.plain(), places);
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

    /// Fits the chosen parameters, then updates the noise of the lengths.
    fn fit(&mut self, choice: Choice) -> Reached {
        self.refit_set_up_without_bars(&choice);
        // A parameter that is fixed now may have changed in the round before.
        for id in self.base.iter().filter(|id| !choice.kept.contains(id)) {
            self.start.shift(*id, self.set_up.model.value(*id) - self.start.value(*id));
        }
        let prior = self.prior(&choice);
        let fit = fit::all(self.lengths, self.noise.sigma, &choice, prior.as_ref(), &self.start);
        self.iterations += fit.iterations;
        let noise = self.noise;
        self.noise = match prior {
            // The prior increases the residuals, so they do not measure the noise.
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

    /// If the fit of the set-up changed the offset of a bar that is not determined, the balls are wrong by it too.
    fn refit_set_up_without_bars(&mut self, choice: &Choice) {
        let given = self.setting.start;
        let mut bars = [choice.poorly_observable.as_slice(), &choice.undetermined_bars].concat();
        bars.retain(is_bar);
        if bars.iter().any(|id| self.set_up.model.value(*id) != given.value(*id)) {
            self.free.retain(|id| !bars.contains(id));
            self.set_up = fit::set_up(self.lengths, &self.free, given);
            self.start = self.set_up.model.clone();
        }
    }

    fn prior(&self, choice: &Choice) -> Option<PriorRows> {
        prior::rows(self.setting, &choice.undetermined_bars, &choice.kept)
    }

    /// Whether a fit with the new weights would be the same: without a prior a common factor on all weights does not matter.
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
