//! Candidates of further measurements, each with poses that the robot reaches within its axis limits.

use nalgebra::{Matrix3, Vector3};

use super::Trial;
use crate::estimation::result::{CirclePlane, FurtherMeasurement};
use crate::measurement::PreparedMeasurement;
use crate::robot::pose::{rot_x, rot_y, rot_z};
use crate::robot::{AXES, BallId, Geometry, Pose, Robot, inverse};

/// A length with a larger residual belongs to another ball or bar, mm.
const FOREIGN_MM: f64 = 50.0;
/// Poses of a candidate.
const POSES: usize = 20;
/// Poses tried on each circle.
const PLACES: usize = 30;
/// Rotation of the wrist along a circle, and in the candidate with more rotation, degrees.
const TURN_DEG: f64 = 25.0;
const MORE_DEG: f64 = 45.0;
/// Tilt of an inclined circle, degrees.
const TILT_DEG: f64 = 30.0;
/// Places of a further ball relative to the first: distance from axis 1 and height, mm; rotation about axis 1, degrees.
const OUTWARD_MM: [f64; 2] = [-400.0, 300.0];
const UPWARD_MM: [f64; 2] = [-500.0, 500.0];
const ASIDE_DEG: [f64; 2] = [-35.0, 35.0];
/// Least height of a ball, and rounding of its place, mm.
const LOWEST_MM: f64 = 100.0;
const ROUND_MM: f64 = 50.0;
/// Rotations about axis 1 of the same ball and poses, degrees.
const ABOUT_AXIS_1_DEG: [f64; 4] = [60.0, -60.0, 30.0, -30.0];
/// Other lengths of the bar relative to the first.
const BARS: [f64; 2] = [0.6, 1.6];

pub(super) struct Candidate {
    pub(super) measure: FurtherMeasurement,
    /// A further ball, mm.
    pub(super) ball: Option<Vector3<f64>>,
    pub(super) poses: Vec<PreparedMeasurement>,
}

/// All candidates that the robot reaches.
pub(super) fn all(trial: &Trial<'_>) -> Vec<Candidate> {
    let mut all = Vec::new();
    let Some(cell) = Cell::of(trial) else { return all };
    let further = BallId::at(trial.model.balls.len());
    let mut add = |measure, ball, poses: Option<Vec<PreparedMeasurement>>| {
        all.extend(poses.map(|poses| Candidate { measure, ball, poses }));
    };
    for plane in PLANES {
        let poses = cell.about(cell.ball, cell.home, cell.radius, &[rotation(plane)]);
        add(FurtherMeasurement::Circle { planes: vec![plane] }, None, poses);
    }
    let [xy, xz, yz, ..] = PLANES;
    let upright = [xy, xz, yz].map(rotation);
    let three = FurtherMeasurement::Circle { planes: vec![xy, xz, yz] };
    add(three, None, cell.about(cell.ball, cell.home, cell.radius, &upright));
    add(FurtherMeasurement::Wrist { degrees: MORE_DEG }, None, cell.wrist());
    for place in cell.places() {
        let poses = cell.about(place, further, cell.radius, &upright);
        add(FurtherMeasurement::Ball { ball_mm: place.into() }, Some(place), poses);
    }
    if let Some((ball, poses)) = cell.turned(further) {
        add(FurtherMeasurement::TurnedBall { ball_mm: ball.into() }, Some(ball), Some(poses));
    }
    for share in BARS {
        let length_mm = (cell.radius * share / ROUND_MM).round().max(1.0) * ROUND_MM;
        let poses = cell.about(cell.ball, cell.home, length_mm, &upright);
        add(FurtherMeasurement::Bar { length_mm }, None, poses);
    }
    all
}

const PLANES: [CirclePlane; 5] = [
    CirclePlane::Xy,
    CirclePlane::Xz,
    CirclePlane::Yz,
    CirclePlane::TiltedAboutX(TILT_DEG),
    CirclePlane::TiltedAboutY(TILT_DEG),
];

