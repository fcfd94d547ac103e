//! The world around the simulated controller: the true robot, base balls and bar.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Vector3;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use serde::Deserialize;

use super::ControllerMoment;
use crate::program;
use crate::sim::SimulationFinding;
use dbbd_model::base::fixed_array::fixed_array;
use dbbd_model::base::parse::from_toml;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::plausibility::Quantity;
use dbbd_model::robot::{AXES, Geometry};

/// Time in which the repeatability error of a motion replaces the error of the motion before, s: no robot jumps.
const REPLACED_S: f64 = 0.2;

/// The true set-up: from WORLD.toml; keys that it does not have are taken from the modules of the program.
#[derive(Clone, Debug, PartialEq)]
pub struct WorldSetup {
    /// True centre of each base ball in the robot base, mm, by its number.
    pub centres_mm: BTreeMap<u32, [f64; 3]>,
    /// For a base ball that was taught: the axis angles, degrees, at which the true tool ball is at its centre.
    pub taught_deg: BTreeMap<u32, [f64; AXES]>,
    pub bar: TrueBar,
    /// Standard deviation of each coordinate of the tool ball, drawn again for each motion, micrometres.
    pub repeatability_um: f64,
    /// Backlash of each axis, degrees: the true axis is behind by half of it, against the sense of its last move.
    pub backlash_deg: [f64; AXES],
    /// Following error of each axis as a time constant, ms: in motion the axis is behind by its speed times this.
    pub following_ms: [f64; AXES],
}

/// The true ball-bar.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrueBar {
    /// True distance between the ball centres at reading zero, mm.
    pub length_mm: f64,
    /// Lowest and highest reading, mm.
    pub stroke_mm: [f64; 2],
    /// Standard deviation of a reading, micrometres.
    pub noise_um: f64,
    /// Step of a reading, micrometres; 0 for none.
    pub resolution_um: f64,
    /// Readings per second.
    pub rate_hz: f64,
    /// Temperature that the bar reports, degrees Celsius.
    pub temperature_c: f64,
    /// Force with which the bar pulls the tool ball towards the base ball, N.
    pub force_n: f64,
}

/// WORLD.toml; every key is optional.
#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct WorldFile {
    /// True centres of base balls, or how they were taught; the other balls are at their places in the program.
    centre: Vec<WorldBallTable>,
    bar: WorldBarTable,
    /// The same as in [`WorldSetup`], as the following keys.
    repeatability_um: f64,
    #[serde(deserialize_with = "fixed_array")]
    backlash_deg: [f64; AXES],
    #[serde(deserialize_with = "fixed_array")]
    following_ms: [f64; AXES],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WorldBallTable {
    id: u32,
    /// The true centre, mm; either this or `taught_deg`.
    #[serde(default, deserialize_with = "fixed_array")]
    xyz_mm: Option<[f64; 3]>,
    /// The axis angles as in [`WorldSetup::taught_deg`].
    #[serde(default, deserialize_with = "fixed_array")]
    taught_deg: Option<[f64; AXES]>,
}

#[derive(Deserialize)]
#[serde(default, deny_unknown_fields)]
struct WorldBarTable {
    /// Length of the bar, mm; the default is the length in the program.
    length_mm: Option<f64>,
    /// Stroke of the bar, mm; the default is the stroke in the program.
    #[serde(deserialize_with = "fixed_array")]
    stroke_mm: Option<[f64; 2]>,
    noise_um: f64,
    resolution_um: f64,
    rate_hz: f64,
    temperature_c: f64,
    force_n: f64,
}

impl Default for WorldBarTable {
    fn default() -> Self {
        let (length_mm, stroke_mm) = (None, None);
        Self {
            length_mm,
            stroke_mm,
            noise_um: 1.0,
            resolution_um: 0.1,
            rate_hz: 200.0,
            temperature_c: 20.0,
            force_n: 0.0,
        }
    }
}

impl WorldSetup {
    /// The set-up of `world` (name and text of a file); keys that it does not have are taken from the set-up of the
    /// program's modules.
    pub fn new(program: &[program::Setup], world: Option<(&str, &str)>) -> Result<Self, Diagnostic> {
        let (name, text) = world.unwrap_or(("WORLD.toml", ""));
        let file: WorldFile = from_toml(name, text)?;
        Self::of(program, file).map_err(|finding| finding.in_file(name))
    }

