//! `dbbd acquire` without a port, without a bar, or after the bar disappeared.
#![cfg(unix)]

use std::io::{Read, Write};
use std::net::TcpListener;
use std::path::Path;
use std::sync::Arc;

use dbbd::daemon;
use dbbd_device::clock;
use dbbd_device::protocol::ProtocolDefinition;
use dbbd_job::recording::capture::RunEvent;
use dbbd_job::sim::bar::Terminal;
use dbbd_model::provenance::Identity;
use rustix::pty::{self, OpenptFlags};

use crate::cell::{codes, stderr};
use crate::played_bar::{definition, endless, play, read, reading, wait_for};
use crate::process::{dbbd, run, signal};

const NO_PORT: &str = "E0201";
const PORT_BUSY: &str = "E0203";
const STOPPED_SENDING: &str = "W0225";
const PORT_REFUSED: &str = "E0204";
const PORT_GONE: &str = "E0206";
const STAYED_AWAY: &str = "W0220";
const OPEN_TO_ALL: &str = "I0211";

/// Arguments for a bar that never sends a byte, the exit code, and the codes.
const SILENT: &[(&[&str], i32, &[&str])] = &[
    (&["--protocol", "microepsilon-ild1420"], 1, &["E0205"]),
    (&["--duration", "0.3"], 3, &["W0221"]),
    (&["--duration", "0.3", "--ekrl", "127.0.0.1:0"], 3, &["W0221", "W0224"]),
];

#[test]
fn bar_that_falls_silent_is_reported() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("run");
    // After half a second it stops sending but stays plugged in.
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
    assert!(read(&path).events().any(|event| matches!(event, RunEvent::Gap { seconds: Some(_), .. })));
}

#[test]
fn silent_bar_is_reported() {
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

/// In this process: a child would inherit the other side of the terminal and keep it open.
#[test]
fn bar_that_disappears_ends_the_run() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("run");
    let terminal = Terminal::new().unwrap();
    let options = daemon::AcquisitionOptions {
        port: terminal.address().clone(),
        definition: definition(),
        out: path.clone(),
        plan: None,
        identity: Identity::default(),
        controller: daemon::ControllerConnections::default(),
        duration_s: None,
        gone_s: 0.3,
        feed: None,
        sync_s: 1.0,
    };
    let acquisition = daemon::Acquisition::start(options, Arc::default()).unwrap();
    drop(terminal);
    let summary = acquisition.join().unwrap();
    assert_eq!(summary.ending, daemon::EndReason::Gone);
    let capture = read(&path);
    assert!(capture.ended());
    assert!(
        capture
            .events()
            .any(|event| matches!(event, RunEvent::Gap { reason, .. } if reason.contains("gone")))
    );
}

/// In this process too: the line disappears while the bar is queried.
#[test]
fn port_that_disappears_during_a_command() {
    // A program that another test starts meanwhile must not hold the line open.
    let line = pty::openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    pty::grantpt(&line).unwrap();
    pty::unlockpt(&line).unwrap();
    // Another test may get the same terminal: this name is gone before it.
    let directory = tempfile::tempdir().unwrap();
    let link = directory.path().join("bar");
    let terminal = pty::ptsname(&line, Vec::new()).unwrap();
    std::os::unix::fs::symlink(terminal.to_str().unwrap(), &link).unwrap();
    let name = link.display().to_string();
    let pulled = std::thread::spawn(move || {
        std::fs::File::from(line).read_exact(&mut [0; 1]).unwrap();
        std::fs::remove_file(link).unwrap();
    });
    let definition = ProtocolDefinition::by_name("microepsilon-ild1420").unwrap().unwrap();
    let gone = daemon::zero_bar(&name.parse().unwrap(), &definition).unwrap_err();
    pulled.join().unwrap();
    assert_eq!(dbbd_model::diagnostic::Finding::code(&gone).as_str(), PORT_GONE, "{gone}");
}

/// The simulator holds the other side of the line exclusively.
#[test]
fn bar_that_stays_unplugged_is_reported() {
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
    // Another test may get the same terminal.
    std::fs::remove_file(path("bar")).unwrap();
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    assert!(codes(&output).contains(&STAYED_AWAY.to_owned()), "{}", stderr(&output));
}

#[test]
fn file_is_no_port_and_address_errors_are_reported() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("run");
    let out = path.to_str().unwrap();
    let refused = run(&["acquire", "--port", "/dev/null", "--out", out]);
    assert_eq!((refused.status.code(), codes(&refused)), (Some(1), vec![PORT_REFUSED.to_owned()]));
    let open = run(&["acquire", "--port", "/dev/ttyNONE7", "--ekrl", "0.0.0.0:0", "--out", out]);
    assert_eq!(codes(&open), [OPEN_TO_ALL, NO_PORT]);
}

#[test]
fn missing_port_is_reported_and_leaves_no_file() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("run");
    let output = run(&["acquire", "--port", "/dev/ttyNONE7", "--out", path.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(codes(&output), [NO_PORT]);
    assert!(!path.exists());
}

#[test]
fn occupied_port_is_reported() {
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

/// A bar without a clock never pauses; the recording process is stopped for 1.6 s. The computer is named, not the bar.
#[test]
fn computer_that_stands_still_is_no_silent_bar() {
    let directory = tempfile::tempdir().unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = format!("tcp://{}", listener.local_addr().unwrap());
    let out = directory.path().join("run");
    let child = dbbd(&[
        "acquire",
        "--port",
        &port,
        "--protocol",
        "touchdro",
        "--out",
        out.to_str().unwrap(),
        "--duration",
        "5",
        "--json",
    ])
    .spawn()
    .unwrap();
    let (mut line, _) = listener.accept().unwrap();
    let bar = std::thread::spawn(move || {
        for number in 0.. {
            clock::sleep(0.04);
            if line.write_all(format!("X{};", 100 + number % 7).as_bytes()).is_err() {
                return;
            }
        }
    });
    clock::sleep(2.0);
    signal(&child, "STOP");
    clock::sleep(1.6);
    signal(&child, "CONT");
    let output = child.wait_with_output().unwrap();
    bar.join().unwrap();
    let warnings: Vec<String> = codes(&output).into_iter().filter(|code| code.starts_with('W')).collect();
    assert_eq!((output.status.code(), warnings), (Some(3), vec!["W0226".to_owned()]));
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let stood_still_s = summary["progress"]["stood_still_s"].as_f64().unwrap();
    assert!((1.0..2.5).contains(&stood_still_s) && summary["progress"]["silent_s"] == 0.0, "{summary}");
}
