//! A virtual bar and `acquire`: the two programs and a pseudo-terminal between them.
#![cfg(unix)]

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Output;

use dbbd_job::recording::capture::Capture;
use dbbd_model::base::units::{DeviceTicks, HostNs};
use dbbd_model::measurement::sample::Sample;
use dbbd_model::robot::Robot;
use serde_json::Value;

use crate::cell::stderr;
use crate::process::{Simulator, dbbd, end_when, spawn};

/// The seed of the virtual bar.
pub(crate) const RATE_HZ: f64 = 1000.0;
/// The position of the controller at switch-on, so that nothing moves.
const AXES_DEG: [f64; 6] = [0.0, -90.0, 90.0, 0.0, 0.0, 0.0];

/// A robot at rest: every reading can be recognised by its own noise.
pub(crate) fn simulate(directory: &Path, speed: &str, rest: &[&str]) -> Simulator {
    simulate_at(0.0, directory, speed, rest)
}

/// The same at another mean reading, mm.
pub(crate) fn simulate_at(reading_mm: f64, directory: &Path, speed: &str, rest: &[&str]) -> Simulator {
    let axes = AXES_DEG.map(f64::to_radians);
    let ball = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0])
        .unwrap()
        .unwrap()
        .geometry
        .ball(&axes)
        .position;
    let world = format!(
        "[[centre]]\nid = 1\nxyz_mm = [{}, {}, {}]\n[bar]\nlength_mm = {:?}\nstroke_mm = [-2.0, 2.0]\n\
         noise_um = 100.0\nrate_hz = {RATE_HZ:.1}\n",
        ball.x,
        ball.y,
        ball.z - 300.0,
        300.0 - reading_mm,
    );
    std::fs::write(directory.join("world.toml"), world).unwrap();
    let [a1, a2, a3, a4, a5, a6] = AXES_DEG;
    let target = format!("PTP {{A1 {a1:.1},A2 {a2:.1},A3 {a3:.1},A4 {a4:.1},A5 {a5:.1},A6 {a6:.1}}}");
    std::fs::write(directory.join("STILL.src"), format!("DEF STILL ( )\n{target}\nWAIT SEC 3000\nEND\n"))
        .unwrap();
    let fixed = [
        "--program",
        "STILL.src",
        "--robot",
        "kr60ha",
        "--tool",
        "30,20,10",
        "--world",
        "world.toml",
        "--quiet",
    ];
    Simulator::start(directory, &[&fixed[..], &["--speed", speed], rest].concat())
}

/// A row of samples.csv.
pub(crate) struct Row {
    pub(crate) host: HostNs,
    pub(crate) frame: u64,
    pub(crate) sample: Sample,
}

/// The files of a run.
pub(crate) struct Run {
    pub(crate) output: Output,
    pub(crate) summary: Value,
    pub(crate) rows: Vec<Row>,
    pub(crate) bytes: u64,
    /// Kind, word, bytes.
    pub(crate) faults: Vec<(String, String, u64)>,
    /// Name and detail.
    pub(crate) events: Vec<(HostNs, String, Value)>,
}

pub(crate) fn acquire(directory: &Path, port: &str, seconds: &str, rest: &[&str]) -> Run {
    let mut command = dbbd(&["acquire", "--port", port, "--out", "run", "--duration", seconds, "--json"]);
    exported(directory, command.args(rest).current_dir(directory).output().unwrap())
}

/// The same until the capture is as it should be.
pub(crate) fn acquire_until(directory: &Path, port: &str, done: impl Fn(&Capture) -> bool) -> Run {
    let child = spawn(directory, &["acquire", "--port", port, "--out", "run", "--json"]);
    exported(directory, end_when(child, &directory.join("run"), done))
}

fn exported(directory: &Path, output: Output) -> Run {
    let exported = dbbd(&["export", "run", "--out", "csv"]).current_dir(directory).output().unwrap();
    assert_eq!(exported.status.code(), Some(0), "{}{}", stderr(&output), stderr(&exported));
    let table = |name: &str| -> Vec<BTreeMap<String, String>> {
        let mut rows = csv::Reader::from_path(directory.join("csv").join(name)).unwrap();
        rows.deserialize().map(Result::unwrap).collect()
    };
    let host = |row: &BTreeMap<String, String>| HostNs(row["host_ns"].parse().unwrap());
    let samples = table("samples.csv");
    let rows = samples.iter().map(|row| {
        let ticks: Option<u64> = row["ticks"].parse().ok();
        let sample = Sample {
            reading_mm: row["reading_mm"].parse().unwrap(),
            sequence: row["sequence"].parse().ok(),
            ticks: ticks.map(DeviceTicks),
            trigger: Some(row["trigger"] == "1"),
            temperature_c: row["temperature_c"].parse().ok(),
            valid: row["valid"] == "1",
            status: row["status"].parse().unwrap(),
            offset: 0,
        };
        Row { host: host(row), frame: ticks.unwrap_or(0) / 1000, sample }
    });
    let raw = table("raw.csv");
    let faults = table("faults.csv");
    let events = table("events.csv");
    Run {
        summary: serde_json::from_slice(&output.stdout).unwrap_or(Value::Null),
        output,
        rows: rows.collect(),
        bytes: raw.iter().map(|row| row["bytes_hex"].len() as u64 / 2).sum(),
        faults: faults
            .iter()
            .map(|row| (row["kind"].clone(), row["word"].clone(), row["bytes"].parse().unwrap()))
            .collect(),
        events: events
            .iter()
            .map(|row| (host(row), row["event"].clone(), serde_json::from_str(&row["detail_json"]).unwrap()))
            .collect(),
    }
}
