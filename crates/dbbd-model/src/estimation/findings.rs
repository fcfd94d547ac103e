//! Findings about a calibration.

use super::calibration::{AngleSource, Calibration};
use super::contradiction::{contradicted, kinds_disagree};
use super::hypotheses::{EventTreatment, MRAD, RunHypothesis, SupposedEventKind};
use super::lengths::Sigma;
use super::linear_system::factor;
use super::priors::{Prior, largest_plausible};
use super::result::{MonteCarlo, ParameterResult, Status};
use super::workspace::{ErrorSummary, SimplifiedModelError};
use crate::diagnostic::Names;
use crate::estimation::EstimationFinding;
use crate::math::distributions::ChiSquareOutcome;
use crate::measurement::LengthModel;
use crate::robot::{ParamId, Robot, parameter};

/// With a larger fraction of outliers the remaining lengths cannot be relied on either.
const OUTLIER_FRACTION: f64 = 0.1;
/// A robot drawn from its tolerance deviates by less than this fraction of the expectation in fewer than one run of a
/// thousand.
const CLOSEST_TO_NOMINAL: f64 = 0.04;
/// With fewer lengths an agreement with the nominal robot may be chance.
const MIN_LENGTHS: usize = 20;
/// Residuals beyond this number of standard deviations of noise and repeatability are mainly errors that the model
/// lacks.
const FAR: f64 = 5.0;

/// Residuals below this fraction of sigma contradict it,
const FAR_BELOW: f64 = 0.2;
/// if it is larger than that of any bar, mm.
const LARGE_MM: f64 = 0.1;

/// The findings of a calibration, most severe first.
pub(super) fn findings(of: &Calibration<'_>) -> Vec<EstimationFinding> {
    let fit = &of.estimate.fit;
    let mut found = Vec::new();
    if !fit.converged {
        found.push(EstimationFinding::NotConverged { iterations: fit.iterations });
    }
    let (residual_rms_mm, predicted_max_mm) = (of.checks.residual_mm.after.rms, of.prediction.maker.max);
    if fits_no_robot(residual_rms_mm, &of.prediction.maker) {
        found.push(EstimationFinding::FitsWorseThanNominal { residual_rms_mm, predicted_max_mm });
    }
    found.extend(of.hypotheses().iter().filter_map(happened));
    found.extend(beyond_prior(of));
    found.extend(implausible(of));
    found.extend(displaced(of));
    found.extend(contradicted(of));
    found.extend(of.estimate.shifted_rows(&of.lengths));
    found.extend(kinds_disagree(&of.estimate, &of.lengths));
    found.extend(outliers(fit.outliers.len(), of.lengths.len()));
    found.extend(consistency(of));
    found.extend(against_repeatability(of));
    found.extend(position(of));
    found.extend(poorly_observable(&of.parameters));
    let identified = Robot { geometry: fit.model.geometry.clone(), ..of.setting.robot.clone() };
    let beyond =
        |left_out: SimplifiedModelError| EstimationFinding::BeyondTable { left_out_mm: left_out.mean_mm };
    found.extend(SimplifiedModelError::of(&identified).map(beyond));
    found.extend(approach_unknown(of));
    found.extend(of.checks.monte_carlo.iter().flat_map(monte_carlo));
    found.extend(absolute_accuracy_mode(of));
    found
}

