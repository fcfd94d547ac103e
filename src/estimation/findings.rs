//! What is doubted or worth knowing of a result.

use super::calibration::{AngleSource, Calibration};
use super::contradiction::kinds_disagree;
use super::held::contradicted;
use super::left_out::left_out_mm;
use super::lengths::Sigma;
use super::linear_system::factor;
use super::priors::{Priors, largest_displacement_mm, largest_plausible};
use super::result::{JointEffect, JointError, MonteCarlo, ParameterResult, Status};
use super::shifted_rows::shifted_rows;
use crate::catalogue::{EstimationFinding, Names};
use crate::math::distributions::ChiSquare;
use crate::measurement::LengthModel;
use crate::robot::{ParamId, Robot, parameter};

/// Above this share of outliers the lengths that are left are doubtful too.
const OUTLIER_SHARE: f64 = 0.1;
/// A robot drawn from its tolerance is off by less than this share of what is expected in no run of a thousand.
const CLOSEST_TO_NOMINAL: f64 = 0.04;

/// Lengths from which an agreement with the nominal robot is no chance.
const LEAST_LENGTHS: usize = 20;

/// The findings of a calibration, the gravest first.
pub(super) fn findings(of: &Calibration<'_>) -> Vec<EstimationFinding> {
    let fit = &of.estimate.fit;
    let mut found = Vec::new();
    if !fit.converged {
        found.push(EstimationFinding::NotConverged { iterations: fit.iterations });
    }
    let (residual_rms_mm, predicted_max_mm) = (of.residual_mm.after.rms, of.prediction.maker.max);
    if residual_rms_mm > predicted_max_mm {
        found.push(EstimationFinding::FitsWorseThanNominal { residual_rms_mm, predicted_max_mm });
    }
    found.extend(beyond_prior(of));
    found.extend(implausible(&of.parameters, &of.setting.priors, &of.setting.options.hold));
    found.extend(displaced(&of.parameters));
    found.extend(contradicted(of));
    found.extend(shifted_rows(&of.estimate, &of.lengths));
    found.extend(kinds_disagree(&of.estimate, &of.lengths));
    found.extend(outliers(fit.out.len(), of.lengths.len()));
    found.extend(consistency(of));
    found.extend(against_repeatability(of));
    found.extend(joints(&of.joint_effects));
    found.extend(position(of));
    found.extend(poorly_observable(&of.parameters));
    let identified = Robot { geometry: fit.model.geometry.clone(), ..of.setting.robot.clone() };
    found.extend(left_out_mm(&identified).map(|left_out_mm| EstimationFinding::BeyondTable { left_out_mm }));
    if let Some(drawn) = &of.monte_carlo {
        found.extend(monte_carlo(drawn));
    }
    found.extend(absolute_accuracy_mode(of));
    found
}

/// Compares the corrections with the prior.
fn beyond_prior(of: &Calibration<'_>) -> Option<EstimationFinding> {
    let scale = of.setting.priors.scale();
    let widened = scale != 1.0;
    let times = if widened { scale } else { of.estimate.beyond_prior()? };
    // A tolerance that nobody named has given way: doubted is what no robot has.
    Some(match times > largest_plausible(!widened) {
        true => EstimationFinding::FarBeyondPrior { times },
        false if widened => EstimationFinding::PriorWidened { times },
        false => EstimationFinding::BeyondPrior { times },
    })
}

/// Corrections that no robot needs. They make up for a part of the set-up that the user fixed, or it is another robot.
fn implausible(
    parameters: &[ParameterResult],
    priors: &Priors,
    fixed: &[ParamId],
) -> Option<EstimationFinding> {
    let fixed: Vec<&ParamId> = fixed.iter().filter(|id| id.is_setup()).collect();
    let times = largest_plausible(!fixed.is_empty());
    let excessive = |found: &&ParameterResult| {
        let excess = priors.excess(found.id, found.correction, found.sd.unwrap_or(0.0));
        excess.is_some_and(|excess| excess > times)
    };
    let parameters = names(parameters.iter().filter(excessive))?;
    Some(if fixed.is_empty() {
        EstimationFinding::Implausible { parameters, times }
    } else {
        EstimationFinding::ImplausibleWithFixed { fixed: Names::of(fixed), parameters, times }
    })
}

/// Balls and bars that came out far from where they were given.
fn displaced(parameters: &[ParameterResult]) -> Option<EstimationFinding> {
    let is_displaced = |found: &&ParameterResult| {
        largest_displacement_mm(found.id).is_some_and(|most| (found.identified - found.start).abs() > most)
    };
    Some(EstimationFinding::Displaced { parameters: names(parameters.iter().filter(is_displaced))? })
}

fn outliers(outliers: usize, lengths: usize) -> Option<EstimationFinding> {
    if outliers as f64 > OUTLIER_SHARE * lengths as f64 {
        Some(EstimationFinding::ManyOutliers { outliers, lengths })
    } else {
        (outliers > 0).then_some(EstimationFinding::Outliers { outliers })
    }
}

