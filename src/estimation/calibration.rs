//! A calibration: the estimate, what it leaves unknown, how it is checked, and the one place that makes the result.

use std::collections::BTreeSet;

use super::estimate::{Estimate, estimate};
use super::findings::findings;
use super::joint_errors;
use super::joint_fit::JointFit;
use super::joint_prediction::JointPrediction;
use super::lengths::{Lengths, Weighted};
use super::monte_carlo::Draws;
use super::observability::{correlations, observability};
use super::posterior::Posterior;
use super::predicted::Prediction;
use super::priors::open_limit;
use super::residual_tests::joint_effects;
use super::residuals::{residual_on, residuals};
use super::result::{
    BeforeAfter, CalibrationResult, Folds, JointEffect, MadeFrom, MonteCarlo, Outlier, ParameterResult,
    PriorUsed, RankSummary, Reason, Recommendation, SigmaSource, SigmaSummary, SolverSummary, StartRobot,
    Status,
};
use super::selection::is_place;
use super::setting::Setting;
use super::uncertainty::{Uncertainty, leaks, uncertainty};
use super::zero_change::{ZeroChange, zero_change};
use super::{
    Combination, Correlation, DistanceQuantities, Observability, Options, Prior, factor, validation,
};
use crate::catalogue::EstimationFinding;
use crate::diagnostic::{Diagnostic, Finding, Severity};
use crate::math::base_set;
use crate::math::distributions::coverage_95;
use crate::measurement::{LengthModel, Measurements};
use crate::robot::{Datum, ParamId, Robot, RobotUncertainty};

/// What a calibration is of.
#[derive(Clone, Copy)]
pub struct Input<'a> {
    /// Where the fit starts, and the nominal robot inside where it was identified before.
    pub robot: &'a Robot,
    pub observations: &'a Measurements,
    /// The robot's geometry in the set-up as it was given.
    pub start: &'a LengthModel,
    /// Separate measurements in the same set-up, on which nothing is fitted.
    pub validation: Option<&'a Measurements>,
    pub options: &'a Options,
    pub axes: AngleSource,
}

/// Where the axis angles come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AngleSource {
    /// They were commanded; the controller may have corrected them.
    Commanded,
    /// By the user's table, or logged by the program.
    Given,
}

impl<'a> Input<'a> {
    /// The estimate alone: no covariance, folds or predictions.
    ///
    /// # Errors
    /// Numbers that are not finite, nothing to estimate.
    pub fn fit(&self) -> Result<LengthModel, EstimationFinding> {
        let lengths = Lengths::of(&self.observations.rows, self.options, self.robot);
        let asked = self.setting().asked();
        Ok(Start::of(self, &lengths, &asked)?.estimate.fit.model)
    }

    pub(super) fn setting(&self) -> Setting<'a> {
        Setting::new(self.robot, self.start, self.observations, self.options)
    }
}

/// The estimate with the setting that it is of.
struct Start<'a> {
    setting: Setting<'a>,
    estimate: Estimate,
}

impl<'a> Start<'a> {
    fn of(input: &Input<'a>, lengths: &Lengths, asked: &[ParamId]) -> Result<Self, EstimationFinding> {
        if input.options.seeks_joint_errors()
            && let Some(found) = Self::with_joints(input, lengths, asked)?
        {
            return Ok(found);
        }
        let setting = input.setting();
        Ok(Self { estimate: estimate(&setting, lengths, asked)?, setting })
    }

