//! A step or drift of the bar's zero or of the tracker during the measurement is named, the table stays as it was, and the robot
//! is as accurate as without. Campaign: docs/evidence/README.md.

use std::fs;

use dbbd_model::design::calibrate;
use dbbd_model::diagnostic::RecordedFinding;
use dbbd_model::estimation::{
    AngleSource, CalibrationResult, EventTreatment, Input, Options, SupposedEventKind,
};
use dbbd_model::measurement::{BaseBall, LengthModel, Measurements};
use dbbd_model::robot::{BallId, Robot};
use nalgebra::Vector3;
use tempfile::tempdir;

use crate::ball_is_mounted_again::{identified, robot_of};
use crate::cell::{codes, dbbd, kr60, stderr};
use crate::identifies_real_robots::data;
use crate::nothing_wrong_is_silent::says;
use crate::positions_identify::moved_tracker;
use crate::support::drawn_robots::{BALLS, drawn, lengths, mean_error};

/// How the zero changes over a table.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Course {
    /// After two fifths of the rows.
    Step,
    Drift,
}

fn changed(mut data: Measurements, course: Course, by_mm: f64) -> Measurements {
    let count = data.rows.len();
    for (place, row) in data.rows.iter_mut().enumerate() {
        row.length_mm += match course {
            Course::Step if place < count * 2 / 5 => 0.0,
            Course::Step => by_mm,
            Course::Drift => by_mm * place as f64 / (count - 1) as f64,
        };
    }
    data
}

fn changes(result: &CalibrationResult) -> Vec<&RecordedFinding> {
    result.findings.iter().filter(|warning| warning.code() == "W1333").collect()
}

/// A change by 0.06 mm is an unknown of its own kind, the table is as it was, and the robot as accurate as without the change.
fn is_an_unknown(course: Course, size_mm: f64) -> RecordedFinding {
    let (dir, truth) = (tempdir().unwrap(), drawn(3));
    let at = dir.path();
    let data = lengths(&truth, 70, 3, 1);
    let (_, plain, _) = identified(at, &data, "plain");
    assert!(!plain.contains(&"W1333".to_owned()), "{plain:?}");
    let before = mean_error(&truth, &robot_of(&at.join("plain")), 9000);
    let (exit, _, after) = identified(at, &changed(data, course, size_mm), "changed");
    assert_eq!(exit, Some(3), "{:?}", after.hypotheses);
    let [found] = changes(&after)[..] else { panic!("{course:?}: {:?}", after.findings) };
    let value = |name: &str| found.values()[name].as_f64().unwrap();
    assert!((value("by_mm") - size_mm).abs() < 4.0 * value("sd_mm"), "{}", found.values());
    assert!(value("sd_mm") < 0.012, "{}", found.values());
    let [event] = &after.hypotheses[..] else { panic!("{:?}", after.hypotheses) };
    let name = match course {
        Course::Step => SupposedEventKind::BarZeroStep,
        Course::Drift => SupposedEventKind::BarZeroDrift,
    };
    assert_eq!((event.name, event.treated), (name, EventTreatment::Unknown));
    assert!(!fs::read_to_string(at.join("changed/lengths.csv")).unwrap().contains("zero_mm"));
    // The robot file has the warning.
    let robot = robot_of(&at.join("changed"));
    let error = mean_error(&truth, &robot, 9000);
    assert!(error.mean < 1.2 * before.mean, "{} mm, {} mm", error.mean, before.mean);
    assert!(robot.warnings.contains(&"W1333".to_owned()));
    let robot = "changed/robot-identified.toml";
    let again = dbbd(at, &["identify", "obs.csv", "--centres", "C.csv", "--robot", robot, "--out", "again"]);
    says(&again, 3, "W1334");
    found.clone()
}

#[test]
fn a_step_of_zero_is_an_unknown() {
    let found = is_an_unknown(Course::Step, 0.06);
    assert!((found.values()["index"].as_f64().unwrap() - 85.0).abs() < 6.0, "{}", found.values());
}

#[test]
fn a_drift_of_zero_is_an_unknown() {
    is_an_unknown(Course::Drift, 0.06);
}

/// A step of twice the noise of a length could be, but the result is as if it were not.
#[test]
fn a_small_step_is_said() {
    let dir = tempdir().unwrap();
    let data = changed(lengths(&drawn(3), 70, 3, 1), Course::Step, 0.02);
    let (exit, said, after) = identified(dir.path(), &data, "small");
    assert!(exit == Some(0) && said.contains(&"I1336".to_owned()), "{said:?}");
    let [event] = &after.hypotheses[..] else { panic!("{:?}", after.hypotheses) };
    assert_eq!((event.name, event.treated), (SupposedEventKind::BarZeroStep, EventTreatment::Reported));
    assert!((0.5..0.99).contains(&event.probability), "{event:?}");
}

