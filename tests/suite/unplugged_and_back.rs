//! The bar is unplugged at random moments and returns under another name, or its network is cut: the run
//! continues soon,
//! each gap is recorded once with its length, and every byte is in a sample or a fault.
//!
//! The sessions run concurrently in real time, each with a line of its own.
#![cfg(unix)]

use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::Duration;

use dbbd::daemon::{Acquisition, AcquisitionOptions, ControllerConnections};
use dbbd_device::clock;
use dbbd_device::port::PortAddress;
use dbbd_device::protocol::ProtocolDefinition;
use dbbd_job::recording::capture::{self, CaptureRecord, RunEvent};
use dbbd_job::sim::bar::TerminalLink;
use dbbd_model::base::units::{DeviceTicks, HostNs};
use dbbd_model::measurement::sample::Sample;
use dbbd_model::provenance::Identity;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serialport::{SerialPort, TTYPort};

use crate::virtual_bar::simulate;

/// Limit for continuing the run after the port returned, s.
const BACK_S: f64 = 3.0;
/// Limit for detecting that the port is gone, s.
const NOTICED_S: f64 = 1.0;

/// Intervals without the port, s of host time.
#[derive(Clone, Copy)]
struct Away {
    from_s: f64,
    to_s: f64,
}

fn seconds(host: HostNs) -> f64 {
    host.seconds_since(HostNs(0))
}

/// Duration of a session, and longest time that a bar stays plugged in, s.
#[derive(Clone, Copy)]
struct Length {
    lasting_s: f64,
    longest_s: f64,
}

/// A bar that is repeatedly plugged in for 0.2 s to the longest time and away for 0.05 s to 5/8 of it; returns
/// when it was
/// away.
fn bar(link: &Path, length: Length, seed: u64, ready: &AtomicBool) -> Vec<Away> {
    let mut dice = Pcg64::seed_from_u64(seed);
    let encoder = ProtocolDefinition::by_name("dbb-cobs-1").unwrap().unwrap().encoder();
    let begin = clock::now();
    let mut away: Vec<Away> = Vec::new();
    let (mut sequence, mut left_s) = (0u32, None);
    while clock::now().seconds_since(begin) < length.lasting_s {
        let (mut line, host) = TTYPort::pair().unwrap();
        let name = host.name().unwrap();
        drop(host);
        line.set_timeout(Duration::from_millis(20)).unwrap();
        let plug = TerminalLink::new(link, &name).unwrap();
        let plugged = clock::now();
        if let Some(from_s) = left_s {
            away.push(Away { from_s, to_s: seconds(plugged) });
        }
        // The first time the host must find it.
        let stays_s = if left_s.is_none() { 1.0 } else { dice.random_range(0.2..length.longest_s) };
        ready.store(true, Ordering::Relaxed);
        let (mut running, mut heard) = (false, Vec::new());
        while clock::now().seconds_since(plugged) < stays_s {
            let mut buffer = [0; 64];
            match line.read(&mut buffer) {
                Ok(count) => heard.extend_from_slice(&buffer[..count]),
                // Not opened yet: reading fails at once.
                Err(error) if error.kind() != std::io::ErrorKind::TimedOut => clock::sleep(0.02),
                Err(_) => {}
            }
            for command in heard.split(|byte| *byte == 0) {
                match command {
                    [2, 0x53] => running = true,
                    [2, 0x58] => running = false,
                    _ => {}
                }
            }
            heard.clear();
            if running {
                let sample = Sample {
                    sequence: Some(sequence % 65536),
                    ticks: Some(DeviceTicks(clock::now().0 / 1000 % (1 << 32))),
                    trigger: Some(false),
                    temperature_c: Some(20.0),
                    status: 1,
                    ..Sample::of(f64::from(sequence % 1000) / 1000.0)
                };
                let mut frame = Vec::new();
                encoder.encode(&sample, &mut frame).unwrap();
                // Unread bytes are lost, as on a line.
                let _ = line.write_all(&frame);
                sequence += 1;
            }
        }
        left_s = Some(seconds(clock::now()));
        drop(plug);
        drop(line);
        clock::sleep(dice.random_range(0.05..0.625 * length.longest_s));
    }
    away
}

