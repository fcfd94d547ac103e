//! Makes the recordings: a tap on the line between a virtual bar and `acquire`.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use dbbd_device::clock;
use dbbd_device::protocol::{ProtocolDefinition, ProtocolMode};
use dbbd_job::recording::capture::{self, CaptureRecord};
use serialport::TTYPort;

use super::player::{other_side, read, terminal, told};
use crate::recordings::{Line, Recording, What, directory};

const NOTHING: &[&str] = &[];

/// Protocol, what goes wrong, in words, and the faults of the virtual bar.
const FAULTS: &[(&str, &str, &str, &[&str])] = &[
    ("dbb-cobs-1", "banner", "the bar says who it is before its first frame", &["banner=1"]),
    ("dbb-cobs-1", "double", "1 byte in 200 comes twice", &["double=0.005"]),
    ("dbb-cobs-1", "drop", "1 byte in 200 is lost", &["drop=0.005"]),
    ("dbb-cobs-1", "echo", "the bar sends commands back", &["echo=1"]),
    ("dbb-cobs-1", "flip", "a bit of 1 byte in 200 is flipped", &["flip=0.005"]),
    ("dbb-cobs-1", "insert", "before 1 byte in 200 stands another", &["insert=0.005"]),
    ("dbb-cobs-1", "over", "the bar is 3 mm beyond its stroke", &["over_mm=3"]),
    ("dbb-cobs-1", "skip", "1 sequence number in 20 is left out", &["skip=0.05"]),
    (
        "dbb-cobs-1",
        "unplug",
        "the bar is pulled out, and comes back under another name",
        &["unplug_s=2", "away_s=0.5"],
    ),
    ("dbb-cobs-1", "wrap", "the bar's counter wraps after 2 s", &["wrap_ticks=2000000"]),
    ("dbb-nmea-1", "flip", "a bit of 1 byte in 200 is flipped", &["flip=0.005"]),
    ("microepsilon-ild1420", "refuse", "1 reading in 10 is the sensor's word for none", &["refuse=0.1"]),
    ("modbus-rtu", "flip", "a bit of 1 byte in 50 is flipped", &["flip=0.02"]),
    ("riftek-rf60x", "drop", "1 byte in 50 is lost", &["drop=0.02"]),
    ("sylvac-opto", "echo", "the gauge sends commands back", &["echo=1"]),
    ("sylvac-opto", "refuse", "the gauge refuses 4 readings in 10", &["refuse=0.4"]),
    ("sylvac-opto", "silence", "the gauge does not answer 3 requests in 10", &["silence=0.3"]),
];

/// `cargo test --test suite record_the_virtual_bars -- --ignored`: then `DBBD_BLESS=1 cargo test replay`.
/// With `DBBD_RECORD=NAME` that one alone.
#[test]
#[ignore = "writes fixtures/captures/*.rec"]
fn record_the_virtual_bars() {
    let whole = ProtocolDefinition::built_in().iter().map(|(id, _)| (*id, "", "all is well", NOTHING));
    let only = std::env::var("DBBD_RECORD").ok();
    std::thread::scope(|scope| {
        for (protocol, fault, words, faults) in whole.chain(FAULTS.iter().copied()) {
            let name = if fault.is_empty() { protocol.to_owned() } else { format!("{protocol}+{fault}") };
            if only.as_ref().is_none_or(|only| *only == name) {
                scope.spawn(move || record(&name, words, faults));
            }
        }
    });
}

