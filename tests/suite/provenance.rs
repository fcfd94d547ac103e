//! Every artefact records its sources. Inputs that do not belong together are refused or reported with a warning.

use std::fs;
use std::path::Path;
use std::process::Output;

use dbbd_job::artefact::VERSION;
use dbbd_job::program::{self, Language};
use dbbd_job::recording::capture::{self, CaptureRecord, CaptureWriter};
use dbbd_job::sim::truth;
use dbbd_model::base::hash::sha256;
use dbbd_model::provenance::{Artefact, ArtefactRole, Identity, Provenance};
use dbbd_model::robot::Robot;
use serde_json::Value;
use tempfile::{TempDir, tempdir};

use crate::cell::{
    CENTRE, DESIGNED, centres_csv, codes, dbbd, horizontal, kr60, measure, stderr, with_errors,
};

/// One short circle.
const JOB: &str = "robot = 'robot.toml'\n[bar]\nlength_mm = 300.0\nstroke_mm = [-5.0, 5.0]\nmargin_mm = 0.5\nserial = 'B-1'\n\
                   [[centre]]\nid = 1\nxyz_mm = [1300.0, 0.0, 800.0]\n[[circle]]\nplane = 'XY'\npoints = 8\ntilt_deg = 30.0\namplitude_deg = 25.0\n";

/// Runs a step that must succeed.
fn step(dir: &Path, args: &[&str]) -> Output {
    let output = dbbd(dir, args);
    assert!(matches!(output.status.code(), Some(0 | 3)), "dbbd {}: {}", args.join(" "), stderr(&output));
    output
}

/// The exit code of a run, and whether it printed the code.
fn said(output: &Output, code: &str) -> (Option<i32>, bool) {
    (output.status.code(), codes(output).iter().any(|said| said == code))
}

/// A plan, its program, lengths of a robot with errors, and an identified robot with its lengths.
fn cell() -> TempDir {
    let dir = tempdir().unwrap();
    let at = dir.path();
    let robot = Robot { serial: Some("KR-1".into()), ..kr60() };
    fs::write(at.join("robot.toml"), robot.to_toml().unwrap()).unwrap();
    fs::write(at.join("job.toml"), JOB).unwrap();
    step(at, &["plan", "job.toml", "--out", "plan"]);
    step(at, &["krl", "plan/plan.csv", "--out", "krl"]);
    let circle = [horizontal(1, CENTRE)];
    let lengths = measure(&with_errors(DESIGNED), &circle, 24, 20.0).to_csv();
    fs::write(at.join("obs.csv"), &lengths).unwrap();
    fs::write(at.join("C.csv"), centres_csv(&circle)).unwrap();
    fs::create_dir(at.join("result")).unwrap();
    fs::write(at.join("result/lengths.csv"), lengths + "\n").unwrap();
    write_identified(at, robot);
    dir
}

/// The identified robot, from robot.toml and the lengths beside it.
fn write_identified(at: &Path, nominal: Robot) {
    let source = |role, file: &str| dbbd_job::artefact::of_file(role, &at.join(file)).unwrap();
    let robot = Artefact { name: nominal.name.clone(), ..source(ArtefactRole::Robot, "robot.toml") };
    let from = vec![robot, source(ArtefactRole::Measurements, "result/lengths.csv")];
    let provenance = Provenance { dbbd: VERSION.into(), from, ..Provenance::default() };
    let identified = Robot {
        provenance,
        nominal: Some(Box::new(nominal.clone())),
        ..truth::draw_true_robot(&nominal, 1, 0.3)
    };
    fs::write(at.join("result/robot-identified.toml"), identified.to_toml().unwrap()).unwrap();
}

/// Few parameters, so that the test is short.
fn identify<'a>(robot: &'a str, out: &'a str) -> Vec<&'a str> {
    let args = ["identify", "obs.csv", "--robot", robot, "--centres", "C.csv", "--estimate", "a1-3,bar"];
    [&args[..], &["--folds", "0", "--out", out]].concat()
}

fn compensate<'a>(program: &'a str, robot: &'a str, out: &'a str) -> [&'a str; 7] {
    ["compensate", "--replace", program, "--robot", robot, "--out", out]
}

/// The output of `dbbd info` for a file.
fn info(dir: &Path, file: &str) -> Value {
    serde_json::from_slice(&step(dir, &["info", file, "--json"]).stdout).unwrap()
}

