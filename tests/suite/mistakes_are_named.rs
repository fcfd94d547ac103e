//! Inputs that contradict each other, and options that have no effect, are refused or reported with a warning.

use std::fs;
use std::path::Path;
use std::process::Output;

use dbbd_job::recording::run::read_plan;
use dbbd_job::sim::truth;
use dbbd_model::robot::{ControllerModel, Robot};
use tempfile::tempdir;

use crate::cell::{codes, dbbd, measure, stderr, three_planes, with_errors};
use crate::nothing_wrong_is_silent::{ERRORS, JOB, cell, identify, says};

fn done(output: &Output) {
    assert_eq!(output.status.code(), Some(0), "{}", stderr(output));
}

const PRIOR: [&str; 2] = ["--prior", "datasheet"];

#[test]
fn certificates_of_two_calibrations() {
    let (dir, data) = cell();
    let at = dir.path();
    fs::write(
        at.join("id.toml"),
        "robot = \"KR-1\"\ncontroller = \"C-1\"\nmeasured = \"2026-03-02\"\nload_kg = 5.0\noperator = \"A. Example\"\n\
         balls = { 1 = \"S-1\" }\n[bar]\nserial = \"B-1\"\ncertificate = \"K-1\"\ncertified_on = \"2026-03-01\"\nlength_mm = 300.0\n\
         length_u_mm = 0.002\ntemperature_c = 20.0\nexpansion_per_k = 12e-6\n[[temperature]]\nof = \"bar\"\ncelsius = 20.12\nu_k = 0.4\n",
    )
    .unwrap();
    done(&identify(at, &data.to_csv(), &[&PRIOR[..], &["--identity", "id.toml"]].concat()));
    fs::rename(at.join("out"), at.join("first")).unwrap();
    let mut other = data.clone();
    other.rows.iter_mut().for_each(|row| row.length_mm += 1e-4);
    done(&identify(at, &other.to_csv(), &PRIOR));
    let again = measure(&with_errors(ERRORS), &three_planes(1, [1300.0, 0.0, 800.0]), 8, 20.0);
    fs::write(at.join("again.csv"), again.to_csv()).unwrap();
    let robot = "first/robot-identified.toml";
    let check = |more: &[&str]| {
        let given = ["check", "again.csv", "--robot", robot, "--centres", "C.csv", "--out", "check"];
        dbbd(at, &[&given[..], more].concat())
    };
    says(&check(&[]), 3, "W1921");
    let certificate = |result: &str, more: &[&str]| {
        dbbd(at, &[&["certificate", result, "--out", "certificate"][..], more].concat())
    };
    // The lengths of the check agree too well (W1921): a certificate has this warning too. The check beside the result counts.
    for more in [&[][..], &["--check", "check"]] {
        says(&certificate("first", more), 3, "W2005");
    }
    says(&certificate("out", &["--check", "check"]), 1, "E2002");
    for stated in [
        "robot = \"KR-2\"",
        "measured = \"2025-03-02\"",
        "controller = \"C-2\"",
        "load_kg = 60.0",
        "balls = { 1 = \"S-2\" }",
        "[bar]\nserial = \"B-2\"",
        "[bar]\nlength_mm = 250.0",
        "[bar]\ncertificate = \"K-2\"",
        "[bar]\ncertified_on = \"2001-03-01\"",
        "[bar]\nlength_u_mm = 0.2",
        "[bar]\ntemperature_c = 35.0",
        "[bar]\nexpansion_per_k = 23e-6",
        "[[temperature]]\nof = \"bar\"\ncelsius = 22.0",
        "[[temperature]]\nof = \"bar\"\ncelsius = 20.1\nu_k = 0.1",
        "balls = { 7 = \"S-7\" }",
    ] {
        fs::write(at.join("other.toml"), stated).unwrap();
        says(&certificate("first", &["--identity", "other.toml"]), 3, "W2007");
    }
    // Another operator, and a rounded temperature.
    let same =
        "operator = \"B. Other\"\nballs = { 1 = \"S-1\" }\n[[temperature]]\nof = \"bar\"\ncelsius = 20.1\n";
    fs::write(at.join("other.toml"), same).unwrap();
    let output = certificate("first", &["--identity", "other.toml"]);
    assert!(!codes(&output).contains(&"W2007".to_owned()), "{}", stderr(&output));
    // Micrometres, radians, one pose many times.
    assert_eq!(check(&["--tool-repeat", "10"]).status.code(), Some(2));
    for (option, value) in [("--tolerance", "300"), ("--repeat-u", "5")] {
        let args = ["compare", "first", "out", "--out", "compared", option, value];
        assert_eq!(dbbd(at, &args).status.code(), Some(2));
    }
    let dates = ["compare", "first", "out", "--out", "compared", "--dates", "2026-01-01,2399-01-01"];
    says(&dbbd(at, &dates), 1, "E1904");
    let header = "a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg\n";
    let radians: String = (0..20).map(|at| format!("0.1,-1.2,1.{at:02},0.1,0.5,0.2\n")).collect();
    fs::write(at.join("workspace.csv"), format!("{header}{radians}")).unwrap();
    let output = check(&["--workspace", "workspace.csv"]);
    assert!(codes(&output).contains(&"W1281".into()), "{}", stderr(&output));
    fs::write(at.join("workspace.csv"), format!("{header}{}", "0,-60,90,0,60,0\n".repeat(40))).unwrap();
    says(&check(&["--workspace", "workspace.csv"]), 1, "E1301");
}

