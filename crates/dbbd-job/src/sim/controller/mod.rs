//! A controller that executes a program in virtual time; the program is its only source of motion.
//!
//! It knows only the NOMINAL robot: like a real controller it converts Cartesian positions to axis angles by the
//! nominal inverse kinematics. KRL is interpreted (`krl`). For other languages the list of actions is executed
//! (`listed`), with the stopping behaviour of their controllers. The common parts are here: the arm and its motions.
//! Its fields are private to the files below it.

mod krl;
mod listed;
mod selected;

pub use selected::SimulatedController;

use std::fmt::Debug;

use nalgebra::{Rotation3, Unit, UnitVector3, Vector3};

use super::ControllerMoment;
use crate::program::Language;
use crate::program::ProgramFinding;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::inverse::{self, Unsolved};
use dbbd_model::robot::pose::rotation_vector;
use dbbd_model::robot::{AXES, Geometry, Pose, Robot};

/// Executes a program. The default implementations are those of a controller without `.dat` files and EthernetKRL.
pub trait ProgramExecutor: Debug + Send {
    /// Continues for `dt_s` seconds of device time.
    fn step(&mut self, dt_s: f64) -> Result<ControllerMoment, Diagnostic>;

    fn moment(&self) -> ControllerMoment;

    /// Presses START: a program that waits for the operator continues.
    fn go_on(&mut self);

    /// File and line (from 1) of the statement that was begun last.
    fn position(&self) -> (&str, usize);

    /// Number of dwells so far: the number of times that the strobe went high and low again. In a program without a
    /// strobe, the number of times that the measured axes were logged, or that the robot settled and waited.
    fn dwells(&self) -> u32;

    /// Switches to absolute-accuracy mode: the robot of the controller is the calibrated one, and in KRL `$ABS_ACCUR` is TRUE.
    fn set_absolute_accuracy(&mut self) {}

    /// Name and text of each `.dat` file with the values that the program assigned: scalars in their declarations,
    /// elements of arrays in lines before `ENDDAT`.
    fn saved(&self) -> Vec<(String, String)> {
        Vec::new()
    }

    /// Connects EthernetKRL: telegrams are carried to a server. Without a connection a program cannot open a channel.
    fn link_ekrl(&mut self) {}

    /// Whether the program holds the channel open.
    fn ekrl_open(&self) -> bool {
        false
    }

    /// The next telegram to send.
    fn telegram(&mut self) -> Option<String> {
        None
    }

    /// Receives the `Id` of an answer.
    fn answer(&mut self, _id: i64) {}
}

/// The arm of a simulated controller: the nominal robot, its commanded position and its limits.
#[derive(Clone, Debug)]
struct SimulatedArm {
    /// The robot as the controller knows it.
    robot: Robot,
    /// Commanded axis angles, rad.
    axes: [f64; AXES],
    /// Number of motions that have begun.
    motions: u32,
}

fn unsolved(why: Unsolved) -> ProgramFinding {
    ProgramFinding::NoAxisAngles { why: why.to_string() }
}

impl SimulatedArm {
    /// An arm at the home position for a language, or as near to it as the limits of the robot allow.
    fn at_home(robot: &Robot, language: Language) -> Self {
        let mut home = language.home_deg();
        for i in 0..AXES {
            let [low, high] = robot.limits_at_deg(&home)[i];
            home[i] = home[i].clamp(low, high);
        }
        Self { robot: robot.clone(), axes: home.map(f64::to_radians), motions: 0 }
    }

    fn begin(&mut self, path: CommandedPath, profile: SpeedProfile) -> CommandedMotion {
        self.motions = self.motions.saturating_add(1);
        CommandedMotion { path, profile, t_s: 0.0 }
    }

    /// The axis angles for a pose, near the commanded ones; `geometry` has the tool of the program.
    fn nearest(&self, geometry: &Geometry, pose: &Pose) -> Result<[f64; AXES], ProgramFinding> {
        inverse::nearest(geometry, pose, &self.axes).map_err(unsolved)
    }

    /// Continues a motion for at most `left_s`, at the share `rate` of its speed. Returns the time that it took if it
    /// ended.
    fn advance(
        &mut self,
        motion: &mut CommandedMotion,
        geometry: &Geometry,
        [left_s, rate]: [f64; 2],
    ) -> Result<Option<f64>, ProgramFinding> {
        let needed_s = motion.left_s() / rate;
        if needed_s <= left_s {
            motion.t_s = f64::INFINITY;
            self.command(&motion.place(), geometry, needed_s)?;
            return Ok(Some(needed_s));
        }
        motion.t_s += left_s * rate;
        self.command(&motion.place(), geometry, left_s)?;
        Ok(None)
    }

