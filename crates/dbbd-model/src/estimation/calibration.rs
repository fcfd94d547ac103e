//! A calibration: the estimate, its uncertainty and checks, and the result made of them.

use std::collections::BTreeSet;

use super::estimate::{Estimate, estimate};
use super::findings::findings;
use super::identifiability::{correlations, observability};
use super::joint_errors;
use super::joint_fit::JointFit;
use super::joint_prediction::JointPrediction;
use super::lengths::Lengths;
use super::monte_carlo::Draws;
use super::options::Setting;
use super::parameters::ParameterTable;
use super::predicted::Prediction;
use super::residual_tests::joint_effects;
use super::result::{
    BeforeAfter, CalibrationResult, Folds, JointEffect, MadeFrom, MonteCarlo, Outlier, ParameterResult,
    PriorUsed, RankSummary, Recommendation, SigmaSource, SigmaSummary, SolverSummary, StartRobot, Status,
};
use super::uncertainty::Uncertainty;
use super::validation::{self, residual_of, residual_of_used};
use super::zero_change::{ZeroChange, zero_change};
use super::{Correlation, DistanceQuantities, Observability, Options, Prior, factor};
use crate::diagnostic::{Diagnostic, Finding, Severity};
use crate::estimation::EstimationFinding;
use crate::math::distributions::coverage_95;
use crate::math::rank;
use crate::measurement::{LengthModel, Measurements};
use crate::robot::{Datum, ParamId, Robot, RobotUncertainty};

/// The input of a calibration.
#[derive(Clone, Copy)]
pub struct Input<'a> {
    /// The start of the fit. A robot that was identified before contains the nominal one.
    pub robot: &'a Robot,
    pub observations: &'a Measurements,
    /// The robot's geometry in the set-up as it was given.
    pub start: &'a LengthModel,
    /// Separate measurements in the same set-up, which are not used in the fit.
    pub validation: Option<&'a Measurements>,
    pub options: &'a Options,
    pub axes: AngleSource,
}

/// The source of the axis angles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AngleSource {
    /// The commanded angles, which the controller may have corrected.
    Commanded,
    /// The user's table, or the program's log.
    Given,
}

impl<'a> Input<'a> {
    /// The estimate alone, without uncertainty, cross-validation and predictions.
    ///
    /// # Errors
    /// A number is not finite, or there is nothing to estimate.
    pub fn fit(&self) -> Result<LengthModel, EstimationFinding> {
        let lengths = Lengths::of(&self.observations.rows, self.options, self.robot);
        Ok(self.estimate(&lengths, &self.setting().asked())?.1.fit.model)
    }

    pub(super) fn setting(&self) -> Setting<'a> {
        Setting::new(self.robot, self.start, self.observations, self.options)
    }

    /// The estimate with the setting that it was made in.
    fn estimate(
        &self,
        lengths: &Lengths,
        asked: &[ParamId],
    ) -> Result<(Setting<'a>, Estimate), EstimationFinding> {
        if self.options.seeks_joint_errors()
            && let Some(found) = self.with_joint_errors(lengths, asked)?
        {
            return Ok(found);
        }
        let setting = self.setting();
        let estimate = estimate(&setting, lengths, asked)?;
        Ok((setting, estimate))
    }

    /// The estimate with errors of the joints, if the lengths support them.
    fn with_joint_errors(
        &self,
        lengths: &Lengths,
        asked: &[ParamId],
    ) -> Result<Option<(Setting<'a>, Estimate)>, EstimationFinding> {
        let mut setting = self.setting().bound();
        let mut found = estimate(&setting, lengths, asked)?;
        if let Some(times) = found.beyond_prior() {
            // Errors of the joints must not compensate the error of a fixed ball.
            if setting.options.hold.iter().any(|id| id.is_setup()) {
                return Ok(None);
            }
            // A default tolerance is widened if the lengths contradict it.
            if self.options.prior == Prior::None {
                setting.priors = setting.priors.widened(times);
                found = estimate(&setting, lengths, asked)?;
            }
        }
        if !joint_errors::can_be_determined(lengths, &found) {
            return Ok(None);
        }
        Ok(joint_errors::fit(&setting, lengths, found).map(|found| (setting, found)))
    }
}

/// An estimate with its uncertainty and checks.
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
    /// The uncertainty of a robot with errors of the joints.
    joint_uncertainty: Option<RobotUncertainty>,
    sigma: SigmaSummary,
    rank: RankSummary,
    folds: Option<Folds>,
    pub(super) validation: Option<BeforeAfter>,
}

