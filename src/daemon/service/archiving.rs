//! Sends completed runs to the archive: `dbbd archive push` as a child process, one run at a time.

use std::fs;
use std::io;
use std::path::{Path, absolute};
use std::process::Stdio;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;

use serde::Deserialize;

use super::config::ArchiveTarget;
use super::log::LogLevel;
use super::{LineUse, Supervisor};
use super::{jobs, runs};
use crate::live::Archiving;
use dbbd_device::sync::lock;
use dbbd_job::child_process;
use dbbd_job::files;
use dbbd_model::base::hash::sha256;
use dbbd_model::diagnostic::{FindingRecord, Severity};
use dbbd_plant::{LocalRun, Secrets, Spool};

/// File beside a run with the hash of the state that was handed over. It is not pushed.
const HANDED_OVER: &str = ".archive";
/// Interval between checks while no run waits, s.
const IDLE_S: f64 = 3600.0;

enum PushAttempt {
    /// The archive confirmed the run, perhaps with a warning.
    Confirmed(Option<String>),
    /// The run is in the spool, with the reason.
    Waits(String),
    /// The run was neither pushed nor spooled, with the reason.
    Failed(String),
}

/// Starts the thread that pushes, if there is an archive. `over` is notified when a run or a job ends.
pub(super) fn start(supervisor: &Arc<Supervisor>, over: Receiver<()>) -> io::Result<()> {
    if supervisor.config.archive.is_none() {
        return Ok(());
    }
    let supervisor = Arc::clone(supervisor);
    std::thread::Builder::new().name("archive".into()).spawn(move || push_all(&supervisor, &over)).map(drop)
}

/// Pushes every completed run that is new or has changed, and the runs in the spool.
fn push_all(supervisor: &Supervisor, over: &Receiver<()>) {
    let Some(archive) = &supervisor.config.archive else { return };
    let mut confirmed = 0;
    loop {
        let state = round(supervisor, archive, confirmed);
        confirmed = state.confirmed;
        let waits = state.waiting > 0;
        let before = lock(&supervisor.archiving).replace(state.clone());
        if before.as_ref() != Some(&state) {
            let level = if waits { LogLevel::Warning } else { LogLevel::Info };
            let reason = state.reason.unwrap_or_default();
            supervisor.log.event(level, "archive", &[("waiting", &state.waiting), ("reason", &reason)]);
        }
        let pause = Duration::from_secs_f64(if waits { archive.retry_s } else { IDLE_S });
        if over.recv_timeout(pause) == Err(RecvTimeoutError::Disconnected) {
            return;
        }
        while over.try_recv().is_ok() {}
    }
}

/// Pushes once all that waits. `confirmed` is the number of runs confirmed before.
fn round(supervisor: &Supervisor, archive: &ArchiveTarget, confirmed: u64) -> Archiving {
    let mut state = Archiving::default();
    let spooled = || Spool::count(&archive.spool).map_or(1, |waiting| waiting as u64);
    let (before, mut handed_over) = (spooled(), 0);
    let mut sent = false;
    let names = completed(supervisor).unwrap_or_else(|error| {
        (state.refused, state.reason) = (1, Some(error.to_string()));
        Vec::new()
    });
    for name in names {
        let directory = supervisor.config.data.join(&name);
        let pushed = hand_over(archive, &directory);
        match pushed {
            Ok(None) => {}
            Ok(Some(PushAttempt::Confirmed(warning))) => {
                (sent, handed_over) = (true, handed_over + 1);
                let level = if warning.is_some() { LogLevel::Warning } else { LogLevel::Info };
                let warning = warning.unwrap_or_default();
                supervisor.log.event(level, "archived", &[("run", &name), ("warning", &warning)]);
            }
            // The run is counted in the spool.
            Ok(Some(PushAttempt::Waits(why))) => {
                (sent, handed_over, state.reason) = (true, handed_over + 1, Some(why));
            }
            Ok(Some(PushAttempt::Failed(why))) => {
                (state.refused, state.reason) = (state.refused + 1, Some(why))
            }
            Err(error) => (state.refused, state.reason) = (state.refused + 1, Some(error.to_string())),
        }
    }
    if spooled() > 0 && !sent {
        state.reason = match push(archive, None) {
            Ok(PushAttempt::Confirmed(_)) => state.reason,
            Ok(PushAttempt::Waits(why) | PushAttempt::Failed(why)) => Some(why),
            Err(error) => Some(error.to_string()),
        };
    }
    let left = spooled();
    state.confirmed = confirmed + (before + handed_over).saturating_sub(left);
    state.waiting = left + state.refused;
    state
}

