//! The requests of the pages, answered by the service.

use std::fmt::Display;
use std::sync::atomic::Ordering;

use serde_json::Value;
use tokio::sync::{broadcast, watch};

use super::begin::ReadPurpose;
use super::jobs::JobSubject;
use super::log::LogLevel;
use super::{ActiveRun, LineUse, Supervisor};
use super::{catalogue, jobs, runs};
use crate::daemon::session;
use crate::live::ServiceFinding::{
    NoRunIsOn, NoSuchPort, NoSuchProtocol, NoZeroCommand, NotRead, RunDuration, RunIsOn, RunIsStarting,
    RunName, Speed, ThisRunIsOn,
};
use crate::live::{
    Act, Catalogue, CheckItem, ConnectRequest, EvaluationJob, JobKind, JobRequest, Journal, Message, Point,
    ReadingRange, RunEntry, Service, StartRequest, Status,
};
use dbbd_device::clock;
use dbbd_device::port::{self, PortAddress};
use dbbd_device::protocol::ProtocolDefinition;
use dbbd_device::sync::lock;
use dbbd_job::page::Download;
use dbbd_job::recording::capture::RunEvent;
use dbbd_model::diagnostic::Diagnostic;

/// The longest run that may be requested, s.
const LONGEST_S: f64 = 1e6;
/// Operator actions that are kept until a run begins. The oldest are dropped.
const MAX_NOTES: usize = 100;

/// The greatest speed of a simulated cell: at greater speeds the line of the virtual bar is the limit.
const MAX_SPEED: f64 = 100.0;

fn check_speed(speed: Option<f64>) -> Result<(), Diagnostic> {
    match speed {
        Some(speed) if !(speed > 0.0 && speed <= MAX_SPEED) => Err(Speed { most: MAX_SPEED }.into()),
        Some(_) | None => Ok(()),
    }
}

/// Frees the reserved line if the start of a run panics.
struct StartGuard<'a>(&'a Supervisor);

impl Drop for StartGuard<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.inner().run = LineUse::None;
        }
    }
}

impl Supervisor {
    /// Logs an action of the operator, and writes it into the capture of the current run or of the next one.
    fn note(&self, action: &str, detail: &str) {
        self.log.event(LogLevel::Info, "operator", &[("action", &action), ("detail", &detail)]);
        let unix_ms = clock::unix_ns() / 1_000_000;
        let event = RunEvent::Operator { unix_ms, action: action.into(), detail: detail.into() };
        let mut inner = self.inner();
        if let LineUse::On(running) = &inner.run
            && running.acquisition.note(event.clone())
        {
            return;
        }
        if inner.notes.len() >= MAX_NOTES {
            inner.notes.remove(0);
        }
        inner.notes.push(event);
    }
}

impl Supervisor {
    /// Notes the purpose of the plan of a run.
    fn note_plan(&self, run: &mut RunEntry) {
        let capture = self.config.data.join(&run.name).join(runs::CAPTURE);
        let plan = self.known.of_runs.of(&capture, run.started_unix_ms);
        run.is_check = plan.is_some_and(|plan| plan.is_check);
    }
}

impl Journal for Supervisor {
    fn warn(&self, event: &'static str, fields: &[(&str, &dyn Display)]) {
        self.journal.warn(event, fields);
    }
}

impl Service for Supervisor {
    fn status(&self) -> watch::Receiver<Status> {
        self.status.subscribe()
    }

    fn messages(&self) -> broadcast::Receiver<Message> {
        self.live.messages.subscribe()
    }

    fn points(&self) -> Vec<Point> {
        lock(&self.live.run).points.clone()
    }

    fn trace(&self) -> Vec<ReadingRange> {
        lock(&self.live.run).trace.iter().copied().collect()
    }

    fn catalogue(&self, which: Catalogue) -> Result<Value, Diagnostic> {
        let configured = self.config.port.as_ref();
        catalogue::list_catalogue(which, &self.known.plans, &self.config.plans, configured)
    }

