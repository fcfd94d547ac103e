//! A plan that is accepted runs: its program stays within limits, speeds and branch on the controller.

use dbbd::krl::{Options, Program, Sync, emit};
use dbbd::plan::{Job, Kind, Plan};
use dbbd::sim::world::{Setup, Stroke};
use dbbd::sim::{Controller, World, truth};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::cell::kr60;

/// A job drawn at random, most of them feasible: up to three circles about one or two balls.
fn job(seed: u64) -> String {
    let mut random = Pcg64::seed_from_u64(seed);
    let mut between = |low: f64, high: f64| random.random_range(low..high);
    let mut text = format!(
        "robot = \"kr60ha\"\nseed = {seed}\n[bar]\nlength_mm = {:.1}\nstroke_mm = [-6.0, 6.0]\nmargin_mm = 0.5\n",
        between(150.0, 450.0)
    );
    let balls = if between(0.0, 1.0) < 0.3 { 2 } else { 1 };
    for id in 1..=balls {
        let centre = [between(1000.0, 1500.0), between(-500.0, 500.0), between(500.0, 1200.0)];
        text.push_str(&format!("[[centre]]\nid = {id}\nxyz_mm = {centre:.1?}\n"));
    }
    for _ in 0..between(1.0, 4.0) as u32 {
        let plane = match between(0.0, 4.0) as u32 {
            0 => "plane = \"XY\"".into(),
            1 => "plane = \"XZ\"".into(),
            2 => "plane = \"YZ\"".into(),
            _ => format!("normal = {:.3?}", [between(-1.0, 1.0), between(-1.0, 1.0), between(-1.0, 1.0)]),
        };
        let orientation = ["fixed", "seed", "random", "turning"][between(0.0, 4.0) as usize];
        let amplitude = match orientation {
            "seed" | "random" => format!("amplitude_deg = {:.1}\n", between(2.0, 40.0)),
            _ => String::new(),
        };
        let direction = ["ccw", "cw", "both"][between(0.0, 3.0) as usize];
        let arc = if between(0.0, 1.0) < 0.3 { between(60.0, 300.0) } else { 360.0 };
        text.push_str(&format!(
            "[[circle]]\ncentre = {}\n{plane}\npoints = {}\norientation = \"{orientation}\"\n{amplitude}tilt_deg = {:.1}\n\
             spin_deg = {:.1}\ndirection = \"{direction}\"\nstart_deg = {:.1}\narc_deg = {arc:.1}\n",
            between(1.0, f64::from(balls) + 1.0) as u32,
            between(5.0, 60.0) as u32,
            between(0.0, 45.0),
            between(-90.0, 90.0),
            between(-180.0, 180.0),
        ));
    }
    text + "[motion]\nsettle_s = 0.1\ndwell_s = 0.2\n"
}

/// How the program of a job ended.
#[derive(Debug, PartialEq)]
enum Fate {
    Refused,
    Ran { strayed: bool },
    Failed(String),
}

fn run(seed: u64, step_s: f64) -> Fate {
    let job = Job::from_toml("job.toml", &job(seed)).unwrap();
    let nominal = kr60();
    let Ok(plan) = Plan::build(&job, &nominal) else { return Fate::Refused };
    let sync = if seed.is_multiple_of(2) { Sync::Output } else { Sync::Marker };
    let files = match emit(&plan, Options { sync, controller: dbbd::krl::Controller::Krc4 }) {
        Ok(files) => files,
        Err(error) => return Fate::Failed(error.to_string()),
    };
    let program = Program::open("DBB_MAIN", |wanted| {
        Ok(files.iter().find(|(name, _)| name.eq_ignore_ascii_case(wanted)).cloned())
    })
    .unwrap();
    let setup = Setup::new(&program, None).unwrap();
    let mut world = World::new(truth::draw(&nominal, seed, 1.0).geometry, setup, seed);
    let mut controller = Controller::new(program, &nominal, 100.0).unwrap();
    let (mut mounted, mut strayed) = (false, false);
    loop {
        let moment = match controller.step(step_s) {
            Ok(moment) => moment,
            Err(error) => return Fate::Failed(format!("seed {seed}: {error}")),
        };
        let reading = world.reading(&moment);
        strayed |= mounted && reading.stroke != Stroke::Within;
        if moment.halted {
            mounted = true;
            controller.go_on();
        }
        if moment.done {
            break;
        }
    }
    let dwells = plan.rows.iter().filter(|row| row.kind != Kind::Transit).count();
    if controller.dwells() as usize != dwells {
        return Fate::Failed(format!("seed {seed}: {} of {dwells} dwells", controller.dwells()));
    }
    Fate::Ran { strayed }
}

fn campaign(wanted: usize, step_s: f64) -> [usize; 3] {
    let (mut ran, mut strayed, mut refused) = (0, 0, 0);
    let mut failed = Vec::new();
    for seed in 1.. {
        match run(seed, step_s) {
            Fate::Refused => refused += 1,
            Fate::Ran { strayed: out } => {
                ran += 1;
                strayed += usize::from(out);
            }
            Fate::Failed(why) => {
                ran += 1;
                failed.push(why);
            }
        }
        if ran >= wanted {
            break;
        }
    }
    assert!(failed.is_empty(), "{} of {ran} failed:\n{}", failed.len(), failed.join("\n"));
    [ran, strayed, refused]
}

#[test]
fn random_feasible_jobs_run_to_their_end() {
    campaign(20, 0.1);
}

/// `cargo test --release --test suite thousand_random_jobs -- --ignored --nocapture`: docs/krl.md.
#[test]
#[ignore = "takes minutes"]
fn thousand_random_jobs_run_to_their_end() {
    let [ran, strayed, refused] = campaign(1000, 0.05);
    eprintln!("{ran} jobs ran, {strayed} left the stroke at some moment, {refused} were refused");
}
