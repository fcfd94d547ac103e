//! Stages from the maker's tolerance: a few safe poses, then more, until every pose is allowed; nothing leaves the stroke.

use std::process::Command;
use std::sync::OnceLock;

use dbbd_job::plan::PlanFinding;
use dbbd_job::plan::{Job, Plan, PlanningPrior, PoseKind};
use dbbd_job::program::krl::{self, Options, Program};
use dbbd_job::sim::world::WorldSetup;
use dbbd_job::sim::{SimulatedController, World, truth};
use dbbd_model::measurement::{Measurement, Measurements, PreparedMeasurement};
use dbbd_model::robot::Robot;
use tempfile::tempdir;

use crate::cell::{codes, kr60};

/// The example, with fewer candidates so that a thousand robots take minutes.
fn job() -> Job {
    let text =
        include_str!("../../examples/stages.toml").replace("points = 80", "points = 80\ncandidates = 1000");
    Job::from_toml("stages.toml", &text).unwrap()
}

/// A cell: the controller's robot, the true one, and the true world.
pub(crate) struct Cell {
    pub(crate) nominal: Robot,
    pub(crate) true_robot: Robot,
    pub(crate) world: String,
}

/// What the robot does with the program of a plan: the greatest |reading| while the bar was on, mm, and its lengths.
pub(crate) fn execute(plan: &Plan, cell: &Cell, seed: u64) -> (f64, Vec<PreparedMeasurement>) {
    let options = Options { sync: krl::Sync::Output, controller: krl::Controller::Krc4 };
    let files = krl::emit(plan, options).unwrap();
    let program = Program::open("DBB_MAIN", |wanted| {
        Ok(files.iter().find(|(name, _)| name.eq_ignore_ascii_case(wanted)).cloned())
    })
    .unwrap();
    let world = cell.world.replace("[bar]", "[bar]\nstroke_mm = [-50.0, 50.0]");
    let setup = WorldSetup::new(&program.setups(), Some(("world.toml", &world))).unwrap();
    let mut world = World::new(cell.true_robot.geometry.clone(), setup, seed);
    let mut controller = SimulatedController::new(program, &cell.nominal, 100.0).unwrap();
    let rows: Vec<_> = plan.rows.iter().filter(|row| row.kind != PoseKind::Transit).collect();
    let mut sums = vec![(0.0, 0.0); rows.len()];
    let (mut mounted, mut was, mut worst) = (false, false, 0.0_f64);
    loop {
        let moment = controller.step(0.1).unwrap();
        let reading = world.reading(&moment).reading_mm;
        if mounted {
            worst = worst.max(reading.abs());
        }
        if moment.halted {
            // The program halts for the bar to be mounted, and between two balls for it to be taken off.
            mounted = !mounted;
            controller.go_on();
        }
        if moment.strobe
            && let Some(sum) = sums.get_mut(controller.dwells() as usize)
        {
            // The pulses of the start mark come before the first dwell.
            *sum = if was { (sum.0 + reading, sum.1 + 1.0) } else { (reading, 1.0) };
        }
        was = moment.strobe;
        if moment.done {
            break;
        }
    }
    assert_eq!(controller.dwells() as usize, rows.len());
    let bar = &plan.header.job.bar;
    let lengths = rows.iter().zip(&sums).map(|(row, (sum, count))| PreparedMeasurement {
        length_mm: bar.length_mm + sum / count,
        ..row.reading(bar)
    });
    (worst, lengths.collect())
}

/// Readings as a table has them, measured one after the other.
pub(crate) fn table(readings: &[PreparedMeasurement]) -> Measurements {
    let rows = (1..).zip(readings).map(|(index, one)| Measurement::of_prepared(index, one)).collect();
    Measurements { rows, ..Measurements::default() }
}

/// What became of one robot.
#[derive(Debug)]
struct Staged {
    /// Plans until every pose was allowed.
    plans: usize,
    /// Greatest |reading| in each, mm.
    worst: Vec<f64>,
    /// Share of the poses that the last one still barred.
    barred: f64,
}

