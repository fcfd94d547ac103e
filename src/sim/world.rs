//! The world around the simulated controller: the true robot, the true balls, the bar.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Vector3;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use serde::Deserialize;

use super::Moment;
use crate::diag::Diagnostic;
use crate::krl::{Program, read_setup};
use crate::model::{AXES, Geometry};

/// What is true: WORLD.toml over what the program's `.dat` files say.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// True centre of each base ball in the robot base, mm, by its number.
    pub centres_mm: BTreeMap<u32, [f64; 3]>,
    /// Axis angles, degrees, at which the true tool ball stood where a base ball then was fixed; that is its centre.
    pub taught_deg: BTreeMap<u32, [f64; AXES]>,
    /// The bar.
    pub bar: Bar,
    /// Standard deviation of each coordinate of the tool ball, drawn anew for each motion, micrometres.
    pub repeatability_um: f64,
    /// Play of each axis, degrees: the true axis lags half of it behind the direction of its last move.
    pub backlash_deg: [f64; AXES],
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
    /// `[[centre]]`: true centres of base balls, or how they were taught; those not given stand where the program has them.
    #[serde(default)]
    centre: Vec<CentreTable>,
    /// `[bar]`
    #[serde(default)]
    bar: BarTable,
    /// As [`Setup::repeatability_um`]; default 0.
    #[serde(default)]
    repeatability_um: f64,
    /// As [`Setup::backlash_deg`]; default 0 for all.
    #[serde(default)]
    backlash_deg: [f64; AXES],
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
    ///
    /// # Errors
    /// What is wrong in the file, or what neither tells.
    pub fn new(program: &Program, world: Option<(&str, &str)>) -> Result<Self, Diagnostic> {
        let (name, text) = world.unwrap_or(("WORLD.toml", ""));
        let file: WorldFile = toml::from_str(text).map_err(|error| Diagnostic::toml(name, text, &error))?;
        let mut centres_mm = BTreeMap::new();
        let mut balls = BTreeSet::new();
        let mut first = None;
        for data in program.modules.iter().filter_map(|module| module.data.as_ref()) {
            if let Some(setup) = read_setup(data)? {
                balls.insert(setup.ball);
                centres_mm.insert(setup.ball, setup.centre_mm);
                first = first.or(Some(setup));
            }
        }
        if balls.is_empty() {
            balls.insert(1); // a program that names no ball is about the first
        }
        let mut given = BTreeSet::new();
        let mut taught_deg = BTreeMap::new();
        for centre in file.centre {
            if !given.insert(centre.id) {
                return Err(Diagnostic::file(name, format!("[[centre]]: ball {} is given twice", centre.id)));
            }
            match (centre.xyz_mm, centre.taught_deg) {
                (Some(xyz_mm), None) => _ = centres_mm.insert(centre.id, xyz_mm),
                (None, Some(axes_deg)) => _ = taught_deg.insert(centre.id, axes_deg),
                _ => {
                    let message = format!("[[centre]]: ball {} needs either xyz_mm or taught_deg", centre.id);
                    return Err(Diagnostic::file(name, message));
                }
            }
        }
        let unknown = |ball: &&u32| !centres_mm.contains_key(ball) && !taught_deg.contains_key(ball);
        if let Some(ball) = balls.iter().find(unknown) {
            let message =
                format!("nothing tells where ball {ball} is, neither the program's .dat nor the world");
            return Err(
                Diagnostic::file(name, message).help("give a [[centre]] with id and xyz_mm or taught_deg")
            );
        }
        let missing = |key: &str| {
            let message = format!("nothing tells the bar's {key}, neither the program's .dat nor the world");
            Diagnostic::file(name, message).help(format!("give [bar] {key}"))
        };
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
        };
        setup.check().map_err(|message| Diagnostic::file(name, message))?;
        Ok(setup)
    }

    fn check(&self) -> Result<(), String> {
        let Bar { length_mm, stroke_mm: [low, high], noise_um, resolution_um, rate_hz, temperature_c } =
            self.bar;
        let sizes = [("noise_um", noise_um), ("resolution_um", resolution_um)];
        let sizes = sizes.into_iter().chain([("repeatability_um", self.repeatability_um)]);
        let play = self.backlash_deg.into_iter().map(|play| ("backlash_deg", play));
        if let Some((key, value)) = sizes.chain(play).find(|(_, value)| !(0.0..1e6).contains(value)) {
            return Err(format!("{key} = {value} must be 0 or more"));
        }
        if !(length_mm > 0.0 && length_mm.is_finite()) {
            return Err(format!("[bar] length_mm = {length_mm} must be above 0"));
        }
        if !(low < high && low.is_finite() && high.is_finite()) {
            return Err(format!("[bar] stroke_mm = [{low}, {high}] must be [low, high]"));
        }
        if !(0.1..=100_000.0).contains(&rate_hz) {
            return Err(format!("[bar] rate_hz = {rate_hz} must be 0.1 to 100000"));
        }
        if !temperature_c.is_finite()
            || self
                .centres_mm
                .values()
                .flatten()
                .chain(self.taught_deg.values().flatten())
                .any(|value| !value.is_finite())
        {
            return Err("temperature and ball centres must be finite numbers".into());
        }
        Ok(())
    }
}

