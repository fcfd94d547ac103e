//! What the service answers to the pages.

use std::fmt::Display;
use std::sync::atomic::Ordering;

use serde_json::Value;
use tokio::sync::{broadcast, watch};

use super::begin::Aim;
use super::log::Level;
use super::state::{Run, Supervisor};
use super::{catalogue, jobs, names, runs};
use crate::base::sync::lock;
use crate::catalogue::ServiceFinding::{
    NoPortChosen, NoRunIsOn, NoSuchPort, NoSuchProtocol, RunDuration, RunIsOn, RunIsStarting, RunName,
    ThisRunIsOn,
};
use crate::device::port::{self, PortAddress};
use crate::device::protocol::Definition;
use crate::diagnostic::Diagnostic;
use crate::live::{
    Act, Catalogue, CheckItem, Download, Job, JobKind, JobRequest, Journal, Message, Point, RunEntry,
    Service, StartRequest, Status,
};

/// The longest run that may be asked for, s.
const LONGEST_S: f64 = 1e6;

/// The place of a run that is starting: free again where the start panics.
struct Place<'a>(&'a Supervisor);

impl Drop for Place<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.inner().run = Run::None;
        }
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
        lock(&self.live.points).clone()
    }

    fn catalogue(&self, which: Catalogue) -> Result<Value, Diagnostic> {
        catalogue::list(which, &self.plans, &self.config.plans)
    }

    fn choose(&self, port: Option<String>, protocol: Option<String>) -> Result<(), Diagnostic> {
        if matches!(self.inner().run, Run::Reading(_)) {
            self.end_reading()?;
        }
        let mut inner = self.inner();
        if !matches!(inner.run, Run::None) {
            return Err(RunIsOn.into());
        }
        let address = port.as_deref().map(str::parse::<PortAddress>).transpose()?;
        if let Some((port, address)) = port.as_ref().zip(address.as_ref()) {
            // Only what is a serial port may be opened, or what the configuration named.
            let listed =
                port::list()?.iter().any(|one| one.port == *port || one.by_id.as_ref() == Some(port));
            if !listed && !self.is_simulated(address) && self.config.port.as_ref() != Some(address) {
                return Err(NoSuchPort { port: port.clone() }.into());
            }
        }
        if let Some(name) = &protocol {
            let configured = self.config.protocol.clone().filter(|configured| configured.id == *name);
            let found = configured.map(Ok).or_else(|| Definition::by_name(name));
            inner.protocol = Some(found.ok_or_else(|| NoSuchProtocol { protocol: name.clone() })??);
        }
        let chosen = [&port, &protocol].map(|one| one.clone().unwrap_or_default()).join(" ");
        if address.is_some() {
            inner.port = address;
        }
        let status = self.look(&inner);
        drop(inner);
        self.status.send_replace(status);
        self.note("choose", chosen.trim());
        Ok(())
    }

    fn connect(&self, plan: Option<String>) -> Result<(), Diagnostic> {
        self.read(plan)
    }

    fn disconnect(&self) -> Result<(), Diagnostic> {
        self.end_reading()
    }

    fn zero(&self) -> Result<(), Diagnostic> {
        self.set_zero()
    }

    fn act(&self, act: Act) {
        self.note(act.name(), "");
    }

    fn start(&self, request: StartRequest) -> Result<(), Diagnostic> {
        if !names::is_sound(&request.name) {
            return Err(RunName.into());
        }
        if request.duration_s.is_some_and(|s| !(s > 0.0 && s <= LONGEST_S)) {
            return Err(RunDuration { most_s: LONGEST_S }.into());
        }
        let reading = self.take_place()?;
        let _place = Place(self);
        if let Some(reading) = reading {
            reading.end();
        }
        let (port, protocol) = {
            let inner = self.inner();
            (inner.port.clone(), inner.protocol.clone())
        };
        let (name, plan) = (request.name.clone(), request.plan.clone().unwrap_or_default());
        let checked: Vec<&str> = request.checked.iter().copied().map(CheckItem::name).collect();
        let checked = checked.join(" ");
        let begun = match port {
            Some(port) => self.begin(Aim::Run(request), port, protocol),
            None => Err(NoPortChosen.into()),
        };
        let mut inner = self.inner();
        match begun {
            Ok(running) => {
                self.log.say(Level::Info, "run_started", &[("run", &name), ("plan", &plan)]);
                std::mem::take(&mut inner.notes).into_iter().for_each(|note| running.acquisition.note(note));
                inner.run = Run::On(Box::new(running));
                inner.failed = None;
                drop(inner);
                self.note("checked", &checked);
                self.note("start", &name);
                self.tick();
                Ok(())
            }
            Err(refusal) => {
                inner.run = Run::None;
                let fields: [(&str, &dyn Display); 3] =
                    [("run", &name), ("code", &refusal.code), ("reason", &refusal)];
                self.log.say(Level::Warning, "run_refused", &fields);
                Err(refusal)
            }
        }
    }

    fn stop(&self) -> Result<(), Diagnostic> {
        match &self.inner().run {
            Run::On(_) => {}
            Run::Starting => return Err(RunIsStarting.into()),
            Run::None | Run::Reading(_) => return Err(NoRunIsOn.into()),
        }
        self.note("stop", "");
        if let Run::On(running) = &self.inner().run {
            running.stop.store(true, Ordering::Relaxed);
        }
        Ok(())
    }

    fn mark(&self, text: String) -> Result<(), Diagnostic> {
        match &self.inner().run {
            Run::On(running) => running.acquisition.mark(text),
            Run::None | Run::Starting | Run::Reading(_) => return Err(NoRunIsOn.into()),
        }
        Ok(())
    }

    fn runs(&self) -> Result<Vec<RunEntry>, Diagnostic> {
        runs::list(&self.config.data, self.running().as_deref())
    }

    fn run(&self, name: &str) -> Result<RunEntry, Diagnostic> {
        runs::entry(&self.config.data, name, self.running().as_deref())
    }

    fn file(&self, run: &str, result: Option<(JobKind, &str)>) -> Result<Download, Diagnostic> {
        runs::open(&self.config.data, run, result)
    }

    fn submit(&self, request: JobRequest) -> Result<Job, Diagnostic> {
        if self.running().as_ref() == Some(&request.run) {
            return Err(ThisRunIsOn { run: request.run }.into());
        }
        let args = jobs::arguments(&request)?;
        let directory = runs::evaluable(&self.config.data, &request.run, request.kind)?;
        let job = self.jobs.submit(request, args, directory)?;
        let fields: [(&str, &dyn Display); 3] =
            [("job", &job.id), ("kind", &job.kind.name()), ("run", &job.run)];
        self.log.say(Level::Info, "job_taken", &fields);
        Ok(job)
    }

    fn jobs(&self) -> Vec<Job> {
        self.jobs.list()
    }

    fn job(&self, id: u64) -> Result<Job, Diagnostic> {
        self.jobs.get(id)
    }

    fn cancel(&self, id: u64) -> Result<Job, Diagnostic> {
        self.jobs.cancel(id)
    }
}