    /// With errors of the joints, where the lengths carry them.
    fn with_joints(
        input: &Input<'a>,
        lengths: &Lengths,
        asked: &[ParamId],
    ) -> Result<Option<Self>, EstimationFinding> {
        let mut setting = input.setting().bound();
        let mut estimate = estimate(&setting, lengths, asked)?;
        if let Some(times) = estimate.beyond_prior() {
            // What makes up for a ball that is fixed elsewhere than it is, is no error of a joint.
            if setting.options.hold.iter().any(|id| id.is_setup()) {
                return Ok(None);
            }
            // A tolerance that nobody asked for gives way where the lengths contradict it.
            if input.options.prior == Prior::None {
                setting = setting.widened(times);
                estimate = self::estimate(&setting, lengths, asked)?;
            }
        }
        if !joint_errors::carries(lengths, &estimate) {
            return Ok(None);
        }
        let found = joint_errors::fit(&setting, lengths, estimate);
        Ok(found.map(|estimate| Self { estimate, setting }))
    }
}

/// An estimate with all that is known of it.
pub struct Calibration<'a> {
    pub(crate) setting: Setting<'a>,
    pub(crate) lengths: Lengths<'a>,
    pub(crate) estimate: Estimate,
    pub(crate) prediction: Prediction,
    pub(super) uncertainty: Uncertainty,
    pub(super) residual_mm: BeforeAfter,
    pub(super) parameters: Vec<ParameterResult>,
    pub(super) joint_effects: Vec<JointEffect>,
    zero_change: Option<ZeroChange>,
    pub(super) monte_carlo: Option<MonteCarlo>,
    pub(super) axes: AngleSource,
    observations: &'a Measurements,
    /// What is not known of a robot with errors of its joints.
    unknown: Option<RobotUncertainty>,
    sigma: SigmaSummary,
    rank: RankSummary,
    folds: Option<Folds>,
    pub(super) validation: Option<BeforeAfter>,
}

impl<'a> Calibration<'a> {
    /// # Errors
    /// Numbers that are not finite, nothing to estimate.
    pub fn new(input: &Input<'a>) -> Result<Self, EstimationFinding> {
        let lengths = Lengths::of(&input.observations.rows, input.options, input.robot);
        let asked = input.setting().asked();
        let Start { setting, estimate } = Start::of(input, &lengths, &asked)?;
        let folds = cross_validated(&setting, &lengths, &estimate, &asked)?;
        let used = estimate.used(&lengths);
        let model = &estimate.fit.model;
        let uncertainty = uncertainty_of(&setting, &estimate, &used).ok_or(EstimationFinding::NotFinite)?;
        let residual_mm = residuals(&estimate.before, model, &used).ok_or(EstimationFinding::NotFinite)?;
        let sigma = sigma(&estimate, &lengths);
        if !sigma.mm.is_finite() {
            return Err(EstimationFinding::NotFinite);
        }
        let draws =
            setting.options.monte_carlo.map(|trials| Draws::of(&setting.priors, &estimate, &lengths, trials));
        let table = Table {
            setting: &setting,
            estimate: &estimate,
            uncertainty: &uncertainty,
            coverage_factor: sigma.coverage_factor,
            draws: draws.as_ref(),
            combinations: estimate.analysis.combinations(),
            unobservable: estimate.analysis.zero(),
        };
        let parameters = table.parameters();
        let on_both = |set| {
            let (before, after) = (residual_on(&estimate.before, set)?, residual_on(model, set)?);
            Some(BeforeAfter { before, after })
        };
        let validation =
            input.validation.map(|set| on_both(set).ok_or(EstimationFinding::NotFinite)).transpose()?;
        let mut prediction = Prediction::of(&setting, &estimate, &used)?;
        let parameters_used = uncertainty.effective_parameters;
        let joints = estimate.joints.as_ref().map(|fit| JointPrediction::of(&setting, fit, &lengths));
        let unknown = match joints {
            Some(JointPrediction { summary, map, unknown }) => {
                (prediction.pair.identified, prediction.map) = (summary, map);
                Some(unknown)
            }
            None => None,
        };
        Ok(Self {
            prediction,
            zero_change: zero_change(input.observations, &estimate, &lengths, parameters_used),
            unknown,
            rank: rank(&estimate, &lengths)?,
            joint_effects: if estimate.fit.converged {
                joint_effects(model, &used, &estimate.base)
            } else {
                Vec::new()
            },
            monte_carlo: draws.map(|draws| draws.summary(&parameters)),
            axes: input.axes,
            observations: input.observations,
            parameters,
            validation,
            residual_mm,
            uncertainty,
            sigma,
            folds,
            setting,
            estimate,
            lengths,
        })
    }

