//! Poses and lengths from Pinocchio (tests/independent/golden.py), which shares no code with dbbd: these tests show errors that the
//! simulator and the fit have in common.

use std::fs;
use std::path::{Path, PathBuf};

use dbbd_model::estimation::CalibrationResult;
use dbbd_model::estimation::result::Status;
use dbbd_model::robot::ParamUnit;
use tempfile::tempdir;

use crate::cell::{DESIGNED, dbbd, stderr};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).to_path_buf()
}

fn identify(observations: &str, extra: &[&str]) -> CalibrationResult {
    let dir = tempdir().unwrap();
    let observations = root().join(observations);
    let centres = root().join("examples/paper/centres.csv");
    let mut args = vec!["identify", observations.to_str().unwrap(), "--centres", centres.to_str().unwrap()];
    args.extend(["--robot", "kr60ha", "--tool", "30,20,10", "--out", "out"]);
    args.extend(extra);
    let output = dbbd(dir.path(), &args);
    assert!(matches!(output.status.code(), Some(0 | 3)), "{}", stderr(&output));
    serde_json::from_str(&fs::read_to_string(dir.path().join("out/result.json")).unwrap()).unwrap()
}

#[test]
fn experiment_of_the_paper_on_independent_lengths() {
    let result = identify("examples/paper/observations.csv", &["--estimate", "alpha1-5,a1-5,d4-6"]);
    assert!(result.converged && result.iterations <= 8);
    for (name, designed) in DESIGNED {
        let found = result.parameters.iter().find(|p| p.name.to_string() == name).unwrap();
        assert!((found.correction - designed).abs() < 1e-9, "{name}: {} for {designed}", found.correction);
    }
}

/// Every identified parameter has the true value of what it represents: its own error and that of the parameters that depend on it.
#[test]
fn robot_with_errors_everywhere_is_identified() {
    let result = identify("fixtures/golden/three_planes.csv", &["--folds", "0", "--hold", "bar_offset"]);
    let truth = fs::read_to_string(root().join("fixtures/golden/three_planes_truth.csv")).unwrap();
    let error = |name: &str| -> f64 {
        let line = truth.lines().find(|line| line.split(',').next() == Some(name));
        line.map_or(0.0, |line| line.split(',').nth(1).unwrap().parse().unwrap())
    };
    let identified: Vec<_> = result.parameters.iter().filter(|p| p.status == Status::Identified).collect();
    // The others are errors of joints, which the data limit to nothing.
    assert_eq!(identified.iter().filter(|parameter| !parameter.name.is_optional()).count(), 24);
    let correction = |name: &str| {
        let found = result.parameters.iter().find(|parameter| parameter.name.to_string() == name);
        found.map_or(0.0, |parameter| parameter.correction)
    };
    for parameter in identified {
        let name = parameter.name.to_string();
        let group = result.combinations.iter().find(|group| group.kept == parameter.name);
        // The prior distributes a sum over its members.
        let sum = |of: &dyn Fn(&str) -> f64| match group {
            // The coefficients are those of the nominal geometry; errors of a mrad change them by as much.
            Some(group) => group.members.iter().map(|(id, share)| share * of(&id.to_string())).sum(),
            None => of(&name),
        };
        let (found, expected) = (sum(&correction), sum(&error));
        let near = if parameter.unit == ParamUnit::Mm { 5e-3 } else { 5e-6 };
        assert!((found - expected).abs() < near, "{name}: {found} for {expected}");
    }
}

/// The robot has sag, backlash and a transmission error that the model lacks: the result reports it.
#[test]
fn unmodelled_errors_are_reported() {
    let result = identify(
        "fixtures/golden/unmodelled.csv",
        &["--sigma", "0.005", "--folds", "0", "--model", "geometric"],
    );
    let warning = result.findings.iter().find(|w| w.code() == "W1316");
    assert!(warning.is_some(), "{:?}", result.findings);
    assert!(result.residual_mm.after.rms > 0.02);
}
