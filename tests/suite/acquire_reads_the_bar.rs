//! `dbbd acquire` over a pseudo-terminal with a virtual bar.
#![cfg(unix)]

use std::path::Path;
use std::process::{Command, Stdio};

use dbbd_device::protocol::ProtocolDefinition;
use dbbd_job::recording::capture::{self, CaptureRecord, RunEnd, RunEvent};
use dbbd_job::sim::bar::{self, ReadingSource, SimulatedReading, Terminal, VirtualBarOptions};
use dbbd_model::provenance::DataOrigin;

use crate::cell::{codes, stderr};
use crate::played_bar::{RATE_HZ, endless, play, read, reading, reading_mm, samples, wait_for};
use crate::process::{dbbd, run, signal};

const SAMPLES_MISSING: &str = "W0223";

/// Whether the strobe is high: two dwells, then the end mark of two short pulses.
fn strobe(t_s: f64) -> bool {
    [(1.0, 2.0), (4.0, 5.0), (6.0, 6.2), (6.6, 6.8)].iter().any(|(from, to)| (*from..*to).contains(&t_s))
}

/// The program of [`strobe`]. After its end the bar continues until the host sends stop.
struct Program {
    over: bool,
}

impl ReadingSource for Program {
    fn reading(&mut self, t_s: f64) -> Option<SimulatedReading> {
        self.over = t_s > 7.0;
        Some(reading(t_s, strobe(t_s)))
    }

    fn over(&self) -> bool {
        self.over
    }
}

