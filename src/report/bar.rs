//! `bar.html`: how well a bar at rest reads.

use serde::Serialize;

use super::page::{findings, render};
use super::plot::{Series, TrendPlot, histogram};
use super::scale::Unit;
use crate::diagnostic::Diagnostic;
use crate::provenance::Provenance;
use crate::recording::bar_check::BarCheck;

/// Most values of the histogram; more change no bar of it.
const MOST_VALUES: usize = 20_000;

#[derive(Serialize)]
struct Page<'a> {
    check: &'a BarCheck,
    figures: [String; 2],
    findings: Vec<Diagnostic>,
    provenance: &'a Provenance,
}

/// The page `bar.html`.
///
/// # Errors
/// Only a fault of the template itself.
pub fn html(check: &BarCheck, provenance: &Provenance) -> Result<String, Diagnostic> {
    let trend = TrendPlot {
        title: "Means of one second",
        unit: Unit::length(check.means.iter().fold(0.0, |most, mean| f64::max(most, mean[1].abs()))),
        time_name: "time (s)",
        values: check.means.clone(),
        line: Some(check.line),
        limit: None,
    };
    let every = check.residual_mm.len().div_ceil(MOST_VALUES).max(1);
    let residual_mm: Vec<f64> = check.residual_mm.iter().step_by(every).copied().collect();
    let page = Page {
        check,
        figures: [trend.to_svg(), histogram("Readings about the line", &residual_mm, Series::Second)],
        findings: findings(&check.findings),
        provenance,
    };
    render("bar.html", include_str!("bar.html"), &page)
}
