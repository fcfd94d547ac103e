//! `dbbd simulate` and the commands that run it refuse what they cannot run, with a code.
#![cfg(unix)]

use std::io::Write;
use std::net::{Shutdown, TcpListener};
use std::path::Path;

use tempfile::tempdir;

use crate::cell::{codes, dbbd, stderr};
use crate::process::Simulator;
use crate::support::circle_plan::plan;

/// Options that `simulate` refuses, with the code.
const CASES: &[(&[&str], &str)] = &[
    (&["--halt=-1"], "E1601"),
    (&["--override", "0.5"], "E1601"),
    (&["--speed=-1"], "E1601"),
    (&["--fault", "drop=much"], "E1601"),
    (&["--fault", "drop=2"], "E1601"),
    (&["--fault", "dorp=0.1"], "E1601"),
    (&["--world", "world.toml"], "E0130"),
    (&["--link", "directory"], "E1604"),
];

/// Options of the bar with the code with which the simulator ends: the ball is always out of the stroke.
const READ: &[(&[&str], &str)] = &[(&[], "W1607"), (&["--fault", "over_mm=1000000"], "E0312")];

/// A program without motion, and the files that the cases name.
fn cell(dir: &Path) {
    let source = "DEF T ( )\nPTP {A1 0.0,A2 -90.0,A3 90.0,A4 0.0,A5 45.0,A6 0.0}\nDBBSTB=TRUE\nWAIT SEC 0.5\n\
                  DBBSTB=FALSE\nEND\n";
    let data = "DEFDAT T\nSIGNAL DBBSTB $OUT[1]\nDECL INT DBBBALL=1\nDECL FRAME DBBCEN={X 0.0,Y 0.0,Z 0.0,A 0.0,B 0.0,C 0.0}\n\
                DECL REAL DBBLEN=300.0\nDECL REAL DBBLOW=-1.0\nDECL REAL DBBHIGH=1.0\nENDDAT\n";
    std::fs::write(dir.join("T.src"), source).unwrap();
    std::fs::write(dir.join("T.dat"), data).unwrap();
    std::fs::write(dir.join("world.toml"), "[bar]\nlength_mm = -1.0\n").unwrap();
    std::fs::create_dir(dir.join("directory")).unwrap();
}

#[test]
fn options_are_refused_with_their_code() {
    let dir = tempdir().unwrap();
    cell(dir.path());
    for (options, code) in CASES {
        let output = dbbd(dir.path(), &[&["simulate", "--program", "T.src"], *options].concat());
        assert_eq!(output.status.code(), Some(1), "{options:?}: {}", stderr(&output));
        assert_eq!(codes(&output), [*code], "{options:?}: {}", stderr(&output));
    }
    let output = dbbd(dir.path(), &["simulate", "--program", "NOWHERE.src"]);
    assert_eq!(codes(&output), ["E0806"]);
}

#[test]
fn unresponsive_server_is_reported() {
    let address = {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        listener.local_addr().unwrap()
    };
    assert_eq!(dbbd_job::sim::ekrl::EkrlClient::connect(address).unwrap_err().code().as_str(), "E1606");
    for answer in ["", "<Nack/>", "<Ack Id=\"x\"/>"] {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let mut client = dbbd_job::sim::ekrl::EkrlClient::connect(listener.local_addr().unwrap()).unwrap();
        let (mut stream, _) = listener.accept().unwrap();
        stream.write_all(answer.as_bytes()).unwrap();
        stream.shutdown(Shutdown::Write).unwrap();
        assert_eq!(client.exchange("<Dbb/>").unwrap_err().code().as_str(), "E1606", "{answer}");
    }
}

#[test]
fn impossible_readings_are_refused_and_strange_ones_warned_of() {
    for (options, code) in READ {
        let dir = tempdir().unwrap();
        cell(dir.path());
        let fixed = ["--program", "T.src", "--speed", "0"];
        let simulator = Simulator::start(dir.path(), &[&fixed[..], options].concat());
        let args = ["acquire", "--port", &simulator.port, "--out", "run", "--duration", "2", "--gone", "1"];
        dbbd(dir.path(), &args);
        let output = simulator.finished();
        assert_eq!(codes(&output), [*code], "{}", stderr(&output));
    }
}

#[test]
fn failed_step_is_reported() {
    let dir = tempdir().unwrap();
    let mut plan = plan(1, 3);
    plan.header.moves.iter_mut().for_each(|time| time.turn_deg_s = 0.0);
    let (csv, json) = plan.to_files().unwrap();
    std::fs::write(dir.path().join("plan.csv"), csv).unwrap();
    std::fs::write(dir.path().join("plan.json"), json).unwrap();
    let output = dbbd(dir.path(), &["acquire", "--port", "sim", "--plan", "plan.csv", "--out", "run"]);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert_eq!(codes(&output), ["E0820", "E1608"], "{}", stderr(&output));
}
