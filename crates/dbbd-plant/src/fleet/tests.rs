//! Runs of many robots and bars together determine what none determines alone: the bar that was dropped, and the prior of a new
//! robot of a known type.

use super::{Assumptions, Fleet, RunPosterior, fleet};
use dbbd_model::diagnostic::Finding as _;
use dbbd_model::estimation::posterior::Posterior;
use dbbd_model::estimation::priors::Priors;
use dbbd_model::estimation::{AngleSource, ErrorModel, ErrorSummary, Input, Options, Prior, Workspace};
use dbbd_model::math::aligned_distances;
use dbbd_model::measurement::{BaseBall, LengthModel, Measurement, Measurements, PreparedMeasurement};
use dbbd_model::robot::{Approach, AxisAngles, BallId, Geometry, ParamId, PayloadId, Robot, parameter};
use nalgebra::{DMatrix, DVector, Vector3};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal, StandardNormal};
use rand_pcg::Pcg64;

use crate::cell::{CENTRE, kr60, poses, three_planes};

/// Standard deviation of a length, mm, and of a bar's offset, mm.
const NOISE_MM: f64 = 0.01;
const BAR_U_MM: f64 = 0.02;
/// Robots of a type differ by this share of the maker's tolerance, and types by more.
const WITHIN: f64 = 0.3;
const BETWEEN: f64 = 0.8;
/// What the dropped bar lost, mm, and when, days.
const DROP_MM: f64 = -0.06;
const DROP_DAY: f64 = 270.0;
const DRIFT: f64 = 0.1;
const ASSUMED: Assumptions = Assumptions { drift: DRIFT, bar_u_mm: BAR_U_MM };

/// A plant that is simulated.
struct World {
    rng: Pcg64,
    nominal: Robot,
    ids: Vec<ParamId>,
    tolerance: Vec<f64>,
    balls: Vec<BaseBall>,
    /// Axis angles, rad, with their ball.
    pool: Vec<([f64; 6], BallId)>,
    /// Offset and drift of each bar, mm and mm a year; the last one is dropped.
    bars: Vec<[f64; 2]>,
    /// Mean of each type, in tolerances.
    types: Vec<DVector<f64>>,
}

impl World {
    fn new(seed: u64, types: usize, bars: usize) -> Self {
        let mut rng = Pcg64::seed_from_u64(seed);
        let nominal = kr60();
        let all = parameter::all_parameters(&nominal.parallel_joints(), 2);
        let ids: Vec<ParamId> = all.into_iter().filter(|id| id.is_geometric()).collect();
        let priors = Priors::datasheet(&nominal, None);
        let tolerance = ids.iter().map(|id| priors.geometric(*id).unwrap()).collect();
        let centres = [CENTRE, [900.0, 700.0, 1100.0]];
        let balls = centres
            .iter()
            .enumerate()
            .map(|(at, centre)| BaseBall { id: BallId::at(at), position: Vector3::from(*centre) });
        let mut pool = Vec::new();
        for (at, centre) in centres.iter().enumerate() {
            for circle in three_planes(at + 1, *centre) {
                let found = poses(&nominal.geometry, &circle, 14, 25.0);
                pool.extend(found.into_iter().map(|axes| (axes.map(f64::to_radians), BallId::at(at))));
            }
        }
        let mut normal = |sd: f64| Normal::new(0.0, sd).unwrap().sample(&mut rng);
        let bars = (0..bars).map(|_| [normal(BAR_U_MM), normal(0.005)]).collect();
        let types = (0..types).map(|_| DVector::from_fn(ids.len(), |_, _| normal(BETWEEN))).collect();
        Self { rng, nominal, ids, tolerance, balls: balls.collect(), pool, bars, types }
    }

    fn normal(&mut self, sd: f64) -> f64 {
        Normal::new(0.0, sd).unwrap().sample(&mut self.rng)
    }

