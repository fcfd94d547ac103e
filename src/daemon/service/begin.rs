//! The begin of a run or a reading: port, plan, directory.

use std::fs::{self};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use serde_json::json;

use super::log::LogLevel;
use super::{ActiveRun, CellRequest, HaltBehaviour, LineUse, Supervisor, UnopenedLine};
use super::{catalogue, runs};
use crate::daemon::live_state::{LiveFeed, LiveRun};
use crate::daemon::{Acquisition, AcquisitionOptions, ControllerConnections, Schedule};
use crate::live::ServiceFinding::{
    DataUnwritable, Ending, NameTaken, NoPlan, NoPortChosen, ProtocolNotBuiltIn, RunIsOn, RunIsStarting,
};
use crate::live::{Message, StartRequest};
use dbbd_device::clock;
use dbbd_device::port::{self, PortAddress};
use dbbd_device::protocol::ProtocolDefinition;
use dbbd_device::sync::lock;
use dbbd_job::plan::{DEFAULT_PROTOCOL, SIGMA_UM};
use dbbd_job::recording::capture::CaptureWriter;
use dbbd_job::recording::mounting::{ExpectedMounting, RestCondition};
use dbbd_job::recording::run::PlanFiles;
use dbbd_model::diagnostic::{Diagnostic, Finding};
use dbbd_model::robot::Robot;

/// The reason for reading the bar.
pub(super) enum ReadPurpose {
    Run(StartRequest),
    /// The bar is shown against the stroke of a plan.
    Reading {
        plan: Option<String>,
        speed: Option<f64>,
    },
}

impl ReadPurpose {
    /// The speed of the simulated cell that is asked for in place of the bar.
    fn speed(&self) -> Option<f64> {
        match self {
            Self::Run(request) => request.speed,
            Self::Reading { speed, .. } => *speed,
        }
    }
}

impl Supervisor {
    /// Reserves the line to the bar. Returns the reading that uses it, which the caller must end.
    pub(super) fn reserve_line(&self) -> Result<Option<ActiveRun>, Diagnostic> {
        let mut inner = self.inner();
        if inner.ending {
            return Err(Ending.into());
        }
        match std::mem::replace(&mut inner.run, LineUse::Starting) {
            LineUse::None => Ok(None),
            LineUse::Reading(running) => Ok(Some(*running)),
            taken @ (LineUse::On(_) | LineUse::Starting) => {
                let refusal = if matches!(taken, LineUse::On(_)) { RunIsOn } else { RunIsStarting };
                inner.run = taken;
                Err(refusal.into())
            }
        }
    }

    /// Gives the reserved line to a reading, or frees it. An error is returned as it is.
    pub(super) fn release_line(
        &self,
        reading: Result<Option<ActiveRun>, Diagnostic>,
    ) -> Result<(), Diagnostic> {
        let (run, result) = match reading {
            Ok(Some(running)) => (LineUse::Reading(Box::new(running)), Ok(())),
            Ok(None) => (LineUse::None, Ok(())),
            Err(refusal) => (LineUse::None, Err(refusal)),
        };
        self.inner().run = run;
        self.tick();
        result
    }

    /// Opens the selected device and begins to read. The caller has reserved the line.
    pub(super) fn begin(&self, purpose: ReadPurpose) -> Result<ActiveRun, Diagnostic> {
        let (port, protocol) = {
            let inner = self.inner();
            (inner.port.clone(), inner.protocol.clone())
        };
        // A run of a simulated cell leaves the bar of the service as it is.
        let port = if purpose.speed().is_some() { Some(PortAddress::Sim) } else { port };
        let line = self.line(&purpose, port.ok_or(NoPortChosen)?, protocol)?;
        self.open(purpose, line)
    }