fn record(name: &str, words: &str, faults: &[&str]) {
    let mut recording = Recording { name: name.into(), ..Recording::default() };
    let definition = recording.definition();
    let lasts_s = if matches!(definition.mode, ProtocolMode::Poll { .. }) { 2.5 } else { 5.5 };
    let seconds = (definition.line.settle.as_secs_f64() + lasts_s).to_string();
    let protocol = recording.protocol().to_owned();
    let mut simulate = vec![
        "simulate",
        "--program",
        "MODULE.src",
        "--robot",
        "kr60ha",
        "--tool",
        "30,20,10",
        "--world",
        "world.toml",
    ];
    simulate.extend(["--protocol", &protocol, "--seed", "7"]);
    simulate.extend(faults.iter().flat_map(|fault| ["--fault", *fault]));
    let acquire = ["acquire", "--protocol", &protocol, "--duration", &seconds];
    recording.header = vec![
        format!("{}: {words}.", definition.title),
        "`>` is what the host sent, `<` what the bar sent, at seconds; `x`: the bar is unplugged, and comes back.".into(),
        "The last `stream` bytes of the bar's are its stream, what is before them are answers to commands.".into(),
        "Recorded between these two, in fixtures/captures:".into(),
        format!("dbbd {}", simulate.join(" ")),
        format!("dbbd {} --port PTY --out RUN", acquire.join(" ")),
        format!("Again: DBBD_RECORD={name} cargo test --test suite record_the_virtual_bars -- --ignored"),
    ];
    let temporary = tempfile::tempdir().unwrap();
    let path = |name: &str| temporary.path().join(name).to_str().unwrap().to_owned();
    let (bar, tap, run) = (path("bar"), path("tap"), path("run"));
    let dbbd = |arguments: &[&str], more: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_dbbd"));
        command.args(arguments).args(more).current_dir(directory()).stdin(Stdio::null());
        command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    };
    let mut simulator = dbbd(&simulate, &["--link", &bar]);
    BufReader::new(simulator.stdout.take().unwrap()).read_line(&mut String::new()).unwrap();
    let mut tapping = other_side("replay::record::taps", &format!("{bar}\t{tap}"));
    let mut lines = BufReader::new(tapping.stderr.take().unwrap()).lines().map_while(Result::ok);
    assert_eq!(lines.next().as_deref(), Some("ready"));
    let mut acquisition = dbbd(&acquire, &["--port", &tap, "--out", &run]);
    let mut said = BufReader::new(acquisition.stderr.take().unwrap()).lines().map_while(Result::ok);
    said.by_ref().find(|line| line.starts_with("reading ")).expect("it reads");
    tapping.stdin.as_mut().unwrap().write_all(b"reads\n").unwrap();
    let reader = std::thread::spawn(move || lines.map(|line| line + "\n").collect::<String>());
    said.for_each(drop);
    acquisition.wait().unwrap();
    drop(tapping.stdin.take());
    tapping.wait().unwrap();
    simulator.kill().unwrap();
    simulator.wait().unwrap();
    recording.lines = Recording::parse(name, &reader.join().unwrap()).unwrap().lines;
    let capture = capture::read_capture(&std::fs::read(&run).unwrap());
    let raw = capture.records.iter().filter_map(|stamped| match &stamped.record {
        CaptureRecord::Raw(bytes) => Some(&bytes[..]),
        _ => None,
    });
    keep(&mut recording, &raw.collect::<Vec<_>>().concat());
    std::fs::write(directory().join(format!("{name}.rec")), recording.text()).unwrap();
}

/// Carries bytes between the bar and the program behind two links, and tells of them line by line.
#[test]
#[ignore = "the other side of record_the_virtual_bars, which starts it"]
fn taps() {
    let Some(told) = told() else { return };
    let [bar, tap] = &told[..] else { panic!("{told:?}") };
    let (mut line, mut plug) = terminal(tap);
    eprintln!("ready");
    let begun = clock::now();
    let (reads, over) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
    let (reading, ended) = (Arc::clone(&reads), Arc::clone(&over));
    std::thread::spawn(move || {
        let _ = std::io::stdin().read_line(&mut String::new());
        reading.store(true, Ordering::Relaxed);
        let _ = std::io::stdin().read_line(&mut String::new());
        ended.store(true, Ordering::Relaxed);
    });
    let tell = |what: What| {
        let line = Line { t_s: clock::now().seconds_since(begun), what };
        let recording = Recording { lines: vec![line], ..Recording::default() };
        eprintln!("{}", recording.text().lines().last().unwrap());
    };
    let mut device: Option<TTYPort> = None;
    while !over.load(Ordering::Relaxed) {
        let from_host = read(&mut line).unwrap_or_default();
        if device.is_none() && (!from_host.is_empty() || reads.load(Ordering::Relaxed)) {
            let open = serialport::new(bar.as_str(), 115_200).timeout(Duration::from_millis(1)).open_native();
            device = open.ok();
        }
        let Some(opened) = &mut device else {
            clock::sleep(0.001);
            continue;
        };
        if !from_host.is_empty() {
            opened.write_all(&from_host).unwrap();
            tell(What::Host(from_host));
        }
        match read(opened) {
            Some(bytes) if bytes.is_empty() => {}
            Some(bytes) => {
                // Bytes that are not read are lost, as on a real line.
                let _ = line.write_all(&bytes);
                tell(What::Bar(bytes));
            }
            None => {
                tell(What::Unplugged);
                device = None;
                drop(plug);
                while !Path::new(bar).exists() {
                    clock::sleep(0.01);
                }
                // The new one is made before the old one goes: it has another name then.
                (line, plug) = terminal(tap);
            }
        }
    }
}

/// Cuts off what came while the run ended, which nobody read (`raw` is what was), and has a line of its own
/// begin where the stream does.
fn keep(recording: &mut Recording, raw: &[u8]) {
    let said = |line: &Line| if let What::Bar(bytes) = &line.what { bytes.clone() } else { Vec::new() };
    let all: Vec<u8> = recording.lines.iter().flat_map(said).collect();
    let from = all.windows(raw.len()).rposition(|part| part == raw).expect("what was read was sent");
    recording.stream = raw.len();
    let mut at = 0;
    let mut kept = Vec::new();
    for Line { t_s, what } in recording.lines.drain(..) {
        if at == from + raw.len() {
            break;
        }
        match what {
            What::Bar(mut bytes) => {
                bytes.truncate(from + raw.len() - at);
                let stream = bytes.split_off(from.saturating_sub(at).min(bytes.len()));
                at += bytes.len() + stream.len();
                let lines = [bytes, stream].into_iter().filter(|bytes| !bytes.is_empty());
                kept.extend(lines.map(|bytes| Line { t_s, what: What::Bar(bytes) }));
            }
            what => kept.push(Line { t_s, what }),
        }
    }
    recording.lines = kept;
}