/// Compares the residuals with the sigmas that were given.
fn consistency(of: &Calibration<'_>) -> Option<EstimationFinding> {
    let (estimate, lengths) = (&of.estimate, &of.lengths);
    let used = lengths.weighted(Sigma::Given, &estimate.fit.out);
    let parameters = of.uncertainty.effective_parameters;
    let freedom = used.count() as f64 - parameters;
    if freedom < 1.0 {
        return Some(EstimationFinding::NoFreedom { lengths: used.count(), parameters });
    }
    if !lengths.known {
        return None;
    }
    let prepared = estimate.fit.model.prepare();
    let chi = used.sum(|reading, sigma| ((reading.length_mm - prepared.length(reading)) / sigma).powi(2));
    let ratio = chi / freedom;
    let times = ratio.sqrt();
    match ChiSquare::of(ratio, freedom) {
        ChiSquare::Greater if lengths.vouched => Some(EstimationFinding::BeyondSigma { times }),
        ChiSquare::Greater if estimate.noise.sigma == Sigma::Given => {
            Some(EstimationFinding::BeyondSigmaOfFew { times })
        }
        ChiSquare::Greater => Some(EstimationFinding::AboveSigma { times }),
        ChiSquare::Less => Some(EstimationFinding::BelowSigma { times }),
        ChiSquare::AsExpected => None,
    }
}

/// The model lacks most of what residuals beyond so many standard deviations of noise and repeatability show.
const FAR: f64 = 5.0;

/// That residuals are far above what a robot repeats, where the lengths have the standard deviation `sigma_mm` beside.
pub fn beyond_repeatability(residual_rms_mm: f64, sigma_mm: f64, robot: &Robot) -> Option<EstimationFinding> {
    let repeatability_mm = robot.repeatability_sd_mm()?;
    (residual_rms_mm > FAR * repeatability_mm.hypot(sigma_mm))
        .then_some(EstimationFinding::BeyondRepeatability { residual_rms_mm, repeatability_mm })
}

/// Residuals that are far above what the robot repeats, of the lengths used and of those that only check.
fn against_repeatability(of: &Calibration<'_>) -> Option<EstimationFinding> {
    let robot = of.setting.robot;
    let given = of.lengths.weighted(Sigma::Given, &of.estimate.fit.out);
    let given_mm = if of.lengths.known { given.rms_sigma() } else { 0.0 };
    let residual_rms_mm = of.residual_mm.after.rms;
    if let Some(far) = beyond_repeatability(residual_rms_mm, given_mm, robot) {
        return Some(far);
    }
    let least_mm = robot.repeatability_sd_mm()?.hypot(given_mm);
    // What was never used shows the errors of the parameters too.
    let held_out_mm = of.validation.as_ref()?.after.rms;
    (held_out_mm > FAR * least_mm.max(residual_rms_mm))
        .then_some(EstimationFinding::HeldOutDiffers { held_out_mm, residual_rms_mm })
}

/// What the residuals show at the joints, a finding for each kind of error.
fn joints(effects: &[JointEffect]) -> impl Iterator<Item = EstimationFinding> {
    let of_kind = |error: JointError| {
        let effects: Vec<&JointEffect> = effects.iter().filter(|effect| effect.error == error).collect();
        (!effects.is_empty()).then_some(effects)
    };
    let axes = |effects: &[&JointEffect]| Names::of(effects.iter().map(|effect| effect.axis));
    let angle = of_kind(JointError::Angle).map(|effects| EstimationFinding::AngleError {
        axes: axes(&effects),
        rms_um: effects.iter().map(|effect| effect.rms_mm * 1e3).collect(),
    });
    let reversal = of_kind(JointError::Reversal).map(|effects| EstimationFinding::ReversalError {
        axes: axes(&effects),
        mrad: effects.iter().map(|effect| effect.play_rad.unwrap_or(0.0) * 1e3).collect(),
    });
    angle.into_iter().chain(reversal)
}

/// Whether the lengths determine the position and not only themselves.
fn position(of: &Calibration<'_>) -> Option<EstimationFinding> {
    if of.prediction.is_determined() {
        return None;
    }
    let residual_rms_mm = of.residual_mm.after.rms;
    let (identified_mm, nominal_mm) = (of.prediction.pair.identified.mean, of.prediction.maker.mean);
    // Who gives a list of parameters knows that the others are fixed; but no one wants a robot that is worse than before.
    Some(if of.setting.options.follows_list() && identified_mm < nominal_mm {
        EstimationFinding::ListImprovesLittle { residual_rms_mm, identified_mm, nominal_mm }
    } else {
        EstimationFinding::PositionUndetermined { residual_rms_mm, identified_mm, nominal_mm }
    })
}

fn poorly_observable(parameters: &[ParameterResult]) -> Option<EstimationFinding> {
    let poor = parameters.iter().filter(|parameter| parameter.status() == Status::PoorlyObservable);
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

/// `None` of no parameter.
fn names<'a>(parameters: impl Iterator<Item = &'a ParameterResult>) -> Option<Names> {
    let names = Names::of(parameters.map(|parameter| parameter.id));
    (!names.0.is_empty()).then_some(names)
}

/// Whether lengths at commanded axis angles agree with the nominal robot better than its tolerance lets any robot do.
fn absolute_accuracy_mode(of: &Calibration<'_>) -> Option<EstimationFinding> {
    let robot = of.setting.robot;
    // Planned on a robot that was identified before: then they should agree. Few lengths agree by chance.
    let few = of.axes == AngleSource::Given && of.lengths.len() < LEAST_LENGTHS;
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
    let residual_rms_mm = of.residual_mm.before.rms;
    (residual_rms_mm < CLOSEST_TO_NOMINAL * expected_mm)
        .then_some(EstimationFinding::AbsoluteAccuracyMode { residual_rms_mm, expected_mm })
}
