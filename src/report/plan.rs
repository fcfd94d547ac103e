//! `plan.html`: what the robot is about to do, and what one will know afterwards.

use serde::Serialize;

use super::page::{Fact, Provenance, ReportError, render, texts};
use super::parameters::{class, word};
use super::plan_prediction::{self, Table};
use super::plan_view::{CheckRow, CircleRow, PlanView, PredictedRow};
use super::plot::frame::{NARROW, WIDE};
use super::plot::{HeatMap, Line, Projection, Series, TracePlot, View};
use super::scale::{fixed, plain, significant};
use crate::identify::result::{PredictedPair, WarningKind};
use crate::model::AXES;
use crate::plan::{Kind, Plan};

#[derive(Serialize)]
struct Page<'a> {
    robot: &'a str,
    doubts: Vec<&'a str>,
    notes: Vec<&'a str>,
    failed: usize,
    summary: String,
    facts: Vec<Fact>,
    checks: &'a [CheckRow],
    circles: Vec<CircleLine<'a>>,
    views: Vec<String>,
    stroke: Option<String>,
    axes: Vec<String>,
    error: Vec<[String; 3]>,
    predicted: Vec<PredictedLine<'a>>,
    dependent: &'a [String],
    maps: Vec<String>,
    manipulability: Option<String>,
    tables: Vec<Table>,
    advice: &'a [String],
    provenance: &'a Provenance,
}

#[derive(Serialize)]
struct CircleLine<'a> {
    row: &'a CircleRow,
    radius: String,
}

#[derive(Serialize)]
struct PredictedLine<'a> {
    name: &'a str,
    unit: &'static str,
    tolerance: String,
    sd: String,
    status: &'static str,
    class: &'static str,
    reason: &'a str,
}

/// The page `plan.html`.
///
/// # Errors
/// Only a fault of the template itself.
pub fn html(plan: &Plan, view: &PlanView) -> Result<String, ReportError> {
    let failed = view.checks.iter().filter(|check| !check.passed).count();
    let page = Page {
        robot: &view.provenance.robot,
        doubts: texts(&view.warnings, WarningKind::Doubt),
        notes: texts(&view.warnings, WarningKind::Note),
        failed,
        summary: summary(plan, view),
        facts: facts(plan, view),
        checks: &view.checks,
        circles: view.circles.iter().map(|row| CircleLine { row, radius: fixed(row.radius_mm, 1) }).collect(),
        views: views(plan, view),
        stroke: stroke(plan, view),
        axes: if plan.rows.is_empty() {
            Vec::new()
        } else {
            (0..AXES).map(|axis| axis_trace(plan, view, axis)).collect()
        },
        error: error(view),
        predicted: view.predicted.iter().map(predicted).collect(),
        dependent: &view.dependent,
        maps: view.maps.iter().map(HeatMap::to_svg).collect(),
        manipulability: manipulability(plan, view),
        tables: plan_prediction::tables(view),
        advice: &view.advice,
        provenance: &view.provenance,
    };
    render("plan.html", include_str!("plan.html"), &page)
}

fn count(plan: &Plan, kind: Kind) -> usize {
    plan.rows.iter().filter(|row| row.kind == kind).count()
}

fn summary(plan: &Plan, view: &PlanView) -> String {
    let balls = view.centres.len();
    let reference = match count(plan, Kind::Reference) {
        0 => String::new(),
        number => format!(" and {number} at the reference pose"),
    };
    format!(
        "{} poses to measure{reference}, with {balls} base {}; {} of {} checks passed.",
        count(plan, Kind::Measure),
        if balls == 1 { "ball" } else { "balls" },
        view.checks.iter().filter(|check| check.passed).count(),
        view.checks.len()
    )
}

fn facts(plan: &Plan, view: &PlanView) -> Vec<Fact> {
    let bar = &plan.header.job.bar;
    let [low, high] = bar.stroke_mm;
    let mut facts = vec![
        Fact::new("Rows", plan.rows.len().to_string()),
        Fact::new("Bar length", format!("{} mm", plain(bar.length_mm, 4))),
        Fact::new("Stroke", format!("{} to {} mm", plain(low, 3), plain(high, 3))),
        Fact::new("Margin kept", format!("{} mm", plain(view.margin_mm, 3))),
    ];
    for (number, centre) in &view.centres {
        let [x, y, z] = centre.map(|value| fixed(value, 3));
        facts.push(Fact::new(format!("Base ball {number}"), format!("X {x}, Y {y}, Z {z} mm")));
    }
    facts.extend(view.facts.iter().cloned());
    facts
}

