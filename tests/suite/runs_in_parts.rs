//! A run that was stopped is completed by another one, poses are measured again, and nothing is overwritten.

use std::fs;
use std::path::Path;

use dbbd_job::plan::PoseKind;
use dbbd_job::recording::run::read_plan;
use dbbd_model::estimation::CalibrationResult;
use dbbd_model::measurement::Measurements;

use crate::cell::{codes, dbbd, stderr};

const JOB: &str = "robot = \"kr60ha\"\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = 300.0\nstroke_mm = [-5.0, 5.0]\nmargin_mm = 0.5\n\
    length_u_mm = 0.002\n[[centre]]\nid = 1\nxyz_mm = [1300.0, 0.0, 800.0]\n\
    [[circle]]\nplane = \"XY\"\npoints = 40\namplitude_deg = 25.0\ntilt_deg = 30.0\n\
    [identity]\nmeasured = \"2026-11-20\"\n";

fn done(at: &Path, args: &[&str]) -> Vec<String> {
    let output = dbbd(at, args);
    assert!(matches!(output.status.code(), Some(0 | 3)), "{args:?}: {}", stderr(&output));
    codes(&output)
}

fn result(at: &Path, out: &str) -> CalibrationResult {
    let file = at.join(out).join("result.json");
    CalibrationResult::from_json(out, &fs::read_to_string(file).unwrap()).unwrap()
}

fn lengths(at: &Path, out: &str) -> Measurements {
    Measurements::from_csv(out, &fs::read_to_string(at.join(out).join("lengths.csv")).unwrap()).unwrap()
}

/// The first part of a capture, as a computer leaves it whose power failed.
fn cut(at: &Path, whole: &str, part: &str, share: f64) {
    let bytes = fs::read(at.join(whole)).unwrap();
    fs::write(at.join(part), &bytes[..(share * bytes.len() as f64) as usize]).unwrap();
}

#[test]
fn a_stopped_run_is_completed() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    fs::write(at.join("job.toml"), JOB).unwrap();
    done(at, &["plan", "job.toml", "--out", "plan"]);
    done(at, &["acquire", "--port", "sim", "--seed", "3", "--plan", "plan/plan.csv", "--out", "whole.dbbd"]);
    cut(at, "whole.dbbd", "first.dbbd", 0.5);
    done(at, &["plan", "job.toml", "--remaining", "first.dbbd", "--out", "rest"]);
    done(at, &["acquire", "--port", "sim", "--seed", "4", "--plan", "rest/plan.csv", "--out", "second.dbbd"]);
    done(at, &["identify", "whole.dbbd", "--out", "o"]);
    let joined = ["identify", "first.dbbd", "second.dbbd", "--same-setup", "--out", "parts"];
    let said = done(at, &joined);
    assert!(said.contains(&"I1342".to_owned()));
    // The second run makes the first one whole; alone it lacks half of its poses.
    let of_a_cut_run = ["W1003", "W1004", "W1085"];
    assert!(!said.iter().any(|code| of_a_cut_run.contains(&code.as_str())), "{said:?}");
    assert!(done(at, &["identify", "first.dbbd", "--out", "half"]).contains(&"W1003".to_owned()));
    // Each pose has one length.
    let (whole, parts) = (lengths(at, "o"), lengths(at, "parts"));
    let measured = |table: &Measurements| {
        let is_measured = |row: &&dbbd_model::measurement::Measurement| {
            row.context.as_ref().is_none_or(|context| context.kind != Some(PoseKind::Reference))
        };
        let axes = |row: &dbbd_model::measurement::Measurement| {
            row.axes.degrees().map(|deg| (deg * 1e3).round() as i64)
        };
        let mut poses: Vec<[i64; 6]> = table.rows.iter().filter(is_measured).map(axes).collect();
        poses.sort_unstable();
        poses
    };
    assert_eq!(measured(&whole), measured(&parts));
    assert_eq!(measured(&whole).len(), 40);
    // The parameters agree within their uncertainty, and the certificate of the bar went along.
    let (whole, parts) = (result(at, "o"), result(at, "parts"));
    for (one, other) in whole.parameters.iter().zip(&parts.parameters) {
        assert_eq!(one.name, other.name);
        if let (Some(a), Some(b)) = (one.sd, other.sd) {
            let z = (one.identified - other.identified).abs() / a.hypot(b);
            assert!(z < 4.0, "{}: {} and {}", one.name, one.identified, other.identified);
        }
    }
    let bar = |result: &CalibrationResult| {
        result.parameters.iter().find(|one| one.name.to_string() == "bar_offset").and_then(|one| one.prior_sd)
    };
    assert_eq!((bar(&whole), bar(&parts)), (Some(0.001), Some(0.001)));
    // By the date both are of one set-up; a set-up of its own has balls and a bar of its own.
    done(at, &["identify", "first.dbbd", "second.dbbd", "--new-setup", "--out", "new"]);
    assert!(result(at, "new").parameters.iter().any(|one| one.name.to_string() == "centre2_x"));
    // Nothing remains.
    let output = dbbd(at, &["plan", "job.toml", "--remaining", "whole.dbbd", "--out", "none"]);
    assert_eq!((output.status.code(), codes(&output)), (Some(1), vec!["E0722".to_owned()]));
    // Lengths that are given twice are recognised by themselves: in the same file, in a table of it, in its first part.
    done(at, &["sync", "whole.dbbd", "--out", "whole.csv"]);
    for other in ["whole.dbbd", "whole.csv", "first.dbbd"] {
        let output = dbbd(at, &["identify", "whole.dbbd", other, "--out", "twice"]);
        assert_eq!(output.status.code(), Some(1), "{other}");
        assert_eq!(codes(&output).last().map(String::as_str), Some("E1306"), "{other}");
    }
}