#[test]
fn files_of_an_earlier_result_are_removed() {
    let (dir, data) = cell();
    let at = dir.path();
    let is_there = |name: &str| at.join(name).exists();
    done(&identify(at, &data.to_csv(), &PRIOR));
    assert!(is_there("out/lengths.csv") && !is_there("out/positions.csv"));
    // The tool ball of the identified robot: positions without noise.
    done(&dbbd(at, &["predict", "obs.csv", "--robot", "out/robot-identified.toml", "--out", "pos.csv"]));
    let positions = |more: &[&str]| {
        let given = [
            "identify", "pos.csv", "--robot", "kr60ha", "--tool", "30,20,10", "--out", "out", "--folds", "0",
        ];
        dbbd(at, &[&given[..], &PRIOR, &["--model", "geometric"], more].concat())
    };
    says(&positions(&["--centres", "C.csv"]), 1, "E1361");
    says(&positions(&["--bar-u", "0.01"]), 1, "E1361");
    assert!(is_there("out/lengths.csv"));
    assert!(positions(&[]).status.code() != Some(1));
    assert!(is_there("out/positions.csv") && !is_there("out/lengths.csv"));
    done(&identify(at, &data.to_csv(), &PRIOR));
    assert!(is_there("out/lengths.csv") && !is_there("out/positions.csv"));
    // A table of the user with the name of a table of the result.
    fs::write(at.join("out/positions.csv"), "measured with another instrument").unwrap();
    done(&identify(at, &data.to_csv(), &PRIOR));
    assert!(is_there("out/positions.csv"));

    for (name, more) in [("a.csv", 0.0), ("b.csv", 0.01)] {
        let rows = (0..72)
            .map(|n| format!("1,ccw,{},{}\n", 5 * n, 300.0 + more + 0.05 * (0.17 * f64::from(n)).sin()));
        fs::write(at.join(name), format!("run,direction,angle_deg,length_mm\n{}", rows.collect::<String>()))
            .unwrap();
    }
    let circle =
        |files: &[&str]| dbbd(at, &[&["circle", "--out", "q", "--monte-carlo", "0"][..], files].concat());
    done(&circle(&["a.csv", "b.csv"]));
    assert!(is_there("q/circle-2.svg"));
    done(&circle(&["a.csv"]));
    assert!(is_there("q/circle.svg") && !is_there("q/circle-2.svg"));
}

