//! `dbbd demo`: runs the commands that a user would type.

mod real;
mod truth;

use std::path::{Path, PathBuf};

use super::child::{ChildCommands, LOOPBACK};
use super::{CommandOutcome, CommandOutput};
use dbbd_job::files;
use dbbd_job::robot_files::RobotName;
use dbbd_model::base::hash::sha256;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::CalibrationResult;
use dbbd_model::robot::Robot;

/// Run a whole calibration without hardware.
///
/// Plans poses about three base balls, writes KRL programs, executes them on a simulated robot with a virtual ball-bar on a TCP
/// port of this computer, records a capture, matches the poses and identifies the robot, each with its own command on files. The
/// true robot is drawn from its tolerance and the usual errors of joints. At the end, compares the identified with the true robot.
/// With --real, identifies a robot that others measured.
#[derive(clap::Args)]
pub(crate) struct DemoArgs {
    /// Directory for all files. Those of an earlier demo are replaced.
    #[arg(long, value_name = "DIR", default_value = "demo-out")]
    out: PathBuf,
    /// Seed of the true robot, its repeatability and the bar's noise.
    #[arg(long, value_name = "N", default_value_t = SEED)]
    seed: u64,
    /// Three circles about one ball, measured on a robot without errors of joints.
    #[arg(long, conflicts_with_all = ["paper", "real"])]
    circles: bool,
    /// The paper's circle, and its thirteen parameters, which alone are off.
    #[arg(long, conflicts_with = "real")]
    paper: bool,
    /// Identify a real robot, measured by others with a laser tracker, from lengths to three base balls, and compare it with
    /// the tracker at poses that were not used.
    #[arg(long, value_name = "ROBOT", num_args = 0..=1, default_missing_value = "ur5", conflicts_with = "seed")]
    real: Option<real::RealRobot>,
}

/// What a demo measures, and how it identifies the robot.
struct SimulatedDemo {
    /// The job, shipped below `examples`.
    job: &'static str,
    errors: TrueErrors,
    /// Further arguments of `identify`.
    identify: &'static [&'static str],
}

/// The errors of a true robot.
enum TrueErrors {
    /// Its whole geometry is off by its tolerance, and its joints have their usual errors.
    Joints,
    /// Its whole geometry is off by its tolerance.
    Geometry,
    /// Of all that is unknown only the paper's parameters are off.
    Paper,
}

/// The paper's parameters (docs/explanation/paper.md).
const PAPER: &str = "alpha1-5,a1-5,d4-6";

impl SimulatedDemo {
    const BALLS: Self = Self {
        job: include_str!("../../../examples/demo.toml"),
        errors: TrueErrors::Joints,
        identify: &["--prior", "datasheet"],
    };
    const CIRCLES: Self = Self {
        job: include_str!("../../../examples/circles.toml"),
        errors: TrueErrors::Geometry,
        identify: &["--prior", "datasheet"],
    };
    const PAPER: Self = Self {
        job: include_str!("../../../examples/seed-experiment.toml"),
        errors: TrueErrors::Paper,
        identify: &["--estimate", PAPER],
    };

    fn of(args: &DemoArgs) -> Self {
        match (args.circles, args.paper) {
            (true, _) => Self::CIRCLES,
            (_, true) => Self::PAPER,
            _ => Self::BALLS,
        }
    }

    /// Writes the job, and replaces only that of an earlier demo.
    fn write_job(&self, dir: &Path) -> Result<(), Diagnostic> {
        let path = dir.join("job.toml");
        let is_of = |demo: &Self| files::is_same(&path, &sha256(demo.job));
        if [Self::BALLS, Self::CIRCLES, Self::PAPER].iter().all(|demo| is_of(demo).is_err()) {
            is_of(self)?;
        }
        files::write_file(&path, self.job)
    }
}

/// The job of a cell whose bar is simulated and whose plan nobody gave: three circles about one ball.
pub(crate) const CIRCLES: &str = SimulatedDemo::CIRCLES.job;

