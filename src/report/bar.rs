//! `bar.html`: how well a bar at rest reads.

use serde::Serialize;

use super::page::{findings, render};
use super::plot::{Series, TrendPlot, histogram};
use super::scale::{Unit, magnitude};
use crate::diagnostic::Diagnostic;
use crate::math::straight_line::StraightLine;
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
    // About their mean: a scale of micrometres has no room for the length.
    let off = |&[t_s, mm, sd]: &[f64; 3]| [t_s, mm - check.mean_mm, sd];
    let values: Vec<[f64; 3]> = check.means.iter().map(off).collect();
    let trend = TrendPlot {
        title: "Means of one second about their mean",
        unit: Unit::length(magnitude(values.iter().map(|value| value[1]))),
        time_name: "time (s)",
        values,
        line: Some(StraightLine { level: 0.0, ..check.line }),
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
