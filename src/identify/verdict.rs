//! What the user must be told about a result.

use std::cmp::Ordering;

use super::covariance::beyond_chance;
use super::estimate::Estimate;
use super::lengths::{Lengths, Sigma};
use super::options::{Options, tolerance};
use super::result::{
    Identification, JointEffect, JointError, ParameterResult, PredictedPair, Status, Warning, WarningKind,
};
use crate::model::Robot;

/// Above this share of lengths set aside, the rest is in doubt too.
const OUTLIER_SHARE: f64 = 0.1;
/// Corrections so many times as large as the prior says throw doubt on the lengths.
const FAR_BEYOND: f64 = 5.0;
/// No robot is so many times as far off as its tolerance allows.
const NO_ROBOTS: f64 = 20.0;
/// No tool ball and no base ball is said to stand so far from where it stands, mm.
const FAR_MM: f64 = 1000.0;
/// No bar is longer or shorter than was said by so much, mm.
const FAR_BAR_MM: f64 = 50.0;
/// The identified robot must be predicted at least this much better than the nominal one.
const PINNED: f64 = 0.5;

/// The warnings of a result; `parameters` is the effective number that the data determine.
pub(super) fn warnings(
    result: &Identification,
    estimate: &Estimate,
    lengths: &Lengths,
    parameters: f64,
    robot: &Robot,
    options: &Options,
) -> Vec<Warning> {
    let mut warnings = Vec::new();
    let mut say = |kind, text: String| warnings.push(Warning { kind, text });
    if !result.converged {
        say(
            WarningKind::Doubt,
            "the solver did not come to rest: check the base balls' places (--centres) and the tool ball (--tool)"
                .into(),
        );
    }
    let (left, promised) = (result.residual_mm.after.rms, result.predicted_position_error_mm.nominal.max);
    if left > promised {
        say(
            WarningKind::Doubt,
            format!(
                "the lengths fit only to {left:.2} mm, while the nominal robot is not expected to be off by more than \
                 {promised:.2} mm anywhere: lengths and poses do not belong together, or a base ball, the tool ball or \
                 the robot is another one"
            ),
        );
    }
    beyond_prior(estimate, &mut say);
    implausible(result, robot, options, &mut say);
    let far: Vec<&str> = result
        .parameters
        .iter()
        .filter(|found| {
            let off = (found.identified - found.start).abs();
            let place = found.name.starts_with("tool") || found.name.starts_with("centre");
            place && off > FAR_MM || found.name.starts_with("bar_offset") && off > FAR_BAR_MM
        })
        .map(|found| found.name.as_str())
        .collect();
    if !far.is_empty() {
        say(
            WarningKind::Doubt,
            format!(
                "{} came out far from what it was said to be: these poses hardly tell it, or the place \
                 given is wrong; turn the tool more, or hold it",
                far.join(", ")
            ),
        );
    }
    let share = result.outliers.len() as f64 / lengths.len() as f64;
    if share > OUTLIER_SHARE {
        say(
            WarningKind::Doubt,
            format!(
                "{} of {} lengths were set aside as outliers: more than one in ten, so the rest is in doubt too; \
                 check the matching of lengths to poses",
                result.outliers.len(),
                lengths.len()
            ),
        );
    } else if !result.outliers.is_empty() {
        say(
            WarningKind::Note,
            format!(
                "{} lengths were set aside as outliers; they are named in `outliers`",
                result.outliers.len()
            ),
        );
    }
    let freedom = result.observations as f64 - parameters;
    if freedom < 1.0 {
        say(
            WarningKind::Doubt,
            format!(
                "{} lengths for {parameters:.0} parameters leave nothing to check the result by: measure more poses",
                result.observations
            ),
        );
    } else {
        consistency(estimate, lengths, freedom, &mut say);
    }
    joints(&result.joints, &mut say);
    let predicted = &result.predicted_position_error_mm;
    if !is_pinned(predicted) {
        // Who gives a list of parameters knows that the others are held; but no one wants a robot that is worse than before.
        let better = predicted.identified.mean < predicted.nominal.mean;
        let kind = if options.follows_list() && better { WarningKind::Note } else { WarningKind::Doubt };
        say(
            kind,
            format!(
                "the lengths fit to {:.3} mm, but they do not pin the position: the 3-D error over the workspace is \
                 predicted at {:.2} mm, the nominal robot's at {:.2} mm; a small residual proves nothing here. {}",
                result.residual_mm.after.rms,
                predicted.identified.mean,
                predicted.nominal.mean,
                next(result)
            ),
        );
    }
    let weak: Vec<&str> = result
        .parameters
        .iter()
        .filter(|parameter| parameter.status == Status::TooWeak)
        .map(|parameter| parameter.name.as_str())
        .collect();
    if !weak.is_empty() {
        say(WarningKind::Note, format!("held because the data are too weak for them: {}", weak.join(", ")));
    }
    warnings
}

/// Whether the identified robot is predicted to be clearly better than the nominal one.
pub(super) fn is_pinned(predicted: &PredictedPair) -> bool {
    predicted.identified.mean <= PINNED * predicted.nominal.mean
}

/// What to measure next.
fn next(result: &Identification) -> String {
    match result.advice.iter().find(|advice| advice.poses > 0 && advice.adds) {
        Some(best) => format!("Best of what was tried on the model: {}", best.text),
        None => "No further circle, ball or bar length within the robot's limits that was tried on the model would lower \
                 it much"
            .into(),
    }
}