    fn of(setups: &[program::Setup], file: WorldFile) -> Result<Self, Diagnostic> {
        let mut centres_mm: BTreeMap<u32, [f64; 3]> =
            setups.iter().map(|setup| (setup.ball, setup.centre_mm)).collect();
        // A program without set-ups uses the first ball.
        let balls: BTreeSet<u32> =
            if setups.is_empty() { [1].into() } else { centres_mm.keys().copied().collect() };
        let mut given = BTreeSet::new();
        let mut taught_deg = BTreeMap::new();
        for WorldBallTable { id: ball, xyz_mm, taught_deg: axes_deg } in file.centre {
            if !given.insert(ball) {
                return Err(SimulationFinding::BallTwice { ball }.into());
            }
            match (xyz_mm, axes_deg) {
                (Some(xyz_mm), None) => _ = centres_mm.insert(ball, xyz_mm),
                (None, Some(axes_deg)) => _ = taught_deg.insert(ball, axes_deg),
                _ => return Err(SimulationFinding::BallWithoutPlace { ball }.into()),
            }
        }
        let unknown = |ball: &u32| !centres_mm.contains_key(ball) && !taught_deg.contains_key(ball);
        if let Some(ball) = balls.into_iter().find(unknown) {
            return Err(SimulationFinding::UnknownBall { ball }.into());
        }
        let first = setups.first();
        let missing = |key: &'static str| SimulationFinding::UnknownKey { key };
        let length_mm = file.bar.length_mm.or(first.map(|setup| setup.length_mm));
        let stroke_mm = file.bar.stroke_mm.or(first.map(|setup| setup.stroke_mm));
        let setup = Self {
            centres_mm,
            taught_deg,
            bar: TrueBar {
                length_mm: length_mm.ok_or_else(|| missing("length_mm"))?,
                stroke_mm: stroke_mm.ok_or_else(|| missing("stroke_mm"))?,
                noise_um: file.bar.noise_um,
                resolution_um: file.bar.resolution_um,
                rate_hz: file.bar.rate_hz,
                temperature_c: file.bar.temperature_c,
                force_n: file.bar.force_n,
            },
            repeatability_um: file.repeatability_um,
            backlash_deg: file.backlash_deg,
            following_ms: file.following_ms,
        };
        setup.check()?;
        Ok(setup)
    }

    /// Refuses impossible numbers.
    pub fn check(&self) -> Result<(), Diagnostic> {
        let TrueBar {
            length_mm,
            stroke_mm: [low_mm, high_mm],
            noise_um,
            resolution_um,
            rate_hz,
            temperature_c,
            force_n,
        } = self.bar;
        let scalars = [
            ("[bar] noise_um", noise_um, Quantity::SimulatedError),
            ("[bar] resolution_um", resolution_um, Quantity::SimulatedError),
            ("repeatability_um", self.repeatability_um, Quantity::SimulatedError),
            ("[bar] length_mm", length_mm, Quantity::Length),
            ("[bar] rate_hz", rate_hz, Quantity::SampleRate),
            ("[bar] temperature_c", temperature_c, Quantity::Coordinate),
            ("[bar] force_n", force_n, Quantity::BarForce),
        ];
        let backlash = self.backlash_deg.iter().map(|deg| ("backlash_deg", *deg, Quantity::SimulatedError));
        let following = self.following_ms.iter().map(|ms| ("following_ms", *ms, Quantity::SimulatedError));
        let centres = self.centres_mm.values().flatten();
        let centres = centres.map(|value| ("[[centre]] xyz_mm", *value, Quantity::Coordinate));
        let taught = self.taught_deg.values().flatten();
        let taught = taught.map(|value| ("[[centre]] taught_deg", *value, Quantity::Coordinate));
        let mut all = scalars.into_iter().chain(backlash).chain(following).chain(centres).chain(taught);
        all.try_for_each(|(key, value, quantity)| quantity.check(key, value))?;
        if !(low_mm < high_mm && low_mm.is_finite() && high_mm.is_finite()) {
            return Err(SimulationFinding::Stroke { low_mm, high_mm }.into());
        }
        Ok(())
    }
}

/// A reading of the true bar.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrueReading {
    /// Reading, mm; longer is positive. Outside of the stroke, where a real bar would leave its cup, it is the end of
    /// the stroke.
    pub reading_mm: f64,
    pub in_stroke: bool,
}