fn hash_of(dir: &Path, file: &str) -> String {
    sha256(fs::read(dir.join(file)).unwrap())
}

#[test]
fn chain_leads_from_corrected_program_to_job() {
    let dir = cell();
    let at = dir.path();
    step(at, &identify("robot.toml", "result"));
    let far = ["--limit", "50"];
    let correct = compensate("krl/DBB_C001.src", "result/robot-identified.toml", "corrected");
    step(at, &[&correct[..], &far].concat());
    step(at, &["export", "result", "--for", "kuka", "--out", "back"]);
    let roles = |file: &str| -> Vec<(String, String)> {
        let found = info(at, file);
        let text = |source: &Value, key: &str| source[key].as_str().unwrap().to_owned();
        assert_eq!(found["provenance"]["dbbd"], VERSION, "{file}");
        let sources = found["provenance"]["from"].as_array().unwrap();
        sources.iter().map(|source| (text(source, "role"), text(source, "sha256"))).collect()
    };
    let is = |role: &str, file: &str| (role.to_owned(), hash_of(at, file));
    let (job, robot, plan) = (is("job", "job.toml"), is("robot", "robot.toml"), is("plan", "plan/plan.csv"));
    assert_eq!(roles("plan/plan.json"), [job.clone(), robot.clone()]);
    assert_eq!(roles("plan/plan.csv"), [job.clone(), robot.clone()]);
    for file in ["krl/DBB_MAIN.src", "krl/DBB_C001.src", "krl/DBB_C001.dat"] {
        assert_eq!(roles(file), [job.clone(), robot.clone(), plan.clone()]);
    }
    let lengths = is("measurements", "result/lengths.csv");
    let result = [robot.clone(), is("base_balls", "C.csv"), is("measurements", "obs.csv"), lengths];
    for file in ["result/result.json", "result/robot-identified.toml", "back/DBB_RESULT.dat"] {
        assert_eq!(roles(file)[..3], result[..3], "{file}");
    }
    let identified = is("identified_robot", "result/robot-identified.toml");
    for file in ["corrected/DBB_C001.src", "corrected/DBB_C001.dat"] {
        let chain = roles(file);
        assert_eq!(chain[..3], [job.clone(), robot.clone(), plan.clone()]);
        assert!(chain.contains(&is("program", "krl/DBB_C001.src")), "{chain:?}");
        assert_eq!(chain.last(), Some(&identified));
    }
    // An artefact without sources has only itself.
    assert_eq!(info(at, "job.toml")["serial"], "B-1");
    assert_eq!(info(at, "robot.toml")["serial"], "KR-1");
    assert_eq!(info(at, "result/robot-identified.toml")["serial"], "KR-1");
    // The same inputs give the same bytes; the pages show the chain.
    let plan = fs::read(at.join("plan/plan.json")).unwrap();
    step(at, &["plan", "job.toml", "--out", "again"]);
    assert_eq!(fs::read(at.join("again/plan.json")).unwrap(), plan);
    for (page, hash) in [("plan/plan.html", robot.1), ("result/report.html", hash_of(at, "obs.csv"))] {
        assert!(fs::read_to_string(at.join(page)).unwrap().contains(&hash[..12]), "{page}");
    }
}

