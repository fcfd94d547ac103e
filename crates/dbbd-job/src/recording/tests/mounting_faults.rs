//! A badly mounted bar is detected while it is recorded, and a well-mounted one gives no alarm.
//!
//! The simulated controller runs the program of a plan; hands, vibration and warming are added to the true lengths.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use dbbd_job::plan::{Job, Plan};
use dbbd_job::program::krl::{Controller as Dialect, Options, Program, Sync, emit};
use dbbd_job::recording::mounting::{
    DetectedFault, ExpectedMounting, MountedReading, MountingFault, MountingMonitor, RestCondition,
};
use dbbd_job::sim::fault::InjectedFaults;
use dbbd_job::sim::mounting::SimulatedMounting;
use dbbd_job::sim::world::WorldSetup;
use dbbd_job::sim::{ControllerMoment, SimulatedController, World, truth};
use dbbd_model::diagnostic::Finding;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::test_support::cell::kr60;

const RATE_HZ: f64 = 200.0;
/// Limit for the detection of a fault, s.
const WITHIN_S: f64 = 2.0;
/// Hands are on the bar for this time after the robot halts, s.
const HANDS_S: f64 = 3.0;

const JOB: &str = "robot = \"kr60ha\"\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = 300.0\nstroke_mm = [-5.0, 5.0]\nmargin_mm = 0.5\nsigma_um = 2.0\n\
    [[centre]]\nid = 1\nxyz_mm = [1300.0, 0.0, 800.0]\n\
    [[circle]]\nplane = \"XY\"\npoints = 12\norientation = \"seed\"\namplitude_deg = 25.0\ntilt_deg = 30.0\n\
    [[circle]]\nplane = \"XZ\"\npoints = 12\norientation = \"seed\"\namplitude_deg = 25.0\ntilt_deg = 30.0\nstart_deg = -18.0\n\
    arc_deg = 216.0\n[motion]\nsettle_s = 0.4\ndwell_s = 0.5\n";

/// A cell with its bar.
struct Cell {
    controller: SimulatedController,
    world: World,
    mounting: SimulatedMounting,
    dice: Pcg64,
    halt_s: f64,
    halted_s: Option<f64>,
    /// The last time, and since when the robot is at rest.
    last: Option<ControllerMoment>,
    rests_s: f64,
    hands_mm: f64,
}

/// The reading of the bar at a moment.
struct Now {
    reading: MountedReading,
    done: bool,
}

impl Cell {
    fn new(plan: &Plan, program: &Program, seed: u64, halt_s: f64, faults: InjectedFaults) -> Self {
        let nominal = kr60();
        let mut dice = Pcg64::seed_from_u64(seed);
        let mut setup = WorldSetup::new(&program.setups(), None).unwrap();
        setup.taught_deg = plan.header.taught.iter().map(|ball| (ball.centre, ball.axes_deg)).collect();
        setup.bar.noise_um = dice.random_range(0.5..2.0);
        setup.repeatability_um = 20.0;
        setup.bar.rate_hz = RATE_HZ;
        Self {
            controller: SimulatedController::new(program.clone(), &nominal, 100.0).unwrap(),
            world: World::new(truth::draw_true_robot(&nominal, seed, 1.0).geometry, setup, seed),
            mounting: SimulatedMounting::new(faults, seed),
            hands_mm: dice.random_range(0.5..2.0),
            dice,
            halt_s,
            halted_s: None,
            last: None,
            rests_s: 0.0,
        }
    }