    /// The line to the bar at `port`. For a simulated port its cell is created.
    fn line(
        &self,
        purpose: &ReadPurpose,
        mut port: PortAddress,
        protocol: Option<ProtocolDefinition>,
    ) -> Result<UnopenedLine, Diagnostic> {
        let find = |name: &String| {
            catalogue::plan_file(&self.config.plans, name).ok_or_else(|| NoPlan { plan: name.clone() })
        };
        let (plan, halt) = match purpose {
            ReadPurpose::Run(request) => (&request.plan, HaltBehaviour::Continue),
            ReadPurpose::Reading { plan, .. } => (plan, HaltBehaviour::Wait),
        };
        let mut plan = plan.as_ref().map(find).transpose()?;
        let cell = match &self.simulated.make_cell {
            Some(make_cell) if port == PortAddress::Sim => Some(make_cell(&CellRequest {
                plan: plan.as_deref(),
                halt,
                speed: purpose.speed().unwrap_or(1.0),
            })?),
            _ => None,
        };
        // The bar of a cell speaks the protocol of its plan, whatever the bar of the service speaks.
        let protocol = protocol.filter(|_| cell.is_none());
        if let Some(cell) = &cell {
            (port, plan) = (cell.port().clone(), Some(cell.plan().into()));
        }
        if let Some(finding) = port::blur(&port) {
            let fields: &[(&str, &dyn std::fmt::Display)] = &[("code", &finding.code()), ("text", &finding)];
            self.log.event(LogLevel::Warning, "times_are_blurred", fields);
        }
        Ok(UnopenedLine { port, protocol, plan, _cell: cell })
    }

    pub(super) fn open(&self, purpose: ReadPurpose, line: UnopenedLine) -> Result<ActiveRun, Diagnostic> {
        let files = line.plan.as_deref().map(PlanFiles::read).transpose()?;
        let definition = line.protocol.clone().map_or_else(|| protocol_of(files.as_ref()), Ok)?;
        let schedule = match &files {
            Some(files) => Schedule::of(&files.plan, self.config.alarm_share),
            None => Schedule::bare(self.config.stroke_mm, self.config.alarm_share),
        };
        // After a run was stopped its program may still move the robot.
        let rest =
            if self.inner().last.is_some() { RestCondition::UnderWay } else { RestCondition::Standing };
        let expected = expected(&purpose, files.as_ref(), rest).with_resolution(definition.resolution_mm());
        let robot = files.as_ref().and_then(|files| {
            Robot::from_toml("robot", &files.plan.header.robot).ok().map(|robot| robot.name)
        });
        let stop = Arc::new(AtomicBool::new(false));
        let mut options = AcquisitionOptions {
            port: line.port.clone(),
            definition: definition.clone(),
            out: PathBuf::new(),
            plan: None,
            identity: self.config.identity.clone(),
            controller: ControllerConnections::default(),
            duration_s: None,
            gone_s: f64::INFINITY,
            sync_s: f64::INFINITY,
            feed: Some(LiveFeed::new(self.live.clone(), schedule.clone(), expected)),
        };
        *lock(&self.live.run) = LiveRun::default();
        let (name, by, plan, acquisition) = match purpose {
            ReadPurpose::Reading { plan, speed: _ } => {
                let nowhere = CaptureWriter::on(Box::new(io::sink()), Path::new("live"))?;
                let acquisition = Acquisition::start_on(nowhere, options, Arc::clone(&stop))?;
                (String::new(), None, plan, acquisition)
            }
            ReadPurpose::Run(request) => {
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
                (request.name, request.by, request.plan, acquisition)
            }
        };
        Ok(ActiveRun {
            name,
            by,
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
        fs::create_dir(&directory).map_err(|error| {
            if error.kind() == io::ErrorKind::AlreadyExists {
                NameTaken { run: name.into() }
            } else {
                unwritable(error)
            }
        })?;
        Ok(directory)
    }
}

/// The readings that the mounting monitor expects.
fn expected(purpose: &ReadPurpose, files: Option<&PlanFiles>, rest: RestCondition) -> ExpectedMounting {
    match (purpose, files) {
        (ReadPurpose::Run(_), Some(files)) => ExpectedMounting::of(&files.plan, RestCondition::Program),
        (ReadPurpose::Run(_), None) => ExpectedMounting::unplanned(SIGMA_UM),
        (ReadPurpose::Reading { .. }, files) => {
            let sigma_um = files.map_or(SIGMA_UM, |files| files.plan.header.job.bar.sigma_um);
            ExpectedMounting { rest, ..ExpectedMounting::standing(sigma_um) }
        }
    }
}

/// The protocol that the plan names, else the default. Both must be built in.
fn protocol_of(plan: Option<&PlanFiles>) -> Result<ProtocolDefinition, Diagnostic> {
    let name = plan.map_or(DEFAULT_PROTOCOL, |files| &files.plan.header.job.bar.protocol);
    ProtocolDefinition::by_name(name).ok_or_else(|| ProtocolNotBuiltIn { protocol: name.into() })?
}
