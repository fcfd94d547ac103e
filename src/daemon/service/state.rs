//! The state machine: no device, idle, running, failed.

use std::fs;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde_json::json;
use tokio::sync::{broadcast, watch};

use super::catalogue::Plans;
use super::config::Config;
use super::jobs::Jobs;
use super::log::{Level, Log, Repeats};
use super::trial_cell::{Bench, Cell};
use super::{catalogue, runs};
use crate::base::clock;
use crate::catalogue::ServiceFinding::{self, DataUnwritable, NameTaken, NoPlan, ProtocolNotBuiltIn};
use crate::daemon::live_state::{Feed, LiveState};
use crate::daemon::{Acquisition, Options, Schedule};
use crate::device::port::{self, PortAddress};
use crate::device::protocol::Definition;
use crate::diagnostic::{Diagnostic, Finding};
use crate::live::{Device, LastRun, Message, RunStatus, StartRequest, State, Status};
use crate::recording::run::PlanFiles;

/// The protocol without a word about it.
const DEFAULT_PROTOCOL: &str = "dbb-cobs-1";
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
    pub(super) repeats: Repeats,
    inner: Mutex<Inner>,
}

/// What changes.
pub(super) struct Inner {
    pub(super) port: Option<PortAddress>,
    pub(super) protocol: Option<Definition>,
    pub(super) run: Run,
    /// Why the last run failed.
    pub(super) failed: Option<Diagnostic>,
    last: Option<LastRun>,
    /// Whether the process is about to end: no run may begin.
    pub(super) ending: bool,
}

/// The place of the one run.
pub(super) enum Run {
    None,
    /// The port is being opened.
    Starting,
    On(Box<Running>),
}

/// A run that is on.
pub(super) struct Running {
    pub(super) name: String,
    plan: Option<String>,
    started_unix_ms: u64,
    schedule: Schedule,
    pub(super) acquisition: Acquisition,
    /// What others did to its capture.
    interferences: Vec<Diagnostic>,
    pub(super) stop: Arc<AtomicBool>,
    /// What goes on beside it, where it is simulated.
    _cell: Option<Box<dyn Cell>>,
}

impl Supervisor {
    pub(super) fn new(config: Config, log: Arc<dyn Log>, bench: Option<Bench>) -> std::io::Result<Self> {
        let messages = broadcast::Sender::new(BACKLOG);
        let inner = Inner {
            port: config.port.clone(),
            protocol: config.protocol.clone(),
            run: Run::None,
            failed: None,
            last: None,
            ending: false,
        };
        Ok(Self {
            config,
            log,
            bench,
            status: watch::Sender::new(Status::default()),
            jobs: Jobs::start(messages.clone())?,
            live: LiveState { messages, points: Arc::default(), clock_ahead_ms: Arc::default() },
            plans: Plans::default(),
            repeats: Repeats::default(),
            inner: Mutex::new(inner),
        })
    }

    pub(super) fn inner(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
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
            matches!(&inner.run, Run::On(running) if running.acquisition.is_over())
                .then(|| std::mem::replace(&mut inner.run, Run::None))
        };
        if let Some(Run::On(running)) = over {
            self.conclude(*running);
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
    }

