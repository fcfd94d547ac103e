//! `dbbd plan` writes the pair of a plan, and commands an identified robot through its nominal one.

use std::process::Command;

use dbbd_job::plan::{Plan, PoseKind};
use dbbd_model::robot::Robot;

use crate::cell::codes;

#[test]
fn the_command_writes_the_pair_and_commands_an_identified_robot_through_its_nominal_one() {
    let dir = tempfile::tempdir().unwrap();
    let job = format!("{}/examples/seed-experiment.toml", env!("CARGO_MANIFEST_DIR"));
    let mut identified = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
    identified.nominal = Some(Box::new(identified.clone()));
    identified.geometry.rows[2].a += 0.5;
    identified.geometry.rows[3].theta += 0.001;
    identified.geometry.rows[4].alpha += 0.0005;
    let file = dir.path().join("identified.toml");
    std::fs::write(&file, identified.to_toml().unwrap()).unwrap();
    let out = Command::new(env!("CARGO_BIN_EXE_dbbd"))
        .args(["plan", &job, "--json", "--out"])
        .arg(dir.path())
        .arg("--robot")
        .arg(&file)
        .output()
        .unwrap();
    // Without lengths.csv it is not known what the identification left unknown.
    assert_eq!(codes(&out).iter().filter(|code| *code == "W0720").count(), 1);
    assert_eq!(out.status.code(), Some(3), "{}", String::from_utf8_lossy(&out.stderr));
    let summary: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!(summary["measure"], 80);
    let read = |name: &str| std::fs::read_to_string(dir.path().join(name)).unwrap();
    let plan = Plan::from_files("plan.csv", &read("plan.csv"), "plan.json", &read("plan.json")).unwrap();
    for row in plan.rows.iter().filter(|row| row.kind == PoseKind::Measure) {
        let axes = row.axes_deg.map(f64::to_radians);
        // The true arm's ball lies on the circle, the commanded one beside it.
        let ball = identified.geometry.ball(&axes).position;
        let centre = nalgebra::Vector3::new(1300.0, 0.0, 800.0);
        assert!(((ball - centre).norm() - 300.0).abs() < 3e-3);
        let commanded = identified.controller().geometry.ball(&axes).position;
        assert!((commanded - nalgebra::Vector3::from(row.xyz_mm)).norm() < 1e-6);
        assert!((commanded - ball).norm() > 0.05);
    }
}