/// The rotation from XY to the plane.
fn rotation(plane: CirclePlane) -> Matrix3<f64> {
    let quarter = std::f64::consts::FRAC_PI_2;
    match plane {
        CirclePlane::Xy => Matrix3::identity(),
        CirclePlane::Xz => rot_x(quarter),
        CirclePlane::Yz => rot_z(quarter) * rot_x(quarter),
        CirclePlane::TiltedAboutX(degrees) => rot_x(degrees.to_radians()),
        CirclePlane::TiltedAboutY(degrees) => rot_y(degrees.to_radians()),
    }
}

/// The cell with the ball to which most lengths were measured.
struct Cell<'a> {
    /// The geometry by which the controller moves, with the fitted tool.
    geometry: Geometry,
    controller: &'a Robot,
    /// The ball's place and the median length to it, mm.
    ball: Vector3<f64>,
    home: BallId,
    radius: f64,
    /// Some of the poses measured to it.
    measured: Vec<PreparedMeasurement>,
}

impl<'a> Cell<'a> {
    /// `None` without a length to a ball.
    fn of(trial: &Trial<'a>) -> Option<Self> {
        let prepared = trial.model.prepare();
        let is_near = |reading: &&PreparedMeasurement| prepared.residual(reading).abs() < FOREIGN_MM;
        let of_ball = |ball: BallId| {
            trial.readings.iter().filter(is_near).filter(move |reading| reading.datum.ball() == Some(ball))
        };
        let home = (0..trial.model.balls.len()).map(BallId::at).max_by_key(|ball| of_ball(*ball).count())?;
        let mut lengths: Vec<f64> = of_ball(home).map(|reading| reading.length_mm).collect();
        lengths.sort_by(f64::total_cmp);
        let controller = trial.robot.controller();
        Some(Self {
            geometry: Geometry { tool: trial.model.geometry.tool, ..controller.geometry.clone() },
            controller,
            ball: *trial.model.balls.get(home.index())?,
            home,
            radius: *lengths.get(lengths.len() / 2)?,
            measured: evenly(&of_ball(home).copied().collect::<Vec<_>>(), POSES),
        })
    }

    /// Poses on circles about a ball with a rotating wrist, in the orientation of a measured pose or else with the tool
    /// pointing down; `None` if too few are reached.
    fn about(
        &self,
        ball: Vector3<f64>,
        number: BallId,
        radius: f64,
        planes: &[Matrix3<f64>],
    ) -> Option<Vec<PreparedMeasurement>> {
        let near = self.measured.first()?;
        let down = rot_x(std::f64::consts::PI);
        let facing = rot_z(ball.y.atan2(ball.x) - self.ball.y.atan2(self.ball.x));
        [facing * self.geometry.flange(&near.axes).rotation, facing * down].into_iter().find_map(|held| {
            let mut reached = Vec::new();
            for plane in planes {
                let mut last = near.axes;
                for place in 0..PLACES {
                    let t = std::f64::consts::TAU * place as f64 / PLACES as f64;
                    let position = ball + plane * Vector3::new(t.cos(), t.sin(), 0.0) * radius;
                    let pose = Pose { position, rotation: turn(t, TURN_DEG) * held };
                    if let Some(axes) = self.reach(&pose, &last) {
                        reached.push(PreparedMeasurement::new(axes, number, radius));
                        last = axes;
                    }
                }
            }
            (reached.len() >= POSES).then(|| evenly(&reached, POSES))
        })
    }

    /// The measured positions with more rotation of the wrist.
    fn wrist(&self) -> Option<Vec<PreparedMeasurement>> {
        let count = self.measured.len() as f64;
        let turned = |(at, reading): (usize, &PreparedMeasurement)| {
            let ball = self.geometry.ball(&reading.axes);
            let t = std::f64::consts::TAU * at as f64 / count;
            // If a rotation is out of reach, the opposite or a smaller one may not be.
            let axes = [1.0, -1.0, 0.5, -0.5].into_iter().find_map(|share| {
                let rotation = turn(t + 0.3, share * MORE_DEG) * ball.rotation;
                self.reach(&Pose { rotation, ..ball }, &reading.axes)
            })?;
            Some(PreparedMeasurement::new(axes, self.home, reading.length_mm))
        };
        let poses: Vec<PreparedMeasurement> = self.measured.iter().enumerate().filter_map(turned).collect();
        (poses.len() >= POSES / 2).then_some(poses)
    }

