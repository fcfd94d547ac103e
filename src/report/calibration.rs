//! `report.html`: what a calibration found, in the order in which one asks.

use std::collections::BTreeMap;

use serde::Serialize;

use super::export::frames::{Frame, frames};
use super::export::mastering::{AxisOffset, offsets};
use super::page::render;
use super::parameters::{Group, NotEstimated, groups, not_estimated};
use super::plot::{
    HeatMap, PolarPlot, PolarTrace, ResidualPoint, Series, Shown, against_axis, histogram, joint_error,
    residuals,
};
use super::scene::{Posed, Scene, SceneBall, skeleton};
use crate::conformity::{Budget, BudgetLine};
use crate::diagnostic::Diagnostic;
use crate::estimation::result::Recommendation;
use crate::estimation::{CalibrationResult, ResultFile, joint_curve, senses};
use crate::measurement::{Kind, Measurements};
use crate::provenance::Provenance;
use crate::robot::{AXES, BallId, BarId, CircleId, Datum, Joint};

/// Lengths that are drawn at most: an even sample of more.
const DRAWN: usize = 20_000;
/// The same of the panels of one axis each.
const DRAWN_BY_AXIS: usize = 1500;

#[derive(Serialize)]
struct Page<'a> {
    result: &'a ResultFile,
    /// The robot that "before" is about.
    before: String,
    /// Lengths and positions.
    made_from: String,
    /// What each recommendation says to measure.
    further: Vec<String>,
    counts: Counts,
    figures: Figures,
    groups: Vec<Group<'a>>,
    not_estimated: Vec<NotEstimated<'a>>,
    zeros: Vec<AxisOffset>,
    balls: Vec<Frame>,
    budget: &'a Budget,
    contributions: Vec<Contribution>,
    identity: Vec<(String, String)>,
    /// Data of the viewer.
    scene: String,
    provenance: &'a Provenance,
}

/// A line of the budget in words.
#[derive(Serialize)]
struct Contribution {
    name: &'static str,
    basis: &'static str,
    length_mm: Option<f64>,
    position_mm: Option<f64>,
}

impl From<&BudgetLine> for Contribution {
    fn from(line: &BudgetLine) -> Self {
        let &BudgetLine { source, basis, length_mm, position_mm } = line;
        Self { name: source.words(), basis: basis.words(), length_mm, position_mm }
    }
}

/// How many lengths of which kind there are.
#[derive(Serialize)]
struct Counts {
    per_ball: BTreeMap<BallId, usize>,
    positions: usize,
    at_reference: usize,
    /// Each how-manieth is drawn.
    stride: usize,
}

/// SVG texts.
#[derive(Serialize)]
struct Figures {
    maps: Vec<String>,
    circles: Vec<String>,
    residuals: Vec<String>,
    histograms: Vec<String>,
    axes: Vec<String>,
    joints: Vec<String>,
}

/// The page `report.html`.
///
/// # Errors
/// Only a fault of the template itself.
pub fn html(
    found: &CalibrationResult,
    observations: &Measurements,
    provenance: &Provenance,
    budget: &Budget,
) -> Result<String, Diagnostic> {
    let counts = Counts::of(observations);
    let points = points(found, observations, counts.stride);
    let file = ResultFile::from(found);
    let page = Page {
        result: &file,
        before: found.start.to_string(),
        made_from: found.made_from.to_string(),
        further: found.recommendations.iter().map(Recommendation::what).collect(),
        figures: Figures::of(found, &points),
        counts,
        groups: groups(found, &file),
        not_estimated: not_estimated(&file.parameters),
        zeros: offsets(found),
        balls: frames(found),
        budget,
        contributions: budget.lines.iter().map(Contribution::from).collect(),
        identity: provenance.identity.facts(),
        scene: scene(found, &points).json()?,
        provenance,
    };
    render("calibration.html", include_str!("calibration.html"), &page)
}

impl Counts {
    fn of(observations: &Measurements) -> Self {
        let mut per_ball = BTreeMap::new();
        for row in &observations.rows {
            if let Some(ball) = row.datum.ball() {
                *per_ball.entry(ball).or_default() += 1;
            }
        }
        let kinds = observations.rows.iter().filter_map(|row| row.context.as_ref()?.kind);
        let at_reference = kinds.filter(|kind| *kind == Kind::Reference).count();
        let positions = observations.positions().count();
        Self { per_ball, positions, at_reference, stride: observations.rows.len().div_ceil(DRAWN).max(1) }
    }
}

/// Every `stride`-th measurement with its residuals.
fn points(found: &CalibrationResult, observations: &Measurements, stride: usize) -> Vec<ResidualPoint> {
    let rows = observations.rows.iter();
    let senses = senses(rows.clone().map(|row| row.axes.radians())).step_by(stride);
    let drawn = rows.clone().enumerate().step_by(stride).zip(found.residuals(rows.step_by(stride)));
    drawn
        .zip(senses)
        .map(|(((at, row), residual), senses)| ResidualPoint {
            index: row.index,
            datum: row.datum,
            axes_deg: row.axes.degrees(),
            senses,
            before_mm: residual.before,
            after_mm: residual.after,
            on_circle: row.context.as_ref().and_then(|context| context.circle.zip(context.angle_deg)),
            outlier: !found.uses(at),
        })
        .collect()
}

impl Figures {
    fn of(found: &CalibrationResult, points: &[ResidualPoint]) -> Self {
        let sound: Vec<&ResidualPoint> = points.iter().filter(|point| !point.outlier).collect();
        Self {
            maps: maps(found, points),
            circles: circles(&sound),
            residuals: per_datum(points, found.sigma.mm),
            histograms: histograms(&sound),
            axes: axes(&sound),
            joints: joints(found, &sound),
        }
    }
}

