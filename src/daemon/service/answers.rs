//! What the service answers to the pages.

use std::fmt::Display;
use std::sync::PoisonError;
use std::sync::atomic::Ordering;

use serde_json::Value;
use tokio::sync::{broadcast, watch};

use super::log::Level;
use super::state::{Run, Supervisor};
use super::{catalogue, names, runs, trial_cell};
use crate::live::{
    Catalogue, Download, Job, JobKind, JobRequest, Message, Point, Refusal, RunEntry, Service, StartRequest,
    Status,
};
use crate::port;
use crate::protocol::Definition;

/// The longest run that may be asked for, s.
const LONGEST_S: f64 = 1e6;

impl Service for Supervisor {
    fn status(&self) -> watch::Receiver<Status> {
        self.status.subscribe()
    }

    fn messages(&self) -> broadcast::Receiver<Message> {
        self.shown.messages.subscribe()
    }

    fn points(&self) -> Vec<Point> {
        self.shown.points.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn catalogue(&self, which: Catalogue) -> Result<Value, Refusal> {
        catalogue::list(which, &self.config.plans)
    }

    fn choose(&self, port: Option<String>, protocol: Option<String>) -> Result<(), Refusal> {
        let mut inner = self.inner();
        if !matches!(inner.run, Run::None) {
            return Err(Refusal::Conflict("a run is on: stop it first".into()));
        }
        if let Some(port) = &port {
            // Only what is a serial port may be opened, or what the configuration named.
            let listed = port::list().map_err(|error| Refusal::Failed(error.to_string()))?;
            let listed = listed.iter().any(|one| one.port == *port || one.by_id.as_ref() == Some(port));
            let simulated = *port == trial_cell::PORT && self.bench.is_some();
            if !listed && !simulated && self.config.port.as_ref() != Some(port) {
                return Err(Refusal::Missing(format!("there is no port `{port}`")));
            }
        }
        if let Some(name) = &protocol {
            let configured = self.config.protocol.clone().filter(|configured| configured.id == *name);
            let found = configured.map(Ok).or_else(|| Definition::by_name(name));
            let unknown = || Refusal::Missing(format!("there is no protocol `{name}`"));
            let definition = found.ok_or_else(unknown)?;
            inner.protocol = Some(definition.map_err(|error| Refusal::Invalid(error.to_string()))?);
        }
        if port.is_some() {
            inner.port = port;
        }
        let status = self.look(&inner);
        drop(inner);
        self.status.send_replace(status);
        Ok(())
    }

    fn start(&self, request: StartRequest) -> Result<(), Refusal> {
        if !names::is_sound(&request.name) {
            let message =
                "a run's name has 1 to 64 letters, digits, `.`, `_`, `-`, and begins with a letter or digit";
            return Err(Refusal::Invalid(message.into()));
        }
        if request.duration_s.is_some_and(|s| !(s > 0.0 && s <= LONGEST_S)) {
            return Err(Refusal::Invalid(format!("duration_s must be above 0 and at most {LONGEST_S}")));
        }
        let (port, protocol) = {
            let mut inner = self.inner();
            if !matches!(inner.run, Run::None) {
                return Err(Refusal::Conflict("a run is on: stop it first".into()));
            }
            if inner.ending {
                return Err(Refusal::Conflict("dbbd is about to end".into()));
            }
            let none = || Refusal::Conflict("no port was chosen".into());
            let port = inner.port.clone().ok_or_else(none)?;
            inner.run = Run::Starting;
            (port, inner.protocol.clone())
        };
        let begun = self.begin(&request, port, protocol);
        let mut inner = self.inner();
        match begun {
            Ok(running) => {
                let plan = request.plan.as_deref().unwrap_or("");
                self.log.say(Level::Info, "run_started", &[("run", &request.name), ("plan", &plan)]);
                inner.run = Run::On(Box::new(running));
                inner.failed = None;
                drop(inner);
                self.tick();
                Ok(())
            }
            Err(refusal) => {
                inner.run = Run::None;
                self.log.say(Level::Warning, "run_refused", &[("run", &request.name), ("reason", &refusal)]);
                Err(refusal)
            }
        }
    }

    fn stop(&self) -> Result<(), Refusal> {
        match &self.inner().run {
            Run::On(running) => running.stop.store(true, Ordering::Relaxed),
            Run::Starting => return Err(Refusal::Conflict("the run is just starting".into())),
            Run::None => return Err(Refusal::Conflict("no run is on".into())),
        }
        Ok(())
    }

    fn mark(&self, text: String) -> Result<(), Refusal> {
        match &self.inner().run {
            Run::On(running) => running.acquisition.mark(text),
            Run::None | Run::Starting => return Err(Refusal::Conflict("no run is on".into())),
        }
        Ok(())
    }

    fn runs(&self) -> Result<Vec<RunEntry>, Refusal> {
        runs::list(&self.config.data, self.running().as_deref())
    }

    fn run(&self, name: &str) -> Result<RunEntry, Refusal> {
        runs::entry(&self.config.data, name, self.running().as_deref())
    }

    fn file(&self, run: &str, result: Option<(JobKind, &str)>) -> Result<Download, Refusal> {
        runs::open(&self.config.data, run, result)
    }

    fn submit(&self, request: JobRequest) -> Result<Job, Refusal> {
        let directory = runs::directory(&self.config.data, &request.run)?;
        if self.running().as_ref() == Some(&request.run) {
            return Err(Refusal::Conflict(format!("run `{}` is on: stop it first", request.run)));
        }
        if !directory.join(runs::CAPTURE).is_file() {
            return Err(Refusal::Missing(format!("there is no run `{}`", request.run)));
        }
        let job = self.jobs.submit(request, directory)?;
        let fields: [(&str, &dyn Display); 3] =
            [("job", &job.id), ("kind", &job.kind.name()), ("run", &job.run)];
        self.log.say(Level::Info, "job_taken", &fields);
        Ok(job)
    }

    fn jobs(&self) -> Vec<Job> {
        self.jobs.list()
    }

    fn job(&self, id: u64) -> Result<Job, Refusal> {
        self.jobs.get(id)
    }

    fn cancel(&self, id: u64) -> Result<Job, Refusal> {
        self.jobs.cancel(id)
    }
}
