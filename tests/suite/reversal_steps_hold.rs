//! Coverage of the 95 % intervals of the backlash of a robot's joints, for any orientation along the circle.

use std::path::Path;

use dbbd_job::plan::{Job, Plan, PoseKind};
use dbbd_job::program::krl::{self, Options, Program};
use dbbd_job::recording::run::drives;
use dbbd_job::sim::{SimulatedController, truth};
use dbbd_model::circular::CircularFinding;
use dbbd_model::circular::{CirclePoint, CircleSense, CircleTrace, CircularSettings, DriveId, circular};
use dbbd_model::diagnostic::Diagnostic;
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64;

use crate::cell::{dbbd, kr60};

/// Noise of a length: of the bar and of the robot's repeatability, mm.
const SIGMA_MM: f64 = 0.005;

/// The demo with one circle: its orientation pattern and direction.
fn job(orientation: &str, direction: &str) -> String {
    let demo = include_str!("../../examples/circles.toml");
    let (head, rest) = demo.split_once("[[circle]]").unwrap();
    let tail = &rest[rest.find("[[obstacle]]").unwrap()..];
    let circle = format!(
        "[[circle]]\ncentre = 1\nplane = \"XY\"\npoints = 72\norientation = {orientation}\ntilt_deg = 30.0\n\
         direction = \"{direction}\"\n\n"
    );
    [head, &circle, tail].concat()
}

/// A planned circle as it is driven: for each dwell the axes that are commanded (rad) and the sense of their last
/// moves.
struct Driven {
    plan: Plan,
    dwells: Vec<([f64; 6], [f64; 6])>,
}

impl Driven {
    fn new(orientation: &str) -> Self {
        let job = Job::from_toml("job.toml", &job(orientation, "both")).unwrap();
        let plan = Plan::build(&job, &kr60()).unwrap_or_else(|refused| panic!("{refused}"));
        let options = Options { sync: krl::Sync::Output, controller: krl::Controller::Krc4 };
        let files = krl::emit(&plan, options).unwrap();
        let program = Program::open("DBB_MAIN", |wanted| {
            Ok(files.iter().find(|(name, _)| name.eq_ignore_ascii_case(wanted)).cloned())
        })
        .unwrap();
        let mut controller = SimulatedController::new(program, &kr60(), 100.0).unwrap();
        let rows = plan.rows.iter().filter(|row| row.kind != PoseKind::Transit).count();
        let mut dwells = vec![([0.0; 6], [0.0; 6]); rows];
        let (mut last, mut sense) = (None, [0.0; 6]);
        loop {
            let moment = controller.step(0.02).unwrap();
            let before = last.replace(moment.axes).unwrap_or(moment.axes);
            for joint in 0..6 {
                let moved: f64 = moment.axes[joint] - before[joint];
                if moved.abs() > 1e-9 {
                    sense[joint] = moved.signum();
                }
            }
            if moment.halted {
                controller.go_on();
            }
            if moment.strobe
                && let Some(dwell) = dwells.get_mut(controller.dwells() as usize)
            {
                *dwell = (moment.axes, sense);
            }
            if moment.done {
                return Self { plan, dwells };
            }
        }
    }

    /// The circle of a robot within the tolerance with plays (rad): both senses.
    fn measured(&self, seed: u64, plays: &[f64; 6]) -> [CircleTrace; 2] {
        let robot = truth::draw_true_robot(&kr60(), seed, 1.0);
        let centre = Vector3::from(self.plan.header.job.centres[0].xyz_mm);
        let mut random = Pcg64::seed_from_u64(seed);
        let noise = Normal::new(0.0, SIGMA_MM).unwrap();
        let mut traces = [CircleSense::CounterClockwise, CircleSense::Clockwise].map(|sense| CircleTrace {
            run: "1".into(),
            sense,
            points: Vec::new(),
        });
        let rows = self.plan.rows.iter().zip(self.plan.circle_places());
        for ((row, place), (axes, sense)) in
            rows.filter(|(row, _)| row.kind != PoseKind::Transit).zip(&self.dwells)
        {
            let Some(place) = place.filter(|_| row.kind == PoseKind::Measure) else { continue };
            let arrived = std::array::from_fn(|joint| axes[joint] - 0.5 * sense[joint] * plays[joint]);
            let length_mm =
                (robot.geometry.ball(&arrived).position - centre).norm() + noise.sample(&mut random);
            traces[usize::from(place.clockwise)].points.push(CirclePoint {
                angle_deg: place.angle_deg,
                length_mm,
                sigma_mm: None,
                t_s: None,
                temp_c: None,
                axes_deg: Some(row.axes_deg),
                drives: drives(&self.plan, &kr60(), row),
            });
        }
        traces
    }
}

