//! `dbbd plan`.

mod check;

use std::path::{Path, PathBuf};

use check::PlannedCheck;
use serde::Serialize;

use super::identify::{LENGTHS, lengths, measurements};
use super::{CommandOutcome, CommandOutput, output, protocols, robots, value};
use dbbd_device::clock;
use dbbd_job::file_set::FileSet;
use dbbd_job::files;
use dbbd_job::plan::PlanFinding;
use dbbd_job::plan::prediction::Identifiability;
use dbbd_job::plan::{Job, Plan, PlanCheck, PlanPrediction, PlanningPrior, PoseKind, Stage, TaughtBall};
use dbbd_job::recording::dwell;
use dbbd_job::report;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::change::CheckPower;
use dbbd_model::estimation::{check_measurements, doubts};
use dbbd_model::measurement::MeasurementFinding;
use dbbd_model::measurement::{BaseBall, PreparedMeasurement};
use dbbd_model::provenance::ProvenanceFinding;
use dbbd_model::provenance::{Artefact, ArtefactRole, TracedArtefact, one_robot};
use dbbd_model::robot::{LoadedRobot, Robot};

/// Plan the poses of a calibration from a job, and check them.
///
/// Plans circles in any plane about a base ball, with dwells or in continuous motion in both directions, or poses chosen by
/// optimal design. Checks every pose and the path between them: reach, axis limits, singularities, stroke, cup, obstacles, and
/// the risk that a robot within its tolerance leaves the stroke. Refuses an unsafe plan with the row, the quantity and the
/// limit. If only the risk is too great, plans a few safe poses to be measured first. plan.html shows the poses and what they
/// identify. More: docs/explanation/planning.md.
#[derive(clap::Args)]
pub(crate) struct PlanArgs {
    /// The job: bar, base balls, circles, motion, limits (examples/*.toml explain every key).
    job: PathBuf,
    /// Directory for plan.csv, plan.json, plan.html and centres.csv (the base balls, for `identify --centres`).
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Robot by built-in name or file, in place of the job's. With a robot-identified.toml the plan uses the identified robot:
    /// the lengths.csv beside it counts as --measured; the commanded poses are those of the nominal robot.
    #[arg(long, value_name = "NAME|FILE")]
    robot: Option<String>,
    /// Measurements CSV of lengths measured before to the same base balls (may be repeated). The plan uses the robot that is
    /// most likely given these lengths and its tolerance; risks and predictions use its posterior.
    #[arg(long, value_name = "OBS.csv")]
    measured: Vec<PathBuf>,
    /// Plan this many safe poses about the job's base balls in place of its circles, 6 to 242: a stage to be measured before
    /// a plan that is refused for its risk of leaving the stroke.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(6..=242))]
    stage: Option<u32>,
    /// Plan a short check of a calibrated robot; --robot is its robot-identified.toml. In place of the job's circles, chooses
    /// the poses about its base balls that are most sensitive to a change of any parameter. plan.json and plan.html state
    /// the smallest changes that are detected with 95 % probability at 1 % false alarms.
    #[arg(long, requires = "robot", conflicts_with_all = ["stage", "measured"])]
    check: bool,
    /// Number of poses of the check, 12 to 24.
    #[arg(long, value_name = "N", requires = "check", default_value_t = 18, value_parser = clap::value_parser!(u32).range(12..=24))]
    poses: u32,
    /// The base balls of the check are still mounted as in the calibration: the check detects whether one moved.
    #[arg(long, requires = "check")]
    balls_kept: bool,
    /// Tolerance of the check, mm, as for `dbbd check`: reports now if the check cannot decide on it.
    #[arg(long, value_name = "MM", requires = "check", value_parser = value::tolerance)]
    tolerance: Option<f64>,
    /// Largest probability of a wrong decision of the check.
    #[arg(long, value_name = "P", requires = "tolerance", default_value_t = 0.05, value_parser = value::risk)]
    risk: f64,
}