#[test]
fn poses_are_measured_again() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    fs::write(at.join("job.toml"), JOB).unwrap();
    done(at, &["plan", "job.toml", "--out", "plan"]);
    done(at, &["acquire", "--port", "sim", "--plan", "plan/plan.csv", "--out", "run.dbbd"]);
    let plan = read_plan(&at.join("plan/plan.csv")).unwrap();
    let measured: Vec<u32> =
        plan.rows.iter().filter(|row| row.kind == PoseKind::Measure).map(|row| row.index).collect();
    let rows = format!("run.dbbd:{},{}", measured[3], measured[9]);
    done(at, &["plan", "job.toml", "--repeat", &rows, "--out", "again"]);
    done(at, &["acquire", "--port", "sim", "--seed", "9", "--plan", "again/plan.csv", "--out", "again.dbbd"]);
    done(at, &["identify", "run.dbbd", "again.dbbd", "--same-setup", "--out", "o"]);
    // The order of the files makes no difference: the later run replaces.
    done(at, &["identify", "again.dbbd", "run.dbbd", "--same-setup", "--out", "other"]);
    let table = lengths(at, "o");
    let readings = |table: &Measurements| -> Vec<_> {
        table.rows.iter().map(|row| (row.index, row.length_mm)).collect()
    };
    assert_eq!(readings(&table), readings(&lengths(at, "other")));
    let is_first = |index: u32| table.rows.iter().any(|row| row.index == index);
    assert!(!is_first(measured[3]) && !is_first(measured[9]) && is_first(measured[4]));
    let output = dbbd(at, &["plan", "job.toml", "--repeat", "run.dbbd:1", "--out", "none"]);
    assert_eq!((output.status.code(), codes(&output)), (Some(1), vec!["E0722".to_owned()]));
}