/// The number of reported steps in this many circles, and of those whose interval covers the true backlash.
fn coverage(orientation: &str, circles: u64) -> (usize, usize) {
    let driven = Driven::new(orientation);
    let (mut reported, mut held, mut largest, mut silent) = (0, 0, 0.0_f64, 0);
    for seed in 1..=circles {
        let mut random = Pcg64::seed_from_u64(1_000_000 + seed);
        // Every second robot has no backlash.
        let plays: [f64; 6] = std::array::from_fn(|_| match seed % 2 {
            0 => random.random_range(0.0..0.005_f64).to_radians(),
            _ => 0.0,
        });
        let traces = driven.measured(seed, &plays);
        let found =
            circular(&traces, &CircularSettings { draws: 0, ..CircularSettings::new(300.0) }).unwrap();
        let is_said = |note: &Diagnostic| {
            matches!(note.finding::<CircularFinding>(), Some(CircularFinding::StepsNotSeparable { .. }))
        };
        silent += usize::from(found.steps.is_empty() && !found.notes.iter().any(is_said));
        for step in &found.steps {
            let DriveId::Joint(joint) = step.mover else { panic!("{step:?}") };
            reported += 1;
            held += usize::from((step.play - plays[joint - 1]).abs() <= step.u95);
            if seed % 2 == 1 {
                largest = largest.max(step.most_mm);
            }
        }
    }
    eprintln!(
        "{orientation}: {circles} circles, {reported} steps, {held} hold the play ({:.1} %); without play at most {:.1} um",
        100.0 * held as f64 / reported.max(1) as f64,
        1e3 * largest
    );
    assert_eq!(silent, 0, "circles without a step and without the reason");
    (reported, held)
}

const PATTERNS: [&str; 3] =
    ["\"seed\"\namplitude_deg = 15.0", "\"fixed\"", "\"random\"\namplitude_deg = 10.0"];

#[test]
fn step_intervals_cover_the_backlash() {
    let (reported, held) = coverage(PATTERNS[0], 40);
    assert!(reported >= 40 && held as f64 >= 0.88 * reported as f64, "{held} of {reported}");
}

/// `cargo test --release --test suite a_thousand_circles -- --ignored --nocapture`
#[test]
#[ignore = "takes a minute"]
fn a_thousand_circles() {
    for orientation in PATTERNS {
        let (reported, held) = coverage(orientation, 1000);
        // Random orientations leave the two senses no pose in common: no step is separable.
        let expected = if orientation.contains("random") { 0..=0 } else { 1000..=6000 };
        assert!(
            expected.contains(&reported) && held as f64 >= 0.93 * reported as f64,
            "{held} of {reported}"
        );
    }
}

/// A capture of a circle on a robot without backlash whose orientation changes, through the binary: its notes and
/// steps.
fn captured(dir: &Path, direction: &str) -> serde_json::Value {
    let step = |args: &[&str]| {
        let output = dbbd(dir, args);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(matches!(output.status.code(), Some(0 | 3)), "{args:?}: {said}");
    };
    let job = job(PATTERNS[0], direction).replace("points = 72", "points = 24");
    std::fs::write(dir.join("job.toml"), job).unwrap();
    step(&["plan", "job.toml", "--out", "plan"]);
    let run = ["acquire", "--port", "sim", "--plan", "plan/plan.csv", "--out", "run.dbbd"];
    step(&run);
    step(&["circle", "run.dbbd", "--out", "circle", "--monte-carlo", "0"]);
    serde_json::from_str(&std::fs::read_to_string(dir.join("circle/circle.json")).unwrap()).unwrap()
}

#[test]
fn a_robot_without_backlash_has_no_step_and_one_sense_has_a_code() {
    let dir = tempfile::tempdir().unwrap();
    let one = captured(dir.path(), "ccw");
    assert_eq!(one["reversal_steps"].as_array().unwrap().len(), 0, "{one}");
    let codes: Vec<&str> =
        one["notes"].as_array().unwrap().iter().filter_map(|note| note["code"].as_str()).collect();
    assert!(codes.contains(&"I1416"), "{codes:?}");
}
