//! `plan.html`: the path with its checks, and the predicted result of an identification.

use nalgebra::Matrix6;
use serde::Serialize;

use super::page::render;
use super::plot::{HeatMap, NARROW, Projection, Trace, View, WIDE, error_after_minutes};
use super::scale::plain;
use super::scene::{BallMark, Scene, ScenePose, skeleton, wireframe};
use crate::plan::{Plan, PlanCheck, PlanHeader, PlanRow};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::result::MapPoint;
use dbbd_model::measurement::PoseKind;
use dbbd_model::provenance::Provenance;
use dbbd_model::robot::{AXES, Robot};

/// Poses at which the robot is drawn.
const SKELETONS: usize = 8;

#[derive(Serialize)]
struct Page<'a> {
    robot: &'a str,
    header: &'a PlanHeader,
    rows: usize,
    measure: usize,
    reference: usize,
    duration_min: f64,
    checks: Vec<CheckLine>,
    /// The picture of what more time would reach, for a plan with a goal.
    curve: Option<String>,
    figures: Figures,
    /// Data of the viewer.
    scene: String,
    identity: Vec<(String, String)>,
    provenance: &'a Provenance,
}

#[derive(Serialize)]
struct CheckLine {
    quantity: &'static str,
    worst: String,
    limit: String,
    at_least: bool,
    row: u32,
    passed: bool,
}

#[derive(Serialize)]
struct Figures {
    reading: Option<String>,
    views: Vec<String>,
    axes: Vec<String>,
    manipulability: Option<String>,
    maps: Vec<String>,
}

/// The page of a plan for `robot`; `map` is the predicted position uncertainty over the workspace.
pub fn html(plan: &Plan, robot: &Robot, map: &[MapPoint]) -> Result<String, Diagnostic> {
    let count = |kind: PoseKind| plan.rows.iter().filter(|row| row.kind == kind).count();
    let page = Page {
        robot: &robot.name,
        header: &plan.header,
        rows: plan.rows.len(),
        measure: count(PoseKind::Measure),
        reference: count(PoseKind::Reference),
        duration_min: plan.duration_s() / 60.0,
        checks: plan.header.checks.iter().map(check).collect(),
        curve: plan.header.goal.as_ref().map(error_after_minutes),
        figures: figures(plan, robot, map),
        scene: scene(plan, robot).json()?,
        identity: plan.header.provenance.identity.facts(),
        provenance: &plan.header.provenance,
    };
    render("plan.html", include_str!("plan.html"), &page)
}

fn check(check: &PlanCheck) -> CheckLine {
    let quantity = check.quantity;
    CheckLine {
        quantity: quantity.description(),
        worst: quantity.format(check.worst),
        limit: quantity.format(check.limit),
        at_least: quantity.at_least(),
        row: check.row,
        passed: check.holds(),
    }
}

fn figures(plan: &Plan, robot: &Robot, map: &[MapPoint]) -> Figures {
    let arm = plan.rows.iter().find(|row| row.kind == PoseKind::Measure);
    let arm = arm.map_or_else(Vec::new, |row| skeleton(robot, &row.axes_deg));
    let maps = HeatMap::of_uncertainty(map, &arm, &balls(plan));
    if plan.rows.is_empty() {
        return Figures { reading: None, views: Vec::new(), axes: Vec::new(), manipulability: None, maps };
    }
    let bar = &plan.header.job.bar;
    let reading = Trace {
        title: "Nominal reading along the path".into(),
        size: [WIDE, 290.0],
        y_name: "reading (mm)",
        rows: &plan.rows,
        value: &|row| row.length_mm - bar.length_mm,
        limits: bar.stroke_mm,
        margin: bar.margin_mm,
    };
    let manipulability = Trace {
        title: "Manipulability along the path".into(),
        size: [WIDE, 230.0],
        y_name: "|det J| (m³)",
        value: &|row| manipulability(robot, row),
        // At zero the arm is singular.
        limits: [0.0; 2],
        margin: 0.0,
        ..reading
    };
    Figures {
        manipulability: Some(manipulability.to_svg()),
        reading: Some(reading.to_svg()),
        views: views(plan, robot),
        axes: (0..AXES).map(|axis| axis_trace(plan, robot, axis)).collect(),
        maps,
    }
}

/// Each projection with the robot, and enlarged about the balls.
fn views(plan: &Plan, robot: &Robot) -> Vec<String> {
    let (balls, skeletons) = (balls(plan), skeletons(plan, robot));
    let edges = plan.header.job.obstacles.iter().flat_map(|obstacle| wireframe(obstacle, &balls));
    let obstacles: Vec<Vec<[f64; 3]>> = edges.collect();
    let cell = View {
        title: "robot and path",
        balls: &balls,
        rows: &plan.rows,
        skeletons: &skeletons,
        obstacles: &obstacles,
    };
    let around = View { title: "around the balls", skeletons: &[], ..cell };
    let draw = |projection| [cell.to_svg(projection), around.to_svg(projection)];
    Projection::ALL.into_iter().flat_map(draw).collect()
}

fn balls(plan: &Plan) -> Vec<BallMark> {
    plan.header.job.centres.iter().map(|centre| BallMark { id: centre.id, at: centre.xyz_mm }).collect()
}

fn scene(plan: &Plan, robot: &Robot) -> Scene {
    let measured = plan.rows.iter().filter(|row| row.kind == PoseKind::Measure);
    let poses =
        measured.map(|row| ScenePose::new(robot, row.index, row.centre.number(), &row.axes_deg, None));
    Scene::new(&balls(plan), poses.collect(), &plan.header.job.obstacles)
}

/// The robot as lines at a few of the poses.
fn skeletons(plan: &Plan, robot: &Robot) -> Vec<Vec<[f64; 3]>> {
    let measured: Vec<_> = plan.rows.iter().filter(|row| row.kind == PoseKind::Measure).collect();
    measured
        .iter()
        .step_by(measured.len().div_ceil(SKELETONS).max(1))
        .map(|row| skeleton(robot, &row.axes_deg))
        .collect()
}

fn axis_trace(plan: &Plan, robot: &Robot, axis: usize) -> String {
    let [low, high] = robot.limits_deg[axis];
    let title = format!("A{} (limits {}° to {}°)", axis + 1, plain(low, 2), plain(high, 2));
    Trace {
        title,
        size: [NARROW, 190.0],
        y_name: "deg",
        rows: &plan.rows,
        value: &|row| row.axes_deg[axis],
        limits: [low, high],
        margin: 0.0,
    }
    .to_svg()
}

/// Yoshikawa's measure at a row: the size of the determinant of the arm's Jacobian, m^3.
fn manipulability(robot: &Robot, row: &PlanRow) -> f64 {
    let columns = robot.geometry.axis_jacobian(&row.axes_deg.map(f64::to_radians));
    let jacobian = Matrix6::from_fn(|at, axis| {
        let (moved, turned) = &columns[axis];
        if at < 3 { moved[at] * 1e-3 } else { turned[at - 3] }
    });
    jacobian.determinant().abs()
}
