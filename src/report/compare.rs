//! `compare.html`: results or circular tests side by side in time.

use std::fmt::Display;

use serde::Serialize;

use super::page::render;
use super::plot::{HeatMap, Interval, Intervals, PolarPlot, PolarTrace, Series, TrendPlot};
use super::scale::{Unit, decimals};
use crate::circular::Sense;
use crate::conformity::{CircleCompared, Comparison, ResultsCompared, Subject, TimeUnit, Timeline, Tracked};
use crate::diagnostic::Diagnostic;
use crate::math::straight_line::StraightLine;
use crate::provenance::Provenance;
use crate::robot::{ParamId, parameter};

/// Half width of a 95 % interval in standard deviations.
const COVERAGE: f64 = 1.96;

#[derive(Serialize)]
struct Page<'a> {
    comparison: &'a Comparison,
    tables: Vec<Table>,
    /// Names of the robot's own parameters with significant changes.
    changed: Vec<String>,
    maps: Vec<String>,
    overlays: Vec<String>,
    trends: Vec<String>,
    time_word: &'static str,
    provenance: &'a Provenance,
}

/// Quantities of one unit.
#[derive(Serialize)]
struct Table {
    title: String,
    unit: Unit,
    decimals: usize,
    rows: Vec<Row>,
    chart: Option<String>,
    with_trend: bool,
}

#[derive(Serialize)]
struct Row {
    name: String,
    values: Vec<f64>,
    change: f64,
    u95: f64,
    p_holm: f64,
    significant: bool,
    /// Per day or per result.
    slope: Option<f64>,
    slope_u95: Option<f64>,
}

/// The page `compare.html`.
///
/// # Errors
/// Only a fault of the template itself.
pub fn html(
    comparison: &Comparison,
    timeline: &Timeline,
    provenance: &Provenance,
) -> Result<String, Diagnostic> {
    let time = Time { timeline, unit: comparison.time_unit };
    let mut page = Page {
        comparison,
        tables: Vec::new(),
        changed: Vec::new(),
        maps: Vec::new(),
        overlays: Vec::new(),
        trends: Vec::new(),
        time_word: comparison.time_unit.word(),
        provenance,
    };
    match &comparison.subject {
        Subject::Results(results) => page.add_results(results, &time),
        Subject::Circles { circles } => {
            circles.iter().for_each(|circle| page.add_circle(circle, &time, comparison.tolerance_mm));
        }
    }
    render("compare.html", include_str!("compare.html"), &page)
}

struct Time<'a> {
    timeline: &'a Timeline,
    unit: TimeUnit,
}

impl Time<'_> {
    fn axis(&self) -> &'static str {
        match self.unit {
            TimeUnit::Days => "days from the first",
            TimeUnit::Results => "number of the result",
        }
    }

    /// The values less `origin`, with their line where the trend is significant.
    fn plot<N: Display>(&self, tracked: &Tracked<N>, origin: f64, words: PlotWords<'_>) -> String {
        let places = self.timeline.times.iter().zip(&tracked.values);
        let values: Vec<[f64; 3]> =
            places.map(|(time, value)| [*time, value.value - origin, value.sd]).collect();
        let line = tracked.trend.filter(|trend| trend.significant).map(|trend| trend.line);
        let largest = values.iter().map(|[_, value, _]| value.abs()).fold(0.0, f64::max);
        let unit = match tracked.unit {
            "mm" => Unit::length(largest),
            "rad" => Unit::angle(largest),
            other => unit_of(other),
        };
        TrendPlot {
            title: words.title,
            unit,
            time_name: self.axis(),
            values,
            line: line.map(|line| StraightLine { level: line.level - origin, ..line }),
            limit: words.limit,
        }
        .to_svg()
    }
}

/// Title and limit of a plot.
struct PlotWords<'a> {
    title: &'a str,
    limit: Option<f64>,
}

fn unit_of(unit: &'static str) -> Unit {
    match unit {
        "mm" => Unit::MM,
        "rad" => Unit::DEG,
        other => Unit { sign: other, factor: 1.0 },
    }
}