/// Transport of a session.
#[derive(Clone, Copy, PartialEq)]
enum Wire {
    /// A pseudo-terminal under a link.
    Pty,
    /// A serial server, named by its scheme, behind a network that is cut.
    Network(&'static str),
}

/// Passes bytes between a host and a serial server until the network is cut, at the same intervals as a bar.
/// Returns the
/// times of the cuts.
fn network(own: u16, server: u16, length: Length, seed: u64, ready: &AtomicBool) -> Vec<Away> {
    let mut dice = Pcg64::seed_from_u64(seed);
    let begin = clock::now();
    let mut away: Vec<Away> = Vec::new();
    let mut left_s = None;
    while clock::now().seconds_since(begin) < length.lasting_s {
        let listener = TcpListener::bind(("127.0.0.1", own)).unwrap();
        listener.set_nonblocking(true).unwrap();
        let whole = clock::now();
        away.extend(left_s.map(|from_s| Away { from_s, to_s: seconds(whole) }));
        // The first time the host must find it.
        let stays_s = if left_s.is_none() { 1.0 } else { dice.random_range(0.2..length.longest_s) };
        ready.store(true, Ordering::Relaxed);
        let mut ends: Option<[TcpStream; 2]> = None;
        while clock::now().seconds_since(whole) < stays_s {
            if let Ok((host, _)) = listener.accept() {
                let server = TcpStream::connect(("127.0.0.1", server)).unwrap();
                let both = [host, server];
                both.iter().for_each(|end| end.set_nonblocking(true).unwrap());
                ends = Some(both);
            }
            let Some([host, server]) = &mut ends else {
                clock::sleep(0.005);
                continue;
            };
            if !(pass(host, server) && pass(server, host)) {
                ends = None;
            }
            clock::sleep(0.001);
        }
        left_s = Some(seconds(clock::now()));
        drop((ends, listener));
        clock::sleep(dice.random_range(0.05..0.625 * length.longest_s));
    }
    away
}

/// A port that nobody is given while the network is cut: below those from which the system chooses, and another one at
/// each call, since campaigns run beside each other.
fn port_that_stays_free() -> u16 {
    static CALLS: AtomicU32 = AtomicU32::new(0);
    let is_free = |port: &u16| TcpListener::bind(("127.0.0.1", *port)).is_ok();
    let next = || {
        let call = CALLS.fetch_add(1, Ordering::Relaxed);
        (12_000 + (64 * std::process::id() + call) % 20_000) as u16
    };
    std::iter::repeat_with(next).find(is_free).unwrap()
}

/// Passes received bytes on; `false` if an end disappeared.
fn pass(from: &mut TcpStream, to: &mut TcpStream) -> bool {
    let mut room = [0; 4096];
    match from.read(&mut room) {
        Ok(0) => false,
        Ok(count) => to.write_all(&room[..count]).is_ok(),
        Err(error) => error.kind() == ErrorKind::WouldBlock,
    }
}

/// Results of a session, s.
#[derive(Debug, Default)]
struct Seen {
    unplugged: usize,
    gaps: usize,
    samples: u64,
    /// From the return of the port to that of the run.
    back_s: Vec<f64>,
    /// From the disappearance of the port to its detection.
    noticed_s: Vec<f64>,
}

fn session(directory: &Path, wire: Wire, length: Length, seed: u64) -> Seen {
    let directory = directory.join(seed.to_string());
    std::fs::create_dir(&directory).unwrap();
    let out: PathBuf = directory.join("run");
    let ready = Arc::new(AtomicBool::new(false));
    let plugged = Arc::clone(&ready);
    let (port, bar, _simulator) = match wire {
        Wire::Pty => {
            let link = directory.join("bar");
            let port = link.to_str().unwrap().to_owned();
            (port, std::thread::spawn(move || bar(&link, length, seed, &plugged)), None)
        }
        Wire::Network(scheme) => {
            let bar = simulate(&directory, "1", &["--listen", &format!("{scheme}://127.0.0.1:0")]);
            let server = bar.port.rsplit_once(':').unwrap().1.parse().unwrap();
            let own = port_that_stays_free();
            let cut = move || network(own, server, length, seed, &plugged);
            (format!("{scheme}://127.0.0.1:{own}"), std::thread::spawn(cut), Some(bar))
        }
    };
    let port: PortAddress = port.parse().unwrap();
    while !ready.load(Ordering::Relaxed) {
        assert!(!bar.is_finished(), "the bar did not begin");
        clock::sleep(0.01);
    }
    let options = AcquisitionOptions {
        port,
        definition: ProtocolDefinition::by_name("dbb-cobs-1").unwrap().unwrap(),
        out: out.clone(),
        plan: None,
        identity: Identity::default(),
        controller: ControllerConnections::default(),
        duration_s: None,
        gone_s: 1e9,
        sync_s: 1.0,
        feed: None,
    };
    let stop = Arc::new(AtomicBool::new(false));
    let acquisition = Acquisition::start(options, Arc::clone(&stop)).unwrap();
    let away = bar.join().unwrap();
    // The last absence has no end.
    stop.store(true, Ordering::Relaxed);
    let samples = acquisition.join().unwrap().progress.counts.samples;
    let capture = capture::read_capture(&std::fs::read(&out).unwrap());
    assert!(capture.ended() && capture.damages.is_empty());
    accounts_for_every_byte(&capture);
    let mut gaps: Vec<Away> = Vec::new();
    for stamped in &capture.records {
        if let CaptureRecord::Event(RunEvent::Gap { seconds: Some(lasted_s), reason, .. }) = &stamped.record {
            assert!(reason.contains("gone"), "{reason}");
            let to_s = seconds(stamped.host);
            gaps.push(Away { from_s: to_s - lasted_s, to_s });
        }
    }
    let last = gaps.pop().expect("the last leaving is recorded too");
    assert!(away.iter().all(|away| away.to_s < last.to_s));
    let mut seen = Seen { unplugged: away.len(), gaps: gaps.len(), samples, ..Seen::default() };
    let mut told = 0;
    for gap in &gaps {
        // A bar that disappears again before the run continued makes one gap.
        let within: Vec<&Away> =
            away.iter().filter(|away| away.from_s <= gap.to_s && away.to_s >= gap.from_s).collect();
        let (Some(first), Some(last)) = (within.first(), within.last()) else {
            panic!("seed {seed}: a gap of {:.3} s without a cause", gap.to_s - gap.from_s);
        };
        told += within.len();
        seen.noticed_s.push(gap.from_s - first.from_s);
        seen.back_s.push(gap.to_s - last.to_s);
    }
    let untold = away.iter().filter(|away| away.from_s > last.from_s).count();
    assert_eq!(told + untold, away.len(), "seed {seed}: each leaving belongs to one gap");
    seen
}

/// Bytes received = bytes in samples + in faults; nothing is pending at the end. A frame of the protocol has 18
/// bytes.
fn accounts_for_every_byte(capture: &capture::Capture) {
    let (mut received, mut explained) = (0, 0);
    for stamped in &capture.records {
        match &stamped.record {
            CaptureRecord::Raw(bytes) => received += bytes.len() as u64,
            CaptureRecord::Samples(samples) => explained += 18 * samples.len() as u64,
            CaptureRecord::Fault(json) => {
                let fault: serde_json::Value = serde_json::from_slice(json).unwrap();
                explained += fault["bytes"].as_u64().unwrap();
            }
            CaptureRecord::Attachment { .. } | CaptureRecord::Axes(_) | CaptureRecord::Event(_) => {}
        }
    }
    assert_eq!(received, explained);
}

/// Concurrent sessions; prints their results.
fn campaign(wire: Wire, sessions: u64, length: Length) {
    let directory = tempfile::tempdir().unwrap();
    let at = directory.path();
    let seen: Vec<Seen> = std::thread::scope(|scope| {
        let all: Vec<_> =
            (0..sessions).map(|seed| scope.spawn(move || session(at, wire, length, seed + 1))).collect();
        all.into_iter().map(|session| session.join().unwrap()).collect()
    });
    let sum = |of: fn(&Seen) -> u64| seen.iter().map(of).sum::<u64>();
    let sorted = |of: fn(&Seen) -> &Vec<f64>| {
        let mut all: Vec<f64> = seen.iter().flat_map(|seen| of(seen).iter().copied()).collect();
        all.sort_by(f64::total_cmp);
        all
    };
    let (back, noticed) = (sorted(|seen| &seen.back_s), sorted(|seen| &seen.noticed_s));
    let at = |sorted: &[f64], share: f64| sorted[(share * (sorted.len() - 1) as f64) as usize];
    eprintln!(
        "{sessions} sessions of {} s: {} times unplugged, {} gaps, {} samples; back after {:.2} s \
         (median), {:.2} s (99 %), {:.2} s (most); noticed after {:.3} s (median), {:.3} s (most)",
        length.lasting_s,
        sum(|seen| seen.unplugged as u64),
        sum(|seen| seen.gaps as u64),
        sum(|seen| seen.samples),
        at(&back, 0.5),
        at(&back, 0.99),
        at(&back, 1.0),
        at(&noticed, 0.5),
        at(&noticed, 1.0),
    );
    assert!(at(&back, 0.0) > 0.0 && at(&back, 1.0) <= BACK_S);
    assert!(at(&noticed, 0.0) >= 0.0 && at(&noticed, 1.0) <= NOTICED_S);
}

/// In a process of its own: a child of another test would inherit the other sides of the terminals and keep them
/// open.
#[test]
fn bar_is_unplugged_and_returns() {
    let output = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "unplugged_and_back::a_few_sessions", "--ignored", "--nocapture"])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success() && said.contains("times unplugged"), "{said}");
}

