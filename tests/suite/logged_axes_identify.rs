//! A controller in absolute-accuracy mode moves the axes to other angles than those of the plan. The axes that it logs in the `.dat`
//! replace them; without these the run ends with a warning.
#![cfg(unix)]

use std::fs;
use std::path::Path;

use dbbd_job::plan::PoseKind;
use dbbd_job::program::krl::{absolute_accuracy, logged_axes, parse_data};
use dbbd_job::sim::truth;
use dbbd_model::robot::Robot;
use tempfile::tempdir;

use crate::cell::{codes, dbbd, kr60, stderr};
use crate::process::Simulator;
use crate::support::production::chosen;

/// Simulates the program of a plan and records its lengths; the saved .dat files are in `dat`.
fn run(at: &Path, extra: &[&str]) {
    let program = ["--program", "krl/DBB_MAIN.src", "--speed", "0", "--halt", "0.5", "--save", "dat"];
    let truth = ["--robot", "truth.toml", "--world", "world.toml"];
    let simulator = Simulator::start(at, &[&program[..], &truth, extra].concat());
    let recorded = dbbd(
        at,
        &["acquire", "--port", &simulator.port, "--plan", "plan.csv", "--out", "run.dbbd", "--gone", "2"],
    );
    assert!(matches!(recorded.status.code(), Some(0 | 3)), "{}", stderr(&recorded));
    assert!(simulator.finished().status.success());
}

#[test]
fn logged_axes_replace_those_of_the_plan() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    let mut plan = chosen(1, 40, true);
    plan.header.job.motion.dwell_s = 0.6;
    plan.header.job.motion.settle_s = 0.3;
    plan.rows.iter_mut().filter(|row| row.dwell_s > 0.0).for_each(|row| row.dwell_s = 0.6);
    let (csv, json) = plan.to_files().unwrap();
    fs::write(at.join("plan.csv"), &csv).unwrap();
    fs::write(at.join("plan.json"), &json).unwrap();
    let true_robot = truth::draw_true_robot(&kr60(), 5, 1.0);
    fs::write(at.join("truth.toml"), true_robot.to_toml().unwrap()).unwrap();
    fs::write(at.join("world.toml"), "[bar]\nnoise_um = 20.0\n").unwrap();
    assert!(dbbd(at, &["krl", "plan.csv", "--out", "krl"]).status.success());

    // The controller knows its true robot: all lengths are as planned, and contain no information without the axes.
    run(at, &["--accuracy", "truth.toml"]);
    let blind = dbbd(at, &["identify", "run.dbbd", "--out", "blind"]);
    assert_eq!(blind.status.code(), Some(3), "{}", stderr(&blind));
    assert!(codes(&blind).contains(&"W1327".to_owned()), "{}", stderr(&blind));
    let other = dbbd(at, &["identify", "run.dbbd", "--robot", "kr16-2", "--out", "other"]);
    assert_eq!(other.status.code(), Some(3), "{}", stderr(&other));
    assert!(codes(&other).contains(&"W1328".to_owned()), "{}", stderr(&other));

    let text = fs::read_to_string(at.join("dat/DBB_C001.dat")).unwrap();
    let data = parse_data("DBB_C001.dat", &text).unwrap();
    assert_eq!(absolute_accuracy(&data), Some(true));
    let logged = logged_axes(&data).unwrap();
    let dwells = plan.rows.iter().filter(|row| row.kind != PoseKind::Transit);
    assert!(logged.keys().copied().eq(dwells.map(|row| row.index)));
    let sync = |extra: &[&str]| {
        let given = ["sync", "run.dbbd", "--out", "obs.csv", "--axes"];
        dbbd(at, &[&given[..], extra].concat())
    };
    let synced = sync(&["dat/DBB_C001.dat"]);
    assert_eq!(synced.status.code(), Some(0), "{}", stderr(&synced));
    assert_eq!(codes(&synced), ["I0420", "I1010"]);
    let balls = "centre,x_mm,y_mm,z_mm\n1,1300,0,800\n";
    fs::write(at.join("centres.csv"), balls).unwrap();
    let found = dbbd(
        at,
        &[
            "identify",
            "obs.csv",
            "--robot",
            "kr60ha",
            "--tool",
            "30,20,10",
            "--centres",
            "centres.csv",
            "--hold",
            "bar_offset",
            "--prior",
            "none",
            "--out",
            "seen",
        ],
    );
    // Without a prior 40 lengths leave half of the workspace open; that the axes were others is no warning any more.
    let warnings: Vec<String> = codes(&found).into_iter().filter(|code| code.starts_with('W')).collect();
    assert_eq!((found.status.code(), warnings), (Some(3), vec!["W1319".into()]), "{}", stderr(&found));
    let found = fs::read_to_string(at.join("seen/robot-identified.toml")).unwrap();
    let found = Robot::from_toml("robot-identified.toml", &found).unwrap();
    for (row, (is, was)) in found
        .geometry
        .rows
        .iter()
        .zip(true_robot.geometry.rows.iter().zip(kr60().geometry.rows))
        .enumerate()
        .skip(3)
    {
        let off = (is.alpha - was.0.alpha).abs();
        assert!(
            off < 2e-4,
            "alpha of row {row}: {off} rad from the truth, {} apart at first",
            was.0.alpha - was.1.alpha
        );
    }

    // Only a part of the axes, those of another plan, and a file that is not a `.dat`.
    let half = text.lines().filter(|line| !line.starts_with("XQ[1]=")).collect::<Vec<_>>().join("\r\n");
    fs::write(at.join("half.dat"), half + "\r\n").unwrap();
    let partly = sync(&["half.dat"]);
    assert_eq!(partly.status.code(), Some(3));
    assert!(codes(&partly).contains(&"W0413".to_owned()), "{}", stderr(&partly));
    fs::write(at.join("other.dat"), text.replacen("DBBPLAN[]=\"", "DBBPLAN[]=\"f", 1)).unwrap();
    let other = sync(&["other.dat"]);
    assert_eq!((other.status.code(), codes(&other)), (Some(1), vec!["E0408".to_owned()]));

    // The plan of another run.
    let mut second = plan.clone();
    second.rows[5].length_mm += 1.0;
    let (csv, json) = second.to_files().unwrap();
    fs::write(at.join("second.csv"), csv).unwrap();
    fs::write(at.join("second.json"), json).unwrap();
    let mismatched = dbbd(at, &["sync", "run.dbbd", "--plan", "second.csv", "--out", "obs2.csv"]);
    assert_eq!(mismatched.status.code(), Some(3));
    assert!(codes(&mismatched).contains(&"W0412".to_owned()), "{}", stderr(&mismatched));
}