/// A reading of the true bar.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// Reading, mm; longer is positive. Out of the stroke it stands at the stroke's end.
    pub reading_mm: f64,
    /// Whether the balls' distance is inside the stroke.
    pub stroke: Stroke,
}

/// Where the balls' distance lies; out of its stroke a real bar would leave its cup.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stroke {
    /// Inside.
    Within,
    /// Too long.
    Over,
    /// Too short.
    Under,
}

/// The true robot with the bar on it.
#[derive(Clone, Debug)]
pub struct World {
    robot: Geometry,
    setup: Setup,
    random: Pcg64,
    /// The motion for which `offset` was drawn.
    motion: Option<u32>,
    /// Repeatability error of the tool ball, mm.
    offset: Vector3<f64>,
    /// Last commanded axis angles, and which way each moved last.
    last: Option<[f64; AXES]>,
    direction: [f64; AXES],
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
            offset: Vector3::zeros(),
            last: None,
            direction: [0.0; AXES],
        }
    }

    /// What is true.
    pub fn setup(&self) -> &Setup {
        &self.setup
    }

    /// What the bar reads at a moment; moments come in order.
    pub fn reading(&mut self, moment: &Moment) -> Measured {
        if self.motion != Some(moment.motions) {
            self.motion = Some(moment.motions);
            let sd_mm = self.setup.repeatability_um * 1e-3;
            self.offset = Vector3::from_fn(|_, _| sd_mm * self.normal());
        }
        let axes = self.true_axes(moment);
        let ball = self.robot.ball(&axes).position + self.offset;
        let centre = self.setup.centres_mm.get(&moment.centre).copied().map(Vector3::from);
        // A ball that nothing tells of is out of the bar's reach.
        let distance = centre.map_or(f64::INFINITY, |centre| (ball - centre).norm());
        let bar = self.setup.bar;
        let reading_mm = distance - bar.length_mm;
        let noise_mm = bar.noise_um * 1e-3 * self.normal();
        let [low, high] = bar.stroke_mm;
        if reading_mm > high {
            return Measured { reading_mm: high, stroke: Stroke::Over };
        }
        if reading_mm < low {
            return Measured { reading_mm: low, stroke: Stroke::Under };
        }
        let noisy = reading_mm + noise_mm;
        let step_mm = bar.resolution_um * 1e-3;
        let reading_mm = if step_mm > 0.0 { (noisy / step_mm).round() * step_mm } else { noisy };
        Measured { reading_mm, stroke: Stroke::Within }
    }

    /// The axes behind their play.
    fn true_axes(&mut self, moment: &Moment) -> [f64; AXES] {
        let mut axes = moment.axes;
        for i in 0..AXES {
            let moved = self.last.map_or(0.0, |last| moment.axes[i] - last[i]);
            if moved.abs() > 1e-9 {
                self.direction[i] = moved.signum();
            }
            axes[i] -= 0.5 * self.direction[i] * self.setup.backlash_deg[i].to_radians();
        }
        self.last = Some(moment.axes);
        axes
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.random)
    }
}
