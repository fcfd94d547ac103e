//! `circle.html`: circular tests by the quantities of ISO 230-4.

use serde::Serialize;

use super::page::render;
use super::plot::{PolarPlot, PolarTrace, Series};
use super::scale::{signed, significant};
use dbbd_model::circular::{
    CircleSense, CircularEvaluation, DriveBacklash, DriveId, QUANTITY_NAMES, TRACE_NAMES,
};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::math::distributions::{COVERAGE_95, normal_deviate};
use dbbd_model::provenance::Provenance;
use dbbd_model::robot::AXES;

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CircleTest {
    pub source: String,
    /// Number of the circle in its plan.
    pub circle: Option<u32>,
    pub evaluation: CircularEvaluation,
}

#[derive(Serialize)]
struct Page<'a> {
    tests: Vec<Panel<'a>>,
    trend: Vec<&'a CircleTest>,
    names: [&'static str; QUANTITY_NAMES.len()],
    trace_names: [&'static str; TRACE_NAMES.len()],
    provenance: &'a Provenance,
}

#[derive(Serialize)]
struct Panel<'a> {
    source: &'a str,
    found: &'a CircularEvaluation,
    notes: Vec<Diagnostic>,
    sigma_source: &'static str,
    plot: String,
    /// The quantities of the first line: G(b) or G, and D.
    deviation: [dbbd_model::circular::CircularQuantity; 3],
    reversal_errors: Vec<ReversalError>,
}

#[derive(Serialize)]
struct ReversalError {
    drive: String,
    error: String,
    /// Largest step in the length, um: an upper bound if the error is not significant.
    largest_step: String,
}

impl CircleTest {
    /// The polar plot, with ticks where joints reverse.
    pub fn svg(&self) -> String {
        let found = &self.evaluation;
        let passes =
            |sense: CircleSense| found.traces.iter().filter(move |trace| trace.sense == sense).count();
        let traces = found
            .traces
            .iter()
            .map(|trace| {
                let (word, series) = match trace.sense {
                    CircleSense::CounterClockwise => ("counter-clockwise", Series::Second),
                    CircleSense::Clockwise => ("clockwise", Series::First),
                };
                let name =
                    if passes(trace.sense) > 1 { format!("{word}, run {}", trace.run) } else { word.into() };
                PolarTrace { name, series, points: trace.deviations.clone() }
            })
            .collect();
        let marks = found.reversals.iter().map(|at| (at.angle_deg, at.joint.to_string())).collect();
        let title =
            self.circle.map_or("Deviation from the circle".into(), |number| format!("Circle {number}"));
        PolarPlot { title, radius_mm: Some(found.radius_mm), traces, marks }.to_svg()
    }
}

pub fn html(tests: &[CircleTest], provenance: &Provenance) -> Result<String, Diagnostic> {
    let page = Page {
        tests: tests.iter().map(panel).collect(),
        trend: trend(tests),
        names: QUANTITY_NAMES,
        trace_names: TRACE_NAMES,
        provenance,
    };
    render("circle.html", include_str!("circle.html"), &page)
}

fn panel(test: &CircleTest) -> Panel<'_> {
    let found = &test.evaluation;
    Panel {
        source: &test.source,
        found,
        notes: found.notes.clone(),
        sigma_source: found.sigma_source.word(),
        plot: test.svg(),
        deviation: ["Gb", "G_lsc", "D"].map(|name| found.get(name)),
        reversal_errors: found.steps.iter().map(reversal_error).collect(),
    }
}

/// The number of expanded uncertainties by which an error must differ from zero to be significant. In 95 of 100 tests
/// without any backlash, none of six joints exceeds it.
fn significant_for_all() -> f64 {
    normal_deviate((0.05 / AXES as f64).ln()) / COVERAGE_95
}

fn reversal_error(step: &DriveBacklash) -> ReversalError {
    let (drive, factor, unit) = match step.mover {
        DriveId::Axis(axis) => (format!("axis {axis}"), 1e3, "µm"),
        DriveId::Joint(joint) => (format!("joint {joint}"), 1e6, "µrad"),
    };
    let significant_error = step.play.abs() > significant_for_all() * step.u95;
    // A bound of more than a degree means that the joint hardly affects the length.
    let (bound, degree) = (step.play.abs() + step.u95, 1f64.to_radians());
    // The step is proportional to the error.
    let bound_um = if step.play == 0.0 { f64::NAN } else { 1e3 * step.most_mm * bound / step.play.abs() };
    let largest_step = match step.mover {
        _ if significant_error => significant(1e3 * step.most_mm, 2),
        _ if bound_um.is_finite() => format!("< {}", significant(bound_um, 2)),
        DriveId::Axis(_) | DriveId::Joint(_) => "–".into(),
    };
    let error = match step.mover {
        _ if significant_error => {
            let decimals = if factor * step.u95 >= 10.0 { 0 } else { 2 };
            let value = signed(factor * step.play, decimals);
            format!("{value} ± {} {unit}", significant(factor * step.u95, 2))
        }
        DriveId::Joint(_) if bound > degree => "not identifiable: the joint hardly changes the length".into(),
        DriveId::Axis(_) | DriveId::Joint(_) => {
            format!("not significant, below {} {unit}", significant(factor * bound, 2))
        }
    };
    ReversalError { drive, error, largest_step }
}

/// The tests of circles that were tested more than once, in the order of the circles.
fn trend(tests: &[CircleTest]) -> Vec<&CircleTest> {
    let times = |circle: Option<u32>| tests.iter().filter(|test| test.circle == circle).count();
    let mut again: Vec<&CircleTest> = tests.iter().filter(|test| times(test.circle) > 1).collect();
    again.sort_by_key(|test| test.circle);
    again
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A normal variable is beyond 2.638 standard deviations with a probability of 0.05 / 6.
    #[test]
    fn six_joints_together_show_a_backlash_in_one_test_of_twenty() {
        assert!((significant_for_all() * 1.96 - 2.638).abs() < 1e-3, "{}", significant_for_all());
    }
}
