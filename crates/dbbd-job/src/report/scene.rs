//! The cell in three dimensions for the views and the viewer: arm, base balls, poses with their residuals, obstacles.

use serde::Serialize;

use crate::plan::job::ObstacleTable;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::{AXES, Robot};

use super::page::script_json;

/// Most poses in the viewer; more are sampled evenly.
const MOST_POSES: usize = 400;
/// Sides of the polygon that is drawn for a circle.
const SIDES: usize = 24;

/// The data of the viewer; robot base, mm, rounded.
#[derive(Serialize)]
pub(super) struct Scene {
    balls: Vec<BallMark>,
    poses: Vec<ScenePose>,
    obstacles: Vec<Vec<[f64; 3]>>,
    /// Size of a residual at which its colour is full, mm.
    largest: f64,
}

/// A base ball in the robot base, mm.
#[derive(Clone, Copy, Serialize)]
pub(crate) struct BallMark {
    pub(crate) id: u32,
    pub(crate) at: [f64; 3],
}

impl BallMark {
    pub(crate) fn name(&self) -> String {
        format!("ball {}", self.id)
    }
}

#[derive(Serialize)]
pub(super) struct ScenePose {
    ball: u32,
    at: [f64; 3],
    arm: Vec<[f64; 3]>,
    /// Residual, mm.
    value: Option<f64>,
    text: String,
}

impl Scene {
    pub(super) fn new(balls: &[BallMark], poses: Vec<ScenePose>, obstacles: &[ObstacleTable]) -> Self {
        let stride = poses.len().div_ceil(MOST_POSES).max(1);
        let largest = poses.iter().filter_map(|pose| pose.value).map(f64::abs).fold(0.0, f64::max);
        Self {
            obstacles: obstacles.iter().flat_map(|one| wireframe(one, balls)).map(rounded).collect(),
            balls: balls.iter().map(|ball| BallMark { at: ball.at.map(f64::round), ..*ball }).collect(),
            poses: poses.into_iter().step_by(stride).collect(),
            largest: if largest > 0.0 { largest } else { 1.0 },
        }
    }

    /// The scene as JSON within a script element.
    pub(super) fn json(&self) -> Result<String, Diagnostic> {
        script_json(self)
    }
}

impl ScenePose {
    /// An arm at axis angles in degrees, with the residual of the length in mm.
    pub(super) fn new(
        robot: &Robot,
        index: u32,
        ball: u32,
        axes_deg: &[f64; AXES],
        residual_mm: Option<f64>,
    ) -> Self {
        let arm = rounded(skeleton(robot, axes_deg));
        let value = residual_mm.filter(|mm| mm.is_finite());
        let residual = value.map_or_else(String::new, |mm| format!(": {:+.1} µm", 1e3 * mm));
        let text = format!("pose {index}, ball {ball}{residual}");
        Self { ball, at: arm.last().copied().unwrap_or_default(), arm, value, text }
    }
}

fn rounded(line: Vec<[f64; 3]>) -> Vec<[f64; 3]> {
    line.into_iter().map(|point| point.map(f64::round)).collect()
}

/// The arm at a pose: base, joints, tool ball.
pub(super) fn skeleton(robot: &Robot, axes_deg: &[f64; AXES]) -> Vec<[f64; 3]> {
    let axes = axes_deg.map(f64::to_radians);
    let joints = robot.geometry.skeleton(&axes);
    let ball = robot.geometry.ball(&axes).position;
    let joints = joints.iter().map(|joint| <[f64; 3]>::from(*joint));
    std::iter::once([0.0; 3]).chain(joints).chain([ball.into()]).collect()
}

/// The edges of an obstacle; a floor is drawn below the balls.
pub(super) fn wireframe(obstacle: &ObstacleTable, balls: &[BallMark]) -> Vec<Vec<[f64; 3]>> {
    match *obstacle {
        ObstacleTable::Box { low_mm: [x0, y0, z0], high_mm: [x1, y1, z1] } => {
            let ring = |z| vec![[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z], [x0, y0, z]];
            let posts = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]].map(|[x, y]| vec![[x, y, z0], [x, y, z1]]);
            [ring(z0), ring(z1)].into_iter().chain(posts).collect()
        }
        ObstacleTable::Cylinder { from_mm, to_mm, radius_mm } => cylinder(from_mm, to_mm, radius_mm),
        ObstacleTable::Floor { z_mm } => {
            let coordinates = balls.iter().flat_map(|ball| ball.at);
            let most = coordinates.fold(500.0, |most: f64, value| most.max(1.5 * value.abs()));
            let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]];
            vec![corners.map(|[x, y]| [x * most, y * most, z_mm]).to_vec()]
        }
    }
}

fn cylinder(from_mm: [f64; 3], to_mm: [f64; 3], radius_mm: f64) -> Vec<Vec<[f64; 3]>> {
    let [from, to] = [from_mm, to_mm].map(nalgebra::Vector3::from);
    let Some(axis) = (to - from).try_normalize(1e-9) else { return Vec::new() };
    // The coordinate axis that is least parallel gives a direction across.
    let least = axis.iamin();
    let across = axis.cross(&nalgebra::Vector3::ith(least, 1.0)).normalize();
    let other = axis.cross(&across);
    let rim = |end: nalgebra::Vector3<f64>, side: usize| -> [f64; 3] {
        let (sin, cos) = (std::f64::consts::TAU * side as f64 / SIDES as f64).sin_cos();
        (end + radius_mm * (cos * across + sin * other)).into()
    };
    let ring = |end| (0..=SIDES).map(|side| rim(end, side)).collect();
    let posts = (0..4).map(|quarter| vec![rim(from, quarter * SIDES / 4), rim(to, quarter * SIDES / 4)]);
    [ring(from), ring(to)].into_iter().chain(posts).collect()
}