/// The true robot with the bar on it.
#[derive(Clone, Debug)]
pub struct World {
    robot: Geometry,
    setup: WorldSetup,
    random: Pcg64,
    /// The motion for which `offset` was drawn.
    motion: Option<u32>,
    /// Repeatability errors of the tool ball in the motion before and in this motion, mm; this motion began at
    /// `since_s`.
    offsets: [Vector3<f64>; 2],
    since_s: f64,
    /// Last commanded joint angles, rad, and the sense of each joint's last move.
    last: Option<[f64; AXES]>,
    direction: [f64; AXES],
    last_measured: Option<FollowedAxes>,
}

/// The measured axes and their commands at a time.
#[derive(Clone, Copy, Debug)]
struct FollowedAxes {
    t_s: f64,
    commanded: [f64; AXES],
    axes: [f64; AXES],
}

impl World {
    /// The true `robot` (its tool is the true tool ball) in a set-up; `seed` is the seed of noise and repeatability.
    pub fn new(robot: Geometry, mut setup: WorldSetup, seed: u64) -> Self {
        for (ball, axes_deg) in &setup.taught_deg {
            let centre = robot.ball(&axes_deg.map(f64::to_radians)).position;
            setup.centres_mm.insert(*ball, centre.into());
        }
        Self {
            robot,
            setup,
            random: Pcg64::seed_from_u64(seed),
            motion: None,
            offsets: [Vector3::zeros(); 2],
            since_s: 0.0,
            last: None,
            direction: [0.0; AXES],
            last_measured: None,
        }
    }

    /// The measured axes, rad. Moments must be in order of time.
    pub fn measured(&mut self, moment: &ControllerMoment) -> [f64; AXES] {
        let ControllerMoment { t_s, axes: commanded, .. } = *moment;
        let before = self.last_measured.unwrap_or(FollowedAxes { t_s, commanded, axes: commanded });
        let dt_s = t_s - before.t_s;
        let axes = std::array::from_fn(|i| {
            let lag_s = self.setup.following_ms[i] * 1e-3;
            if lag_s <= 0.0 || dt_s <= 0.0 {
                return if lag_s <= 0.0 { commanded[i] } else { before.axes[i] };
            }
            // The response of a first-order lag to a ramp from the command before to this one.
            let behind = (commanded[i] - before.commanded[i]) / dt_s * lag_s;
            let decay = (-dt_s / lag_s).exp();
            commanded[i] - behind + (before.axes[i] - before.commanded[i] + behind) * decay
        });
        self.last_measured = Some(FollowedAxes { t_s, commanded, axes });
        axes
    }

    pub fn setup(&self) -> &WorldSetup {
        &self.setup
    }

    /// The readings at rest at poses (axis angles, rad, and number of the base ball), each after a motion of its own.
    pub fn readings(&mut self, poses: impl IntoIterator<Item = ([f64; AXES], u32)>) -> Vec<TrueReading> {
        let at_rest = |(motions, (axes, centre)): (u32, ([f64; AXES], u32))| {
            let t_s = 2.0 * REPLACED_S * f64::from(motions);
            let begins =
                ControllerMoment { t_s, axes, centre, strobe: false, motions, halted: false, done: false };
            self.reading(&begins);
            self.reading(&ControllerMoment { t_s: t_s + REPLACED_S, strobe: true, ..begins })
        };
        (1..).zip(poses).map(at_rest).collect()
    }

    /// The reading at a moment. Moments must be in order of time.
    pub fn reading(&mut self, moment: &ControllerMoment) -> TrueReading {
        if self.motion != Some(moment.motions) {
            self.motion = Some(moment.motions);
            let sd_mm = self.setup.repeatability_um * 1e-3;
            self.offsets = [self.offset(moment.t_s), Vector3::from_fn(|_, _| sd_mm * self.normal())];
            self.since_s = moment.t_s;
        }
        let axes = self.true_axes(moment);
        let ball = self.robot.ball(&axes).position + self.offset(moment.t_s);
        let centre = self.setup.centres_mm.get(&moment.centre).copied().map(Vector3::from);
        // A ball whose centre is not known is out of the reach of the bar.
        let bar = self.setup.bar;
        let distance = centre.map_or(f64::INFINITY, |centre| {
            let free = (ball - centre).norm();
            if bar.force_n == 0.0 { free } else { free - self.shortened_mm(&axes, &centre) }
        });
        let reading_mm = distance - bar.length_mm;
        let noise_mm = bar.noise_um * 1e-3 * self.normal();
        let [low, high] = bar.stroke_mm;
        if !(low..=high).contains(&reading_mm) {
            return TrueReading { reading_mm: reading_mm.clamp(low, high), in_stroke: false };
        }
        let noisy = reading_mm + noise_mm;
        let step_mm = bar.resolution_um * 1e-3;
        let reading_mm = if step_mm > 0.0 { (noisy / step_mm).round() * step_mm } else { noisy };
        TrueReading { reading_mm, in_stroke: true }
    }