impl Page<'_> {
    fn add_results(&mut self, results: &ResultsCompared, time: &Time<'_>) {
        let own = &results.parameters;
        let of_group = |in_mm: bool| -> Vec<&Tracked<ParamId>> {
            own.iter().filter(|found| (found.name.unit() == parameter::Unit::Mm) == in_mm).collect()
        };
        let set_up: Vec<&Tracked<ParamId>> = results.set_up.iter().collect();
        let families = [
            ("Robot: lengths", of_group(true)),
            ("Robot: angles", of_group(false)),
            ("Set-up: tool ball, base balls and bar", set_up),
        ];
        self.tables.extend(families.into_iter().filter_map(|(title, family)| table(title, &family, time)));
        let changed: Vec<&Tracked<ParamId>> = own.iter().filter(|found| found.change.significant).collect();
        self.changed = changed.iter().map(|found| found.name.to_string()).collect();
        let maps = HeatMap::of_positions("Change of position", &results.position_change_mm.map);
        self.maps = maps.iter().map(HeatMap::to_svg).collect();
        if time.timeline.has_trend() {
            let moving = own.iter().filter(|found| found.trend.is_some_and(|trend| trend.significant));
            let plot = |found: &Tracked<ParamId>| {
                let first = found.values.first().map_or(0.0, |value| value.value);
                let title = format!("{}, change since the first", found.name);
                time.plot(found, first, PlotWords { title: &title, limit: None })
            };
            self.trends = moving.map(plot).collect();
        }
    }

    fn add_circle(&mut self, circle: &CircleCompared, time: &Time<'_>, tolerance_mm: Option<f64>) {
        let title = circle.circle.map_or("Circle".into(), |number| format!("Circle {number}"));
        let quantities: Vec<&Tracked<&'static str>> = circle.quantities.iter().collect();
        self.tables.extend(table(&title, &quantities, time));
        let changed = quantities.iter().filter(|found| found.change.significant);
        self.changed.extend(changed.map(|found| format!("{} ({title})", found.name)));
        self.overlays.extend(overlays(&title, circle));
        if time.timeline.has_trend() {
            let plots = quantities.iter().map(|found| {
                let limit = tolerance_mm.filter(|_| ["Gb", "G_lsc"].contains(&found.name));
                let title = format!("{title}, {}", found.name);
                time.plot(found, 0.0, PlotWords { title: &title, limit })
            });
            self.trends.extend(plots);
        }
    }
}

/// The traces of all tests in each sense: first and last in colours of their own.
fn overlays(title: &str, circle: &CircleCompared) -> Vec<String> {
    let last = circle.traces.len().saturating_sub(1);
    let of_sense = |sense: Sense| {
        let tests = circle.traces.iter().enumerate().flat_map(|(at, traces)| {
            let (series, name) = match at {
                0 => (Series::First, "first".to_owned()),
                at if at == last => (Series::Second, "last".to_owned()),
                at => (Series::Third, format!("number {}", at + 1)),
            };
            let of_sense = traces.iter().filter(move |trace| trace.direction == sense);
            let drawn = of_sense.filter(|trace| !trace.deviations.is_empty()).take(1);
            drawn.map(move |trace| PolarTrace {
                name: name.clone(),
                series,
                points: trace.deviations.clone(),
            })
        });
        let traces: Vec<PolarTrace> = tests.collect();
        let word = match sense {
            Sense::CounterClockwise => "counter-clockwise",
            Sense::Clockwise => "clockwise",
        };
        let plot = PolarPlot {
            title: format!("{title}, {word}"),
            radius_mm: Some(circle.radius_mm),
            traces,
            marks: Vec::new(),
        };
        (!plot.traces.is_empty()).then(|| plot.to_svg())
    };
    [Sense::CounterClockwise, Sense::Clockwise].into_iter().filter_map(of_sense).collect()
}

/// `None` of an empty family.
fn table<N: Display>(title: &str, family: &[&Tracked<N>], time: &Time<'_>) -> Option<Table> {
    let first = family.first()?;
    let unit = unit_of(first.unit);
    let smallest = family.iter().map(|found| found.change.sd * unit.factor).fold(f64::INFINITY, f64::min);
    let row = |found: &&Tracked<N>| Row {
        name: found.name.to_string(),
        values: found.values.iter().map(|value| value.value * unit.factor).collect(),
        change: found.change.change * unit.factor,
        u95: COVERAGE * found.change.sd * unit.factor,
        p_holm: found.change.p_holm,
        significant: found.change.significant,
        slope: found.trend.map(|trend| trend.line.slope * unit.factor),
        slope_u95: found.trend.map(|trend| COVERAGE * trend.line.slope_sd * unit.factor),
    };
    let interval = |found: &&Tracked<N>| Interval {
        name: found.name.to_string(),
        value: found.change.change,
        half_width: COVERAGE * found.change.sd,
    };
    let chart = Intervals {
        title: format!("{title}, change"),
        description: "Change from the first to the last with its 95 % interval",
        unit,
        rows: family.iter().map(interval).collect(),
        tolerance: None,
    };
    Some(Table {
        title: title.into(),
        unit,
        decimals: (decimals(smallest) + 1).min(6),
        rows: family.iter().map(row).collect(),
        chart: chart.to_svg(),
        with_trend: time.timeline.has_trend(),
    })
}
