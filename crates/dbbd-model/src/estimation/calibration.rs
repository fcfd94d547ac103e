//! A calibration: the estimate, its uncertainty and checks.

mod completion;

use std::ops::Range;

use super::estimator::{Estimate, ForecastStart, ForecastVariances, estimate, refit};
use super::hypotheses::{EventPlace, EventTreatment, RunHypothesis, SupposedEventKind};
use super::lengths::Lengths;
use super::monte_carlo::Draws;
use super::options::Setting;
use super::parameters::ParameterTable;
use super::position::{ToolPoses, compressed, drawn_errors};
use super::posterior::Posterior;
use super::prediction::{IdentifiedPositions, Prediction, compressing_poses, position_before};
use super::result::{BeforeAfter, Folds, MapPoint, MonteCarlo, ParameterResult, SigmaSource, Status};
use super::selection::data_sd;
use super::validation::{self, residual_of, residual_of_used};
use super::{ErrorSummary, Options, factor};
use crate::estimation::EstimationFinding;
use crate::math::distributions::coverage_95;
use crate::math::{map_items, rank};
use crate::measurement::{LengthModel, Measurements};
use crate::robot::{BallId, ParamId, Robot, RobotUncertainty};

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

/// The expected statement of an identification about lengths that are planned.
pub struct Forecast {
    /// The position uncertainty over the workspace after the lengths, mm.
    pub position_mm: ErrorSummary,
    /// The position uncertainty over the workspace after the lengths.
    pub map: Vec<MapPoint>,
    /// The robot, its set-up and the bars after the lengths.
    pub(super) posterior: Posterior,
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
        Ok(self.estimate()?.fit.model)
    }

    /// The posterior of the robot, its set-up and the bars, with the prior of what the lengths do not show.
    ///
    /// # Errors
    /// A number is not finite, or there is nothing to estimate.
    pub fn posterior(&self) -> Result<Posterior, EstimationFinding> {
        let found = self.estimate()?;
        // A parameter that no length shows is as before, and so is a further ball. The place of the robot's base, which only the
        // balls show, is where it is stated: its error is that of the balls.
        let is_unseen = |id: &ParamId| matches!(id, ParamId::Ball(..)) || found.analysis.zero().contains(id);
        let priors = self.setting().priors;
        let mut all = Posterior::parameters_of_prior(self.robot, self.start.balls.len(), &priors);
        all.retain(|(id, _)| is_unseen(id));
        let known = RobotUncertainty {
            parameters: found.kept.clone(),
            root: found.root.clone(),
            ..found.uncertainty(self.robot)
        };
        let by = compressing_poses(&self.options.workspace_poses(self.robot), &self.lengths());
        let known = compressed(&found.fit.model, &known, &by);
        let posterior = Posterior::with_root(found.fit.model, &known.parameters, known.root.clone());
        Ok(posterior.with_errors_of_pose(&known).with_parameters(&all))
    }

    pub(super) fn estimate(&self) -> Result<Estimate, EstimationFinding> {
        let setting = self.setting();
        estimate(&setting, &self.lengths(), &setting.asked())
    }

    fn lengths(&self) -> Lengths<'a> {
        Lengths::of(&self.observations.rows, self.options, self.robot)
    }

    /// The position uncertainty over the workspace that an identification of these lengths states with an estimate of them, mm;
    /// without an estimate that before any length.
    pub(super) fn stated_position_mm(&self, found: Option<&Estimate>) -> ErrorSummary {
        match found {
            Some(found) => IdentifiedPositions::of(&self.setting(), found, &self.lengths()).summary,
            None => position_before(&self.setting()),
        }
    }

    /// What an identification of these lengths is expected to state after the estimate `before` of some of them.
    pub(super) fn forecast(&self, before: Option<&Estimate>) -> Result<Forecast, EstimationFinding> {
        let (setting, lengths) = (self.setting(), self.lengths());
        let variances = before.map_or(ForecastVariances::Expected, ForecastVariances::Found);
        let start = ForecastStart::new(&setting, &lengths, &setting.asked())?;
        let expected = start.forecast(variances).ok_or(EstimationFinding::NotFinite)?;
        let IdentifiedPositions { summary, map, .. } = IdentifiedPositions::of(&setting, &expected, &lengths);
        let posterior = Posterior::with_root(expected.fit.model, &expected.kept, expected.root);
        Ok(Forecast { position_mm: summary, map, posterior })
    }

    /// The position errors at poses of tools that identifications of these lengths are expected to leave: those of robots that are
    /// drawn, with variances of each seed, after the estimate `before` of some of the lengths.
    pub(super) fn drawn_errors(
        &self,
        before: Option<&Estimate>,
        tools: &[ToolPoses],
        seeds: Range<u64>,
    ) -> Result<Vec<ErrorSummary>, EstimationFinding> {
        let (setting, lengths) = (self.setting(), self.lengths());
        // Variances that were found are not drawn.
        let seeds: Vec<u64> = if before.is_some() { vec![seeds.start] } else { seeds.collect() };
        let start = ForecastStart::new(&setting, &lengths, &setting.asked())?;
        let robots = |seed: &u64| {
            let expected =
                start.forecast(before.map_or(ForecastVariances::Drawn(*seed), ForecastVariances::Found))?;
            let unknown = expected.uncertainty(self.robot);
            let errors =
                drawn_errors(&expected.fit.model.geometry, &unknown, &self.robot.tolerance, tools, *seed);
            let of_robot = |column| ErrorSummary::of(&errors.columns(column, 1).into_owned());
            Some((0..errors.ncols()).map(of_robot).collect::<Vec<_>>())
        };
        let robots: Option<Vec<Vec<ErrorSummary>>> = map_items(&seeds, robots).into_iter().collect();
        Ok(robots.ok_or(EstimationFinding::NotFinite)?.concat())
    }

    pub(super) fn setting(&self) -> Setting<'a> {
        Setting::new(self.robot, self.start, self.observations, self.options)
    }
}