    fn robot(&mut self, kind: usize) -> DVector<f64> {
        let own: Vec<f64> = (0..self.ids.len()).map(|_| self.normal(WITHIN)).collect();
        &self.types[kind] + DVector::from_vec(own)
    }

    fn geometry(&self, errors: &DVector<f64>) -> Geometry {
        let mut geometry = self.nominal.geometry.clone();
        for ((id, error), sd) in self.ids.iter().zip(errors.iter()).zip(&self.tolerance) {
            *geometry.value_mut(*id).unwrap() += error * sd;
        }
        geometry
    }

    fn bar_mm(&self, bar: usize, day: f64) -> f64 {
        let [offset, drift] = self.bars[bar];
        let dropped = bar + 1 == self.bars.len() && day >= DROP_DAY;
        offset + drift * day / 365.25 + if dropped { DROP_MM } else { 0.0 }
    }

    /// Lengths at `count` poses of the pool.
    fn lengths(&mut self, truth: &Geometry, count: usize, bar_mm: f64) -> Vec<PreparedMeasurement> {
        let mut left = self.pool.clone();
        (0..count)
            .map(|_| {
                let (axes, ball) = left.swap_remove(self.rng.random_range(0..left.len()));
                let true_mm = truth.length(&axes, &self.balls[ball.index()].position, bar_mm);
                PreparedMeasurement::new(axes, ball, true_mm + self.normal(NOISE_MM))
            })
            .collect()
    }

    /// The robot's parameters, then tool, balls and bar.
    fn with_setup(&self) -> Vec<ParamId> {
        let setup = parameter::all_parameters(&[], 2)
            .into_iter()
            .filter(|id| !id.is_geometric() && !id.is_optional());
        self.ids.iter().copied().chain(setup).collect()
    }

    /// A run as its identification leaves it: the maker's tolerance is the prior, tool, balls and bar are free.
    fn run(&mut self, robot: &str, kind: usize, errors: &DVector<f64>, bar: usize, day: f64) -> RunPosterior {
        let truth = self.geometry(errors);
        let lengths = self.lengths(&truth, 24, self.bar_mm(bar, day));
        let start = LengthModel::new(self.nominal.geometry.clone(), &self.balls);
        let all = self.with_setup();
        let priors = Priors::datasheet(&self.nominal, None);
        let sd: Vec<f64> = all.iter().map(|id| priors.geometric(*id).unwrap_or(10.0)).collect();
        let found = Posterior::new(start.clone(), &all, &sd).learn(&lengths, NOISE_MM).unwrap();
        RunPosterior {
            robot: robot.into(),
            kind: format!("type {kind}"),
            bar: format!("bar {bar}"),
            day,
            corrections: DVector::from_iterator(
                all.len(),
                all.iter().map(|id| found.model.value(*id) - start.value(*id)),
            ),
            covariance: found.covariance(),
            prior: sd.into_iter().map(Some).collect(),
            ids: all,
        }
    }

    /// Every robot with its errors at the first run, and all runs.
    fn plant(
        &mut self,
        robots: usize,
        runs: usize,
        crash_every: usize,
    ) -> (Vec<DVector<f64>>, Vec<RunPosterior>) {
        let (mut first, mut found) = (Vec::new(), Vec::new());
        for robot in 0..robots {
            let kind = robot % self.types.len();
            let mut errors = self.robot(kind);
            first.push(errors.clone());
            let crash = if robot % crash_every == crash_every - 1 {
                self.rng.random_range(1..runs)
            } else {
                usize::MAX
            };
            for run in 0..runs {
                let days = 730.0 / runs as f64;
                if run > 0 {
                    for at in 0..errors.len() {
                        errors[at] += self.normal(DRIFT * (days / 365.25).sqrt());
                    }
                }
                if run == crash {
                    let theta = self.ids.iter().position(|id| id.to_string() == "theta3").unwrap();
                    errors[theta] += 4.0;
                }
                // Robots and bars meet at random: a bar goes from cell to cell.
                let (bar, day) = (self.rng.random_range(0..self.bars.len()), days * run as f64);
                let name = format!("R{robot:03}");
                found.push(self.run(&name, kind, &errors, bar, day));
            }
        }
        (first, found)
    }

