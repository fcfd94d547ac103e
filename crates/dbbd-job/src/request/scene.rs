//! The cell of a plan in three dimensions, for a viewer.

use std::path::Path;

use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::CalibrationResult;
use dbbd_model::estimation::result::ExcludedMeasurement;
use dbbd_model::measurement::{LengthModel, Measurement, Measurements, PoseKind, PreparedMeasurement};
use dbbd_model::robot::{
    AXES, BallId, BarId, Coordinate, Datum, Geometry, ParamId, PayloadId, Robot, TargetId,
};
use nalgebra::Vector3;
use serde::Serialize;

use super::identify::{LENGTHS, ROBOT};
use crate::files;
use crate::plan::Plan;
use crate::plan::job::ObstacleTable;
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
    /// The target on the tool, which is the tool ball by default.
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

/// The model of a result: its robot with the identified base balls, bars and targets.
fn identified_model(geometry: Geometry, result: &CalibrationResult) -> LengthModel {
    let value = |id: ParamId| result.parameter(id).map(|parameter| parameter.identified);
    let place = |[x, y, z]: [ParamId; 3]| Some(Vector3::new(value(x)?, value(y)?, value(z)?));
    let ball = |ball| place(Coordinate::ALL.map(|axis| ParamId::Ball(ball, axis)));
    let target = |target| place(Coordinate::ALL.map(|axis| ParamId::Target(target, axis)));
    LengthModel {
        geometry,
        balls: (0..).map_while(|at| ball(BallId::at(at))).collect(),
        bar_offsets: (0..).map_while(|at| value(ParamId::BarOffset(BarId::at(at)))).collect(),
        // The first target is the tool ball.
        targets: (1..).map_while(|at| target(TargetId::at(at))).collect(),
        // The scene shows lengths, no positions of a tracker.
        tracker: None,
    }
}

impl ResultAtPoses {
    fn read(directory: &Path, plan: &Plan) -> Result<Self, Diagnostic> {
        let [robot_file, lengths, result] = [ROBOT, LENGTHS, "result.json"].map(|name| directory.join(name));
        if !lengths.is_file() {
            return Ok(Self::default());
        }
        let robot = Robot::from_toml(&robot_file.display().to_string(), &files::read_text(&robot_file)?)?;
        let table = Measurements::from_csv(&lengths.display().to_string(), &files::read_text(&lengths)?)?;
        let table = table
            .carrying(&robot.geometry.load)
            .map_err(|finding| Diagnostic::file(lengths.display(), finding))?;
        let result =
            CalibrationResult::from_json(&result.display().to_string(), &files::read_text(&result)?)?;
        let model = identified_model(robot.geometry, &result);
        Ok(Self { excluded: result.excluded, ..Self::of(&model, &table.rows, plan) })
    }

