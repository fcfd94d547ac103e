//! Workers of the archive. Each job is `dbbd identify` as a child process.

use std::fs;
use std::path::Path;
use std::process::{ExitStatus, Stdio};
use std::time::Duration;

use serde_json::json;

use crate::archive::{
    Archive, ArchivedResult, Job, Selection, Settings, Summary, Worker, WrittenPosterior, is_away,
};
use crate::base::{clock, files, program};
use crate::catalogue::{ArchiveFinding, ServiceFinding};
use crate::cli::{Outcome, Output};
use crate::diagnostic::Diagnostic;
use crate::estimation::ResultFile;
use crate::estimation::priors::Priors;
use crate::provenance::VERSION;
use crate::recording::run;
use crate::robot::Robot;

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

/// The file with the stderr of an identification.
const STDERR: &str = "stderr";
/// The code of a stored object whose content has changed.
const DAMAGED: &str = "E2408";

/// Files by name.
type Contents = Vec<(String, Vec<u8>)>;

/// When a worker ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Until {
    Empty,
    Stopped,
}

/// This process as a worker.
pub(super) fn worker(lease_s: Option<f64>) -> Worker {
    let host = files::read(Path::new("/etc/hostname")).unwrap_or_default();
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
    until: Until,
    out: &Output,
) -> Result<[u64; 2], Diagnostic> {
    let mut counts = [0; 2];
    loop {
        let Some(job) = patiently(archive, out, |archive| archive.claim(worker))? else {
            let open = patiently(archive, out, Archive::queue)?;
            // The job of another worker may become free again.
            if until == Until::Empty && open.waiting + open.running == 0 {
                return Ok(counts);
            }
            clock::sleep(PAUSE_S);
            continue;
        };
        counts[usize::from(!one(archive, &job, worker, out)?)] += 1;
        out.progress(format!("{} {}", &job.run[..12.min(job.run.len())], job.settings.text()));
    }
}

/// Repeats an access to the archive for up to [`PATIENCE_S`] while it cannot be reached.
fn patiently<T>(
    archive: &mut Archive,
    out: &Output,
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
fn one(archive: &mut Archive, job: &Job, worker: &Worker, out: &Output) -> Result<bool, Diagnostic> {
    let directory = tempfile::tempdir().map_err(system)?;
    let capture = directory.path().join("run.dbbd");
    match patiently(archive, out, |archive| archive.fetch_object(&job.run, &capture)) {
        // Other runs may be undamaged.
        Err(why) if why.code.0 == DAMAGED => return failed(archive, job, why.code.0, &why.to_string(), out),
        fetched => fetched?,
    }
    let status = identify(archive, job, worker, directory.path())?;
    match status.code() {
        Some(code @ (0 | 3)) => {
            let (summary, contents) = read(&directory.path().join("result"), code == 3)?;
            patiently(archive, out, |archive| archive.finish(job, worker, &summary, &contents))?;
            Ok(true)
        }
        code => {
            let stderr = fs::read(directory.path().join(STDERR)).unwrap_or_default();
            let text = String::from_utf8_lossy(&stderr);
            let error = text.lines().find_map(|line| line.strip_prefix("error[")?.split_once("]: "));
            match (error, code) {
                (Some((code, message)), _) => failed(archive, job, code, message, out),
                (None, Some(_)) => failed(archive, job, "E2411", text.trim(), out),
                // Killed: the job stays claimed until the lease ends.
                (None, None) => Ok(false),
            }
        }
    }
}

fn failed(
    archive: &mut Archive,
    job: &Job,
    code: &str,
    message: &str,
    out: &Output,
) -> Result<bool, Diagnostic> {
    patiently(archive, out, |archive| archive.fail(job, code, message))?;
    Ok(false)
}

/// Identifies the capture in `directory`, and renews the lease meanwhile.
fn identify(
    archive: &mut Archive,
    job: &Job,
    worker: &Worker,
    directory: &Path,
) -> Result<ExitStatus, Diagnostic> {
    let mut command = program::own().map_err(system)?;
    command.args(["identify", "run.dbbd", "--out=result", "--quiet"]).args(job.settings.arguments());
    let log = fs::File::create(directory.join(STDERR)).map_err(system)?;
    command.current_dir(directory).stdout(Stdio::null()).stderr(log);
    let mut child = command.spawn().map_err(system)?;
    let third_s = worker.lease.as_secs_f64() / 3.0;
    let mut kept = clock::now();
    loop {
        if let Some(status) = child.try_wait().map_err(system)? {
            return Ok(status);
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

fn system(error: std::io::Error) -> ServiceFinding {
    ServiceFinding::NoSystem { why: error.to_string() }
}

pub(super) fn report_failures(jobs: u64, out: &Output) {
    if jobs > 0 {
        out.finding(ArchiveFinding::JobsFailed { jobs });
    }
}

/// The summary of a result, and the files that are stored.
fn read(result: &Path, doubtful: bool) -> Result<(Summary, Contents), Diagnostic> {
    let mut contents = Vec::new();
    for name in KEPT {
        let path = result.join(name);
        if path.is_file() {
            contents.push((name.to_owned(), fs::read(&path).map_err(files::unreadable(path.display()))?));
        }
    }
    let file = ResultFile::from_json("result.json", &files::read(&result.join("result.json"))?)?;
    let covariance = files::read(&result.join("covariance.csv"))?;
    let posterior = WrittenPosterior::of(&file, &covariance, &priors(result)?);
    let summary = Summary {
        doubtful,
        lengths: file.observations as u64,
        sigma_mm: Some(file.sigma_mm),
        rms_before_mm: Some(file.residual_mm.before.rms),
        rms_after_mm: Some(file.residual_mm.after.rms),
        error_nominal_mm: Some(file.predicted_position_error_mm.nominal.mean),
        error_identified_mm: Some(file.predicted_position_error_mm.identified.mean),
        posterior: posterior.map(|posterior| posterior.write()),
    };
    Ok((summary, contents))
}

/// The datasheet priors of a run: the robot's tolerance, and the certificate of the bar in the job.
fn priors(result: &Path) -> Result<Priors, Diagnostic> {
    let robot =
        Robot::from_toml("robot-identified.toml", &files::read(&result.join("robot-identified.toml"))?)?;
    let capture = result.with_file_name("run.dbbd");
    let run = run::open(&capture, None, &[], &mut |_| {})?;
    Ok(Priors::datasheet(&robot, run.plan.header.job.bar.u_mm()))
}

/// Compares the results of this version and these settings with the earlier results of the same runs.
pub(super) fn compare(
    archive: &mut Archive,
    selection: &Selection,
    settings: &Settings,
    out: &Output,
) -> Result<Outcome, Diagnostic> {
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
        "{count} runs compared: predicted position error changes by {mean:+.4} mm on average, by {worst:+.4} mm at most"
    ));
    report_failures(archive.failed(selection, settings, VERSION)?, out);
    Ok(Outcome::Done)
}
