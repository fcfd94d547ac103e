//! `compare.html`: results or circular tests side by side in time.

use std::fmt::Display;

use minijinja::Value;
use minijinja::value::Serde;
use serde::Serialize;

use super::page::render;
use super::plot::{
    HeatMap, Interval, Intervals, PANEL, PolarPlot, PolarTrace, Series, Time, TrendLine, TrendPlot,
    TrendPoint,
};
use super::scale::{Unit, decimals};
use super::verdict::Verdict;
use dbbd_model::circular::CircleSense;
use dbbd_model::conformity::{
    ComparedCircle, ComparedResults, ComparisonSubject, ResultComparison, ResultTimeline, TimelineUnit,
    TrackedQuantity,
};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::math::distributions::COVERAGE_95;
use dbbd_model::math::straight_line::StraightLine;
use dbbd_model::provenance::Provenance;
use dbbd_model::robot::{ParamId, ParamUnit};

#[derive(Serialize)]
struct Page<'a> {
    comparison: &'a ResultComparison,
    tables: Vec<Table>,
    /// Names of the robot's own parameters with significant changes.
    changed: Vec<String>,
    maps: Vec<String>,
    overlays: Vec<String>,
    trends: Vec<String>,
    has_trend: bool,
    /// The verdict; `None` before the tables are made.
    verdict: Option<Verdict>,
    time_word: &'static str,
    provenance: &'a Provenance,
}

/// A table of quantities of one unit.
#[derive(Serialize)]
struct Table {
    title: String,
    unit: Unit,
    decimals: usize,
    /// Rows, each a [`TrackedQuantity`].
    rows: Vec<Value>,
    chart: Option<String>,
}

pub fn html(
    comparison: &ResultComparison,
    timeline: &ResultTimeline,
    provenance: &Provenance,
) -> Result<String, Diagnostic> {
    let mut page = Page {
        comparison,
        tables: Vec::new(),
        changed: Vec::new(),
        maps: Vec::new(),
        overlays: Vec::new(),
        trends: Vec::new(),
        has_trend: timeline.has_trend(),
        verdict: None,
        time_word: comparison.time_unit.word(),
        provenance,
    };
    match &comparison.subject {
        ComparisonSubject::Results(results) => page.add_results(results, timeline),
        ComparisonSubject::Circles { circles } => {
            circles.iter().for_each(|circle| page.add_circle(circle, timeline));
        }
    }
    page.verdict = Some(Verdict::of_comparison(comparison, &page.changed));
    render("compare.html", include_str!("compare.html"), &page)
}

fn unit_of(unit: &'static str) -> Unit {
    match unit {
        "mm" => Unit::MM,
        "rad" => Unit::DEG,
        other => Unit { sign: other, factor: 1.0 },
    }
}

