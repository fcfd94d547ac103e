//! With equal lengths a bar's offset is equivalent to a uniform scale of the robot. A second length of the same bar separates
//! them; a second bar with an offset of its own does not, unless one of them is calibrated.

use dbbd_model::robot::{BallId, BarId};
use std::fs;

use dbbd_model::estimation::result::Status;
use dbbd_model::estimation::result::{CalibrationResult, ParameterResult};
use dbbd_model::measurement::{Datum, Measurements};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use tempfile::tempdir;

use crate::cell::{CENTRE, Circle, centres_csv, dbbd, kr60, measure, stderr, three_planes};

/// Three planes about one ball with this radius.
fn circles(radius: f64) -> Vec<Circle> {
    three_planes(1, CENTRE).into_iter().map(|circle| Circle { radius, ..circle }).collect()
}

/// Lengths of the nominal robot at radius 300 with bar 1, then at radius 200 with `second`; offsets of 0.05 and
/// -0.03 mm.
fn two_lengths(second: usize, noise_mm: f64) -> Measurements {
    let mut random = Pcg64::seed_from_u64(7);
    let mut data = measure(&kr60(), &circles(300.0), 27, 25.0);
    let mut more = measure(&kr60(), &circles(200.0), 27, 25.0);
    more.rows.iter_mut().for_each(|row| {
        (row.index, row.datum) = (row.index + 100, Datum::Ball(BallId::FIRST, BarId::at(second - 1)))
    });
    data.rows.extend(more.rows);
    for row in &mut data.rows {
        let z: f64 = StandardNormal.sample(&mut random);
        row.length_mm += [0.05, -0.03][row.datum.bar().unwrap().index()] + noise_mm * z;
    }
    data
}

fn run(csv: &str, extra: &[&str]) -> (i32, Option<CalibrationResult>, String) {
    let dir = tempdir().unwrap();
    fs::write(dir.path().join("obs.csv"), csv).unwrap();
    fs::write(dir.path().join("C.csv"), centres_csv(&circles(300.0))).unwrap();
    let mut args = vec![
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
    args.extend(["--folds", "0"]);
    args.extend(extra);
    let output = dbbd(dir.path(), &args);
    let result = fs::read_to_string(dir.path().join("out/result.json")).ok();
    let said = stderr(&output) + &String::from_utf8_lossy(&output.stdout);
    (output.status.code().unwrap(), result.map(|text| serde_json::from_str(&text).unwrap()), said)
}

fn identify(data: &Measurements, extra: &[&str]) -> CalibrationResult {
    let (code, result, said) = run(&data.to_csv(), extra);
    assert!(matches!(code, 0 | 3), "{said}");
    result.unwrap()
}

fn parameter<'a>(result: &'a CalibrationResult, name: &str) -> &'a ParameterResult {
    result.parameters.iter().find(|parameter| parameter.name.to_string() == name).unwrap()
}

fn text(result: &CalibrationResult, part: &str) -> bool {
    result.combinations.iter().any(|group| group.to_string().contains(part))
}

const SCALE: &str = "bar_offset is a uniform scale by another name; calibrate the bar or add a second length";

#[test]
fn second_length_of_a_bar_raises_the_rank() {
    let one = identify(&measure(&kr60(), &circles(300.0), 54, 25.0), &["--estimate", "all"]);
    assert_eq!((one.rank, parameter(&one, "bar_offset").status), (24, Status::Dependent));
    assert!(text(&one, SCALE), "{:?}", one.combinations);

    let two = identify(&two_lengths(1, 0.0), &["--estimate", "all"]);
    assert_eq!((two.rank, parameter(&two, "bar_offset").status), (25, Status::Identified));
    assert!(!text(&two, "uniform scale"));
    assert!((parameter(&two, "bar_offset").identified - 0.05).abs() < 1e-8);
}

