//! Inputs that are valid one by one but wrong together, in part, or for their use are refused or reported.
#![cfg(unix)]

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

use dbbd_device::clock;
use dbbd_model::measurement::{ContextColumn, MeasurementContext, Measurements};
use dbbd_model::provenance::Provenance;
use tempfile::tempdir;

use crate::cell::{codes, dbbd, stderr};
use crate::nothing_wrong_is_silent::{JOB, cell, identify, says};

fn step(dir: &Path, args: &[&str]) -> Output {
    let output = dbbd(dir, args);
    assert!(matches!(output.status.code(), Some(0 | 3)), "dbbd {}: {}", args.join(" "), stderr(&output));
    output
}

fn short_plan(dir: &Path) {
    let job = include_str!("../../examples/circles.toml").replace("points = 80", "points = 12");
    fs::write(dir.join("job.toml"), job).unwrap();
    step(dir, &["plan", "job.toml", "--out", "plan"]);
}

/// The layout of dbbd's own export, with or without the strobe.
fn mapping(strobe: &str) -> String {
    format!(
        "[time]\ncolumn = \"ticks\"\nunit = \"us\"\n[length]\ncolumn = \"reading_mm\"\nkind = \"reading\"\n{strobe}"
    )
}

/// A table of samples with each reading changed by a function of its row.
fn of_readings(text: &str, mut of: impl FnMut(usize, f64) -> f64) -> String {
    let mut lines = text.lines();
    let header = lines.next().unwrap();
    let column = header.split(',').position(|name| name == "reading_mm").unwrap();
    let rows = lines.enumerate().map(|(at, line)| {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        cells[column] = of(at, cells[column].parse().unwrap()).to_string();
        cells.join(",") + "\n"
    });
    format!("{header}\n{}", rows.collect::<String>())
}

/// The reading at a third of the rows is repeated until half of them.
fn holding(count: usize) -> impl FnMut(usize, f64) -> f64 {
    let mut held = None;
    move |at, mm| if (count / 3..count / 2).contains(&at) { *held.get_or_insert(mm) } else { mm }
}

#[test]
fn frozen_traces() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    short_plan(at);
    step(at, &["acquire", "--port", "sim", "--plan", "plan/plan.csv", "--out", "run.dbbd"]);
    step(at, &["export", "run.dbbd", "--out", "csv"]);
    let samples = fs::read_to_string(at.join("csv/samples.csv")).unwrap();
    fs::write(at.join("sound.csv"), &samples).unwrap();
    fs::write(at.join("frozen.csv"), of_readings(&samples, holding(samples.lines().count()))).unwrap();
    fs::write(at.join("strobe.toml"), mapping("[strobe]\ncolumn = \"trigger\"\n")).unwrap();
    fs::write(at.join("still.toml"), mapping("")).unwrap();
    for (name, how, warning) in
        [("sound", "still", None), ("sound", "strobe", None), ("frozen", "strobe", Some("W1008"))]
    {
        let [table, mapping, run] =
            [format!("{name}.csv"), format!("{how}.toml"), format!("{name}-{how}.dbbd")];
        step(at, &["import", &table, "--plan", "plan/plan.csv", "--mapping", &mapping, "--out", &run]);
        let output = step(at, &["sync", &run, "--out", "o.csv"]);
        let mut said = codes(&output);
        said.retain(|code| ["W1008"].contains(&code.as_str()));
        assert_eq!(said.first().map(String::as_str), warning, "{name} {how}: {}", stderr(&output));
    }
}

#[test]
fn tables_of_two_robots_or_bars() {
    let (dir, data) = cell();
    let at = dir.path();
    let text = data.to_csv();
    fs::write(at.join("other.csv"), &text).unwrap();
    fs::write(at.join("positions.csv"), "a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg,x_mm,y_mm,z_mm\n")
        .unwrap();
    let record = |table: &str, robot: &str, bar: &str| {
        let mut provenance = Provenance::default();
        provenance.identity.robot = Some(robot.into());
        provenance.identity.bar.serial = Some(bar.into());
        let text = fs::read_to_string(at.join(table)).unwrap_or_else(|_| text.clone());
        dbbd_job::artefact::write_beside(&provenance, &at.join(table), &text).unwrap();
    };
    record("bad.csv", "R-1", "B-1");
    let validated = |robot: &str, bar: &str| {
        record("other.csv", robot, bar);
        identify(at, &text, &["--prior", "datasheet", "--validate", "other.csv"])
    };
    says(&validated("R-2", "B-1"), 1, "E1802");
    says(&validated("R-1", "B-2"), 3, "W1845");
    assert!(!codes(&validated("R-1", "B-1")).contains(&"W1845".to_owned()));
    record("positions.csv", "R-2", "B-1");
    says(&identify(at, &text, &["--positions", "positions.csv"]), 1, "E1802");
}