    fn next(&mut self) -> Now {
        let moment = self.controller.step(1.0 / RATE_HZ).unwrap();
        let t_s = moment.t_s;
        if moment.halted {
            let since_s = *self.halted_s.get_or_insert(t_s);
            if t_s - since_s >= self.halt_s {
                self.controller.go_on();
            }
        }
        let rests = self.last.is_some_and(|last| last.axes == moment.axes);
        if !rests {
            self.rests_s = t_s;
        }
        let measured = self.world.reading(&moment);
        let within = measured.in_stroke;
        let handled = self.halted_s.is_none_or(|since_s| t_s - since_s < HANDS_S);
        let mounted = within && !handled;
        let mut extra_mm = self.mounting.offset_mm(t_s, mounted, moment.strobe);
        // The drives shake the bar while the robot moves, and for a moment after.
        let rested_s = t_s - self.rests_s;
        let shaken_um = if rests { 10.0 * (-rested_s / 0.1).exp() } else { 3.0 };
        extra_mm += 1e-3 * shaken_um * (TAU * 12.0 * if rests { rested_s } else { t_s }).sin();
        // The bar warms by 1 micrometre per minute.
        extra_mm += t_s / 60e3;
        if handled {
            let wobble = (TAU * 1.3 * t_s).sin() + 0.5 * (TAU * 3.1 * t_s).sin();
            extra_mm += self.hands_mm * wobble + 0.1 * self.dice.random_range(-1.0..1.0);
        }
        self.last = Some(moment);
        let reading_mm = measured.reading_mm + extra_mm;
        let reading = MountedReading { t_s, reading_mm, mounted: within, strobe: Some(moment.strobe) };
        Now { reading, done: moment.done }
    }
}

fn prepared() -> (Plan, Program) {
    let plan = Plan::build(&Job::from_toml("job.toml", JOB).unwrap(), &kr60()).unwrap();
    let files = emit(&plan, Options { sync: Sync::Output, controller: Dialect::Krc4 }).unwrap();
    let program = crate::test_support::krl::program(&files);
    (plan, program)
}

fn monitor(plan: &Plan) -> MountingMonitor {
    MountingMonitor::new(ExpectedMounting::of(plan, RestCondition::Program))
}

/// The first detected fault, and its delay.
fn first_named(plan: &Plan, mut cell: Cell, until_s: f64) -> Option<(DetectedFault, f64)> {
    let mut monitor = monitor(plan);
    loop {
        let Now { reading, done } = cell.next();
        if let Some(named) = monitor.push(reading) {
            return Some((named, named.t_s - cell.mounting.onset_s()?));
        }
        if done || reading.t_s > until_s {
            return None;
        }
    }
}

/// A fault of a size drawn between two, micrometres, and how long the program waits at HALT, s.
fn faults(fault: MountingFault, seed: u64) -> (InjectedFaults, f64) {
    let mut dice = Pcg64::seed_from_u64(seed ^ 0xfa);
    let mut size = |low: f64, high: f64| {
        let um: f64 = dice.random_range(low..high);
        if dice.random_range(0..2) == 0 { um } else { -um }
    };
    let none = InjectedFaults::default();
    let waits = HANDS_S + 5.0;
    match fault {
        MountingFault::NotSeated => (InjectedFaults { unseated_um: size(20.0, 100.0).abs(), ..none }, waits),
        MountingFault::Creep => (InjectedFaults { creep_um: size(120.0, 500.0), ..none }, waits),
        MountingFault::Slip => (InjectedFaults { slip_um: size(60.0, 300.0), ..none }, waits),
        // Every second one before the program begins, the others at a dwell.
        _ => (
            InjectedFaults { cable_um: size(30.0, 150.0), ..none },
            if seed.is_multiple_of(2) { 40.0 } else { waits },
        ),
    }
}

const FAULTS: [MountingFault; 4] =
    [MountingFault::NotSeated, MountingFault::Creep, MountingFault::Slip, MountingFault::CablePull];

/// Number of faults detected in time, and the slowest of these, s.
fn named_in_time(fault: MountingFault, seeds: std::ops::Range<u64>) -> (usize, f64) {
    let (plan, program) = prepared();
    let (mut in_time, mut slowest_s) = (0, 0.0_f64);
    let mut others: BTreeMap<String, u32> = BTreeMap::new();
    for seed in seeds {
        let (faults, halt_s) = faults(fault, seed);
        let cell = Cell::new(&plan, &program, seed, halt_s, faults);
        match first_named(&plan, cell, 90.0) {
            Some((named, after_s)) if named.fault == fault && after_s <= WITHIN_S => {
                in_time += 1;
                slowest_s = slowest_s.max(after_s);
            }
            other => {
                eprintln!("seed {seed}, {faults:?}: {other:?}");
                *others.entry(format!("{:?}", other.map(|(named, _)| named.fault))).or_default() += 1;
            }
        }
    }
    eprintln!("{fault:?}: {in_time} in time, slowest {slowest_s:.2} s, others {others:?}");
    (in_time, slowest_s)
}

