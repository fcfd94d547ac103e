//! Passes without stops through the program, from the plan to the circular test.

use crate::cell::{dbbd, stderr};

/// Plan, program, simulated cell, capture, lengths, identification and circular test of passes without stops.
#[test]
fn passes_are_evaluated_end_to_end() {
    let dir = tempfile::tempdir().unwrap();
    let job = "robot = \"kr60ha\"\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = 300.0\nstroke_mm = [-6.0, 6.0]\n[[centre]]\nid = 1\n\
               xyz_mm = [1300.0, 0.0, 800.0]\n[[circle]]\nplane = \"XY\"\norientation = \"fixed\"\ntilt_deg = 25.0\n\
               points = 72\ndirection = \"both\"\nmode = \"continuous\"\n[motion]\nfeed_mm_s = 60.0\n";
    std::fs::write(dir.path().join("job.toml"), job).unwrap();
    let dbbd = |args: &[&str]| {
        let output = dbbd(dir.path(), args);
        let said = String::from_utf8_lossy(&output.stdout).into_owned() + &stderr(&output);
        assert!(matches!(output.status.code(), Some(0 | 3)), "{args:?}: {said}");
        said
    };
    dbbd(&["plan", "job.toml", "--out", "plan"]);
    dbbd(&["acquire", "--port", "sim", "--plan", "plan/plan.csv", "--out", "run"]);
    let said = dbbd(&["sync", "run", "--out", "obs.csv"]);
    assert!(said.contains("144 of 144 poses have a length (dwells by the strobe)"), "{said}");
    assert!(said.contains("circle 1: the reading comes") && said.contains(") after the command"), "{said}");
    let said = dbbd(&["identify", "run", "--out", "id"]);
    assert!(said.contains("144 lengths"), "{said}");
    let said = dbbd(&["circle", "run", "--out", "circle"]);
    assert!(said.contains("Gb"), "{said}");
}
