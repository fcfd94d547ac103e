//! A run of another plan's program gives no lengths, and a run of the plan's own program is never refused.

use dbbd_job::plan::{Job, Plan};
use dbbd_job::recording::matching::{MatchingInput, PoseMatching, match_poses};
use dbbd_model::base::units::{DeviceTicks, HostNs};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::plan::job::{BaseBallTable, CircleDirection, OrientationPattern, PlaneAxes};
use crate::test_support::sync_runs::{Run, WORLD, World, run, stream};
use dbbd_model::robot::Robot;

/// Jobs with a circle, with few points, with circles about two balls, and with chosen poses.
const JOBS: [&str; 4] = [
    "[[circle]]\nplane = \"XY\"\npoints = 24\namplitude_deg = 20.0\ntilt_deg = 30.0\n",
    "[[circle]]\nplane = \"XY\"\npoints = 6\namplitude_deg = 20.0\ntilt_deg = 30.0\n",
    "[[centre]]\nid = 2\nxyz_mm = [1250.0, 300.0, 700.0]\n\
     [[circle]]\nplane = \"XY\"\npoints = 15\ntilt_deg = 30.0\namplitude_deg = 20.0\n\
     [[circle]]\ncentre = 2\nplane = \"XY\"\npoints = 15\ntilt_deg = 30.0\namplitude_deg = 15.0\n",
    "[optimise]\npoints = 14\ncandidates = 300\n",
];

fn job(tables: &str) -> Job {
    let text = format!(
        "robot = \"kr60ha\"\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = 300.0\nstroke_mm = [-8.0, 8.0]\nmargin_mm = 0.5\n\
         [[centre]]\nid = 1\nxyz_mm = [1300.0, 0.0, 800.0]\n{tables}"
    );
    Job::from_toml("job.toml", &text).unwrap()
}

fn robot() -> Robot {
    Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap()
}

/// Changes one key that moves a pose or its program. The amounts go down to a tenth of the smallest that a tape shows.
fn edit(job: &mut Job, robot: &mut Robot, rng: &mut Pcg64) -> &'static str {
    let size = 10_f64.powf(rng.random_range(-2.0..1.0)) * if rng.random_bool(0.5) { 1.0 } else { -1.0 };
    let balls = job.centres.len();
    let ball: &mut BaseBallTable = &mut job.centres[rng.random_range(0..balls)];
    let axis = rng.random_range(0..3);
    let circles = job.circles.len();
    let circle = (circles > 0).then(|| rng.random_range(0..circles)).and_then(|at| job.circles.get_mut(at));
    let motion = &mut job.motion;
    let common =
        ["xyz_mm", "length_mm", "ball_mm", "feed_mm_s", "turn_deg_s", "settle_s", "dwell_s", "base", "tool"];
    let of_circle = [
        "tilt_deg",
        "spin_deg",
        "amplitude_deg",
        "start_deg",
        "arc_deg",
        "radius_mm",
        "points",
        "plane",
        "direction",
        "orientation",
        "normal",
    ];
    let key = match circle {
        Some(_) => {
            [&common[..], &of_circle[..]].concat()[rng.random_range(0..common.len() + of_circle.len())]
        }
        None => [&common[..], &["optimise", "seed"]].concat()[rng.random_range(0..common.len() + 2)],
    };
    match (key, circle) {
        ("xyz_mm", _) => ball.xyz_mm[axis] += size,
        ("length_mm", _) => job.bar.length_mm += size,
        ("ball_mm", _) => robot.geometry.tool[axis] += size,
        ("feed_mm_s", _) => motion.feed_mm_s *= 0.9 + 0.02 * size.abs().min(4.0),
        ("turn_deg_s", _) => motion.turn_deg_s *= 0.9 + 0.02 * size.abs().min(4.0),
        ("settle_s", _) => motion.settle_s += 0.01 * size.abs(),
        ("dwell_s", _) => motion.dwell_s += 0.01 * size.abs(),
        ("base", _) => motion.base.get_or_insert_default()[axis] += size,
        ("tool", _) => motion.tool.get_or_insert_default()[3 + axis] += size,
        ("optimise", _) => job.optimise.as_mut().unwrap().points += 1,
        ("seed", _) => job.seed += 1,
        ("tilt_deg", Some(circle)) => circle.tilt_deg += size,
        ("spin_deg", Some(circle)) => circle.spin_deg += size,
        ("amplitude_deg", Some(circle)) => {
            circle.orientation = OrientationPattern::Seed;
            circle.amplitude_deg = Some(20.0 + size);
        }
        ("start_deg", Some(circle)) => circle.start_deg += size,
        ("arc_deg", Some(circle)) => circle.arc_deg -= 1.0 + size.abs(),
        ("radius_mm", Some(circle)) => circle.radius_mm = Some(300.0 + 0.5 * size),
        ("points", Some(circle)) => circle.points += 1,
        ("plane", Some(circle)) => circle.plane = Some(PlaneAxes::Xz),
        ("direction", Some(circle)) => circle.direction = CircleDirection::Cw,
        ("orientation", Some(circle)) => circle.orientation = OrientationPattern::Fixed,
        (_, Some(circle)) => {
            circle.plane = None;
            circle.normal = Some([0.01 * size, 0.0, 1.0]);
        }
        (key, None) => panic!("{key}"),
    }
    key
}