/// The finding for an event that happened while the lengths were measured, or could have happened; `None` if the
/// hypothesis lacks the part that the finding names.
fn happened(found: &RunHypothesis) -> Option<EstimationFinding> {
    let RunHypothesis { name, place, size, sd, probability, rivals, treated } = found;
    let (size_mm, sd_mm) = (*size, *sd);
    if *treated == EventTreatment::Reported {
        let rivals: Vec<&str> = rivals.iter().map(|rival| rival.name()).collect();
        let rivals = match rivals.is_empty() {
            true => String::new(),
            false => format!("; or {}", rivals.join(", or ")),
        };
        let (event, size, unit, probability) = (name.name(), *size, name.unit(), *probability);
        return Some(match place.index {
            Some(index) => EstimationFinding::CouldBeFrom { event, index, size, unit, probability, rivals },
            None => EstimationFinding::CouldBe { event, size, unit, probability, rivals },
        });
    }
    Some(match name {
        SupposedEventKind::BarZeroStep => {
            EstimationFinding::ZeroStep { bar: place.bar?, index: place.index?, by_mm: size_mm, sd_mm }
        }
        SupposedEventKind::BarZeroDrift => {
            EstimationFinding::ZeroDrift { bar: place.bar?, by_mm: size_mm, sd_mm }
        }
        SupposedEventKind::BaseBallMoved => {
            EstimationFinding::BaseBallMoved { ball: place.ball?, index: place.index?, size_mm, sd_mm }
        }
        SupposedEventKind::ToolBallMoved => {
            EstimationFinding::ToolBallMoved { index: place.index?, size_mm, sd_mm }
        }
        SupposedEventKind::JointZeroStep => {
            let [by_deg, sd_deg] = [*size, *sd].map(|mrad| (mrad / MRAD).to_degrees());
            EstimationFinding::AxisZeroStep { axis: place.joint?, index: place.index?, by_deg, sd_deg }
        }
        SupposedEventKind::TrackerMoved => {
            EstimationFinding::TrackerStep { index: place.index?, size_mm, sd_mm }
        }
        SupposedEventKind::TrackerDrift => EstimationFinding::TrackerDrift { size_mm, sd_mm },
        SupposedEventKind::WrongBall => {
            EstimationFinding::WrongBall { ball: place.ball?, indices: Names::of(place.rows.iter()) }
        }
        // It is only a rival of the other events.
        SupposedEventKind::BallOffset => return None,
    })
}

/// Compares the corrections with the prior.
fn beyond_prior(of: &Calibration<'_>) -> Option<EstimationFinding> {
    if of.setting.options.follows_list() {
        return None;
    }
    let times = of.estimate.beyond_prior(&of.setting)?;
    let is_default = of.setting.options.prior == Prior::Datasheet;
    // A default tolerance was widened to fit the lengths, so only impossible corrections get a warning.
    Some(match times > largest_plausible(!is_default) {
        true => EstimationFinding::FarBeyondPrior { times },
        false if is_default => EstimationFinding::PriorWidened { times },
        false => EstimationFinding::BeyondPrior { times },
    })
}

/// Implausible corrections: they compensate a fixed part of the set-up, or it is another robot.
fn implausible(of: &Calibration<'_>) -> Option<EstimationFinding> {
    let fixed: Vec<&ParamId> = of.setting.options.hold.iter().filter(|id| id.is_setup()).collect();
    let times = largest_plausible(!fixed.is_empty());
    let is_excessive = |parameter: &&ParameterResult| {
        let sd = parameter.sd.unwrap_or(0.0);
        let excess = of.setting.priors.excess(parameter.name, parameter.correction, sd);
        excess.is_some_and(|excess| excess > times)
    };
    let parameters = names(of.parameters.iter().filter(is_excessive))?;
    Some(if fixed.is_empty() {
        EstimationFinding::Implausible { parameters, times }
    } else {
        EstimationFinding::ImplausibleWithFixed { fixed: Names::of(fixed), parameters, times }
    })
}

/// Balls and bars with implausibly large corrections.
fn displaced(of: &Calibration<'_>) -> Option<EstimationFinding> {
    // The robot file states how accurately the tool ball is mounted.
    let of_tool_mm = largest_plausible(false) * of.setting.robot.ball_u_mm;
    let max_mm =
        |id: ParamId| matches!(id, ParamId::Tool(_)).then_some(of_tool_mm).or_else(|| id.max_correction_mm());
    let is_displaced = |found: &&ParameterResult| {
        max_mm(found.name).is_some_and(|max_mm| (found.identified - found.start).abs() > max_mm)
    };
    Some(EstimationFinding::Displaced { parameters: names(of.parameters.iter().filter(is_displaced))? })
}

