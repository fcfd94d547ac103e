//! `dbbd acquire` over a real pseudo terminal, with a virtual bar on its other side.
#![cfg(unix)]

use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::sync::Arc;
use std::thread::JoinHandle;

use dbbd::base::clock;
use dbbd::daemon;
use dbbd::device::protocol::Definition;
use dbbd::measurement::sample::Sample;
use dbbd::provenance::Identity;
use dbbd::recording::capture::{self, Capture, Event, Record, RunEnd};
use dbbd::sim::bar::{self, Options, Reading, Source, Terminal};

use crate::cell::codes;

const RATE_HZ: f64 = 1000.0;

fn definition() -> Definition {
    Definition::by_name("dbb-cobs-1").unwrap().unwrap()
}

/// Readings on the 10 nm grid of the protocol, one a millisecond.
fn reading_mm(frame: u64) -> f64 {
    (f64::from(u32::try_from(frame % 20_001).unwrap()) - 10_000.0) / 1e5
}

pub(crate) fn reading(t_s: f64, strobe: bool) -> Reading {
    let frame = (t_s * RATE_HZ).round() as u64;
    Reading { reading_mm: reading_mm(frame), strobe, valid: true, temperature_c: 20.0 }
}

/// Plays a source on a new terminal: its name, and the thread that gives the number of frames sent.
pub(crate) fn play(speed: f64, source: impl Source + Send + 'static) -> (String, JoinHandle<u64>) {
    let terminal = Terminal::new().unwrap();
    let name = terminal.address().to_string();
    // The counter wraps after two seconds.
    let options = Options { rate_hz: RATE_HZ, speed, first_ticks: (1 << 32) - 2_000_000 };
    (name, std::thread::spawn(move || bar::serve(terminal, &definition(), options, source).unwrap()))
}

