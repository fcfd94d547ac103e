//! `dbbd compensate` changes only the numbers of points.

use std::fs;
use std::path::PathBuf;

use dbbd_job::sim::truth;
use dbbd_model::robot::Robot;

use crate::cell::{codes, dbbd, kr60, stderr};

fn fixture(name: &str) -> String {
    let path: PathBuf = [env!("CARGO_MANIFEST_DIR"), "fixtures/krl", name].iter().collect();
    fs::read_to_string(path).unwrap()
}

/// A robot drawn from the tolerance as an identified one. Its ball is not a tool of the program.
fn identified(seed: u64) -> Robot {
    let mut robot = truth::draw_true_robot(&kr60(), seed, 1.0);
    robot.nominal = Some(Box::new(kr60()));
    robot
}

/// A line with the numbers of X, Y, Z, A..C and A1..A6 replaced by a mark.
fn masked(line: &[u8]) -> String {
    let line: String = line.iter().copied().map(char::from).collect();
    let mut out = String::new();
    let mut rest = line.as_str();
    while let Some(at) = rest.find(|c: char| "{,".contains(c)) {
        let (head, tail) = rest.split_at(at + 1);
        out.push_str(head);
        let tail_of_type = tail.strip_prefix("E6POS:").map_or(tail, |rest| {
            out.push_str("E6POS:");
            rest
        });
        let name = tail_of_type.trim_start().split(' ').next().unwrap();
        let value = tail_of_type.find(name).unwrap() + name.len();
        let point = ["X", "Y", "Z", "A", "B", "C", "A1", "A2", "A3", "A4", "A5", "A6"].contains(&name);
        if point && !name.is_empty() {
            out.push_str(&tail_of_type[..value]);
            let end = tail_of_type[value..].find([',', '}']).map_or(tail_of_type.len(), |end| value + end);
            out.push('#');
            rest = &tail_of_type[end..];
        } else {
            rest = tail_of_type;
        }
    }
    out + rest
}

#[test]
fn other_bytes_are_unchanged() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    // A comment in an old code page, another line end, no line end at the end of the file.
    let mut source = fixture("GLUE01.src").into_bytes();
    source.extend(b"; M\xfcller\t \n;\r\n; last");
    let data = fixture("GLUE01.dat").into_bytes();
    fs::write(path("GLUE01.src"), &source).unwrap();
    fs::write(path("glue01.DAT"), &data).unwrap();
    fs::write(path("config.dat"), fixture("config.dat")).unwrap();
    fs::write(path("id.toml"), identified(3).to_toml().unwrap()).unwrap();
    let run_to = |out: &str, extra: &[&str]| {
        let args = ["compensate", "--replace", "GLUE01.src", "--robot", "id.toml", "--out", out];
        dbbd(dir.path(), &[&args, extra].concat())
    };
    let run = |extra: &[&str]| run_to("new", extra);
    let output = run(&["--config", "config.dat"]);
    // 3: a relative motion was not corrected, which the user must see.
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    assert!(codes(&output).contains(&"W0905".into()), "{}", stderr(&output));
    let mut changed = 0;
    for (name, old) in [("GLUE01.src", &source), ("glue01.DAT", &data)] {
        let new = fs::read(dir.path().join("new").join(name)).unwrap();
        // The comments with the provenance are new.
        let made = |line: &&[u8]| line.starts_with(b"; made ");
        let lines = |bytes: &[u8]| {
            bytes.split(|b| *b == b'\n').filter(|line| !made(line)).map(<[u8]>::to_vec).collect::<Vec<_>>()
        };
        let (old, new) = (lines(old), lines(&new));
        assert_eq!(old.len(), new.len());
        for (old, new) in old.iter().zip(&new) {
            assert_eq!(masked(old), masked(new));
            changed += u32::from(old != new);
        }
    }
    assert_eq!(changed, 9);
    let points = fs::read_to_string(dir.path().join("new/glue01.DAT")).unwrap();
    let digits = |line: &str| line.split(',').next().unwrap().rsplit('.').next().unwrap().len();
    assert!(points.lines().filter(|line| line.contains("XP1=")).all(|line| digits(line) == 5));

    let refused = |output: std::process::Output, code: &str| {
        assert_eq!(output.status.code(), Some(1), "{code}");
        assert_eq!(codes(&output).last().map(String::as_str), Some(code), "{}", stderr(&output));
    };
    refused(run(&[]), COMMAND[0]);
    let one = ["--tool", "52.5,-3.25,210,12,25,-8", "--base", "900,-400,450,15,0,0"];
    refused(run(&one), COMMAND[1]);
    let limited = run(&["--config", "config.dat", "--limit", "0.01"]);
    // The motions that stay as they are have their findings, although nothing is written.
    for code in [COMMAND[2], "W0905"] {
        assert!(codes(&limited).contains(&code.into()), "{}", stderr(&limited));
    }
    refused(limited, COMMAND[3]);
    refused(run_to(".", &["--config", "config.dat"]), COMMAND[4]);
    refused(run(&["--limit", "0"]), "E0130");
    // A `.dat` alone is not a program.
    let args = ["compensate", "--replace", "glue01.DAT", "--robot", "id.toml", "--out", "new"];
    refused(dbbd(dir.path(), &args), COMMAND[4]);
    fs::write(path("id.toml"), kr60().to_toml().unwrap()).unwrap();
    refused(run(&["--config", "config.dat"]), COMMAND[5]);
}

/// What the command refuses in `other_bytes_are_unchanged`.
const COMMAND: [&str; 6] = ["E0901", "E0902", "E0908", "E0912", "E0910", "E0909"];