#[test]
fn facts_of_the_bar() {
    let (dir, data) = cell();
    let at = dir.path();
    let warm = |celsius: f64| -> Measurements {
        let mut warm = data.clone();
        let context = std::sync::Arc::new(MeasurementContext {
            temperature_c: Some(celsius),
            ..MeasurementContext::default()
        });
        warm.columns.push(ContextColumn::TemperatureC);
        warm.rows.iter_mut().for_each(|row| row.context = Some(context.clone()));
        warm
    };
    let prior = ["--prior", "datasheet"];
    says(&identify(at, &warm(42.0).to_csv(), &prior), 3, "W0482");
    assert_eq!(identify(at, &warm(21.0).to_csv(), &prior).status.code(), Some(0));
    let id = "measured = \"2026-01-05\"\n[bar]\ncertified_on = \"2019-03-01\"\n";
    for (text, is_old) in [(id.to_owned(), true), (id.replace("2019", "2025"), false)] {
        fs::write(at.join("id.toml"), text).unwrap();
        let output = identify(at, &data.to_csv(), &[&prior[..], &["--identity", "id.toml"]].concat());
        assert_eq!(codes(&output).contains(&"I1846".to_owned()), is_old, "{}", stderr(&output));
    }
    // The job has one ball, and no floor within reach.
    assert_eq!(dbbd(at, &["plan", "job.toml", "--out", "plan"]).status.code(), Some(0));
    fs::write(at.join("balls.toml"), "[balls]\n9 = \"K-9\"\n").unwrap();
    let acquire =
        ["acquire", "--port", "/dev/null/none", "--plan", "plan/plan.csv", "--out", "r", "--gone", "0"];
    let output = dbbd(at, &[&acquire[..], &["--identity", "balls.toml"]].concat());
    assert!(codes(&output).contains(&"W1844".to_owned()), "{}", stderr(&output));
    for (from, to) in [
        ("[[circle]]", "[[centre]]\nid = 2\nxyz_mm = [900.0, 700.0, 900.0]\n[[circle]]"),
        ("[[obstacle]]", "[[obstacle]]\nshape = \"floor\"\nz_mm = -8000.0\n[[obstacle]]"),
    ] {
        fs::write(at.join("job.toml"), JOB.replacen(from, to, 1)).unwrap();
        says(&dbbd(at, &["plan", "job.toml", "--out", "plan2"]), 0, "I0681");
    }
}

/// A simulator of the programs in `krl`, and the address of its bar.
fn simulator(dir: &Path, more: &[&str]) -> (Child, String) {
    let mut child = Command::new(env!("CARGO_BIN_EXE_dbbd"))
        .args(["simulate", "--program", "krl/DBB_MAIN.src"])
        .args(more)
        .current_dir(dir)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut port = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut port).unwrap();
    (child, port.trim().to_owned())
}

#[test]
fn simulations() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    short_plan(at);
    step(at, &["krl", "plan/plan.csv", "--out", "krl"]);
    let axes = ["--axes", "rsi://127.0.0.1:49152", "--speed", "0"];
    says(&dbbd(at, &[&["simulate", "--program", "krl/DBB_MAIN.src"], &axes[..]].concat()), 1, "E1601");
    // After a signal, no link is left.
    let (child, _) = simulator(at, &["--link", "bar"]);
    assert!(fs::symlink_metadata(at.join("bar")).is_ok());
    Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap();
    says(&child.wait_with_output().unwrap(), 3, "W1610");
    assert!(fs::symlink_metadata(at.join("bar")).is_err());
    // A program with a strobe does not use a server.
    let (child, port) =
        simulator(at, &["--listen", "tcp://127.0.0.1:0", "--speed", "0", "--ekrl", "127.0.0.1:9"]);
    step(at, &["acquire", "--port", &port, "--plan", "plan/plan.csv", "--out", "run.dbbd"]);
    says(&child.wait_with_output().unwrap(), 3, "W1611");
    // A bar that is longer than the circles' radius.
    fs::write(at.join("world.toml"), "[bar]\nlength_mm = 320.0\n").unwrap();
    let (mut child, port) =
        simulator(at, &["--listen", "tcp://127.0.0.1:0", "--speed", "0", "--world", "world.toml"]);
    let acquire = ["acquire", "--port", &port, "--plan", "plan/plan.csv", "--out", "longer.dbbd"];
    says(&dbbd(at, &acquire), 3, "W0222");
    let _ = child.wait();
    // The program of another robot, and the .dat of another plan.
    let simulate = ["simulate", "--program", "krl/DBB_MAIN.src", "--nominal"];
    says(&dbbd(at, &[&simulate[..], &["kr16-2"]].concat()), 1, "E1802");
    let job = fs::read_to_string(at.join("job.toml")).unwrap().replace("points = 12", "points = 10");
    fs::write(at.join("other.toml"), job).unwrap();
    step(at, &["plan", "other.toml", "--out", "other"]);
    step(at, &["krl", "other/plan.csv", "--out", "other-krl"]);
    fs::copy(at.join("other-krl/DBB_C001.dat"), at.join("krl/DBB_C001.dat")).unwrap();
    says(&dbbd(at, &[&simulate[..], &["kr60ha"]].concat()), 1, "E0806");
}

#[test]
fn simulated_bars() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    let output = dbbd(at, &["bar", "identify", "--port", "sim", "--duration", "0.5"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(String::from_utf8_lossy(&output.stdout).contains("dbb-cobs-1"));
    let output = dbbd(at, &["bar", "check", "--port", "sim", "--duration", "6", "--out", "bar"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    // A run that ends by --duration does not wait for the program.
    let begun = clock::now();
    let output = dbbd(at, &["acquire", "--port", "sim", "--duration", "0.2", "--out", "run"]);
    assert!(matches!(output.status.code(), Some(0 | 3)), "{}", stderr(&output));
    let took_s = clock::now().seconds_since(begun);
    assert!(took_s < 9.0, "{took_s}");
}