#[test]
fn zeroing_is_noted_in_the_capture() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("run");
    let path = path.to_str().unwrap();
    let terminal = Terminal::new().unwrap();
    let port = terminal.address().to_string();
    std::thread::spawn(move || {
        let definition = ProtocolDefinition::by_name("cdi-starrett").unwrap().unwrap();
        let options = VirtualBarOptions { rate_hz: RATE_HZ, speed: 1.0, first_ticks: 0 };
        bar::serve_bar(terminal, &definition, options, Program { over: false })
    });
    let acquire =
        ["acquire", "--port", &port, "--protocol", "cdi-starrett", "--duration", "0.5", "--out", path];
    let output = run(&[&acquire[..], &["--zero"]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let info: serde_json::Value = serde_json::from_slice(&run(&["info", path, "--json"]).stdout).unwrap();
    assert_eq!(info["remarks"], serde_json::json!(["the bar's reading was set to zero before the run"]));
}

#[test]
fn a_program_is_recorded_to_its_end_mark() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("run");
    // Twenty quiet seconds of device time after the mark end a run without a plan.
    let (port, bar) = play(0.0, Program { over: false });
    let output = run(&["acquire", "--port", &port, "--out", path.to_str().unwrap(), "--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary["ending"], "mark");
    assert_eq!(summary["progress"]["dwells"], 2);
    let capture = read(&path);
    assert_eq!(capture.damages, []);
    let samples = samples(&capture);
    let sent = bar.join().unwrap();
    assert!((26_700..=sent).contains(&(samples.len() as u64)), "{} of {sent}", samples.len());
    for (frame, sample) in (0u64..).zip(&samples) {
        assert_eq!(sample.sequence, Some((frame % 65536) as u32));
        assert_eq!(sample.reading_mm, reading_mm(frame), "frame {frame}");
        assert_eq!(sample.trigger, Some(strobe(frame as f64 / RATE_HZ)));
        assert_eq!(sample.ticks.unwrap().0, ((1u64 << 32) - 2_000_000 + 1000 * frame) % (1 << 32));
    }
    // Raw bytes are written before the decoded samples.
    let first =
        |wanted: fn(&CaptureRecord) -> bool| capture.records.iter().position(|s| wanted(&s.record)).unwrap();
    assert!(
        first(|r| matches!(r, CaptureRecord::Raw(_))) < first(|r| matches!(r, CaptureRecord::Samples(_)))
    );
    assert!(capture.attachment("protocol.toml").is_some());
    let events: Vec<&RunEvent> = capture.events().collect();
    assert!(
        matches!(
            events[..],
            [
                RunEvent::Started { .. },
                RunEvent::Opened { .. },
                // The mark of the virtual bar comes with its first frame.
                RunEvent::Origin { origin: DataOrigin::Measured },
                RunEvent::Origin { origin: DataOrigin::Simulated },
                RunEvent::Ended(RunEnd { lost: 0, .. })
            ]
        ),
        "{events:?}"
    );

    // The exports read back bit for bit.
    let out = directory.path().join("csv");
    let exported = run(&["export", path.to_str().unwrap(), "--out", out.to_str().unwrap()]);
    assert_eq!(exported.status.code(), Some(0), "{}", stderr(&exported));
    let mut rows = csv::Reader::from_path(out.join("samples.csv")).unwrap();
    let mut count = 0;
    for (row, sample) in rows.records().zip(&samples) {
        let row = row.unwrap();
        assert_eq!(row[3].parse::<f64>().unwrap().to_bits(), sample.reading_mm.to_bits());
        count += 1;
    }
    assert_eq!(count, samples.len());
    let info = run(&["info", path.to_str().unwrap(), "--json"]);
    assert_eq!(info.status.code(), Some(0), "{}", stderr(&info));
    let info: serde_json::Value = serde_json::from_slice(&info.stdout).unwrap();
    assert_eq!(info["samples"], samples.len());
    assert_eq!(info["protocol"], "dbb-cobs-1");
}

/// A line that damages every hundredth frame.
struct Spoiled(u64);

impl ReadingSource for Spoiled {
    fn reading(&mut self, t_s: f64) -> Option<SimulatedReading> {
        (t_s < 3600.0).then(|| reading(t_s, false))
    }

    fn spoil(&mut self, frame: &mut Vec<u8>) {
        self.0 += 1;
        if self.0.is_multiple_of(100) {
            frame[5] ^= 1;
        }
    }
}

#[test]
fn damaged_frames_are_recorded_and_give_a_warning() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("run");
    let (port, _bar) = play(0.0, Spoiled(0));
    let child = dbbd(&["acquire", "--port", &port, "--out", path.to_str().unwrap()]).spawn().unwrap();
    wait_for(&path, 300_000);
    signal(&child, "INT");
    let output = child.wait_with_output().unwrap();
    assert_eq!((output.status.code(), codes(&output)), (Some(3), vec![SAMPLES_MISSING.to_owned()]));
    let capture = read(&path);
    let missing: u64 = capture.events().map(|event| event.gaps().1).sum();
    let faults =
        capture.records.iter().filter(|stamped| matches!(stamped.record, CaptureRecord::Fault(_))).count();
    let expected = samples(&capture).len() as u64 / 99;
    assert!(expected > 5 && missing.abs_diff(expected) <= 1, "{missing} of {expected}");
    // The last fault may be a frame that the end of the run cut. A damaged byte may end its frame early.
    assert!((faults as u64).abs_diff(expected) <= 2 + expected / 50, "{faults} of {expected}");
}

#[test]
fn signals_complete_the_run() {
    for name in ["INT", "TERM", "HUP", "QUIT", "USR1", "USR2"] {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("run");
        let (port, _bar) = play(1.0, endless());
        // Under `nohup cargo test` a child would ignore SIGHUP.
        let mut env = Command::new("env");
        env.args(["--default-signal=HUP", env!("CARGO_BIN_EXE_dbbd"), "acquire", "--port", &port, "--out"]);
        env.arg(&path).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let child = env.spawn().unwrap();
        wait_for(&path, 20_000);
        signal(&child, name);
        let output = child.wait_with_output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        let capture = read(&path);
        assert!(capture.ended() && capture.damages.is_empty());
    }
}

#[test]
fn a_run_under_nohup_survives_its_terminal() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("run");
    let (port, _bar) = play(1.0, endless());
    let mut nohup = Command::new("nohup");
    nohup.arg(env!("CARGO_BIN_EXE_dbbd")).args(["acquire", "--port", &port, "--out", path.to_str().unwrap()]);
    let child = nohup.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    wait_for(&path, 20_000);
    signal(&child, "HUP");
    wait_for(&path, std::fs::metadata(&path).unwrap().len() + 40_000);
    signal(&child, "INT");
    assert_eq!(child.wait_with_output().unwrap().status.code(), Some(0));
    assert!(read(&path).ended());
}

/// A bar that sends zeros between frames: each zero ends an empty frame.
struct Zeros;

impl ReadingSource for Zeros {
    fn reading(&mut self, t_s: f64) -> Option<SimulatedReading> {
        (t_s < 3600.0).then(|| reading(t_s, false))
    }

    fn spoil(&mut self, frame: &mut Vec<u8>) {
        frame.extend([0; 1000]);
    }
}

#[test]
fn faults_in_a_row_are_one_record() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("run");
    let (port, _bar) = play(0.0, Zeros);
    let output = run(&["acquire", "--port", &port, "--out", path.to_str().unwrap(), "--duration", "1"]);
    assert!(matches!(output.status.code(), Some(0 | 3)), "{}", stderr(&output));
    let info: serde_json::Value =
        serde_json::from_slice(&run(&["info", path.to_str().unwrap(), "--json"]).stdout).unwrap();
    let raw = info["raw_bytes"].as_u64().unwrap();
    let faults: u64 = info["faults"].as_object().unwrap().values().map(|count| count.as_u64().unwrap()).sum();
    assert!(raw > 20_000 && 10 * faults > 9 * raw, "{info:#}");
    let size = std::fs::metadata(&path).unwrap().len();
    assert!(size < 4 * raw, "{size} bytes of {raw}");
}

