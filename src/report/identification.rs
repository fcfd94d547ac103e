//! `report.html`: what an identification found, in the order in which one asks.

use std::collections::BTreeMap;

use serde::Serialize;

use super::choices::{self, Choices};
use super::diagnosis::{self, AdviceLine};
use super::handing_back::{self, PlaceLine, ZeroLine};
use super::identification_view::{CirclePanel, IdentificationPlots, ObservationPoint};
use super::page::{Fact, Provenance, ReportError, render, texts};
use super::parameters::{Group, charts, estimated, groups, word};
use super::plot::{HeatMap, Histogram, PolarPlot, PolarTrace, ResidualPlot, ResidualPoint, Series};
use super::scale::{fixed, significant};
use crate::identify::result::{Identification, PredictedError, Residual, Status, WarningKind};

#[derive(Serialize)]
struct Page<'a> {
    robot: &'a str,
    doubts: Vec<&'a str>,
    notes: Vec<&'a str>,
    converged: bool,
    verdict: Vec<String>,
    facts: Vec<Fact>,
    choices: Choices,
    comparison: Vec<Comparison>,
    polar: Vec<[String; 2]>,
    residuals: Vec<String>,
    histograms: Vec<String>,
    joints: Vec<String>,
    panels: Vec<String>,
    advice: Vec<AdviceLine>,
    correlated: Vec<[String; 3]>,
    zeros: Vec<ZeroLine>,
    balls: Vec<PlaceLine>,
    outliers: Vec<[String; 3]>,
    groups: Vec<Group>,
    charts: Vec<String>,
    dependent: Vec<DependentLine<'a>>,
    untold: Vec<Untold>,
    maps: Vec<String>,
    provenance: &'a Provenance,
}

#[derive(Serialize)]
struct Comparison {
    quantity: &'static str,
    before: String,
    after: String,
    factor: String,
    rule: bool,
}

#[derive(Serialize)]
struct DependentLine<'a> {
    kept: &'a str,
    text: &'a str,
}

#[derive(Serialize)]
struct Untold {
    names: String,
    status: &'static str,
    reason: String,
}

/// The page `report.html`.
///
/// # Errors
/// Only a fault of the template itself.
pub fn html(result: &Identification, plots: &IdentificationPlots) -> Result<String, ReportError> {
    let page = Page {
        robot: &result.robot,
        doubts: texts(&result.warnings, WarningKind::Doubt),
        notes: texts(&result.warnings, WarningKind::Note),
        converged: result.converged,
        verdict: verdict(result),
        facts: facts(result, plots),
        choices: choices::choices(result),
        comparison: comparison(result),
        polar: plots.circles.iter().filter_map(|circle| polar(circle, result, plots)).collect(),
        residuals: residuals(result, plots),
        histograms: histograms(result, plots),
        joints: diagnosis::joints(result),
        panels: diagnosis::panels(result, plots),
        advice: diagnosis::advice(result),
        correlated: diagnosis::correlated(result),
        zeros: handing_back::zeros(&plots.zeros),
        balls: handing_back::places(&plots.balls),
        outliers: result
            .outliers
            .iter()
            .map(|o| [o.index.to_string(), o.centre.to_string(), fixed(o.residual_mm, 4)])
            .collect(),
        groups: groups(&result.parameters),
        charts: charts(&result.parameters, plots.tolerance.map(|t| [t.length_mm, t.angle_rad])),
        dependent: dependent(result),
        untold: untold(result),
        maps: plots.maps.iter().map(HeatMap::to_svg).collect(),
        provenance: &plots.provenance,
    };
    render("identification.html", include_str!("identification.html"), &page)
}

/// The answer in sentences.
fn verdict(result: &Identification) -> Vec<String> {
    let Identification { residual_mm: residual, predicted_position_error_mm: predicted, .. } = result;
    let told = result.parameters.iter().filter(|parameter| estimated(parameter.status)).count();
    vec![
        format!(
            "The rms residual of the lengths {} from {} mm to {} mm.",
            went(residual.before.rms, residual.after.rms),
            significant(residual.before.rms, 3),
            significant(residual.after.rms, 3)
        ),
        format!(
            "The predicted 3-D position error over the workspace {} from {} mm to {} mm in the mean, with 95 % of \
             the poses below {} mm.",
            went(predicted.nominal.mean, predicted.identified.mean),
            significant(predicted.nominal.mean, 3),
            significant(predicted.identified.mean, 3),
            significant(predicted.identified.p95, 3)
        ),
        format!(
            "{told} of {} parameters were estimated; the data tell {} independent directions.",
            result.parameters.len(),
            result.rank
        ),
    ]
}

fn went(before: f64, after: f64) -> &'static str {
    if after < before {
        "fell"
    } else if after > before {
        "rose"
    } else {
        "went"
    }
}

fn facts(result: &Identification, plots: &IdentificationPlots) -> Vec<Fact> {
    let balls: Vec<String> =
        plots.per_ball.iter().map(|(ball, count)| format!("ball {ball}: {count}")).collect();
    let mut facts = vec![Fact::new("Lengths used", result.observations.to_string())];
    if !balls.is_empty() {
        facts.push(Fact::new("Per base ball", balls.join(", ")));
    }
    if plots.references > 0 {
        facts.push(Fact::new("At the reference pose", plots.references.to_string()));
    }
    facts.push(Fact::new("Set aside as outliers", result.outliers.len().to_string()));
    facts.push(choices::sigma(result));
    facts.push(Fact::new(
        "Rank (nominal, at the solution)",
        format!("{}, {}", result.rank, result.rank_at_solution),
    ));
    facts.push(Fact::new("Condition of the base set", significant(result.condition, 3)));
    facts.extend(diagnosis::facts(result));
    facts.push(Fact::new("Solver steps", result.iterations.to_string()));
    facts.extend(plots.facts.iter().cloned());
    facts
}