#[test]
#[ignore = "runs in a process of its own, started by bar_is_unplugged_and_returns"]
fn a_few_sessions() {
    campaign(Wire::Pty, 16, Length { lasting_s: 5.0, longest_s: 1.6 });
}

#[test]
fn network_fails_and_returns() {
    campaign(Wire::Network("tcp"), 2, Length { lasting_s: 5.0, longest_s: 1.6 });
    campaign(Wire::Network("rfc2217"), 2, Length { lasting_s: 5.0, longest_s: 1.6 });
}

/// cargo test --test suite two_hundred_cuts -- --ignored --nocapture
#[test]
#[ignore = "4 sessions of 200 s"]
fn two_hundred_cuts_of_tcp() {
    campaign(Wire::Network("tcp"), 4, Length { lasting_s: 200.0, longest_s: 4.0 });
}

#[test]
#[ignore = "4 sessions of 200 s"]
fn two_hundred_cuts_of_rfc2217() {
    campaign(Wire::Network("rfc2217"), 4, Length { lasting_s: 200.0, longest_s: 4.0 });
}

/// TMPDIR=/dev/shm cargo test --release --test suite ten_thousand_seconds -- --ignored --nocapture
#[test]
#[ignore = "64 sessions of 160 s"]
fn ten_thousand_seconds_of_unplugging() {
    campaign(Wire::Pty, 64, Length { lasting_s: 160.0, longest_s: 8.0 });
}
