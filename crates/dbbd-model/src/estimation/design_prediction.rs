//! The predicted outcome of planned lengths: rank, standard deviations, observability indices, position uncertainty.

use super::estimator::Estimate;
use super::position::ToolPoses;
use super::priors::WEAK;
use super::{
    Analysis, ErrorSummary, EstimationFinding, Forecast, Input, Observability, Options, Posterior, analyse,
    factor, inverse_root, observability,
};
use crate::measurement::{Measurement, Measurements, PreparedMeasurement};
use crate::robot::ParamId;

/// Lengths that are planned, beside those that were measured before.
pub struct PlannedLengths<'a> {
    /// The identification of the lengths that were measured before, with its estimate.
    measured: Input<'a>,
    estimate: Option<Estimate>,
    planned: &'a [Measurement],
}

pub struct DesignPrediction {
    /// Rank and linearly dependent parameters.
    pub analysis: Analysis,
    /// The indices of the identifiable parameters, in units of their prior standard deviations.
    pub observability: Option<Observability>,
    pub parameters: Vec<ParameterPrediction>,
    /// What an identification will state.
    pub forecast: Forecast,
}

/// Standard deviations of a parameter, mm or rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParameterPrediction {
    pub id: ParamId,
    pub before: f64,
    pub after: f64,
    /// Standard deviation by the lengths alone, for a parameter of the base set.
    pub alone: Option<f64>,
}

impl<'a> PlannedLengths<'a> {
    /// # Errors
    /// The measured lengths have no estimate.
    pub fn new(measured: Input<'a>, planned: &'a [Measurement]) -> Result<Self, EstimationFinding> {
        let is_first = measured.observations.rows.is_empty();
        let estimate = if is_first { None } else { Some(measured.estimate()?) };
        Ok(Self { measured, estimate, planned })
    }

    /// The same lengths, with the position error over other poses by these options.
    #[must_use]
    pub fn over(&self, options: &'a Options) -> Self {
        Self { measured: Input { options, ..self.measured }, estimate: self.estimate.clone(), ..*self }
    }

    pub fn planned(&self) -> &'a [Measurement] {
        self.planned
    }

    /// The position error as an identification of the measured lengths states it, mm; without any, as the robot's file has it.
    pub fn stated_before(&self) -> ErrorSummary {
        self.measured.stated_position_mm(self.estimate.as_ref())
    }

    /// The position errors at poses of tools that an identification of all these lengths leaves, of robots that are drawn from what is
    /// known: the variances of their errors of `variances` kinds first, then the errors. `None` if a number is not finite.
    pub fn drawn_errors(&self, tools: &[ToolPoses], variances: u64) -> Option<Vec<ErrorSummary>> {
        let measured = &self.measured.observations.rows;
        let rows = measured.iter().chain(self.planned).cloned().collect();
        let observations = Measurements { rows, ..Measurements::default() };
        let input = Input { observations: &observations, ..self.measured };
        input.drawn_errors(self.estimate.as_ref(), tools, 0..variances).ok()
    }

    /// Predicts the effect of these planned lengths (places among the planned ones), of standard deviation `sigma_mm`, on `prior`.
    /// `None` if a number is not finite.
    pub fn predict(
        &self,
        prior: &Posterior,
        places: impl Iterator<Item = usize>,
        sigma_mm: f64,
    ) -> Option<DesignPrediction> {
        let rows: Vec<Measurement> = places.map(|at| self.planned[at].clone()).collect();
        let readings: Vec<PreparedMeasurement> = rows.iter().map(PreparedMeasurement::from).collect();
        let Measurements { rows: measured, .. } = self.measured.observations;
        let observations =
            Measurements { rows: measured.iter().cloned().chain(rows).collect(), ..Measurements::default() };
        let forecast =
            Input { observations: &observations, ..self.measured }.forecast(self.estimate.as_ref()).ok()?;
        let analysis = analyse(&prior.model, readings.as_slice(), prior.ids())?;
        let kept = analysis.kept();
        let mut scaled = factor(&prior.model, readings.as_slice(), &kept);
        for (at, id) in kept.iter().enumerate() {
            scaled.column_mut(at).scale_mut(prior.sd(*id).unwrap_or(1.0));
        }
        let inverse = inverse_root(&scaled);
        let alone = |id: ParamId| {
            let at = kept.iter().position(|other| *other == id)?;
            Some(inverse.as_ref()?.row(at).norm() * prior.sd(id)? * sigma_mm)
        };
        let parameter = |(&id, before): (&ParamId, f64)| {
            let after = forecast.posterior.sd(id).unwrap_or(before);
            ParameterPrediction { id, before, after, alone: alone(id) }
        };
        // A combination that is determined only by rounding would dominate all indices.
        let is_identifiable =
            |id: ParamId| alone(id).is_some_and(|alone| alone <= WEAK * prior.sd(id).unwrap_or(0.0));
        let identifiable: Vec<usize> = (0..kept.len()).filter(|&at| is_identifiable(kept[at])).collect();
        Some(DesignPrediction {
            observability: observability(&scaled.select_columns(&identifiable), readings.len()),
            parameters: prior.ids().iter().zip(prior.sds()).map(parameter).collect(),
            analysis,
            forecast,
        })
    }
}