pub(crate) fn run(args: &DemoArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    files::directory(&args.out)?;
    let dir = args.out.as_path();
    if let Some(robot) = args.real {
        return identify_real(&robot.tracked()?, dir, out);
    }
    let demo = SimulatedDemo::of(args);
    demo.write_job(dir)?;
    let steps = ChildCommands::new(dir, out);

    steps.say("1. Plan the poses, and check them before anything moves");
    steps.run(&["plan", "job.toml", "--out", "plan", "--replace"])?;
    steps.say("2. Write the KRL programs for the controller");
    steps.run(&["krl", "plan/plan.csv", "--out", "krl", "--replace"])?;
    steps.say("3. A robot whose true parameters nobody knows executes them; the bar is read meanwhile");
    let truth = truth::Truth::draw(dir, &demo, args.seed)?;
    measure(&steps, args.seed)?;
    steps.say("4. Match the lengths to the commanded poses");
    steps.run(&["sync", "run.dbbd", "--out", "observations.csv"])?;
    steps.say("5. Identify the robot");
    let [x, y, z] = truth.tool_mm();
    let (tool, centres) = (format!("{x},{y},{z}"), ["--centres", "plan/centres.csv"]);
    let robot = ["identify", "observations.csv", "--robot", "kr60ha", "--tool", &tool];
    let rest = ["--out", "result", "--replace"];
    steps.run(&[&robot[..], &centres, demo.identify, &rest].concat())?;

    let path = dir.join("result/result.json");
    let result = CalibrationResult::from_json(&path.display().to_string(), &files::read_text(&path)?)?;
    let path = dir.join("result/robot-identified.toml");
    let identified = Robot::from_toml(&path.display().to_string(), &files::read_text(&path)?)?;
    let comparison = truth.compare(&result, &identified)?;
    out.document(&comparison)?;
    for line in comparison.lines() {
        out.result(line);
    }
    out.result(format!("The report: {}", dir.join("result/report.html").display()));
    Ok(CommandOutcome::Done)
}

/// Identifies a real robot in a directory of its own, and judges it at the poses that it did not see.
fn identify_real(
    robot: &real::TrackedRobot,
    dir: &Path,
    out: &CommandOutput,
) -> Result<CommandOutcome, Diagnostic> {
    let (name, dir) = (robot.name(), &dir.join(robot.name()));
    let nominal = RobotName::from(name).read()?.robot;
    files::directory(dir)?;
    robot.write(dir, &nominal)?;
    let steps = ChildCommands::new(dir, out);
    steps.say(&format!("Identify a real {} from lengths to three base balls", nominal.name));
    let inputs = ["identify", "observations.csv", "--robot", name, "--tool", &robot.tool()];
    let further = ["--centres", "centres.csv", "--folds", "0", "--out", "result", "--replace"];
    steps.run(&[&inputs[..], &further].concat())?;
    let path = dir.join("result/robot-identified.toml");
    let error = robot.judge(&Robot::from_toml(&path.display().to_string(), &files::read_text(&path)?)?)?;
    out.document(&error)?;
    error.lines().into_iter().for_each(|line| out.result(line));
    Ok(CommandOutcome::Done)
}

/// The seed of the true robot where none is given.
const SEED: u64 = 1;

/// Writes the job with its true robot and base balls, for a cell that is simulated later.
pub(crate) fn write_cell(dir: &Path) -> Result<(), Diagnostic> {
    files::directory(dir)?;
    SimulatedDemo::BALLS.write_job(dir)?;
    truth::Truth::draw(dir, &SimulatedDemo::BALLS, SEED).map(drop)
}

/// Simulates the program and records the bar.
fn measure(steps: &ChildCommands<'_>, seed: u64) -> Result<(), Diagnostic> {
    steps.remove("run.dbbd")?;
    let simulate =
        ["simulate", "--program", "krl/DBB_MAIN.src", "--robot", "truth.toml", "--world", "world.toml"];
    let seeded = ["--speed", "0", "--seed", &seed.to_string(), "--listen", LOOPBACK];
    let simulator = steps.start(&[&simulate[..], &seeded].concat())?;
    let port = simulator.port().to_string();
    steps.run(&["acquire", "--port", &port, "--plan", "plan/plan.csv", "--out", "run.dbbd"])?;
    simulator.finish()
}
