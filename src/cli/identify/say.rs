//! Prints a result on the terminal.

use std::path::Path;

use crate::cli::{CommandOutput, output};
use dbbd_job::report::Verdict;
use dbbd_job::report::export::mastering::offsets;
use dbbd_job::request::identify::IdentifyDocument;
use dbbd_model::base::number::significant;
use dbbd_model::conformity::standing;
use dbbd_model::estimation::result::{MaxUncertainty, SigmaSource, Status};
use dbbd_model::estimation::{CalibrationResult, Combination, is_place, wording};

/// The result on stdout; with `--verbose` what else it states on stderr.
pub(in crate::cli) fn show(out: &CommandOutput, document: &IdentifyDocument, dir: &Path) {
    let IdentifyDocument { calibration, budget, .. } = document;
    let result = &calibration.result;
    let verdict = Verdict::of_calibration(result, budget, &standing(&result.into(), None, None));
    out.result(verdict.sentence());
    verdict.next().iter().for_each(|next| out.result(format!("next: {next}")));
    out.result(fit(result));
    out.result(counts(result));
    monte_carlo(result).into_iter().for_each(|line| out.result(line));
    answers(document, dir).into_iter().for_each(|line| out.detail(line));
    for lines in [search(result), groups(result), position(result), parameters(result), further(result)] {
        lines.into_iter().for_each(|line| out.detail(line));
    }
    out.findings(calibration.diagnostics());
    out.result(format!("results in {}", dir.display()));
}

fn fit(result: &CalibrationResult) -> String {
    let residual = &result.residual_mm;
    format!(
        "{}: {}, residual rms {} -> {}",
        result.robot,
        result.made_from,
        mm(residual.before.rms),
        mm(residual.after.rms)
    )
}

fn search(result: &CalibrationResult) -> Vec<String> {
    let residual = &result.residual_mm;
    let mut lines = vec![
        format!(
            "rank {} of the parameters asked for, condition {:.0}, {} steps; before is {}",
            result.rank, result.condition, result.iterations, result.start
        ),
        format!(
            "residual largest {} -> {}, sigma {} ({})",
            mm(residual.before.max),
            mm(residual.after.max),
            mm(result.noise_mm.length),
            source(result.sigma_source)
        ),
    ];
    if let Some(folds) = &result.folds {
        lines.push(format!("held out in {} folds: rms {}", folds.folds, mm(folds.rms)));
    }
    if let Some(validation) = &result.validation {
        let [before, after] = [validation.before.rms, validation.after.rms].map(mm);
        lines.push(format!("validation: rms {before} -> {after}"));
    }
    lines
}

/// Errors of the joints and of a pose.
fn groups(result: &CalibrationResult) -> Vec<String> {
    let Some(pose_mm) = result.noise_mm.pose else { return Vec::new() };
    let first = format!("a pose repeats to {} in each direction; by the evidence:", mm(pose_mm));
    std::iter::once(first).chain(result.groups.iter().map(|group| format!("  {group}"))).collect()
}

/// What the user asked to be drawn.
fn monte_carlo(result: &CalibrationResult) -> Option<String> {
    let drawn = result.monte_carlo.as_ref()?;
    let names: Vec<String> = drawn.disagree.iter().map(ToString::to_string).collect();
    Some(match names.as_slice() {
        [] => format!("Monte Carlo, {} trials: the linear 95 % intervals hold", drawn.used),
        names => format!(
            "Monte Carlo, {} trials: the linear 95 % intervals do not hold for {}",
            drawn.used,
            names.join(", ")
        ),
    })
}

fn position(result: &CalibrationResult) -> Vec<String> {
    let mut lines: Vec<String> = result.observability.iter().map(output::observability).collect();
    let predicted = &result.predicted_position_uncertainty_mm;
    lines.push(format!(
        "predicted position uncertainty over the workspace: 95 % {} -> {}",
        mm(predicted.nominal.p95),
        mm(predicted.identified.p95)
    ));
    if result.count(Status::Fixed) > 0 {
        lines.push("  fixed parameters count as exact in this prediction".into());
    }
    lines.extend(result.predicted_orientation_uncertainty_mrad.iter().map(|turned| {
        let [before, after] = [turned.nominal.mean, turned.identified.mean];
        format!("predicted orientation error of the flange: mean {before:.2} -> {after:.2} mrad")
    }));
    lines
}

fn counts(result: &CalibrationResult) -> String {
    format!(
        "{} identified, {} with the prior's help, {} dependent, {} poorly observable, {} fixed",
        result.count(Status::Identified),
        result.count(Status::SupportedByPrior),
        result.count(Status::Dependent),
        result.count(Status::PoorlyObservable),
        result.count(Status::Fixed)
    )
}