#[test]
fn program_is_not_corrected_twice() {
    let dir = cell();
    let at = dir.path();
    let identified = "result/robot-identified.toml";
    let once = dbbd(at, &compensate("krl/DBB_C001.src", identified, "corrected"));
    assert_eq!(once.status.code(), Some(0), "{}", stderr(&once));
    let twice = dbbd(at, &compensate("corrected/DBB_C001.src", identified, "twice"));
    assert_eq!(said(&twice, "E1801"), (Some(1), true), "{}", stderr(&twice));
    // Only the points changed.
    fs::create_dir(at.join("mixed")).unwrap();
    fs::copy(at.join("krl/DBB_C001.src"), at.join("mixed/DBB_C001.src")).unwrap();
    fs::copy(at.join("corrected/DBB_C001.dat"), at.join("mixed/DBB_C001.dat")).unwrap();
    let mixed = dbbd(at, &compensate("mixed/DBB_C001.src", identified, "twice"));
    assert_eq!(said(&mixed, "E1801"), (Some(1), true), "{}", stderr(&mixed));
    // A plan for the identified robot, and a plan with its lengths, command the corrected poses.
    for (out, option, file) in [("p1", "--robot", identified), ("p2", "--measured", "obs.csv")] {
        step(at, &["plan", "job.toml", option, file, "--out", out]);
        step(at, &["krl", &format!("{out}/plan.csv"), "--out", &format!("{out}/krl")]);
        let planned = dbbd(at, &compensate(&format!("{out}/krl/DBB_C001.src"), identified, "twice"));
        assert_eq!(said(&planned, "E1801"), (Some(1), true), "{}", stderr(&planned));
    }
    assert!(!at.join("twice").exists());
    // A program of another origin is known as corrected too.
    fs::write(
        at.join("P.src"),
        "DEF P ( )\r\n$TOOL=$NULLFRAME\r\n$BASE=$NULLFRAME\r\nPTP {A1 5.0,A2 -80.0,A3 100.0,A4 3.0,A5 60.0,A6 4.0}\r\nEND\r\n",
    )
    .unwrap();
    step(at, &compensate("P.src", identified, "own"));
    let twice = dbbd(at, &compensate("own/P.src", identified, "twice"));
    assert_eq!(said(&twice, "E1801"), (Some(1), true), "{}", stderr(&twice));
}

#[test]
fn files_of_another_robot_are_refused() {
    let dir = cell();
    let at = dir.path();
    let read = |name: &str| {
        Robot::from_toml(name, &fs::read_to_string(at.join("result/robot-identified.toml")).unwrap()).unwrap()
    };
    let robot = read("identified");
    let write = |name: &str, robot: &Robot| fs::write(at.join(name), robot.to_toml().unwrap()).unwrap();
    write("other.toml", &Robot { serial: Some("KR-2".into()), ..robot.clone() });
    let other = dbbd(at, &compensate("krl/DBB_C001.src", "other.toml", "out"));
    assert_eq!(said(&other, "E1802"), (Some(1), true), "{}", stderr(&other));
    write("named.toml", &Robot { serial: None, name: "KUKA KR 16-2".into(), ..robot.clone() });
    let named = dbbd(at, &compensate("krl/DBB_C001.src", "named.toml", "out"));
    assert_eq!(said(&named, "E1802"), (Some(1), true), "{}", stderr(&named));
    // The job is for one robot, the file is of another.
    fs::write(at.join("serial.toml"), format!("serial = 'KR-9'\n{JOB}")).unwrap();
    let job = dbbd(at, &["plan", "serial.toml", "--out", "out"]);
    assert_eq!(said(&job, "E1802"), (Some(1), true), "{}", stderr(&job));
    // The nominal file was edited between plan and identification.
    let robot = Robot::from_toml("robot", &fs::read_to_string(at.join("robot.toml")).unwrap()).unwrap();
    let edited = Robot { repeatability_mm: Some(0.06), ..robot };
    write("robot.toml", &edited);
    write_identified(at, edited);
    let edited = dbbd(at, &compensate("krl/DBB_C001.src", "result/robot-identified.toml", "out"));
    assert_eq!(said(&edited, "W1803"), (Some(3), true), "{}", stderr(&edited));
}