pub(crate) fn dbbd(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_dbbd"));
    command.args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

pub(crate) fn run(arguments: &[&str]) -> Output {
    dbbd(arguments).output().unwrap()
}

const NO_PORT: &str = "E0201";
const PORT_BUSY: &str = "E0203";
const STOPPED_SENDING: &str = "W0225";
const PORT_REFUSED: &str = "E0204";
const PORT_GONE: &str = "E0206";
const STAYED_AWAY: &str = "W0220";
const SAMPLES_MISSING: &str = "W0223";
const OPEN_TO_ALL: &str = "I0211";

/// What is asked of a bar that never sends a byte, the exit code, and the codes.
const SILENT: &[(&[&str], i32, &[&str])] = &[
    (&["--protocol", "microepsilon-ild1420"], 1, &["E0205"]),
    (&["--duration", "0.3"], 3, &["W0221"]),
    (&["--duration", "0.3", "--ekrl", "127.0.0.1:0"], 3, &["W0221", "W0224"]),
];

pub(crate) fn provoked() -> Vec<&'static str> {
    let silent = SILENT.iter().flat_map(|(_, _, codes)| *codes).copied();
    let others = [PORT_REFUSED, PORT_GONE, STAYED_AWAY, SAMPLES_MISSING, OPEN_TO_ALL, STOPPED_SENDING];
    silent.chain(others).chain([NO_PORT, PORT_BUSY]).collect()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn read(path: &Path) -> Capture {
    capture::read(&std::fs::read(path).unwrap())
}

fn samples(capture: &Capture) -> Vec<Sample> {
    capture.samples().map(|(_, sample)| *sample).collect()
}

/// Waits until the capture holds so many bytes.
pub(crate) fn wait_for(path: &Path, bytes: u64) {
    for _ in 0..500 {
        if std::fs::metadata(path).is_ok_and(|data| data.len() >= bytes) {
            return;
        }
        clock::sleep(0.02);
    }
    panic!("{} does not grow", path.display());
}

/// Sends a signal by the system's own tool.
pub(crate) fn signal(child: &Child, name: &str) {
    let status = Command::new("kill").args([format!("-{name}"), child.id().to_string()]).status().unwrap();
    assert!(status.success());
}

/// Whether the strobe is high: two dwells, then the end mark of two short pulses.
fn strobe(t_s: f64) -> bool {
    [(1.0, 2.0), (4.0, 5.0), (6.0, 6.2), (6.6, 6.8)].iter().any(|(from, to)| (*from..*to).contains(&t_s))
}

/// The program of [`strobe`]; when it is over the bar goes on until the host says stop.
struct Program {
    over: bool,
}

impl Source for Program {
    fn reading(&mut self, t_s: f64) -> Option<Reading> {
        self.over = t_s > 7.0;
        Some(reading(t_s, strobe(t_s)))
    }

    fn over(&self) -> bool {
        self.over
    }
}

#[test]
fn a_reading_that_was_set_to_zero_says_so_in_the_capture() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("run");
    let path = path.to_str().unwrap();
    let terminal = Terminal::new().unwrap();
    let port = terminal.address().to_string();
    std::thread::spawn(move || {
        let definition = Definition::by_name("cdi-starrett").unwrap().unwrap();
        let options = Options { rate_hz: RATE_HZ, speed: 1.0, first_ticks: 0 };
        bar::serve(terminal, &definition, options, Program { over: false })
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
    // The raw bytes come to the disk before what they decode to.
    let first = |wanted: fn(&Record) -> bool| capture.records.iter().position(|s| wanted(&s.record)).unwrap();
    assert!(first(|r| matches!(r, Record::Raw(_))) < first(|r| matches!(r, Record::Samples(_))));
    assert!(capture.attachment("protocol.toml").is_some());
    let events: Vec<&Event> = capture.events().collect();
    assert!(
        matches!(
            events[..],
            [Event::Started { .. }, Event::Opened { .. }, Event::Ended(RunEnd { lost: 0, .. })]
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

/// A bar whose line spoils every hundredth frame.
struct Spoiled(u64);

impl Source for Spoiled {
    fn reading(&mut self, t_s: f64) -> Option<Reading> {
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
fn spoiled_frames_are_faults_and_gaps_and_a_doubt() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("run");
    let (port, _bar) = play(0.0, Spoiled(0));
    let child = dbbd(&["acquire", "--port", &port, "--out", path.to_str().unwrap()]).spawn().unwrap();
    wait_for(&path, 300_000);
    signal(&child, "INT");
    let output = child.wait_with_output().unwrap();
    assert_eq!((output.status.code(), codes(&output)), (Some(3), vec![SAMPLES_MISSING.to_owned()]));
    let capture = read(&path);
    let missing: u64 = capture
        .events()
        .map(|event| match event {
            Event::Gap { missing, .. } => missing.unwrap(),
            _ => 0,
        })
        .sum();
    let faults = capture.records.iter().filter(|stamped| matches!(stamped.record, Record::Fault(_))).count();
    let expected = samples(&capture).len() as u64 / 99;
    assert!(expected > 5 && missing.abs_diff(expected) <= 1, "{missing} of {expected}");
    // The last fault may be a frame that the end cut through; a spoiled byte may end its frame early.
    assert!((faults as u64).abs_diff(expected) <= 2 + expected / 50, "{faults} of {expected}");
}

pub(crate) fn endless() -> impl Source {
    |t: f64| (t < 1e6).then(|| reading(t, false))
}

#[test]
fn signals_end_a_run_well() {
    for name in ["INT", "TERM", "HUP", "QUIT", "USR1", "USR2"] {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("run");
        let (port, _bar) = play(1.0, endless());
        let child = dbbd(&["acquire", "--port", &port, "--out", path.to_str().unwrap()]).spawn().unwrap();
        wait_for(&path, 20_000);
        signal(&child, name);
        let output = child.wait_with_output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        let capture = read(&path);
        assert!(capture.ended() && capture.damages.is_empty());
    }
}

#[test]
fn a_run_under_nohup_goes_on_without_its_terminal() {
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

#[test]
fn a_bar_that_falls_silent_is_a_doubt() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("run");
    // After half a second it sends no more, and stays plugged in.
    let (port, _bar) = play(1.0, |t_s: f64| {
        if t_s > 0.5 {
            clock::sleep(60.0);
        }
        Some(reading(t_s, false))
    });
    let acquire =
        ["acquire", "--port", &port, "--out", path.to_str().unwrap(), "--duration", "4.5", "--json"];
    let output = run(&acquire);
    assert_eq!((output.status.code(), codes(&output)), (Some(3), vec![STOPPED_SENDING.to_owned()]));
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let silent_s = summary["progress"]["silent_s"].as_f64().unwrap();
    assert!((3.0..4.5).contains(&silent_s), "{silent_s} s");
    assert!(read(&path).events().any(|event| matches!(event, Event::Gap { seconds: Some(_), .. })));
}

/// A bar between whose frames zeros come: each ends a frame that has nothing in it.
struct Zeros;

impl Source for Zeros {
    fn reading(&mut self, t_s: f64) -> Option<Reading> {
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
    // At most the record that was being written is torn, at the very end.
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
    assert_eq!(info.status.code(), Some(3), "a run that was cut off is a doubt: {}", stderr(&info));
    // The bar can be started again, by the same name.
    let again = directory.path().join("again");
    let output = run(&["acquire", "--port", &port, "--out", again.to_str().unwrap(), "--duration", "0.5"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
}

#[test]
fn a_torn_capture_is_recovered_with_a_doubt() {
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
    let (before, after) = (capture::read(&bytes), read(Path::new(&path("whole"))));
    assert_eq!((after.records, after.damages.len()), (before.records, 0));
    // It lacks its end for ever; a whole run lacks nothing.
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

/// In this process: a child would inherit the terminal's other side and keep it open.
#[test]
fn a_bar_that_goes_away_for_good_ends_the_run() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("run");
    let terminal = Terminal::new().unwrap();
    let options = daemon::Options {
        port: terminal.address().clone(),
        definition: definition(),
        out: path.clone(),
        plan: None,
        identity: Identity::default(),
        duration_s: None,
        gone_s: 0.3,
        feed: None,
        sync_s: 1.0,
    };
    let acquisition = daemon::Acquisition::start(options, Arc::default()).unwrap();
    drop(terminal);
    let summary = acquisition.join().unwrap();
    assert_eq!(summary.ending, daemon::Ending::Gone);
    let capture = read(&path);
    assert!(capture.ended());
    assert!(
        capture.events().any(|event| matches!(event, Event::Gap { reason, .. } if reason.contains("gone")))
    );
}

#[test]
fn the_plan_goes_into_the_capture_and_its_last_module_ends_the_run() {
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name).to_str().unwrap().to_owned();
    let demo = include_str!("../../examples/demo.toml").replace("points = 80", "points = 12");
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
    // Two dwells are no twelve poses.
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

#[test]
fn a_silent_bar_is_doubted() {
    for (more, exit, expected) in SILENT {
        let directory = tempfile::tempdir().unwrap();
        let terminal = Terminal::new().unwrap();
        let path = directory.path().join("run");
        let port = terminal.address().to_string();
        let given = ["acquire", "--port", &port, "--out", path.to_str().unwrap()];
        let output = run(&[&given[..], more].concat());
        assert_eq!(output.status.code(), Some(*exit), "{more:?}: {}", stderr(&output));
        assert_eq!(codes(&output), *expected, "{more:?}");
    }
}

/// In this process, as above: the line goes while the bar is asked.
#[test]
fn a_port_that_goes_while_a_command_is_sent() {
    let (mut line, host) = serialport::TTYPort::pair().unwrap();
    let name = serialport::SerialPort::name(&host).unwrap();
    drop(host);
    let pulled = std::thread::spawn(move || {
        // Nobody has the line open at first.
        let came =
            |line: &mut serialport::TTYPort| std::io::Read::read(line, &mut [0; 1]).is_ok_and(|n| n > 0);
        while !came(&mut line) {
            clock::sleep(0.001);
        }
    });
    let definition = Definition::by_name("microepsilon-ild1420").unwrap().unwrap();
    let gone = daemon::zero(&name.parse().unwrap(), &definition).unwrap_err();
    pulled.join().unwrap();
    assert_eq!(dbbd::diagnostic::Finding::code(&gone).0, PORT_GONE, "{gone}");
}

/// The simulator holds the other side of the line alone.
#[test]
fn a_bar_that_is_unplugged_for_good_is_a_doubt() {
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name).to_str().unwrap().to_owned();
    let program = "DEF P ( )\r\nPTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}\r\nHALT\r\nEND\r\n";
    std::fs::write(path("P.src"), program).unwrap();
    std::fs::write(path("world.toml"), "[bar]\nlength_mm = 300.0\nstroke_mm = [-6.0, 6.0]\n[[centre]]\nid = 1\nxyz_mm = [1300.0, 0.0, 800.0]\n").unwrap();
    let simulate = ["simulate", "--program", &path("P.src"), "--world", &path("world.toml"), "--halt", "600"];
    let mut simulator = dbbd(&[&simulate[..], &["--link", &path("bar")]].concat()).spawn().unwrap();
    let mut byte = [0; 1];
    std::io::Read::read_exact(simulator.stdout.as_mut().unwrap(), &mut byte).unwrap();
    let acquire = ["acquire", "--port", &path("bar"), "--gone", "0.3", "--out", &path("run")];
    let child = dbbd(&acquire).spawn().unwrap();
    wait_for(Path::new(&path("run")), 20_000);
    simulator.kill().unwrap();
    simulator.wait().unwrap();
    // Its terminal may become another test's.
    std::fs::remove_file(path("bar")).unwrap();
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    assert!(codes(&output).contains(&STAYED_AWAY.to_owned()), "{}", stderr(&output));
}

#[test]
fn a_file_is_no_port_and_an_open_address_is_named() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("run");
    let out = path.to_str().unwrap();
    let refused = run(&["acquire", "--port", "/dev/null", "--out", out]);
    assert_eq!((refused.status.code(), codes(&refused)), (Some(1), vec![PORT_REFUSED.to_owned()]));
    let open = run(&["acquire", "--port", "/dev/ttyNONE7", "--ekrl", "0.0.0.0:0", "--out", out]);
    assert_eq!(codes(&open), [OPEN_TO_ALL, NO_PORT]);
}

#[test]
fn a_missing_port_is_told_and_leaves_no_file() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("run");
    let output = run(&["acquire", "--port", "/dev/ttyNONE7", "--out", path.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(codes(&output), [NO_PORT]);
    assert!(!path.exists());
}

#[test]
fn an_occupied_port_is_told() {
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name).to_str().unwrap().to_owned();
    let (port, _bar) = play(1.0, endless());
    let mut first = dbbd(&["acquire", "--port", &port, "--out", &path("first")]).spawn().unwrap();
    wait_for(Path::new(&path("first")), 20_000);
    let second = run(&["acquire", "--port", &port, "--out", &path("second")]);
    signal(&first, "INT");
    first.wait().unwrap();
    assert_eq!(second.status.code(), Some(1));
    assert_eq!(codes(&second), [PORT_BUSY]);
}
