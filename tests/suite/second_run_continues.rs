//! A second run of an identified robot starts from the posterior of the first.

use std::fs;
use std::path::Path;
use std::process::Output;

use dbbd_job::plan::{Job, PlanningPrior};
use dbbd_job::sim::truth;
use dbbd_model::diagnostic::Severity;
use dbbd_model::estimation::CalibrationResult;
use dbbd_model::estimation::result::{PriorSource, StartRobot};
use dbbd_model::measurement::Measurements;
use dbbd_model::robot::Robot;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use tempfile::{TempDir, tempdir};

use crate::cell::{
    CENTRE, Circle, centres_csv, codes, dbbd, horizontal, kr60, measure, stderr, three_planes,
};

const REPEATS_MM: f64 = 0.0138;

/// Lengths of a robot drawn from the tolerance.
fn lengths(circles: &[Circle], points: usize, seed: u64) -> Measurements {
    let mut random = Pcg64::seed_from_u64(seed);
    let mut data = measure(&truth::draw_true_robot(&kr60(), 4, 1.0), circles, points, 30.0);
    for row in &mut data.rows {
        let z: f64 = StandardNormal.sample(&mut random);
        row.length_mm += REPEATS_MM * z;
        row.sigma_mm = Some(0.0015);
    }
    data
}

fn first_circles() -> Vec<Circle> {
    let balls = [CENTRE, [1100.0, 400.0, 600.0], [1200.0, -500.0, 1000.0]];
    (1..).zip(balls).flat_map(|(number, ball)| three_planes(number, ball)).collect()
}

/// The first calibration, and the lengths of a check of it.
fn cell(prior: &str) -> (TempDir, CalibrationResult) {
    let dir = tempdir().unwrap();
    let write = |name: &str, text: String| fs::write(dir.path().join(name), text).unwrap();
    write("obs.csv", lengths(&first_circles(), 20, 1).to_csv());
    write("C.csv", centres_csv(&first_circles()));
    write("check.csv", lengths(&[horizontal(1, CENTRE)], 16, 2).to_csv());
    write("ball.csv", centres_csv(&[horizontal(1, CENTRE)]));
    let args = [
        "identify",
        "obs.csv",
        "--robot",
        "kr60ha",
        "--tool",
        "30,20,10",
        "--centres",
        "C.csv",
        "--folds",
        "0",
    ];
    let output = dbbd(dir.path(), &[&args[..], &["--out", "first", "--prior", prior]].concat());
    assert!(matches!(output.status.code(), Some(0 | 3)), "{}", stderr(&output));
    let first = result(dir.path(), "first");
    (dir, first)
}

fn result(dir: &Path, out: &str) -> CalibrationResult {
    serde_json::from_str(&fs::read_to_string(dir.join(out).join("result.json")).unwrap()).unwrap()
}

fn check(dir: &Path, robot: &str, extra: &[&str]) -> Output {
    let out = if robot.starts_with("second/") { "third" } else { "second" };
    let args = ["identify", "check.csv", "--robot", robot, "--centres", "ball.csv", "--out", out];
    dbbd(dir, &[&args[..], extra].concat())
}

fn told(output: &Output, code: &str) -> bool {
    codes(output).iter().any(|told| told == code)
}

#[test]
fn repeated_measurement_does_not_raise_the_predicted_error() {
    for prior in ["none", "datasheet"] {
        let (dir, first) = cell(prior);
        let first_mm = first.predicted_position_uncertainty_mm.identified.mean;
        let output = check(dir.path(), "first/robot-identified.toml", &[]);
        let second = result(dir.path(), "second");
        let second_mm = second.predicted_position_uncertainty_mm;
        let said = stderr(&output);
        // The only warning comes from the first run: some of its poses are beyond the limits.
        let own = second.findings.iter().all(|found| found.severity() == Severity::Info);
        assert!(output.status.code() == Some(3) && told(&output, "W1843") && own, "{said}");
        assert!(second_mm.identified.mean < 1.05 * first_mm, "{prior} {first_mm}: {second_mm:?} {said}");
        // The prior is the posterior of the first run.
        assert!((second_mm.nominal.mean / first_mm - 1.0).abs() < 0.1, "{prior} {first_mm}: {second_mm:?}");
        assert_eq!(second.prior, PriorSource::Posterior);
        assert_eq!([first.start, second.start], [StartRobot::Nominal, StartRobot::Identified]);
        // The same lengths again add no information, others do.
        let again = check(dir.path(), "second/robot-identified.toml", &[]);
        assert!(again.status.code() == Some(3) && told(&again, "W1334"), "{}", stderr(&again));
        let others = lengths(&[horizontal(1, CENTRE)], 16, 3).to_csv();
        fs::write(dir.path().join("check.csv"), others).unwrap();
        let third = check(dir.path(), "first/robot-identified.toml", &[]);
        assert!(third.status.code() == Some(3) && told(&third, "W1843"), "{}", stderr(&third));
    }
}