fn parameters(result: &CalibrationResult) -> Vec<String> {
    let mut lines = Vec::new();
    let (places, own): (Vec<&Combination>, Vec<&Combination>) =
        result.combinations.iter().partition(|combination| is_place(&combination.kept));
    lines.extend(wording::in_short(own).into_iter().map(|line| format!("  {line}")));
    let members = places.iter().flat_map(|combination| combination.members.iter().map(|(id, _)| *id));
    let mut absorbed: Vec<String> = members.filter(|id| !is_place(id)).map(|id| id.to_string()).collect();
    absorbed.sort_unstable();
    absorbed.dedup();
    if !absorbed.is_empty() {
        lines.push(format!("  linearly dependent on the places of the balls: {}", absorbed.join(", ")));
    }
    if let Some((worst, others)) = result.correlated.split_first() {
        let [one, other] = worst.pair;
        let more = if others.is_empty() { "" } else { ", and others in result.json" };
        lines.push(format!("  nearly collinear: {one} and {other}, correlation {:.3}{more}", worst.r));
    }
    lines
}

/// What a customer asks about the result: its cost, what limits it and where, an hour more, another payload, and what the
/// controller gets.
fn answers(document: &IdentifyDocument, dir: &Path) -> Vec<String> {
    let IdentifyDocument { calibration, budget, .. } = document;
    let result = &calibration.result;
    let mm = |value: f64| format!("{} mm", significant(value, 2));
    let mut lines = Vec::new();
    if let Some(effort) = &result.effort {
        let minutes = effort.minutes.map(|minutes| format!(" in {minutes:.1} minutes"));
        let minutes = minutes.unwrap_or_default();
        lines.push(format!("measured: {} at {} poses{minutes}", result.made_from, effort.poses));
    }
    lines.extend(budget.largest().map(|line| {
        format!(
            "limited by {}, {} of {}; by the bar {}, by the robot and its model {}",
            line.source.words(),
            mm(line.position_mm.unwrap_or(0.0)),
            mm(budget.combined_mm),
            mm(budget.by_bar_mm()),
            mm(budget.by_robot_mm())
        )
    }));
    lines.extend(result.max_uncertainty.map(
        |MaxUncertainty { position_mm: [x, y, z], expanded_uncertainty_mm }| {
            format!(
                "largest uncertainty at ({x:.0}, {y:.0}, {z:.0}) mm: U = {} (k = 2)",
                mm(expanded_uncertainty_mm)
            )
        },
    ));
    lines.extend(result.effort.and_then(|effort| effort.hour_more).map(|more| {
        format!(
            "an hour more of the same poses, {} measurements, leaves at most U = {} (k = 2)",
            more.measurements,
            mm(more.expanded_uncertainty_mm)
        )
    }));
    lines.extend(result.validity.as_ref().and_then(|validity| validity.rated_payload).map(|rated| {
        format!(
            "with the usual payload of such an arm, {:.0} kg, which was not measured: U = {} (k = 2); `dbbd predict --payload` \
             states it of others",
            rated.kg,
            mm(rated.expanded_uncertainty_mm)
        )
    }));
    let zeros = offsets(result, &calibration.robot);
    let known = zeros.iter().filter(|zero| zero.sd_deg.is_some());
    // A zero has no minus sign.
    let digits = |deg: f64| (1e4 * deg).round() / 1e4 + 0.0;
    let zeros: Vec<String> =
        known.map(|zero| format!("A{} {:+.4}", zero.axis, digits(zero.offset_deg))).collect();
    if !zeros.is_empty() {
        lines.push(format!(
            "zero errors for the controller: {} deg, valid only with all parameters; `dbbd export {} --for ..` writes its files",
            zeros.join(", "),
            dir.display()
        ));
    }
    lines
}

/// Validity with its assumptions, and every further measurement with its predicted effect.
fn further(result: &CalibrationResult) -> Vec<String> {
    let validity = result.validity.iter().map(|validity| format!("identified {validity}"));
    validity.chain(result.recommendations.iter().map(|one| format!("could be measured: {one}"))).collect()
}

fn source(source: SigmaSource) -> &'static str {
    match source {
        SigmaSource::Given => "given",
        SigmaSource::Estimated => "estimated",
        SigmaSource::Assumed => "assumed",
    }
}

/// A length to print.
fn mm(value: f64) -> String {
    if value.abs() < 5e-4 && value != 0.0 { format!("{value:.1e} mm") } else { format!("{value:.4} mm") }
}