/// The JSON document.
#[derive(Serialize)]
struct PlanSummary<'a> {
    robot: &'a str,
    hash: &'a str,
    rows: usize,
    measure: usize,
    reference: usize,
    duration_s: f64,
    checks: &'a [PlanCheck],
    stage: Option<Stage>,
    taught: &'a [TaughtBall],
    predictions: Option<&'a PlanPrediction>,
    #[serde(skip_serializing_if = "Option::is_none")]
    check: Option<&'a CheckPower>,
}

pub(crate) fn run(args: &PlanArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    let name = args.job.display().to_string();
    let job = Job::from_toml(&name, &files::read_text(&args.job)?)?;
    job.identity().check_dates(clock::unix_ns()).map_err(|(_, why)| Diagnostic::file(&name, why))?;
    let made_from = job.traced(&args.job)?;
    let job = args.stage.map_or_else(|| job.clone(), |points| job.as_stage(points));
    // The file of a definition may exist only on the computer that records.
    if !job.bar.protocol.ends_with(".toml") {
        let bar = protocols::load_with(&job.bar.protocol, &[]).map_err(|why| why.in_file(&name))?;
        out.findings_in(&name, dwell::too_short(job.motion.dwell_s, &bar));
    }
    let robot_name = args.robot.as_deref().unwrap_or(&job.robot);
    let LoadedRobot { robot, source, .. } =
        with_serial(&job, robots::read_for_measurement(robot_name, out)?)?;
    job.check_against(robot.controller()).map_err(|why| Diagnostic::file(&name, why))?;
    out.findings_in(&name, job.without_effect(&robot));
    out.findings_in(&name, job.in_robot(&robot));
    let check = args.check.then(|| PlannedCheck::new(args, &job, &robot, out)).transpose()?;
    let measured = if args.check {
        EarlierMeasurements::default()
    } else {
        EarlierMeasurements::find(args, robot_name, &source, out)?
    };
    let files = measured.files.iter().map(|path| path.display().to_string());
    one_robot(files.zip(&measured.sources).chain([(robot_name.to_owned(), &source)]))?;
    // With lengths measured before, their own findings report this.
    out.findings(robot.asked_repeatability().filter(|_| measured.files.is_empty()));
    let provenance =
        dbbd_job::artefact::made_from([&made_from, &source].into_iter().chain(&measured.sources));
    let PlanningKnowledge { job, robot, prior } = match &check {
        Some(check) => check.known(&job)?,
        None => PlanningKnowledge::after(job, robot, &measured.files, out)?,
    };
    let mut plan = Plan::build_with(&job, &robot, &prior).map_err(|refusal| {
        out.findings(refusal.printed().cloned());
        Diagnostic::from(refusal).in_file(&name)
    })?;
    plan.header.provenance = provenance;
    let map = match &check {
        Some(check) => check.predict(&mut plan, out)?,
        None => plan.predict(&robot, &prior),
    };
    write_plan(&plan, report::plan::html(&plan, &robot, &map)?, &args.out)?;
    out.findings(plan.header.notes.iter().cloned());
    let predictions = plan.header.predictions.iter();
    out.findings(predictions.flat_map(|prediction| prediction.recommendations.iter().cloned()));
    report(&plan, &robot, out)?;
    out.progress(format!("wrote plan.csv, plan.json, plan.html and centres.csv to {}", args.out.display()));
    Ok(CommandOutcome::Done)
}

fn write_plan(plan: &Plan, page: String, directory: &Path) -> Result<(), Diagnostic> {
    let (csv, json) = plan.to_files()?;
    let mut set = FileSet::begin(directory)?;
    set.write("plan.csv", csv)?;
    set.write("plan.json", json)?;
    set.write("plan.html", page)?;
    set.write("centres.csv", BaseBall::to_csv(&plan.header.job.balls()))?;
    set.finish()
}

