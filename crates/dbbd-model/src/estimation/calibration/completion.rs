//! The result of a calibration.

use std::collections::BTreeSet;
use std::ops::Range;

use super::super::estimator::Estimate;
use super::super::findings::findings;
use super::super::identifiability::{correlations, observability};
use super::super::prediction::drift_after;
use super::super::result::{
    CalibrationResult, CompletedCalibration, Effort, MadeFrom, MapPoint, NoiseSummary, Outlier,
    RESULT_SCHEMA, Recommendation, StartRobot,
};
use super::super::validity::ValidityLimit;
use super::super::{Correlation, DistanceQuantities, ErrorModel, Observability, Validity, factor};
use super::Calibration;
use crate::diagnostic::{Diagnostic, RecordedFinding, Severity};
use crate::measurement::Measurements;
use crate::robot::{Datum, Geometry, Robot, RobotUncertainty};
impl Calibration<'_> {
    /// Makes the result. `recommendations` come from `design`, `input_findings` from the checks of the inputs.
    pub fn complete(
        self,
        recommendations: Vec<Recommendation>,
        input_findings: Vec<Diagnostic>,
    ) -> CompletedCalibration {
        let mut findings: Vec<Diagnostic> = findings(&self).into_iter().map(Diagnostic::from).collect();
        let of_estimate = findings.len();
        findings.extend(input_findings);
        let (observability, correlated) = (self.observability(), self.correlations());
        let hypotheses = self.hypotheses();
        let (excluded_rows, outliers): (Vec<Range<usize>>, Vec<Outlier>) = self.outliers().unzip();
        let Self { setting, estimate, prediction, posterior, sigma, checks, .. } = self;
        let nominal = setting.robot.nominal.clone().unwrap_or_else(|| Box::new(setting.robot.clone()));
        let warnings = findings.iter().filter(|finding| finding.severity() == Severity::Warning);
        let joint_errors = estimate.joint_summary();
        let robot = Robot {
            warnings: BTreeSet::from_iter(warnings.map(|finding| finding.code().to_string()))
                .into_iter()
                .collect(),
            posterior: prediction.posterior,
            geometry: with_measured_payloads(estimate.fit.model.geometry.clone(), self.observations),
            nominal: Some(nominal),
            uncertainty: Some(Box::new(RobotUncertainty {
                shared_mm: estimate
                    .shape
                    .sought_own_sd()
                    .map(|own| (sigma.mm.powi(2) - own.powi(2)).max(0.0).sqrt()),
                ..prediction.uncertainty
            })),
            measured: setting.options.measured.clone(),
            drift: drift_after(&setting, &estimate),
            ..setting.robot.clone()
        };
        let result = CalibrationResult {
            schema: RESULT_SCHEMA,
            robot: setting.robot.name.clone(),
            model: if joint_errors.is_some() { ErrorModel::Joints } else { ErrorModel::Geometric },
            start: if setting.robot.nominal.is_some() { StartRobot::Identified } else { StartRobot::Nominal },
            prior: (&setting.options.prior).into(),
            prior_scale: (!setting.options.follows_list()).then(|| estimate.tolerance_scale()),
            measurements: self.observations.count() - outliers.len(),
            made_from: MadeFrom::of(self.observations, &outliers),
            effort: Some(Effort::of(
                &self.observations.rows,
                self.observations.count() - outliers.len(),
                &prediction.map,
                &prediction.parts,
            )),
            rank: estimate.analysis.base.rank,
            rank_at_solution: self.rank_at_solution,
            condition: estimate.analysis.base.condition,
            observability,
            iterations: estimate.fit.iterations,
            converged: estimate.fit.converged,
            noise_mm: NoiseSummary {
                length: sigma.mm,
                pose: joint_errors.as_ref().map(|_| estimate.noise.pose_mm),
                instrument: joint_errors.as_ref().map(|_| estimate.noise.length_mm),
                degrees_of_freedom: sigma.freedom,
            },
            sigma_source: sigma.source,
            coverage_factor: sigma.coverage_factor(),
            residual_mm: checks.residual_mm,
            folds: checks.folds,
            validation: checks.validation,
            distance: DistanceQuantities::of_places(
                &self.observations.rows,
                estimate.used(&self.lengths).used_places(),
                |place| self.lengths.reading(place),
                &estimate.fit.model,
            ),
            groups: estimate.groups.clone(),
            joint_errors,
            hypotheses,
            monte_carlo: checks.monte_carlo,
            predicted_position_uncertainty_mm: prediction.pair,
            predicted_orientation_uncertainty_mrad: Some(prediction.orientation),
            max_uncertainty: MapPoint::max_uncertainty(&prediction.map),
            validity: Validity::of(
                &robot,
                setting.options.tolerance_mm.map(ValidityLimit::Tolerance),
                &prediction.map,
            ),
            parameters: self.parameters,
            combinations: estimate.analysis.combinations(),
            correlated,
            outliers,
            excluded: Vec::new(),
            recommendations,
            findings: findings.iter().cloned().map(RecordedFinding::from).collect(),
        };
        CompletedCalibration {
            result,
            robot,
            before: estimate.before,
            posterior,
            position_parts: prediction.parts,
            map: prediction.map,
            excluded_rows,
            event_mm: estimate.event_mm,
            wrong_balls: estimate.wrong_balls,
            of_estimate,
        }
    }

    /// The indices of the identified parameters, in units of their prior standard deviations.
    fn observability(&self) -> Option<Observability> {
        let identified = self.identified();
        let used = self.estimate.used(&self.lengths);
        let mut scaled = factor(&self.estimate.fit.model, &used, &identified);
        for (mut column, id) in scaled.column_iter_mut().zip(&identified) {
            column *= self.sigma.mm * self.setting.priors.sd(*id);
        }
        observability(&scaled, used.count())
    }

    /// Correlations within the base set. Combinations describe the dependence of the other parameters.
    fn correlations(&self) -> Vec<Correlation> {
        let Estimate { kept, base, .. } = &self.estimate;
        let places: Vec<usize> = (0..kept.len()).filter(|&k| base.contains(&kept[k])).collect();
        let covariance = self.posterior.covariance();
        correlations(base, &covariance.select_rows(&places).select_columns(&places))
    }

    /// The outliers, each with its rows of the observations.
    fn outliers(&self) -> impl Iterator<Item = (Range<usize>, Outlier)> {
        let after = self.estimate.fit.model.prepare();
        let outlier = move |place: usize| {
            let residual = |place: usize| after.residual(&self.lengths.reading(place));
            let row = &self.observations.rows[place];
            let places = row.datum.rows(place);
            let residual_mm = match row.datum {
                Datum::Ball(..) => residual(place),
                Datum::Plane(_) => places.clone().map(|at| residual(at).powi(2)).sum::<f64>().sqrt(),
            };
            let (ball, axes_deg) = (row.datum.ball(), row.axes.degrees());
            (places, Outlier { index: row.index, ball, axes_deg, residual_mm })
        };
        let is_first = move |place: &usize| self.observations.rows[*place].datum.is_first();
        self.estimate.fit.outliers.iter().copied().filter(is_first).map(outlier)
    }
}

/// A geometry, with the payloads marked that rows were measured with.
fn with_measured_payloads(mut geometry: Geometry, measured: &Measurements) -> Geometry {
    for row in &measured.rows {
        if let Some(payload) = geometry.load.payloads.get_mut(row.payload.index()) {
            payload.is_measured = true;
        }
    }
    geometry
}