fn world(rng: &mut Pcg64) -> World {
    World {
        rate_hz: 250.0,
        noise_mm: rng.random_range(0.0002..0.002),
        swing_mm: rng.random_range(0.4..1.5),
        override_factor: rng.random_range(0.4..1.0),
        strobe: rng.random_bool(0.5),
        ..WORLD
    }
}

/// The program was stopped at a share of the first run, and started again.
fn started_again(first: Run, second: Run, share: f64) -> Run {
    let until = (share * first.samples.len() as f64) as usize;
    let after_ns = first.samples[until].0.0 + 20_000_000_000;
    let mut samples = first.samples[..until].to_vec();
    let again = second.samples.into_iter().zip((until as u32)..).map(|((host, mut sample), number)| {
        sample.sequence = Some(number & 0xffff);
        sample.ticks = sample.ticks.map(|ticks| DeviceTicks(ticks.0 + after_ns / 1000));
        (HostNs(host.0 + after_ns), sample)
    });
    samples.extend(again);
    Run { samples, ..first }
}

fn matched(plan: &Plan, run: &Run) -> PoseMatching {
    match_poses(&MatchingInput::new(plan, &stream(&run.samples)))
}

/// The log odds of the own plan in sound runs, and against the plan that an edit made.
#[derive(Debug, Default)]
struct Outcome {
    edits: usize,
    refused: usize,
    unproven: usize,
    accepted_wrong: Vec<String>,
    sound: usize,
    sound_refused: Vec<String>,
    min_sound: f64,
    max_foreign: f64,
}

fn campaign(edits: std::ops::Range<u64>) -> Outcome {
    let originals = JOBS.map(|tables| (job(tables), Plan::build(&job(tables), &robot()).unwrap()));
    let mut outcome =
        Outcome { min_sound: f64::INFINITY, max_foreign: f64::NEG_INFINITY, ..Outcome::default() };
    for seed in edits {
        let mut rng = Pcg64::seed_from_u64(seed);
        let (original, plan) = &originals[seed as usize % JOBS.len()];
        let (mut job, mut robot) = (original.clone(), robot());
        let key = edit(&mut job, &mut robot, &mut rng);
        let Ok(edited) = Plan::build(&job, &robot) else { continue };
        let world = world(&mut rng);
        let name = format!("{seed}: {key}, override {:.2}, strobe {}", world.override_factor, world.strobe);
        let mut driven = run(plan, seed, world);
        if rng.random_bool(0.3) {
            driven = started_again(driven, run(plan, seed + 1, world), rng.random_range(0.1..0.9));
        }
        let own = matched(plan, &driven);
        let lengths = |matching: &PoseMatching| matching.observations.rows.len();
        let own_lengths = lengths(&own);
        let sound = own.code;
        outcome.sound += 1;
        let odds: f64 = sound.by_module.iter().map(|module| module.log_odds).sum();
        outcome.min_sound = outcome.min_sound.min(odds);
        if sound.foreign_module().is_some() && own_lengths > 0 {
            outcome.sound_refused.push(format!("{name}: {:?}", sound.by_module));
        }
        if edited.rows == plan.rows && edited.header.job.motion == plan.header.job.motion {
            continue;
        }
        let foreign = matched(&edited, &driven);
        let foreign_lengths = lengths(&foreign);
        let foreign = foreign.code;
        eprintln!(
            "{name}: sound {:?} ({own_lengths}), foreign {:?} ({foreign_lengths})",
            sound.by_module, foreign.by_module
        );
        outcome.edits += 1;
        let odds = foreign.by_module.iter().map(|module| module.log_odds).sum();
        outcome.max_foreign = outcome.max_foreign.max(odds);
        // Without a length nothing is written, and one length comes with warnings (W1085, W1003).
        let is_proven = foreign.is_own();
        if foreign.foreign_module().is_some() || (foreign_lengths <= 1 && !is_proven) {
            outcome.refused += 1;
        } else if is_proven {
            outcome.accepted_wrong.push(format!("{name}: {:?}", foreign.by_module));
        } else {
            outcome.unproven += 1;
        }
    }
    eprintln!("{outcome:#?}");
    assert!(outcome.accepted_wrong.is_empty());
    assert!(outcome.sound_refused.is_empty());
    outcome
}

#[test]
fn few_dwells_show_the_plan() {
    let outcome = campaign(0..24);
    assert!(outcome.edits >= 15 && 5 * outcome.unproven <= outcome.edits, "{outcome:?}");
}

/// `cargo test --release -p dbbd-job foreign_programs::campaign -- --ignored --nocapture`, some minutes.
#[test]
#[ignore = "a campaign of some minutes"]
fn campaign_of_single_edits() {
    let outcome = campaign(1000..1400);
    assert!(outcome.edits >= 300 && outcome.unproven == 0, "{outcome:?}");
}