    /// Mean 3-D error of an identified robot after a rigid motion, mm.
    fn error_mm(&mut self, truth: &Geometry, found: &Geometry) -> f64 {
        let limits = self.nominal.limits_deg;
        let poses: Vec<[f64; 6]> = (0..200)
            .map(|_| limits.map(|[low, high]| self.rng.random_range(low..high).to_radians()))
            .collect();
        let places =
            |geometry: &Geometry| poses.iter().map(|axes| geometry.ball(axes).position).collect::<Vec<_>>();
        let apart = aligned_distances(&places(truth), &places(found));
        apart.iter().sum::<f64>() / apart.len() as f64
    }

    fn measured(&mut self, truth: &Geometry, count: usize, bar_mm: f64) -> Measurements {
        let lengths = self.lengths(truth, count, bar_mm);
        let rows = lengths.iter().enumerate().map(|(at, one)| Measurement {
            index: at as u32 + 1,
            datum: one.datum,
            target: one.target,
            axes: AxisAngles::from_degrees(one.axes.map(f64::to_degrees)),
            approach: Approach::default(),
            length_mm: one.length_mm,
            sigma_mm: Some(NOISE_MM),
            payload: PayloadId::FIRST,
            context: None,
        });
        Measurements { rows: rows.collect(), ..Measurements::default() }
    }
}

/// The offset of the dropped bar before and the change, each within so many standard deviations.
fn dropped_bar_is_named(world: &World, found: &Fleet, most: f64) {
    for (at, bar) in found.bars.iter().enumerate() {
        let is_dropped = bar.bar == format!("bar {}", world.bars.len() - 1);
        let at = bar.bar.strip_prefix("bar ").map_or(at, |number| number.parse().unwrap());
        assert_eq!(bar.jumps.len(), usize::from(is_dropped), "{bar:?}");
        for jump in &bar.jumps {
            let off = (jump.change_mm.value - DROP_MM).abs();
            assert!(off < most * jump.change_mm.sd, "{jump:?}");
            assert!(jump.after_day <= DROP_DAY && DROP_DAY <= jump.before_day, "{jump:?}");
        }
        let off = (bar.offset_mm.value - world.bars[at][0]).abs();
        assert!(off < most * bar.offset_mm.sd, "{bar:?}: {}", world.bars[at][0]);
    }
}

/// How many numbers there are, and how many of them are in their intervals of 95 %.
#[derive(Default)]
struct Covered {
    inside: usize,
    all: usize,
}

impl Covered {
    fn add(&mut self, is_inside: bool) {
        self.inside += usize::from(is_inside);
        self.all += 1;
    }

    fn share(&self) -> f64 {
        self.inside as f64 / self.all as f64
    }
}

/// The parameters of robots, the offsets of bars at the first run and at the last one.
#[derive(Default)]
struct Coverage {
    robots: Covered,
    offsets: Covered,
    now: Covered,
}

impl Coverage {
    fn add(&mut self, world: &World, found: &Fleet, first: &[DVector<f64>], last_day: f64) {
        for robot in &found.robots {
            let truth = &first[robot.robot[1..].parse::<usize>().unwrap()];
            let ids = &found.types.iter().find(|kind| kind.kind == robot.kind).unwrap().ids;
            for (at, id) in ids.iter().enumerate() {
                let own = world.ids.iter().position(|other| other == id).unwrap();
                let off = (robot.corrections[at] - truth[own] * world.tolerance[own]).abs();
                self.robots.add(off <= 1.959_964 * robot.covariance[(at, at)].sqrt());
            }
        }
        for bar in &found.bars {
            let number = bar.bar[4..].parse::<usize>().unwrap();
            self.offsets.add(bar.offset_mm.covers(world.bars[number][0]));
            self.now.add(bar.offset_now_mm.covers(world.bar_mm(number, last_day)));
        }
    }