    /// The result: the only place where one is made. `recommendations` are what design found for it, `inputs` what was
    /// found in the inputs before.
    pub fn result(self, recommendations: Vec<Recommendation>, inputs: Vec<Diagnostic>) -> CalibrationResult {
        let findings = findings(&self);
        let (observability, correlations) = (self.observability(), self.correlations());
        let outliers = self.outliers();
        let Self { setting, estimate, uncertainty, .. } = self;
        let joints = estimate.joints.as_ref().map(JointFit::summary);
        let nominal = setting.robot.nominal.clone().unwrap_or_else(|| Box::new(setting.robot.clone()));
        let geometry = estimate.fit.model.geometry.clone();
        let codes = findings.iter().map(Finding::code).chain(inputs.iter().map(|finding| finding.code));
        let doubts = codes.filter(|code| code.severity() == Severity::Warning).map(|code| code.to_string());
        CalibrationResult {
            robot: Robot {
                doubts: BTreeSet::from_iter(doubts).into_iter().collect(),
                posterior: self.prediction.posterior,
                geometry,
                nominal: Some(nominal),
                uncertainty: self.unknown.map(Box::new),
                ..setting.robot.clone()
            },
            lengths: self.observations.count() - outliers.len(),
            made_from: MadeFrom::of(self.observations, &outliers),
            rank: self.rank,
            observability,
            solver: SolverSummary { iterations: estimate.fit.iterations, converged: estimate.fit.converged },
            sigma: self.sigma,
            prior: PriorUsed::of(&setting.options.prior, setting.priors.scale()),
            joints,
            monte_carlo: self.monte_carlo,
            residual_mm: self.residual_mm,
            folds: self.folds,
            validation: self.validation,
            distance: DistanceQuantities::of(&self.observations.rows, &estimate.fit.model),
            predicted: self.prediction.pair,
            position_parts: self.prediction.parts,
            map: self.prediction.map,
            parameters: self.parameters,
            combinations: estimate.analysis.combinations(),
            correlations,
            recommendations,
            joint_effects: self.joint_effects,
            zero_change: self.zero_change,
            outliers,
            findings,
            input_findings: inputs,
            before: estimate.before,
            start: if setting.robot.nominal.is_some() { StartRobot::Identified } else { StartRobot::Nominal },
            posterior: uncertainty.posterior,
        }
    }

    /// The parameters that the data identify.
    pub(crate) fn identified(&self) -> Vec<ParamId> {
        let identified = self.parameters.iter().filter(|parameter| parameter.status() == Status::Identified);
        identified.map(|parameter| parameter.id).collect()
    }

    /// Of the parameters identified, their columns in units of their prior standard deviations.
    fn observability(&self) -> Option<Observability> {
        let Prediction { ids, factor, .. } = &self.prediction;
        let identified = self.identified();
        let places: Vec<usize> =
            identified.iter().filter_map(|id| ids.iter().position(|other| other == id)).collect();
        let mut scaled = factor.select_columns(&places);
        for (mut column, place) in scaled.column_iter_mut().zip(&places) {
            column *= self.sigma.mm * self.setting.priors.sd(ids[*place]);
        }
        observability(&scaled, self.estimate.used(&self.lengths).count())
    }

    /// The pairs that are hardly separated. Of what only the prior separates, the combinations say it.
    fn correlations(&self) -> Vec<Correlation> {
        let estimate = &self.estimate;
        let base: Vec<usize> =
            (0..estimate.kept.len()).filter(|&k| estimate.base.contains(&estimate.kept[k])).collect();
        let covariance = self.uncertainty.posterior.covariance();
        correlations(&estimate.base, &covariance.select_rows(&base).select_columns(&base))
    }