    /// Commands a place on the path, `elapsed_s` after the last place; `geometry` has the tool of the program.
    fn command(
        &mut self,
        place: &CommandedPlace,
        geometry: &Geometry,
        elapsed_s: f64,
    ) -> Result<(), ProgramFinding> {
        self.axes = match place {
            CommandedPlace::Axes(axes) => *axes,
            CommandedPlace::Pose(pose) => {
                let axes = self.nearest(geometry, pose)?;
                self.check_limits(&axes)?;
                for i in 0..AXES {
                    let most = self.robot.max_speed_deg_s[i].to_radians() * elapsed_s;
                    if (axes[i] - self.axes[i]).abs() > 1.05 * most + 1e-6 {
                        return Err(ProgramFinding::AxisSpeed { axis: i + 1 });
                    }
                }
                axes
            }
        };
        Ok(())
    }

    /// Refuses axis angles (rad) outside of the robot's limits.
    fn check_limits(&self, axes: &[f64; AXES]) -> Result<(), ProgramFinding> {
        let axes_deg = axes.map(f64::to_degrees);
        let limits_deg = self.robot.limits_at_deg(&axes_deg);
        for (i, angle_deg) in axes_deg.into_iter().enumerate() {
            let [low_deg, high_deg] = limits_deg[i];
            if !(low_deg - 1e-9..=high_deg + 1e-9).contains(&angle_deg) {
                return Err(ProgramFinding::AxisLimit { axis: i + 1, angle_deg, low_deg, high_deg });
            }
        }
        Ok(())
    }
}

/// A trapezoidal speed profile over a path from 0 to 1.
#[derive(Clone, Copy, Debug)]
struct SpeedProfile {
    speed: f64,
    acceleration: f64,
    duration_s: f64,
}

impl SpeedProfile {
    /// The fastest profile within all limits, each a distance with its largest speed and acceleration.
    fn within(limits: impl IntoIterator<Item = (f64, f64, f64)>) -> Self {
        let (mut speed, mut acceleration) = (f64::INFINITY, f64::INFINITY);
        for (distance, largest_speed, largest_acceleration) in limits {
            let distance = distance.abs();
            if distance > 1e-12 {
                speed = speed.min(largest_speed / distance);
                acceleration = acceleration.min(largest_acceleration / distance);
            }
        }
        if !speed.is_finite() {
            return Self { speed: 0.0, acceleration: 0.0, duration_s: 0.0 }; // nothing moves
        }
        // If full speed is not reached, the trapezoid is a triangle.
        speed = speed.min(acceleration.sqrt());
        Self { speed, acceleration, duration_s: 1.0 / speed + speed / acceleration }
    }

    /// The profile of the limit that takes longest by itself.
    fn slowest<const N: usize>(limits: [(f64, f64, f64); N]) -> Self {
        let profiles = limits.map(|limit| Self::within([limit]));
        profiles
            .into_iter()
            .max_by(|a, b| a.duration_s.total_cmp(&b.duration_s))
            .unwrap_or_else(|| Self::within([]))
    }

    /// A profile with this duration, a quarter of it for each ramp.
    fn lasting(seconds: f64) -> Self {
        if seconds <= 0.0 {
            return Self::within([]);
        }
        let speed = 4.0 / (3.0 * seconds);
        Self { speed, acceleration: 4.0 * speed / seconds, duration_s: seconds }
    }

    /// This profile, or if it is shorter, a profile with this duration.
    fn not_before(self, seconds: f64) -> Self {
        if self.duration_s < seconds && self.duration_s > 0.0 { Self::lasting(seconds) } else { self }
    }

    /// The position on the path, 0 to 1, after `t_s` seconds.
    fn share(&self, t_s: f64) -> f64 {
        if t_s >= self.duration_s {
            return 1.0;
        }
        let ramp_s = self.speed / self.acceleration;
        let left_s = self.duration_s - t_s;
        if t_s < ramp_s {
            0.5 * self.acceleration * t_s * t_s
        } else if left_s < ramp_s {
            1.0 - 0.5 * self.acceleration * left_s * left_s
        } else {
            self.speed * (t_s - 0.5 * ramp_s)
        }
    }
}

/// A commanded place on a path.
enum CommandedPlace {
    /// Axis angles, rad.
    Axes([f64; AXES]),
    /// The tool point in the robot base, with the orientation of the flange.
    Pose(Pose),
}