impl Page<'_> {
    fn add_results(&mut self, results: &ComparedResults, timeline: &ResultTimeline) {
        let own = &results.parameters;
        let is_length = |id: ParamId| match id.unit() {
            ParamUnit::Mm => true,
            ParamUnit::Rad | ParamUnit::RadPerNm => false,
        };
        let of_group = |lengths: bool| -> Vec<&TrackedQuantity<ParamId>> {
            own.iter().filter(|found| is_length(found.name) == lengths).collect()
        };
        let families = [
            ("Robot: lengths", of_group(true)),
            ("Robot: angles", of_group(false)),
            ("Set-up: tool ball, base balls and bar", results.set_up.iter().collect()),
        ];
        self.tables.extend(families.into_iter().filter_map(|(title, family)| table(title, &family)));
        let changed = own.iter().filter(|found| found.change.significant);
        self.changed = changed.map(|found| found.name.to_string()).collect();
        self.maps = HeatMap::of_positions("Change of position", &results.position_change_mm.map);
        if self.has_trend {
            let moving = own.iter().filter(|found| found.trend.is_some_and(|trend| trend.significant));
            let plot = |found: &TrackedQuantity<ParamId>| {
                let first = found.values.first().map_or(0.0, |value| value.value);
                let title = format!("{}, change since the first", found.name);
                self.trend(found, timeline, &title, first)
            };
            self.trends = moving.map(plot).collect();
        }
    }

    fn add_circle(&mut self, circle: &ComparedCircle, timeline: &ResultTimeline) {
        let title = circle.circle.map_or("Circle".into(), |number| format!("Circle {number}"));
        let quantities: Vec<&TrackedQuantity<&'static str>> = circle.quantities.iter().collect();
        self.tables.extend(table(&title, &quantities));
        let changed = quantities.iter().filter(|found| found.change.significant);
        self.changed.extend(changed.map(|found| format!("{} ({title})", found.name)));
        self.overlays.extend(overlays(&title, circle));
        if self.has_trend {
            let plot = |found: &&TrackedQuantity<&'static str>| {
                self.trend(found, timeline, &format!("{title}, {}", found.name), 0.0)
            };
            let plots: Vec<String> = quantities.iter().map(plot).collect();
            self.trends.extend(plots);
        }
    }

    /// The values less `origin` against time, with their line if the trend is significant. The tolerance is the
    /// tolerance of the circular deviation.
    fn trend<N: Display>(
        &self,
        tracked: &TrackedQuantity<N>,
        timeline: &ResultTimeline,
        title: &str,
        origin: f64,
    ) -> String {
        let point = |(time, value): (&f64, &dbbd_model::conformity::TrackedValue)| {
            let (value, u95) = (value.value - origin, COVERAGE_95 * value.sd);
            TrendPoint { time: *time, value, u95, has_warnings: false }
        };
        let points: Vec<TrendPoint> = timeline.times.iter().zip(&tracked.values).map(point).collect();
        let trend = tracked.trend.filter(|trend| trend.significant).zip(points.last());
        let line = trend.map(|(trend, last)| TrendLine {
            line: StraightLine { level: trend.line.level - origin, ..trend.line },
            coverage: None,
            until: last.time,
        });
        let largest = points.iter().map(|point| point.value.abs()).fold(0.0, f64::max);
        let unit = match tracked.unit {
            "mm" => Unit::length(largest),
            "rad" => Unit::angle(largest),
            other => unit_of(other),
        };
        let time = Time::Numbers(match self.comparison.time_unit {
            TimelineUnit::Days => "days from the first",
            TimelineUnit::Results => "number of the result",
        });
        let is_deviation = ["Gb", "G_lsc"].contains(&tracked.name.to_string().as_str());
        let limit = self.comparison.tolerance_mm.filter(|_| is_deviation);
        TrendPlot { title, size: PANEL, unit, time, points: &points, line, limit }.to_svg()
    }
}

/// Overlaid traces of all tests in each sense; first and last have colours of their own.
fn overlays(title: &str, circle: &ComparedCircle) -> Vec<String> {
    let last = circle.traces.len().saturating_sub(1);
    let of_sense = |sense: CircleSense| {
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
            CircleSense::CounterClockwise => "counter-clockwise",
            CircleSense::Clockwise => "clockwise",
        };
        let plot = PolarPlot {
            title: format!("{title}, {word}"),
            radius_mm: Some(circle.radius_mm),
            traces,
            marks: Vec::new(),
        };
        (!plot.traces.is_empty()).then(|| plot.to_svg())
    };
    [CircleSense::CounterClockwise, CircleSense::Clockwise].into_iter().filter_map(of_sense).collect()
}

/// The table of a family of quantities; `None` for an empty family.
fn table<N: Display + Serialize>(title: &str, family: &[&TrackedQuantity<N>]) -> Option<Table> {
    let unit = unit_of(family.first()?.unit);
    let smallest = family.iter().map(|found| found.change.sd * unit.factor).fold(f64::INFINITY, f64::min);
    let interval = |found: &&TrackedQuantity<N>| Interval {
        name: found.name.to_string(),
        value: found.change.change,
        half_width: COVERAGE_95 * found.change.sd,
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
        rows: family.iter().map(|found| Value::from(Serde(*found))).collect(),
        chart: chart.to_svg(),
    })
}
