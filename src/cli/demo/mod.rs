//! `dbbd demo`: runs the commands that a user would type.

mod real;
mod truth;

use std::path::{Path, PathBuf};

use super::child::{ChildCommands, LOOPBACK};
use super::{CommandOutcome, CommandOutput};
use dbbd_job::files;
use dbbd_job::robot_files::named_robot;
use dbbd_model::base::hash::sha256;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::CalibrationResult;
use dbbd_model::robot::Robot;

/// The job of the demo, shipped as `examples/demo.toml`.
pub(crate) const JOB: &str = include_str!("../../../examples/demo.toml");

/// Run a whole calibration without hardware.
///
/// Plans poses, writes KRL programs, executes them on a simulated robot with a virtual ball-bar on a TCP port of this
/// computer, records a capture, matches the poses and identifies the robot, each with its own command on files. At the end,
/// compares the identified with the true parameters. With --real, identifies a robot that others measured.
#[derive(clap::Args)]
pub(crate) struct DemoArgs {
    /// Directory for all files. Those of an earlier demo are replaced.
    #[arg(long, value_name = "DIR", default_value = "demo-out")]
    out: PathBuf,
    /// Seed of the true robot, its repeatability and the bar's noise.
    #[arg(long, value_name = "N", default_value_t = SEED)]
    seed: u64,
    /// Identify a real robot, measured by others with a laser tracker, from lengths to three base balls, and compare it with
    /// the tracker at poses that were not used.
    #[arg(long, value_name = "ROBOT", num_args = 0..=1, default_missing_value = "ur5", conflicts_with = "seed")]
    real: Option<real::RealRobot>,
}

pub(crate) fn run(args: &DemoArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    files::directory(&args.out)?;
    let dir = args.out.as_path();
    if let Some(robot) = args.real {
        return identify_real(&robot.tracked()?, dir, out);
    }
    write_job(dir)?;
    let steps = ChildCommands::new(dir, out);

    steps.say("1. Plan the circles, and check them before anything moves");
    steps.run(&["plan", "job.toml", "--out", "plan", "--replace"])?;
    steps.say("2. Write the KRL programs for the controller");
    steps.run(&["krl", "plan/plan.csv", "--out", "krl", "--replace"])?;
    steps.say("3. A robot whose true parameters nobody knows executes them; the bar is read meanwhile");
    let truth = truth::Truth::draw(dir, args.seed)?;
    measure(&steps, args.seed)?;
    steps.say("4. Match the lengths to the commanded poses");
    steps.run(&["sync", "run.dbbd", "--out", "observations.csv"])?;
    steps.say("5. Identify the robot");
    let [x, y, z] = truth.tool_mm();
    let (tool, centres) = (format!("{x},{y},{z}"), ["--centres", "plan/centres.csv"]);
    let robot = ["identify", "observations.csv", "--robot", "kr60ha", "--tool", &tool];
    let rest = ["--out", "result", "--prior", "datasheet", "--replace"];
    steps.run(&[&robot[..], &centres, &rest].concat())?;

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
    let nominal = named_robot(name)?.robot;
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

/// Writes the job, and replaces only that of an earlier demo.
fn write_job(dir: &Path) -> Result<(), Diagnostic> {
    files::is_same(&dir.join("job.toml"), &sha256(JOB))?;
    files::write_file(&dir.join("job.toml"), JOB)
}

/// The seed of the true robot where none is given.
const SEED: u64 = 1;

/// Writes the job of the demo with its true robot and base balls, for a cell that is simulated later.
pub(crate) fn write_cell(dir: &Path) -> Result<(), Diagnostic> {
    files::directory(dir)?;
    write_job(dir)?;
    truth::Truth::draw(dir, SEED).map(drop)
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
