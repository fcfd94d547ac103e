//! `report.html`: the result of a calibration.

use std::collections::BTreeMap;

use serde::Serialize;

use super::export::frames::{BallInFrame, frames};
use super::export::mastering::{AxisOffset, offsets};
use super::page::render;
use super::parameters::{Group, NotEstimated, groups, not_estimated};
use super::plot::{
    HeatMap, PolarPlot, PolarTrace, ResidualPoint, ResidualSet, Series, against_axis, histogram, joint_error,
    residuals,
};
use super::scene::{BallMark, Scene, ScenePose, skeleton};
use super::verdict::{Verdict, holds};
use dbbd_model::conformity::{BudgetLine, UncertaintyBudget, standing};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::result::Recommendation;
use dbbd_model::estimation::{CalibrationResult, Combination, CompletedCalibration, joint_curve};
use dbbd_model::measurement::{Measurements, PoseKind};
use dbbd_model::provenance::Provenance;
use dbbd_model::robot::{AXES, Approach, BallId, BarId, CircleId, Datum, Joint};

/// Most lengths that are drawn; more are sampled evenly.
const DRAWN: usize = 20_000;
/// The same limit in the panels of the axes.
const DRAWN_BY_AXIS: usize = 1500;

#[derive(Serialize)]
struct Page<'a> {
    result: &'a CalibrationResult,
    /// The robot that "before" refers to.
    before: String,
    made_from: String,
    /// The measurement that each recommendation proposes.
    further: Vec<String>,
    /// Each combination in words.
    combinations: Vec<String>,
    counts: Counts,
    figures: Figures,
    groups: Vec<Group<'a>>,
    not_estimated: Vec<NotEstimated<'a>>,
    zeros: Vec<AxisOffset>,
    balls: Vec<BallInFrame>,
    budget: &'a UncertaintyBudget,
    verdict: Verdict,
    /// How its uncertainty grows until the validity ends.
    holds: Option<String>,
    /// Source and basis of each line of the budget, in words.
    contributions: Vec<(&'static str, &'static str, &'a BudgetLine)>,
    identity: Vec<(String, String)>,
    /// Data of the viewer.
    scene: String,
    provenance: &'a Provenance,
}

#[derive(Serialize)]
struct Counts {
    per_ball: BTreeMap<BallId, usize>,
    positions: usize,
    at_reference: usize,
    /// Only one length of this number is drawn.
    stride: usize,
}

#[derive(Serialize)]
struct Figures {
    maps: Vec<String>,
    circles: Vec<String>,
    residuals: Vec<String>,
    histograms: Vec<String>,
    axes: Vec<String>,
    joints: Vec<String>,
}

pub fn html(
    found: &CompletedCalibration,
    observations: &Measurements,
    provenance: &Provenance,
    budget: &UncertaintyBudget,
) -> Result<String, Diagnostic> {
    let counts = Counts::of(observations);
    let points = points(found, observations, counts.stride);
    let result = &found.result;
    let page = Page {
        result,
        before: result.start.to_string(),
        made_from: result.made_from.to_string(),
        further: result.recommendations.iter().map(Recommendation::what).collect(),
        combinations: result.combinations.iter().map(Combination::to_string).collect(),
        figures: Figures::of(found, &points),
        counts,
        groups: groups(result, &found.robot),
        not_estimated: not_estimated(&result.parameters),
        zeros: offsets(&found.result, &found.robot),
        balls: frames(result),
        budget,
        verdict: Verdict::of_calibration(result, budget, &standing(&result.into(), None, None)),
        holds: result.validity.as_ref().filter(|validity| validity.limit_mm.is_some()).map(holds),
        contributions: budget.lines.iter().map(|l| (l.source.words(), l.basis.words(), l)).collect(),
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
        let at_reference = kinds.filter(|kind| *kind == PoseKind::Reference).count();
        let positions = observations.positions().count();
        Self { per_ball, positions, at_reference, stride: observations.rows.len().div_ceil(DRAWN).max(1) }
    }
}

