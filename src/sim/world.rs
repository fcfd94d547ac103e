//! The world around the simulated controller: the true robot, the true balls, the bar.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Vector3;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use serde::Deserialize;

use super::Moment;
use crate::base::parse::from_toml;
use crate::catalogue::SimulationFinding;
use crate::diagnostic::Diagnostic;
use crate::program::Equipped;
use crate::robot::{AXES, Geometry};

/// The repeatability error of a motion replaces that of the one before within so long, s: no robot jumps.
const REPLACED_S: f64 = 0.2;

/// What is true: WORLD.toml over what the program's `.dat` files say.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// True centre of each base ball in the robot base, mm, by its number.
    pub centres_mm: BTreeMap<u32, [f64; 3]>,
    /// Axis angles, degrees, at which the true tool ball stood where a base ball then was fixed; that is its centre.
    pub taught_deg: BTreeMap<u32, [f64; AXES]>,
    pub bar: Bar,
    /// Standard deviation of each coordinate of the tool ball, drawn anew for each motion, micrometres.
    pub repeatability_um: f64,
    /// Play of each axis, degrees: the true axis lags half of it behind the direction of its last move.
    pub backlash_deg: [f64; AXES],
    /// Time constant with which each axis follows its command, ms: in motion it is behind by its speed times this.
    pub following_ms: [f64; AXES],
}

