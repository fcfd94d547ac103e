//! Uninformative and impossible data give a finding or a right answer: never a crash, and never a silent wrong number.

use std::fs;

use dbbd_model::estimation::CalibrationResult;
use dbbd_model::estimation::result::Status;
use dbbd_model::measurement::Measurements;
use tempfile::{TempDir, tempdir};

use crate::cell::{
    CENTRE, DESIGNED, centres_csv, dbbd, horizontal, measure, stderr, three_planes, with_errors,
};

struct Run {
    code: Option<i32>,
    said: String,
    result: Option<CalibrationResult>,
    _dir: TempDir,
}

impl Run {
    fn parameter(&self, name: &str) -> (f64, Status) {
        let found =
            self.result.as_ref().unwrap().parameters.iter().find(|p| p.name.to_string() == name).unwrap();
        (found.correction, found.status)
    }
}

fn identify(csv: &str, args: &[&str]) -> Run {
    let dir = tempdir().unwrap();
    fs::write(dir.path().join("obs.csv"), csv).unwrap();
    fs::write(dir.path().join("c.csv"), centres_csv(&[horizontal(1, CENTRE)])).unwrap();
    let fixed = [
        "identify",
        "obs.csv",
        "--robot",
        "kr60ha",
        "--tool",
        "30,20,10",
        "--centres",
        "c.csv",
        "--out",
        "out",
    ];
    let output = dbbd(dir.path(), &[&fixed[..], args].concat());
    let result = fs::read_to_string(dir.path().join("out/result.json")).ok();
    let result = result.map(|text| serde_json::from_str(&text).expect("finite numbers, or null"));
    Run { code: output.status.code(), said: stderr(&output), result, _dir: dir }
}

/// Lengths of the designed robot on three planes.
fn sound(points: usize) -> Measurements {
    measure(&with_errors(DESIGNED), &three_planes(1, CENTRE), points, 25.0)
}

/// With and without a prior: an answer without a warning is near the truth, otherwise there is a finding.
fn said_or_right(data: &Measurements, words: &str) {
    for args in [&[][..], &["--prior", "datasheet"][..]] {
        let run = identify(&data.to_csv(), args);
        assert!(matches!(run.code, Some(0 | 1 | 3)), "{words}: {:?}\n{}", run.code, run.said);
        if let Some(result) = &run.result {
            for found in &result.parameters {
                let most = if found.name.to_string().starts_with("centre") { 200.0 } else { 50.0 };
                let off = found.correction.abs();
                let said = run.code == Some(3);
                assert!(said || off < most, "{words} {args:?}: {} is off by {off}", found.name);
            }
        } else {
            assert!(run.said.contains("error["), "{words}: {}", run.said);
        }
    }
}

#[test]
fn one_pose_one_length_and_a_row_repeated() {
    for rows in [1, 2] {
        let mut data = sound(8);
        data.rows.truncate(rows);
        said_or_right(&data, "few rows");
    }
    let mut data = sound(8);
    let first = data.rows[0].clone();
    data.rows.iter_mut().for_each(|row| {
        row.axes = first.axes;
        row.length_mm = first.length_mm;
    });
    said_or_right(&data, "one pose repeated");
}

#[test]
fn lengths_of_any_size() {
    for length in [1e-300, 1e-12, 1e12, 1e200, 1e308] {
        let mut data = sound(10);
        data.rows.iter_mut().for_each(|row| row.length_mm = length);
        for args in [&[][..], &["--prior", "datasheet"][..]] {
            let run = identify(&data.to_csv(), args);
            assert!(matches!(run.code, Some(1 | 3)), "{length}: {:?}\n{}", run.code, run.said);
            assert!(run.said.contains("error[") || run.said.contains("warning["), "{length}: {}", run.said);
            assert!(!run.said.contains("inf"), "{length}: {}", run.said);
        }
    }
}

/// One absurd length of thirty is reported as an outlier, and the result is as without it.
#[test]
fn one_absurd_length_is_an_outlier() {
    let args = ["--estimate", "alpha1-5,a1-5,d4-6"];
    for length in [1e-9, 1e6, 1e9] {
        let mut data = sound(27);
        data.rows[40].length_mm = length;
        let run = identify(&data.to_csv(), &args);
        let result = run.result.as_ref().unwrap_or_else(|| panic!("{length}: {}", run.said));
        let outliers: Vec<u32> = result.outliers.iter().map(|outlier| outlier.index).collect();
        if run.code != Some(3) {
            assert_eq!(outliers, [41], "{length}");
            for (name, error) in DESIGNED {
                assert!((run.parameter(name).0 - error).abs() < 1e-6, "{length} {name}");
            }
        }
    }
}

#[test]
fn every_length_an_outlier() {
    let mut data = sound(20);
    for (at, row) in data.rows.iter_mut().enumerate() {
        row.length_mm += 200.0 * (at as f64 * 12.9898).sin();
    }
    let run = identify(&data.to_csv(), &[]);
    assert_eq!(run.code, Some(3), "{}", run.said);
}

