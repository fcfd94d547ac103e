//! A command that writes a set of files over an earlier one is killed at any moment: the next command that reads or writes there
//! finds the earlier set or the new one, never a mix.
#![cfg(target_os = "linux")]

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

use dbbd_device::clock;
use dbbd_model::base::hash::sha256;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::cell::{dbbd, stderr};
use crate::nothing_wrong_is_silent::{JOB, cell};
use crate::process::{delayed, delays};

/// The file that says which renames complete a set.
const COMMIT: &str = ".dbbd-set.json";
/// What a rename takes where kills are to hit between two of them, s.
const RENAME_S: f64 = 0.003;
/// Kills whose moment is that of a rename, of so many.
const AT_RENAMES: u64 = 3;

/// A command that writes a set into a directory, the inputs of two sets, and a command that reads the set.
struct Writer {
    args: &'static [&'static str],
    inputs: [&'static str; 2],
    /// Its files, without the directory, are named last.
    reads: &'static [&'static str],
    file: &'static str,
    /// Whether an earlier set is kept in a directory beside.
    keeps: bool,
}

const WRITERS: [Writer; 5] = [
    Writer {
        args: &["plan"],
        inputs: ["job.toml", "other.toml"],
        reads: &["krl", "--replace", "--out", "read"],
        file: "plan.csv",
        keeps: true,
    },
    Writer {
        args: &["plan", "--replace"],
        inputs: ["job.toml", "other.toml"],
        reads: &["info"],
        file: "plan.json",
        keeps: false,
    },
    Writer {
        args: &["krl", "--replace"],
        inputs: ["plan-0/plan.csv", "plan-1/plan.csv"],
        reads: &["info"],
        file: "DBB_MAIN.src",
        keeps: false,
    },
    Writer {
        args: &["identify", "--centres", "C.csv", "--folds", "0", "--robot", "kr60ha", "--tool", "30,20,10"],
        inputs: ["obs.csv", "other.csv"],
        reads: &["info"],
        file: "result.json",
        keeps: true,
    },
    Writer {
        args: &[
            "identify",
            "--replace",
            "--centres",
            "C.csv",
            "--folds",
            "0",
            "--robot",
            "kr60ha",
            "--tool",
            "30,20,10",
        ],
        inputs: ["obs.csv", "other.csv"],
        reads: &["info"],
        file: "robot-identified.toml",
        keeps: false,
    },
];

/// The files of a set by their hashes.
type Hashes = BTreeMap<String, String>;

fn hashes(directory: &Path) -> Hashes {
    let files =
        fs::read_dir(directory).into_iter().flatten().flatten().filter(|entry| entry.path().is_file());
    files
        .map(|entry| (entry.file_name().into_string().unwrap(), sha256(fs::read(entry.path()).unwrap())))
        .collect()
}

fn is_part(name: &str) -> bool {
    name.ends_with(".part")
}

/// What the kills met.
#[derive(Debug, Default)]
struct Tally {
    /// Kills after which the earlier or the new set was there.
    earlier: u32,
    new: u32,
    /// Those of them that were between two renames.
    between: u32,
}

/// The numbers of the directories of earlier sets that are there.
fn previous(directory: &Path) -> u32 {
    (1..).find(|number| !directory.join(format!("previous-{number}")).exists()).unwrap() - 1
}