/// An estimate with its uncertainty and checks.
pub struct Calibration<'a> {
    pub(crate) setting: Setting<'a>,
    pub(super) axes: AngleSource,
    observations: &'a Measurements,
    pub(crate) lengths: Lengths<'a>,
    pub(crate) estimate: Estimate,
    pub(crate) prediction: Prediction,
    pub(super) posterior: Posterior,
    sigma: LengthSigma,
    rank_at_solution: usize,
    pub(super) parameters: Vec<ParameterResult>,
    pub(super) checks: EstimateChecks,
}

/// The checks of an estimate.
pub(super) struct EstimateChecks {
    pub(super) residual_mm: BeforeAfter,
    folds: Option<Folds>,
    /// Residuals of separate lengths.
    pub(super) validation: Option<BeforeAfter>,
    pub(super) monte_carlo: Option<MonteCarlo>,
}

impl<'a> Calibration<'a> {
    /// # Errors
    /// A number is not finite, or there is nothing to estimate.
    pub fn new(input: &Input<'a>) -> Result<Self, EstimationFinding> {
        const NOT_FINITE: EstimationFinding = EstimationFinding::NotFinite;
        let lengths = Lengths::of(&input.observations.rows, input.options, input.robot);
        let setting = input.setting();
        let estimate = estimate(&setting, &lengths, &setting.asked())?;
        let lengths = estimate.corrected(&lengths);
        let folds = cross_validated(&setting, &lengths, &estimate);
        let used = estimate.used(&lengths);
        let (before, model) = (&estimate.before, &estimate.fit.model);
        let posterior = Posterior::with_root(model.clone(), &estimate.kept, estimate.root.clone());
        let residual_mm = BeforeAfter {
            before: residual_of_used(before, &used).ok_or(NOT_FINITE)?,
            after: residual_of_used(model, &used).ok_or(NOT_FINITE)?,
        };
        let sigma = LengthSigma::of(&estimate, &lengths);
        if !sigma.mm.is_finite() {
            return Err(NOT_FINITE);
        }
        let draws = setting.options.monte_carlo.map(|trials| Draws::of(&estimate, &lengths, trials));
        let table = ParameterTable {
            setting: &setting,
            estimate: &estimate,
            posterior: &posterior,
            data_sd: data_sd(model, &used, &estimate.base).unwrap_or_default(),
            coverage_factor: sigma.coverage_factor(),
            draws: draws.as_ref(),
            combinations: estimate.analysis.combinations(),
        };
        let parameters = table.parameters();
        let validation =
            |set| Some(BeforeAfter { before: residual_of(before, set)?, after: residual_of(model, set)? });
        let checks = EstimateChecks {
            residual_mm,
            folds,
            validation: input.validation.map(|set| validation(set).ok_or(NOT_FINITE)).transpose()?,
            monte_carlo: draws.map(|draws| draws.summary(&parameters)),
        };
        let prediction = Prediction::of(&setting, &estimate, &lengths);
        Ok(Self {
            rank_at_solution: rank(&factor(model, &lengths.plain(), &estimate.analysis.ids))
                .ok_or(NOT_FINITE)?,
            axes: input.axes,
            observations: input.observations,
            prediction,
            parameters,
            posterior,
            checks,
            sigma,
            setting,
            estimate,
            lengths,
        })
    }