fn report(plan: &Plan, robot: &Robot, out: &CommandOutput) -> Result<(), Diagnostic> {
    let count = |kind: PoseKind| plan.rows.iter().filter(|row| row.kind == kind).count();
    let summary = PlanSummary {
        robot: &robot.name,
        hash: &plan.header.hash,
        rows: plan.rows.len(),
        measure: count(PoseKind::Measure),
        reference: count(PoseKind::Reference),
        duration_s: plan.duration_s(),
        checks: &plan.header.checks,
        stage: plan.header.stage,
        taught: &plan.header.taught,
        predictions: plan.header.predictions.as_ref(),
        check: plan.header.check.as_ref(),
    };
    out.document(&summary)?;
    out.result(format!("plan {} for {}", summary.hash, summary.robot));
    out.result(format!(
        "{} poses to measure, {} visits of a reference pose, {} module(s); {:.1} min at full override",
        summary.measure,
        summary.reference,
        plan.rows.last().map_or(0, |row| row.circle),
        summary.duration_s / 60.0
    ));
    out.result("worst of what was checked along the whole path:");
    for check in summary.checks {
        out.result(format!("  {check}"));
    }
    for ball in summary.taught {
        let angles = ball.axes_deg.map(|angle| format!("{angle:.4}")).join(", ");
        out.result(format!(
            "teach base ball {}: the tool ball on it at A1..A6 = {angles}; the risk rests on it",
            ball.centre
        ));
    }
    summary.predictions.into_iter().flat_map(prediction_lines).for_each(|line| out.result(line));
    summary.check.into_iter().flat_map(check::check_power_lines).for_each(|line| out.result(line));
    Ok(())
}

/// The robot with the serial number of the job. Refuses a robot with another one.
fn with_serial(job: &Job, read: LoadedRobot) -> Result<LoadedRobot, Diagnostic> {
    let LoadedRobot { mut robot, mut source, findings } = read;
    if let (Some(of_job), Some(of_robot)) = (&job.serial, &robot.serial)
        && of_job != of_robot
    {
        let (job, robot) = (of_job.clone(), of_robot.clone());
        return Err(ProvenanceFinding::OtherJobSerial { job, robot }.into());
    }
    if let Some(serial) = &job.serial {
        robot.serial = Some(serial.clone());
        robot.nominal.iter_mut().for_each(|nominal| nominal.serial = Some(serial.clone()));
        source.artefact.serial = Some(serial.clone());
    }
    Ok(LoadedRobot { robot, source, findings })
}

/// Tables of lengths measured before, each once.
#[derive(Default)]
struct EarlierMeasurements {
    files: Vec<PathBuf>,
    sources: Vec<TracedArtefact>,
}

impl EarlierMeasurements {
    /// The tables of the command line, and the lengths.csv beside an identified robot. Refuses one of another result.
    fn find(
        args: &PlanArgs,
        robot_name: &str,
        robot: &TracedArtefact,
        out: &CommandOutput,
    ) -> Result<Self, Diagnostic> {
        let mut measured = Self::default();
        args.measured.iter().try_for_each(|path| measured.add(path, out))?;
        if robot.artefact.role != ArtefactRole::IdentifiedRobot {
            return Ok(measured);
        }
        let path = Path::new(robot_name).with_file_name(LENGTHS);
        if !path.is_file() {
            out.finding(PlanFinding::NoLengths { file: path.display().to_string() });
            return Ok(measured);
        }
        let lengths = dbbd_job::artefact::of_file(ArtefactRole::Measurements, &path)?;
        let of_result =
            |source: &&Artefact| source.role == ArtefactRole::Measurements && source.name == lengths.name;
        if let Some(expected) = robot.provenance.from.iter().rev().find(of_result)
            && expected.sha256 != lengths.sha256
        {
            let (lengths, expected) = (lengths.to_string(), expected.to_string());
            return Err(ProvenanceFinding::OtherLengths { lengths, expected }.into());
        }
        measured.add(&path, out)?;
        Ok(measured)
    }