    fn choose(&self, port: Option<String>, protocol: Option<String>) -> Result<(), Diagnostic> {
        if matches!(self.inner().run, LineUse::Reading(_)) {
            self.disconnect()?;
        }
        let mut inner = self.inner();
        if !matches!(inner.run, LineUse::None) {
            return Err(RunIsOn.into());
        }
        let address = port.as_deref().map(str::parse::<PortAddress>).transpose()?;
        if let Some((port, address)) = port.as_ref().zip(address.as_ref()) {
            // Clients may choose listed serial ports and the configured port, nothing else. A simulated cell is no device of
            // the service: a run asks for it.
            let is_listed = port::list_ports()?.iter().any(|one| one.is(port));
            if !is_listed && self.config.port.as_ref() != Some(address) {
                return Err(NoSuchPort { port: port.clone() }.into());
            }
        }
        if let Some(name) = &protocol {
            let configured = self.config.protocol.clone().filter(|configured| configured.id == *name);
            let found = configured.map(Ok).or_else(|| ProtocolDefinition::by_name(name));
            inner.protocol = Some(found.ok_or_else(|| NoSuchProtocol { protocol: name.clone() })??);
        }
        if address.is_some() {
            inner.port = address;
        }
        let status = self.current_status(&inner);
        drop(inner);
        self.status.send_replace(status);
        let chosen = [port, protocol].map(Option::unwrap_or_default).join(" ");
        self.note("choose", chosen.trim());
        Ok(())
    }

    fn connect(&self, ConnectRequest { plan, speed }: ConnectRequest) -> Result<(), Diagnostic> {
        check_speed(speed)?;
        if let Some(before) = self.reserve_line()? {
            before.end();
        }
        let detail = plan.clone().unwrap_or_default();
        self.release_line(self.begin(ReadPurpose::Reading { plan, speed }).map(Some))?;
        self.note("connect", &detail);
        Ok(())
    }

    fn disconnect(&self) -> Result<(), Diagnostic> {
        let before = self.reserve_line()?;
        let was_connected = before.is_some();
        if let Some(before) = before {
            before.end();
        }
        self.release_line(Ok(None))?;
        if was_connected {
            self.note("disconnect", "");
        }
        Ok(())
    }

    /// Sets the bar to zero. A reading is ended meanwhile: the command needs the line for itself.
    fn zero(&self) -> Result<(), Diagnostic> {
        let Some(running) = self.reserve_line()? else {
            self.release_line(Ok(None))?;
            return Err(NotRead.into());
        };
        let definition = running.definition.clone();
        if definition.zero.is_empty() {
            self.release_line(Ok(Some(running)))?;
            return Err(NoZeroCommand { protocol: definition.id }.into());
        }
        let ActiveRun { plan, line, acquisition, stop, .. } = running;
        let before_mm = acquisition.progress().counts.reading_mm;
        stop.store(true, Ordering::Relaxed);
        let zeroed = acquisition.join().and_then(|_| Ok(session::zero_bar(&line.port, &definition)?));
        self.release_line(self.open(ReadPurpose::Reading { plan, speed: None }, line).map(Some))?;
        zeroed?;
        self.note("zero", &before_mm.map_or(String::new(), |mm| format!("{mm:.4} mm before")));
        Ok(())
    }

    fn act(&self, act: Act) {
        self.note(act.name(), "");
    }