/// The base balls as identified.
fn balls(found: &CalibrationResult) -> impl Iterator<Item = (BallId, [f64; 3])> {
    found.posterior.model.balls.iter().enumerate().map(|(at, ball)| (BallId::at(at), (*ball).into()))
}

/// The maps, with the arm at the first pose.
fn maps(found: &CalibrationResult, points: &[ResidualPoint]) -> Vec<String> {
    let arm = points.first().map_or_else(Vec::new, |point| skeleton(&found.robot, &point.axes_deg));
    let balls: Vec<_> = balls(found).map(|(ball, at)| (format!("ball {ball}"), at)).collect();
    HeatMap::of_uncertainty(&found.map, &arm, &balls).iter().map(HeatMap::to_svg).collect()
}

/// What the viewer shows.
fn scene(found: &CalibrationResult, points: &[ResidualPoint]) -> Scene {
    let id = |ball: BallId| u32::try_from(ball.index() + 1).unwrap_or(u32::MAX);
    let posed = points.iter().filter(|point| !point.outlier).filter_map(|point| {
        let (index, axes_deg, residual_mm) = (point.index, point.axes_deg, Some(point.after_mm));
        Some(Posed { index, ball: id(point.datum.ball()?), axes_deg, residual_mm })
    });
    let balls = balls(found).map(|(ball, at)| SceneBall { id: id(ball), at }).collect();
    Scene::new(&found.robot, balls, &posed.collect::<Vec<_>>(), &[])
}

/// For each circle: before and after on one scale, and after alone on its own.
fn circles(sound: &[&ResidualPoint]) -> Vec<String> {
    let mut circles: BTreeMap<(CircleId, BallId), [Vec<[f64; 2]>; 2]> = BTreeMap::new();
    for point in sound {
        if let Some(((circle, angle_deg), ball)) = point.on_circle.zip(point.datum.ball()) {
            let [before, after] = circles.entry((circle, ball)).or_default();
            before.push([angle_deg, point.before_mm]);
            after.push([angle_deg, point.after_mm]);
        }
    }
    let draw = |title, traces| PolarPlot { title, radius_mm: None, traces, marks: Vec::new() }.to_svg();
    let trace = |name: &str, series, points| PolarTrace { name: name.into(), series, points };
    circles
        .into_iter()
        .flat_map(|((circle, ball), [before, after])| {
            let title = format!("Circle {circle}, ball {ball}");
            let after = trace("after", Series::Second, after);
            let magnified = draw(format!("{title}: after, magnified"), vec![after.clone()]);
            [draw(title, vec![trace("before", Series::First, before), after]), magnified]
        })
        .collect()
}

/// For each base ball and each coordinate of the tracker: before and after on one scale, and after alone on its own.
fn per_datum(points: &[ResidualPoint], sigma_mm: f64) -> Vec<String> {
    let mut sets: BTreeMap<Datum, Vec<ResidualPoint>> = BTreeMap::new();
    for point in points {
        let by_any_bar = point.datum.ball().map(|ball| Datum::Ball(ball, BarId::FIRST));
        sets.entry(by_any_bar.unwrap_or(point.datum)).or_default().push(*point);
    }
    sets.into_iter()
        .flat_map(|(datum, points)| {
            let what = match datum {
                Datum::Ball(ball, _) => format!("Ball {ball}"),
                Datum::Plane(coordinate) => format!("Tracker, {coordinate}"),
            };
            [
                residuals(&format!("{what}: before and after"), &points, Shown::BeforeAndAfter),
                residuals(&format!("{what}: after, magnified"), &points, Shown::After { sigma_mm }),
            ]
        })
        .collect()
}

fn histograms(sound: &[&ResidualPoint]) -> Vec<String> {
    if sound.is_empty() {
        return Vec::new();
    }
    let before: Vec<f64> = sound.iter().map(|point| point.before_mm).collect();
    let after: Vec<f64> = sound.iter().map(|point| point.after_mm).collect();
    vec![
        histogram("Residuals before", &before, Series::First),
        histogram("Residuals after", &after, Series::Second),
    ]
}

/// A panel for each axis, all on one scale.
fn axes(sound: &[&ResidualPoint]) -> Vec<String> {
    let stride = sound.len().div_ceil(DRAWN_BY_AXIS).max(1);
    let shown: Vec<&ResidualPoint> = sound.iter().copied().step_by(stride).collect();
    if shown.is_empty() {
        return Vec::new();
    }
    let sizes = shown.iter().map(|point| point.after_mm.abs()).filter(|size| size.is_finite());
    let largest_mm = sizes.fold(0.0, f64::max);
    (0..AXES).map(|axis| against_axis(axis, &shown, largest_mm)).collect()
}

/// The error of each joint, where the robot has one.
fn joints(found: &CalibrationResult, sound: &[&ResidualPoint]) -> Vec<String> {
    if found.joints.is_none() {
        return Vec::new();
    }
    let stride = sound.len().div_ceil(DRAWN_BY_AXIS).max(1);
    let draw = |joint: Joint| {
        let axis = joint.index();
        let coupling = &found.robot.geometry.coupling;
        let angle_deg = |point: &&ResidualPoint| coupling.joints(&point.axes_deg)[axis];
        let measured: Vec<f64> = sound.iter().step_by(stride).map(angle_deg).collect();
        joint_error(axis, &joint_curve(&found.robot, joint), &measured)
    };
    Joint::ALL.into_iter().map(draw).collect()
}
