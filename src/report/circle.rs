//! `circle.html`: circular tests by the quantities of ISO 230-4.

use serde::Serialize;

use super::page::{Fact, Provenance, ReportError, render};
use super::plot::{PolarPlot, PolarTrace, Series};
use super::scale::{plain, signed, significant};
use crate::circular::{Evaluation, Mover, NAMES, Quantity, Sense, Step, TERM_NAMES, TRACE_NAMES};

/// A circle that was evaluated.
#[derive(Clone, Debug, PartialEq)]
pub struct CircleTest {
    /// Where its lengths come from.
    pub source: String,
    /// Number of the circle in its plan, where there is one.
    pub circle: Option<u32>,
    /// What was found.
    pub evaluation: Evaluation,
}

/// What the page shows.
#[derive(Clone, Debug, PartialEq)]
pub struct CircleView<'a> {
    /// The circles, in the order given.
    pub tests: &'a [CircleTest],
    /// Where they come from.
    pub provenance: Provenance,
}

#[derive(Serialize)]
struct Page<'a> {
    title: &'static str,
    tests: Vec<Panel<'a>>,
    trend: Vec<TrendLine<'a>>,
    provenance: &'a Provenance,
}

#[derive(Serialize)]
struct Panel<'a> {
    source: &'a str,
    summary: String,
    plot: String,
    facts: Vec<Fact>,
    quantities: Vec<[String; 4]>,
    traces: Vec<[String; 8]>,
    harmonics: Vec<[String; 6]>,
    meanings: Vec<Fact>,
    reversals: usize,
    steps: Vec<[String; 3]>,
    notes: &'a [String],
}

#[derive(Serialize)]
struct TrendLine<'a> {
    source: &'a str,
    values: Vec<String>,
}

/// Of the quantities in a trend: places in [`NAMES`].
const TREND: [usize; 6] = [0, 1, 2, 3, 4, 5];

impl CircleTest {
    /// The polar plot, with the joints' reversals on the outermost ring.
    pub fn svg(&self) -> String {
        let found = &self.evaluation;
        let passes = |sense: Sense| found.traces.iter().filter(move |trace| trace.sense == sense).count();
        let traces = found
            .traces
            .iter()
            .map(|trace| {
                let (word, series) = match trace.sense {
                    Sense::CounterClockwise => ("counter-clockwise", Series::Second),
                    Sense::Clockwise => ("clockwise", Series::First),
                };
                let name =
                    if passes(trace.sense) > 1 { format!("{word}, run {}", trace.run) } else { word.into() };
                PolarTrace { name, series, points: trace.deviations.clone() }
            })
            .collect();
        let marks: Vec<(f64, String)> =
            found.reversals.iter().map(|at| (at.angle_deg, at.joint.to_string())).collect();
        let title =
            self.circle.map_or("Deviation from the circle".into(), |number| format!("Circle {number}"));
        let plot = PolarPlot { title, radius_mm: Some(found.radius_mm), axis_names: None, traces };
        plot.to_svg_with(&marks)
    }
}

/// The page `circle.html`.
///
/// # Errors
/// Only a fault of the template itself.
pub fn html(view: &CircleView<'_>) -> Result<String, ReportError> {
    let trend = trend(view.tests);
    let page = Page {
        title: if view.tests.len() == 1 { "Circular test" } else { "Circular tests" },
        tests: view.tests.iter().map(panel).collect(),
        trend,
        provenance: &view.provenance,
    };
    render("circle.html", include_str!("circle.html"), &page)
}

/// Micrometres of millimetres, as many decimals as the uncertainty needs.
fn um(value: Option<f64>, u95: Option<f64>) -> String {
    value.map_or("–".into(), |value| {
        let decimals = match u95.map(|u| 1e3 * u) {
            Some(u) if u >= 10.0 => 0,
            Some(u) if u >= 1.0 => 1,
            Some(u) if u >= 0.1 => 2,
            _ => 3,
        };
        super::scale::fixed(1e3 * value, decimals)
    })
}

fn half_width(quantity: &Quantity) -> String {
    quantity.u95.filter(|_| quantity.value.is_some()).map_or("–".into(), |u| significant(1e3 * u, 2))
}