/// Every `stride`-th measurement with its residuals.
fn points(found: &CompletedCalibration, observations: &Measurements, stride: usize) -> Vec<ResidualPoint> {
    let rows = observations.rows.iter();
    let along = Approach::along(rows.clone().map(|row| row.axes.radians()));
    let senses = along.map(|approach| approach.senses()).step_by(stride);
    let drawn = rows.enumerate().step_by(stride);
    let drawn = drawn.clone().zip(found.residuals(drawn));
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
    fn of(found: &CompletedCalibration, points: &[ResidualPoint]) -> Self {
        let inliers: Vec<&ResidualPoint> = points.iter().filter(|point| !point.outlier).collect();
        let arm = points.first().map_or_else(Vec::new, |point| skeleton(&found.robot, &point.axes_deg));
        Self {
            maps: HeatMap::of_uncertainty(&found.map, &arm, &balls(found)),
            circles: circles(&inliers),
            residuals: per_datum(points, found.result.noise_mm.length),
            histograms: histograms(&inliers),
            axes: axes(&inliers),
            joints: joints(found, &inliers),
        }
    }
}

/// The base balls as identified.
fn balls(found: &CompletedCalibration) -> Vec<BallMark> {
    let balls = (1..).zip(&found.posterior.model.balls);
    balls.map(|(id, ball)| BallMark { id, at: (*ball).into() }).collect()
}

fn scene(found: &CompletedCalibration, points: &[ResidualPoint]) -> Scene {
    let poses = points.iter().filter(|point| !point.outlier).filter_map(|point| {
        let ball = point.datum.ball()?.number();
        Some(ScenePose::new(&found.robot, point.index, ball, &point.axes_deg, Some(point.after_mm)))
    });
    Scene::new(&balls(found), poses.collect(), &[])
}

/// Two plots for each circle: before and after on one scale, and after alone on its own scale.
fn circles(inliers: &[&ResidualPoint]) -> Vec<String> {
    let mut circles: BTreeMap<(CircleId, BallId), [Vec<[f64; 2]>; 2]> = BTreeMap::new();
    for point in inliers {
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

/// Two plots for each base ball and each coordinate of the tracker: before and after on one scale, and after alone on
/// its own scale.
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
                residuals(&format!("{what}: before and after"), &points, ResidualSet::BeforeAndAfter),
                residuals(&format!("{what}: after, magnified"), &points, ResidualSet::After { sigma_mm }),
            ]
        })
        .collect()
}

fn histograms(inliers: &[&ResidualPoint]) -> Vec<String> {
    if inliers.is_empty() {
        return Vec::new();
    }
    let before: Vec<f64> = inliers.iter().map(|point| point.before_mm).collect();
    let after: Vec<f64> = inliers.iter().map(|point| point.after_mm).collect();
    vec![
        histogram("Residuals before", &before, Series::First),
        histogram("Residuals after", &after, Series::Second),
    ]
}

/// A panel for each axis, all on one scale.
fn axes(inliers: &[&ResidualPoint]) -> Vec<String> {
    let stride = inliers.len().div_ceil(DRAWN_BY_AXIS).max(1);
    let drawn: Vec<&ResidualPoint> = inliers.iter().copied().step_by(stride).collect();
    if drawn.is_empty() {
        return Vec::new();
    }
    let sizes = drawn.iter().map(|point| point.after_mm.abs()).filter(|size| size.is_finite());
    let largest_mm = sizes.fold(0.0, f64::max);
    (0..AXES).map(|axis| against_axis(axis, &drawn, largest_mm)).collect()
}

/// The errors of the joints, if they were estimated.
fn joints(found: &CompletedCalibration, inliers: &[&ResidualPoint]) -> Vec<String> {
    if found.result.joint_errors.is_none() {
        return Vec::new();
    }
    let stride = inliers.len().div_ceil(DRAWN_BY_AXIS).max(1);
    let draw = |joint: Joint| {
        let axis = joint.index();
        let coupling = &found.robot.geometry.coupling;
        let angle_deg = |point: &&ResidualPoint| coupling.joints(&point.axes_deg)[axis];
        let measured: Vec<f64> = inliers.iter().step_by(stride).map(angle_deg).collect();
        joint_error(axis, &joint_curve(&found.robot, joint), &measured)
    };
    Joint::ALL.into_iter().map(draw).collect()
}