/// All faults reported in a number of hours of normal running.
fn false_alarms(hours: f64) -> Vec<DetectedFault> {
    let (plan, program) = prepared();
    let (mut passed_s, mut seed, mut named) = (0.0, 1000, Vec::new());
    while passed_s < hours * 3600.0 {
        let mut cell = Cell::new(&plan, &program, seed, HANDS_S + 5.0, InjectedFaults::default());
        let mut monitor = monitor(&plan);
        loop {
            let Now { reading, done } = cell.next();
            if let Some(one) = monitor.push(reading) {
                eprintln!("seed {seed}: {one:?}");
                named.push(one);
            }
            if done {
                passed_s += reading.t_s;
                break;
            }
        }
        seed += 1;
    }
    eprintln!("{} false alarms in {:.1} h", named.len(), passed_s / 3600.0);
    named
}

#[test]
fn mounting_faults_are_detected_without_false_alarms() {
    for fault in FAULTS {
        let (in_time, _) = named_in_time(fault, 0..4);
        assert_eq!(in_time, 4, "{fault:?}");
    }
    assert_eq!(false_alarms(0.05), []);
}

/// `OPT=1`-like speed is needed: `cargo test --release mounting_campaign -- --ignored --nocapture`.
#[test]
#[ignore = "a campaign of minutes"]
fn mounting_campaign() {
    for fault in FAULTS {
        assert!(named_in_time(fault, 0..100).0 >= 95, "{fault:?}");
    }
    assert!(false_alarms(30.0).len() < 3);
}

/// A step that stays, which no simulated fault causes.
#[test]
fn moved_ball_is_detected() {
    let mut monitor = MountingMonitor::new(ExpectedMounting::standing(2.0));
    let readings = (0..1600).map(|at| {
        let t_s = f64::from(at) / RATE_HZ;
        let reading_mm = if t_s < 4.0 { 0.0 } else { 0.2 };
        MountedReading { t_s, reading_mm, mounted: true, strobe: None }
    });
    let named: Vec<DetectedFault> = readings.filter_map(|reading| monitor.push(reading)).collect();
    assert_eq!(named.len(), 1, "{named:?}");
    assert_eq!(named[0].fault, MountingFault::Moved);
    assert!((named[0].size - 0.2).abs() < 0.01, "{named:?}");
    assert_eq!(named[0].finding().code().as_str(), "W0284");
}

/// A dwell of 3 s, in which the reading is off by 0.2 mm for 0.2 s: at the strobe the robot rests, and the speed of the program is no excuse.
#[test]
fn magnet_that_slips_in_a_dwell_is_named() {
    let (plan, _) = prepared();
    let mut monitor = monitor(&plan);
    let mut dice = Pcg64::seed_from_u64(5);
    let readings = (0..1600).map(|at| {
        let t_s = f64::from(at) / RATE_HZ;
        let off_mm = if (2.0..2.2).contains(&t_s) { 0.2 } else { 0.0 };
        let reading_mm = off_mm + 0.002 * dice.random_range(-1.0..1.0);
        MountedReading { t_s, reading_mm, mounted: true, strobe: Some((1.0..4.0).contains(&t_s)) }
    });
    let named: Vec<DetectedFault> = readings.filter_map(|reading| monitor.push(reading)).collect();
    assert_eq!(named.iter().map(|named| named.fault).collect::<Vec<_>>(), [MountingFault::Slip], "{named:?}");
    assert!((named[0].size - 0.2).abs() < 0.01, "{named:?}");
}