    /// Of plants with these seeds.
    fn of(seeds: std::ops::Range<u64>, [types, bars, robots, runs]: [usize; 4]) -> Self {
        let mut coverage = Self::default();
        for seed in seeds {
            let mut world = World::new(seed, types, bars);
            let (first, all) = world.plant(robots, runs, 10);
            let found = fleet(&all, &ASSUMED).unwrap();
            coverage.add(&world, &found, &first, all.iter().map(|run| run.day).fold(0.0, f64::max));
        }
        coverage
    }
}

/// Mean 3-D error, mm, of the best estimate from `count` poses of a robot whose parameters are known beforehand to this
/// share of the tolerance: the Bayesian bound, mean of ten draws of poses.
fn bound_mm(world: &mut World, known: f64, count: usize) -> f64 {
    const DRAWS: usize = 10;
    let ids = world.with_setup();
    let sd = |id: &ParamId| match (world.ids.iter().position(|own| own == id), id) {
        (Some(own), _) => known * world.tolerance[own],
        (None, ParamId::BarOffset(_)) => BAR_U_MM,
        (None, _) => 10.0,
    };
    let sd: Vec<f64> = ids.iter().map(sd).collect();
    let geometry = world.nominal.geometry.clone();
    let prior = Posterior::new(LengthModel::new(geometry.clone(), &world.balls), &ids, &sd);
    let workspace = Workspace::new(&geometry, &Workspace::uniform(&world.nominal, 1000, 6), &ids);
    let drawn = DMatrix::from_fn(ids.len(), 100, |_, _| StandardNormal.sample(&mut world.rng));
    let mut mean_mm = || {
        let after = prior.after(&world.lengths(&geometry, count, 0.0), NOISE_MM).unwrap();
        ErrorSummary::of(&(workspace.jacobian() * after.root() * &drawn)).mean
    };
    (0..DRAWS).map(|_| mean_mm()).sum::<f64>() / DRAWS as f64
}

/// Mean 3-D errors of new robots: 20 poses and the type's prior, 80 poses and the maker's tolerance, 20 poses and that.
fn new_robots(world: &mut World, found: &Fleet, count: usize) -> [f64; 3] {
    let mut sums = [0.0; 3];
    for number in 0..count {
        let kind = number % world.types.len();
        let errors = world.robot(kind);
        let truth = world.geometry(&errors);
        let known = found.types[kind].robot(&world.nominal).unwrap();
        let nominal = world.nominal.clone();
        let bar_mm = world.normal(BAR_U_MM);
        for (at, (robot, poses, prior)) in [
            (&known, 20, Prior::Posterior),
            (&nominal, 80, Prior::Datasheet),
            (&nominal, 20, Prior::Datasheet),
        ]
        .into_iter()
        .enumerate()
        {
            let lengths = world.measured(&truth, poses, bar_mm);
            let options = Options {
                prior,
                model: ErrorModel::Geometric,
                folds: Some(0),
                bar_u_mm: Some(BAR_U_MM),
                ..Options::default()
            };
            let start = LengthModel::new(robot.geometry.clone(), &world.balls);
            let axes = AngleSource::Given;
            let input = Input {
                robot,
                observations: &lengths,
                start: &start,
                validation: None,
                options: &options,
                axes,
            };
            let identified = input.fit().unwrap();
            sums[at] += world.error_mm(&truth, &identified.geometry) / count as f64;
        }
    }
    sums
}

