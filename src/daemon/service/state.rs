//! The state machine: no device, idle, running, failed.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard};

use tokio::sync::{broadcast, watch};

use super::catalogue::Plans;
use super::config::Config;
use super::jobs::Jobs;
use super::log::{Level, Log, Warnings};
use super::trial_cell::{Bench, Cell};
use crate::base::clock;
use crate::base::sync::lock;
use crate::catalogue::ServiceFinding;
use crate::daemon::live_state::LiveState;
use crate::daemon::{Acquisition, Schedule};
use crate::device::port::PortAddress;
use crate::device::protocol::Definition;
use crate::diagnostic::Diagnostic;
use crate::live::{Archiving, Device, LastRun, Message, RunStatus, State, Status};
use crate::recording::capture::Event;

/// Messages that a slow client may be behind before it loses some: about ten seconds.
const BACKLOG: usize = 256;

/// The service behind the pages.
pub(super) struct Supervisor {
    pub(super) config: Config,
    pub(super) log: Arc<dyn Log>,
    pub(super) bench: Option<Bench>,
    pub(super) status: watch::Sender<Status>,
    pub(super) live: LiveState,
    pub(super) jobs: Jobs,
    pub(super) plans: Plans,
    pub(super) journal: Warnings,
    /// What waits for the archive.
    pub(super) archiving: Mutex<Option<Archiving>>,
    /// Is sent that a run is over.
    over: Sender<()>,
    inner: Mutex<Inner>,
}

/// What changes.
pub(super) struct Inner {
    pub(super) port: Option<PortAddress>,
    pub(super) protocol: Option<Definition>,
    pub(super) run: Run,
    /// Why the last run failed.
    pub(super) failed: Option<Diagnostic>,
    pub(super) last: Option<LastRun>,
    /// What the operator did since the last run began.
    pub(super) notes: Vec<Event>,
    /// Whether the process is about to end: no run may begin.
    pub(super) ending: bool,
}

/// The place of the one run, or of what reads the bar without one.
pub(super) enum Run {
    None,
    /// The port is being opened.
    Starting,
    On(Box<Running>),
    Reading(Box<Running>),
}

/// The line to a bar, not yet open.
pub(super) struct Line {
    pub(super) port: PortAddress,
    /// Its protocol; none: that of the plan.
    pub(super) protocol: Option<Definition>,
    /// The plan's file.
    pub(super) plan: Option<PathBuf>,
    /// What goes on beside it, where it is simulated.
    pub(super) _cell: Option<Box<dyn Cell>>,
}

/// A run that is on, or a reading.
pub(super) struct Running {
    /// Its name; empty of a reading.
    pub(super) name: String,
    pub(super) plan: Option<String>,
    pub(super) robot: Option<String>,
    pub(super) started_unix_ms: u64,
    pub(super) schedule: Schedule,
    pub(super) acquisition: Acquisition,
    /// What others did to its capture.
    pub(super) interferences: Vec<Diagnostic>,
    pub(super) stop: Arc<AtomicBool>,
    pub(super) definition: Definition,
    /// The line, to open it again.
    pub(super) line: Line,
}

impl Supervisor {
    /// With the end at which it is heard that a run or a job is over.
    pub(super) fn new(
        config: Config,
        log: Arc<dyn Log>,
        bench: Option<Bench>,
    ) -> std::io::Result<(Self, Receiver<()>)> {
        let messages = broadcast::Sender::new(BACKLOG);
        let (over, heard) = channel();
        let inner = Inner {
            port: config.port.clone(),
            protocol: config.protocol.clone(),
            run: Run::None,
            failed: None,
            last: None,
            notes: Vec::new(),
            ending: false,
        };
        let supervisor = Self {
            config,
            journal: Warnings::new(Arc::clone(&log)),
            log,
            bench,
            status: watch::Sender::new(Status::default()),
            jobs: Jobs::start(messages.clone(), over.clone())?,
            live: LiveState {
                messages,
                points: Arc::default(),
                clock_ahead_ms: Arc::default(),
                mounting: Arc::default(),
            },
            plans: Plans::default(),
            archiving: Mutex::default(),
            over,
            inner: Mutex::new(inner),
        };
        Ok((supervisor, heard))
    }