/// The path from one point to the next.
#[derive(Clone, Debug)]
enum CommandedPath {
    /// All axes in proportion, rad.
    Axes { from: [f64; AXES], to: [f64; AXES] },
    /// The tool on a line or an arc; its orientation turns about one axis.
    Tool { from: Pose, to: Pose, turn: FixedAxisTurn, arc: Option<ToolArc> },
}

/// A turn about a fixed axis.
#[derive(Clone, Copy, Debug)]
struct FixedAxisTurn {
    axis: UnitVector3<f64>,
    angle: f64,
}

impl FixedAxisTurn {
    /// The shortest turn from one orientation to the other, in the robot base.
    fn between(from: &Pose, to: &Pose) -> Self {
        let turn = rotation_vector(&(to.rotation * from.rotation.transpose()));
        let (axis, angle) = Unit::try_new_and_get(turn, 0.0).unwrap_or((Vector3::z_axis(), 0.0));
        Self { axis, angle }
    }
}

#[derive(Clone, Copy, Debug)]
struct ToolArc {
    centre: Vector3<f64>,
    normal: UnitVector3<f64>,
    /// Signed sweep, rad.
    sweep: f64,
}

impl ToolArc {
    /// The arc from `start` through `via` to `end` and its length (mm); `sweep` (rad, negative against the taught
    /// direction) replaces the taught sweep. `None` if the points are on a line.
    fn through(
        start: Vector3<f64>,
        via: Vector3<f64>,
        end: Vector3<f64>,
        sweep: Option<f64>,
    ) -> Option<(Self, f64)> {
        let (a, b) = (via - start, end - start);
        let normal = a.cross(&b);
        let area = normal.norm_squared();
        if area <= 1e-9 * a.norm_squared() * b.norm_squared() || area == 0.0 {
            return None;
        }
        // Circumcentre of the triangle.
        let centre = start
            + (normal.cross(&a) * b.norm_squared() + b.cross(&normal) * a.norm_squared()) / (2.0 * area);
        let normal = Unit::new_normalize(normal);
        let (from, to) = (start - centre, end - centre);
        // About this normal, start, via and end are in counter-clockwise order.
        let taught = normal.dot(&from.cross(&to)).atan2(from.dot(&to)).rem_euclid(std::f64::consts::TAU);
        let sweep = sweep.unwrap_or(taught);
        Some((Self { centre, normal, sweep }, from.norm() * sweep.abs()))
    }

    fn at(&self, start: &Vector3<f64>, share: f64) -> Vector3<f64> {
        self.centre + Rotation3::from_axis_angle(&self.normal, self.sweep * share) * (start - self.centre)
    }
}

#[derive(Clone, Debug)]
struct CommandedMotion {
    path: CommandedPath,
    profile: SpeedProfile,
    /// Time on the path at full override, s.
    t_s: f64,
}

impl CommandedMotion {
    fn left_s(&self) -> f64 {
        self.profile.duration_s - self.t_s
    }

    /// The current place; at the end it is exactly the commanded point.
    fn place(&self) -> CommandedPlace {
        let share = self.profile.share(self.t_s);
        match &self.path {
            CommandedPath::Axes { to, .. } if share >= 1.0 => CommandedPlace::Axes(*to),
            CommandedPath::Axes { from, to } => {
                CommandedPlace::Axes(std::array::from_fn(|i| from[i] + share * (to[i] - from[i])))
            }
            CommandedPath::Tool { to, arc, from, turn } => {
                let turned = Rotation3::from_axis_angle(&turn.axis, turn.angle * share);
                let position = match arc {
                    Some(arc) => arc.at(&from.position, share),
                    None => from.position + (to.position - from.position) * share,
                };
                if share >= 1.0 {
                    // An arc with a programmed sweep does not end at the taught point.
                    let position = if arc.is_some() { position } else { to.position };
                    return CommandedPlace::Pose(Pose { rotation: to.rotation, position });
                }
                CommandedPlace::Pose(Pose { rotation: turned.matrix() * from.rotation, position })
            }
        }
    }
}

#[cfg(test)]
mod arm_tests {
    use super::*;
    use dbbd_model::diagnostic::Finding;