fn comparison(result: &Identification) -> Vec<Comparison> {
    let line = |quantity, before: f64, after: f64, rule| Comparison {
        quantity,
        before: fixed(before, 4),
        after: fixed(after, 4),
        factor: if before > 0.0 && after > 0.0 { significant(before / after, 2) } else { "–".into() },
        rule,
    };
    let residual = |names: [&'static str; 3], before: Residual, after: Residual| {
        [
            line(names[0], before.rms, after.rms, true),
            line(names[1], before.mean, after.mean, false),
            line(names[2], before.max, after.max, false),
        ]
    };
    let own = result.residual_mm;
    let mut lines =
        Vec::from(residual(["Residual, rms", "Residual, mean", "Residual, largest"], own.before, own.after));
    // A mean crosses zero: its ratio says nothing.
    if let Some(mean) = lines.get_mut(1) {
        mean.factor = "–".into();
    }
    if let Some(folds) = result.folds {
        lines.push(line("Held-out residual by cross-validation, rms", f64::NAN, folds.rms, true));
    }
    if let Some(validation) = result.validation {
        let names = ["Validation file, rms", "Validation file, mean", "Validation file, largest"];
        let mut separate = residual(names, validation.before, validation.after);
        separate[1].factor = "–".into();
        lines.extend(separate);
    }
    let PredictedError { mean, p95, max } = result.predicted_position_error_mm.nominal;
    let after = result.predicted_position_error_mm.identified;
    lines.push(line("Predicted 3-D error, mean", mean, after.mean, true));
    lines.push(line("Predicted 3-D error, 95 % of poses", p95, after.p95, false));
    lines.push(line("Predicted 3-D error, largest (95 % of robots)", max, after.max, false));
    lines
}

/// Before and after to one scale, and after alone to its own; without the outliers.
fn polar(circle: &CirclePanel, result: &Identification, plots: &IdentificationPlots) -> Option<[String; 2]> {
    let on_circle = |o: &&ObservationPoint| o.circle == Some(circle.number) && !o.is_outlier(result);
    let members = || plots.observations.iter().filter(on_circle);
    let trace = |name: &str, series, value: fn(&ObservationPoint) -> f64| PolarTrace {
        name: name.into(),
        series,
        points: members().filter_map(|o| Some([o.angle_deg?, value(o)])).collect(),
    };
    let before = trace("before", Series::First, |o| o.before_mm);
    let after = trace("after", Series::Second, |o| o.after_mm);
    let draw = |title: String, traces| {
        let (radius_mm, axis_names) = (circle.radius_mm, circle.axis_names.clone());
        PolarPlot { title, radius_mm, axis_names, traces }.to_svg()
    };
    (!after.points.is_empty()).then(|| {
        [
            draw(circle.name.clone(), vec![before, after.clone()]),
            draw(format!("{}: after, magnified", circle.name), vec![after]),
        ]
    })
}

/// For each base ball: before and after to one scale, and after alone to its own.
fn residuals(result: &Identification, plots: &IdentificationPlots) -> Vec<String> {
    let mut balls: BTreeMap<usize, Vec<ResidualPoint>> = BTreeMap::new();
    for o in &plots.observations {
        balls.entry(o.centre).or_default().push(ResidualPoint {
            index: o.index,
            before_mm: Some(o.before_mm),
            after_mm: o.after_mm,
            outlier: o.is_outlier(result),
        });
    }
    balls
        .into_iter()
        .flat_map(|(ball, points)| {
            let alone = points.iter().map(|point| ResidualPoint { before_mm: None, ..*point }).collect();
            let both =
                ResidualPlot { title: format!("Ball {ball}: before and after"), points, sigma_mm: None };
            let title = format!("Ball {ball}: after, magnified");
            let after = ResidualPlot { title, points: alone, sigma_mm: Some(result.sigma_mm) };
            [both.to_svg(), after.to_svg()]
        })
        .collect()
}

fn histograms(result: &Identification, plots: &IdentificationPlots) -> Vec<String> {
    let sound = || plots.observations.iter().filter(|o| !o.is_outlier(result));
    let draw = |title: &str, series, values_mm| Histogram { title: title.into(), values_mm, series }.to_svg();
    if sound().next().is_none() {
        return Vec::new();
    }
    vec![
        draw("Residuals before", Series::First, sound().map(|o| o.before_mm).collect()),
        draw("Residuals after", Series::Second, sound().map(|o| o.after_mm).collect()),
    ]
}

fn dependent(result: &Identification) -> Vec<DependentLine<'_>> {
    result.dependent.iter().map(|group| DependentLine { kept: &group.kept, text: &group.text }).collect()
}

/// What was not estimated, by reason.
fn untold(result: &Identification) -> Vec<Untold> {
    let mut lines: Vec<(Status, &str, Vec<&str>)> = Vec::new();
    for parameter in result.parameters.iter().filter(|parameter| !estimated(parameter.status)) {
        let (status, reason) = (parameter.status, parameter.reason.as_str());
        match lines.iter_mut().find(|line| line.0 == status && line.1 == reason) {
            Some(line) => line.2.push(&parameter.name),
            None => lines.push((status, reason, vec![&parameter.name])),
        }
    }
    lines
        .into_iter()
        .map(|(status, reason, names)| Untold {
            names: names.join(", "),
            status: word(status),
            reason: reason.to_owned(),
        })
        .collect()
}
