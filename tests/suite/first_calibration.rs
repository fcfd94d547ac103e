//! The commands of docs/tutorial/first-calibration.md and README.md run as written and print what the page shows.
#![cfg(unix)]

use std::fs;
use std::path::Path;
use std::process::Command;

use tempfile::tempdir;

const DOCUMENT: &str = include_str!("../../docs/tutorial/first-calibration.md");
const README: &str = include_str!("../../README.md");

/// A block of commands, and the lines of output that the document shows below it.
struct Step<'a> {
    commands: &'a str,
    output: Option<&'a str>,
}

/// The blocks ```sh, each with the block ```text that follows it before the next one.
fn steps(document: &str) -> Vec<Step<'_>> {
    let mut steps: Vec<Step> = Vec::new();
    for piece in document.split("\n```").collect::<Vec<_>>().chunks(2) {
        let [_, block] = piece else { continue };
        match block.split_once('\n') {
            Some(("sh", commands)) => steps.push(Step { commands, output: None }),
            Some(("text", lines)) => {
                if let Some(last) = steps.last_mut().filter(|step| step.output.is_none()) {
                    last.output = Some(lines);
                }
            }
            _ => {}
        }
    }
    steps
}

/// Whether a line is as shown; `…` stands for whatever depends on the machine, or is left out.
fn is_as_shown(line: &str, shown: &str) -> bool {
    let mut pieces = shown.split('…');
    let Some(mut rest) = line.strip_prefix(pieces.next().unwrap_or_default()) else { return false };
    let mut last = None;
    for piece in pieces {
        let Some(at) = rest.find(piece) else { return false };
        rest = &rest[at + piece.len()..];
        last = Some(piece);
    }
    rest.is_empty() || last == Some("")
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

/// Runs the blocks one after the other in a directory of their own beside a copy of examples/.
fn run(steps: &[Step]) {
    let dir = tempdir().unwrap();
    copy(&Path::new(env!("CARGO_MANIFEST_DIR")).join("examples"), &dir.path().join("examples"));
    let program = Path::new(env!("CARGO_BIN_EXE_dbbd")).parent().unwrap().display();
    let path = format!("{program}:{}", std::env::var("PATH").unwrap_or_default());
    for Step { commands, output } in steps {
        let run = Command::new("timeout")
            .args(["60", "sh", "-c", &format!("set -e; exec 2>&1\n{commands}")])
            .current_dir(dir.path())
            .env_clear()
            .env("PATH", &path)
            .env("HOME", dir.path())
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&run.stdout);
        assert!(run.status.success(), "{commands}: {}\n{said}", run.status);
        let mut lines = said.lines();
        for shown in output.unwrap_or_default().lines().filter(|line| *line != "…") {
            assert!(
                lines.any(|line| is_as_shown(line.trim_end(), shown.trim_end())),
                "{commands} does not say (here)\n{shown}\nbut\n{said}"
            );
        }
    }
}

#[test]
fn every_command_of_the_document_runs_and_says_what_stands_there() {
    let steps = steps(DOCUMENT);
    assert!(steps.len() >= 8 && steps.iter().filter(|step| step.output.is_some()).count() >= 7);
    run(&steps);
}

/// Builds are .ci/run's, and a foreign trace is `imports_foreign_traces`'.
#[test]
fn every_command_of_the_readme_runs() {
    let mut steps = steps(README);
    steps.retain(|step| !step.commands.starts_with("cargo ") && !step.commands.starts_with("dbbd import "));
    assert_eq!(steps.len(), 2);
    run(&steps);
}
