//! `--port sim`: a simulated cell as a child process, its programs in a directory that goes with it.

use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::base::files;
use crate::catalogue::FileFinding;
use crate::cli::child::{LOOPBACK, Simulator, Steps};
use crate::cli::{Output, demo};
use crate::device::port::PortAddress;
use crate::diagnostic::Diagnostic;
use crate::plan::{Plan, Taught};
use crate::recording::run::read_plan;
use crate::robot::Robot;
use crate::sim::truth;

/// A simulator that runs a plan.
pub(crate) struct Cell {
    simulator: Simulator,
    plan: PathBuf,
    directory: TempDir,
}

/// A directory of this user's own that nobody could have made before; it goes with its value.
fn private_directory() -> Result<TempDir, Diagnostic> {
    let mut builder = tempfile::Builder::new();
    builder.prefix("dbbd-sim-");
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o700));
    let made = builder.tempdir();
    made.map_err(|error| {
        let why = FileFinding::NoDirectory { why: error.to_string() };
        Diagnostic::file(&std::env::temp_dir().display().to_string(), why)
    })
}

/// A world whose robot and bar repeat as the plan counts on, and whose base balls stand where it has them taught.
fn world(plan: &Plan, robot: &Robot) -> String {
    let table = |Taught { centre, axes_deg }: Taught| {
        format!("[[centre]]\nid = {centre}\ntaught_deg = {axes_deg:?}\n")
    };
    let noise = truth::noise(robot, plan.header.job.bar.sigma_um);
    std::iter::once(noise).chain(plan.taught().map(table)).collect()
}

impl Cell {
    /// Starts the simulator on `plan`, or on the demo's; `speed` is device time in host time, 0 for as
    /// fast as the bytes are taken. Its program reports its dwells to `server`, if there is one.
    ///
    /// # Errors
    /// When a step on the way to its programs fails.
    pub(crate) fn start(
        plan: Option<&Path>,
        speed: &str,
        server: Option<SocketAddr>,
        out: &Output,
    ) -> Result<Self, Diagnostic> {
        Self::start_at(plan, speed, "2", server, out)
    }

    /// The same with a program that waits at each HALT for so many seconds.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub(crate) fn start_at(
        plan: Option<&Path>,
        speed: &str,
        halt_s: &str,
        server: Option<SocketAddr>,
        out: &Output,
    ) -> Result<Self, Diagnostic> {
        let directory = private_directory()?;
        let inside = directory.path();
        let steps = Steps::new(inside, out);
        let plan = match plan {
            Some(plan) => std::path::absolute(plan).map_err(|error| {
                let why = error.to_string();
                Diagnostic::file(&plan.display().to_string(), FileFinding::Unreadable { why })
            })?,
            None => {
                files::write(&inside.join("job.toml"), demo::JOB)?;
                steps.run(&["plan", "job.toml", "--out", "plan"])?;
                inside.join("plan/plan.csv")
            }
        };
        let plan_name = plan.display().to_string();
        let read = read_plan(&plan)?;
        // The controller's, where the plan was made on an identified one.
        let robot = Robot::from_toml("the plan's robot", &read.header.robot)?;
        files::write(&inside.join("robot.toml"), robot.controller().to_toml()?)?;
        files::write(&inside.join("world.toml"), world(&read, &robot))?;
        let mut emit = vec!["krl", plan_name.as_str(), "--out", "krl", "--controller", "simulated"];
        let mut simulate = vec!["simulate", "--program", "krl/DBB_MAIN.src", "--nominal", "robot.toml"];
        simulate.extend(["--world", "world.toml", "--speed", speed, "--halt", halt_s]);
        simulate.extend(["--listen", LOOPBACK]);
        let address = server.map(|server| match server.ip().is_unspecified() {
            true => SocketAddr::from((Ipv4Addr::LOCALHOST, server.port())).to_string(),
            false => server.to_string(),
        });
        if let Some(address) = address.as_deref() {
            emit.extend(["--sync", "ekrl", "--server", address]);
            simulate.extend(["--ekrl", address]);
        }
        steps.run(&emit)?;
        let simulator = steps.start(&simulate)?;
        Ok(Self { simulator, plan, directory })
    }

    /// Where the virtual bar is.
    pub(crate) fn port(&self) -> &PortAddress {
        self.simulator.port()
    }

    /// The plan that it runs.
    pub(crate) fn plan(&self) -> &Path {
        &self.plan
    }

    /// Waits for its end.
    ///
    /// # Errors
    /// When it failed.
    pub(crate) fn finish(self) -> Result<(), Diagnostic> {
        let Self { simulator, plan: _, directory: _directory } = self;
        simulator.finish()
    }
}
