//! Workers: each job is `dbbd identify` as a child process, as the service's are.

use std::fs;
use std::path::Path;
use std::process::{ExitStatus, Stdio};
use std::time::Duration;

use serde_json::json;

use crate::archive::{Archive, Job, Settings, Summary, Worker, is_away};
use crate::base::{clock, files, program};
use crate::catalogue::{ArchiveFinding, ServiceFinding};
use crate::cli::{Outcome, Output};
use crate::diagnostic::Diagnostic;
use crate::estimation::ResultFile;
use crate::estimation::priors::Priors;
use crate::provenance::VERSION;
use crate::recording::run;
use crate::robot::Robot;

/// How long a worker may be silent.
const LEASE: Duration = Duration::from_secs(30);
/// How often it looks for work and at its child, s.
const PAUSE_S: f64 = 1.0;
const LOOK_S: f64 = 0.02;
/// How long it waits for an archive that cannot be reached, s.
const PATIENCE_S: f64 = 60.0;
/// What of a result is kept.
const KEPT: [&str; 4] = ["result.json", "report.html", "robot-identified.toml", "lengths.csv"];

/// Where an identification writes why it failed.
const SAID: &str = "said";
/// The code of an object that is not what was stored.
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

/// Works until nothing is left or for ever; how many jobs were done and how many failed.
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
            // A job of another worker may come back.
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

/// Does something with the archive, again and again while that cannot be reached, for a while.
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
        // Where this fails, so does the next attempt.
        let _ = archive.reconnect();
    }
}

