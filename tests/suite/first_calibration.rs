//! The commands of the tutorial, of the guides that go on from it, and of README.md run as written and print what the page
//! shows.
#![cfg(unix)]

use std::fs;
use std::path::Path;
use std::process::Command;

use tempfile::tempdir;

const TUTORIAL: &str = include_str!("../../docs/tutorial/first-calibration.md");
/// Pages whose commands run after the tutorial in its directory.
const GUIDES: [&str; 4] = [
    include_str!("../../docs/how-to/import-a-trace.md"),
    include_str!("../../docs/how-to/further-measurement.md"),
    include_str!("../../docs/how-to/crash-check.md"),
    include_str!("../../docs/explanation/identification.md"),
];
const README: &str = include_str!("../../README.md");

/// A block of commands, and the lines of output that the document shows below it.
struct Step {
    commands: String,
    output: Option<String>,
}

/// The blocks ```sh, each with the block ```text that follows it before the next one. Blocks of a list are indented.
fn steps(document: &str) -> Vec<Step> {
    let document: String = document.lines().flat_map(|line| [line.trim_start(), "\n"]).collect();
    let mut steps: Vec<Step> = Vec::new();
    for piece in document.split("\n```").collect::<Vec<_>>().chunks(2) {
        let [_, block] = piece else { continue };
        match block.split_once('\n') {
            Some(("sh", commands)) => steps.push(Step { commands: commands.into(), output: None }),
            Some(("text", lines)) => {
                if let Some(last) = steps.last_mut().filter(|step| step.output.is_none()) {
                    last.output = Some(lines.into());
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
            .args(["180", "sh", "-c", &format!("set -e; exec 2>&1\n{commands}")])
            .current_dir(dir.path())
            .env_clear()
            .env("PATH", &path)
            .env("HOME", dir.path())
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&run.stdout);
        assert!(run.status.success(), "{commands}: {}\n{said}", run.status);
        let mut lines = said.lines();
        for shown in output.as_deref().unwrap_or_default().lines().filter(|line| *line != "…") {
            assert!(
                lines.any(|line| is_as_shown(line.trim(), shown)),
                "{commands} does not say (here)\n{shown}\nbut\n{said}"
            );
        }
    }
}

#[test]
fn every_command_of_the_tutorial_and_its_guides_runs_and_prints_what_they_show() {
    let mut all = steps(TUTORIAL);
    // Of a guide's own files, which are not there, the commands are in capitals.
    let runs = |step: &Step| !step.commands.contains("YOUR-");
    all.extend(GUIDES.into_iter().flat_map(steps).filter(runs));
    let shown = all.iter().filter(|step| step.output.is_some()).count();
    assert!(all.len() >= 22 && shown >= 18, "{shown} of {} steps", all.len());
    run(&all);
}

/// Builds are .ci/run's, and a foreign trace is `imports_foreign_traces`'.
#[test]
fn every_command_of_the_readme_runs() {
    let mut steps = steps(README);
    steps.retain(|step| !step.commands.starts_with("cargo ") && !step.commands.starts_with("dbbd import "));
    assert_eq!(steps.len(), 1);
    run(&steps);
}