    fn add(&mut self, path: &Path, out: &CommandOutput) -> Result<(), Diagnostic> {
        let (lengths, changed) = dbbd_job::artefact::of_table(ArtefactRole::Measurements, path)?;
        out.findings(changed);
        if self.sources.iter().any(|source| source.artefact.sha256 == lengths.artefact.sha256) {
            out.finding(ProvenanceFinding::GivenTwice { lengths: lengths.artefact.to_string() });
            return Ok(());
        }
        self.files.push(path.into());
        self.sources.push(lengths);
        Ok(())
    }
}

/// Job and robot after the earlier measurements, with what is known of them.
struct PlanningKnowledge {
    job: Job,
    robot: Robot,
    prior: PlanningPrior,
}

impl PlanningKnowledge {
    fn after(job: Job, robot: Robot, measured: &[PathBuf], out: &CommandOutput) -> Result<Self, Diagnostic> {
        if measured.is_empty() {
            let prior = PlanningPrior::datasheet(&job, &robot);
            return Ok(Self { job, robot, prior });
        }
        let (mut tables, mut findings) = (Vec::new(), Vec::new());
        for path in measured {
            let observations = measurements(path, lengths, &mut findings, out)?;
            let name = path.display().to_string();
            check_measurements(&name, &observations, &robot, &job.balls())?;
            findings.extend(doubts(&name, &observations, &robot, &job.balls()));
            let rows = observations.rows.len();
            if tables.contains(&observations) {
                findings.push(Diagnostic::file(&name, MeasurementFinding::Repeated { repeated: rows, rows }));
            } else {
                tables.push(observations);
            }
        }
        out.findings(findings);
        let rows = || tables.iter().flat_map(|table| &table.rows);
        let lengths: Vec<PreparedMeasurement> = rows().map(PreparedMeasurement::from).collect();
        // If the job does not say where a ball was taught for an earlier stage, its lengths do.
        let mut job = job;
        for row in rows() {
            let taught_deg = row.context.as_ref().and_then(|context| context.taught_deg.as_deref());
            let ball = row.datum.ball().and_then(|ball| job.centres.get_mut(ball.index()));
            if let Some((table, axes_deg)) = ball.zip(taught_deg) {
                table.taught_deg.get_or_insert(*axes_deg);
            }
        }
        job.check_against(robot.controller()).map_err(Diagnostic::new)?;
        let prior = PlanningPrior::after_lengths(&job, &robot, &lengths).map_err(Diagnostic::from)?;
        out.findings(prior.doubts(&job, &robot, &lengths));
        let (job, robot) = prior.applied(&job, &robot);
        Ok(Self { job, robot, prior })
    }
}

/// A prediction on the terminal.
fn prediction_lines(prediction: &PlanPrediction) -> Vec<String> {
    let count =
        |of: Identifiability| prediction.parameters.iter().filter(|p| p.identifiability == of).count();
    let (now, then) = (prediction.now_mm, prediction.identified_mm);
    let mut lines = vec![
        format!(
            "without a prior these lengths ({:.1} um each) identify {} of {} parameters or combinations: {} well, {} worse than 3 tolerances",
            prediction.sigma_mm * 1e3,
            prediction.rank,
            prediction.of,
            count(Identifiability::Identified),
            count(Identifiability::PoorlyObservable)
        ),
        format!(
            "predicted 3-D error over the workspace, with --prior datasheet: mean {:.3} mm -> {:.3} mm, 95 % {:.3} -> {:.3} mm",
            now.mean, then.mean, now.p95, then.p95
        ),
    ];
    lines.extend(
        prediction
            .observability
            .as_ref()
            .map(|index| format!("{}; condition {:.0}", output::observability(index), prediction.condition)),
    );
    lines.extend(prediction.dependent_in_short.iter().map(|text| format!("  {text}")));
    lines
}