    /// The posterior of the robot, its set-up and the bars.
    pub(crate) fn posterior(&self) -> Posterior {
        let Estimate { fit, kept, root, .. } = &self.estimate;
        // The same covariance with as few columns as it can have.
        let square = root.transpose().qr().r().transpose();
        Posterior::with_root(fit.model.clone(), kept, square)
    }

    /// The parameters with the status identified.
    pub(crate) fn identified(&self) -> Vec<ParamId> {
        let identified = self.parameters.iter().filter(|parameter| parameter.status == Status::Identified);
        identified.map(|parameter| parameter.name).collect()
    }

    /// Events that happened while the lengths were measured, or could have happened: wrong ball numbers, then the
    /// events in the order in which they were found.
    pub(super) fn hypotheses(&self) -> Vec<RunHypothesis> {
        let index = |place: usize| self.observations.rows[place].index;
        let mut found: Vec<RunHypothesis> = Vec::new();
        let wrong = &self.estimate.wrong_balls;
        let mut balls: Vec<BallId> = wrong.iter().map(|(_, ball)| *ball).collect();
        balls.sort_unstable();
        balls.dedup();
        for ball in balls {
            let rows: Vec<u32> =
                wrong.iter().filter(|(_, own)| *own == ball).map(|(place, _)| index(*place)).collect();
            let place = EventPlace {
                ball: Some(ball.number()),
                index: rows.first().copied(),
                rows,
                ..EventPlace::default()
            };
            found.push(RunHypothesis {
                name: SupposedEventKind::WrongBall,
                place,
                size: 0.0,
                sd: 0.0,
                probability: 1.0,
                rivals: Vec::new(),
                treated: EventTreatment::Unknown,
            });
        }
        found.extend(self.estimate.events.iter().map(|event| event.hypothesis(index)));
        found
    }
}

/// Cross-validation. The variances stay as they are in each fold.
fn cross_validated(setting: &Setting<'_>, lengths: &Lengths, estimate: &Estimate) -> Option<Folds> {
    let folds = validation::folds(setting.options.folds, lengths.len(), estimate.base.len())?;
    let fit = |training: &Lengths| refit(training, estimate).map(|[_, at_rest]| at_rest);
    let rms = validation::held_out_rms(lengths, &estimate.fit.outliers, folds, fit)?;
    Some(Folds { folds, rms })
}

/// The standard deviation of a length, mm.
#[derive(Clone, Copy)]
struct LengthSigma {
    mm: f64,
    source: SigmaSource,
    /// Degrees of freedom, if it was estimated.
    freedom: Option<f64>,
}

impl LengthSigma {
    fn of(estimate: &Estimate, lengths: &Lengths) -> Self {
        let freedom = estimate.freedom;
        let source = match freedom {
            Some(_) => SigmaSource::Estimated,
            None if lengths.known => SigmaSource::Given,
            None => SigmaSource::Assumed,
        };
        Self { mm: estimate.used(lengths).rms_sigma(), source, freedom }
    }

    /// The coverage factor of a 95 % interval; `None` if sigma is unknown.
    fn coverage_factor(self) -> Option<f64> {
        (self.source != SigmaSource::Assumed).then(|| coverage_95(self.freedom))
    }
}
