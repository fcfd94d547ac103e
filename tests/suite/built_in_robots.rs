//! The robots that are built in stand where their published descriptions have them
//! (tests/independent/robots.py, which knows no DH parameter).

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::Output;

use dbbd::robot::{AXES, Robot};
use tempfile::tempdir;

use crate::cell::{dbbd, stderr};

#[test]
fn every_robot_stands_where_its_description_has_it() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/golden/robots.csv");
    let text = fs::read_to_string(path).unwrap();
    let mut checked = BTreeSet::new();
    for line in text.lines().skip(1) {
        let (name, numbers) = line.split_once(',').unwrap();
        let numbers: Vec<f64> = numbers.split(',').map(|cell| cell.parse().unwrap()).collect();
        let robot = Robot::by_name(name).unwrap().unwrap();
        let axes: [f64; AXES] = std::array::from_fn(|i| numbers[i].to_radians());
        let flange = robot.geometry.flange(&axes);
        for (axis, expected) in numbers[6..9].iter().enumerate() {
            assert!((flange.position[axis] - expected).abs() < 1e-8, "{line}");
        }
        for (at, expected) in numbers[9..18].iter().enumerate() {
            assert!((flange.rotation[(at / 3, at % 3)] - expected).abs() < 1e-11, "{line}");
        }
        checked.insert(name.to_owned());
    }
    let built_in: BTreeSet<String> = Robot::built_in().iter().map(|(name, _)| (*name).to_owned()).collect();
    assert_eq!(checked, built_in, "each robot needs its poses in fixtures/golden/robots.csv");
}

#[test]
fn every_robot_is_listed_and_shown_with_its_source() {
    let dir = tempdir().unwrap();
    let stdout = |output: &Output| String::from_utf8(output.stdout.clone()).unwrap();
    let list = stdout(&dbbd(dir.path(), &["robots"]));
    for (name, _) in Robot::built_in() {
        assert!(list.contains(name), "{list}");
        let shown = dbbd(dir.path(), &["robots", "show", name]);
        assert!(shown.status.success(), "{}", stderr(&shown));
        assert!(stdout(&shown).contains("Geometry"), "{name} has no source");
    }
}