/// What the residuals show at the joints, a sentence for each kind of error.
fn joints(effects: &[JointEffect], say: &mut impl FnMut(WarningKind, String)) {
    let named = |error: JointError, figure: fn(&JointEffect) -> String| {
        let of_kind = effects.iter().filter(move |effect| effect.error == error);
        let text = |effect: &JointEffect| format!("axis {} ({})", effect.axis, figure(effect));
        of_kind.map(text).collect::<Vec<_>>().join(", ")
    };
    let um = |effect: &JointEffect| format!("{:.1} um rms", effect.rms_mm * 1e3);
    let angle = named(JointError::Angle, um);
    if !angle.is_empty() {
        say(
            WarningKind::Note,
            format!(
                "the residuals follow the axis angle beyond chance at {angle}: an error of the gear, or sag, which the \
                 model lacks"
            ),
        );
    }
    let mrad = |effect: &JointEffect| format!("{:.2} mrad", effect.play_rad.unwrap_or(0.0) * 1e3);
    let reversal = named(JointError::Reversal, mrad);
    if !reversal.is_empty() {
        say(
            WarningKind::Note,
            format!(
                "the residuals follow the sense of the motion beyond chance at {reversal}: play or lag, if the rows \
                 stand in the order in which they were measured; come to every pose from the same side"
            ),
        );
    }
}

/// Compares the corrections with what the prior says of them.
fn beyond_prior(estimate: &Estimate, say: &mut impl FnMut(WarningKind, String)) {
    let Some(prior) = &estimate.prior else { return };
    let off = |k: usize| prior.weights[k] * (estimate.fit.model.value(estimate.kept[k]) - prior.mean[k]);
    let count = prior.bound().count() as f64;
    let ratio = prior.bound().map(|k| off(k).powi(2)).sum::<f64>() / count;
    if count > 0.0 && beyond_chance(ratio, count) == Some(Ordering::Greater) {
        let factor = ratio.sqrt();
        let kind = if factor > FAR_BEYOND { WarningKind::Doubt } else { WarningKind::Note };
        say(
            kind,
            format!(
                "the corrections are {factor:.1} times as large as the prior allows: the robot is worse than its \
                 file says (`--prior-scale auto` goes by the lengths), or lengths and poses do not belong together"
            ),
        );
    }
}

/// Corrections that no robot needs. They make up for a part of the set-up that the user held, or it is another robot.
fn implausible(
    result: &Identification,
    robot: &Robot,
    options: &Options,
    say: &mut impl FnMut(WarningKind, String),
) {
    let held: Vec<String> = options.hold.iter().filter(|id| id.is_setup()).map(ToString::to_string).collect();
    let most = if held.is_empty() { NO_ROBOTS } else { FAR_BEYOND };
    let absurd = |found: &&ParameterResult| {
        let allowed = found.name.parse().ok().and_then(|id| tolerance(robot, id));
        let sd = found.sd.unwrap_or(0.0);
        allowed.is_some_and(|allowed| found.correction.abs() > most * allowed.hypot(sd))
    };
    let names: Vec<&str> = result.parameters.iter().filter(absurd).map(|found| found.name.as_str()).collect();
    if names.is_empty() {
        return;
    }
    let names = names.join(", ");
    let which = if held.is_empty() { names } else { format!("with {} held, {names}", held.join(", ")) };
    let why = if held.is_empty() {
        "no robot is so far off: lengths and poses do not belong together, or it is another robot (--robot)"
    } else {
        "most likely what is held stands elsewhere (let it be estimated, or measure it again), or the robot is worse \
         than its file says"
    };
    say(
        WarningKind::Doubt,
        format!(
            "{which} came out more than {most:.0} times as far from nominal as the robot's tolerance allows: {why}"
        ),
    );
}

/// Compares the residuals with the sigmas that were given.
fn consistency(
    estimate: &Estimate,
    lengths: &Lengths,
    freedom: f64,
    say: &mut impl FnMut(WarningKind, String),
) {
    if !lengths.known {
        return;
    }
    let prepared = estimate.fit.model.prepare();
    let used = lengths.weighted(Sigma::Given, &estimate.fit.out);
    let chi = used.sum(|reading, sigma| ((reading.length - prepared.length(reading)) / sigma).powi(2));
    let ratio = chi / freedom;
    let factor = ratio.sqrt();
    let beyond = beyond_chance(ratio, freedom);
    if beyond == Some(Ordering::Greater) {
        let (kind, then) = if lengths.vouched {
            (
                WarningKind::Doubt,
                "the model lacks something, or sigma is too small; the standard deviations rest on the sigma given",
            )
        } else if estimate.sigma == Sigma::Given {
            (
                WarningKind::Doubt,
                "the standard deviations rest on the sigma given all the same, because so few lengths cannot tell \
                 another; give --sigma with the robot's repeatability in it, or measure more poses",
            )
        } else {
            (
                WarningKind::Note,
                "repeatability or what the model lacks; the standard deviations rest on the residuals",
            )
        };
        say(kind, format!("the residuals are {factor:.1} times as large as the given sigma: {then}"));
    } else if beyond == Some(Ordering::Less) {
        say(
            WarningKind::Note,
            format!(
                "the residuals are only {factor:.2} times the given sigma: sigma is too large, or lengths repeat"
            ),
        );
    }
}