    /// Places for a further ball.
    fn places(&self) -> Vec<Vector3<f64>> {
        let (distance, angle) = (self.ball.x.hypot(self.ball.y), self.ball.y.atan2(self.ball.x));
        let mut places = Vec::new();
        for outward in OUTWARD_MM {
            for upward in UPWARD_MM {
                for aside in ASIDE_DEG {
                    let (s, c) = (angle + aside.to_radians()).sin_cos();
                    let (radius, height) = (distance + outward, self.ball.z + upward);
                    let place = Vector3::new(radius * c, radius * s, height);
                    if radius > 0.0 && height >= LOWEST_MM {
                        places.push((place / ROUND_MM).map(f64::round) * ROUND_MM);
                    }
                }
            }
        }
        places
    }

    /// The measured poses and their ball (now `number`), rotated about axis 1 as far as its limits allow.
    fn turned(&self, number: BallId) -> Option<(Vector3<f64>, Vec<PreparedMeasurement>)> {
        let [low, high] = self.controller.limits_deg[0];
        let sense = self.geometry.rows.first()?.sign;
        ABOUT_AXIS_1_DEG.into_iter().find_map(|degrees| {
            let turned = |reading: &PreparedMeasurement| {
                let mut axes = reading.axes;
                axes[0] += degrees.to_radians();
                let is_within = (low..=high).contains(&axes[0].to_degrees());
                is_within.then(|| PreparedMeasurement::new(axes, number, reading.length_mm))
            };
            let poses = self.measured.iter().map(turned).collect::<Option<Vec<_>>>()?;
            Some((rot_z(sense * degrees.to_radians()) * self.ball, poses))
        })
    }

    fn reach(&self, pose: &Pose, near: &[f64; AXES]) -> Option<[f64; AXES]> {
        inverse::nearest(&self.geometry, pose, near)
            .ok()
            .filter(|axes| self.controller.is_within_limits(axes))
    }
}

/// The rotation of the wrist at the circle angle `t`, with a frequency of its own about each axis.
fn turn(t: f64, amplitude_deg: f64) -> Matrix3<f64> {
    let amplitude = amplitude_deg.to_radians();
    rot_z(amplitude * (2.0 * t).sin())
        * rot_y(amplitude * (3.0 * t).sin())
        * rot_x(amplitude * (5.0 * t).sin())
}

/// Selects at most `count` of the readings, evenly spaced.
fn evenly(readings: &[PreparedMeasurement], count: usize) -> Vec<PreparedMeasurement> {
    let take = count.min(readings.len());
    (0..take).filter_map(|at| readings.get(at * readings.len() / take).copied()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// On a circle of 300 mm the tool ball keeps the radius, and the wrist turns. More rotation of the wrist keeps the places
    /// of the tool ball, and turns the flange there by more than the circle did.
    #[test]
    fn wrist_turns_at_the_measured_places() {
        let robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        let (ball, home) = (Vector3::new(1300.0, 0.0, 800.0), BallId::FIRST);
        let start =
            PreparedMeasurement::new([0.0, -90.0, 90.0, 0.0, 60.0, 0.0].map(f64::to_radians), home, 300.0);
        let geometry = robot.geometry.clone();
        let cell = Cell { geometry, controller: &robot, ball, home, radius: 300.0, measured: vec![start] };
        let measured = cell.about(ball, home, 300.0, &[rotation(CirclePlane::Xy)]).unwrap();
        assert_eq!(measured.len(), POSES);
        let cell = Cell { measured, ..cell };
        let turned = cell.wrist().unwrap();
        assert_eq!(turned.len(), POSES);
        let mut largest: f64 = 0.0;
        for (before, after) in cell.measured.iter().zip(&turned) {
            let [before, after] = [before, after].map(|reading| cell.geometry.ball(&reading.axes));
            let off = before.position - ball;
            assert!((off.norm() - 300.0).abs() < 1e-6 && off.z.abs() < 1e-6, "{off}");
            assert!((after.position - before.position).norm() < 1e-6);
            let by: Matrix3<f64> = after.rotation * before.rotation.transpose();
            largest = largest.max((0.5 * (by.trace() - 1.0)).clamp(-1.0, 1.0).acos().to_degrees());
        }
        // Three rotations of at most 45 degrees.
        assert!((MORE_DEG..=78.0).contains(&largest), "{largest}");
    }
}
