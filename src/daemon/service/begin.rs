//! What begins a run or a reading: its line, its plan, its directory.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use serde_json::json;

use super::log::Level;
use super::state::{Line, Running, Supervisor};
use super::trial_cell::Program;
use super::{catalogue, runs};
use crate::base::clock;
use crate::base::sync::lock;
use crate::catalogue::ServiceFinding::{DataUnwritable, NameTaken, NoPlan, ProtocolNotBuiltIn};
use crate::daemon::live_state::{Feed, LiveState};
use crate::daemon::{Acquisition, Options, Schedule};
use crate::device::port::{self, PortAddress};
use crate::device::protocol::Definition;
use crate::diagnostic::{Diagnostic, Finding};
use crate::live::{Message, Mounting, StartRequest};
use crate::plan::{DEFAULT_PROTOCOL, SIGMA_UM};
use crate::recording::capture::{Disk, Writer};
use crate::recording::mounting::{Expected, Rest};
use crate::recording::run::PlanFiles;
use crate::robot::Robot;

/// What the bar is read for.
pub(super) enum Aim {
    Run(StartRequest),
    /// To see it against the stroke of a plan.
    Reading {
        plan: Option<String>,
    },
}

/// Keeps nothing.
struct Nowhere;

impl Write for Nowhere {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Disk for Nowhere {
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

/// A capture that is not kept.
fn nowhere() -> Result<Writer, Diagnostic> {
    Writer::on(Box::new(Nowhere), Path::new("live"))
}

impl Supervisor {
    /// The line to the bar at `port`; where that is simulated, its cell is made.
    fn line(
        &self,
        aim: &Aim,
        mut port: PortAddress,
        protocol: Option<Definition>,
    ) -> Result<Line, Diagnostic> {
        let find = |name: &String| {
            catalogue::plan_file(&self.config.plans, name).ok_or_else(|| NoPlan { plan: name.clone() })
        };
        let (plan, program) = match aim {
            Aim::Run(request) => (&request.plan, Program::Runs),
            Aim::Reading { plan } => (plan, Program::Waits),
        };
        let mut plan = plan.as_ref().map(find).transpose()?;
        let cell = match &self.bench {
            Some(bench) if port == PortAddress::Sim => Some(bench(plan.as_deref(), program)?),
            _ => None,
        };
        if let Some(cell) = &cell {
            (port, plan) = (cell.port().clone(), Some(cell.plan().into()));
        }
        if let Some(finding) = port::blur(&port) {
            let fields: [(&str, &dyn std::fmt::Display); 2] = [("code", &finding.code()), ("text", &finding)];
            self.log.say(Level::Warning, "times_are_blurred", &fields);
        }
        Ok(Line { port, protocol, plan, _cell: cell })
    }

    /// Opens the device and begins; the caller holds the place of the run.
    pub(super) fn begin(
        &self,
        aim: Aim,
        port: PortAddress,
        protocol: Option<Definition>,
    ) -> Result<Running, Diagnostic> {
        let line = self.line(&aim, port, protocol)?;
        self.open(aim, line)
    }

    /// The same on a line.
    pub(super) fn open(&self, aim: Aim, line: Line) -> Result<Running, Diagnostic> {
        let files = line.plan.as_deref().map(PlanFiles::read).transpose()?;
        let definition = line.protocol.clone().map_or_else(|| protocol_of(files.as_ref()), Ok)?;
        let schedule = match &files {
            Some(files) => Schedule::of(&files.plan, self.config.alarm_share),
            None => Schedule::bare(self.config.stroke_mm, self.config.alarm_share),
        };
        // The program of a run that was stopped goes on.
        let rest = if self.inner().last.is_some() { Rest::UnderWay } else { Rest::Standing };
        let expected = expected(&aim, files.as_ref(), rest).with_resolution(definition.resolution_mm());
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
            duration_s: None,
            gone_s: f64::INFINITY,
            sync_s: f64::INFINITY,
            feed: Some(Feed::new(self.live.clone(), schedule.clone(), expected)),
        };
        self.forget();
        let (name, plan, acquisition) = match aim {
            Aim::Reading { plan } => {
                let acquisition = Acquisition::start_on(nowhere()?, options, Arc::clone(&stop))?;
                (String::new(), plan, acquisition)
            }
            Aim::Run(request) => {
                let directory = self.reserve(&request.name)?;
                let begin = json!({ "name": request.name, "plan": request.plan });
                let _ = self.live.messages.send(Message::new("begin", &begin));
                options.out = directory.join(runs::CAPTURE);
                (options.plan, options.duration_s) = (files, request.duration_s);
                (options.gone_s, options.sync_s) = (self.config.gone_s, 1.0);
                let begun = Acquisition::start(options, Arc::clone(&stop));
                let acquisition = begun.inspect_err(|_| {
                    // Nothing was recorded: the name stays free. What else is in there stays.
                    let _ = fs::remove_dir(&directory);
                })?;
                (request.name, request.plan, acquisition)
            }
        };
        let started_unix_ms = clock::unix_ns() / 1_000_000;
        Ok(Running {
            name,
            plan,
            robot,
            started_unix_ms,
            schedule,
            acquisition,
            interferences: Vec::new(),
            stop,
            definition,
            line,
        })
    }

    /// What is shown is that of the run to come.
    fn forget(&self) {
        let LiveState { points, clock_ahead_ms, mounting, .. } = &self.live;
        lock(points).clear();
        *lock(clock_ahead_ms) = None;
        *lock(mounting) = Mounting::default();
    }

    /// A directory for a run of that name.
    fn reserve(&self, name: &str) -> Result<PathBuf, Diagnostic> {
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

/// What is expected of the bar's readings.
fn expected(aim: &Aim, files: Option<&PlanFiles>, rest: Rest) -> Expected {
    match (aim, files) {
        (Aim::Run(_), Some(files)) => Expected::of(&files.plan, Rest::Program),
        (Aim::Run(_), None) => Expected::unplanned(SIGMA_UM),
        (Aim::Reading { .. }, files) => {
            let sigma_um = files.map_or(SIGMA_UM, |files| files.plan.header.job.bar.sigma_um);
            Expected { rest, ..Expected::standing(sigma_um) }
        }
    }
}

/// The protocol that the plan names, else the default; both built in.
fn protocol_of(plan: Option<&PlanFiles>) -> Result<Definition, Diagnostic> {
    let name = plan.map_or(DEFAULT_PROTOCOL, |files| &files.plan.header.job.bar.protocol);
    Definition::by_name(name).ok_or_else(|| ProtocolNotBuiltIn { protocol: name.into() })?
}