fn outliers(outliers: usize, lengths: usize) -> Option<EstimationFinding> {
    if outliers as f64 > OUTLIER_FRACTION * lengths as f64 {
        Some(EstimationFinding::ManyOutliers { outliers, lengths })
    } else {
        (outliers > 0).then_some(EstimationFinding::Outliers { outliers })
    }
}

/// Compares the residuals with the given standard deviations.
fn consistency(of: &Calibration<'_>) -> Option<EstimationFinding> {
    let (estimate, lengths) = (&of.estimate, &of.lengths);
    let used = lengths.weighted(Sigma::Given, &estimate.fit.outliers);
    let parameters = of.estimate.effective_parameters();
    let freedom = used.count() as f64 - parameters;
    if freedom < 1.0 {
        return Some(EstimationFinding::NoFreedom { lengths: used.count(), parameters });
    }
    if !lengths.known {
        return None;
    }
    let prepared = estimate.fit.model.prepare();
    let ratio_to = |shared_mm: f64| {
        used.sum(|reading, sigma| (prepared.residual(reading) / sigma.hypot(shared_mm)).powi(2)) / freedom
    };
    let ratio = ratio_to(0.0);
    let times = ratio.sqrt();
    match ChiSquareOutcome::of(ratio, freedom) {
        ChiSquareOutcome::Greater if lengths.is_sigma_given => Some(EstimationFinding::BeyondSigma { times }),
        ChiSquareOutcome::Greater if estimate.freedom.is_none() => {
            Some(EstimationFinding::BeyondSigmaOfFew { times })
        }
        ChiSquareOutcome::Greater => {
            // The sigma of a bar does not contain how the robot repeats.
            let ratio = ratio_to(of.setting.robot.repeatability_sd_mm().unwrap_or(0.0));
            let is_more = matches!(ChiSquareOutcome::of(ratio, freedom), ChiSquareOutcome::Greater);
            is_more.then_some(EstimationFinding::AboveSigma { times: ratio.sqrt() })
        }
        ChiSquareOutcome::Less => {
            let sigma_mm = used.rms_sigma();
            Some(match times < FAR_BELOW && sigma_mm > LARGE_MM {
                true => EstimationFinding::FarBelowSigma { sigma_mm, times },
                false => EstimationFinding::BelowSigma { times },
            })
        }
        ChiSquareOutcome::AsExpected => None,
    }
}

/// Whether a fit leaves more than the nominal robot could be off, whose predicted position errors are `maker`: lengths and poses
/// do not belong to one robot.
pub fn fits_no_robot(residual_rms_mm: f64, maker: &ErrorSummary) -> bool {
    residual_rms_mm > maker.max
}

/// A finding if the residuals are far above the repeatability of the robot and the standard deviation `sigma_mm` of the
/// lengths.
pub fn beyond_repeatability(residual_rms_mm: f64, sigma_mm: f64, robot: &Robot) -> Option<EstimationFinding> {
    let repeatability_mm = robot.repeatability_sd_mm()?;
    (residual_rms_mm > FAR * repeatability_mm.hypot(sigma_mm))
        .then_some(EstimationFinding::BeyondRepeatability { residual_rms_mm, repeatability_mm })
}

/// Compares the residuals of the used lengths, and of separate validation lengths, with the repeatability.
fn against_repeatability(of: &Calibration<'_>) -> Option<EstimationFinding> {
    let robot = of.setting.robot;
    let given = of.lengths.weighted(Sigma::Given, &of.estimate.fit.outliers);
    let given_mm = if of.lengths.known { given.rms_sigma() } else { 0.0 };
    let residual_rms_mm = of.checks.residual_mm.after.rms;
    if let Some(far) = beyond_repeatability(residual_rms_mm, given_mm, robot) {
        return Some(far);
    }
    let least_mm = robot.repeatability_sd_mm()?.hypot(given_mm);
    let held_out_mm = of.checks.validation.as_ref()?.after.rms;
    (held_out_mm > FAR * least_mm.max(residual_rms_mm))
        .then_some(EstimationFinding::HeldOutDiffers { held_out_mm, residual_rms_mm })
}