    /// What the model predicts for measured rows and for the rows of a plan.
    fn of(model: &LengthModel, rows: &[Measurement], plan: &Plan) -> Self {
        let prepared = model.prepare();
        let residual = |row: &Measurement| {
            let Datum::Ball(ball, bar) = row.datum else { return None };
            let identified = prepared.row(&PreparedMeasurement::from(row));
            let distance_mm = identified.length - model.bar_offset(bar);
            let at = rounded(model.balls.get(ball.index())? + identified.unit() * distance_mm);
            let residual_mm = row.length_mm - identified.length;
            Some(SceneResidual { index: row.index, ball: ball.number(), at, residual_mm })
        };
        let job = &plan.header.job;
        let payloads = &model.geometry.load.payloads;
        let carried = payloads.iter().position(|payload| job.payload.as_ref() == Some(&payload.name));
        let payload = carried.map_or(PayloadId::FIRST, PayloadId::at);
        let force_n = job.bar.force_n.unwrap_or(0.0);
        let measured =
            plan.rows.iter().zip(plan.approaches()).filter(|(row, _)| row.kind != PoseKind::Transit);
        let expected = measured.map(|(row, approach)| {
            let axes = row.axes_deg.map(f64::to_radians);
            let planned = PreparedMeasurement::new(axes, row.centre, row.length_mm);
            let planned = PreparedMeasurement { approach, payload, force_n, ..planned };
            let deviation_mm = prepared.length(&planned) - row.length_mm;
            ExpectedDeviation { index: row.index, deviation_mm }
        });
        Self {
            residuals: rows.iter().filter_map(residual).collect(),
            // A length from a base ball that the result does not know is NaN.
            expected: expected.filter(|expected| expected.deviation_mm.is_finite()).collect(),
            excluded: Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use dbbd_model::measurement::MeasurementContext;
    use dbbd_model::robot::{Approach, AxisAngles, Joint, Payload};

    use super::*;
    use crate::test_support::cell::kr60;
    use crate::test_support::circle_plan;

    const AXES_DEG: [f64; AXES] = [10.0, -60.0, 90.0, 5.0, 57.0, 20.0];
    const FORCE_N: f64 = 100.0;

    /// A robot without links' masses whose third joint gives way, with an empty flange and a gripper of 50 kg; a base ball
    /// 300 mm below its tool ball, a bar that is 0.2 mm too long, and a second target.
    fn model() -> LengthModel {
        let mut geometry = kr60().geometry;
        geometry.load.masses.clear();
        let payload = |name: &str, kg| Payload { name: name.into(), kg, ..Payload::default() };
        geometry.load.payloads = vec![payload("", 0.0), payload("gripper", 50.0)];
        geometry.compliance = [0.0; AXES];
        geometry.compliance[Joint::J3.index()] = 1e-6;
        let ball = geometry.ball(&axes()).position - Vector3::new(0.0, 0.0, 300.0);
        let target = Vector3::new(-80.0, 30.0, 150.0);
        LengthModel {
            geometry,
            balls: vec![ball],
            bar_offsets: vec![0.2],
            targets: vec![target],
            tracker: None,
        }
    }

    fn axes() -> [f64; AXES] {
        AXES_DEG.map(f64::to_radians)
    }

    fn row(length_mm: f64) -> Measurement {
        Measurement {
            index: 7,
            datum: Datum::Ball(BallId::FIRST, BarId::FIRST),
            target: TargetId::FIRST,
            axes: AxisAngles::from_degrees(AXES_DEG),
            approach: Approach::default(),
            length_mm,
            sigma_mm: None,
            payload: PayloadId::FIRST,
            context: None,
        }
    }

    /// The residual of an exact row, and the distance of the place where it is drawn from the place of the target.
    fn residual(row: Measurement, target: Vector3<f64>) -> [f64; 2] {
        let plan = circle_plan::plan(1, 3);
        let found = ResultAtPoses::of(&model(), &[row], &plan).residuals;
        assert_eq!((found.len(), found[0].index, found[0].ball), (1, 7, 1));
        [found[0].residual_mm.abs(), (Vector3::from(found[0].at) - target).norm()]
    }

    /// The tool ball under 50 kg, another target, and a pull that turns joint 3 by its compliance times the torque.
    #[test]
    fn residual_of_an_exact_length_is_zero_whatever_it_was_measured_with() {
        let model = model();
        let ball = model.balls[0];
        let plain = model.geometry.ball(&axes()).position;
        let length = |place: Vector3<f64>| (place - ball).norm() + 0.2;
        let mut loaded = model.geometry.clone();
        loaded.load.payloads.swap(0, 1);
        let sagged = loaded.ball(&axes()).position;
        let flange = model.geometry.flange(&axes());
        let target = flange.position + flange.rotation * model.targets[0];
        let (shift, _) = model.geometry.axis_jacobian(&axes())[Joint::J3.index()];
        let torque_nm = 1e-3 * shift.dot(&((ball - plain).normalize() * FORCE_N));
        let pulled = plain + shift * (1e-6 * torque_nm);
        let context = MeasurementContext { force_n: Some(FORCE_N), ..MeasurementContext::default() };
        for (place, measured, min_mm) in [
            (plain, row(length(plain)), 0.0),
            (sagged, Measurement { payload: PayloadId::at(1), ..row(length(sagged)) }, 0.1),
            (target, Measurement { target: TargetId::at(1), ..row(length(target)) }, 1.0),
            (pulled, Measurement { context: Some(Arc::new(context)), ..row(length(pulled)) }, 0.01),
        ] {
            // The rigid distance of the tool ball is another length.
            assert!((measured.length_mm - length(plain)).abs() >= min_mm, "{measured:?}");
            let [residual_mm, beside_mm] = residual(measured, place);
            assert!(residual_mm < 1e-4 && beside_mm < 0.3, "{residual_mm} {beside_mm}");
        }
    }

    /// The plan is exact for a robot that carries nothing and a bar that does not pull.
    #[test]
    fn expected_length_has_the_pull_of_the_bar_and_the_payload_of_the_job() {
        let ball = Vector3::from(circle_plan::BALL_MM);
        let model = LengthModel { balls: vec![ball], bar_offsets: vec![], ..model() };
        let deviations = |change: fn(&mut Plan)| -> Vec<f64> {
            let mut plan = circle_plan::plan(1, 4);
            change(&mut plan);
            let expected = ResultAtPoses::of(&model, &[], &plan).expected;
            expected.iter().map(|expected| expected.deviation_mm).collect()
        };
        let plain = deviations(|_| {});
        assert_eq!(plain.len(), 5);
        assert!(plain.iter().all(|mm| mm.abs() < 0.002), "{plain:?}");
        let pulled = deviations(|plan| plan.header.job.bar.force_n = Some(FORCE_N));
        assert!(pulled.iter().all(|mm| *mm < 0.001) && pulled.iter().any(|mm| *mm < -0.002), "{pulled:?}");
        let loaded = deviations(|plan| plan.header.job.payload = Some("gripper".into()));
        assert!(loaded.iter().any(|mm| mm.abs() > 0.02), "{loaded:?}");
        // A base ball that the result does not know.
        assert_eq!(deviations(|plan| plan.rows[7].centre = BallId::at(1)).len(), 4);
    }
}