/// Kills a command so many times, and checks the set after each of them.
fn kill(at: &Path, library: &str, writer: &Writer, count: u64, random: &mut Pcg64) -> Tally {
    let out = at.join("set");
    let command = |input: &str, out: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_dbbd"));
        command
            .args(&writer.args[..1])
            .arg(input)
            .args(&writer.args[1..])
            .args(["--out", out])
            .current_dir(at);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        command
    };
    let begun = clock::now();
    let wanted = writer.inputs.map(|input| {
        let _ = fs::remove_dir_all(at.join("whole"));
        assert!(matches!(command(input, "whole").status().unwrap().code(), Some(0 | 3)), "{input}");
        hashes(&at.join("whole"))
    });
    let takes_s = clock::now().seconds_since(begun) / 2.0;
    assert!(wanted[0].len() > 2 && wanted[0] != wanted[1]);
    let _ = fs::remove_dir_all(&out);
    let (mut before, mut tally) = (None, Tally::default());
    for number in 0..count {
        // Also the first set of a directory.
        if number % 5 == 4 {
            fs::remove_dir_all(&out).unwrap();
            before = None;
        }
        let next = before.map_or(0, |before: usize| 1 - before);
        let kept = previous(&out);
        let mut command = command(writer.inputs[next], "set");
        let is_at_rename = number % AT_RENAMES != 0;
        if is_at_rename {
            delayed(&mut command, library, "DBBD_TEST_RENAME_S", RENAME_S);
        }
        let mut child = command.spawn().unwrap();
        if is_at_rename {
            while !out.join(COMMIT).exists() && child.try_wait().unwrap().is_none() {
                clock::sleep(1e-4);
            }
            clock::sleep(random.random_range(0.0..RENAME_S * (1 + wanted[next].len()) as f64));
        } else {
            clock::sleep(random.random_range(0.0..1.1 * takes_s));
        }
        // Fails if it has just ended.
        let _ = child.kill();
        child.wait().unwrap();
        let was_between = out.join(COMMIT).exists();
        tally.between += u32::from(was_between);
        let file = format!("set/{}", writer.file);
        let read = dbbd(at, &[writer.reads, &[&file]].concat());
        let mut found = hashes(&out);
        let name = format!("{:?} {number}, before {before:?}, between {was_between}", writer.args);
        // What was written before the set was complete stays until somebody removes it; of a complete one nothing is left.
        let own_part = format!(".{}.", child.id());
        let is_left = |file: &String| is_part(file) && file.contains(&own_part) || file == COMMIT;
        assert!(!was_between || !found.keys().any(is_left), "{name}: {:?}", found.keys());
        found.retain(|name, _| !is_part(name));
        let is_there = wanted.iter().position(|set| *set == found);
        assert!(
            is_there == Some(next)
                || is_there == before && !was_between && (before.is_some() || found.is_empty()),
            "{name}: {:?}\n{}",
            found.keys(),
            stderr(&read)
        );
        let is_read = matches!(read.status.code(), Some(0 | 3));
        assert_eq!(is_read, is_there.is_some(), "{name}: {}", stderr(&read));
        if is_there == Some(next) {
            tally.new += 1;
            // The earlier set is kept as a whole.
            if let Some(before) = before.filter(|_| writer.keeps) {
                assert_eq!(previous(&out), kept + 1, "{name}");
                assert!(
                    hashes(&out.join(format!("previous-{}", kept + 1))) == wanted[before],
                    "{name}: what was kept"
                );
            }
        } else {
            tally.earlier += 1;
            assert_eq!(previous(&out), kept, "{name}");
        }
        before = is_there;
    }
    tally
}

/// Kills each command so many times.
fn kills(count: u64) {
    let (dir, data) = cell();
    let at = dir.path();
    let library = delays(at);
    fs::write(at.join("other.toml"), JOB.replace("points = 3", "points = 4")).unwrap();
    let mut other = data;
    other.rows.iter_mut().for_each(|row| row.length_mm += 0.001);
    fs::write(at.join("other.csv"), other.to_csv()).unwrap();
    for (number, job) in ["job.toml", "other.toml"].into_iter().enumerate() {
        assert!(matches!(
            dbbd(at, &["plan", job, "--out", &format!("plan-{number}")]).status.code(),
            Some(0 | 3)
        ));
    }
    let mut random = Pcg64::seed_from_u64(1);
    let mut between = 0;
    for writer in &WRITERS {
        let tally = kill(at, &library, writer, count, &mut random);
        between += tally.between;
        eprintln!("{count} kills of {}: {tally:?}", writer.args[..writer.args.len().min(2)].join(" "));
    }
    assert!(between >= count as u32, "{between} kills between two renames");
}

/// A short sample of [`kills_campaign`].
#[test]
fn a_killed_command_leaves_one_set() {
    kills(6);
}

#[test]
#[ignore = "a campaign of a minute"]
fn kills_campaign() {
    kills(100);
}
