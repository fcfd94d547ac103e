//! Workers of the archive. Each job is a request that a child process computes.

use dbbd_model::base::InternalFinding;
use dbbd_model::base::text::unreadable;
use std::fs;
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

use serde_json::json;

use crate::cli::{CommandOutcome, CommandOutput};
use dbbd_device::clock;
use dbbd_job::artefact::VERSION;
use dbbd_job::files;
use dbbd_job::recording::run;
use dbbd_job::request::{AnswerRecord, AnswerResult, RequestChild, RequestResult, read_answer};
use dbbd_model::diagnostic::{Diagnostic, FindingRecord};
use dbbd_model::estimation::CalibrationResult;
use dbbd_model::estimation::priors::Priors;
use dbbd_model::robot::Robot;
use dbbd_plant::ArchiveFinding;
use dbbd_plant::{
    Archive, ArchivedResult, ClaimedJob, IdentifySettings, ResultSummary, RunSelection, Worker,
    WrittenPosterior, is_away,
};

/// How long a worker may be silent before another one takes its job.
const LEASE: Duration = Duration::from_secs(30);
/// The interval at which a worker looks for a job, s.
const PAUSE_S: f64 = 1.0;
/// The interval at which it looks whether its child has ended, s.
const LOOK_S: f64 = 0.02;
/// How long it waits for an archive that cannot be reached, s.
const PATIENCE_S: f64 = 60.0;
/// The files of a result that are stored.
const KEPT: [&str; 4] = ["result.json", "report.html", "robot-identified.toml", "lengths.csv"];

/// The file with the answer of the child process.
const ANSWER: &str = "answer.json";
/// Files by name.
type FileContents = Vec<(String, Vec<u8>)>;

/// When a worker ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum WorkerEnd {
    Empty,
    Stopped,
}

/// This process as a worker.
pub(super) fn worker(lease_s: Option<f64>) -> Worker {
    let host = files::read_text(Path::new("/etc/hostname")).unwrap_or_default();
    Worker {
        name: format!("{}-{}-{}", host.trim(), std::process::id(), clock::unix_ns() % 1_000_000_000),
        version: VERSION.into(),
        lease: lease_s.map_or(LEASE, Duration::from_secs_f64),
    }
}

/// Works on jobs. Returns how many were done and how many failed.
pub(super) fn work(
    archive: &mut Archive,
    worker: &Worker,
    until: WorkerEnd,
    out: &CommandOutput,
) -> Result<[u64; 2], Diagnostic> {
    let mut counts = [0; 2];
    loop {
        let Some(job) = patiently(archive, out, |archive| archive.claim(worker))? else {
            let open = patiently(archive, out, Archive::queue)?;
            // The job of another worker may become free again.
            if until == WorkerEnd::Empty && open.waiting + open.running == 0 {
                return Ok(counts);
            }
            clock::sleep(PAUSE_S);
            continue;
        };
        counts[usize::from(!do_job(archive, &job, worker, out)?)] += 1;
        out.progress(format!("{} {}", &job.run[..12.min(job.run.len())], job.settings.text()));
    }
}

/// Repeats an access to the archive for up to [`PATIENCE_S`] while it cannot be reached.
fn patiently<T>(
    archive: &mut Archive,
    out: &CommandOutput,
    mut what: impl FnMut(&mut Archive) -> Result<T, Diagnostic>,
) -> Result<T, Diagnostic> {
    let began = clock::now();
    loop {
        match what(archive) {
            Err(why) if is_away(&why) && clock::now().seconds_since(began) < PATIENCE_S => {
                out.progress(why.to_string())
            }
            done => return done,
        }
        clock::sleep(PAUSE_S);
        // If this fails, so does the next attempt.
        let _ = archive.reconnect();
    }
}

/// Does a job. Returns whether there is a result.
fn do_job(
    archive: &mut Archive,
    job: &ClaimedJob,
    worker: &Worker,
    out: &CommandOutput,
) -> Result<bool, Diagnostic> {
    let directory = tempfile::tempdir().map_err(system)?;
    let capture = directory.path().join("run.dbbd");
    match patiently(archive, out, |archive| archive.fetch_object(&job.run, &capture)) {
        // Other runs may be undamaged.
        Err(why) if why.finding().is_some_and(ArchiveFinding::is_damage) => {
            return failed(archive, job, why.code().as_str(), &why.to_string(), out);
        }
        fetched => fetched?,
    }
    let Some(answer) = identify(archive, job, worker, directory.path())? else {
        // The child was killed: the job stays claimed until the lease ends.
        return Ok(false);
    };
    match answer.result {
        AnswerResult::Result(RequestResult { outcome, .. }) => {
            let (summary, contents) = read_result(&directory.path().join("result"), outcome.has_warnings())?;
            patiently(archive, out, |archive| archive.finish(job, worker, &summary, &contents))?;
            Ok(true)
        }
        AnswerResult::Refusal(refusal) => failed(archive, job, &refusal.code, &refusal.to_string(), out),
    }
}

fn failed(
    archive: &mut Archive,
    job: &ClaimedJob,
    code: &str,
    message: &str,
    out: &CommandOutput,
) -> Result<bool, Diagnostic> {
    patiently(archive, out, |archive| archive.fail(job, code, message))?;
    Ok(false)
}