#[test]
fn two_bars_do_not_determine_the_scale_until_one_is_calibrated() {
    let free = identify(&two_lengths(2, 0.0), &["--estimate", "all"]);
    assert_eq!((free.rank, parameter(&free, "bar_offset2").status), (25, Status::Dependent));
    assert!(text(
        &free,
        "bar_offset2 is a uniform scale by another name while each bar has an offset of its own"
    ));
    assert!(text(&free, "calibrate one of the bars, or set one to a second length"));

    // Bar 1 is calibrated: its offset is subtracted from its lengths, and it is fixed.
    let mut known = two_lengths(2, 0.002);
    known
        .rows
        .iter_mut()
        .filter(|row| row.datum.bar() == Some(BarId::FIRST))
        .for_each(|row| row.length_mm -= 0.05);
    let held = identify(&known, &["--hold", "bar_offset", "--estimate", "all"]);
    let second = parameter(&held, "bar_offset2");
    let [low, high] = second.interval95.unwrap();
    assert_eq!(second.status, Status::Identified);
    assert!(low < -0.03 && -0.03 < high && high - low < 0.02, "{low} {high}");
    assert_eq!(parameter(&held, "bar_offset").identified, 0.0);
    assert!(!text(&held, "uniform scale"));
}

/// The lengths do not improve a certificate of 1 um; each bar has its own offset.
#[test]
fn certificate_fixes_the_offset_of_each_bar() {
    let mut data = two_lengths(2, 0.01);
    data.rows.iter_mut().for_each(|row| row.length_mm -= [0.05, -0.03][row.datum.bar().unwrap().index()]);
    let with = |extra: &[&str]| identify(&data, &[&["--sigma", "0.01"], extra].concat());
    let predicted = |result: &CalibrationResult| result.predicted_position_uncertainty_mm.identified.mean;
    let free = with(&["--prior", "datasheet"]);
    let bound = with(&["--prior", "datasheet", "--bar-u", "0.001"]);
    for name in ["bar_offset", "bar_offset2"] {
        let found = parameter(&bound, name);
        assert!(found.sd.unwrap() <= 0.001 && found.identified.abs() < 0.003, "{found:?}");
        assert!(parameter(&free, name).sd.unwrap() > 0.005);
    }
    assert_ne!(parameter(&bound, "bar_offset").identified, parameter(&bound, "bar_offset2").identified);
    assert!(predicted(&bound) < 0.9 * predicted(&free), "{} {}", predicted(&bound), predicted(&free));

    // The certificate sets the limit for the offset to be identified by the lengths.
    let one = two_lengths(1, 0.05);
    for (u, status) in [("0.0001", Status::SupportedByPrior), ("0.1", Status::Identified)] {
        let found = identify(&one, &["--sigma", "0.05", "--bar-u", u]);
        assert_eq!(parameter(&found, "bar_offset").status, status);
    }
    let (code, _, said) = run(&data.to_csv(), &["--bar-u", "0"]);
    assert!(code == 2 && said.contains("E0130"), "{said}");
}

#[test]
fn bars_have_their_own_columns() {
    let data = two_lengths(2, 0.002);
    let csv = data.to_csv();
    assert!(csv.lines().next().unwrap().ends_with(",length_mm,sigma_mm,bar"));
    assert_eq!(Measurements::from_csv("obs.csv", &csv).unwrap(), data);
    assert!(!two_lengths(1, 0.0).to_csv().contains("bar"), "one bar needs no column");
    // Naming the group covers both.
    let both = identify(&data, &["--estimate", "bar"]);
    assert!(
        ["bar_offset", "bar_offset2"].iter().all(|name| parameter(&both, name).status == Status::Identified)
    );
}

#[test]
fn wrong_bars_are_refused() {
    let csv = two_lengths(2, 0.002).to_csv();
    let cases = [
        (
            csv.replace(",,2\n", ",,3\n"),
            vec![],
            "column `bar`: the numbers must run 1, 2, ..: bar 2 has no length",
        ),
        (csv.replacen(",,2\n", ",,0\n", 1), vec![], "column `bar`: `0`: must be a whole number from 1"),
        (csv.replacen(",,2\n", ",,long\n", 1), vec![], "column `bar`: `long`"),
        (
            csv.clone(),
            vec!["--estimate", "bar_offset3"],
            "`bar_offset3` is not a parameter: the data have 2 bar(s)",
        ),
        (csv.clone(), vec!["--estimate", "bar_offset1"], "`bar_offset1` is not a parameter"),
    ];
    for (csv, extra, words) in cases {
        let (code, _, said) = run(&csv, &extra);
        assert_eq!(code, 1, "{said}");
        assert!(said.contains(words), "`{words}` is not in: {said}");
    }
}