#[test]
fn a_dropped_bar_is_found_and_a_known_type_needs_fewer_poses() {
    let mut world = World::new(7, 1, 3);
    let (_, runs) = world.plant(6, 8, 6);
    let found = fleet(&runs, &ASSUMED).unwrap();
    assert_eq!((found.unusable, found.robots.len(), found.types[0].robots), (0, 6, 6));
    dropped_bar_is_named(&world, &found, 4.0);
    // How long all bars are, only their certificates say: robots of an unknown type that are larger look the same.
    let of_certificates_mm = BAR_U_MM / (found.bars.len() as f64).sqrt();
    assert!(found.bars.iter().all(|bar| bar.offset_mm.sd > 0.95 * of_certificates_mm));
    let crashed: Vec<&str> = found
        .robots
        .iter()
        .filter(|robot| !robot.crashes.is_empty())
        .map(|robot| robot.robot.as_str())
        .collect();
    assert_eq!(crashed, ["R005"]);
    let mut codes: Vec<&str> = found.findings().iter().map(|finding| finding.code().as_str()).collect();
    codes.dedup();
    assert_eq!(codes, ["W2416"]);
    let [known, _, unknown] = new_robots(&mut world, &found, 1);
    assert!(known < unknown, "{known} mm, {unknown} mm");
    // The same runs in another order are the same plant.
    let again = fleet(&runs.iter().rev().cloned().collect::<Vec<_>>(), &ASSUMED).unwrap();
    assert_eq!(again.bars[0].offset_mm, found.bars[0].offset_mm);
}

/// The bars share the error of what only their certificates say: how long all of them are.
#[test]
fn intervals_of_robots_and_bars_cover() {
    let coverage = Coverage::of(200..210, [1, 3, 6, 5]);
    let [robots, offsets, now] =
        [coverage.robots, coverage.offsets, coverage.now].map(|covered| covered.share());
    assert!((0.93..=0.985).contains(&robots), "{robots}");
    // Ten plants of three bars, which are off together.
    assert!(offsets >= 0.8 && now >= 0.8, "{offsets} {now}");
}

/// `cargo test --release coverage_of_400 -- --ignored --nocapture`
#[test]
#[ignore = "minutes: the figures of docs/evidence/README.md"]
fn coverage_of_400_plants() {
    let coverage = Coverage::of(10_000..10_400, [4, 12, 40, 8]);
    for (name, covered) in
        [("robots", coverage.robots), ("bars", coverage.offsets), ("bars now", coverage.now)]
    {
        eprintln!("{name}: {:.4} of {} covered", covered.share(), covered.all);
        assert!((0.92..=0.99).contains(&covered.share()), "{name}");
    }
}

/// `cargo test --release fleet_of_200 -- --ignored --nocapture`
#[test]
#[ignore = "minutes: the figures of docs/evidence/README.md"]
fn fleet_of_200_robots() {
    let mut world = World::new(1, 4, 12);
    let (first, runs) = world.plant(200, 25, 10);
    let found = fleet(&runs, &ASSUMED).unwrap();
    for bar in &found.bars {
        eprintln!("{}: {:?} drift {:?} jumps {:?}", bar.bar, bar.offset_mm, bar.drift_mm_a_year, bar.jumps);
    }
    let crashed = found.robots.iter().filter(|robot| !robot.crashes.is_empty()).count();
    let mut coverage = Coverage::default();
    coverage.add(&world, &found, &first, 730.0 * 24.0 / 25.0);
    let (robots, bars) = (coverage.robots.share(), coverage.offsets.share());
    eprintln!("{} runs; {crashed} robots crashed; covered: robots {robots:.4}, bars {bars:.3}", runs.len());
    let [known, many, unknown] = new_robots(&mut world, &found, 200);
    eprintln!(
        "3-D error, mean of 200: prior of the type and 20 poses {known:.4} mm, tolerance and 80 poses {many:.4} mm, tolerance and 20 poses {unknown:.4} mm"
    );
    assert!(robots > 0.92 && known < 0.49 && many < 0.21 && 2.0 * known < unknown, "{robots} {known} {many}");
    for known in [0.1, WITHIN, WITHIN.hypot(BETWEEN)] {
        let bounds = [10, 20, 30, 40, 60, 80].map(|count| (count, bound_mm(&mut world, known, count)));
        eprintln!("bound, parameters known to {known:.2} tolerances: {bounds:.3?}");
    }
    dropped_bar_is_named(&world, &found, 4.0);
}
