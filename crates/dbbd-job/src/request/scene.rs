//! The cell of a plan in three dimensions, for a viewer.

use std::path::Path;

use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::result::ExcludedMeasurement;
use dbbd_model::estimation::{CalibrationResult, Positions};
use dbbd_model::measurement::{ApproachedPose, Measurement, Measurements, PoseKind};
use dbbd_model::robot::{AXES, Approach, AxisAngles, BallId, BarId, Coordinate, Datum, ParamId, Robot};
use nalgebra::Vector3;
use serde::Serialize;

use super::identify::{LENGTHS, ROBOT};
use crate::files;
use crate::plan::job::ObstacleTable;
use crate::plan::{Plan, PlanRow};
use crate::recording::run::read_plan;

/// A longer move of an axis is drawn with positions in between, degrees.
const STEP_DEG: f64 = 4.0;
/// Most positions in between; a move of a whole turn has fewer.
const MAX_STEPS: usize = 90;

/// The cell of a plan; robot base, mm.
#[derive(Debug, Serialize)]
pub struct CellScene {
    pub robot: String,
    pub arm_radius_mm: f64,
    pub tool_radius_mm: f64,
    pub bar_length_mm: f64,
    pub bar_radius_mm: f64,
    pub limits_deg: [[f64; 2]; AXES],
    pub balls: Vec<[f64; 3]>,
    pub obstacles: Vec<ObstacleTable>,
    /// The path: the rows of the plan, with positions in between.
    pub path: Vec<ScenePosition>,
    pub residuals: Vec<SceneResidual>,
    /// Deviations that the identified robot shows at the measured rows of the plan.
    pub expected: Vec<ExpectedDeviation>,
    /// Measurements that the result left out on request.
    pub excluded: Vec<ExcludedMeasurement>,
}

/// The arm at one time of the program.
#[derive(Debug, Serialize)]
pub struct ScenePosition {
    /// Time since the start of the program at full override, s.
    pub t_s: f64,
    /// Row of the plan; `None` in between.
    pub index: Option<u32>,
    pub kind: Option<PoseKind>,
    /// The base ball.
    pub ball: u32,
    pub axes_deg: [f64; AXES],
    /// Base, joints and tool ball, mm.
    pub arm: Vec<[f64; 3]>,
}

/// Measured minus identified length.
#[derive(Debug, PartialEq, Serialize)]
pub struct SceneResidual {
    /// Row of the plan.
    pub index: u32,
    pub ball: u32,
    pub at: [f64; 3],
    pub residual_mm: f64,
}

/// The length that is expected of the identified robot at a pose, minus the planned length.
#[derive(Debug, PartialEq, Serialize)]
pub struct ExpectedDeviation {
    /// Row of the plan.
    pub index: u32,
    pub deviation_mm: f64,
}

/// The data of a result about the poses of a plan.
#[derive(Default)]
struct ResultAtPoses {
    residuals: Vec<SceneResidual>,
    expected: Vec<ExpectedDeviation>,
    excluded: Vec<ExcludedMeasurement>,
}

impl CellScene {
    /// The cell of the plan whose rows are in `csv`, with the residuals of the result in the directory `result`.
    pub fn read(csv: &Path, result: Option<&Path>) -> Result<Self, Diagnostic> {
        let plan = read_plan(csv)?;
        let robot = Robot::from_toml("the plan's robot", &plan.header.robot)?;
        let of_result =
            result.map_or(Ok(ResultAtPoses::default()), |result| ResultAtPoses::read(result, &plan))?;
        let ResultAtPoses { residuals, expected, excluded } = of_result;
        let job = &plan.header.job;
        Ok(Self {
            robot: robot.name.clone(),
            arm_radius_mm: job.tool.arm_radius_mm,
            tool_radius_mm: job.tool.radius_mm,
            bar_length_mm: job.bar.length_mm,
            bar_radius_mm: job.bar.radius_mm,
            limits_deg: robot.limits_deg,
            balls: job.balls().iter().map(|ball| ball.position.into()).collect(),
            obstacles: job.obstacles.clone(),
            path: path(&plan, robot.controller()),
            residuals,
            expected,
            excluded,
        })
    }
}

fn rounded(point: Vector3<f64>) -> [f64; 3] {
    // A tenth of a millimetre is finer than a pixel.
    point.map(|mm| (10.0 * mm).round() / 10.0).into()
}