/// A length that the fit left out, or the user, is not in the table of the result: its pose is measured again all the same.
#[test]
fn outliers_are_measured_again() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    fs::write(at.join("job.toml"), JOB).unwrap();
    done(at, &["plan", "job.toml", "--out", "plan"]);
    done(at, &["acquire", "--port", "sim", "--plan", "plan/plan.csv", "--out", "run.dbbd"]);
    done(at, &["sync", "run.dbbd", "--out", "run.csv"]);
    let mut table = Measurements::from_csv("t", &fs::read_to_string(at.join("run.csv")).unwrap()).unwrap();
    table.rows[20].length_mm += 2.0;
    let [outlier, excluded] = [20, 30].map(|place| table.rows[place].clone());
    fs::write(at.join("slipped.csv"), table.to_csv()).unwrap();
    let left_out = excluded.index.to_string();
    let of_table = [
        "identify",
        "slipped.csv",
        "--robot",
        "kr60ha",
        "--tool",
        "30,20,10",
        "--centres",
        "plan/centres.csv",
    ];
    done(at, &[&of_table[..], &["--prior", "datasheet", "--exclude", &left_out, "--out", "o"]].concat());
    let found: Vec<u32> = result(at, "o").outliers.iter().map(|outlier| outlier.index).collect();
    assert_eq!(found, [outlier.index]);
    assert!(
        lengths(at, "o").rows.iter().all(|row| row.index != outlier.index && row.index != excluded.index)
    );
    for (rows, again) in [("o:outliers", &outlier), (&*format!("o:{left_out}"), &excluded)] {
        done(at, &["plan", "job.toml", "--repeat", rows, "--out", "again", "--replace"]);
        let plan = read_plan(&at.join("again/plan.csv")).unwrap();
        let poses = plan.rows.iter().filter(|row| row.kind == PoseKind::Measure).map(|row| row.axes_deg);
        let poses: Vec<[f64; 6]> = poses.collect();
        assert_eq!(poses.len(), 1, "{rows}");
        let off = poses[0].iter().zip(again.axes.degrees()).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 1e-3, "{rows}: {off}");
    }
}

/// A part of the same set-up has a second ball, with so few lengths that a fold may have none.
#[test]
fn a_part_of_the_same_set_up_may_have_another_ball() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    fs::write(at.join("job.toml"), JOB).unwrap();
    let second = JOB.replace("points = 40", "points = 6").replace(
        "[identity]",
        "[[centre]]\nid = 2\nxyz_mm = [1100.0, 500.0, 700.0]\n\
         [[circle]]\ncentre = 2\nplane = \"XY\"\npoints = 6\ntilt_deg = 20.0\n[identity]",
    );
    fs::write(at.join("second.toml"), second).unwrap();
    done(at, &["plan", "job.toml", "--out", "plan"]);
    done(at, &["plan", "second.toml", "--out", "further"]);
    done(at, &["acquire", "--port", "sim", "--plan", "plan/plan.csv", "--out", "run.dbbd"]);
    done(at, &["acquire", "--port", "sim", "--plan", "further/plan.csv", "--out", "further.dbbd"]);
    done(at, &["identify", "run.dbbd", "further.dbbd", "--same-setup", "--out", "o"]);
    let balls = |out: &str| {
        let mut balls: Vec<u32> =
            lengths(at, out).rows.iter().filter_map(|row| Some(row.datum.ball()?.number())).collect();
        balls.sort_unstable();
        balls.dedup();
        balls
    };
    assert_eq!(balls("o"), [1, 2]);
    done(at, &["identify", "run.dbbd", "further.dbbd", "--new-setup", "--out", "new"]);
    assert_eq!(balls("new"), [1, 2, 3]);
    // The robot to start from is that of the first run, whatever the order of the files.
    done(at, &["identify", "further.dbbd", "run.dbbd", "--same-setup", "--out", "other"]);
    assert_eq!(result(at, "o").parameters, result(at, "other").parameters);
}