fn panel(test: &CircleTest) -> Panel<'_> {
    let found = &test.evaluation;
    let words = |name: &str| match name {
        "G_lsc" => (
            "G, least-squares centre",
            "circular deviation: the greater of the traces, each about its own centre",
        ),
        "G_mzc" => ("G, minimum zone", "the same between the two nearest concentric circles"),
        "Gb" => ("G(b)", "bi-directional circular deviation: both senses about one centre"),
        "D" => ("D", "mean radial deviation from the nominal radius"),
        "F_max" if found.free_centre => {
            ("F max", "greatest radial deviation, about the least-squares centre (b)")
        }
        "F_min" if found.free_centre => {
            ("F min", "least radial deviation, about the least-squares centre (b)")
        }
        "F_max" => ("F max", "greatest radial deviation, about the instrument's centre (a)"),
        "F_min" => ("F min", "least radial deviation, about the instrument's centre (a)"),
        "H" => ("H", "hysteresis: greatest difference of the senses (1996 edition, legacy)"),
        "x" => ("centre x", "base ball, seen from the programmed centre"),
        _ => ("centre y", "base ball, seen from the programmed centre"),
    };
    let quantities = NAMES
        .iter()
        .zip(&found.quantities)
        .map(|(name, quantity)| {
            let (short, long) = words(name);
            [short.into(), um(quantity.value, quantity.u95), half_width(quantity), long.into()]
        })
        .collect();
    let traces = found
        .traces
        .iter()
        .map(|trace| {
            let value = |name: &str| {
                let at = TRACE_NAMES.iter().position(|known| *known == name);
                let quantity = at.and_then(|at| trace.quantities.get(at)).copied().unwrap_or_default();
                um(quantity.value, quantity.u95)
            };
            [
                trace.run.clone(),
                trace.sense.word().into(),
                trace.points.to_string(),
                value("G_lsc"),
                value("G_mzc"),
                value("D"),
                value("F_max"),
                value("F_min"),
            ]
        })
        .collect();
    let meaning = &found.diagnosis;
    let harmonics = meaning
        .harmonics
        .iter()
        .map(|harmonic| {
            let mut line: [String; 6] = Default::default();
            line[0] = harmonic.sense.word().into();
            for at in 0..TERM_NAMES.len() {
                line[at + 1] = um(Some(harmonic.values_mm[at]), Some(harmonic.u95_mm[at]));
            }
            line
        })
        .collect();
    let mut meanings = Vec::new();
    if let Some(pair) = meaning.scale_mismatch {
        meanings.push(Fact::new("Scale mismatch, first less second axis", small(pair, 1e6, "ppm")));
    }
    if let Some(pair) = meaning.squareness_rad {
        let with = if meaning.both_senses { "" } else { " (one sense: a servo mismatch is in it)" };
        meanings.push(Fact::new("Squareness", format!("{}{with}", small(pair, 1e6, "µrad"))));
    }
    if let Some(pair) = meaning.servo_mismatch_s {
        meanings.push(Fact::new("Servo mismatch, second axis lags", small(pair, 1e3, "ms")));
    }
    let steps = found.steps.iter().map(play).collect();
    let arc = &found.arc;
    let extent = if arc.full {
        "full circle".into()
    } else {
        format!("{} degrees from {}°", plain(arc.span_deg, 1), plain(arc.from_deg, 1))
    };
    let facts = vec![
        Fact::new("Nominal radius", format!("{} mm", plain(found.radius_mm, 4))),
        Fact::new("Arc", extent),
        Fact::new("Condition number of centre and radius", significant(arc.condition, 2)),
        Fact::new("Smoothing", "none"),
        Fact::new(
            "Standard uncertainty of a length",
            format!("{} µm ({})", significant(1e3 * found.sigma_mm, 2), found.sigma_source),
        ),
        Fact::new("Intervals", format!("95 %, by {} draws", found.draws)),
        Fact::new(
            "Temperature",
            if found.as_measured.is_some() { "corrected to 20 °C" } else { "as measured" },
        ),
    ];
    let get = |name: &str| {
        let quantity = found.get(name);
        quantity
            .value
            .map(|value| format!("{} ± {} µm", um(Some(value), quantity.u95), half_width(&quantity)))
    };
    let summary = match (get("Gb"), get("G_lsc"), get("D")) {
        (Some(gb), _, Some(d)) => {
            format!("Bi-directional circular deviation G(b) {gb}; mean radial deviation D {d}.")
        }
        (None, Some(g), Some(d)) => {
            format!("Circular deviation G {g}; mean radial deviation D {d}. One sense only: no G(b).")
        }
        _ => "The arc is too short to tell its centre: only F about the instrument's centre is given.".into(),
    };
    Panel {
        source: &test.source,
        summary,
        plot: test.svg(),
        facts,
        quantities,
        traces,
        harmonics,
        meanings,
        reversals: found.reversals.len(),
        steps,
        notes: &found.notes,
    }
}

/// A value and the half width of its interval, in a unit of which there are `factor` in its own.
fn small([value, u95]: [f64; 2], factor: f64, unit: &str) -> String {
    let decimals = if factor * u95 >= 10.0 { 0 } else { 2 };
    format!("{} ± {} {unit}", signed(factor * value, decimals), significant(factor * u95, 2))
}

/// A drive, its play, and the most that it does to the length.
fn play(step: &Step) -> [String; 3] {
    let (drive, factor, unit) = match step.mover {
        Mover::Axis(axis) => (format!("axis {axis}"), 1e3, "µm"),
        Mover::Joint(joint) => (format!("joint {joint}"), 1e6, "µrad"),
    };
    // No gear has a play of a degree: it is the joint that hardly moves the length.
    let (bound, degree) = (step.play.abs() + step.u95, 1f64.to_radians());
    let told = match step.mover {
        _ if step.play.abs() > step.u95 => small([step.play, step.u95], factor, unit),
        Mover::Joint(_) if bound > degree => "cannot be told: it hardly moves the length".into(),
        _ => format!("none seen; up to {} {unit} would not show", significant(factor * bound, 2)),
    };
    let most =
        if step.play.abs() > step.u95 { significant(1e3 * step.most_mm, 2) + " µm" } else { "–".into() };
    [drive, told, most]
}

/// The tests in the order of their circles, where a circle was tested more than once: the circles of one
/// run are no trend.
fn trend(tests: &[CircleTest]) -> Vec<TrendLine<'_>> {
    let times = |circle: Option<u32>| tests.iter().filter(|test| test.circle == circle).count();
    let mut again: Vec<&CircleTest> = tests.iter().filter(|test| times(test.circle) > 1).collect();
    again.sort_by_key(|test| test.circle);
    again.into_iter().map(trend_line).collect()
}

fn trend_line(test: &CircleTest) -> TrendLine<'_> {
    let values = TREND.iter().map(|&at| {
        let quantity = test.evaluation.quantities.get(at).copied().unwrap_or_default();
        match quantity.u95 {
            Some(_) if quantity.value.is_some() => {
                format!("{} ± {}", um(quantity.value, quantity.u95), half_width(&quantity))
            }
            _ => um(quantity.value, None),
        }
    });
    TrendLine { source: &test.source, values: values.collect() }
}