    fn outliers(&self) -> Vec<Outlier> {
        let after = self.estimate.fit.model.prepare();
        let residual = |place: usize| {
            let reading = self.lengths.reading(place);
            reading.length_mm - after.length(&reading)
        };
        let outlier = |place: usize| {
            let row = &self.observations.rows[place];
            let places = row.datum.rows(place);
            let residual_mm = match row.datum {
                Datum::Ball(..) => residual(place),
                Datum::Plane(_) => places.clone().map(|at| residual(at).powi(2)).sum::<f64>().sqrt(),
            };
            Outlier { places, index: row.index, ball: row.datum.ball(), residual_mm }
        };
        let is_first = |place: &usize| self.observations.rows[*place].datum.is_first();
        self.estimate.fit.out.iter().copied().filter(is_first).map(outlier).collect()
    }
}

/// Held-out residuals. Errors of the joints keep their variances in each fold.
fn cross_validated(
    setting: &Setting<'_>,
    lengths: &Lengths,
    estimate: &Estimate,
    asked: &[ParamId],
) -> Result<Option<Folds>, EstimationFinding> {
    let Some(folds) = validation::folds(setting.options.folds, lengths.len(), estimate.base.len()) else {
        return Ok(None);
    };
    let fit = |training: &Lengths| match &estimate.joints {
        Some(joints) => {
            let model = joint_errors::refit(setting, training, estimate, joints);
            model.ok_or(EstimationFinding::NotFinite)
        }
        None => Ok(self::estimate(setting, training, asked)?.fit.model),
    };
    let held_out = validation::held_out(lengths, &estimate.fit.out, folds, fit)?;
    Ok(held_out.map(|residuals| Folds { folds, rms: validation::rms(&residuals) }))
}

/// With what the tolerances of poorly observable parameters add, where no prior carries these.
fn uncertainty_of(setting: &Setting<'_>, estimate: &Estimate, used: &Weighted) -> Option<Uncertainty> {
    let Estimate { kept, base, poorly_observable, prior, .. } = estimate;
    let model = &estimate.fit.model;
    if let Some(JointFit { root, effective_parameters, .. }) = &estimate.joints {
        let found = uncertainty(model, used, kept, base, prior.as_ref())?;
        let own = root.rows(0, kept.len()).into_owned();
        let posterior = Posterior::with_root(model.clone(), kept, own);
        return Some(Uncertainty { posterior, effective_parameters: *effective_parameters, ..found });
    }
    let found = uncertainty(model, used, kept, base, prior.as_ref())?;
    if prior.is_some() || poorly_observable.is_empty() {
        return Some(found);
    }
    let columns = leaks(&setting.priors, model, used, kept, poorly_observable)?;
    let posterior: Posterior = found.posterior.widened(&columns);
    Some(Uncertainty { posterior, ..found })
}

fn sigma(estimate: &Estimate, lengths: &Lengths) -> SigmaSummary {
    let source = match estimate.noise.freedom {
        Some(_) => SigmaSource::Estimated,
        None if lengths.known => SigmaSource::Given,
        None => SigmaSource::Assumed,
    };
    SigmaSummary {
        mm: estimate.used(lengths).rms_sigma(),
        source,
        freedom: estimate.noise.freedom,
        coverage_factor: (source != SigmaSource::Assumed).then(|| coverage_95(estimate.noise.freedom)),
    }
}

fn rank(estimate: &Estimate, lengths: &Lengths) -> Result<RankSummary, EstimationFinding> {
    let ids = &estimate.analysis.ids;
    let order: Vec<usize> = (0..ids.len()).collect();
    let set = base_set(&factor(&estimate.fit.model, &lengths.plain(), ids), &order)
        .ok_or(EstimationFinding::NotFinite)?;
    let base = &estimate.analysis.base;
    Ok(RankSummary { nominal: base.rank, at_solution: set.rank, condition: base.condition })
}