    fn start(&self, request: StartRequest) -> Result<(), Diagnostic> {
        if !runs::is_sound(&request.name) {
            return Err(RunName.into());
        }
        if request.duration_s.is_some_and(|s| !(s > 0.0 && s <= LONGEST_S)) {
            return Err(RunDuration { most_s: LONGEST_S }.into());
        }
        check_speed(request.speed)?;
        let reading = self.reserve_line()?;
        let _guard = StartGuard(self);
        if let Some(reading) = reading {
            reading.end();
        }
        let (name, plan) = (request.name.clone(), request.plan.clone().unwrap_or_default());
        let started = match &request.by {
            Some(by) => format!("{name} by {by}"),
            None => name.clone(),
        };
        let checked: Vec<&str> = request.checked.iter().copied().map(CheckItem::name).collect();
        let begun = self.begin(ReadPurpose::Run(request));
        let mut inner = self.inner();
        match begun {
            Ok(running) => {
                self.log.event(LogLevel::Info, "run_started", &[("run", &name), ("plan", &plan)]);
                inner.notes.retain(|note| !running.acquisition.note(note.clone()));
                inner.run = LineUse::On(Box::new(running));
                inner.failed = None;
                drop(inner);
                self.note("checked", &checked.join(" "));
                self.note("start", &started);
                self.tick();
                Ok(())
            }
            Err(refusal) => {
                inner.run = LineUse::None;
                let fields: &[(&str, &dyn Display)] =
                    &[("run", &name), ("code", &refusal.code()), ("reason", &refusal)];
                self.log.event(LogLevel::Warning, "run_refused", fields);
                Err(refusal)
            }
        }
    }

    fn stop(&self) -> Result<(), Diagnostic> {
        match &self.inner().run {
            LineUse::On(_) => {}
            LineUse::Starting => return Err(RunIsStarting.into()),
            LineUse::None | LineUse::Reading(_) => return Err(NoRunIsOn.into()),
        }
        self.note("stop", "");
        if let LineUse::On(running) = &self.inner().run {
            running.stop.store(true, Ordering::Relaxed);
        }
        Ok(())
    }

    fn mark(&self, text: String) -> Result<(), Diagnostic> {
        match &self.inner().run {
            LineUse::On(running) if running.acquisition.mark(text) => Ok(()),
            LineUse::On(_) | LineUse::None | LineUse::Starting | LineUse::Reading(_) => Err(NoRunIsOn.into()),
        }
    }

    fn runs(&self) -> Result<Vec<RunEntry>, Diagnostic> {
        let mut runs = runs::list_recorded_runs(&self.config.data, self.running().as_deref())?;
        runs.iter_mut().for_each(|run| self.note_plan(run));
        Ok(runs)
    }

    fn run(&self, name: &str) -> Result<RunEntry, Diagnostic> {
        let mut run = runs::entry(&self.config.data, name, self.running().as_deref())?;
        self.note_plan(&mut run);
        Ok(run)
    }

    fn file(&self, run: &str, result: Option<(JobKind, &str)>) -> Result<Download, Diagnostic> {
        runs::open_download(&self.config.data, run, result)
    }

    fn submit(&self, request: JobRequest) -> Result<EvaluationJob, Diagnostic> {
        if self.running().as_ref() == Some(&request.run) {
            return Err(ThisRunIsOn { run: request.run }.into());
        }
        let work = jobs::work_of(&request)?;
        let directory = runs::evaluable(&self.config.data, &request.run, request.kind)?;
        if request.kind == JobKind::Sync {
            dbbd_job::files::directory(&directory.join(request.kind.name()))?;
        }
        let subject = JobSubject { kind: request.kind.name(), run: request.run, step: None, results: None };
        let job = self.jobs.submit(subject, work, directory)?;
        let fields: &[(&str, &dyn Display)] = &[("job", &job.id), ("kind", &job.kind), ("run", &job.run)];
        self.log.event(LogLevel::Info, "job_taken", fields);
        Ok(job)
    }

    fn jobs(&self) -> Vec<EvaluationJob> {
        self.jobs.list()
    }

    fn job(&self, id: u64) -> Result<EvaluationJob, Diagnostic> {
        self.jobs.get(id)
    }

    fn cancel(&self, id: u64) -> Result<EvaluationJob, Diagnostic> {
        self.jobs.cancel(id)
    }
}
