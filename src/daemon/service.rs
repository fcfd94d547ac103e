//! The service: one device, one run at a time, jobs, and the state that all clients see.
//!
//! This file has the state machine: no device, idle, running, failed. Its fields are private to the files below it.

mod answers;
#[cfg(feature = "archive")]
mod archiving;
mod begin;
mod catalogue;
mod config;
mod jobs;
mod log;
mod run_plans;
mod runs;
mod serve;
mod workbench;

pub use config::{Endpoint, ServiceConfig};
pub use log::{LogLevel, ServiceLog};
#[cfg(feature = "archive")]
pub use serve::serve_plant;
pub use serve::{abort_on_panic, serve};

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard};

use tokio::sync::{broadcast, watch};

use self::catalogue::PlanCache;
pub use self::jobs::Explain;
use self::jobs::JobQueue;
use self::log::RateLimitedLog;
use self::run_plans::RunPlans;
use super::live_state::LiveState;
use super::{Acquisition, Schedule};
use crate::live::ServiceFinding;
use crate::live::{Archiving, Device, LastRun, Message, RunStatus, State, Status};
use dbbd_device::clock;
use dbbd_device::port::PortAddress;
use dbbd_device::protocol::ProtocolDefinition;
use dbbd_device::sync::lock;
use dbbd_job::recording::capture::RunEvent;
use dbbd_model::diagnostic::Diagnostic;

/// Messages that a client may lag behind before it loses some: about ten seconds.
const BACKLOG: usize = 256;

/// The behaviour of a simulated cell's program at its HALT.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HaltBehaviour {
    /// The program continues once the bar is read.
    Continue,
    /// The program waits, so that the bar can be mounted.
    Wait,
}

/// The simulated cell that is requested.
#[derive(Clone, Copy, Debug)]
pub struct CellRequest<'a> {
    /// The plan that the cell runs; `None` for the cell's own plan.
    pub plan: Option<&'a Path>,
    pub halt: HaltBehaviour,
    /// Speed of the cell: device time per host time.
    pub speed: f64,
}