#[test]
fn jobs_and_identities() {
    let (dir, _) = cell();
    let at = dir.path();
    for (from, to) in [
        ("[[centre]]", "certified_on = \"2399-01-01\"\n[[centre]]"),
        ("[[centre]]", "certified_on = \"1926-01-01\"\n[[centre]]"),
        ("[motion]", "[identity]\nmeasured = \"2399-01-01\"\n[motion]"),
        ("[motion]", "[identity]\nballs = { 7 = \"S-7\" }\n[motion]"),
    ] {
        fs::write(at.join("bad.toml"), JOB.replacen(from, to, 1)).unwrap();
        says(&dbbd(at, &["plan", "bad.toml", "--out", "plan"]), 1, "E0680");
    }
    fs::create_dir(at.join("plans")).unwrap();
    for identity in [
        "measured = \"1900-01-01\"",
        "measured = \"2026-03-02T25:61:00Z\"",
        "measured = \"2026-03-02Tmorning\"",
        "operator = \"  \"",
        "country = \"UK\"",
        "balls = { 01 = \"S-1\" }",
        "[[identity.temperature]]\nof = \"air\"\ncelsius = 20\n[[identity.temperature]]\nof = \"air\"\ncelsius = 25",
    ] {
        fs::write(at.join("service.toml"), format!("plans = \"plans\"\n[identity]\n{identity}\n")).unwrap();
        says(&dbbd(at, &["serve", "--check", "--config", "service.toml"]), 1, "E0680");
    }
    fs::write(
        at.join("service.toml"),
        "plans = \"plans\"\n[identity]\nmeasured = \"2026-03-02T10:59:00Z\"\n",
    )
    .unwrap();
    done(&dbbd(at, &["serve", "--check", "--config", "service.toml"]));
}

#[test]
fn lengths_measured_before_and_traces() {
    let (dir, data) = cell();
    let at = dir.path();
    let plan = |table: &str| {
        fs::write(at.join("measured.csv"), table).unwrap();
        dbbd(at, &["plan", "job.toml", "--measured", "measured.csv", "--out", "plan"])
    };
    done(&plan(&data.to_csv()));
    let mut sorted = data.clone();
    let mut lengths: Vec<f64> = data.rows.iter().map(|row| row.length_mm).collect();
    lengths.sort_by(f64::total_cmp);
    sorted.rows.iter_mut().zip(lengths).for_each(|(row, length_mm)| row.length_mm = length_mm);
    says(&plan(&sorted.to_csv()), 3, "W1381");
    let (header, rows) = data.to_csv().split_once('\n').map(|(a, b)| (a.to_owned(), b.to_owned())).unwrap();
    let rows: String = rows.lines().map(|row| format!("{row},-127\n")).collect();
    says(&identify(at, &format!("{header},temp_c\n{rows}"), &PRIOR), 3, "W0131");

    let planned_s = read_plan(&at.join("plan/plan.csv")).unwrap().duration_s();
    // Traces as multiples of the plan: waits for the operator, and a clock that runs slow.
    for (times, exit, code) in [(20.0, 0, "I1113"), (0.93, 3, "W1110")] {
        let trace: String = (0..9600)
            .map(|n| {
                let share = f64::from(n) / 9599.0;
                format!("{},{}\n", share * times * planned_s, 300.0 + 0.001 * f64::from(n % 7))
            })
            .collect();
        fs::write(at.join("trace.csv"), format!("t_s,length_mm\n{trace}")).unwrap();
        let _ = fs::remove_file(at.join("run"));
        let import = ["import", "trace.csv", "--plan", "plan/plan.csv", "--out", "run"];
        says(&dbbd(at, &import), exit, code);
    }
}

const RAPID: &str = "MODULE Weld\nPERS tooldata tGun:=[TRUE,[[0,0,0],[1,0,0,0]],[3,[0,0,80],[1,0,0,0],0,0,0]];\n\
    PERS wobjdata wFix:=[FALSE,TRUE,\"\",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];\n\
    CONST robtarget p10:=[[1200.0,0.0,850.0],[0.0,0.991444861,0.0,-0.130526192],[0,0,-2,0],[9E9,9E9,9E9,9E9,9E9,9E9]];\n\
    CONST robtarget p20:=[[1190.0,0.0,850.0],[0.0,0.991444861,0.0,-0.130526192],[0,0,-2,0],[9E9,9E9,9E9,9E9,9E9,9E9]];\n\
    PROC main()\nMoveJ p10,v100,fine,tGun\\WObj:=wFix;\nENDPROC\nENDMODULE\n";
