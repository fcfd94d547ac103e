//! `bar.html`: the check of a bar at rest.

use serde::Serialize;

use super::page::{findings, render};
use super::plot::{PANEL, Series, Time, TrendLine, TrendPlot, TrendPoint, histogram};
use super::scale::{Unit, magnitude};
use crate::recording::bar_check::BarCheck;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::math::distributions::COVERAGE_95;
use dbbd_model::math::straight_line::StraightLine;
use dbbd_model::provenance::Provenance;

/// Most values of the histogram; more are sampled evenly.
const MOST_VALUES: usize = 20_000;

#[derive(Serialize)]
struct Page<'a> {
    check: &'a BarCheck,
    figures: [String; 2],
    findings: Vec<Diagnostic>,
    provenance: &'a Provenance,
}

pub fn html(check: &BarCheck, provenance: &Provenance) -> Result<String, Diagnostic> {
    // The means are drawn about their mean, on a scale of micrometres.
    let point = |&[time, mm, sd]: &[f64; 3]| TrendPoint {
        time,
        value: mm - check.mean_mm,
        u95: COVERAGE_95 * sd,
        has_warnings: false,
    };
    let points: Vec<TrendPoint> = check.means.iter().map(point).collect();
    let line = StraightLine { level: 0.0, ..check.line };
    let trend = TrendPlot {
        title: "Means of one second about their mean",
        size: PANEL,
        unit: Unit::length(magnitude(points.iter().map(|point| point.value))),
        time: Time::Numbers("time (s)"),
        points: &points,
        line: points.last().map(|last| TrendLine { line, coverage: None, until: last.time }),
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