/// Creates a simulated cell.
pub type MakeCell = Box<dyn Fn(&CellRequest<'_>) -> Result<Box<dyn SimulatedCell>, Diagnostic> + Send + Sync>;

/// Writes the job of a simulated cell into a directory, with its true robot and its true base balls.
pub type MakeDemo = Box<dyn Fn(&Path) -> Result<(), Diagnostic> + Send + Sync>;

/// Functions of the program that the service calls.
pub struct ServiceParts {
    /// Creates the cell of the port `sim`.
    pub make_cell: Option<MakeCell>,
    pub make_demo: MakeDemo,
    pub explain: Explain,
}

/// A simulated cell. Its program begins when its bar is read; the cell ends when it is dropped.
pub trait SimulatedCell: Send {
    /// The port of its bar.
    fn port(&self) -> &PortAddress;
    fn plan(&self) -> &Path;
}

/// The service behind the pages.
struct Supervisor {
    config: ServiceConfig,
    log: Arc<dyn ServiceLog>,
    simulated: SimulatedCells,
    known: KnownPlans,
    status: watch::Sender<Status>,
    live: LiveState,
    jobs: JobQueue,
    journal: RateLimitedLog,
    archiving: Mutex<Option<Archiving>>,
    /// Signals the end of each run.
    over: Sender<()>,
    inner: Mutex<SupervisorState>,
}

/// The functions that make simulated cells.
struct SimulatedCells {
    make_cell: Option<MakeCell>,
    make_demo: MakeDemo,
}

/// The plans that were read, and the plans of runs.
#[derive(Default)]
struct KnownPlans {
    plans: PlanCache,
    of_runs: RunPlans,
}

/// The mutable state.
struct SupervisorState {
    port: Option<PortAddress>,
    protocol: Option<ProtocolDefinition>,
    run: LineUse,
    /// Why the last run failed.
    failed: Option<Diagnostic>,
    last: Option<LastRun>,
    /// Actions of the operator since the last run began.
    notes: Vec<RunEvent>,
    /// Whether the process is about to end: then no run may begin.
    ending: bool,
}

/// The user of the line to the bar.
enum LineUse {
    None,
    /// The port is being opened.
    Starting,
    On(Box<ActiveRun>),
    /// The bar is read without a run.
    Reading(Box<ActiveRun>),
}

/// The line to a bar, not yet open.
struct UnopenedLine {
    port: PortAddress,
    /// Protocol of the bar; `None` for the protocol of the plan.
    protocol: Option<ProtocolDefinition>,
    /// File of the plan.
    plan: Option<PathBuf>,
    /// Keeps the simulated cell running.
    _cell: Option<Box<dyn SimulatedCell>>,
}

/// A run or a reading in progress.
struct ActiveRun {
    /// Name of the run; empty for a reading.
    name: String,
    /// Who started the run, if users have names.
    by: Option<String>,
    plan: Option<String>,
    robot: Option<String>,
    started_unix_ms: u64,
    schedule: Schedule,
    acquisition: Acquisition,
    /// Findings about interference with the capture file.
    interferences: Vec<Diagnostic>,
    stop: Arc<AtomicBool>,
    definition: ProtocolDefinition,
    /// The line, to open it again.
    line: UnopenedLine,
}

impl Supervisor {
    /// Also returns the receiver that is notified when a run or a job ends.
    fn new(
        config: ServiceConfig,
        log: Arc<dyn ServiceLog>,
        parts: ServiceParts,
    ) -> std::io::Result<(Self, Receiver<()>)> {
        let messages = broadcast::Sender::new(BACKLOG);
        let (over, notified) = channel();
        let inner = SupervisorState {
            port: config.port.clone(),
            protocol: config.protocol.clone(),
            run: LineUse::None,
            failed: None,
            last: None,
            notes: Vec::new(),
            ending: false,
        };
        let supervisor = Self {
            config,
            journal: RateLimitedLog::new(Arc::clone(&log)),
            log,
            simulated: SimulatedCells { make_cell: parts.make_cell, make_demo: parts.make_demo },
            known: KnownPlans::default(),
            status: watch::Sender::new(Status::default()),
            jobs: JobQueue::start(messages.clone(), over.clone(), parts.explain)?,
            live: LiveState { messages, run: Arc::default() },
            archiving: Mutex::default(),
            over,
            inner: Mutex::new(inner),
        };
        Ok((supervisor, notified))
    }

    fn inner(&self) -> MutexGuard<'_, SupervisorState> {
        lock(&self.inner)
    }

    /// Handles the end of a run and publishes the state.
    fn tick(&self) -> State {
        let over = {
            let mut inner = self.inner();
            if let LineUse::On(running) = &mut inner.run {
                for finding in running.acquisition.findings() {
                    let fields: &[(&str, &dyn std::fmt::Display)] =
                        &[("code", &finding.code()), ("text", &finding)];
                    self.log.event(LogLevel::Error, "capture_taken_away", fields);
                    running.interferences.push(finding);
                }
            }
            matches!(&inner.run, LineUse::On(running) | LineUse::Reading(running) if running.acquisition.is_over())
                .then(|| std::mem::replace(&mut inner.run, LineUse::None))
        };
        match over {
            Some(LineUse::On(running)) => self.conclude(*running),
            Some(LineUse::Reading(running)) => running.end(),
            _ => {}
        }
        let status = self.current_status(&self.inner());
        let state = status.state;
        let changed = self.status.borrow().state != state;
        if changed {
            let reason = status.reason.clone().unwrap_or_default();
            self.log.event(LogLevel::Info, "state", &[("state", &state.name()), ("reason", &reason)]);
        }
        let message = Message::new("status", &status);
        self.status.send_replace(status);
        // Fails without a receiver.
        let _ = self.live.messages.send(message);
        state
    }

    fn conclude(&self, running: ActiveRun) {
        let ActiveRun { name, acquisition, interferences, .. } = running;
        let samples = acquisition.progress().counts.samples;
        let mut interferences = interferences.into_iter().chain(acquisition.findings());
        // A run fails if its capture file was removed or replaced, whatever ended it.
        let joined = acquisition.join().and_then(|summary| interferences.next().map_or(Ok(summary), Err));
        let ending = match &joined {
            Ok(summary) => summary.ending.reason().to_owned(),
            Err(error) => error.to_string(),
        };
        let level = if joined.is_err() { LogLevel::Error } else { LogLevel::Info };
        let code = joined.as_ref().err().map_or("", |error| error.code().as_str());
        let fields: [(&str, &dyn std::fmt::Display); 4] =
            [("run", &name), ("ending", &ending), ("samples", &samples), ("code", &code)];
        self.log.event(level, "run_over", if joined.is_err() { &fields } else { &fields[..3] });
        let mut inner = self.inner();
        inner.last = Some(LastRun { name, ending, failed: joined.is_err(), samples });
        inner.failed = joined.err();
        // Fails without an archive.
        let _ = self.over.send(());
    }

    fn current_status(&self, inner: &SupervisorState) -> Status {
        let is_present =
            |port: &PortAddress| *port != PortAddress::Sim && port.is_present() || self.is_simulated(port);
        let present = inner.port.as_ref().is_some_and(is_present);
        let port = inner.port.as_ref().map(PortAddress::to_string);
        let (run, reading) = match &inner.run {
            LineUse::On(running) => (Some(self.run_status(running)), None),
            LineUse::Reading(running) => (None, Some(self.run_status(running))),
            LineUse::None | LineUse::Starting => (None, None),
        };
        let (state, finding) = match (&inner.failed, &port) {
            _ if run.is_some() => (State::Running, None),
            (Some(failed), _) => (State::Failed, Some(failed.clone())),
            _ if present => (State::Idle, None),
            (None, Some(port)) => {
                (State::NoDevice, Some(ServiceFinding::PortAway { port: port.clone() }.into()))
            }
            (None, None) => (State::NoDevice, Some(ServiceFinding::NoPortChosen.into())),
        };
        let code = finding.as_ref().map(|finding| finding.code());
        let reason = finding.map(|finding| {
            if matches!(state, State::Failed) {
                format!("the last run failed: {finding}")
            } else {
                finding.to_string()
            }
        });
        let protocol = inner.protocol.as_ref().map(|definition| definition.id.clone());
        Status {
            version: dbbd_job::artefact::VERSION,
            state,
            reason,
            code,
            device: Device { port, present, protocol },
            run,
            reading,
            last: inner.last.clone(),
            archive: lock(&self.archiving).clone(),
        }
    }

    /// Whether this is the port of the simulated cell, and there is a simulated cell.
    fn is_simulated(&self, port: &PortAddress) -> bool {
        *port == PortAddress::Sim && self.simulated.make_cell.is_some()
    }

    fn run_status(&self, running: &ActiveRun) -> RunStatus {
        let ActiveRun { schedule, definition, .. } = running;
        let progress = running.acquisition.progress();
        let live = lock(&self.live.run);
        RunStatus {
            name: running.name.clone(),
            by: running.by.clone(),
            plan: running.plan.clone(),
            robot: running.robot.clone(),
            left_s: schedule.left_s(progress.counts.dwells),
            next: schedule.next(progress.counts.dwells),
            mounting: live.mounting.clone(),
            can_zero: !definition.zero.is_empty(),
            started_unix_ms: running.started_unix_ms,
            counts: progress.counts,
            clock_ahead_ms: live.clock_ahead_ms,
            bar_length_mm: schedule.bar_length_mm,
            stroke_mm: schedule.stroke_mm,
            alarm_share: schedule.alarm_share,
            poses: schedule.poses(),
        }
    }

    /// The name of the run in progress.
    fn running(&self) -> Option<String> {
        match &self.inner().run {
            LineUse::On(running) => Some(running.name.clone()),
            LineUse::None | LineUse::Starting | LineUse::Reading(_) => None,
        }
    }

    /// Stops the run and the jobs, and waits for the end of the run.
    fn end(&self) {
        self.inner().ending = true;
        self.jobs.end();
        loop {
            match &self.inner().run {
                LineUse::None => return,
                LineUse::Starting => {}
                LineUse::On(running) | LineUse::Reading(running) => {
                    running.stop.store(true, Ordering::Relaxed)
                }
            }
            self.tick();
            clock::sleep(0.02);
        }
    }
}

impl ActiveRun {
    /// Stops a reading and waits for its end. Its result is not used.
    fn end(self) {
        self.stop.store(true, Ordering::Relaxed);
        let _ = self.acquisition.join();
    }
}
