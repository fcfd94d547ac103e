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
use dbbd_model::base::parse::from_toml;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::{AXES, Geometry};

/// Time in which the repeatability error of a motion replaces that of the one before, s: no robot jumps.
const REPLACED_S: f64 = 0.2;

/// The true set-up: from WORLD.toml, and for keys that it does not have from the modules of the program.
#[derive(Clone, Debug, PartialEq)]
pub struct WorldSetup {
    /// True centre of each base ball in the robot base, mm, by its number.
    pub centres_mm: BTreeMap<u32, [f64; 3]>,
    /// For a base ball that was taught: the axis angles, degrees, at which the true tool ball is at its centre.
    pub taught_deg: BTreeMap<u32, [f64; AXES]>,
    pub bar: TrueBar,
    /// Standard deviation of each coordinate of the tool ball, drawn anew for each motion, micrometres.
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
}

/// WORLD.toml; every key is optional.
#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct WorldFile {
    /// True centres of base balls, or how they were taught; the other balls are where the program has them.
    centre: Vec<WorldBallTable>,
    bar: WorldBarTable,
    /// As in [`WorldSetup`], like the following.
    repeatability_um: f64,
    backlash_deg: [f64; AXES],
    following_ms: [f64; AXES],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WorldBallTable {
    id: u32,
    /// The true centre, mm, or
    xyz_mm: Option<[f64; 3]>,
    /// as in [`WorldSetup::taught_deg`].
    taught_deg: Option<[f64; AXES]>,
}

#[derive(Deserialize)]
#[serde(default, deny_unknown_fields)]
struct WorldBarTable {
    /// Default: that of the program.
    length_mm: Option<f64>,
    /// Default: that of the program.
    stroke_mm: Option<[f64; 2]>,
    noise_um: f64,
    resolution_um: f64,
    rate_hz: f64,
    temperature_c: f64,
}

impl Default for WorldBarTable {
    fn default() -> Self {
        let (length_mm, stroke_mm) = (None, None);
        Self { length_mm, stroke_mm, noise_um: 1.0, resolution_um: 0.1, rate_hz: 200.0, temperature_c: 20.0 }
    }
}

impl WorldSetup {
    /// The set-up of `world` (name and text of a file), and for keys that it does not have that of the program's modules.
    pub fn new(program: &[program::Setup], world: Option<(&str, &str)>) -> Result<Self, Diagnostic> {
        let (name, text) = world.unwrap_or(("WORLD.toml", ""));
        let file: WorldFile = from_toml(name, text)?;
        Self::of(program, file).map_err(|finding| Diagnostic::file(name, finding))
    }

    fn of(setups: &[program::Setup], file: WorldFile) -> Result<Self, SimulationFinding> {
        let mut centres_mm: BTreeMap<u32, [f64; 3]> =
            setups.iter().map(|setup| (setup.ball, setup.centre_mm)).collect();
        // A program without set-ups uses the first ball.
        let balls: BTreeSet<u32> =
            if setups.is_empty() { [1].into() } else { centres_mm.keys().copied().collect() };
        let mut given = BTreeSet::new();
        let mut taught_deg = BTreeMap::new();
        for WorldBallTable { id: ball, xyz_mm, taught_deg: axes_deg } in file.centre {
            if !given.insert(ball) {
                return Err(SimulationFinding::BallTwice { ball });
            }
            match (xyz_mm, axes_deg) {
                (Some(xyz_mm), None) => _ = centres_mm.insert(ball, xyz_mm),
                (None, Some(axes_deg)) => _ = taught_deg.insert(ball, axes_deg),
                _ => return Err(SimulationFinding::BallWithoutPlace { ball }),
            }
        }
        let unknown = |ball: &u32| !centres_mm.contains_key(ball) && !taught_deg.contains_key(ball);
        if let Some(ball) = balls.into_iter().find(unknown) {
            return Err(SimulationFinding::UnknownBall { ball });
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
            },
            repeatability_um: file.repeatability_um,
            backlash_deg: file.backlash_deg,
            following_ms: file.following_ms,
        };
        setup.check()?;
        Ok(setup)
    }

    /// Refuses impossible numbers.
    pub fn check(&self) -> Result<(), SimulationFinding> {
        let TrueBar {
            length_mm,
            stroke_mm: [low_mm, high_mm],
            noise_um,
            resolution_um,
            rate_hz,
            temperature_c,
        } = self.bar;
        let zero_or_more = |value: f64| (0.0..1e6).contains(&value);
        let scalars = [
            ("[bar] noise_um", noise_um, zero_or_more(noise_um)),
            ("[bar] resolution_um", resolution_um, zero_or_more(resolution_um)),
            ("repeatability_um", self.repeatability_um, zero_or_more(self.repeatability_um)),
            ("[bar] length_mm", length_mm, length_mm > 0.0 && length_mm.is_finite()),
            ("[bar] rate_hz", rate_hz, (0.1..=100_000.0).contains(&rate_hz)),
            ("[bar] temperature_c", temperature_c, temperature_c.is_finite()),
        ];
        let backlash = self.backlash_deg.iter().map(|deg| ("backlash_deg", *deg, zero_or_more(*deg)));
        let following = self.following_ms.iter().map(|ms| ("following_ms", *ms, zero_or_more(*ms)));
        let centres = self.centres_mm.values().flatten();
        let centres = centres.map(|value| ("[[centre]] xyz_mm", *value, value.is_finite()));
        let taught = self.taught_deg.values().flatten();
        let taught = taught.map(|value| ("[[centre]] taught_deg", *value, value.is_finite()));
        let mut all = scalars.into_iter().chain(backlash).chain(following).chain(centres).chain(taught);
        if let Some((key, value, _)) = all.find(|(_, _, is_possible)| !is_possible) {
            return Err(SimulationFinding::WorldNumber { key, value });
        }
        if !(low_mm < high_mm && low_mm.is_finite() && high_mm.is_finite()) {
            return Err(SimulationFinding::Stroke { low_mm, high_mm });
        }
        Ok(())
    }
}

/// A reading of the true bar.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrueReading {
    /// Reading, mm; longer is positive. Outside of the stroke, where a real bar would leave its cup, the end of the stroke.
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
    /// Repeatability error of the tool ball in the motion before and in this one, mm, which began at `since_s`.
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
    /// The true `robot` (its tool is the true tool ball) in a set-up; `seed` is that of noise and repeatability.
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
        // A ball without a known centre is out of the reach of the bar.
        let distance = centre.map_or(f64::INFINITY, |centre| (ball - centre).norm());
        let bar = self.setup.bar;
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