#[test]
fn a_motion_of_the_tracker_is_an_unknown() {
    let dir = tempdir().unwrap();
    let still = |_: usize| 0.0;
    let step = |row: usize| if row > 30 { 0.2 } else { 0.0 };
    let drift = |row: usize| 0.3 * row as f64 / 70.0;
    /// How far the tracker moved by each row, mm, and what that is.
    type Motion<'a> = (&'a dyn Fn(usize) -> f64, Option<SupposedEventKind>);
    let of: [Motion<'_>; 3] = [
        (&still, None),
        (&step, Some(SupposedEventKind::TrackerMoved)),
        (&drift, Some(SupposedEventKind::TrackerDrift)),
    ];
    for (off_mm, expected) in of {
        fs::write(dir.path().join("p.csv"), moved_tracker(off_mm)).unwrap();
        let output =
            dbbd(dir.path(), &["identify", "p.csv", "--robot", "kr60ha", "--tool", "30,20,10", "--out", "o"]);
        assert_eq!(codes(&output).contains(&"W1333".to_owned()), expected.is_some(), "{}", stderr(&output));
        let result = fs::read(dir.path().join("o/result.json")).unwrap();
        let result: CalibrationResult = serde_json::from_slice(&result).unwrap();
        assert_eq!(result.hypotheses.first().map(|event| event.name), expected, "{:?}", result.hypotheses);
    }
}

fn identified_with(data: &Measurements, robot: &Robot, balls: &[Vector3<f64>]) -> (Robot, CalibrationResult) {
    let ball = |(at, position): (usize, &Vector3<f64>)| BaseBall { id: BallId::at(at), position: *position };
    let centres: Vec<BaseBall> = balls.iter().enumerate().map(ball).collect();
    let start = LengthModel::before(robot.geometry.clone(), &centres, data);
    let options = Options { folds: Some(0), ..Options::default() };
    let axes = AngleSource::Given;
    let input = Input { robot, observations: data, start: &start, validation: None, options: &options, axes };
    let calibration = calibrate(&input, Vec::new()).unwrap();
    (calibration.robot, calibration.result)
}

#[test]
#[ignore = "needs data that are not part of the project: .ci/night"]
fn no_change_of_zero_is_found_on_a_real_robot() {
    let of = |x: f64, y: f64, z: f64| Vector3::new(x, y, z);
    let kr60_balls = [of(270.0, -1490.0, 530.0), of(760.0, -1570.0, 1030.0), of(340.0, -1000.0, 1230.0)];
    let mut arm = kr60();
    arm.set_tool([0.0, 0.0, 104.0]);
    for (name, balls) in
        [("three_balls", 3), ("three_balls_approach", 3), ("one_ball", 1), ("one_ball_approach", 1)]
    {
        let path = data(&format!("kr60/{name}.csv"));
        let table = Measurements::from_csv(name, &fs::read_to_string(path).unwrap()).unwrap();
        let (_, result) = identified_with(&table, &arm, &kr60_balls[..balls]);
        assert!(changes(&result).is_empty(), "{name}: {:?}", result.findings);
    }
}

/// What a change of the zero by `by_um` does to the results of 100 robots: at least `least` of them name it.
fn campaign(course: Course, by_um: u32, least: usize) {
    let balls = BALLS.map(|ball| Vector3::from(ball) + Vector3::new(3.0, -2.0, 1.0));
    let (mut otherwise, mut as_ball) = (0, 0);
    let (mut sizes_um, mut ratios) = (Vec::new(), Vec::new());
    for seed in 1..=100 {
        let truth = drawn(seed);
        let data = changed(lengths(&truth, 70, 3, seed), course, 1e-3 * f64::from(by_um));
        let (robot, result) = identified_with(&data, &kr60(), &balls);
        let error = mean_error(&truth, &robot, seed + 9000);
        ratios.push(error.predicted / error.mean);
        as_ball += u32::from(result.findings.iter().any(|warning| warning.code() == "W1331"));
        match &changes(&result)[..] {
            [] => {}
            [one] if (course == Course::Step) == one.values().get("index").is_some() => {
                sizes_um.push(1e3 * one.values()["by_mm"].as_f64().unwrap());
            }
            _ => otherwise += 1,
        }
    }
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
    let (found, size_um, ratio) = (sizes_um.len(), mean(&sizes_um), mean(&ratios));
    let smallest = ratios.iter().copied().fold(f64::INFINITY, f64::min);
    eprintln!(
        "{course:?} of {by_um} um: {found} found (mean {size_um:.1} um), {otherwise} otherwise, {as_ball} as a ball; \
         predicted/true {ratio:.2}, {smallest:.2} at least"
    );
    assert!(found >= least && otherwise + as_ball <= 2 && (0.85..1.25).contains(&ratio), "{course:?}");
    assert!(by_um > 0 || found <= 1, "{found} found without a change");
}

#[test]
#[ignore = "1000 identifications: see docs/evidence/README.md"]
fn zeros_of_a_hundred_robots() {
    for (by_um, [step, drift]) in [(0, [0, 0]), (10, [0, 0]), (20, [0, 0]), (40, [50, 0]), (80, [95, 70])] {
        campaign(Course::Step, by_um, step);
        campaign(Course::Drift, by_um, drift);
    }
}