/// Base, joints, tool ball at axis angles in degrees.
fn arm(robot: &Robot, axes_deg: &[f64; AXES]) -> Vec<[f64; 3]> {
    let axes = axes_deg.map(f64::to_radians);
    let joints = robot.geometry.skeleton(&axes);
    let ball = robot.geometry.ball(&axes).position;
    [Vector3::zeros()].into_iter().chain(joints).chain([ball]).map(rounded).collect()
}

fn path(plan: &Plan, robot: &Robot) -> Vec<ScenePosition> {
    let mut path: Vec<ScenePosition> = Vec::new();
    let mut t_s = 0.0;
    for (row, time) in plan.rows.iter().zip(&plan.header.moves) {
        // The arc is drawn by its end.
        if row.is_auxiliary() {
            continue;
        }
        let ball = row.centre.number();
        if let Some(before) = path.last() {
            let from = before.axes_deg;
            let turn = from.iter().zip(&row.axes_deg).map(|(a, b)| (b - a).abs()).fold(0.0, f64::max);
            let steps = ((turn / STEP_DEG).ceil() as usize).clamp(1, MAX_STEPS);
            for step in 1..steps {
                let share = step as f64 / steps as f64;
                let axes_deg = std::array::from_fn(|i| from[i] + share * (row.axes_deg[i] - from[i]));
                let (index, kind) = (None, None);
                let t_s = t_s + share * time.duration_s;
                path.push(ScenePosition { t_s, index, kind, ball, axes_deg, arm: arm(robot, &axes_deg) });
            }
        }
        t_s += time.duration_s;
        let (index, kind, axes_deg) = (Some(row.index), Some(row.kind), row.axes_deg);
        path.push(ScenePosition { t_s, index, kind, ball, axes_deg, arm: arm(robot, &axes_deg) });
        t_s += row.dwell_s;
    }
    path
}

impl ResultAtPoses {
    fn read(directory: &Path, plan: &Plan) -> Result<Self, Diagnostic> {
        let [robot_file, lengths, result] = [ROBOT, LENGTHS, "result.json"].map(|name| directory.join(name));
        if !lengths.is_file() {
            return Ok(Self::default());
        }
        let robot = Robot::from_toml(&robot_file.display().to_string(), &files::read_text(&robot_file)?)?;
        let table = Measurements::from_csv(&lengths.display().to_string(), &files::read_text(&lengths)?)?;
        let result =
            CalibrationResult::from_json(&result.display().to_string(), &files::read_text(&result)?)?;
        let value = |id: ParamId| result.parameter(id).map_or(0.0, |parameter| parameter.identified);
        let length = |place: &Vector3<f64>, ball: BallId, bar: BarId| {
            let centre = Vector3::from(Coordinate::ALL.map(|axis| value(ParamId::Ball(ball, axis))));
            (place - centre).norm() + value(ParamId::BarOffset(bar))
        };
        let places = |poses: &[ApproachedPose]| Positions::of(&robot, poses).balls;
        let poses: Vec<ApproachedPose> =
            table.rows.iter().map(|row| ApproachedPose { axes: row.axes, approach: row.approach }).collect();
        let of_row = |(row, place): (&Measurement, &Vector3<f64>)| {
            let Datum::Ball(ball, bar) = row.datum else { return None };
            let residual_mm = row.length_mm - length(place, ball, bar);
            Some(SceneResidual { index: row.index, ball: ball.number(), at: rounded(*place), residual_mm })
        };
        let residuals = table.rows.iter().zip(&places(&poses)).filter_map(of_row).collect();
        let approaches = Approach::along(plan.rows.iter().map(|row| row.axes_deg.map(f64::to_radians)));
        let measured = plan.rows.iter().zip(approaches).filter(|(row, _)| row.kind != PoseKind::Transit);
        let pose = |(row, approach): (_, Approach)| {
            let row: &PlanRow = row;
            (row, ApproachedPose { axes: AxisAngles::from_degrees(row.axes_deg), approach })
        };
        let (rows, poses): (Vec<&PlanRow>, Vec<ApproachedPose>) = measured.map(pose).unzip();
        let expected = |(row, place): (&&PlanRow, &Vector3<f64>)| ExpectedDeviation {
            index: row.index,
            deviation_mm: length(place, row.centre, BarId::FIRST) - row.length_mm,
        };
        let expected = rows.iter().zip(&places(&poses)).map(expected).collect();
        Ok(Self { residuals, expected, excluded: result.excluded })
    }
}
