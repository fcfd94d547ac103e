//! `--port sim`: a simulated cell as a child process, with its programs in a temporary directory.

use dbbd_model::base::text::unreadable;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::cli::child::{ChildCommands, LOOPBACK, Simulator};
use crate::cli::{CommandOutput, demo};
use dbbd_device::port::PortAddress;
use dbbd_job::files;
use dbbd_job::plan::{Plan, TaughtBall};
use dbbd_job::recording::run::{PlanFiles, read_plan};
use dbbd_job::request;
use dbbd_job::sim::truth;
use dbbd_model::base::FileFinding;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::Robot;

/// How long a program waits at its HALT, s.
pub(crate) const HALT_S: &str = "2";

/// Device time per host time of a bar whose line must settle, and how much longer than that its program waits, s.
const SETTLING_SPEED: f64 = 20.0;
const SETTLING_MARGIN_S: f64 = 1.0;

/// How a simulated cell runs.
#[derive(Clone, Copy)]
pub(crate) struct CellOptions<'a> {
    /// Device time per host time; 0: as fast as the bytes are read.
    pub speed: &'a str,
    /// How long the program waits at each HALT, s.
    pub halt_s: &'a str,
    /// Where the program reports its dwells over EthernetKRL.
    pub server: Option<SocketAddr>,
    /// The protocol of the bar with its parameters; `None` for that of the plan.
    pub protocol: Option<(&'a str, &'a [(String, String)])>,
    pub seed: Option<u64>,
}

impl<'a> CellOptions<'a> {
    /// A cell in real time with the bar of the plan.
    pub(crate) fn real_time(halt_s: &'a str) -> Self {
        Self { speed: "1", halt_s, server: None, protocol: None, seed: None }
    }
}

/// A simulator that runs a plan.
pub(crate) struct PlanSimulator {
    simulator: Simulator,
    plan: PathBuf,
    directory: TempDir,
}

/// A new directory that only this user can read. It is deleted with its value.
fn private_directory() -> Result<TempDir, Diagnostic> {
    let mut builder = tempfile::Builder::new();
    builder.prefix("dbbd-sim-");
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o700));
    builder.tempdir().map_err(|error| {
        Diagnostic::file(std::env::temp_dir().display(), FileFinding::NoDirectory { why: error.to_string() })
    })
}

fn absolute(path: &Path) -> Result<PathBuf, Diagnostic> {
    std::path::absolute(path).map_err(unreadable(path.display()))
}

/// A world with the repeatability and the noise that the plan assumes, and with the base balls where they were taught.
fn world(plan: &Plan, robot: &Robot) -> String {
    let table = |TaughtBall { centre, axes_deg }: TaughtBall| {
        format!("[[centre]]\nid = {centre}\ntaught_deg = {axes_deg:?}\n")
    };
    let noise = truth::noise(robot, plan.header.job.bar.sigma_um);
    std::iter::once(noise).chain(plan.taught().map(table)).collect()
}

/// The true robot and the true world of a simulated cell beside the directory of the plan, if the plan is of such a cell.
fn true_cell(plan: &Path) -> Option<[PathBuf; 2]> {
    let cell = plan.parent()?.parent()?;
    let truth = ["truth.toml", "world.toml"].map(|name| cell.join(name));
    truth.iter().all(|path| path.is_file()).then_some(truth)
}

impl PlanSimulator {
    /// Starts the simulator with `plan`, or with that of the demo.
    pub(crate) fn start(
        plan: Option<&Path>,
        options: CellOptions<'_>,
        out: &CommandOutput,
    ) -> Result<Self, Diagnostic> {
        let CellOptions { speed, halt_s, server, protocol, seed } = options;
        let directory = private_directory()?;
        let inside = directory.path();
        let steps = ChildCommands::new(inside, out);
        let plan = match plan {
            Some(plan) => PlanFiles::read(&absolute(plan)?)?.path,
            None => {
                files::write_file(&inside.join("job.toml"), demo::CIRCLES)?;
                steps.run(&["plan", "job.toml", "--out", "plan"])?;
                inside.join("plan/plan.csv")
            }
        };
        let plan_name = plan.display().to_string();
        let content = read_plan(&plan)?;
        let robot = Robot::from_toml("the plan's robot", &content.header.robot)?;
        // The controller computes with the nominal robot, even if the plan was made for an identified one.
        files::write_file(&inside.join("robot.toml"), robot.controller().to_toml()?)?;
        let mut simulate = vec!["simulate", "--program", "krl/DBB_MAIN.src", "--nominal", "robot.toml"];
        let truth = true_cell(&plan).map(|file| file.map(|path| path.display().to_string()));
        match &truth {
            Some([robot, world]) => simulate.extend(["--robot", robot, "--world", world]),
            None => {
                files::write_file(&inside.join("world.toml"), world(&content, &robot))?;
                simulate.extend(["--world", "world.toml"]);
            }
        }
        let mut emit = vec!["krl", plan_name.as_str(), "--out", "krl", "--controller", "simulated"];
        simulate.extend(["--listen", LOOPBACK]);
        let (named, params) = protocol.unwrap_or((content.header.job.bar.protocol.as_str(), &[]));
        // The simulator runs in another directory; a built-in name is no file.
        let is_file = Path::new(named).is_file();
        let protocol = if is_file { absolute(Path::new(named))?.display().to_string() } else { named.into() };
        // A bar without a strobe is synchronised by the markers of the plan.
        let definition = request::read_protocol(&protocol, params)?;
        if !definition.has_strobe() && server.is_none() {
            emit.extend(["--sync", "marker"]);
        }
        simulate.extend(["--protocol", &protocol]);
        // What a bar sends while its line settles is not read: it must not be the run.
        let settle_s = definition.line.settle.as_secs_f64();
        let waited = (speed == "0" && settle_s > 0.0).then(|| {
            let halt_s =
                halt_s.parse::<f64>().unwrap_or(0.0) + SETTLING_SPEED * (settle_s + SETTLING_MARGIN_S);
            (SETTLING_SPEED.to_string(), halt_s.to_string())
        });
        let (speed, halt_s) = waited.as_ref().map_or((speed, halt_s), |(speed, halt_s)| (speed, halt_s));
        simulate.extend(["--speed", speed, "--halt", halt_s]);
        let settings: Vec<String> = params.iter().map(|(name, value)| format!("{name}={value}")).collect();
        settings.iter().for_each(|setting| simulate.extend(["--param", setting]));
        let seed = seed.map(|seed| seed.to_string());
        seed.iter().for_each(|seed| simulate.extend(["--seed", seed.as_str()]));
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

    /// The address of the virtual bar.
    pub(crate) fn port(&self) -> &PortAddress {
        self.simulator.port()
    }

    pub(crate) fn plan(&self) -> &Path {
        &self.plan
    }

    /// Waits for the end of the simulator.
    pub(crate) fn finish(self) -> Result<(), Diagnostic> {
        let Self { simulator, plan: _, directory: _directory } = self;
        simulator.finish()
    }
}