#[test]
fn a_table_of_the_same_lengths_is_no_prior() {
    let (dir, _) = cell("none");
    let identify = |lengths: &str, balls: &str| {
        let args = [
            "identify",
            lengths,
            "--robot",
            "kr60ha",
            "--tool",
            "30,20,10",
            "--centres",
            balls,
            "--folds",
            "0",
            "--out",
            "again",
        ];
        dbbd(dir.path(), &[&args[..], &["--prior", "first/parameters.csv"]].concat())
    };
    let same = identify("obs.csv", "C.csv");
    assert!(same.status.code() == Some(3) && told(&same, "W1334"), "{}", stderr(&same));
    assert_eq!(result(dir.path(), "again").prior, PriorSource::Datasheet);
    assert!(!told(&identify("check.csv", "ball.csv"), "W1334"));
}

#[test]
fn a_lost_posterior_is_reported() {
    let (dir, _) = cell("none");
    let path = dir.path().join("first/robot-identified.toml");
    let text = fs::read_to_string(&path).unwrap();
    let robot = Robot::from_toml("robot.toml", &text).unwrap();
    let write =
        |name: &str, robot: &Robot| fs::write(dir.path().join(name), robot.to_toml().unwrap()).unwrap();
    write("old.toml", &Robot { posterior: None, ..robot.clone() });
    let mut edited = robot.clone();
    edited.geometry.rows[3].d += 0.01;
    write("edited.toml", &edited);
    for file in ["old.toml", "edited.toml"] {
        let output = check(dir.path(), file, &[]);
        assert!(output.status.code() == Some(3) && told(&output, "W1332"), "{file}: {}", stderr(&output));
        let refused = check(dir.path(), file, &["--prior", "posterior"]);
        assert_eq!((refused.status.code(), codes(&refused)), (Some(1), vec!["E1304".to_owned()]));
    }
    // With an option the run starts from the datasheet.
    assert!(!told(&check(dir.path(), "old.toml", &["--prior", "none"]), "W1332"));
    let torn = text.replacen("root = [[", "root = [[1.0, 2.0], [", 1);
    assert_eq!(Robot::from_toml("robot.toml", &torn).unwrap_err().code().as_str(), "E0505");
}

/// The plan contains the posterior of an identified robot, so that its run needs no other file.
#[test]
fn a_plan_starts_from_the_posterior() {
    let text =
        fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/two-balls/job.toml")).unwrap();
    let job = Job::from_toml("check.toml", &text).unwrap();
    let data = lengths(&[horizontal(1, CENTRE)], 30, 5);
    let known = PlanningPrior::after_lengths(&job, &kr60(), &data).unwrap();
    let (_, robot) = known.applied(&job, &kr60());
    let posterior = robot.posterior.as_ref().unwrap();
    assert!(posterior.is_of(&robot.geometry) && robot.nominal.is_some());
    for id in posterior.ids() {
        let (here, there) = (posterior.sd(*id).unwrap(), known.posterior.sd(*id).unwrap());
        assert!((here / there - 1.0).abs() < 1e-9, "{id}: {here} for {there}");
    }
}

/// Another tool ball is another set-up: the posterior of the robot applies, the ball is estimated again.
#[test]
fn another_tool_ball_is_estimated_again() {
    let (dir, _) = cell("datasheet");
    let output = check(dir.path(), "first/robot-identified.toml", &["--tool", "30.5,19.5,10.5"]);
    assert!(!told(&output, "W1332") && !told(&output, "W1322"), "{}", stderr(&output));
    assert_eq!(result(dir.path(), "second").prior, PriorSource::Posterior);
}
