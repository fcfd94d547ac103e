//! A capture that is removed while it is recorded: detected within a second, and recording continues.
#![cfg(unix)]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Output};

use dbbd_device::clock;
use dbbd_job::recording::capture::{self, Capture};
use serde_json::Value;

use crate::cell::{codes, stderr};
use crate::played_bar::{endless, play, wait_for};
use crate::process::{dbbd, run, signal};

const TAKEN_AWAY: &str = "W0415";

struct Recording {
    dir: tempfile::TempDir,
    child: Child,
}

impl Recording {
    fn begin() -> Self {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir(dir.path().join("runs")).unwrap();
        let (port, _bar) = play(1.0, endless());
        let out = dir.path().join("runs/run.dbbd");
        let child = dbbd(&["acquire", "--json", "--port", &port, "--out", out.to_str().unwrap()]);
        let recording = Self { dir, child: { child }.spawn().unwrap() };
        wait_for(&out, 40_000);
        recording
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    /// Waits until the file exists, and stops; `damages` of the new file are reported.
    fn end(self, new: &str, damages: usize) -> (Output, PathBuf, tempfile::TempDir) {
        let new = self.path(new);
        let begun = clock::now();
        while !new.exists() && clock::now().seconds_since(begun) < 5.0 {
            clock::sleep(0.01);
        }
        let noticed_s = clock::now().seconds_since(begun);
        assert!(noticed_s < 1.2, "noticed after {noticed_s} s");
        clock::sleep(0.3);
        signal(&self.child, "INT");
        let output = self.child.wait_with_output().unwrap();
        let mut expected = vec![TAKEN_AWAY.to_owned()];
        expected.extend(std::iter::repeat_n("W0410".to_owned(), damages));
        assert_eq!((output.status.code(), codes(&output)), (Some(3), expected));
        let summary: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(summary["capture"].as_str(), new.to_str(), "{}", stderr(&output));
        assert_eq!(summary["findings"][0]["code"], TAKEN_AWAY);
        (output, new, self.dir)
    }
}

fn read(path: &Path) -> Capture {
    capture::read_capture(&fs::read(path).unwrap())
}

/// Checks that all sent samples are there in order, with the attachments.
fn is_whole(path: &Path) {
    let capture = read(path);
    assert!(capture.ended() && capture.damages.is_empty(), "{:?}", capture.damages);
    assert!(capture.attachment("protocol.toml").is_some());
    let samples: Vec<_> = capture.samples().map(|(_, sample)| sample.sequence.unwrap()).collect();
    assert!(samples.len() > 500 && samples.iter().copied().eq(0..samples.len() as u32), "{}", samples.len());
    assert_eq!(run(&["info", path.to_str().unwrap()]).status.code(), Some(0));
}

#[test]
fn removed_capture_is_rewritten() {
    let recording = Recording::begin();
    fs::remove_file(recording.path("runs/run.dbbd")).unwrap();
    let (_, new, _dir) = recording.end("runs/run.dbbd", 0);
    is_whole(&new);
}

#[test]
fn renamed_capture_continues_in_a_new_file() {
    let recording = Recording::begin();
    fs::rename(recording.path("runs/run.dbbd"), recording.path("runs/old.dbbd")).unwrap();
    let (_, new, dir) = recording.end("runs/run.dbbd", 0);
    is_whole(&new);
    let old = read(&dir.path().join("runs/old.dbbd"));
    assert!(old.records.len() > 10 && read(&new).records.starts_with(&old.records));
}

#[test]
fn replaced_capture_is_not_overwritten() {
    let recording = Recording::begin();
    fs::write(recording.path("other"), "mine").unwrap();
    fs::rename(recording.path("other"), recording.path("runs/run.dbbd")).unwrap();
    let (_, new, dir) = recording.end("runs/run-2.dbbd", 0);
    is_whole(&new);
    assert_eq!(fs::read(dir.path().join("runs/run.dbbd")).unwrap(), b"mine");
}

#[test]
fn missing_directory_is_recreated() {
    let recording = Recording::begin();
    fs::remove_dir_all(recording.path("runs")).unwrap();
    let (_, new, _dir) = recording.end("runs/run.dbbd", 0);
    is_whole(&new);
}

/// The truncated part is lost, and the new file reports how much.
#[test]
fn truncated_capture_continues_in_a_new_file() {
    for left in [0, 20_000] {
        let recording = Recording::begin();
        let cut = fs::OpenOptions::new().write(true).open(recording.path("runs/run.dbbd")).unwrap();
        cut.set_len(left).unwrap();
        let (_, new, dir) = recording.end("runs/run-2.dbbd", 2);
        let capture = read(&new);
        assert!(capture.ended() && capture.attachment("protocol.toml").is_some());
        assert_eq!(capture.damages.len(), 1, "{:?}", capture.damages);
        assert!(capture.samples().count() > 100);
        for file in ["runs/run.dbbd", "runs/run-2.dbbd"] {
            let info = run(&["info", dir.path().join(file).to_str().unwrap()]);
            assert_eq!(info.status.code(), Some(3), "{file}: {}", stderr(&info));
            assert!(codes(&info).iter().any(|code| code == "W0410"), "{file}: {}", stderr(&info));
        }
    }
}

#[test]
fn other_users_cannot_read_a_capture() {
    use std::os::unix::fs::PermissionsExt;
    let dir = tempfile::tempdir().unwrap();
    capture::CaptureWriter::create(&dir.path().join("run")).unwrap();
    let mode = fs::metadata(dir.path().join("run")).unwrap().permissions().mode();
    assert_eq!(mode & 0o007, 0, "{mode:o}");
}

/// Another program writes into the capture: the damage is reported when the run ends.
#[test]
fn overwritten_capture_is_a_loss() {
    use std::io::{Seek as _, SeekFrom, Write as _};
    let recording = Recording::begin();
    let path = recording.path("runs/run.dbbd");
    let mut file = fs::OpenOptions::new().write(true).open(&path).unwrap();
    file.seek(SeekFrom::Start(20_000)).unwrap();
    file.write_all(&[0x55; 300]).unwrap();
    signal(&recording.child, "INT");
    let output = recording.child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    assert!(codes(&output).contains(&"W0410".to_owned()), "{}", stderr(&output));
}