    /// Shortening of the length by the pull of the bar, mm.
    fn shortened_mm(&self, axes: &[f64; AXES], centre: &Vector3<f64>) -> f64 {
        self.robot.length_row(axes, centre, 0.0).shortened_mm(&self.robot, self.setup.bar.force_n)
    }

    /// The repeatability error at a time, mm.
    fn offset(&self, t_s: f64) -> Vector3<f64> {
        let share = ((t_s - self.since_s) / REPLACED_S).clamp(0.0, 1.0);
        self.offsets[0].lerp(&self.offsets[1], share * share * (3.0 - 2.0 * share))
    }

    /// The axes with their backlash, rad.
    fn true_axes(&mut self, moment: &ControllerMoment) -> [f64; AXES] {
        // Backlash is in the drives of the joints, not of the axes.
        let coupling = self.robot.coupling;
        let commanded = coupling.joints(&moment.axes);
        let mut joints = coupling.joints(&self.measured(moment));
        for i in 0..AXES {
            let moved = self.last.map_or(0.0, |last| commanded[i] - last[i]);
            if moved.abs() > 1e-9 {
                self.direction[i] = moved.signum();
            }
            joints[i] -= 0.5 * self.direction[i] * self.setup.backlash_deg[i].to_radians();
            let own = self.robot.joint_errors.at(i).map_or(0.0, |error| error.backlash);
            joints[i] += self.direction[i] * self.robot.rows[i].sign * own;
        }
        self.last = Some(commanded);
        coupling.axes(&joints)
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.random)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dbbd_model::robot::Robot;

    const HOME: [f64; AXES] = [0.1, -1.0, 1.6, 0.2, 1.0, 0.3];