/// The table of all parameters.
struct Table<'a> {
    setting: &'a Setting<'a>,
    estimate: &'a Estimate,
    uncertainty: &'a Uncertainty,
    coverage_factor: Option<f64>,
    draws: Option<&'a Draws>,
    combinations: Vec<Combination>,
    unobservable: Vec<ParamId>,
}

impl Table<'_> {
    fn parameters(&self) -> Vec<ParameterResult> {
        let Setting { robot, start, set_up, .. } = *self.setting;
        let mut nominal = start.clone();
        if let Some(before) = &robot.nominal {
            nominal.geometry = before.geometry.clone();
        }
        let more = [self.estimate.analysis.ids.as_slice(), &self.estimate.kept].concat();
        let ids = self.setting.all_and(set_up, &more);
        ids.into_iter().map(|id| self.parameter(id, start.value(id), nominal.value(id))).collect()
    }

    fn parameter(&self, id: ParamId, start: f64, nominal: f64) -> ParameterResult {
        let identified = self.estimate.fit.model.value(id);
        let sd = self.uncertainty.posterior.sd(id);
        let about = |(factor, sd): (f64, f64)| [identified - factor * sd, identified + factor * sd];
        ParameterResult {
            id,
            start,
            nominal,
            identified,
            correction: identified - nominal,
            sd,
            interval95: self.coverage_factor.zip(sd).map(about),
            monte_carlo: self.draws.and_then(|draws| draws.parameter(id)),
            reason: self.reason(id),
        }
    }

    fn reason(&self, id: ParamId) -> Reason {
        let Setting { options, priors, .. } = self.setting;
        if let Some(k) = self.estimate.kept.iter().position(|kept| *kept == id) {
            return self.reason_of_estimated(id, k);
        }
        let limit = || priors.weak_limit(id).unwrap_or(f64::INFINITY);
        if options.hold.contains(&id) {
            Reason::FixedAsAsked
        } else if self.estimate.poorly_observable.contains(&id) {
            match is_place(&id) {
                true => Reason::Open { limit: open_limit(id) },
                false => Reason::PoorlyObservable { limit: limit() },
            }
        } else if !self.estimate.analysis.ids.contains(&id) {
            Reason::NotAsked
        } else if self.unobservable.contains(&id) {
            Reason::ChangesNoLength
        } else {
            Reason::Dependent { combination: self.combination(id) }
        }
    }

    fn reason_of_estimated(&self, id: ParamId, k: usize) -> Reason {
        let Estimate { kept, base, prior, .. } = self.estimate;
        if id.is_optional() && self.estimate.joints.is_some() {
            let before = self.estimate.prior_sd(id).unwrap_or(f64::INFINITY);
            let after = self.uncertainty.posterior.sd(id).unwrap_or(before);
            return Reason::ByEvidence { determined: 1.0 - (after / before).powi(2) };
        }
        if !base.contains(&id) {
            return Reason::PriorShares { combination: self.combination(id) };
        }
        let data_sd = self.uncertainty.data_sd[k];
        let limit = self.setting.priors.weak_limit(id).unwrap_or(f64::INFINITY);
        if prior.is_some() && data_sd > limit {
            return Reason::PriorCarries { data_sd };
        }
        let Some(combination) = self.combinations.iter().find(|combination| combination.kept == id) else {
            return Reason::Identified;
        };
        let shared = combination.members.iter().any(|(member, _)| *member != id && kept.contains(member));
        Reason::IdentifiedFor { combination: combination.clone(), shared }
    }

    /// The first combination that a parameter belongs to.
    fn combination(&self, id: ParamId) -> Option<Combination> {
        self.combinations.iter().find(|combination| combination.contains(id)).cloned()
    }
}