#[test]
fn nothing_is_overwritten() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    fs::write(at.join("job.toml"), JOB).unwrap();
    done(at, &["plan", "job.toml", "--out", "plan"]);
    let first = fs::read(at.join("plan/plan.csv")).unwrap();
    done(at, &["krl", "plan/plan.csv", "--out", "krl"]);
    fs::write(at.join("job.toml"), JOB.replace("tilt_deg = 30.0", "tilt_deg = 31.0")).unwrap();
    // The program would be that of the earlier job.
    assert!(done(at, &["krl", "plan/plan.csv", "--out", "old"]).contains(&"W0885".to_owned()));
    // The same for a robot file beside it.
    assert!(dbbd(at, &["robots", "import", "kr60ha", "--out", "own.toml"]).status.success());
    fs::write(at.join("own-job.toml"), JOB.replace("\"kr60ha\"", "\"own.toml\"")).unwrap();
    done(at, &["plan", "own-job.toml", "--out", "own-plan"]);
    assert!(!done(at, &["krl", "own-plan/plan.csv", "--out", "own-krl"]).contains(&"W0885".to_owned()));
    let own = fs::read_to_string(at.join("own.toml")).unwrap();
    fs::write(at.join("own.toml"), format!("{own}# another tool ball\n")).unwrap();
    assert!(done(at, &["krl", "own-plan/plan.csv", "--out", "own-old"]).contains(&"W0885".to_owned()));
    // The warning of a command that another one starts.
    let output = dbbd(at, &["acquire", "--port", "sim", "--plan", "plan/plan.csv", "--out", "old.dbbd"]);
    let is_named = codes(&output).contains(&"W0885".to_owned());
    assert!(output.status.code() == Some(3) && is_named, "{}", stderr(&output));
    done(at, &["plan", "job.toml", "--out", "plan"]);
    assert_eq!(fs::read(at.join("plan/previous-1/plan.csv")).unwrap(), first);
    assert_ne!(fs::read(at.join("plan/plan.csv")).unwrap(), first);
    let program = fs::read(at.join("krl/DBB_C001.src")).unwrap();
    let output = dbbd(at, &["krl", "plan/plan.csv", "--out", "krl"]);
    assert_eq!((output.status.code(), codes(&output)), (Some(1), vec!["E0182".to_owned()]));
    assert_eq!(fs::read(at.join("krl/DBB_C001.src")).unwrap(), program);
    done(at, &["krl", "plan/plan.csv", "--out", "krl", "--replace"]);
    assert_ne!(fs::read(at.join("krl/DBB_C001.src")).unwrap(), program);
    done(at, &["plan", "job.toml", "--out", "plan", "--replace"]);
    assert!(!at.join("plan/previous-2").exists());
}

/// The program of an earlier plan, and the plan that was made after it.
#[test]
fn a_program_of_another_plan_gives_no_lengths() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    for (job, tilt) in [("old", "30.0"), ("new", "30.5")] {
        fs::write(at.join("job.toml"), JOB.replace("tilt_deg = 30.0", &format!("tilt_deg = {tilt}")))
            .unwrap();
        done(at, &["plan", "job.toml", "--out", job]);
    }
    done(at, &["acquire", "--port", "sim", "--plan", "old/plan.csv", "--out", "run.dbbd"]);
    let output = dbbd(at, &["sync", "run.dbbd", "--plan", "new/plan.csv", "--out", "obs.csv"]);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert!(codes(&output).contains(&"E1084".to_owned()), "{}", stderr(&output));
    assert!(!at.join("obs.csv").exists());
    done(at, &["sync", "run.dbbd", "--plan", "old/plan.csv", "--out", "obs.csv"]);
}

#[test]
fn the_simulated_bar_speaks_the_protocol_of_the_plan() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    fs::write(at.join("job.toml"), JOB.replace("length_u_mm", "protocol = \"dbb-csv-1\"\nlength_u_mm"))
        .unwrap();
    done(at, &["plan", "job.toml", "--out", "plan"]);
    done(at, &["acquire", "--port", "sim", "--gone", "1", "--plan", "plan/plan.csv", "--out", "run.dbbd"]);
    let info = dbbd(at, &["info", "run.dbbd", "--json"]);
    let found: serde_json::Value = serde_json::from_slice(&info.stdout).unwrap();
    assert!(found.to_string().contains("dbb-csv-1"), "{found}");
    done(at, &["sync", "run.dbbd", "--out", "obs.csv"]);
    let table = fs::read_to_string(at.join("obs.csv")).unwrap();
    assert!(table.lines().count() > 40, "{table}");
}