    pub(super) fn look(&self, inner: &Inner) -> Status {
        let there =
            |port: &PortAddress| *port != PortAddress::Sim && port.is_present() || self.is_simulated(port);
        let present = inner.port.as_ref().is_some_and(there);
        let run = match &inner.run {
            Run::On(running) => Some(self.run_status(running)),
            Run::None | Run::Starting => None,
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
            last: inner.last.clone(),
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
            started_unix_ms: running.started_unix_ms,
            elapsed_s: progress.elapsed_s,
            device_s: progress.device_s,
            clock_ahead_ms: *self.live.clock_ahead_ms.lock().unwrap_or_else(PoisonError::into_inner),
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

    /// Opens the device and begins; the caller holds the place of the run.
    pub(super) fn begin(
        &self,
        request: &StartRequest,
        mut port: PortAddress,
        protocol: Option<Definition>,
    ) -> Result<Running, Diagnostic> {
        let find = |name: &String| {
            catalogue::plan_file(&self.config.plans, name).ok_or_else(|| NoPlan { plan: name.clone() })
        };
        let mut csv = request.plan.as_ref().map(find).transpose()?;
        let cell = match &self.bench {
            Some(bench) if port == PortAddress::Sim => Some(bench(csv.as_deref())?),
            _ => None,
        };
        if let Some(cell) = &cell {
            (port, csv) = (cell.port().clone(), Some(cell.plan().into()));
        }
        let plan = csv.as_deref().map(PlanFiles::read).transpose()?;
        let schedule = match &plan {
            Some(files) => Schedule::of(&files.plan, self.config.alarm_share),
            None => Schedule::bare(self.config.stroke_mm, self.config.alarm_share),
        };
        let definition = protocol.map_or_else(|| protocol_of(plan.as_ref()), Ok)?;
        if let Some(finding) = port::blur(&port) {
            let fields: [(&str, &dyn std::fmt::Display); 2] = [("code", &finding.code()), ("text", &finding)];
            self.log.say(Level::Warning, "times_are_blurred", &fields);
        }
        let directory = self.reserve(&request.name)?;
        let (points, clock_ahead) = (&self.live.points, &self.live.clock_ahead_ms);
        points.lock().unwrap_or_else(PoisonError::into_inner).clear();
        *clock_ahead.lock().unwrap_or_else(PoisonError::into_inner) = None;
        let stop = Arc::new(AtomicBool::new(false));
        let options = Options {
            port,
            definition,
            out: directory.join(runs::CAPTURE),
            plan,
            identity: self.config.identity.clone(),
            duration_s: request.duration_s,
            gone_s: self.config.gone_s,
            sync_s: 1.0,
            feed: Some(Feed::new(self.live.clone(), schedule.clone())),
        };
        let begin = json!({ "name": request.name, "plan": request.plan });
        let _ = self.live.messages.send(Message::new("begin", &begin));
        let acquisition = Acquisition::start(options, Arc::clone(&stop)).inspect_err(|_| {
            // Nothing was recorded: the name stays free. What else is in there stays.
            let _ = fs::remove_dir(&directory);
        })?;
        let started_unix_ms = clock::unix_ns() / 1_000_000;
        let (name, plan) = (request.name.clone(), request.plan.clone());
        Ok(Running {
            name,
            plan,
            started_unix_ms,
            schedule,
            acquisition,
            interferences: Vec::new(),
            stop,
            _cell: cell,
        })
    }

    /// A directory for a run of that name.
    fn reserve(&self, name: &str) -> Result<PathBuf, Diagnostic> {
        let unwritable = |error: std::io::Error| DataUnwritable { why: error.to_string() };
        fs::create_dir_all(&self.config.data).map_err(unwritable)?;
        let directory = runs::directory(&self.config.data, name)?;
        fs::create_dir(&directory).map_err(|error| match error.kind() {
            std::io::ErrorKind::AlreadyExists => NameTaken { run: name.into() },
            _ => unwritable(error),
        })?;
        Ok(directory)
    }

    pub(super) fn running(&self) -> Option<String> {
        match &self.inner().run {
            Run::On(running) => Some(running.name.clone()),
            Run::None | Run::Starting => None,
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
                Run::On(running) => running.stop.store(true, Ordering::Relaxed),
            }
            self.tick();
            clock::sleep(0.02);
        }
    }
}

/// The protocol that the plan names, else the default; both built in.
fn protocol_of(plan: Option<&PlanFiles>) -> Result<Definition, Diagnostic> {
    let name = plan.map_or(DEFAULT_PROTOCOL, |files| &files.plan.header.job.bar.protocol);
    Definition::by_name(name).ok_or_else(|| ProtocolNotBuiltIn { protocol: name.into() })?
}
