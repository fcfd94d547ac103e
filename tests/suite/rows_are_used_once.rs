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
    identify_with(data, &[])
}

fn identify_with(data: &Measurements, more: &[&str]) -> (TempDir, Output) {
    let dir = tempdir().unwrap();
    fs::write(dir.path().join("obs.csv"), data.to_csv()).unwrap();
    fs::write(dir.path().join("C.csv"), centres_csv(&three_planes(1, CENTRE))).unwrap();
    let args = [
        "identify",
        "obs.csv",
        "--robot",
        "kr60ha",
        "--tool",
        "30,20,10",
        "--centres",
        "C.csv",
        "--out",
        "out",
    ];
    let output = dbbd(dir.path(), &[&args[..], &["--folds", "0"], more].concat());
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
fn lengths_shifted_by_a_row_have_a_warning() {
    let (dir, output) = identify(&moved(lengths(27)));
    assert_eq!(output.status.code(), Some(3));
    let found = result(&dir);
    let moved = found.findings.iter().find(|warning| warning.code() == "W1330").unwrap();
    assert_eq!(moved.values()["rows"], -1);
    assert!(moved.values()["gain"].as_f64().unwrap() > 20.0);
    assert!(moved.values()["shifted_mm"].as_f64() < Some(0.1), "{}", moved.values());
    // Unshifted lengths have no warning, nor with one outlier.
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

/// A row that is left out has no effect, whatever its length is; the result, the report and the certificate list it with who and
/// why; the table of the user keeps it.
#[test]
fn a_row_is_left_out_on_request() {
    let data = lengths(20);
    let mut wild = data.clone();
    wild.rows[4].length_mm += 0.05;
    let index = wild.rows[4].index;
    let mut without = data.clone();
    without.rows.remove(4);
    let asked = format!("{index}:door slammed");
    let (dir, output) = identify_with(&wild, &["--exclude", &asked]);
    assert!(codes(&output).iter().any(|code| code == "I1343"), "{output:?}");
    let found = result(&dir);
    assert_eq!(found.parameters, result(&identify(&without).0).parameters);
    assert_eq!((found.measurements, found.outliers.len(), found.excluded.len()), (59, 0, 1));
    let listed = &found.excluded[0];
    assert_eq!(
        (listed.index, listed.reason.as_deref(), listed.by.as_deref()),
        (index, Some("door slammed"), None)
    );
    // It is 0.05 mm longer than the others, and the noise of a length is 0.01 mm.
    assert!((listed.residual_mm - 0.05).abs() < 0.04, "{}", listed.residual_mm);
    let read = |name: &str| fs::read_to_string(dir.path().join(name)).unwrap();
    assert_eq!(read("obs.csv"), wild.to_csv());
    assert_eq!(Measurements::from_csv("lengths.csv", &read("out/lengths.csv")).unwrap().rows.len(), 59);
    assert!(read("out/report.html").contains("door slammed"));
    dbbd(dir.path(), &["certificate", "out", "--out", "certificate"]);
    assert!(read("certificate/certificate.html").contains("door slammed"));
    // Who: the operator of the measurement.
    fs::write(dir.path().join("identity.toml"), "operator = 'A. Example'\n").unwrap();
    let args = [
        "identify",
        "obs.csv",
        "--robot",
        "kr60ha",
        "--tool",
        "30,20,10",
        "--centres",
        "C.csv",
        "--out",
        "named",
        "--folds",
        "0",
    ];
    let more = ["--identity", "identity.toml", "--exclude", "3,7-8", "--exclude", "5:twice"];
    dbbd(dir.path(), &[&args[..], &more].concat());
    let named: CalibrationResult = serde_json::from_str(&read("named/result.json")).unwrap();
    let listed = named.excluded.iter().map(|one| (one.index, one.by.as_deref(), one.reason.as_deref()));
    let operator = Some("A. Example");
    let expected =
        [(3, operator, None), (7, operator, None), (8, operator, None), (5, operator, Some("twice"))];
    assert_eq!(listed.collect::<Vec<_>>(), expected);
}

#[test]
fn a_row_that_does_not_exist_cannot_be_left_out() {
    let (_, output) = identify_with(&lengths(9), &["--exclude", "999"]);
    assert_eq!((output.status.code(), codes(&output)), (Some(1), vec!["E1307".to_owned()]));
}
