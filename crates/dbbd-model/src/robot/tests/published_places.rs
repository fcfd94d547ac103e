//! Flange poses from programs that share no code with dbbd: tests/independent/robots.py, which uses no DH parameter, and Pinocchio
//! (tests/independent/golden.py).

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use dbbd_model::robot::{AXES, Robot};

use crate::test_support::cell::kr60;

#[test]
fn built_in_robots_agree_with_their_descriptions() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/golden/robots.csv");
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
fn flange_agrees_with_pinocchio() {
    let text =
        fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/golden/flange.csv"))
            .unwrap();
    let geometry = kr60().geometry;
    for line in text.lines().skip(1) {
        let numbers: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
        let flange = geometry.flange(&std::array::from_fn(|i| numbers[i].to_radians()));
        for (axis, expected) in numbers[6..9].iter().enumerate() {
            assert!((flange.position[axis] - expected).abs() < 1e-9);
        }
        for (at, expected) in numbers[9..18].iter().enumerate() {
            assert!((flange.rotation[(at / 3, at % 3)] - expected).abs() < 1e-12);
        }
    }
}
