//! What is said of a result on the terminal.

use std::path::Path;

use super::choices;
use crate::cli::Output;
use crate::identifiability::Observability;
use crate::identify::result::{Identification, Status, WarningKind};

/// Further measurements that are named here; all stand in the report.
const ADVICE: usize = 2;

/// The result in lines, warnings to stderr.
pub(super) fn say(out: &Output, result: &Identification, dir: &Path) {
    let residual = &result.residual_mm;
    let count = |status: Status| result.parameters.iter().filter(|p| p.status == status).count();
    out.result(format!(
        "{}: {} lengths, rank {} of the parameters asked for, condition {:.0}, {} steps",
        result.robot, result.observations, result.rank, result.condition, result.iterations
    ));
    out.result(format!(
        "residual rms {} -> {}, largest {} -> {}, sigma {} ({})",
        mm(residual.before.rms),
        mm(residual.after.rms),
        mm(residual.before.max),
        mm(residual.after.max),
        mm(result.sigma_mm),
        choices::source(result.sigma_source)
    ));
    if let Some(folds) = &result.folds {
        out.result(format!("held out in {} folds: rms {}", folds.folds, mm(folds.rms)));
    }
    if let Some(validation) = &result.validation {
        let [before, after] = [validation.before.rms, validation.after.rms].map(mm);
        out.result(format!("validation: rms {before} -> {after}"));
    }
    for line in choices::lines(result) {
        out.result(line);
    }
    if let Some(Observability { o1, o2, o3, o4, o5 }) = result.observability {
        out.result(format!("observability O1 {o1:.3e}, O2 {o2:.3e}, O3 {o3:.3e}, O4 {o4:.3e}, O5 {o5:.3e}"));
    }
    let predicted = &result.predicted_position_error_mm;
    let exact = if count(Status::Held) > 0 { " (what is held taken as exact)" } else { "" };
    out.result(format!(
        "predicted 3-D error over the workspace: mean {} -> {}, 95 % {} -> {}{exact}",
        mm(predicted.nominal.mean),
        mm(predicted.identified.mean),
        mm(predicted.nominal.p95),
        mm(predicted.identified.p95)
    ));
    out.result(format!(
        "{} identified, {} with the prior's help, {} dependent, {} too weak, {} held",
        count(Status::Identified),
        count(Status::Prior),
        count(Status::Dependent),
        count(Status::TooWeak),
        count(Status::Held)
    ));
    let (set_up, own): (Vec<_>, Vec<_>) = result
        .dependent
        .iter()
        .partition(|group| group.kept.starts_with("centre") || group.kept.starts_with("tool"));
    for group in own {
        out.result(format!("  {}", group.text));
    }
    let mut carried: Vec<&str> =
        set_up.iter().flat_map(|group| group.combination.keys().map(String::as_str)).collect();
    carried.retain(|name| !name.starts_with("centre") && !name.starts_with("tool"));
    carried.sort_unstable();
    carried.dedup();
    if !carried.is_empty() {
        out.result(format!("  carried by the places of the balls: {}", carried.join(", ")));
    }
    if let Some((worst, others)) = result.correlated.split_first() {
        let [one, other] = &worst.pair;
        let more = if others.is_empty() { "" } else { ", and others in result.json" };
        out.result(format!("  hardly told apart: {one} and {other}, correlation {:.3}{more}", worst.r));
    }
    for advice in result.advice.iter().filter(|advice| advice.adds).take(ADVICE) {
        out.result(format!("next: {}", advice.text));
    }
    for warning in &result.warnings {
        match warning.kind {
            WarningKind::Doubt => out.warning(&warning.text),
            WarningKind::Note => out.progress(format!("note: {}", warning.text)),
        }
    }
    out.result(format!("results in {}", dir.display()));
}

/// A length for people.
fn mm(value: f64) -> String {
    if value.abs() < 5e-4 && value != 0.0 { format!("{value:.1e} mm") } else { format!("{value:.4} mm") }
}
