//! A cell to test in: pose sets on circles, and lengths on a robot with errors. The crates above and the suite include this file.

use dbbd_model::design::calibrate;
use dbbd_model::estimation::EstimationFinding;
use dbbd_model::estimation::{AngleSource, CompletedCalibration, Input, Options};
use dbbd_model::measurement::{BaseBall, Datum, LengthModel, Measurement, Measurements, TargetId};
use dbbd_model::robot::pose::{rot_x, rot_y, rot_z};
use dbbd_model::robot::{
    Approach, AxisAngles, BallId, BarId, Geometry, ParamId, PayloadId, Pose, Robot, inverse,
};
use nalgebra::{Matrix3, Vector3};

/// The paper's circle: centre and radius, mm.
pub(crate) const CENTRE: [f64; 3] = [1300.0, 0.0, 800.0];
pub(crate) const RADIUS: f64 = 300.0;

/// Table 2 of the paper: the designed errors of its 13 parameters (rad, mm).
pub(crate) const DESIGNED: [(&str, f64); 13] = [
    ("alpha1", -0.0049),
    ("alpha2", 0.0031),
    ("alpha3", 0.0011),
    ("alpha4", -0.0002),
    ("alpha5", -0.0023),
    ("a1", 0.1391),
    ("a2", 0.0331),
    ("a3", 0.0345),
    ("a4", 0.1703),
    ("a5", 0.0300),
    ("d4", -0.0968),
    ("d5", -0.0076),
    ("d6", -0.1091),
];

/// A robot of the catalogue, with the tool ball of the paper or, of another one, at the flange.
pub(crate) fn named(name: &str) -> Robot {
    let tool_mm = if name == "kr60ha" { [30.0, 20.0, 10.0] } else { [0.0; 3] };
    Robot::by_name_with_tool(name, tool_mm).unwrap().unwrap()
}

pub(crate) fn kr60() -> Robot {
    named("kr60ha")
}

/// The kr60ha with errors added by name.
pub(crate) fn with_errors<'a>(errors: impl IntoIterator<Item = (&'a str, f64)>) -> Robot {
    let mut robot = kr60();
    for (name, error) in errors {
        let id: ParamId = name.parse().unwrap();
        *robot.geometry.value_mut(id).unwrap() += error;
    }
    robot
}

/// A circle's plane as the rotation from XY, and its centre.
#[derive(Clone, Copy)]
pub(crate) struct Circle {
    pub(crate) plane: Matrix3<f64>,
    pub(crate) centre: [f64; 3],
    pub(crate) number: usize,
    pub(crate) radius: f64,
}

impl Circle {
    pub(crate) fn ball(&self) -> BallId {
        BallId::at(self.number - 1)
    }
}

pub(crate) fn horizontal(number: usize, centre: [f64; 3]) -> Circle {
    Circle { plane: Matrix3::identity(), centre, number, radius: RADIUS }
}

pub(crate) fn tilted(degrees: f64) -> Circle {
    Circle { plane: rot_x(degrees.to_radians()), ..horizontal(1, CENTRE) }
}

/// XY, XZ and YZ circles about one ball.
pub(crate) fn three_planes(number: usize, centre: [f64; 3]) -> [Circle; 3] {
    let quarter = std::f64::consts::FRAC_PI_2;
    [Matrix3::identity(), rot_x(quarter), rot_z(quarter) * rot_x(quarter)].map(|plane| Circle {
        plane,
        centre,
        number,
        radius: RADIUS,
    })
}

/// Axis angles (degrees) of `points` on a circle, the tool down, turned by the pattern of the
/// paper's experiment with this amplitude: R = Rz(A sin 2t) Ry(A sin 3t) Rx(A sin 5t) Rx(180 deg).
pub(crate) fn poses(robot: &Geometry, circle: &Circle, points: usize, amplitude_deg: f64) -> Vec<[f64; 6]> {
    let amplitude = amplitude_deg.to_radians();
    let mut near = [0.0, -60.0, 90.0, 0.0, 60.0, 0.0].map(f64::to_radians);
    (0..points)
        .map(|i| {
            let t = std::f64::consts::TAU * i as f64 / points as f64;
            let on_circle = circle.plane * Vector3::new(t.cos(), t.sin(), 0.0) * circle.radius;
            let ball = Pose {
                position: Vector3::from(circle.centre) + on_circle,
                rotation: rot_z(amplitude * (2.0 * t).sin())
                    * rot_y(amplitude * (3.0 * t).sin())
                    * rot_x(amplitude * (5.0 * t).sin())
                    * rot_x(std::f64::consts::PI),
            };
            near = inverse::nearest(robot, &ball, &near).unwrap();
            near.map(f64::to_degrees)
        })
        .collect()
}

/// Lengths that `truth` shows at poses planned on the nominal robot.
pub(crate) fn measure(truth: &Robot, circles: &[Circle], points: usize, amplitude_deg: f64) -> Measurements {
    let nominal = kr60();
    let mut rows = Vec::new();
    for circle in circles {
        for axes_deg in poses(&nominal.geometry, circle, points, amplitude_deg) {
            let mut row = Measurement {
                index: rows.len() as u32 + 1,
                datum: Datum::Ball(circle.ball(), BarId::FIRST),
                target: TargetId::FIRST,
                axes: AxisAngles::from_degrees(axes_deg),
                approach: Approach::default(),
                length_mm: 0.0,
                sigma_mm: None,
                payload: PayloadId::FIRST,
                context: None,
            };
            row.length_mm = truth.geometry.length(&row.axes.radians(), &Vector3::from(circle.centre), 0.0);
            rows.push(row);
        }
    }
    Measurements { rows, ..Measurements::default() }
}

/// The base balls of circles, as their file.
pub(crate) fn centres_csv(circles: &[Circle]) -> String {
    let mut centres: Vec<BaseBall> = circles
        .iter()
        .map(|circle| BaseBall { id: circle.ball(), position: Vector3::from(circle.centre) })
        .collect();
    centres.dedup_by_key(|centre| centre.id);
    BaseBall::to_csv(&centres)
}

/// A calibration on the robot's nominal geometry with these base balls.
pub(crate) fn calibrated(
    robot: &Robot,
    observations: &Measurements,
    balls: &[BaseBall],
    options: &Options,
) -> Result<CompletedCalibration, EstimationFinding> {
    let start = LengthModel::new(robot.geometry.clone(), balls);
    let axes = AngleSource::Given;
    calibrate(&Input { robot, observations, start: &start, validation: None, options, axes }, Vec::new())
}