impl<'a> Calibration<'a> {
    /// # Errors
    /// A number is not finite, or there is nothing to estimate.
    pub fn new(input: &Input<'a>) -> Result<Self, EstimationFinding> {
        const NOT_FINITE: EstimationFinding = EstimationFinding::NotFinite;
        let lengths = Lengths::of(&input.observations.rows, input.options, input.robot);
        let asked = input.setting().asked();
        let (setting, estimate) = input.estimate(&lengths, &asked)?;
        let folds = cross_validated(&setting, &lengths, &estimate, &asked)?;
        let used = estimate.used(&lengths);
        let (before, model) = (&estimate.before, &estimate.fit.model);
        let uncertainty = Uncertainty::of(&setting, &estimate, &used).ok_or(NOT_FINITE)?;
        let residual_mm = BeforeAfter {
            before: residual_of_used(before, &used).ok_or(NOT_FINITE)?,
            after: residual_of_used(model, &used).ok_or(NOT_FINITE)?,
        };
        let sigma = sigma(&estimate, &lengths);
        if !sigma.mm.is_finite() {
            return Err(NOT_FINITE);
        }
        let draws =
            setting.options.monte_carlo.map(|trials| Draws::of(&setting.priors, &estimate, &lengths, trials));
        let table = ParameterTable {
            setting: &setting,
            estimate: &estimate,
            uncertainty: &uncertainty,
            coverage_factor: sigma.coverage_factor,
            draws: draws.as_ref(),
            combinations: estimate.analysis.combinations(),
        };
        let parameters = table.parameters();
        let validation =
            |set| Some(BeforeAfter { before: residual_of(before, set)?, after: residual_of(model, set)? });
        let validation = input.validation.map(|set| validation(set).ok_or(NOT_FINITE)).transpose()?;
        let mut prediction = Prediction::of(&setting, &estimate, &used)?;
        let joints = estimate.joints.as_ref().map(|fit| JointPrediction::of(&setting, fit, &lengths));
        let joint_uncertainty = joints.map(|JointPrediction { summary, map, unknown }| {
            (prediction.pair.identified, prediction.map) = (summary, map);
            unknown
        });
        let zero_change =
            zero_change(input.observations, &estimate, &lengths, uncertainty.effective_parameters);
        let joint_effects = match estimate.fit.converged {
            true => joint_effects(model, &used, &estimate.base),
            false => Vec::new(),
        };
        Ok(Self {
            prediction,
            zero_change,
            joint_uncertainty,
            rank: RankSummary {
                nominal: estimate.analysis.base.rank,
                at_solution: rank(&factor(model, &lengths.plain(), &estimate.analysis.ids))
                    .ok_or(NOT_FINITE)?,
                condition: estimate.analysis.base.condition,
            },
            joint_effects,
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

    /// Makes the result. `recommendations` come from `design`, `input_findings` from the checks of the inputs.
    pub fn result(
        self,
        recommendations: Vec<Recommendation>,
        input_findings: Vec<Diagnostic>,
    ) -> CalibrationResult {
        let findings = findings(&self);
        let (observability, correlations) = (self.observability(), self.correlations());
        let outliers = self.outliers();
        let Self { setting, estimate, uncertainty, .. } = self;
        let nominal = setting.robot.nominal.clone().unwrap_or_else(|| Box::new(setting.robot.clone()));
        let codes = findings.iter().map(Finding::code).chain(input_findings.iter().map(Diagnostic::code));
        let doubts = codes.filter(|code| code.severity() == Severity::Warning).map(|code| code.to_string());
        CalibrationResult {
            robot: Robot {
                doubts: BTreeSet::from_iter(doubts).into_iter().collect(),
                posterior: self.prediction.posterior,
                geometry: estimate.fit.model.geometry.clone(),
                nominal: Some(nominal),
                uncertainty: self.joint_uncertainty.map(Box::new),
                ..setting.robot.clone()
            },
            lengths: self.observations.count() - outliers.len(),
            made_from: MadeFrom::of(self.observations, &outliers),
            rank: self.rank,
            observability,
            solver: SolverSummary { iterations: estimate.fit.iterations, converged: estimate.fit.converged },
            sigma: self.sigma,
            prior: PriorUsed::of(&setting.options.prior, setting.priors.scale()),
            joints: estimate.joints.as_ref().and_then(JointFit::summary),
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
            input_findings,
            before: estimate.before,
            start: if setting.robot.nominal.is_some() { StartRobot::Identified } else { StartRobot::Nominal },
            posterior: uncertainty.posterior,
        }
    }

    /// The parameters with the status identified.
    pub(crate) fn identified(&self) -> Vec<ParamId> {
        let identified = self.parameters.iter().filter(|parameter| parameter.status() == Status::Identified);
        identified.map(|parameter| parameter.id).collect()
    }

    /// The indices of the identified parameters, in units of their prior standard deviations.
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

    /// Correlations within the base set. Combinations describe the dependence of the other parameters.
    fn correlations(&self) -> Vec<Correlation> {
        let Estimate { kept, base, .. } = &self.estimate;
        let places: Vec<usize> = (0..kept.len()).filter(|&k| base.contains(&kept[k])).collect();
        let covariance = self.uncertainty.posterior.covariance();
        correlations(base, &covariance.select_rows(&places).select_columns(&places))
    }

    fn outliers(&self) -> Vec<Outlier> {
        let after = self.estimate.fit.model.prepare();
        let residual = |place: usize| after.residual(&self.lengths.reading(place));
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
        self.estimate.fit.outliers.iter().copied().filter(is_first).map(outlier).collect()
    }
}

/// Cross-validation. Errors of the joints keep their variances in each fold.
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
            joint_errors::refit(setting, training, estimate, joints).ok_or(EstimationFinding::NotFinite)
        }
        None => Ok(self::estimate(setting, training, asked)?.fit.model),
    };
    let rms = validation::held_out_rms(lengths, &estimate.fit.outliers, folds, fit)?;
    Ok(rms.map(|rms| Folds { folds, rms }))
}

fn sigma(estimate: &Estimate, lengths: &Lengths) -> SigmaSummary {
    let freedom = estimate.noise.freedom;
    let source = match freedom {
        Some(_) => SigmaSource::Estimated,
        None if lengths.known => SigmaSource::Given,
        None => SigmaSource::Assumed,
    };
    let coverage_factor = (source != SigmaSource::Assumed).then(|| coverage_95(freedom));
    SigmaSummary { mm: estimate.used(lengths).rms_sigma(), source, freedom, coverage_factor }
}