/// Does a job; whether there is a result.
fn one(archive: &mut Archive, job: &Job, worker: &Worker, out: &Output) -> Result<bool, Diagnostic> {
    let directory = tempfile::tempdir().map_err(system)?;
    let capture = directory.path().join("run.dbbd");
    match patiently(archive, out, |archive| archive.fetch_object(&job.run, &capture)) {
        // Other runs are whole.
        Err(why) if why.code.0 == DAMAGED => return failed(archive, job, why.code.0, &why.to_string(), out),
        fetched => fetched?,
    }
    let status = identify(archive, job, worker, directory.path())?;
    match status.code() {
        Some(code @ (0 | 3)) => {
            let (found, contents) = read(&directory.path().join("result"), code == 3)?;
            patiently(archive, out, |archive| archive.finish(job, worker, &found, &contents))?;
            Ok(true)
        }
        code => {
            let said = fs::read(directory.path().join(SAID)).unwrap_or_default();
            let text = String::from_utf8_lossy(&said);
            let error = text.lines().find_map(|line| line.strip_prefix("error[")?.split_once("]: "));
            match (error, code) {
                (Some((code, message)), _) => failed(archive, job, code, message, out),
                (None, Some(_)) => failed(archive, job, "E2411", text.trim(), out),
                // Ended by the system or by another worker: it stays claimed until the lease ends.
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

/// Identifies the capture in `directory`, and keeps the job meanwhile.
fn identify(
    archive: &mut Archive,
    job: &Job,
    worker: &Worker,
    directory: &Path,
) -> Result<ExitStatus, Diagnostic> {
    let mut command = program::own().map_err(system)?;
    command.args(["identify", "run.dbbd", "--out=result", "--quiet"]).args(job.settings.arguments());
    let log = fs::File::create(directory.join(SAID)).map_err(system)?;
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
                    // Another worker has it, or it has just ended.
                    let _ = child.kill();
                }
                Err(_) => {
                    // The next time it is asked again; what is found counts also when the lease has ended.
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

/// Says how many jobs failed.
pub(super) fn report_failures(jobs: u64, out: &Output) {
    if jobs > 0 {
        out.finding(ArchiveFinding::JobsFailed { jobs });
    }
}

/// What the files of a result state, and those that are kept.
fn read(result: &Path, doubtful: bool) -> Result<(Summary, Contents), Diagnostic> {
    let mut contents = Vec::new();
    for name in KEPT {
        let path = result.join(name);
        if path.is_file() {
            contents.push((name.to_owned(), fs::read(&path).map_err(files::unreadable(path.display()))?));
        }
    }
    let file = ResultFile::from_json("result.json", &files::read(&result.join("result.json"))?)?;
    let found = Summary {
        doubtful,
        lengths: file.observations as u64,
        sigma_mm: Some(file.sigma_mm),
        rms_before_mm: Some(file.residual_mm.before.rms),
        rms_after_mm: Some(file.residual_mm.after.rms),
        error_nominal_mm: Some(file.predicted_position_error_mm.nominal.mean),
        error_identified_mm: Some(file.predicted_position_error_mm.identified.mean),
        posterior: posterior(&file, &files::read(&result.join("covariance.csv"))?, &priors(result)?),
    };
    Ok((found, contents))
}

/// What the identification of a run knew beforehand: the robot's tolerance, and the certificate of the bar in the job.
fn priors(result: &Path) -> Result<Priors, Diagnostic> {
    let robot =
        Robot::from_toml("robot-identified.toml", &files::read(&result.join("robot-identified.toml"))?)?;
    let capture = result.with_file_name("run.dbbd");
    let run = run::open(&capture, None, &[], &mut |_| {})?;
    Ok(Priors::datasheet(&robot, run.plan.header.job.bar.u_mm()))
}

/// Corrections and covariance in one text: what the fleet is estimated from.
fn posterior(result: &ResultFile, covariance: &str, priors: &Priors) -> Option<String> {
    let mut lines = covariance.lines().map(|line| line.split(','));
    let names: Vec<&str> = lines.next()?.skip(1).collect();
    let rows: Vec<Vec<f64>> = lines
        .map(|cells| cells.skip(1).map(str::parse).collect::<Result<_, _>>().ok())
        .collect::<Option<_>>()?;
    let correction = |name: &str| Some(result.parameters.iter().find(|one| one.name == name)?.correction);
    // Of the covariance the rows of robot and bar; balls and tool are other ones in every run.
    let kept: Vec<usize> = (0..names.len())
        .filter(|&at| {
            names[at]
                .parse::<crate::robot::ParamId>()
                .is_ok_and(|id| id.is_geometric() || matches!(id, crate::robot::ParamId::BarOffset(_)))
        })
        .collect();
    let corrections: Vec<f64> = kept.iter().map(|&at| correction(names[at])).collect::<Option<_>>()?;
    let triangle: Option<Vec<Vec<f64>>> = kept
        .iter()
        .enumerate()
        .map(|(row, &at)| kept[..=row].iter().map(|&to| rows.get(at)?.get(to).copied()).collect())
        .collect();
    let names: Vec<&str> = kept.iter().map(|&at| names[at]).collect();
    let prior: Vec<Option<f64>> =
        names.iter().map(|name| name.parse().ok().and_then(|id| priors.bound(id, &[]))).collect();
    let found = json!({
        "parameters": names, "corrections": corrections, "covariance": triangle?, "prior": prior,
    });
    Some(found.to_string())
}

/// What changed from the results of one version and its settings to those of another, robot by robot.
pub(super) fn compare(
    archive: &mut Archive,
    selection: &crate::archive::Selection,
    settings: &Settings,
    version: &str,
    out: &Output,
) -> Result<Outcome, Diagnostic> {
    let results = archive.results(selection, None)?;
    let is_new = |result: &crate::archive::ArchivedResult| {
        result.settings == settings.text() && result.version == version
    };
    let (mut compared, mut changes) = (Vec::new(), Vec::new());
    for new in results.iter().filter(|result| is_new(result)) {
        let old = results.iter().rfind(|old| old.run == new.run && !is_new(old));
        let error = |result: &crate::archive::ArchivedResult| result.found.error_identified_mm;
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
    report_failures(archive.failed(selection, settings, version)?, out);
    Ok(Outcome::Done)
}
