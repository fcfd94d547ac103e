//! What is known of a robot fades with the months: its file has its day, predictions widen, the result states until when it is
//! valid, and a few lengths renew it.

use std::fs;
use std::path::Path;

use dbbd_model::robot::{ParamId, Robot};
use serde_json::Value;
use tempfile::tempdir;

use crate::ball_is_mounted_again::robot_of;
use crate::cell::{codes, dbbd, stderr};
use crate::support::drawn_robots::{BALLS, drawn, lengths};

fn json(at: &Path, file: &str) -> Value {
    serde_json::from_str(&fs::read_to_string(at.join(file)).unwrap()).unwrap()
}

/// Identifies lengths that were measured on a day at a temperature.
fn identify(at: &Path, lengths: &str, robot: &str, out: &str, day: &str, celsius: f64) -> Value {
    let identity = format!("measured = '{day}'\n[[temperature]]\nof = 'robot'\ncelsius = {celsius:?}\n");
    fs::write(at.join("identity.toml"), identity).unwrap();
    let args =
        ["identify", lengths, "--robot", robot, "--centres", "C.csv", "--bar-u", "0.002", "--folds", "0"];
    // The file of an identified robot has its tool.
    let tool = if robot == "kr60ha" { &["--tool", "30,20,10"][..] } else { &[] };
    let done = dbbd(
        at,
        &[&args[..], tool, &["--identity", "identity.toml", "--tolerance", "2", "--out", out]].concat(),
    );
    assert!(matches!(done.status.code(), Some(0 | 3)), "{}", stderr(&done));
    json(at, &format!("{out}/result.json"))
}

/// A drawn robot, and its calibration `first` of a day with the job of its base balls.
pub(crate) fn calibrated_on(at: &Path, day: &str) -> (Robot, Value) {
    let balls = (1..).zip(BALLS).map(|(ball, [x, y, z])| format!("{ball},{x},{y},{z}\n"));
    fs::write(at.join("C.csv"), format!("centre,x_mm,y_mm,z_mm\n{}", balls.collect::<String>())).unwrap();
    let mut job = String::from(
        "robot = \"kr60ha\"\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = 300.0\nstroke_mm = [-15.0, 15.0]\nmargin_mm = 0.5\nsigma_um = 10.0\nlength_u_mm = 0.004\n",
    );
    for (id, place) in (1..).zip(BALLS) {
        job += &format!("[[centre]]\nid = {id}\nxyz_mm = {place:?}\n");
    }
    fs::write(at.join("job.toml"), job + "[optimise]\npoints = 40\n").unwrap();
    let truth = drawn(4);
    fs::write(at.join("obs.csv"), lengths(&truth, 70, 3, 1).to_csv()).unwrap();
    let first = identify(at, "obs.csv", "kr60ha", "first", day, 19.5);
    (truth, first)
}

/// Mean `sd_mm` of poses.
fn predicted_mm(at: &Path, more: &[&str]) -> f64 {
    let poses = "a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg\n0,-60,90,10,40,0\n30,-40,70,-20,60,30\n-40,-90,100,0,50,10\n";
    fs::write(at.join("axes.csv"), poses).unwrap();
    let args = ["predict", "axes.csv", "--robot", "first/robot-identified.toml", "--out", "p.csv"];
    let done = dbbd(at, &[&args[..], more].concat());
    assert!(matches!(done.status.code(), Some(0 | 3)), "{}", stderr(&done));
    let text = fs::read_to_string(at.join("p.csv")).unwrap();
    let sds: Vec<f64> =
        text.lines().skip(1).map(|row| row.split(',').nth(15).unwrap().parse().unwrap()).collect();
    sds.iter().sum::<f64>() / sds.len() as f64
}

#[test]
fn the_validity_of_an_old_calibration_is_over() {
    let dir = tempdir().unwrap();
    let (_, result) = calibrated_on(dir.path(), "1999-03-01");
    let until = result["validity"]["until"].as_str().unwrap();
    assert!(until < "2026", "{until}");
    let info = dbbd(dir.path(), &["info", "first/robot-identified.toml"]);
    assert_eq!((info.status.code(), codes(&info)), (Some(3), vec!["W1853".to_owned()]), "{}", stderr(&info));
}

