//! The commands on programs in RAPID and URScript: the robot selects the language, and a program is corrected once and for its own robot.

use std::fs;
use std::path::Path;

use dbbd_job::sim::truth;
use dbbd_model::robot::Robot;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::cell::named;
use crate::cell::{codes, dbbd};
use crate::programs_of_other_makes::{edit, plan_in_a_directory};
use crate::support::makes::job;

/// A directory with the plan of the ABB arm.
fn planned() -> TempDir {
    plan_in_a_directory(&job("irb1600-10-145", [900.0, 0.0, 850.0], 8))
}

fn said(dir: &Path, args: &[&str]) -> (Option<i32>, Vec<String>) {
    let output = dbbd(dir, args);
    (output.status.code(), codes(&output))
}

#[test]
fn robot_selects_the_language_and_unsupported_options_are_refused() {
    let dir = planned();
    let at = dir.path();
    let program = |more: &[&str]| {
        // Each has its own directory, because modules of another plan would be reported.
        let out = format!("p{}", more.join(""));
        said(at, &[&["program", "--replace", "plan.csv", "--out", &out], more].concat())
    };
    // The language of the robot is the default; another one is refused.
    assert_eq!(program(&[]), (Some(0), vec![]));
    assert!(at.join("p/DBB_MAIN.mod").exists() && at.join("p/DBB.pgf").exists());
    assert_eq!(program(&["--language", "krl"]), (Some(1), vec!["E0824".into()]));
    assert_eq!(program(&["--language", "urscript"]), (Some(1), vec!["E0824".into()]));
    assert_eq!(program(&["--sync", "ekrl", "--server", "10.0.0.1:9"]), (Some(1), vec!["E0883".into()]));
    assert_eq!(program(&["--controller", "krc2"]), (Some(1), vec!["E0883".into()]));
    // A UR has the outputs 0 to 7.
    let ur = named("ur10").to_toml().unwrap();
    edit(at, |header| header["robot"] = json!(ur));
    assert_eq!(program(&["--language", "urscript"]), (Some(0), vec![]));
    edit(at, |header| header["job"]["motion"]["outputs"] = json!({ "strobe": 8, "index": [9, 16] }));
    assert_eq!(program(&["--sync", "output"]), (Some(1), vec!["E0823".into()]));
    assert_eq!(program(&["--sync", "marker"]), (Some(0), vec![]));
}

#[test]
fn programs_are_corrected_once_and_for_their_own_robot() {
    let dir = planned();
    let at = dir.path();
    assert_eq!(said(at, &["program", "plan.csv", "--out", "p"]).0, Some(0));
    let identified = |name: &str| {
        let robot = named(name);
        let drawn = truth::draw_true_robot(&robot, 1, 1.0);
        let found = Robot { name: robot.name.clone(), nominal: Some(Box::new(robot.clone())), ..drawn };
        fs::write(at.join(format!("{name}.toml")), found.to_toml().unwrap()).unwrap();
    };
    ["irb1600-10-145", "irb120", "ur10"].into_iter().for_each(identified);
    let compensate = |program: &str, robot: &str, out: &str| {
        said(
            at,
            &["compensate", "--replace", program, "--robot", robot, "--out", out, "--limit", "20", "--quiet"],
        )
    };
    assert_eq!(compensate("p/DBB_C001.mod", "irb1600-10-145.toml", "new"), (Some(0), vec![]));
    assert_eq!(
        compensate("new/DBB_C001.mod", "irb1600-10-145.toml", "twice"),
        (Some(1), vec!["E1801".into()])
    );
    assert_eq!(compensate("p/DBB_C001.mod", "irb120.toml", "other"), (Some(1), vec!["E1802".into()]));
    assert_eq!(compensate("p/DBB_C001.mod", "ur10.toml", "other"), (Some(1), vec!["E0824".into()]));
    assert_eq!(compensate("p/DBB_C001.mod", "irb1600-10-145.toml", "p"), (Some(1), vec!["E0910".into()]));
    let frames = [
        "compensate",
        "--replace",
        "p/DBB_C001.mod",
        "--robot",
        "irb1600-10-145.toml",
        "--out",
        "x",
        "--tool",
        "0,0,0,0,0,0",
    ];
    assert_eq!(said(at, &frames), (Some(1), vec!["E0910".into()]));
    for (name, robot) in [("P.mod", "irb1600-10-145.toml"), ("P.script", "ur10.toml"), ("P.txt", "ur10.toml")]
    {
        fs::write(at.join(name), "x_mm,y_mm\n1,2\n").unwrap();
        assert_eq!(compensate(name, robot, "no"), (Some(1), vec!["E0913".into()]), "{name}");
    }
    // A UR controller has a factory table.
    let script = "def P():\n  set_tcp(p[0,0,0.1,0,0,0])\n  movej([0,-1.5,1.5,-1.5,-1.5,0])\n  movel(p[0.7,0.1,0.4,2.2,2.2,0])\nend\n";
    fs::write(at.join("P.script"), script).unwrap();
    assert_eq!(compensate("P.script", "ur10.toml", "ur"), (Some(1), vec!["E0917".into()]));
    assert!(!at.join("ur").exists());
    let nominal = [
        "compensate",
        "P.script",
        "--robot",
        "ur10.toml",
        "--out",
        "ur",
        "--controller-model",
        "nominal",
        "--limit",
        "20",
        "--json",
    ];
    let output = dbbd(at, &nominal);
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    // Without a posterior nothing is known of the error.
    assert!(found["predicted_position_uncertainty_mm"].is_null(), "{found}");
    assert_eq!((output.status.code(), found["points"].as_array().unwrap().len()), (Some(0), 2));
    // The corrected module has its provenance.
    let info = dbbd(at, &["info", "new/DBB_C001.mod"]);
    let text = String::from_utf8_lossy(&info.stdout).into_owned();
    assert!(info.status.success() && text.contains("identified robot"), "{text}");
}