    pub(super) fn inner(&self) -> MutexGuard<'_, Inner> {
        lock(&self.inner)
    }

    /// Looks after the run that is on, and publishes the state.
    pub(super) fn tick(&self) -> State {
        let over = {
            let mut inner = self.inner();
            if let Run::On(running) = &mut inner.run {
                for finding in running.acquisition.findings() {
                    let fields: [(&str, &dyn std::fmt::Display); 2] =
                        [("code", &finding.code), ("text", &finding)];
                    self.log.say(Level::Error, "capture_taken_away", &fields);
                    running.interferences.push(finding);
                }
            }
            matches!(&inner.run, Run::On(running) | Run::Reading(running) if running.acquisition.is_over())
                .then(|| std::mem::replace(&mut inner.run, Run::None))
        };
        match over {
            Some(Run::On(running)) => self.conclude(*running),
            Some(Run::Reading(running)) => running.end(),
            _ => {}
        }
        let status = self.look(&self.inner());
        let state = status.state;
        let changed = self.status.borrow().state != state;
        if changed {
            let reason = status.reason.clone().unwrap_or_default();
            self.log.say(Level::Info, "state", &[("state", &state.name()), ("reason", &reason)]);
        }
        let message = Message::new("status", &status);
        self.status.send_replace(status);
        // Nobody may be looking.
        let _ = self.live.messages.send(message);
        state
    }

    fn conclude(&self, running: Running) {
        let Running { name, acquisition, interferences, .. } = running;
        let samples = acquisition.progress().samples;
        let mut interferences = interferences.into_iter().chain(acquisition.findings());
        // A run whose capture was taken away is not whole, however it ended.
        let joined = acquisition.join().and_then(|summary| interferences.next().map_or(Ok(summary), Err));
        let ending = match &joined {
            Ok(summary) => summary.ending.reason().to_owned(),
            Err(error) => error.to_string(),
        };
        let level = if joined.is_err() { Level::Error } else { Level::Info };
        let code = joined.as_ref().err().map_or("", |error| error.code.0);
        let fields: [(&str, &dyn std::fmt::Display); 4] =
            [("run", &name), ("ending", &ending), ("samples", &samples), ("code", &code)];
        self.log.say(level, "run_over", if joined.is_err() { &fields } else { &fields[..3] });
        let mut inner = self.inner();
        inner.last = Some(LastRun { name, ending, failed: joined.is_err(), samples });
        inner.failed = joined.err();
        // Without an archive nobody waits for it.
        let _ = self.over.send(());
    }

    pub(super) fn look(&self, inner: &Inner) -> Status {
        let there =
            |port: &PortAddress| *port != PortAddress::Sim && port.is_present() || self.is_simulated(port);
        let present = inner.port.as_ref().is_some_and(there);
        let run = match &inner.run {
            Run::On(running) => Some(self.run_status(running)),
            Run::None | Run::Starting | Run::Reading(_) => None,
        };
        let reading = match &inner.run {
            Run::Reading(running) => Some(self.run_status(running)),
            Run::None | Run::Starting | Run::On(_) => None,
        };
        let (state, finding) = if run.is_some() {
            (State::Running, None)
        } else if let Some(failed) = &inner.failed {
            (State::Failed, Some(failed.clone()))
        } else if present {
            (State::Idle, None)
        } else {
            let port = inner.port.as_ref().map(PortAddress::to_string);
            let finding = port.map_or(ServiceFinding::NoPortChosen, |port| ServiceFinding::PortAway { port });
            (State::NoDevice, Some(finding.into()))
        };
        let code = finding.as_ref().map(|finding| finding.code);
        let reason = finding.map(|finding| match state {
            State::Failed => format!("the last run failed: {finding}"),
            _ => finding.to_string(),
        });
        let protocol = inner.protocol.as_ref().map(|definition| definition.id.clone());
        let device = Device { port: inner.port.as_ref().map(PortAddress::to_string), present, protocol };
        Status {
            version: crate::provenance::VERSION,
            state,
            reason,
            code,
            device,
            run,
            reading,
            last: inner.last.clone(),
            archive: lock(&self.archiving).clone(),
        }
    }

    /// Whether the port is that of the simulated cell, and there is one.
    pub(super) fn is_simulated(&self, port: &PortAddress) -> bool {
        *port == PortAddress::Sim && self.bench.is_some()
    }

    fn run_status(&self, running: &Running) -> RunStatus {
        let progress = running.acquisition.progress();
        RunStatus {
            name: running.name.clone(),
            plan: running.plan.clone(),
            robot: running.robot.clone(),
            left_s: running.schedule.left_s(progress.dwells),
            next: running.schedule.next(progress.dwells),
            mounting: lock(&self.live.mounting).clone(),
            can_zero: !running.definition.zero.is_empty(),
            started_unix_ms: running.started_unix_ms,
            elapsed_s: progress.elapsed_s,
            device_s: progress.device_s,
            clock_ahead_ms: *lock(&self.live.clock_ahead_ms),
            gone: progress.gone,
            in_step: progress.in_step,
            rate_hz: progress.rate_hz,
            bytes: progress.bytes,
            samples: progress.samples,
            reading_mm: progress.reading_mm,
            bar_length_mm: running.schedule.bar_length_mm,
            stroke_mm: running.schedule.stroke_mm,
            alarm_share: running.schedule.alarm_share,
            dwells: progress.dwells,
            poses: running.schedule.poses(),
            modules: progress.modules,
            gaps: progress.gaps,
            missing: progress.missing,
            faults: progress.faults,
            rejected: progress.rejected,
            unanswered: progress.unanswered,
            lost_bytes: progress.lost_bytes,
        }
    }

    pub(super) fn running(&self) -> Option<String> {
        match &self.inner().run {
            Run::On(running) => Some(running.name.clone()),
            Run::None | Run::Starting | Run::Reading(_) => None,
        }
    }

    /// Ends the run as it should, and the job at work.
    pub(super) fn end(&self) {
        self.inner().ending = true;
        self.jobs.end();
        loop {
            match &self.inner().run {
                Run::None => return,
                Run::Starting => {}
                Run::On(running) | Run::Reading(running) => running.stop.store(true, Ordering::Relaxed),
            }
            self.tick();
            clock::sleep(0.02);
        }
    }
}