    fn arm() -> SimulatedArm {
        let robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0])
            .expect("it is built in")
            .expect("its file can be read");
        SimulatedArm::at_home(&robot, Language::Krl)
    }

    #[test]
    fn home_is_moved_to_within_the_limits() {
        let mut robot = arm().robot;
        robot.limits_deg[1] = [-30.0, 35.0];
        robot.limits_deg[2] = [-120.0, 40.0];
        let home = SimulatedArm::at_home(&robot, Language::Krl).axes.map(f64::to_degrees);
        assert!((home[1] + 30.0).abs() < 1e-9 && (home[2] - 40.0).abs() < 1e-9, "{home:?}");
    }

    #[test]
    fn axes_beyond_their_limits_are_refused() {
        let arm = arm();
        let at = |axis: usize, deg: f64| {
            let mut axes = arm.axes;
            axes[axis] = f64::to_radians(deg);
            arm.check_limits(&axes).map_err(|finding| finding.code())
        };
        let limit = ProgramFinding::AxisLimit { axis: 1, angle_deg: 0.0, low_deg: 0.0, high_deg: 0.0 }.code();
        for (axis, deg, expected) in [
            (1, -135.0, Ok(())),
            (1, -135.1, Err(limit)),
            (1, 35.0, Ok(())),
            (1, 35.1, Err(limit)),
            (4, 119.5, Err(limit)),
        ] {
            assert_eq!(at(axis, deg), expected, "A{} {deg}", axis + 1);
        }
    }

    #[test]
    fn motion_ends_when_its_time_at_the_override_is_over() {
        let mut arm = arm();
        let mut to = arm.axes;
        to[0] += 0.4;
        let geometry = arm.robot.geometry.clone();
        let path = CommandedPath::Axes { from: arm.axes, to };
        let mut motion = arm.begin(path, SpeedProfile::lasting(2.0));
        assert_eq!(arm.motions, 1);
        let before = arm.axes[0];
        // At half of the speed the motion takes 4 s: after 1 s it is at 0.5 s of its own time, a sixth of the path.
        assert!(arm.advance(&mut motion, &geometry, [1.0, 0.5]).expect("it is possible").is_none());
        assert!((arm.axes[0] - before - 0.4 / 6.0).abs() < 1e-9);
        let took = arm.advance(&mut motion, &geometry, [9.0, 0.5]).expect("it is possible");
        assert!((took.expect("it has ended") - 3.0).abs() < 1e-9);
        assert_eq!(arm.axes, to);
    }

    /// Axis 1 of the KR 60 has 128 degrees/s. On a line it must not be faster; 5 % are the rounding of the steps.
    #[test]
    fn axis_that_is_too_fast_on_a_line_is_refused() {
        for (deg_s, fits) in [(120.0, true), (133.0, true), (137.0, false)] {
            let mut arm = arm();
            let geometry = arm.robot.geometry.clone();
            let from = geometry.ball(&arm.axes);
            let mut axes = arm.axes;
            axes[0] += f64::to_radians(deg_s) * 0.01;
            let to = geometry.ball(&axes);
            let path = CommandedPath::Tool { from, to, turn: FixedAxisTurn::between(&from, &to), arc: None };
            let mut motion = arm.begin(path, SpeedProfile::lasting(0.01));
            assert_eq!(arm.advance(&mut motion, &geometry, [0.01, 1.0]).is_ok(), fits, "{deg_s}");
        }
    }
}

