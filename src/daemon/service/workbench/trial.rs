//! Tries a changed job: it is planned in a child process, and none of its files are kept. The page shows reach, limits
//! and the risk of leaving the stroke while a ball or an obstacle is moved.

use std::io::{self, Read, Write as _};
use std::path::Path;
use std::thread;

use dbbd_device::clock;
use dbbd_job::request::plan::{PlanRequest, PlannedPoses};
use dbbd_job::request::scene::CellScene;
use dbbd_job::request::{AnswerResult, Request, RequestChild, read_answer};
use dbbd_model::base::InternalFinding::NoSystem;
use dbbd_model::diagnostic::{Diagnostic, FindingRecord};
use serde_json::{Value, json};
use toml_edit::{DocumentMut, value};

use crate::daemon::service::jobs::confine;
use crate::live::ServiceFinding::{JobTooLong, WorkerLost};

/// Longest time of a trial, s: a job that takes longer is not tried. Who asks has an answer within 10 s, also on a busy computer.
const MAX_S: f64 = 8.0;
/// Number of chosen poses of a trial: they show reach, limits and risk about each ball, and take less time than those of a run.
const POINTS: i64 = 30;
/// Interval between checks whether the child has ended, s.
const LOOK_S: f64 = 0.02;

fn failed(error: &io::Error) -> Diagnostic {
    NoSystem { why: error.to_string() }.into()
}

/// Plans a job whose file would be in `directory`: returns `findings`, and with a plan also `checks`, `predictions` and
/// the `scene`. Of chosen poses only a few are planned; then there are no `predictions`.
///
/// # Errors
/// The directory cannot be written, or planning takes too long.
pub(super) fn try_job(
    directory: &Path,
    mut job: DocumentMut,
    explained: impl Fn(FindingRecord) -> Value,
) -> Result<Value, Diagnostic> {
    let is_whole = !has_fewer_points(&mut job);
    // Robot files beside the job are found from its directory; the page does not see names with a leading dot.
    let mut file = tempfile::Builder::new()
        .prefix(".trial-")
        .suffix(".toml")
        .tempfile_in(directory)
        .map_err(|error| failed(&error))?;
    file.write_all(job.to_string().as_bytes()).map_err(|error| failed(&error))?;
    let out = tempfile::tempdir().map_err(|error| failed(&error))?;
    let request = Request::Plan(PlanRequest {
        job: file.path().to_owned(),
        out: out.path().to_owned(),
        robot: None,
        measured: Vec::new(),
        poses: PlannedPoses::Job,
        replace: true,
    });
    let answer = plan(&request, directory)?.ok_or(WorkerLost { worker: "trial".into() })?;
    let findings = |all: Vec<FindingRecord>| all.into_iter().map(&explained).collect::<Vec<Value>>();
    Ok(match answer.result {
        AnswerResult::Refusal(refusal) => {
            json!({ "findings": findings(answer.findings.into_iter().chain([refusal]).collect()) })
        }
        AnswerResult::Result(result) => {
            let scene = CellScene::read(&out.path().join("plan.csv"), None)?;
            json!({
                "findings": findings(answer.findings),
                "checks": result.document["checks"],
                "predictions": is_whole.then(|| &result.document["predictions"]),
                "scene": scene,
            })
        }
    })
}

/// Takes the chosen poses beyond those of a trial from a job; whether it had more.
fn has_fewer_points(job: &mut DocumentMut) -> bool {
    let points = job.get_mut("optimise").and_then(|optimise| optimise.get_mut("points"));
    points.filter(|points| points.as_integer() > Some(POINTS)).map(|points| *points = value(POINTS)).is_some()
}

/// The answer of a child process; `None` if it ended without one.
fn plan(request: &Request, directory: &Path) -> Result<Option<dbbd_job::request::AnswerRecord>, Diagnostic> {
    let set_up = |command: &mut std::process::Command| {
        command.current_dir(directory).stderr(std::process::Stdio::null());
    };
    let RequestChild { mut child, stdin } =
        RequestChild::start(request, set_up).map_err(|error| failed(&error))?;
    confine(&child);
    let stdout = child.stdout.take();
    let began = clock::now();
    thread::scope(|scope| {
        let answer = scope.spawn(|| {
            let mut text = String::new();
            let read = stdout.map(|mut stdout| stdout.read_to_string(&mut text));
            read.and_then(Result::ok).and_then(|_| read_answer(&text))
        });
        while !answer.is_finished() {
            if clock::now().seconds_since(began) > MAX_S {
                let _ = child.kill();
                let _ = child.wait();
                return Err(JobTooLong { max_s: MAX_S }.into());
            }
            clock::sleep(LOOK_S);
        }
        drop(stdin);
        let _ = child.wait();
        Ok(answer.join().ok().flatten())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trial_plans_few_of_many_chosen_poses() {
        for (points, expected) in [("230", "30"), ("30", "30"), ("12", "12")] {
            let mut job: DocumentMut = format!("[optimise]\npoints = {points}\n").parse().unwrap();
            assert_eq!(has_fewer_points(&mut job), points != expected);
            assert_eq!(job.to_string(), format!("[optimise]\npoints = {expected}\n"));
        }
        assert!(!has_fewer_points(&mut "[[circle]]\nid = 1\n".parse().unwrap()));
    }
}