    fn robot() -> Geometry {
        Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0])
            .expect("it is built in")
            .expect("its file can be read")
            .geometry
    }

    /// A base ball 300 mm below the tool ball at home, and a bar without noise that reads -2 to 6 mm.
    fn setup(robot: &Geometry) -> WorldSetup {
        let ball = robot.ball(&HOME).position - Vector3::new(0.0, 0.0, 300.0);
        WorldSetup {
            centres_mm: [(1, ball.into())].into(),
            taught_deg: BTreeMap::new(),
            bar: TrueBar {
                length_mm: 300.0,
                stroke_mm: [-2.0, 6.0],
                noise_um: 0.0,
                resolution_um: 0.0,
                rate_hz: 200.0,
                temperature_c: 20.0,
                force_n: 0.0,
            },
            repeatability_um: 0.0,
            backlash_deg: [0.0; AXES],
            following_ms: [0.0; AXES],
        }
    }

    fn moment(t_s: f64, axes: [f64; AXES], motions: u32) -> ControllerMoment {
        ControllerMoment { t_s, axes, centre: 1, strobe: false, motions, halted: false, done: false }
    }

    #[test]
    fn reading_is_the_distance_less_the_length() {
        let robot = robot();
        let mut setup = setup(&robot);
        setup.bar.length_mm = 299.25;
        let reading = World::new(robot, setup, 1).reading(&moment(0.0, HOME, 0));
        assert!((reading.reading_mm - 0.75).abs() < 1e-9 && reading.in_stroke);
    }

    #[test]
    fn bar_outside_of_its_stroke_reads_the_end() {
        let robot = robot();
        for (length_mm, reading_mm, in_stroke) in
            [(301.9, -1.9, true), (302.1, -2.0, false), (294.1, 5.9, true), (293.9, 6.0, false)]
        {
            let mut setup = setup(&robot);
            setup.bar.length_mm = length_mm;
            let found = World::new(robot.clone(), setup, 1).reading(&moment(0.0, HOME, 0));
            assert!((found.reading_mm - reading_mm).abs() < 1e-9, "{length_mm}: {found:?}");
            assert_eq!(found.in_stroke, in_stroke);
        }
        // A ball whose place is not known is out of reach.
        let elsewhere = ControllerMoment { centre: 2, ..moment(0.0, HOME, 0) };
        let found = World::new(robot.clone(), setup(&robot), 1).reading(&elsewhere);
        assert_eq!(found, TrueReading { reading_mm: 6.0, in_stroke: false });
    }

    /// 4000 readings: the standard deviation of their standard deviation is 1.1 %.
    #[test]
    fn noise_and_resolution_are_those_of_the_bar() {
        let robot = robot();
        let mut setup = setup(&robot);
        setup.bar.noise_um = 5.0;
        let mut world = World::new(robot.clone(), setup.clone(), 3);
        let readings: Vec<f64> = (0..4000).map(|_| world.reading(&moment(0.0, HOME, 0)).reading_mm).collect();
        let mean = readings.iter().sum::<f64>() / 4000.0;
        let variance = readings.iter().map(|one| (one - mean).powi(2)).sum::<f64>() / 3999.0;
        assert!(mean.abs() < 4.0 * 5e-3 / 4000_f64.sqrt(), "{mean}");
        assert!((variance.sqrt() / 5e-3 - 1.0).abs() < 0.045, "{variance}");
        setup.bar.resolution_um = 20.0;
        let mut world = World::new(robot, setup, 3);
        for _ in 0..100 {
            let steps = world.reading(&moment(0.0, HOME, 0)).reading_mm / 0.02;
            assert!((steps - steps.round()).abs() < 1e-9, "{steps}");
        }
    }

    /// The error of a motion comes in by 3 s^2 - 2 s^3 over 0.2 s: a quarter of the time has 5/32 of it.
    #[test]
    fn repeatability_error_is_drawn_for_each_motion() {
        let robot = robot();
        let mut setup = setup(&robot);
        setup.repeatability_um = 100.0;
        let mut world = World::new(robot, setup, 1);
        assert!(world.reading(&moment(0.0, HOME, 0)).reading_mm.abs() < 1e-12);
        let target = world.offsets[1];
        world.reading(&moment(0.05, HOME, 0));
        assert!((world.offset(0.05) - target * (5.0 / 32.0)).norm() < 1e-12);
        assert!((world.offset(0.2) - target).norm() < 1e-12 && (world.offset(9.0) - target).norm() < 1e-12);
        // The next motion begins with the error that the last one left.
        world.reading(&moment(1.0, HOME, 1));
        assert_eq!(world.offsets[0], target);
        assert_ne!(world.offsets[1], target);
        let mut squares = 0.0;
        for motion in 2..1002 {
            world.reading(&moment(f64::from(motion), HOME, motion));
            squares += world.offsets[1].norm_squared();
        }
        // 3000 coordinates with 0.1 mm: the variance is known to 2.6 %.
        assert!((squares / 3000.0 / 0.01 - 1.0).abs() < 0.1, "{squares}");
    }

    #[test]
    fn axis_with_backlash_is_behind_by_half_of_it() {
        let robot = robot();
        let mut setup = setup(&robot);
        setup.backlash_deg[1] = 0.2;
        let mut world = World::new(robot, setup, 1);
        let at = |a2: f64| {
            let mut axes = HOME;
            axes[1] += a2;
            moment(0.0, axes, 0)
        };
        let half = 0.1_f64.to_radians();
        // Before any move there is no sense; then the error is against the last move, and stays at rest.
        for (a2, error) in [(0.0, 0.0), (0.1, -half), (0.1, -half), (0.05, half), (0.05, half), (0.3, -half)]
        {
            let axes = world.true_axes(&at(a2));
            assert!((axes[1] - (HOME[1] + a2 + error)).abs() < 1e-12, "{a2}");
            assert!((axes[0] - HOME[0]).abs() < 1e-12);
        }
    }

    /// A first-order lag T answers a ramp of the rate v with v (t - T (1 - exp(-t / T))).
    #[test]
    fn axis_follows_with_its_time_constant() {
        let robot = robot();
        let mut setup = setup(&robot);
        setup.following_ms[0] = 20.0;
        let mut world = World::new(robot, setup, 1);
        let rate = 0.5;
        let at = |t_s: f64| {
            let mut axes = [0.0; AXES];
            axes[0] = rate * t_s;
            axes[1] = rate * t_s;
            moment(t_s, axes, 0)
        };
        world.measured(&at(0.0));
        for t_s in [0.004, 0.010, 0.040, 0.200] {
            let expected = rate * (t_s - 0.02 * (1.0 - (-t_s / 0.02_f64).exp()));
            let found = world.measured(&at(t_s));
            assert!((found[0] - expected).abs() < 1e-12, "{t_s}");
            assert_eq!(found[1], rate * t_s);
        }
        // At the same moment nothing moves.
        let before = world.measured(&at(0.2));
        assert_eq!(world.measured(&at(0.2)), before);
    }

    fn program(ball: u32) -> program::Setup {
        program::Setup { ball, centre_mm: [1.0, 2.0, 3.0], length_mm: 300.0, stroke_mm: [-1.0, 1.0] }
    }

    #[test]
    fn keys_of_the_file_replace_those_of_the_program() {
        let text = "repeatability_um = 7.0\n[bar]\nlength_mm = 301.0\n[[centre]]\nid = 2\nxyz_mm = [9.0, 8.0, 7.0]\n";
        let setup =
            WorldSetup::new(&[program(1), program(2)], Some(("w.toml", text))).expect("it is possible");
        assert_eq!(setup.centres_mm[&1], [1.0, 2.0, 3.0]);
        assert_eq!(setup.centres_mm[&2], [9.0, 8.0, 7.0]);
        assert_eq!((setup.bar.length_mm, setup.bar.stroke_mm), (301.0, [-1.0, 1.0]));
        assert_eq!((setup.bar.noise_um, setup.bar.resolution_um, setup.repeatability_um), (1.0, 0.1, 7.0));
    }

    #[test]
    fn impossible_worlds_are_refused() {
        let refused = |text: &str| {
            let found = WorldSetup::new(&[program(1)], Some(("w.toml", text)));
            found.expect_err("it is impossible").code().as_str()
        };
        for (text, expected) in [
            ("backlash_deg = [0, 0, 0, 0, -0.1, 0]\n", "E0130"),
            ("following_ms = [0, 0, inf, 0, 0, 0]\n", "E0130"),
            ("[bar]\nrate_hz = 0.05\n", "E0130"),
            ("[bar]\nlength_mm = 0.0\n", "E0130"),
            ("[bar]\nstroke_mm = [1.0, 1.0]\n", "E1603"),
            ("[[centre]]\nid = 1\n", "E1602"),
            ("[[centre]]\nid = 1\nxyz_mm = [1, 2, 3]\n[[centre]]\nid = 1\nxyz_mm = [1, 2, 3]\n", "E1602"),
        ] {
            assert_eq!(refused(text), expected, "{text}");
        }
    }

    #[test]
    fn taught_ball_is_where_the_true_tool_ball_was() {
        let robot = robot();
        let mut setup = setup(&robot);
        setup.taught_deg = [(1, HOME.map(f64::to_degrees))].into();
        let world = World::new(robot.clone(), setup, 1);
        let centre = Vector3::from(world.setup().centres_mm[&1]);
        assert!((centre - robot.ball(&HOME).position).norm() < 1e-9);
    }

    /// A bar that pulls by 50 N reads less by the deflection due to the compliance of joint 3.
    #[test]
    fn a_bar_that_pulls_reads_less() {
        let mut robot = robot();
        robot.compliance[2] = 4e-7;
        let free = setup(&robot);
        let pulling = WorldSetup { bar: TrueBar { force_n: 50.0, ..free.bar }, ..free.clone() };
        let [free, pulled] = [free, pulling]
            .map(|setup| World::new(robot.clone(), setup, 1).reading(&moment(0.0, HOME, 1)).reading_mm);
        let lever = robot.axis_jacobian(&HOME)[2].0.dot(&Vector3::z());
        let shorter = 50.0 * 4e-7 * 1e-3 * lever * lever;
        assert!(shorter > 1e-3 && (free - pulled - shorter).abs() < 1e-6, "{free} {pulled} {shorter}");
    }
}