fn stages(seed: u64) -> Staged {
    static FIRST: OnceLock<Plan> = OnceLock::new();
    let (job, nominal) = (job(), kr60());
    let world = include_str!("../../examples/stages/world.toml").to_owned();
    let cell =
        Cell { true_robot: truth::draw_true_robot(&nominal, seed, 1.0), nominal: nominal.clone(), world };
    let first = FIRST.get_or_init(|| Plan::build(&job, &nominal).unwrap());
    let mut plan = first.clone();
    let (mut lengths, mut worst) = (Vec::new(), Vec::new());
    loop {
        let (most, measured) = execute(&plan, &cell, seed + 7919 * worst.len() as u64);
        worst.push(most);
        lengths.extend(measured);
        if plan.header.stage.is_none() || worst.len() == 6 {
            let share = |note: &PlanFinding| match note {
                PlanFinding::Barred { barred, reachable } => Some(*barred as f64 / *reachable as f64),
                _ => None,
            };
            let barred = plan.header.notes.iter().find_map(share).unwrap_or(0.0);
            return Staged { plans: worst.len(), worst, barred };
        }
        let prior = PlanningPrior::after_lengths(&job, &nominal, &table(&lengths)).unwrap();
        let (job, robot) = prior.applied(&job, &nominal);
        plan =
            Plan::build_with(&job, &robot, &prior).unwrap_or_else(|refused| panic!("seed {seed}: {refused}"));
    }
}

/// The shipped script runs the real program to its end, at most four stages from the tolerance.
#[test]
fn the_example_needs_few_stages() {
    let dir = tempdir().unwrap();
    let examples = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/stages/run.sh");
    let run = Command::new("sh")
        .args([examples, dir.path().to_str().unwrap()])
        .env("DBBD", env!("CARGO_BIN_EXE_dbbd"))
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&run.stdout);
    assert!(run.status.success(), "{said}{}", String::from_utf8_lossy(&run.stderr));
    // Every stage says what it excludes; the last plan may still exclude a few poses far from all that was measured.
    let narrow = codes(&run).iter().filter(|code| *code == "I0712").count();
    let stage = |stage: u32| dir.path().join(format!("stage{stage}/result/result.json")).is_file();
    assert!(stage(2) && !stage(5) && (2..=4).contains(&narrow), "{said}");
}

#[test]
fn robots_of_the_tolerance_keep_the_stroke() {
    for seed in 1..=2 {
        let staged = stages(seed);
        // The errors of joints, which nobody knows before, cost some robots a stage, or a few poses far from all that was measured.
        assert!(staged.plans <= 4 && staged.barred <= 0.01, "{staged:?}");
        assert!(staged.worst.iter().all(|worst| *worst < 1.0), "{staged:?}");
    }
}

/// `STAGES=1..1001 cargo test --release --test suite a_thousand_robots_in_stages -- --ignored --nocapture`
#[test]
#[ignore = "takes minutes"]
fn a_thousand_robots_in_stages() {
    let range = std::env::var("STAGES").unwrap_or("1..1001".into());
    let (first, past) = range.split_once("..").unwrap();
    let (first, past): (u64, u64) = (first.parse().unwrap(), past.parse().unwrap());
    let (mut outside, mut more, mut barred) = (0, 0, 0);
    let mut worst = vec![Vec::new(); 6];
    for seed in first..past {
        let staged = stages(seed);
        outside += usize::from(staged.worst.iter().any(|worst| *worst > 1.0));
        more += usize::from(staged.plans > 4);
        barred += usize::from(staged.barred > 0.01);
        staged.worst.iter().enumerate().for_each(|(at, mm)| worst[at].push(*mm));
        if staged.plans > 4 || staged.barred > 0.01 || staged.worst.iter().any(|worst| *worst > 1.0) {
            eprintln!("seed {seed}: {staged:.3?}");
        }
    }
    let p99 = |list: &mut Vec<f64>| {
        list.sort_by(f64::total_cmp);
        list.get((list.len() * 99) / 100).copied().unwrap_or(0.0)
    };
    let p99: Vec<f64> = worst.iter_mut().map(p99).collect();
    eprintln!(
        "{} robots: {outside} outside +-1 mm at some moment, {more} needed more than 4 plans, {barred} with more \
         than 1 % of the poses left barred; 99 % of the greatest |reading| per stage: {p99:.3?} mm",
        past - first
    );
    // Three runs, each with a risk of 1e-3: 3 robots of a thousand are expected, 10 or more with a probability of 1e-3.
    let robots = past - first;
    assert!(
        outside as u64 * 100 < robots && more as u64 * 20 < robots && barred == 0,
        "{outside} {more} {barred}"
    );
}