#[test]
fn lengths_are_used_once_with_their_result() {
    let dir = cell();
    let at = dir.path();
    step(at, &identify("robot.toml", "first"));
    let again = dbbd(at, &identify("first/robot-identified.toml", "again"));
    assert_eq!(said(&again, "W1805"), (Some(3), true), "{}", stderr(&again));
    let mut validated = identify("robot.toml", "validated");
    validated.extend(["--validate", "obs.csv"]);
    assert_eq!(said(&dbbd(at, &validated), "W1805"), (Some(3), true));
    let twice =
        dbbd(at, &["plan", "job.toml", "--measured", "obs.csv", "--measured", "obs.csv", "--out", "twice"]);
    assert_eq!(said(&twice, "W1805"), (Some(3), true), "{}", stderr(&twice));
    step(at, &["plan", "job.toml", "--measured", "obs.csv", "--out", "once"]);
    // Neither a copy nor a part of a table adds lengths, in whatever order they are given.
    let table = fs::read_to_string(at.join("obs.csv")).unwrap();
    fs::write(at.join("copy.csv"), table.replace('\n', "\r\n")).unwrap();
    fs::write(
        at.join("part.csv"),
        table.lines().take(9).fold(String::new(), |text, line| text + line + "\n"),
    )
    .unwrap();
    for tables in [["obs.csv", "copy.csv"], ["obs.csv", "part.csv"], ["part.csv", "obs.csv"]] {
        let [first, second] = tables;
        let twice =
            ["plan", "job.toml", "--measured", first, "--measured", second, "--out", "twice", "--replace"];
        let twice = dbbd(at, &twice);
        assert_eq!(said(&twice, "W1805"), (Some(3), true), "{tables:?}: {}", stderr(&twice));
        let [once, twice] = ["once", "twice"].map(|out| fs::read(at.join(out).join("plan.json")).unwrap());
        assert_eq!(once, twice, "{tables:?}");
    }
    // The lengths of another result beside the robot.
    let lengths = fs::read_to_string(at.join("result/lengths.csv")).unwrap();
    let fewer: Vec<&str> = lengths.lines().take(20).collect();
    fs::write(at.join("result/lengths.csv"), fewer.join("\n")).unwrap();
    let other = dbbd(at, &["plan", "job.toml", "--robot", "result/robot-identified.toml", "--out", "other"]);
    assert_eq!(said(&other, "E1806"), (Some(1), true), "{}", stderr(&other));
}

/// A stored run whose plan has this chain.
fn stored_run(dir: &Path, name: &str, chain: &Provenance) {
    let stored = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/captures/run.dbbd");
    let bytes = fs::read(stored).unwrap();
    let mut writer = CaptureWriter::create(&dir.join(name)).unwrap();
    for stamped in capture::read_capture(&bytes).records {
        let record = match stamped.record {
            CaptureRecord::Attachment { name, content } if name == "plan.json" => {
                let mut plan: Value = serde_json::from_slice(&content).unwrap();
                plan["provenance"] = serde_json::to_value(chain).unwrap();
                CaptureRecord::Attachment { name, content: serde_json::to_vec(&plan).unwrap() }
            }
            other => other,
        };
        writer.write(stamped.host, &record).unwrap();
    }
}

#[test]
fn outdated_and_foreign_runs_are_reported() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    let robot = |serial: &str, from: Vec<Artefact>| Robot {
        serial: Some(serial.into()),
        nominal: Some(Box::new(kr60())),
        provenance: Provenance { dbbd: VERSION.into(), from, ..Provenance::default() },
        ..kr60()
    };
    let first =
        robot("KR-1", vec![Artefact::new(ArtefactRole::Robot, "KUKA KR 60 HA", "")]).to_toml().unwrap();
    let first = Robot::from_toml("first", &first).unwrap().traced(&first);
    stored_run(at, "run.dbbd", &dbbd_job::artefact::made_from([&first]));
    let identify = |robot: &Robot| {
        fs::write(at.join("id.toml"), robot.to_toml().unwrap()).unwrap();
        dbbd(
            at,
            &[
                "identify",
                "run.dbbd",
                "--robot",
                "id.toml",
                "--estimate",
                "a1-3",
                "--folds",
                "0",
                "--out",
                "out",
            ],
        )
    };
    let newer = identify(&robot("KR-1", first.chain().cloned().collect()));
    assert_eq!(said(&newer, "W1804"), (Some(3), true), "{}", stderr(&newer));
    let of_other_lengths = identify(&robot("KR-1", Vec::new()));
    assert_eq!(said(&of_other_lengths, "W1804"), (Some(3), true), "{}", stderr(&of_other_lengths));
    let other = identify(&robot("KR-2", Vec::new()));
    assert_eq!(said(&other, "E1802"), (Some(1), true), "{}", stderr(&other));
    let chain = info(at, "run.dbbd")["provenance"]["from"].clone();
    assert_eq!(
        chain.as_array().unwrap().iter().map(|s| s["role"].as_str().unwrap()).collect::<Vec<_>>(),
        ["robot", "identified_robot", "plan"]
    );
}

