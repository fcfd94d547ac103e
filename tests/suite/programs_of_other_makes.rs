//! KRL is emitted only for robots that read it, only KRL files are corrected as KRL, and dwells are marked as the bar can read it.

use std::fs;
use std::path::Path;

use dbbd_job::sim::truth;
use dbbd_model::robot::Robot;
use serde_json::{Value, json};
use tempfile::{TempDir, tempdir};

use crate::cell::named;
use crate::cell::{codes, dbbd, kr60, stderr};

/// One short circle.
const JOB: &str = "robot = 'kr60ha'\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = 300.0\nstroke_mm = [-5.0, 5.0]\nmargin_mm = 0.5\n\
                   [[centre]]\nid = 1\nxyz_mm = [1300.0, 0.0, 800.0]\n[[circle]]\nplane = 'XY'\npoints = 8\ntilt_deg = 30.0\n";

/// A directory with the plan of a job.
pub(crate) fn plan_in_a_directory(job: &str) -> TempDir {
    let dir = tempdir().unwrap();
    fs::write(dir.path().join("job.toml"), job).unwrap();
    let output = dbbd(dir.path(), &["plan", "job.toml", "--out", ".", "--quiet"]);
    assert!(output.status.success(), "{}", stderr(&output));
    dir
}

/// Changes the header of the plan in a directory.
pub(crate) fn edit(dir: &Path, change: impl FnOnce(&mut Value)) {
    let path = dir.join("plan.json");
    let mut header: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    change(&mut header);
    // The format of an older version: only the hash of plan.csv.
    header.as_object_mut().unwrap().remove("text_hash");
    let csv = fs::read(dir.join("plan.csv")).unwrap();
    header["hash"] = format!("{:016x}", crc::Crc::<u64>::new(&crc::CRC_64_XZ).checksum(&csv)).into();
    fs::write(path, header.to_string()).unwrap();
}

/// The exit code of `krl` and the codes of its findings.
fn krl(dir: &Path, options: &[&str]) -> (Option<i32>, Vec<String>) {
    let output = dbbd(dir, &[&["krl", "--replace", "plan.csv", "--out", "krl"], options].concat());
    (output.status.code(), codes(&output))
}

#[test]
fn krl_is_refused_for_other_makes() {
    let dir = plan_in_a_directory(JOB);
    let at = dir.path();
    for name in ["irb120", "ur5", "tx2-90l"] {
        let robot = named(name);
        edit(at, |header| header["robot"] = json!(robot.to_toml().unwrap()));
        assert_eq!(krl(at, &[]), (Some(1), vec!["E0824".into()]), "{name}");
        assert!(!at.join("krl").exists());
    }
    // Makers whose language is not supported are refused in every language.
    for name in ["tx2-60", "tx2-90", "tx2-90l", "gp12", "gp25"] {
        let robot = named(name);
        edit(at, |header| header["robot"] = json!(robot.to_toml().unwrap()));
        for language in [
            &[][..],
            &["--language", "krl"],
            &["--language", "rapid"],
            &["--language", "urscript"],
            &["--language", "fanuc"],
        ] {
            let output =
                dbbd(at, &[&["program", "--replace", "plan.csv", "--out", "program"], language].concat());
            assert_eq!((output.status.code(), codes(&output)), (Some(1), vec!["E0824".into()]), "{name}");
        }
    }
    // The simulated controller moves robots of any make.
    assert_eq!(krl(at, &["--controller", "simulated"]), (Some(0), vec![]));
    // An unknown maker is reported; the robot file can name the language.
    let unknown = Robot { name: "cell 7".into(), ..kr60() };
    edit(at, |header| header["robot"] = json!(unknown.to_toml().unwrap()));
    assert_eq!(krl(at, &[]), (Some(0), vec!["I0827".into()]));
    let language = |word: &str| Robot { language: Some(word.into()), ..unknown.clone() }.to_toml().unwrap();
    edit(at, |header| header["robot"] = json!(language("krl")));
    assert_eq!(krl(at, &[]), (Some(0), vec![]));
    edit(at, |header| header["robot"] = json!(language("rapid")));
    assert_eq!(krl(at, &[]), (Some(1), vec!["E0824".into()]));
}

#[test]
fn dwell_markers_match_the_abilities_of_the_bar() {
    let dir = plan_in_a_directory(JOB);
    let at = dir.path();
    let data = || fs::read_to_string(at.join("krl/DBB_C001.dat")).unwrap();
    assert_eq!(krl(at, &[]), (Some(0), vec![]));
    assert!(data().contains("SIGNAL DBBSTB"));
    edit(at, |header| header["job"]["bar"]["protocol"] = json!("mitutoyo-idh"));
    assert_eq!(krl(at, &["--sync", "output"]), (Some(1), vec!["E0823".into()]));
    assert_eq!(krl(at, &[]), (Some(0), vec!["I0826".into()]));
    assert!(!data().contains("SIGNAL DBBSTB"));
    assert_eq!(krl(at, &["--sync", "ekrl", "--server", "10.0.0.1:9000"]), (Some(0), vec![]));
    // A definition that is not built in: the user is responsible.
    edit(at, |header| header["job"]["bar"]["protocol"] = json!("elsewhere.toml"));
    assert_eq!(krl(at, &[]), (Some(1), vec!["E0823".into()]));
    assert_eq!(krl(at, &["--sync", "output"]), (Some(0), vec![]));
}