/// A statement after the end of the routine or in the module, the exit code, and the code.
const OF_RAPID: &[(&str, &str, i32, &str)] = &[
    ("ENDPROC", "TriggL p20,v100,t1,fine,tGun;\nENDPROC", 3, "W0905"),
    ("ENDPROC", "MovL p20,v100,fine,tGun;\nENDPROC", 3, "W0905"),
    ("ENDPROC", "MoveL *,v100,fine,tGun;\nENDPROC", 3, "W0905"),
    ("MoveJ", "PDispSet d10;\nMoveJ", 1, "E0901"),
    ("MoveJ", "PickPart tGun;\nMoveJ", 3, "W0921"),
    ("MoveJ", "p10.trans.x:=900;\nMoveJ", 1, "E0903"),
    ("[0.0,0.991444861", "[2.5,0.991444861", 1, "E0903"),
    ("MoveJ", "tGun.tframe.trans.z:=100;\nMoveJ", 0, ""),
    ("MoveJ", "tGun.tframe.trans.z:=Wanted();\nMoveJ", 1, "E0901"),
    ("MoveJ", "wFix:=wOther;\nMoveJ", 1, "E0901"),
    ("[FALSE,TRUE,\"\"", "[FALSE,FALSE,\"STN1\"", 1, "E0901"),
    ("MoveJ", "SearchL di1,p10,v100,tGun;\nMoveJ", 0, ""),
    ("MODULE Weld", "\u{feff}MODULE Weld", 0, ""),
];
const URSCRIPT: &str = "def prog():\n  set_tcp(p[0.03,0.02,0.15,0,0,0])\n  movej([0,-1.57,1.57,-1.57,-1.57,0])\n  movel(p[0.7,0.1,0.3,0,3.14159,0], a=1.2, v=0.25)\nend\n";
const OF_URSCRIPT: &[(&str, &str, i32, &str)] = &[
    ("end\n", "  movep(p[0.7,0.1,0.3,0,3.14159,0], a=1.2, v=0.25)\nend\n", 3, "W0905"),
    ("end\n", "  servoj([0,-1.57,1.57,-1.57,-1.57,0])\nend\n", 3, "W0905"),
    ("  movel", "  track_conveyor_linear(p[1,0,0,0,0,0],500)\n  movel", 3, "W0905"),
    (
        "  movel",
        "  if get_standard_digital_in(1):\n    set_tcp(get_tcp_offset())\n  end\n  movel",
        3,
        "W0905",
    ),
    ("p[0.03,0.02,0.15,0,0,0]", "p[0.03,0.02,0.25,0,0,0]", 1, "E0902"),
    ("  movej([0,-1.57,1.57,-1.57,-1.57,0])\n", "", 1, "E0923"),
    ("  movel", "  set_gravity([0,0,9.82])\n  movel", 0, ""),
];

fn corrected(
    at: &Path,
    robot: &str,
    file: &str,
    program: &str,
    cases: &[(&str, &str, i32, &str)],
    more: &[&str],
) {
    let built_in = Robot::by_name_with_tool(robot, [0.0; 3]).unwrap().unwrap();
    let nominal = Robot { controller_model: ControllerModel::Nominal, ..built_in };
    let robot =
        Robot { nominal: Some(Box::new(nominal.clone())), ..truth::draw_true_robot(&nominal, 1, 0.3) };
    fs::write(at.join("id.toml"), robot.to_toml().unwrap()).unwrap();
    let args = [&["compensate", "--replace", file, "--robot", "id.toml", "--out", "new"][..], more].concat();
    for (from, to, exit, code) in [("", "", 0, "")].iter().chain(cases) {
        fs::write(at.join(file), program.replacen(from, to, 1)).unwrap();
        let output = dbbd(at, &args);
        if code.is_empty() {
            assert_eq!(output.status.code(), Some(*exit), "{to}: {}", stderr(&output));
        } else {
            says(&output, *exit, code);
        }
    }
}

#[test]
fn programs_that_cannot_be_corrected() {
    let dir = tempdir().unwrap();
    corrected(dir.path(), "irb1600-10-145", "Weld.mod", RAPID, OF_RAPID, &[]);
    let tool = ["--tool", "30,20,150,0,0,0"];
    corrected(dir.path(), "ur10", "prog.script", URSCRIPT, OF_URSCRIPT, &tool);
}

#[test]
fn urdfs_and_joints() {
    let (dir, data) = cell();
    let at = dir.path();
    done(&identify(at, &data.to_csv(), &PRIOR));
    let export = |urdf: &str, joints: &[&str]| {
        fs::write(at.join("user.urdf"), urdf).unwrap();
        let given = [
            "export",
            "--replace",
            "out/robot-identified.toml",
            "--urdf-in",
            "user.urdf",
            "--out",
            "patched",
        ];
        dbbd(at, &[&given[..], joints].concat())
    };
    done(&dbbd(at, &["export", "out", "--for", "urdf", "--out", "back"]));
    let urdf = fs::read_to_string(at.join("back/robot-identified.urdf")).unwrap();
    done(&export(&urdf, &[]));
    says(&export(&urdf, &["--joints", "joint_a1,joint_a2,joint_a3,joint_a4,joint_a5"]), 1, "E1720");
    let sdf = urdf.replace("<robot ", "<sdf ").replace("</robot>", "</sdf>");
    says(&export(&sdf, &[]), 1, "E1720");
}

