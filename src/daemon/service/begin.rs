//! The begin of a run or a reading: port, plan, directory.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use serde_json::json;

use super::log::Level;
use super::state::{Halt, Line, Run, Running, Supervisor};
use super::{catalogue, runs};
use crate::base::clock;
use crate::base::sync::lock;
use crate::catalogue::ServiceFinding::{
    DataUnwritable, Ending, NameTaken, NoPlan, NoPortChosen, ProtocolNotBuiltIn, RunIsOn, RunIsStarting,
};
use crate::daemon::live_state::{Feed, LiveRun};
use crate::daemon::{Acquisition, Controller, Options, Schedule};
use crate::device::port::{self, PortAddress};
use crate::device::protocol::Definition;
use crate::diagnostic::{Diagnostic, Finding};
use crate::live::{Message, StartRequest};
use crate::plan::{DEFAULT_PROTOCOL, SIGMA_UM};
use crate::recording::capture::{Disk, Writer};
use crate::recording::mounting::{Expected, Rest};
use crate::recording::run::PlanFiles;
use crate::robot::Robot;

/// Why the bar is read.
pub(super) enum Purpose {
    Run(StartRequest),
    /// To show the bar against the stroke of a plan.
    Reading {
        plan: Option<String>,
    },
}

/// A capture that is not kept.
impl Disk for io::Sink {
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }

    fn cut(&mut self, _: u64) -> io::Result<()> {
        Ok(())
    }

    fn copy(&mut self, _: u64, _: &mut File) -> io::Result<()> {
        Ok(())
    }
}

impl Supervisor {
    /// Reserves the line to the bar. Returns the reading that uses it, which the caller must end.
    pub(super) fn reserve_line(&self) -> Result<Option<Running>, Diagnostic> {
        let mut inner = self.inner();
        if inner.ending {
            return Err(Ending.into());
        }
        match std::mem::replace(&mut inner.run, Run::Starting) {
            Run::None => Ok(None),
            Run::Reading(running) => Ok(Some(*running)),
            taken @ (Run::On(_) | Run::Starting) => {
                let refusal = if matches!(taken, Run::On(_)) { RunIsOn } else { RunIsStarting };
                inner.run = taken;
                Err(refusal.into())
            }
        }
    }

    /// Gives the reserved line to a reading, or frees it. An error is passed on.
    pub(super) fn release_line(
        &self,
        reading: Result<Option<Running>, Diagnostic>,
    ) -> Result<(), Diagnostic> {
        let (run, result) = match reading {
            Ok(Some(running)) => (Run::Reading(Box::new(running)), Ok(())),
            Ok(None) => (Run::None, Ok(())),
            Err(refusal) => (Run::None, Err(refusal)),
        };
        self.inner().run = run;
        self.tick();
        result
    }

    /// Opens the selected device and begins to read. The caller has reserved the line.
    pub(super) fn begin(&self, purpose: Purpose) -> Result<Running, Diagnostic> {
        let (port, protocol) = {
            let inner = self.inner();
            (inner.port.clone(), inner.protocol.clone())
        };
        let line = self.line(&purpose, port.ok_or(NoPortChosen)?, protocol)?;
        self.open(purpose, line)
    }

    /// The line to the bar at `port`. For a simulated port its cell is created.
    fn line(
        &self,
        purpose: &Purpose,
        mut port: PortAddress,
        protocol: Option<Definition>,
    ) -> Result<Line, Diagnostic> {
        let find = |name: &String| {
            catalogue::plan_file(&self.config.plans, name).ok_or_else(|| NoPlan { plan: name.clone() })
        };
        let (plan, halt) = match purpose {
            Purpose::Run(request) => (&request.plan, Halt::Continue),
            Purpose::Reading { plan } => (plan, Halt::Wait),
        };
        let mut plan = plan.as_ref().map(find).transpose()?;
        let cell = match &self.make_cell {
            Some(make_cell) if port == PortAddress::Sim => Some(make_cell(plan.as_deref(), halt)?),
            _ => None,
        };
        if let Some(cell) = &cell {
            (port, plan) = (cell.port().clone(), Some(cell.plan().into()));
        }
        if let Some(finding) = port::blur(&port) {
            let fields: &[(&str, &dyn std::fmt::Display)] = &[("code", &finding.code()), ("text", &finding)];
            self.log.event(Level::Warning, "times_are_blurred", fields);
        }
        Ok(Line { port, protocol, plan, _cell: cell })
    }