#[cfg(test)]
mod motion_tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use super::*;
    use dbbd_model::robot::pose::{rot_x, rot_z};

    fn assert_near(found: f64, expected: f64) {
        assert!((found - expected).abs() < 1e-9, "{found}, not {expected}");
    }

    /// 100 mm at 20 mm/s and 10 mm/s^2 take 7 s: 2 s and 20 mm for each ramp.
    #[test]
    fn profile_is_a_trapezoid() {
        let profile = SpeedProfile::within([(-100.0, 20.0, 10.0), (0.0, 1.0, 1.0)]);
        assert_near(profile.duration_s, 7.0);
        for (t_s, share) in
            [(0.0, 0.0), (1.0, 0.05), (2.0, 0.2), (3.5, 0.5), (5.0, 0.8), (6.0, 0.95), (7.0, 1.0), (9.0, 1.0)]
        {
            assert_near(profile.share(t_s), share);
        }
        // 10 mm: a triangle of 1 s up and 1 s down.
        let triangle = SpeedProfile::within([(10.0, 20.0, 10.0)]);
        assert_near(triangle.duration_s, 2.0);
        assert_near(triangle.share(0.5), 0.125);
        assert_near(triangle.share(1.5), 0.875);
    }

    #[test]
    fn strictest_speed_and_acceleration_of_all_axes_apply() {
        // The first axis limits the speed to 0.2 and the second the acceleration to 0.05 of the path.
        let profile = SpeedProfile::within([(100.0, 20.0, 100.0), (100.0, 90.0, 5.0)]);
        assert_near(profile.duration_s, 1.0 / 0.2 + 0.2 / 0.05);
        // Alone the first takes 5.2 s, the second (a triangle) 2 sqrt 20.
        assert_near(
            SpeedProfile::slowest([(100.0, 20.0, 100.0), (100.0, 90.0, 5.0)]).duration_s,
            80.0_f64.sqrt(),
        );
        assert_near(SpeedProfile::within([(0.0, 1.0, 1.0)]).duration_s, 0.0);
        assert_near(SpeedProfile::within([(0.0, 1.0, 1.0)]).share(0.0), 1.0);
    }

    /// With a quarter of the time for each ramp the greatest speed is 4/3 of the mean: a ramp of 2 s goes 4/3 / 8 * 2 / 2, a sixth
    /// of the path.
    #[test]
    fn motion_of_a_given_duration_ramps_for_a_quarter_at_each_end() {
        let profile = SpeedProfile::lasting(8.0);
        assert_near(profile.duration_s, 8.0);
        assert_near(profile.share(2.0), 1.0 / 6.0);
        assert_near(profile.share(4.0), 0.5);
        assert_near(profile.share(6.0), 5.0 / 6.0);
        assert_near(SpeedProfile::lasting(0.0).duration_s, 0.0);
        let quick = SpeedProfile::within([(10.0, 20.0, 10.0)]);
        assert_near(quick.not_before(5.0).duration_s, 5.0);
        assert_near(quick.not_before(1.0).duration_s, 2.0);
        assert_near(SpeedProfile::within([]).not_before(1.0).duration_s, 0.0);
    }

    /// A circle of 50 mm about (100, 20, 7).
    #[test]
    fn arc_sweeps_from_its_start() {
        let [start, via, end] =
            [[150.0, 20.0, 7.0], [50.0, 20.0, 7.0], [100.0, -30.0, 7.0]].map(Vector3::from);
        let (arc, length_mm) = ToolArc::through(start, via, end, None).expect("they are on no line");
        assert_near(length_mm, 50.0 * 1.5 * PI);
        assert!((arc.at(&start, 2.0 / 3.0) - via).norm() < 1e-9);
        assert!((arc.at(&start, 1.0) - end).norm() < 1e-9);
        assert!((arc.at(&start, 1.0 / 3.0) - Vector3::new(100.0, 70.0, 7.0)).norm() < 1e-9);
        // A programmed sweep replaces the sweep of the points, also against their order.
        let (back, length_mm) =
            ToolArc::through(start, via, end, Some(-FRAC_PI_2)).expect("they are on no line");
        assert_near(length_mm, 50.0 * FRAC_PI_2);
        assert!((back.at(&start, 1.0) - end).norm() < 1e-9);
        let line = [0.0, 1.0, 3.0].map(|x| Vector3::new(x, 2.0 * x, 0.0));
        assert!(ToolArc::through(line[0], line[1], line[2], None).is_none());
    }

    fn motion(path: CommandedPath, t_s: f64) -> CommandedPlace {
        CommandedMotion { path, profile: SpeedProfile::lasting(8.0), t_s }.place()
    }

    #[test]
    fn axes_move_in_proportion_and_end_exactly() {
        let path = CommandedPath::Axes { from: [0.1; AXES], to: [0.7, 0.1, -0.5, 0.1, 0.1, 0.1] };
        let CommandedPlace::Axes(axes) = motion(path.clone(), 2.0) else { panic!("no axes") };
        assert_near(axes[0], 0.2);
        assert_near(axes[2], 0.0);
        let CommandedPlace::Axes(axes) = motion(path, 8.0) else { panic!("no axes") };
        assert_eq!(axes, [0.7, 0.1, -0.5, 0.1, 0.1, 0.1]);
    }

    /// The tool turns from Rx(90) by Rz(60) of the base: a sixth of the path is 10 degrees about the base's Z.
    #[test]
    fn tool_turns_about_a_fixed_axis_of_the_base() {
        let pose = |x: f64, turn_deg: f64| Pose {
            rotation: rot_z(turn_deg.to_radians()) * rot_x(FRAC_PI_2),
            position: Vector3::new(x, 0.0, 0.0),
        };
        let (from, to) = (pose(0.0, 0.0), pose(60.0, 60.0));
        let turn = FixedAxisTurn::between(&from, &to);
        assert_near(turn.angle.to_degrees(), 60.0);
        let path = CommandedPath::Tool { from, to, turn, arc: None };
        let CommandedPlace::Pose(found) = motion(path.clone(), 2.0) else { panic!("no pose") };
        assert!((found.position - pose(10.0, 10.0).position).norm() < 1e-9);
        assert!((found.rotation - pose(10.0, 10.0).rotation).norm() < 1e-9);
        let CommandedPlace::Pose(found) = motion(path, 8.0) else { panic!("no pose") };
        assert_eq!(found, to);
    }
}