/// An arm of other lengths is no change of the robot: the check decides nothing, and updates nothing. A
/// zero that was lost by a degree is a change.
#[test]
fn a_check_of_another_robot_decides_nothing() {
    let (dir, data) = cell();
    let at = dir.path();
    done(&identify(at, &data.to_csv(), &PRIOR));
    let check = |errors: &[(&str, f64)]| {
        let truth = with_errors(ERRORS.iter().chain(errors).copied());
        let lengths = measure(&truth, &three_planes(1, [1300.0, 0.0, 800.0]), 8, 20.0);
        fs::write(at.join("again.csv"), lengths.to_csv()).unwrap();
        let given = ["check", "again.csv", "--robot", "out", "--centres", "C.csv", "--out", "check"];
        dbbd(at, &[&given[..], &["--tolerance", "1", "--update", "--replace"]].concat())
    };
    let decision = || {
        let text = fs::read_to_string(at.join("check/check.json")).unwrap();
        let json: serde_json::Value = serde_json::from_str(&text).unwrap();
        json["decision"].as_str().unwrap().to_owned()
    };
    for errors in
        [[("a1", 60.0), ("a2", 120.0), ("d4", -80.0)], [("a1", -90.0), ("a2", -250.0), ("d4", 150.0)]]
    {
        says(&check(&errors), 3, "W1926");
        assert_eq!(decision(), "undecided");
        assert!(!at.join("check/robot-identified.toml").exists());
    }
    let lost = check(&[("theta2", 1f64.to_radians())]);
    assert_eq!(lost.status.code(), Some(4), "{}", stderr(&lost));
    assert!(!codes(&lost).contains(&"W1926".to_owned()) && decision() == "fail");
}

/// Every command takes the directory of a result for its robot, and a built-in name; where an identified robot is needed, a
/// built-in one is refused as such.
#[test]
fn a_robot_is_named_alike_in_every_command() {
    let (dir, data) = cell();
    let at = dir.path();
    done(&identify(at, &data.to_csv(), &PRIOR));
    fs::write(at.join("axes.csv"), "a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg\n0,-60,90,0,60,0\n").unwrap();
    fs::write(
        at.join("P.src"),
        "DEF P( )\nBAS(#INITMOV,0)\n$TOOL={X 30,Y 20,Z 10,A 0,B 0,C 0}\n$BASE=$NULLFRAME\n\
         PTP {X 1300,Y 0,Z 800,A 0,B 90,C 180,S 2,T 2}\nEND\n",
    )
    .unwrap();
    let ended = |args: &str| {
        let output = dbbd(at, &args.split_whitespace().collect::<Vec<_>>());
        (output.status.code(), codes(&output))
    };
    for robot in ["out", "out/robot-identified.toml"] {
        for args in [
            format!("robots show {robot}"),
            format!("robots check {robot}"),
            format!("predict axes.csv --robot {robot} --out P.csv"),
            format!("export {robot} --for urdf --out urdf --replace"),
            format!("plan job.toml --robot {robot} --out plan --replace"),
            format!("identify obs.csv --robot {robot} --centres C.csv --folds 0 --out again --replace"),
            format!("check obs.csv --robot {robot} --centres C.csv --out check --replace"),
            format!("compensate P.src --robot {robot} --out corrected --replace"),
        ] {
            let (exit, found) = ended(&args);
            assert!(
                !found.iter().any(|code| ["E0101", "E0503"].contains(&code.as_str())),
                "{args}: {found:?}"
            );
            assert_ne!(exit, Some(2), "{args}");
        }
    }
    for (args, code) in [
        ("check obs.csv --robot kr60ha --centres C.csv --out check", "E1910"),
        ("compensate P.src --robot kr60ha --out corrected", "E0909"),
    ] {
        assert_eq!(ended(args), (Some(1), vec![code.to_owned()]), "{args}");
    }
}