/// Identifies the capture in `directory` in a child process, and renews the lease meanwhile. Returns its answer; `None` if it
/// was killed.
fn identify(
    archive: &mut Archive,
    job: &ClaimedJob,
    worker: &Worker,
    directory: &Path,
) -> Result<Option<AnswerRecord>, Diagnostic> {
    let request = job.settings.request(Path::new("run.dbbd"), Path::new("result"));
    let answer = fs::File::create(directory.join(ANSWER)).map_err(system)?;
    let RequestChild { mut child, stdin: _stdin } = RequestChild::start(&request, |command| {
        command.current_dir(directory).stdout(answer).stderr(Stdio::null());
    })
    .map_err(system)?;
    let third_s = worker.lease.as_secs_f64() / 3.0;
    let mut kept = clock::now();
    loop {
        if let Some(status) = child.try_wait().map_err(system)? {
            let answer = read_answer(&files::read_text(&directory.join(ANSWER))?);
            return Ok(match (answer, status.code()) {
                (Some(answer), _) => Some(answer),
                (None, None) => None,
                (None, Some(_)) => {
                    let ended = Diagnostic::new(system(std::io::Error::other(status.to_string())));
                    let result = AnswerResult::Refusal(FindingRecord::from(&ended));
                    Some(AnswerRecord { findings: Vec::new(), result })
                }
            });
        }
        if clock::now().seconds_since(kept) > third_s {
            kept = clock::now();
            match archive.keep(job, worker) {
                Ok(true) => {}
                Ok(false) => {
                    // Another worker has the job.
                    let _ = child.kill();
                }
                Err(_) => {
                    // The result counts even if the lease ends before the next attempt.
                    let _ = archive.reconnect();
                }
            }
        }
        clock::sleep(LOOK_S);
    }
}

fn system(error: std::io::Error) -> InternalFinding {
    InternalFinding::NoSystem { why: error.to_string() }
}

pub(super) fn report_failures(jobs: u64, out: &CommandOutput) {
    if jobs > 0 {
        out.finding(ArchiveFinding::JobsFailed { jobs });
    }
}

/// The summary of a result, and the files that are stored.
fn read_result(result: &Path, has_warnings: bool) -> Result<(ResultSummary, FileContents), Diagnostic> {
    let mut contents = Vec::new();
    for name in KEPT {
        let path = result.join(name);
        if path.is_file() {
            contents.push((name.to_owned(), fs::read(&path).map_err(unreadable(path.display()))?));
        }
    }
    let file = CalibrationResult::from_json("result.json", &files::read_text(&result.join("result.json"))?)?;
    let covariance = files::read_text(&result.join("covariance.csv"))?;
    let posterior = WrittenPosterior::of(&file, &covariance, &priors(result)?);
    let summary = ResultSummary {
        has_warnings,
        lengths: file.measurements as u64,
        sigma_mm: Some(file.noise_mm.length),
        rms_before_mm: Some(file.residual_mm.before.rms),
        rms_after_mm: Some(file.residual_mm.after.rms),
        error_nominal_mm: Some(file.predicted_position_uncertainty_mm.nominal.mean),
        error_identified_mm: Some(file.predicted_position_uncertainty_mm.identified.mean),
        posterior: posterior.map(|posterior| posterior.write()),
    };
    Ok((summary, contents))
}

/// The datasheet priors of a run: the robot's tolerance, and the certificate of the bar in the job.
fn priors(result: &Path) -> Result<Priors, Diagnostic> {
    let robot =
        Robot::from_toml("robot-identified.toml", &files::read_text(&result.join("robot-identified.toml"))?)?;
    let capture = result.with_file_name("run.dbbd");
    let run = run::open_run(&capture, None, &[], &mut |_| {})?;
    Ok(Priors::datasheet(&robot, run.plan.header.job.bar.u_mm()))
}

/// Compares the results of this version and these settings with the earlier results of the same runs.
pub(super) fn compare(
    archive: &mut Archive,
    selection: &RunSelection,
    settings: &IdentifySettings,
    out: &CommandOutput,
) -> Result<CommandOutcome, Diagnostic> {
    let results = archive.results(selection, None)?;
    let is_new = |result: &ArchivedResult| result.settings == settings.text() && result.version == VERSION;
    let (mut compared, mut changes) = (Vec::new(), Vec::new());
    for new in results.iter().filter(|result| is_new(result)) {
        let old = results.iter().rfind(|old| old.run == new.run && !is_new(old));
        let error = |result: &ArchivedResult| result.found.error_identified_mm;
        let Some((was, is)) = old.and_then(|old| Some((error(old)?, error(new)?))) else { continue };
        changes.push(is - was);
        compared.push(json!({ "run": new.run, "robot": new.robot, "measured": new.measured,
            "old_mm": was, "new_mm": is }));
    }
    let count = changes.len();
    let mean = if count == 0 { 0.0 } else { changes.iter().sum::<f64>() / count as f64 };
    let worst =
        changes.iter().copied().fold(0.0_f64, |worst, one| if one.abs() > worst.abs() { one } else { worst });
    out.document(&json!({ "compared": compared, "mean_change_mm": mean, "largest_change_mm": worst }))?;
    out.result(format!(
        "{count} runs compared: predicted position uncertainty changes by {mean:+.4} mm on average, by {worst:+.4} mm at most"
    ));
    report_failures(archive.failed(selection, settings, VERSION)?, out);
    Ok(CommandOutcome::Done)
}