#[test]
fn sigmas_of_any_size() {
    for sigma in [1e-300, 1e-12, 1e12, 1e300] {
        let mut data = sound(20);
        data.rows.iter_mut().for_each(|row| row.sigma_mm = Some(sigma));
        said_or_right(&data, &format!("sigma {sigma}"));
        // One of them is not like the others.
        let mut data = sound(20);
        data.rows.iter_mut().for_each(|row| row.sigma_mm = Some(0.01));
        data.rows[3].sigma_mm = Some(sigma);
        said_or_right(&data, &format!("one sigma {sigma}"));
    }
    let text = sound(20).to_csv();
    let with = |cell: &str| {
        let mut lines = text.lines().map(str::to_owned).collect::<Vec<_>>();
        lines[1].push_str(cell);
        lines.join("\n")
    };
    for cell in ["0", "-0.01", "nan", "inf", "-inf", "1e999"] {
        let run = identify(&with(cell), &[]);
        assert_eq!(run.code, Some(1), "{cell}: {}", run.said);
        assert!(run.said.contains("obs.csv:2") && run.said.contains("sigma_mm"), "{cell}: {}", run.said);
    }
}

/// Full turns of an axis change only the last digits, until the angle has none left.
#[test]
fn angles_of_any_size() {
    for (turns, within) in [(1.0, 1e-6), (1e3, 1e-4)] {
        let mut data = sound(27);
        data.rows.iter_mut().for_each(|row| row.axes.degrees_mut()[5] += 360.0 * turns);
        let run = identify(&data.to_csv(), &["--estimate", "alpha1-5,a1-5,d4-6"]);
        for (name, error) in DESIGNED {
            assert!((run.parameter(name).0 - error).abs() < within, "{turns} turns: {name}");
        }
    }
    for angle in [1e9, 1e300, -1e308] {
        let mut data = sound(20);
        data.rows.iter_mut().for_each(|row| row.axes.degrees_mut()[1] = angle);
        said_or_right(&data, &format!("angle {angle}"));
        let mut data = sound(20);
        data.rows[7].axes.degrees_mut()[1] = angle;
        said_or_right(&data, &format!("one angle {angle}"));
    }
}

/// The tool never rotates, and the start axes are off by half a microdegree: tool and base ball have the same effect on the
/// lengths. Unidentifiable parameters stay at their start, and the result reports them with the reason.
#[test]
fn a_tool_that_never_rotates_stays_at_its_start() {
    let mut data = measure(&with_errors(DESIGNED), &[horizontal(1, CENTRE)], 80, 0.0);
    for (at, row) in data.rows.iter_mut().enumerate() {
        for (axis, angle) in row.axes.degrees_mut().iter_mut().enumerate() {
            *angle += 5e-7 * ((at * 6 + axis) as f64 * 78.233).sin();
        }
    }
    for args in [&[][..], &["--prior", "datasheet"][..]] {
        let run = identify(&data.to_csv(), args);
        let result = run.result.as_ref().unwrap();
        for axis in ["tool_x", "tool_y", "tool_z"] {
            let (correction, status) = run.parameter(axis);
            assert!(correction.abs() < 20.0, "{args:?} {axis}: {correction} {status:?}");
        }
        let held =
            |p: &&dbbd_model::estimation::result::ParameterResult| p.status == Status::PoorlyObservable;
        let reasons: Vec<&str> = result.parameters.iter().filter(held).map(|p| p.reason.as_str()).collect();
        assert!(
            reasons.iter().any(|text| text.contains("as where the tool never turns")),
            "{args:?} {reasons:?}"
        );
        assert!(run.parameter("centre1_x").0.abs() < 50.0, "{:?}", run.parameter("centre1_x"));
    }
}

/// The same bytes on one core and on all, for a set that is cut into pieces.
#[test]
#[cfg(target_os = "linux")]
fn one_core_or_all_give_the_same_bytes() {
    let dir = tempdir().unwrap();
    let mut data = sound(50);
    let rows = data.rows.clone();
    for copy in 0..60 {
        data.rows.extend(rows.iter().enumerate().map(|(at, row)| {
            let mut row = row.clone();
            row.length_mm += 0.01 * ((copy * 150 + at) as f64 * 43.332).sin();
            row
        }));
    }
    (1..).zip(&mut data.rows).for_each(|(index, row)| row.index = index);
    fs::write(dir.path().join("obs.csv"), data.to_csv()).unwrap();
    fs::write(dir.path().join("c.csv"), centres_csv(&[horizontal(1, CENTRE)])).unwrap();
    let identify = |out: &str, one_core: bool| {
        let args = [
            "identify",
            "obs.csv",
            "--robot",
            "kr60ha",
            "--tool",
            "30,20,10",
            "--centres",
            "c.csv",
            "--folds",
            "0",
            "--out",
            out,
        ];
        if one_core {
            let mut command = std::process::Command::new("taskset");
            command.args(["-c", "0", env!("CARGO_BIN_EXE_dbbd")]).args(args).current_dir(dir.path());
            let output = command.output().expect("taskset of util-linux");
            assert!(output.status.success() || output.status.code() == Some(3), "{}", stderr(&output));
        } else {
            dbbd(dir.path(), &args);
        }
    };
    let read = |out: &str, name: &str| fs::read(dir.path().join(out).join(name)).unwrap();
    identify("all", false);
    identify("again", false);
    identify("one", true);
    for name in ["result.json", "covariance.csv", "parameters.csv", "robot-identified.toml", "lengths.csv"] {
        assert!(read("all", name) == read("again", name), "{name} differs from run to run");
        assert!(read("all", name) == read("one", name), "{name} differs on one core");
    }
}