#[test]
fn continuous_circles_need_a_signal() {
    let more = "mode = 'continuous'\norientation = 'fixed'\ndirection = 'both'\narc_deg = 120.0\novershoot_deg = 15.0\n";
    let dir = plan_in_a_directory(&JOB.replace("points = 8\n", &format!("points = 12\n{more}")));
    let at = dir.path();
    assert_eq!(krl(at, &["--sync", "marker"]), (Some(3), vec!["W0825".into()]));
    edit(at, |header| header["job"]["bar"]["protocol"] = json!("mitutoyo-idh"));
    assert_eq!(krl(at, &[]), (Some(1), vec!["E0823".into()]));
}

/// The beginning of a file that is not KRL, with the line of the finding.
const OTHERS: [(&str, usize); 5] = [
    (
        "%%%\n  VERSION:1\n%%%\nMODULE M\n  PROC main()\n    MoveL p10,v100,fine,tool0;\n  ENDPROC\nENDMODULE\n",
        1,
    ),
    ("\nMODULE M\nENDMODULE\n", 2),
    ("x_mm,y_mm,z_mm\n1,2,3\n", 1),
    ("def p():\n  movej([0,0,0,0,0,0])\nend\n", 1),
    ("", 1),
];

#[test]
fn only_krl_is_corrected() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    let identified = |robot: Robot| Robot {
        nominal: Some(Box::new(robot.clone())),
        ..truth::draw_true_robot(&robot, 1, 1.0)
    };
    fs::write(at.join("id.toml"), identified(kr60()).to_toml().unwrap()).unwrap();
    let compensate = |text: &str, robot: &str| {
        fs::write(at.join("P.src"), text).unwrap();
        dbbd(at, &["compensate", "--replace", "P.src", "--robot", robot, "--out", "out", "--json"])
    };
    for (text, line) in OTHERS {
        let output = compensate(text, "id.toml");
        assert_eq!((output.status.code(), codes(&output)), (Some(1), vec!["E0913".into()]), "{text}");
        let error: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(error["error"]["line"], line, "{text}: {error}");
    }
    assert!(!at.join("out").exists());
    let nothing = compensate("DEF P ( )\nHALT\nEND\n", "id.toml");
    assert_eq!((nothing.status.code(), codes(&nothing)), (Some(3), vec!["W0914".into()]));
    fs::write(at.join("abb.toml"), identified(named("irb120")).to_toml().unwrap()).unwrap();
    let abb = compensate("DEF P ( )\nHALT\nEND\n", "abb.toml");
    assert_eq!((abb.status.code(), codes(&abb)), (Some(1), vec!["E0824".into()]));
}

/// Statements with the lines that are reported; the first statement is in line 4.
const STATEMENTS: &[(&str, &[usize])] = &[
    ("LIN XP1\nMYMOVE(XP3)\n", &[5]),
    ("LIN XP1\nMYMOVE (XP1, XP3 ,10)\nIF OK THEN\nmymove(xp3)\nENDIF\n", &[5, 7]),
    ("LIN XP1\nXHELP=XP3\n", &[5]),
    ("LIN XP1\nTRIGGER WHEN DISTANCE=0 DELAY=0 DO SUB(XP3) PRIO=-1\n", &[5]),
    // The point is corrected for another motion, or it is not a point.
    ("LIN XP1\nLIN XP3\nMYMOVE(XP1)\nMYMOVE(XP3)\n", &[]),
    ("LIN XP1\nSHOW(N, \"XP3\") ; XP3\n", &[]),
];

#[test]
fn points_in_other_statements_are_reported() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    let robot = Robot { nominal: Some(Box::new(kr60())), ..truth::draw_true_robot(&kr60(), 1, 1.0) };
    fs::write(at.join("id.toml"), robot.to_toml().unwrap()).unwrap();
    let point = "{X 1363.778,Y -282.219,Z 1360.625,A 152.596,B 29.472,C -174.261,S 2,T 34}";
    let data = format!("DEFDAT P\nDECL E6POS XP1={point}\nDECL E6POS XP3={point}\nDECL INT N=1\nENDDAT\n");
    fs::write(at.join("P.dat"), data).unwrap();
    for (statements, lines) in STATEMENTS {
        let source = format!("DEF P ( )\n$TOOL=$NULLFRAME\n$BASE=$NULLFRAME\n{statements}END\n");
        fs::write(at.join("P.src"), source).unwrap();
        let output =
            dbbd(at, &["compensate", "--replace", "P.src", "--robot", "id.toml", "--out", "out", "--json"]);
        let found: Value = serde_json::from_slice(&output.stdout).unwrap();
        let named: Vec<(String, u64)> = found["findings"]
            .as_array()
            .into_iter()
            .flatten()
            .map(|finding| (finding["code"].as_str().unwrap().into(), finding["line"].as_u64().unwrap()))
            .collect();
        let wanted: Vec<(String, u64)> = lines.iter().map(|line| ("W0905".into(), *line as u64)).collect();
        assert_eq!(output.status.code(), Some(if lines.is_empty() { 0 } else { 3 }), "{statements}");
        assert!(wanted.iter().all(|one| named.contains(one)), "{statements}: {named:?}");
        assert_eq!(found["left"], lines.len(), "{statements}: {named:?}");
    }
}