    pub(super) fn open(&self, purpose: Purpose, line: Line) -> Result<Running, Diagnostic> {
        let files = line.plan.as_deref().map(PlanFiles::read).transpose()?;
        let definition = line.protocol.clone().map_or_else(|| protocol_of(files.as_ref()), Ok)?;
        let schedule = match &files {
            Some(files) => Schedule::of(&files.plan, self.config.alarm_share),
            None => Schedule::bare(self.config.stroke_mm, self.config.alarm_share),
        };
        // After a run was stopped its program may still move the robot.
        let rest = if self.inner().last.is_some() { Rest::UnderWay } else { Rest::Standing };
        let expected = expected(&purpose, files.as_ref(), rest).with_resolution(definition.resolution_mm());
        let robot = files.as_ref().and_then(|files| {
            Robot::from_toml("robot", &files.plan.header.robot).ok().map(|robot| robot.name)
        });
        let stop = Arc::new(AtomicBool::new(false));
        let mut options = Options {
            port: line.port.clone(),
            definition: definition.clone(),
            out: PathBuf::new(),
            plan: None,
            identity: self.config.identity.clone(),
            controller: Controller::default(),
            duration_s: None,
            gone_s: f64::INFINITY,
            sync_s: f64::INFINITY,
            feed: Some(Feed::new(self.live.clone(), schedule.clone(), expected)),
        };
        *lock(&self.live.run) = LiveRun::default();
        let (name, plan, acquisition) = match purpose {
            Purpose::Reading { plan } => {
                let nowhere = Writer::on(Box::new(io::sink()), Path::new("live"))?;
                let acquisition = Acquisition::start_on(nowhere, options, Arc::clone(&stop))?;
                (String::new(), plan, acquisition)
            }
            Purpose::Run(request) => {
                let directory = self.create_directory(&request.name)?;
                let begin = json!({ "name": request.name, "plan": request.plan });
                let _ = self.live.messages.send(Message::new("begin", &begin));
                options.out = directory.join(runs::CAPTURE);
                (options.plan, options.duration_s) = (files, request.duration_s);
                (options.gone_s, options.sync_s) = (self.config.gone_s, 1.0);
                let begun = Acquisition::start(options, Arc::clone(&stop));
                let acquisition = begun.inspect_err(|_| {
                    // Nothing was recorded: free the name. Fails if the directory has other files, which stay.
                    let _ = fs::remove_dir(&directory);
                })?;
                (request.name, request.plan, acquisition)
            }
        };
        Ok(Running {
            name,
            plan,
            robot,
            started_unix_ms: clock::unix_ns() / 1_000_000,
            schedule,
            acquisition,
            interferences: Vec::new(),
            stop,
            definition,
            line,
        })
    }

    /// Creates the directory of a run.
    fn create_directory(&self, name: &str) -> Result<PathBuf, Diagnostic> {
        let unwritable = |error: io::Error| DataUnwritable { why: error.to_string() };
        fs::create_dir_all(&self.config.data).map_err(unwritable)?;
        let directory = runs::directory(&self.config.data, name)?;
        fs::create_dir(&directory).map_err(|error| match error.kind() {
            io::ErrorKind::AlreadyExists => NameTaken { run: name.into() },
            _ => unwritable(error),
        })?;
        Ok(directory)
    }
}

/// What the mounting monitor expects of the readings.
fn expected(purpose: &Purpose, files: Option<&PlanFiles>, rest: Rest) -> Expected {
    match (purpose, files) {
        (Purpose::Run(_), Some(files)) => Expected::of(&files.plan, Rest::Program),
        (Purpose::Run(_), None) => Expected::unplanned(SIGMA_UM),
        (Purpose::Reading { .. }, files) => {
            let sigma_um = files.map_or(SIGMA_UM, |files| files.plan.header.job.bar.sigma_um);
            Expected { rest, ..Expected::standing(sigma_um) }
        }
    }
}

/// The protocol that the plan names, else the default. Both must be built in.
fn protocol_of(plan: Option<&PlanFiles>) -> Result<Definition, Diagnostic> {
    let name = plan.map_or(DEFAULT_PROTOCOL, |files| &files.plan.header.job.bar.protocol);
    Definition::by_name(name).ok_or_else(|| ProtocolNotBuiltIn { protocol: name.into() })?
}