/// The true ball-bar.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bar {
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
#[serde(deny_unknown_fields)]
struct WorldFile {
    /// `[[centre]]`: true centres of base balls, or how they were taught; those not given are where the program has them.
    #[serde(default)]
    centre: Vec<CentreTable>,
    #[serde(default)]
    bar: BarTable,
    /// As [`Setup::repeatability_um`]; default 0.
    #[serde(default)]
    repeatability_um: f64,
    /// As [`Setup::backlash_deg`]; default 0 for all.
    #[serde(default)]
    backlash_deg: [f64; AXES],
    /// As [`Setup::following_ms`]; default 0 for all.
    #[serde(default)]
    following_ms: [f64; AXES],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CentreTable {
    id: u32,
    /// The true centre, mm; or else
    xyz_mm: Option<[f64; 3]>,
    /// the controller's axis angles, degrees, at which the true tool ball was put on it.
    taught_deg: Option<[f64; AXES]>,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct BarTable {
    /// Default: the program's.
    length_mm: Option<f64>,
    /// Default: the program's.
    stroke_mm: Option<[f64; 2]>,
    /// Default 1.
    noise_um: Option<f64>,
    /// Default 0.1.
    resolution_um: Option<f64>,
    /// Default 200.
    rate_hz: Option<f64>,
    /// Default 20.
    temperature_c: Option<f64>,
}

impl Setup {
    /// What `world` (a file's name and its text) says, and for the rest what the program's `.dat` files say.
    pub fn new(program: &impl Equipped, world: Option<(&str, &str)>) -> Result<Self, Diagnostic> {
        let (name, text) = world.unwrap_or(("WORLD.toml", ""));
        let file: WorldFile = from_toml(name, text)?;
        Self::of(&program.setups(), file).map_err(|finding| Diagnostic::file(name, finding))
    }

    fn of(setups: &[crate::program::Setup], file: WorldFile) -> Result<Self, SimulationFinding> {
        let mut centres_mm: BTreeMap<u32, [f64; 3]> =
            setups.iter().map(|setup| (setup.ball, setup.centre_mm)).collect();
        // A program that names no ball is about the first.
        let balls: BTreeSet<u32> =
            if setups.is_empty() { [1].into() } else { centres_mm.keys().copied().collect() };
        let mut given = BTreeSet::new();
        let mut taught_deg = BTreeMap::new();
        for CentreTable { id: ball, xyz_mm, taught_deg: axes_deg } in file.centre {
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
            bar: Bar {
                length_mm: length_mm.ok_or_else(|| missing("length_mm"))?,
                stroke_mm: stroke_mm.ok_or_else(|| missing("stroke_mm"))?,
                noise_um: file.bar.noise_um.unwrap_or(1.0),
                resolution_um: file.bar.resolution_um.unwrap_or(0.1),
                rate_hz: file.bar.rate_hz.unwrap_or(200.0),
                temperature_c: file.bar.temperature_c.unwrap_or(20.0),
            },
            repeatability_um: file.repeatability_um,
            backlash_deg: file.backlash_deg,
            following_ms: file.following_ms,
        };
        setup.check()?;
        Ok(setup)
    }

    /// # Errors
    /// A number that cannot be.
    pub fn check(&self) -> Result<(), SimulationFinding> {
        let Bar { length_mm, stroke_mm: [low_mm, high_mm], noise_um, resolution_um, rate_hz, temperature_c } =
            self.bar;
        let zero_or_more = |value: f64| (0.0..1e6).contains(&value);
        let scalars = [
            ("[bar] noise_um", noise_um, zero_or_more(noise_um)),
            ("[bar] resolution_um", resolution_um, zero_or_more(resolution_um)),
            ("repeatability_um", self.repeatability_um, zero_or_more(self.repeatability_um)),
            ("[bar] length_mm", length_mm, length_mm > 0.0 && length_mm.is_finite()),
            ("[bar] rate_hz", rate_hz, (0.1..=100_000.0).contains(&rate_hz)),
            ("[bar] temperature_c", temperature_c, temperature_c.is_finite()),
        ];
        let play = self.backlash_deg.iter().map(|play| ("backlash_deg", *play, zero_or_more(*play)));
        let play = play.chain(self.following_ms.iter().map(|ms| ("following_ms", *ms, zero_or_more(*ms))));
        let centres = self.centres_mm.values().flatten();
        let centres = centres.map(|value| ("[[centre]] xyz_mm", *value, value.is_finite()));
        let taught = self.taught_deg.values().flatten();
        let taught = taught.map(|value| ("[[centre]] taught_deg", *value, value.is_finite()));
        let mut all = scalars.into_iter().chain(play).chain(centres).chain(taught);
        if let Some((key, value, _)) = all.find(|(_, _, good)| !good) {
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
pub struct Measured {
    /// Reading, mm; longer is positive. Out of the stroke, where a real bar would leave its cup, it is the stroke's end.
    pub reading_mm: f64,
    pub in_stroke: bool,
}

/// The true robot with the bar on it.
#[derive(Clone, Debug)]
pub struct World {
    robot: Geometry,
    setup: Setup,
    random: Pcg64,
    /// The motion for which `offset` was drawn.
    motion: Option<u32>,
    /// Repeatability error of the tool ball in the motion before and in this one, mm, and since when, s.
    offsets: [Vector3<f64>; 2],
    since_s: f64,
    /// Last commanded axis angles, and which way each moved last.
    last: Option<[f64; AXES]>,
    direction: [f64; AXES],
    follower: Option<Follower>,
}

/// Where the axes are that follow their commands, and the commands at that time.
#[derive(Clone, Copy, Debug)]
struct Follower {
    t_s: f64,
    commanded: [f64; AXES],
    axes: [f64; AXES],
}

impl World {
    /// The true `robot` (its tool is the true tool ball) in a set-up; `seed` draws noise and repeatability.
    pub fn new(robot: Geometry, mut setup: Setup, seed: u64) -> Self {
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
            follower: None,
        }
    }

    /// The axes as the encoders measure them, rad; moments come in order.
    pub fn measured(&mut self, moment: &Moment) -> [f64; AXES] {
        let Moment { t_s, axes: commanded, .. } = *moment;
        let before = self.follower.unwrap_or(Follower { t_s, commanded, axes: commanded });
        let dt_s = t_s - before.t_s;
        let axes = std::array::from_fn(|i| {
            let lag_s = self.setup.following_ms[i] * 1e-3;
            if lag_s <= 0.0 || dt_s <= 0.0 {
                return if lag_s <= 0.0 { commanded[i] } else { before.axes[i] };
            }
            // A first-order lag under a command that goes straight from the one before to this.
            let behind = (commanded[i] - before.commanded[i]) / dt_s * lag_s;
            let decays = (-dt_s / lag_s).exp();
            commanded[i] - behind + (before.axes[i] - before.commanded[i] + behind) * decays
        });
        self.follower = Some(Follower { t_s, commanded, axes });
        axes
    }

    pub fn setup(&self) -> &Setup {
        &self.setup
    }

    /// What the bar reads at rest at poses (axis angles, rad), each with the number of its base ball; each is reached by a
    /// motion of its own.
    pub fn readings(&mut self, poses: impl IntoIterator<Item = ([f64; AXES], u32)>) -> Vec<Measured> {
        let at_rest = |(motions, (axes, centre)): (u32, ([f64; AXES], u32))| {
            let t_s = 2.0 * REPLACED_S * f64::from(motions);
            let begins = Moment { t_s, axes, centre, strobe: false, motions, halted: false, done: false };
            self.reading(&begins);
            self.reading(&Moment { t_s: t_s + REPLACED_S, strobe: true, ..begins })
        };
        (1..).zip(poses).map(at_rest).collect()
    }

    /// What the bar reads at a moment; moments come in order.
    pub fn reading(&mut self, moment: &Moment) -> Measured {
        if self.motion != Some(moment.motions) {
            self.motion = Some(moment.motions);
            let sd_mm = self.setup.repeatability_um * 1e-3;
            self.offsets = [self.offset(moment.t_s), Vector3::from_fn(|_, _| sd_mm * self.normal())];
            self.since_s = moment.t_s;
        }
        let axes = self.true_axes(moment);
        let ball = self.robot.ball(&axes).position + self.offset(moment.t_s);
        let centre = self.setup.centres_mm.get(&moment.centre).copied().map(Vector3::from);
        // A ball whose place is not known is out of the bar's reach.
        let distance = centre.map_or(f64::INFINITY, |centre| (ball - centre).norm());
        let bar = self.setup.bar;
        let reading_mm = distance - bar.length_mm;
        let noise_mm = bar.noise_um * 1e-3 * self.normal();
        let [low, high] = bar.stroke_mm;
        if !(low..=high).contains(&reading_mm) {
            return Measured { reading_mm: reading_mm.clamp(low, high), in_stroke: false };
        }
        let noisy = reading_mm + noise_mm;
        let step_mm = bar.resolution_um * 1e-3;
        let reading_mm = if step_mm > 0.0 { (noisy / step_mm).round() * step_mm } else { noisy };
        Measured { reading_mm, in_stroke: true }
    }

    /// Repeatability error at a time, mm.
    fn offset(&self, t_s: f64) -> Vector3<f64> {
        let share = ((t_s - self.since_s) / REPLACED_S).clamp(0.0, 1.0);
        self.offsets[0].lerp(&self.offsets[1], share * share * (3.0 - 2.0 * share))
    }

    /// The axes behind their play.
    fn true_axes(&mut self, moment: &Moment) -> [f64; AXES] {
        // Play is in the joints' drives.
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
