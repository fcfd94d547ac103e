//! Missing, repeated and changed records of a capture are reported by every command that reads it.

use std::path::{Path, PathBuf};
use std::process::Output;

use dbbd_device::clock;
use dbbd_job::recording::capture::{self, CaptureRecord, CaptureWriter, RunEvent};
use dbbd_model::base::units::HostNs;
use serde_json::Value;

use crate::cell::{codes, dbbd, stderr};

const DAMAGED: &str = "W0410";

/// Commands that read a run with its plan.
const VERBS: [&[&str]; 5] = [
    &["info"],
    &["recover", "--out", "recovered"],
    &["sync", "--out", "sync.csv"],
    &["identify", "--out", "identify"],
    &["circle", "--out", "circle"],
];

fn stored() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/captures/run.dbbd")
}

/// The stored run with numbered records, and the ends of its header and records.
fn run(dir: &Path) -> (Vec<u8>, Vec<usize>) {
    let stored = stored();
    let output = dbbd(dir, &["recover", stored.to_str().unwrap(), "--out", "whole"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let bytes = std::fs::read(dir.join("whole")).unwrap();
    let ends = ends(&bytes);
    (bytes, ends)
}

/// As in docs/reference/capture.md.
fn ends(bytes: &[u8]) -> Vec<usize> {
    let mut ends = vec![16];
    while let Some(end) = ends.last().copied().filter(|end| *end < bytes.len()) {
        let length: [u8; 4] = bytes[end + 5..end + 9].try_into().unwrap();
        ends.push(end + 17 + u32::from_le_bytes(length) as usize + 4);
    }
    ends
}

fn each_verb(dir: &Path, run: &str, mut check: impl FnMut(&str, &Output)) {
    for verb in VERBS {
        let output = dbbd(dir, &[&verb[..1], &[run], &verb[1..]].concat());
        check(verb[0], &output);
        for left in ["recovered", "sync.csv"] {
            let _ = std::fs::remove_file(dir.join(left));
        }
    }
}

fn has_a_warning(dir: &Path, run: &str, bytes: &[u8]) {
    std::fs::write(dir.join(run), bytes).unwrap();
    each_verb(dir, run, |verb, output| {
        assert_eq!(output.status.code(), Some(3), "{run} {verb}: {}", stderr(output));
        assert!(codes(output).iter().any(|code| code == DAMAGED), "{run} {verb}: {}", stderr(output));
    });
}

#[test]
fn missing_and_repeated_records_are_reported() {
    let dir = tempfile::tempdir().unwrap();
    let (bytes, ends) = run(dir.path());
    let middle = ends.len() / 2;
    let without = |from: usize, to: usize| [&bytes[..ends[from]], &bytes[ends[to]..]].concat();
    has_a_warning(dir.path(), "one-less", &without(middle, middle + 1));
    has_a_warning(dir.path(), "many-less", &without(middle, middle + ends.len() / 20));
    has_a_warning(dir.path(), "twice", &[&bytes[..ends[middle]], &bytes[ends[middle - 9]..]].concat());
    has_a_warning(dir.path(), "no-header", &bytes[16..]);
    let info = dbbd(dir.path(), &["info", "many-less", "--json"]);
    let info: Value = serde_json::from_slice(&info.stdout).unwrap();
    let missing = &info["findings"][0]["values"]["records"];
    assert_eq!(missing.as_u64(), Some(ends.len() as u64 / 20), "{info:#}");
    assert_eq!(info["damages"][0]["offset"].as_u64(), Some(ends[middle] as u64));
    // A repeated record is read once.
    let twice = capture::read_capture(&std::fs::read(dir.path().join("twice")).unwrap());
    assert_eq!(twice.records, capture::read_capture(&bytes).records);
}

/// Captures of version 2 have no record numbers; their end has the number of samples.
#[test]
fn old_capture_is_compared_with_its_own_count() {
    let dir = tempfile::tempdir().unwrap();
    let bytes = std::fs::read(stored()).unwrap();
    let ends = ends(&bytes);
    let is_samples = |at: &usize| bytes[ends[*at] + 4] == 6;
    let at = (ends.len() / 2..).find(is_samples).unwrap();
    has_a_warning(dir.path(), "old", &[&bytes[..ends[at]], &bytes[ends[at + 1]..]].concat());
}

#[test]
fn flipped_header_bit_loses_only_the_header() {
    let dir = tempfile::tempdir().unwrap();
    let (mut bytes, _) = run(dir.path());
    let records = capture::read_capture(&bytes).records.len();
    for byte in 0..16 {
        bytes[byte] ^= 4;
        let capture = capture::read_capture(&bytes);
        assert_eq!((capture.records.len(), capture.damages.len()), (records, 1), "byte {byte}");
        if byte % 5 == 0 {
            has_a_warning(dir.path(), &format!("flipped-{byte}"), &bytes);
        }
        bytes[byte] ^= 4;
    }
}

/// As many heads of long records as there is room for, none of which is a record.
#[test]
fn forged_record_heads_are_skipped_in_linear_time() {
    let dir = tempfile::tempdir().unwrap();
    let (bytes, ends) = run(dir.path());
    let (before, after) = bytes.split_at(ends[ends.len() - 3]);
    let head = [&[0xdb, 0xbd, 0x5a, 0xa5, 2][..], &500_000_u32.to_le_bytes()].concat();
    let hostile = [before, &head.repeat(150_000), after].concat();
    std::fs::write(dir.path().join("hostile"), &hostile).unwrap();
    let begun = clock::now();
    let info = dbbd(dir.path(), &["info", "hostile", "--json"]);
    let took_s = clock::now().seconds_since(begun);
    assert_eq!(info.status.code(), Some(3), "{}", stderr(&info));
    // Checking each to its end would take minutes.
    assert!(took_s < 15.0, "{took_s} s");
    assert_eq!(capture::read_capture(&hostile).records, capture::read_capture(&bytes).records);
}

#[test]
fn gaps_of_any_size_are_counted() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = CaptureWriter::create(&dir.path().join("run")).unwrap();
    for _ in 0..2 {
        let gap = RunEvent::Gap { seconds: None, missing: Some(u64::MAX), reason: String::new() };
        writer.write(HostNs(1), &CaptureRecord::Event(gap)).unwrap();
    }
    writer.finish(HostNs(2), "done", 0).unwrap();
    let info = dbbd(dir.path(), &["info", "run", "--json"]);
    let info: Value = serde_json::from_slice(&info.stdout).unwrap();
    assert_eq!((info["gaps"].as_u64(), info["missing"].as_u64()), (Some(2), Some(u64::MAX)));
}

/// Concurrent identifications into one directory: the remaining files belong to one of them.
#[test]
fn sets_of_results_are_not_mixed() {
    use std::process::{Command, Stdio};
    let dir = tempfile::tempdir().unwrap();
    let stored = stored();
    let identify = |tool: &str, out: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_dbbd"));
        command.args([
            "identify",
            stored.to_str().unwrap(),
            "--tool",
            tool,
            "--folds",
            "0",
            "--estimate",
            "tool",
            "--out",
            out,
        ]);
        command.current_dir(dir.path()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
    };
    let tools = ["30,20,10", "31,20,10", "32,20,10"];
    let files = ["result.json", "parameters.csv", "robot-identified.toml", "lengths.csv", "covariance.csv"];
    let read = |out: &str| files.map(|file| std::fs::read(dir.path().join(out).join(file)).unwrap());
    for tool in tools {
        identify(tool, tool).wait().unwrap();
    }
    let alone = tools.map(read);
    let mut together = tools.map(|tool| identify(tool, "together"));
    for child in &mut together {
        child.wait().unwrap();
    }
    assert!(alone.contains(&read("together")));
    let left = std::fs::read_dir(dir.path().join("together")).unwrap();
    let names = left.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    assert_eq!(names.filter(|name| name.ends_with(".part")).count(), 0);
}