/// The names of the runs that no run or job is writing. The directory is listed first, so that a run that begins
/// meanwhile is not among them.
fn completed(supervisor: &Supervisor) -> io::Result<Vec<String>> {
    let entries = match fs::read_dir(&supervisor.config.data) {
        // No run was recorded yet.
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries?.collect::<io::Result<Vec<_>>>()?,
    };
    let names = entries.into_iter().filter_map(|entry| entry.file_name().into_string().ok());
    let is_run = |name: &String| {
        let directory = supervisor.config.data.join(name);
        runs::is_sound(name)
            && runs::is_plain_directory(&directory)
            && directory.join(runs::CAPTURE).is_file()
    };
    let mut names: Vec<String> = names.filter(is_run).collect();
    match &supervisor.inner().run {
        LineUse::Starting => names.clear(),
        LineUse::On(running) => names.retain(|name| *name != running.name),
        LineUse::None | LineUse::Reading(_) => {}
    }
    names.retain(|name| !supervisor.jobs.has_open_job(name));
    names.sort();
    Ok(names)
}

/// Pushes the run in `directory` unless its present state was handed over before.
fn hand_over(archive: &ArchiveTarget, directory: &Path) -> io::Result<Option<PushAttempt>> {
    let state = LocalRun::state(directory).map_err(io::Error::other)?;
    let state = sha256(format!("{}\n{}\n{state}", archive.database, archive.store));
    let noted = directory.join(HANDED_OVER);
    if fs::read_to_string(&noted).is_ok_and(|noted| noted == state) {
        return Ok(None);
    }
    let pushed = push(archive, Some(directory))?;
    if !matches!(pushed, PushAttempt::Failed(_)) {
        files::write_file(&noted, state).map_err(io::Error::other)?;
    }
    Ok(Some(pushed))
}

/// Pushes the runs in the spool, and `run` if there is one.
fn push(archive: &ArchiveTarget, run: Option<&Path>) -> io::Result<PushAttempt> {
    let mut command = child_process::own()?;
    command.args(["archive", "push", "--json"]).args(run.map(absolute).transpose()?);
    command.arg("--spool").arg(absolute(&archive.spool)?);
    command.arg(format!("--archive={}", archive.database)).arg(format!("--store={}", archive.store));
    if !archive.base.as_os_str().is_empty() {
        command.current_dir(&archive.base);
    }
    command.envs(Secrets::variables()).stdout(Stdio::piped()).stderr(Stdio::null());
    let mut child = command.spawn()?;
    jobs::confine(&child);
    let _stdin = child.stdin.take();
    let report = child.stdout.take().map(io::read_to_string).transpose()?.unwrap_or_default();
    let status = child.wait()?;
    let PushReport { findings, error } = serde_json::from_str(&report).unwrap_or_default();
    let mut warnings = findings.iter().filter(|finding| finding.severity == Severity::Warning);
    Ok(match status.code() {
        Some(0) => PushAttempt::Confirmed(None),
        // The command reports waiting runs last.
        Some(3) if Spool::count(&archive.spool).map_err(io::Error::other)? > 0 => {
            PushAttempt::Waits(warnings.next_back().map(FindingRecord::labelled).unwrap_or_default())
        }
        Some(3) => PushAttempt::Confirmed(warnings.next().map(FindingRecord::labelled)),
        _ => {
            let why = error.as_ref().or(warnings.next()).map(FindingRecord::labelled);
            PushAttempt::Failed(why.unwrap_or_else(|| status.to_string()))
        }
    })
}

/// The parts of the document printed by `archive push` that the service reads.
#[derive(Default, Deserialize)]
struct PushReport {
    #[serde(default)]
    findings: Vec<FindingRecord>,
    error: Option<FindingRecord>,
}