/// The noise of the bar is drawn from the seed. The clock of the host is not, so that the text of a table differs.
#[test]
fn the_seed_decides_what_the_simulated_bar_reads() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    fs::write(at.join("job.toml"), JOB).unwrap();
    done(at, &["plan", "job.toml", "--out", "plan"]);
    let lengths = [("1", "a"), ("1", "b"), ("2", "c")].map(|(seed, out)| {
        let sim = ["acquire", "--port", "sim", "--seed", seed, "--plan", "plan/plan.csv", "--out", out];
        done(at, &sim);
        done(at, &["sync", out, "--out", &format!("{out}.csv")]);
        let table = fs::read_to_string(at.join(format!("{out}.csv"))).unwrap();
        let measurements = Measurements::from_csv(out, &table).unwrap();
        measurements.rows.iter().map(|row| row.length_mm).collect::<Vec<f64>>()
    });
    assert!(lengths[0].len() >= 40 && lengths[0] == lengths[1]);
    assert_ne!(lengths[0], lengths[2]);
    let output = dbbd(at, &["acquire", "--port", "tcp://127.0.0.1:1", "--seed", "1", "--out", "d"]);
    assert_eq!((output.status.code(), codes(&output)), (Some(1), vec!["E1601".to_owned()]));
}

/// A second stage is planned on the identified robot, which knows the base ball better, and with one ball more: on the day of the
/// first run it goes on in its set-up. A run of another robot is refused.
#[test]
fn a_further_stage_goes_on_in_the_set_up() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    let second = JOB.replace(
        "[[circle]]",
        "[[centre]]\nid = 2\nxyz_mm = [950.0, 700.0, 1100.0]\n[[circle]]\ncentre = 2\nplane = \"XY\"\npoints = 40\n\
         amplitude_deg = 25.0\ntilt_deg = 15.0\n[[circle]]",
    );
    let other = JOB
        .replace("kr60ha", "irb1600-10-145")
        .replace("1300.0", "900.0")
        .replace("tilt_deg = 30.0", "tilt_deg = 0.0");
    for (name, job) in [("first", JOB), ("second", &second), ("other", &other)] {
        fs::write(at.join(format!("{name}.toml")), job).unwrap();
    }
    let acquire = |name: &str, seed: &str| {
        let (plan, run) = (format!("{name}/plan.csv"), format!("{name}.dbbd"));
        done(at, &["acquire", "--port", "sim", "--seed", seed, "--plan", &plan, "--out", &run]);
    };
    done(at, &["plan", "first.toml", "--out", "first"]);
    acquire("first", "3");
    done(at, &["identify", "first.dbbd", "--prior", "datasheet", "--out", "o"]);
    done(at, &["plan", "second.toml", "--robot", "o/robot-identified.toml", "--out", "second"]);
    acquire("second", "3");
    let places = ["first", "second"]
        .map(|name| read_plan(&at.join(name).join("plan.csv")).unwrap().header.job.balls()[0].position);
    assert_ne!(places[0], places[1]);
    done(
        at,
        &[
            "identify",
            "first.dbbd",
            "second.dbbd",
            "--robot",
            "kr60ha",
            "--tool",
            "30,20,10",
            "--out",
            "joined",
        ],
    );
    let balls = |name: &str| result(at, "joined").parameters.iter().any(|one| one.name.to_string() == name);
    assert!(balls("centre2_x") && !balls("centre3_x"));
    done(at, &["plan", "other.toml", "--out", "other"]);
    acquire("other", "3");
    let output = dbbd(at, &["identify", "first.dbbd", "other.dbbd", "--out", "none"]);
    assert_eq!((output.status.code(), codes(&output)), (Some(1), vec!["E1802".to_owned()]));
}
