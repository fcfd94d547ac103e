//! A failure to write to stdout is an error, and control characters never reach the terminal.
#![cfg(unix)]

use std::fs::File;

use dbbd_job::recording::capture::{CaptureRecord, CaptureWriter, RunEnd, RunEvent};
use dbbd_model::base::units::HostNs;
use serde_json::Value;

use crate::cell::{codes, dbbd, stderr};
use crate::process;

const UNWRITABLE: &str = "E0102";

/// Each way to print something on stdout.
const PRINTS: [&[&str]; 7] = [
    &["robots", "list"],
    &["explain", "E0101", "--json"],
    &["protocols", "--json"],
    &["completions", "bash"],
    &["man"],
    &["--help"],
    &["--version"],
];

#[test]
fn full_stdout_is_an_error() {
    for args in PRINTS {
        let full = File::options().write(true).open("/dev/full").unwrap();
        let output = process::dbbd(args).stdout(full).output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{args:?}: {}", stderr(&output));
        // The parser of the command line prints the help.
        if !args[0].starts_with("--") {
            assert_eq!(codes(&output), [UNWRITABLE], "{args:?}");
        }
    }
}

#[test]
fn closed_pipe_is_not_an_error() {
    for args in PRINTS {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let output = process::dbbd(args).stdout(writer).output().unwrap();
        assert_eq!((output.status.code(), stderr(&output)), (Some(0), String::new()), "{args:?}");
    }
}

#[test]
fn control_characters_are_escaped() {
    const HOSTILE: &str = "\u{1b}]0;title\u{7}\u{9b}2J\u{202e}\r\ndamages      none";
    let dir = tempfile::tempdir().unwrap();
    let mut writer = CaptureWriter::create(&dir.path().join("run")).unwrap();
    let mut write = |record| writer.write(HostNs(1), &record).unwrap();
    write(CaptureRecord::Attachment { name: HOSTILE.into(), content: vec![1] });
    write(CaptureRecord::Event(RunEvent::Mark { text: HOSTILE.into() }));
    write(CaptureRecord::Event(RunEvent::Ended(RunEnd { reason: HOSTILE.into(), samples: 0, lost: 0 })));
    let steers = |c: char| c.is_control() && c != '\n' || c == '\u{202e}';
    let lines = dbbd(dir.path(), &["info", "run"]);
    let text = String::from_utf8(lines.stdout.clone()).unwrap();
    assert!(!text.contains(steers), "{text:?}");
    assert_eq!(text.lines().filter(|line| line.starts_with("damages")).count(), 1, "{text}");
    let json = String::from_utf8(dbbd(dir.path(), &["info", "run", "--json"]).stdout).unwrap();
    assert!(!json.contains(steers), "{json:?}");
    let info: Value = serde_json::from_str(&json).unwrap();
    assert_eq!(info["remarks"][0], HOSTILE);
    let wrong = dbbd(dir.path(), &["info", "\u{1b}[2Jrun"]);
    assert!(wrong.status.code() == Some(1) && !stderr(&wrong).contains(steers), "{}", stderr(&wrong));
}