#[test]
fn a_calibration_fades_and_is_renewed() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    let (truth, first) = calibrated_on(at, "2024-02-29");
    let robot = robot_of(&at.join("first"));
    assert_eq!(robot.measured.date.as_deref(), Some("2024-02-29"));
    assert_eq!(robot.measured.temperature_c, Some(19.5));
    let validity = &first["validity"];
    assert_eq!((&validity["measured"], &validity["basis"]), (&"2024-02-29".into(), &"hyper_prior".into()));
    let u_mm = validity["expanded_uncertainty_mm"].as_f64().unwrap();
    // One number: the line, the budget and the page say the same.
    let of_budget = first["budget"]["expanded_mm"].as_f64().unwrap();
    assert!((u_mm / of_budget - 1.0).abs() < 1e-9, "{u_mm} {of_budget}");
    let turned = &first["predicted_orientation_uncertainty_mrad"];
    let [before, after] = ["nominal", "identified"].map(|when| turned[when]["mean"].as_f64().unwrap());
    assert!(after > 0.0 && after < before, "{turned}");
    assert_eq!(validity["limit_mm"], 2.0);
    assert!((1.0..=12.0).contains(&validity["months"].as_f64().unwrap()), "{validity}");
    // U is twice the 3-D error of the workspace.
    let mean = first["predicted_position_uncertainty_mm"]["identified"]["mean"].as_f64().unwrap();
    assert!((0.9..1.5).contains(&(u_mm / (2.0 * mean))), "{u_mm} {mean}");

    let [day, years, warm] = [
        &["--date", "2024-02-29"][..],
        &["--date", "2026-02-28"],
        &["--date", "2026-02-28", "--temperature", "20.0"],
    ]
    .map(|more| predicted_mm(at, more));
    assert!(years > 1.1 * day && warm < years && warm > day, "{day} {warm} {years}");
    // Before the calibration, and long after it.
    for far in ["2023-12-31", "2224-02-29"] {
        let args = ["predict", "axes.csv", "--robot", "first/robot-identified.toml", "--out", "p.csv"];
        let warned = dbbd(at, &[&args[..], &["--date", far]].concat());
        assert_eq!((warned.status.code(), codes(&warned)), (Some(3), vec!["W0584".to_owned()]), "{far}");
    }
    let today = predicted_mm(at, &[]);
    assert!(today >= years, "{today} {years}");
    for wrong in [["--date", "2024-02-30"], ["--temperature", "293.15"]] {
        let args = ["predict", "axes.csv", "--robot", "first/robot-identified.toml", "--out", "p.csv"];
        let refused = dbbd(at, &[&args[..], &wrong].concat());
        assert_eq!(refused.status.code(), Some(2), "{wrong:?} {}", stderr(&refused));
    }
    let text = fs::read_to_string(at.join("first/robot-identified.toml")).unwrap();
    for (was, becomes) in
        [("date = \"2024-02-29\"", "date = \"yesterday\""), ("temperature_c = 19.5", "temperature_c = 292.0")]
    {
        assert!(Robot::from_toml("robot.toml", &text.replacen(was, becomes, 1)).is_err(), "{becomes}");
    }
    let drift = |zero: f64| format!("{text}\n[drift]\nzero_rad = {zero:?}\nln_sd = 0.5\nintervals = 3\n");
    let learnt = Robot::from_toml("robot.toml", &drift(3e-6)).unwrap();
    assert_eq!(Robot::from_toml("robot.toml", &learnt.to_toml().unwrap()).unwrap(), learnt);
    assert_eq!(Robot::from_toml("robot.toml", &drift(0.5)).unwrap_err().code().as_str(), "E0505");

    // 20 lengths that renew it are planned with what is known today, and continue the posterior.
    let plan = ["plan", "job.toml", "--renew", "--robot", "first/robot-identified.toml", "--out", "renewal"];
    let planned = dbbd(at, &plan);
    assert!(matches!(planned.status.code(), Some(0 | 3)), "{}", stderr(&planned));
    let prediction = &json(at, "renewal/plan.json")["predictions"];
    assert_eq!(prediction["lengths"].as_u64().map(|lengths| lengths >= 20), Some(true), "{prediction}");
    let [now, then] = ["now_mm", "identified_mm"].map(|key| prediction[key]["mean"].as_f64().unwrap());
    assert!(then < 0.9 * now, "{now} {then}");
    let few = dbbd(
        at,
        &["plan", "job.toml", "--renew=5", "--robot", "first/robot-identified.toml", "--out", "few"],
    );
    assert_eq!(few.status.code(), Some(2));
    let nominal = dbbd(at, &["plan", "job.toml", "--renew", "--robot", "kr60ha", "--out", "none"]);
    assert_eq!(nominal.status.code(), Some(1), "{}", stderr(&nominal));

    // Two years later a zero has wandered by 100 urad: no alarm, and the lengths find it.
    let mut later = truth;
    let zero: ParamId = "theta3".parse().unwrap();
    *later.geometry.value_mut(zero).unwrap() += 1e-4;
    fs::write(at.join("later.csv"), lengths(&later, 8, 3, 2).to_csv()).unwrap();
    let args = [
        "check",
        "later.csv",
        "--robot",
        "first/robot-identified.toml",
        "--centres",
        "C.csv",
        "--bar-u",
        "0.002",
        "--tolerance",
        "2",
    ];
    let checked = dbbd(at, &[&args[..], &["--out", "check"]].concat());
    assert_eq!(checked.status.code(), Some(0), "{}", stderr(&checked));
    assert!(json(at, "check/check.json")["validity"]["until"].is_string());
    let standing = || {
        let info = dbbd(at, &["info", "first/robot-identified.toml"]);
        (info.status.code(), codes(&info))
    };
    assert_eq!(standing(), (Some(0), Vec::new()));
    // A zero that is lost fails the check, and the robot file is not to be used.
    let mut lost = later.clone();
    *lost.geometry.value_mut(zero).unwrap() += 5e-3;
    fs::write(at.join("lost.csv"), lengths(&lost, 8, 3, 3).to_csv()).unwrap();
    let mut of_lost = args;
    of_lost[1] = "lost.csv";
    let failed = dbbd(at, &[&of_lost[..], &["--out", "check"]].concat());
    assert_eq!(failed.status.code(), Some(4), "{}", stderr(&failed));
    assert_eq!(standing(), (Some(3), vec!["W1852".to_owned()]));
    let second = identify(at, "later.csv", "first/robot-identified.toml", "second", "2026-02-28", 20.0);
    assert_eq!(second["prior"], "posterior");
    let renewed = robot_of(&at.join("second"));
    assert_eq!(renewed.measured.date.as_deref(), Some("2026-02-28"));
    // One interval is no history yet, but the rate of the zeros is known better.
    assert_eq!((renewed.drift.intervals, renewed.drift.has_history()), (1, false));
    assert!(renewed.drift.ln_sd < robot.drift.ln_sd, "{:?}", renewed.drift);
    let moved = renewed.geometry.value(zero).unwrap() - robot.geometry.value(zero).unwrap();
    assert!((moved / 1e-4 - 1.0).abs() < 0.5, "{moved}");

    // The certificate has the line.
    let made = dbbd(at, &["certificate", "second", "--out", "certificate"]);
    assert!(matches!(made.status.code(), Some(0 | 3)), "{}", stderr(&made));
    let until = second["validity"]["until"].as_str().unwrap();
    for page in ["certificate/certificate.html", "second/report.html"] {
        assert!(fs::read_to_string(at.join(page)).unwrap().contains(until), "{page}");
    }
    assert!(!codes(&made).iter().any(|code| code.starts_with('E')));
}