/// Whether the lengths determine the position of the robot, and not only the residuals.
fn position(of: &Calibration<'_>) -> Option<EstimationFinding> {
    if of.prediction.is_determined() {
        return None;
    }
    let residual_rms_mm = of.checks.residual_mm.after.rms;
    let (identified_mm, nominal_mm) = (of.prediction.pair.identified.mean, of.prediction.maker.mean);
    // With a list the user knows that the other parameters are fixed; but the robot must not become worse.
    Some(if of.setting.options.follows_list() && identified_mm < nominal_mm {
        EstimationFinding::ListImprovesLittle { residual_rms_mm, identified_mm, nominal_mm }
    } else {
        EstimationFinding::PositionUndetermined { residual_rms_mm, identified_mm, nominal_mm }
    })
}

/// The gain that the sense of approach would bring, if no row has it.
fn approach_unknown(of: &Calibration<'_>) -> Option<EstimationFinding> {
    let (backlash_mm, identified_mm) = (of.prediction.parts.backlash_mm, of.prediction.pair.identified.mean);
    (of.estimate.lacks_approach() && backlash_mm > WORTH_ASKING * identified_mm)
        .then_some(EstimationFinding::ApproachUnknown { backlash_mm, identified_mm })
}

/// A part of the predicted uncertainty that is worth a message.
const WORTH_ASKING: f64 = 0.2;

fn poorly_observable(parameters: &[ParameterResult]) -> Option<EstimationFinding> {
    let poor = parameters.iter().filter(|parameter| parameter.status == Status::PoorlyObservable);
    Some(EstimationFinding::PoorlyObservable { parameters: names(poor)? })
}

fn monte_carlo(drawn: &MonteCarlo) -> impl Iterator<Item = EstimationFinding> {
    let MonteCarlo { trials, used, disagree } = drawn;
    let failed = (used < trials)
        .then(|| EstimationFinding::TrialsNotConverged { failed: trials - used, trials: *trials });
    let disagree = (!disagree.is_empty())
        .then(|| EstimationFinding::IntervalsDisagree { parameters: Names::of(disagree) });
    failed.into_iter().chain(disagree)
}

/// `None` without parameters.
fn names<'a>(parameters: impl Iterator<Item = &'a ParameterResult>) -> Option<Names> {
    let names = Names::of(parameters.map(|parameter| parameter.name));
    (!names.0.is_empty()).then_some(names)
}

/// Whether the lengths agree with the nominal robot better than its tolerance allows: the controller corrected its axis angles.
fn absolute_accuracy_mode(of: &Calibration<'_>) -> Option<EstimationFinding> {
    let robot = of.setting.robot;
    let few = of.axes == AngleSource::Given && of.lengths.len() < MIN_LENGTHS;
    // A robot that was identified before should agree.
    if robot.nominal.is_some() || few {
        return None;
    }
    let ids = parameter::parse_list("geometric", &robot.parallel_joints(), 0_usize).ok()?;
    let model = LengthModel { geometry: robot.geometry.clone(), ..of.estimate.fit.model.clone() };
    let rows = factor(&model, &of.lengths.plain(), &ids);
    let tolerance = |id: &ParamId| of.setting.priors.geometric(*id).unwrap_or(0.0);
    let squares =
        rows.column_iter().zip(&ids).map(|(column, id)| column.norm_squared() * tolerance(id).powi(2));
    let expected_mm = (squares.sum::<f64>() / of.lengths.len().max(1) as f64).sqrt();
    let residual_rms_mm = of.checks.residual_mm.before.rms;
    (residual_rms_mm < CLOSEST_TO_NOMINAL * expected_mm)
        .then_some(EstimationFinding::AbsoluteAccuracyMode { residual_rms_mm, expected_mm })
}