#[test]
fn table_of_lengths_has_the_chain_of_its_run() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    let robot = Robot { serial: Some("KR-1".into()), ..kr60() };
    let text = robot.to_toml().unwrap();
    fs::write(at.join("first.toml"), &text).unwrap();
    fs::write(at.join("job.toml"), JOB.replace("robot.toml", "first.toml")).unwrap();
    fs::write(at.join("C.csv"), centres_csv(&[horizontal(1, CENTRE)])).unwrap();
    stored_run(at, "run.dbbd", &dbbd_job::artefact::made_from([&robot.traced(&text)]));
    step(at, &["sync", "run.dbbd", "--out", "obs.csv"]);
    let made = info(at, "obs.csv");
    assert_eq!(made, info(at, "obs.provenance.json"));
    let roles: Vec<&Value> =
        made["provenance"]["from"].as_array().unwrap().iter().map(|from| &from["role"]).collect();
    assert_eq!(roles, ["robot", "plan", "capture"]);
    assert_eq!(made["provenance"]["from"][2]["sha256"], hash_of(at, "run.dbbd"));
    fs::write(at.join("other.toml"), Robot { serial: Some("KR-2".into()), ..robot }.to_toml().unwrap())
        .unwrap();
    let other = dbbd(at, &["identify", "obs.csv", "--robot", "other.toml", "--out", "out"]);
    assert_eq!(said(&other, "E1802"), (Some(1), true), "{}", stderr(&other));
    // The identity of the measurement has the same effect as the robot file.
    for serial in ["KR-1", "KR-2"] {
        let stated = Identity { robot: Some(serial.into()), ..Identity::default() };
        let chain = Provenance { identity: stated, ..dbbd_job::artefact::made_from([&kr60().traced("")]) };
        stored_run(at, &format!("{serial}.dbbd"), &chain);
        step(at, &["sync", &format!("{serial}.dbbd"), "--out", &format!("{serial}.csv")]);
    }
    for args in [
        &["circle", "KR-1.dbbd", "KR-2.dbbd", "--out", "q"][..],
        &["identify", "KR-2.csv", "--robot", "first.toml", "--centres", "C.csv", "--out", "out"],
        &["plan", "job.toml", "--measured", "KR-2.csv", "--out", "plan"],
        &["predict", "obs.csv", "--robot", "other.toml", "--out", "p.csv"],
    ] {
        let other = dbbd(at, args);
        assert_eq!(said(&other, "E1802"), (Some(1), true), "{args:?} {}", stderr(&other));
    }
    let table = fs::read_to_string(at.join("obs.csv")).unwrap();
    let (shorter, _) = table.trim_end().rsplit_once('\n').unwrap();
    fs::write(at.join("obs.csv"), shorter).unwrap();
    assert_eq!(said(&dbbd(at, &["info", "obs.csv"]), "W1809"), (Some(3), true));
    let record = fs::read_to_string(at.join("obs.provenance.json")).unwrap();
    fs::write(at.join("obs.provenance.json"), &record[..record.len() / 2]).unwrap();
    assert_eq!(said(&dbbd(at, &["info", "obs.csv"]), "E1807"), (Some(1), true));
}

#[test]
fn program_header_escapes_names() {
    let chain =
        dbbd_job::artefact::made_from([&Artefact::new(ArtefactRole::Robot, "Käfer \"7\"; €\n𝄞", "x").into()]);
    let program = program::stamped(Language::Krl, "&ACCESS RVP\r\nDEF P ( )\r\nEND\r\n", &chain).unwrap();
    assert!(program.is_ascii() && program.starts_with("&ACCESS RVP\r\nDEF P ( )\r\n; made by"), "{program}");
    assert_eq!(program::provenance("p.src", &program).unwrap(), chain);
    assert_eq!(program::stamped(Language::Krl, &program, &chain).unwrap(), program);
}

/// A record that is damaged could hide a second correction.
#[test]
fn damaged_record_is_refused() {
    let dir = cell();
    let at = dir.path();
    let program = at.join("krl/DBB_C001.src");
    let text = fs::read_to_string(&program).unwrap();
    fs::write(&program, text.replacen("; made from {", "; made from ", 1)).unwrap();
    let robot = "result/robot-identified.toml";
    let corrected = dbbd(at, &["compensate", "krl/DBB_C001.src", "--robot", robot, "--out", "corrected"]);
    assert_eq!(said(&corrected, "E1807"), (Some(1), true));
    assert_eq!(said(&dbbd(at, &["info", "krl/DBB_C001.src"]), "E1807"), (Some(1), true));
    fs::write(at.join("result.json"), "{\"parameters\": [], \"provenance\": 5}").unwrap();
    assert_eq!(said(&dbbd(at, &["info", "result.json"]), "E1807"), (Some(1), true));
}