#[test]
fn a_kill_keeps_what_was_written() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("run");
    let (port, _bar) = play(0.0, endless());
    let mut child = dbbd(&["acquire", "--port", &port, "--out", path.to_str().unwrap()]).spawn().unwrap();
    wait_for(&path, 200_000);
    signal(&child, "KILL");
    child.wait().unwrap();
    let size = std::fs::metadata(&path).unwrap().len();
    let capture = read(&path);
    assert!(!capture.ended());
    // At most the last record is torn.
    match &capture.damages[..] {
        [] => {}
        [torn] => assert_eq!(torn.offset + torn.bytes, size),
        more => panic!("{more:?}"),
    }
    let samples = samples(&capture);
    assert!(samples.len() > 500);
    for (frame, sample) in (0u64..).zip(&samples) {
        assert_eq!(sample.reading_mm, reading_mm(frame));
    }
    let info = run(&["info", path.to_str().unwrap()]);
    assert_eq!(info.status.code(), Some(3), "a run that was cut off has a warning: {}", stderr(&info));
    // The bar can be started again under the same name.
    let again = directory.path().join("again");
    let output = run(&["acquire", "--port", &port, "--out", again.to_str().unwrap(), "--duration", "0.5"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
}

#[test]
fn a_torn_capture_is_recovered_with_a_warning() {
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name).to_str().unwrap().to_owned();
    let (port, _bar) = play(0.0, endless());
    let output = run(&["acquire", "--port", &port, "--out", &path("run"), "--duration", "0.3"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let mut bytes = std::fs::read(path("run")).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 4;
    bytes.truncate(bytes.len() - 3);
    std::fs::write(path("torn"), &bytes).unwrap();
    let recovered = run(&["recover", &path("torn"), "--out", &path("whole")]);
    assert_eq!(recovered.status.code(), Some(3), "{}", stderr(&recovered));
    assert_eq!(codes(&recovered), ["W0410", "W0410", "W0411"], "{}", stderr(&recovered));
    let (before, after) = (capture::read_capture(&bytes), read(Path::new(&path("whole"))));
    assert_eq!((after.records, after.damages.len()), (before.records, 0));
    // Its end stays missing. A complete run misses nothing.
    let again = run(&["recover", &path("whole"), "--out", &path("more")]);
    assert_eq!(again.status.code(), Some(3), "{}", stderr(&again));
    assert!(stderr(&again).contains("cut off"), "{}", stderr(&again));
    let intact = run(&["recover", &path("run"), "--out", &path("again")]);
    assert_eq!(intact.status.code(), Some(0), "{}", stderr(&intact));
    assert_eq!(
        run(&["recover", &path("run"), "--out", &path("again")]).status.code(),
        Some(1),
        "not overwritten"
    );
    std::fs::write(path("text"), "no capture").unwrap();
    assert_eq!(run(&["info", &path("text")]).status.code(), Some(1));
}

#[test]
fn the_plan_goes_into_the_capture_and_its_last_module_ends_the_run() {
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name).to_str().unwrap().to_owned();
    let demo = include_str!("../../examples/circles.toml").replace("points = 80", "points = 12");
    let (first, others) = demo.split_at(demo.rfind("[[circle]]").unwrap());
    let (first, _) = first.split_at(first.rfind("[[circle]]").unwrap());
    let (_, rest) = others.split_at(others.find("[[obstacle]]").unwrap());
    std::fs::write(path("job.toml"), format!("{first}{rest}")).unwrap();
    let planned = run(&["plan", &path("job.toml"), "--out", directory.path().to_str().unwrap()]);
    assert_eq!(planned.status.code(), Some(0), "{}", stderr(&planned));
    let (rows, header) =
        (std::fs::read(path("plan.csv")).unwrap(), std::fs::read(path("plan.json")).unwrap());
    let (port, bar) = play(0.0, Program { over: false });
    let output = run(&["acquire", "--port", &port, "--plan", &path("plan.csv"), "--out", &path("run")]);
    bar.join().unwrap();
    // Two dwells do not cover twelve poses.
    assert_eq!(output.status.code(), Some(3));
    assert!(codes(&output).contains(&"W1003".to_owned()), "{}", stderr(&output));
    let capture = read(Path::new(&path("run")));
    assert_eq!(capture.attachment("plan.csv"), Some(&rows[..]));
    assert_eq!(capture.attachment("plan.json"), Some(&header[..]));
    assert!(capture.attachment("robot.toml").is_some());
    // The mark is over one second after its last pulse at 6.8 s; then come only the bytes on the way.
    let strobes = samples(&capture).iter().filter(|sample| sample.trigger == Some(true)).count();
    assert_eq!(strobes, 2400);
    // A plan that was changed is refused.
    let changed = String::from_utf8(rows).unwrap().replacen("measure", "reference", 1);
    std::fs::write(path("plan.csv"), changed).unwrap();
    let output = run(&["acquire", "--port", &port, "--plan", &path("plan.csv"), "--out", &path("other")]);
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(codes(&output).len(), 1, "{}", stderr(&output));
}
