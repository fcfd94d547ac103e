//! The experiment of Jeon et al. (Table 2, section 4), and which parameters its circle identifies.

use std::fs;

use dbbd_model::estimation::CalibrationResult;
use dbbd_model::estimation::result::Status;
use dbbd_model::robot::Robot;
use tempfile::tempdir;

use crate::cell::{
    CENTRE, Circle, DESIGNED, centres_csv, dbbd, horizontal, kr60, measure, stderr, three_planes, tilted,
    with_errors,
};

/// The paper's 13 parameters, and the 15 with d2 and d3.
const THIRTEEN: &str = "alpha1-5,a1-5,d4-6";
const FIFTEEN: &str = "alpha1-5,a1-5,d2-6";

/// Runs `dbbd identify` on noise-free lengths of the robot with Table 2's errors.
fn identify(circles: &[Circle], extra: &[&str]) -> CalibrationResult {
    identify_robot(&with_errors(DESIGNED), circles, 45.0, extra)
}

fn identify_robot(
    truth: &Robot,
    circles: &[Circle],
    amplitude_deg: f64,
    extra: &[&str],
) -> CalibrationResult {
    let dir = tempdir().unwrap();
    fs::write(dir.path().join("obs.csv"), measure(truth, circles, 80, amplitude_deg).to_csv()).unwrap();
    fs::write(dir.path().join("centres.csv"), centres_csv(circles)).unwrap();
    let mut args = vec![
        "identify",
        "obs.csv",
        "--robot",
        "kr60ha",
        "--tool",
        "30,20,10",
        "--centres",
        "centres.csv",
        "--out",
        "out",
    ];
    args.extend(["--folds", "0"]);
    args.extend(extra);
    let output = dbbd(dir.path(), &args);
    // Exit code 3 is a warning, as for the horizontal circle.
    assert!(matches!(output.status.code(), Some(0 | 3)), "{}", stderr(&output));
    serde_json::from_str(&fs::read_to_string(dir.path().join("out/result.json")).unwrap()).unwrap()
}

#[test]
fn thirteen_parameters_are_identified_to_1e_9() {
    let result = identify(&[horizontal(1, CENTRE)], &["--estimate", THIRTEEN]);
    assert_eq!(result.rank, 13);
    assert!(result.converged && result.iterations <= 8, "{} steps", result.iterations);
    for (name, designed) in DESIGNED {
        let found = result.parameters.iter().find(|parameter| parameter.name.to_string() == name).unwrap();
        assert_eq!(found.status, Status::Identified);
        assert!((found.correction - designed).abs() < 1e-9, "{name}: {} for {designed}", found.correction);
    }
}

#[test]
fn a_horizontal_circle_reports_its_unidentifiable_direction() {
    let result = identify(&[horizontal(1, CENTRE)], &["--estimate", FIFTEEN]);
    assert_eq!(result.rank, 13);
    // (alpha1, d2) = (-1/15 rad, 1 mm) changes no length, so only alpha1 + d2/15 + d3/15 is identifiable:
    // 15 mm is the height of the centre below axis 2, 815 - 800.
    let group = result.combinations.iter().find(|group| group.kept.to_string() == "alpha1").unwrap();
    for member in ["d2", "d3"] {
        let found = group.members.iter().find(|(id, _)| id.to_string() == member).unwrap();
        assert!((found.1 - 1.0 / 15.0).abs() < 1e-6, "{group:?}");
        let text = group.to_string();
        assert!(text.contains(member) && text.contains("alpha1"), "{text}");
    }
}

#[test]
fn a_tilted_circle_leaves_only_d2_and_d3_dependent() {
    let result = identify(&[tilted(30.0)], &["--estimate", FIFTEEN]);
    assert_eq!(result.rank, 14);
    assert_eq!(result.combinations.len(), 1);
    assert_eq!(
        result.combinations[0].members.iter().map(|(id, _)| id.to_string()).collect::<Vec<_>>(),
        ["d2", "d3"]
    );
    for (name, designed) in DESIGNED {
        let found = result.parameters.iter().find(|parameter| parameter.name.to_string() == name).unwrap();
        assert!((found.correction - designed).abs() < 1e-9, "{name}: {} for {designed}", found.correction);
    }
}

/// Ranks found by an independent prototype: columns scaled to unit norm at the nominal geometry,
/// singular values below 1e-8 of the largest dropped. The robot is the nominal one: where the
/// set-up has to be fitted to another robot, the lengths differ and contain some information about the bar.
#[test]
fn ranks_of_the_plans() {
    let rank =
        |circles: &[Circle], list: &str| identify_robot(&kr60(), circles, 45.0, &["--estimate", list]).rank;
    let geometric = "alpha0-5,a0-5,theta1-6,d1-6";
    assert_eq!(rank(&[horizontal(1, CENTRE)], geometric), 19);
    assert_eq!(rank(&[horizontal(1, CENTRE)], "all"), 21);
    let one = three_planes(1, CENTRE);
    assert_eq!(rank(&one, FIFTEEN), 14);
    assert_eq!(rank(&one, "all"), 24);
    let two = [one.as_slice(), &three_planes(2, [1100.0, 400.0, 600.0])].concat();
    assert_eq!(rank(&two, "all"), 27);
    let three = [two.as_slice(), &three_planes(3, [1200.0, -500.0, 1000.0])].concat();
    assert_eq!(rank(&three, "all"), 30);
}

/// With a fixed orientation the wrist hardly moves: 7 of 15.
#[test]
fn a_fixed_orientation_identifies_few_parameters() {
    let result =
        identify_robot(&with_errors(DESIGNED), &[horizontal(1, CENTRE)], 0.0, &["--estimate", FIFTEEN]);
    assert_eq!(result.rank, 7);
}
