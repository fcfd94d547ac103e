//! Shifted, repeated and doubly numbered rows of a table are found.

use std::fs;
use std::process::Output;

use dbbd_model::estimation::CalibrationResult;
use dbbd_model::measurement::Measurements;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use tempfile::{TempDir, tempdir};

use crate::cell::{CENTRE, DESIGNED, centres_csv, codes, dbbd, measure, three_planes, with_errors};

fn lengths(points: usize) -> Measurements {
    let mut random = Pcg64::seed_from_u64(7);
    let mut data = measure(&with_errors(DESIGNED), &three_planes(1, CENTRE), points, 25.0);
    for row in &mut data.rows {
        let z: f64 = StandardNormal.sample(&mut random);
        row.length_mm += 0.01 * z;
    }
    data
}

fn identify(data: &Measurements) -> (TempDir, Output) {
    let dir = tempdir().unwrap();
    fs::write(dir.path().join("obs.csv"), data.to_csv()).unwrap();
    fs::write(dir.path().join("C.csv"), centres_csv(&three_planes(1, CENTRE))).unwrap();
    let args = ["identify", "obs.csv", "--robot", "kr60ha", "--centres", "C.csv", "--out", "out"];
    let output = dbbd(dir.path(), &[&args[..], &["--folds", "0"]].concat());
    (dir, output)
}

fn result(dir: &TempDir) -> CalibrationResult {
    serde_json::from_str(&fs::read_to_string(dir.path().join("out/result.json")).unwrap()).unwrap()
}

/// `data` with the lengths shifted by a row, as after a lost cell.
fn moved(mut data: Measurements) -> Measurements {
    for at in 1..data.rows.len() {
        data.rows[at - 1].length_mm = data.rows[at].length_mm;
    }
    data.rows.pop();
    data
}

#[test]
fn lengths_shifted_by_a_row_are_doubted() {
    let (dir, output) = identify(&moved(lengths(27)));
    assert_eq!(output.status.code(), Some(3));
    let found = result(&dir);
    let moved = found.findings.iter().find(|warning| warning.code() == "W1330").unwrap();
    assert_eq!(moved.values()["rows"], -1);
    assert!(moved.values()["gain"].as_f64().unwrap() > 20.0);
    assert!(moved.values()["shifted_mm"].as_f64() < Some(0.1), "{}", moved.values());
    // Unshifted lengths are not doubted, nor with one outlier.
    for wild in [0.0, 5.0] {
        let mut data = lengths(27);
        data.rows[11].length_mm += wild;
        assert!(!codes(&identify(&data).1).iter().any(|code| code == "W1330"));
    }
}

#[test]
fn repeated_rows_are_used_once() {
    let data = lengths(20);
    let (once, _) = identify(&data);
    let mut twice = data.clone();
    twice.rows.extend(data.rows.clone());
    let mut renumbered = twice.clone();
    (1..).zip(&mut renumbered.rows).for_each(|(index, row)| row.index = index);
    for repeated in [&twice, &renumbered] {
        let (dir, output) = identify(repeated);
        assert_eq!(output.status.code(), Some(3));
        assert!(codes(&output).iter().any(|code| code == "W1209"));
        assert_eq!(result(&dir).parameters, result(&once).parameters);
    }
    // A pose that was measured again is not a repeated row.
    let mut again = data.clone();
    again.rows.push(data.rows[3].clone());
    again.rows.last_mut().unwrap().index = 1000;
    let (dir, output) = identify(&again);
    assert!(!codes(&output).iter().any(|code| code == "W1209"));
    assert_eq!(result(&dir).measurements, 61);
}

#[test]
fn different_rows_with_the_same_index_are_refused() {
    let mut data = lengths(9);
    data.rows[5].index = data.rows[2].index;
    let (_, output) = identify(&data);
    assert_eq!((output.status.code(), codes(&output)), (Some(1), vec!["E1208".to_owned()]));
}