/// Each projection twice: with the robot, and around the balls.
fn views(plan: &Plan, view: &PlanView) -> Vec<String> {
    let balls: Vec<(String, [f64; 3])> =
        view.centres.iter().map(|(number, centre)| (format!("ball {number}"), *centre)).collect();
    let path: Vec<[f64; 3]> = plan.rows.iter().map(|row| row.xyz_mm).collect();
    let dwells: Vec<[f64; 3]> =
        plan.rows.iter().filter(|row| row.kind != Kind::Transit).map(|row| row.xyz_mm).collect();
    let draw = |projection: Projection, place: &str, skeletons: &[Vec<[f64; 3]>]| {
        let title = format!("{}, {place}", projection.names().concat());
        View { title, projection, balls: &balls, path: &path, dwells: &dwells, skeletons }.to_svg()
    };
    if balls.is_empty() && path.is_empty() && view.skeletons.is_empty() {
        return Vec::new();
    }
    let around = |projection| draw(projection, "around the balls", &[]);
    Projection::ALL
        .into_iter()
        .flat_map(|projection| [draw(projection, "robot and path", &view.skeletons), around(projection)])
        .collect()
}

fn line(plan: &Plan, series: Series, value: impl Fn(&crate::plan::PlanRow) -> f64) -> Line {
    Line {
        series,
        points: plan.rows.iter().map(|row| [f64::from(row.index), value(row)]).collect(),
        dwell: plan.rows.iter().map(|row| row.kind != Kind::Transit).collect(),
    }
}

fn stroke(plan: &Plan, view: &PlanView) -> Option<String> {
    let bar = &plan.header.job.bar;
    let plot = TracePlot {
        title: "Nominal reading along the path".into(),
        size: [WIDE, 290.0],
        x_name: "row of the plan".into(),
        y_name: "reading (mm)".into(),
        line: line(plan, Series::Second, |row| row.length_mm - bar.length_mm),
        limits: Some(bar.stroke_mm),
        margin: view.margin_mm,
        show_limits: true,
    };
    (!plan.rows.is_empty()).then(|| plot.to_svg())
}

fn axis_trace(plan: &Plan, view: &PlanView, axis: usize) -> String {
    let [low, high] = view.limits_deg[axis];
    TracePlot {
        title: format!("A{} (limits {}° to {}°)", axis + 1, plain(low, 2), plain(high, 2)),
        size: [NARROW, 190.0],
        x_name: "row of the plan".into(),
        y_name: "deg".into(),
        line: line(plan, Series::Second, |row| row.axes_deg[axis]),
        limits: Some([low, high]),
        margin: 0.0,
        show_limits: true,
    }
    .to_svg()
}

fn manipulability(plan: &Plan, view: &PlanView) -> Option<String> {
    let values = &view.manipulability;
    let plot = TracePlot {
        title: "Manipulability along the path".into(),
        size: [WIDE, 230.0],
        x_name: "row of the plan".into(),
        y_name: "|det J| (m³)".into(),
        line: line(plan, Series::Second, |row| {
            values.get(row.index.saturating_sub(1) as usize).copied().unwrap_or_default()
        }),
        // At zero the arm is singular.
        limits: Some([0.0, 0.0]),
        margin: 0.0,
        show_limits: true,
    };
    (!values.is_empty() && !plan.rows.is_empty()).then(|| plot.to_svg())
}

fn error(view: &PlanView) -> Vec<[String; 3]> {
    let Some(PredictedPair { nominal, identified }) = view.predicted_error_mm else { return Vec::new() };
    [
        ("mean", nominal.mean, identified.mean),
        ("95 % of poses", nominal.p95, identified.p95),
        ("largest", nominal.max, identified.max),
    ]
    .map(|(name, before, after)| [name.to_owned(), fixed(before, 4), fixed(after, 4)])
    .into()
}

fn predicted(row: &PredictedRow) -> PredictedLine<'_> {
    let (unit, factor) = match row.unit.as_str() {
        "mm" => ("µm", 1e3),
        "rad" => ("µrad", 1e6),
        "rad/Nm" => ("nrad/(N m)", 1e9),
        _ => ("own unit", 1.0),
    };
    let show = |value: Option<f64>| value.map_or("–".into(), |value| significant(value * factor, 3));
    PredictedLine {
        name: &row.name,
        unit,
        tolerance: show(row.tolerance),
        sd: show(row.sd),
        status: word(row.status),
        class: class(row.status),
        reason: &row.reason,
    }
}
