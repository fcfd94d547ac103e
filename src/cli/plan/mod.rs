//! `dbbd plan`: poses from a job, checked before anything moves.

mod page;

use std::error::Error;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::{Outcome, Output, Verdict};
use crate::cli::{protocols, robots};
use crate::diag::Diagnostic;
use crate::files;
use crate::model::{Centre, Reading, Robot};
use crate::plan::prediction::Fate;
use crate::plan::{Check, Job, Kind, Knowledge, Plan, Prediction, Stage, Taught};

/// Plan the poses of a calibration from a job, and check them.
///
/// Circles in any plane about a base ball, with dwells or without stops and both ways, or poses chosen by optimal
/// design. Every pose and the path between is checked: reach, axis limits, singularities, stroke, cup, obstacles,
/// and the risk that a robot within its tolerance leaves the stroke. What is unsafe is refused with the row, the
/// quantity and the limit. Where only the risk is too great, a few safe poses are chosen, to be measured first.
/// plan.html shows the poses and what they will tell. More: docs/planning.md.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The job: bar, base balls, circles, motion, limits (examples/*.toml explain every key).
    job: PathBuf,
    /// Directory for plan.csv, plan.json, plan.html and centres.csv (the base balls, as `identify` takes them).
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Robot by built-in name or file, in place of the job's. With a robot-identified.toml the plan is made on what is
    /// known since: the lengths.csv beside it counts as --measured; the controller is told its nominal poses.
    #[arg(long, value_name = "NAME|FILE")]
    robot: Option<String>,
    /// Observations CSV of lengths measured before to the same base balls (may be repeated): the plan is made on the
    /// robot that is likeliest by them and by its tolerance, and its risks and predictions go by what they left unknown.
    #[arg(long, value_name = "OBS.csv")]
    measured: Vec<PathBuf>,
    /// Choose this many poses about the job's base balls in place of its circles, all of them safe as the robot is known
    /// now: a stage before a plan that is refused for its risk of leaving the stroke.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(6..=242))]
    stage: Option<u32>,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Summary<'a> {
    robot: &'a str,
    hash: &'a str,
    rows: usize,
    measure: usize,
    reference: usize,
    duration_s: f64,
    checks: &'a [Check],
    notes: &'a [String],
    stage: Option<Stage>,
    taught: &'a [Taught],
    predictions: Option<&'a Prediction>,
}

pub(crate) fn run(args: &Args, out: &Output) -> Verdict {
    let name = args.job.display().to_string();
    let job = Job::from_toml(&name, &files::read(&args.job)?)?;
    let job = args.stage.map_or_else(|| job.clone(), |points| job.as_stage(points));
    // A definition in a file may be there only where the run is.
    if !job.bar.protocol.ends_with(".toml") {
        protocols::load_with(&job.bar.protocol, &[])
            .map_err(|why| Diagnostic::file(&name, why.to_string()))?;
    }
    let robot_name = args.robot.as_deref().unwrap_or(&job.robot);
    let robot = robots::named(robot_name)?;
    job.check_against(robot.controller()).map_err(|why| Diagnostic::file(&name, why))?;
    let mut measured = args.measured.clone();
    if robot.nominal.is_some() {
        let lengths = Path::new(robot_name).with_file_name(super::identify::LENGTHS);
        if lengths.is_file() {
            measured.push(lengths);
        } else {
            out.warning(format!(
                "{}: not there: what the identification left unknown is not known, and the risk goes by the maker's \
                 tolerance about the identified robot",
                lengths.display()
            ));
        }
    }
    let (job, robot, known) = knowledge(job, robot, &measured)?;
    let mut plan = Plan::build_knowing(&job, &robot, &known)?;
    let foretold = plan.foretell(&robot, &known.belief);
    let map = foretold.map(|(prediction, map)| {
        plan.header.predictions = Some(prediction);
        map
    });

    let (csv, json) = plan.to_files();
    files::directory(&args.out)?;
    files::write(&args.out.join("plan.csv"), csv)?;
    files::write(&args.out.join("plan.json"), json)?;
    files::write(&args.out.join("plan.html"), page::html(&plan, &robot, &name, &map.unwrap_or_default())?)?;
    files::write(&args.out.join("centres.csv"), Centre::to_csv(&job.balls()))?;

    let count = |kind: Kind| plan.rows.iter().filter(|row| row.kind == kind).count();
    let summary = Summary {
        robot: &robot.name,
        hash: &plan.header.hash,
        rows: plan.rows.len(),
        measure: count(Kind::Measure),
        reference: count(Kind::Reference),
        duration_s: plan.duration_s(),
        checks: &plan.header.checks,
        notes: &plan.header.notes,
        stage: plan.header.stage,
        taught: &plan.header.taught,
        predictions: plan.header.predictions.as_ref(),
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
    for ball in &plan.header.taught {
        let angles = ball.axes_deg.map(|angle| format!("{angle:.4}")).join(", ");
        out.result(format!(
            "teach base ball {}: the tool ball on it at A1..A6 = {angles}; the risk rests on it",
            ball.centre
        ));
    }
    for note in summary.notes {
        out.result(note);
    }
    summary.predictions.into_iter().flat_map(lines).for_each(|line| out.result(line));
    out.progress(format!("wrote plan.csv, plan.json, plan.html and centres.csv to {}", args.out.display()));
    Ok(Outcome::Done)
}

/// Job, robot and what is known of it after the lengths measured before, if there are any.
fn knowledge(
    job: Job,
    robot: Robot,
    measured: &[PathBuf],
) -> Result<(Job, Robot, Knowledge), Box<dyn Error>> {
    if measured.is_empty() {
        let known = Knowledge::datasheet(&job, &robot);
        return Ok((job, robot, known));
    }
    let mut lengths = Vec::new();
    for path in measured {
        let name = path.display().to_string();
        let observations = super::identify::observations(path)?;
        if let Some(row) = observations.rows.iter().find(|row| row.centre > job.centres.len()) {
            let message = format!("index {}: the job has no base ball {}", row.index, row.centre);
            return Err(Diagnostic::file(&name, message).into());
        }
        lengths.extend(observations.rows.iter().map(Reading::from));
    }
    let known = Knowledge::learned(&job, &robot, &lengths)
        .ok_or("the lengths measured before give no finite robot")?;
    let (job, robot) = known.applied(&job, &robot);
    Ok((job, robot, known))
}

/// A prediction in a few lines.
fn lines(prediction: &Prediction) -> Vec<String> {
    let count = |fate: Fate| prediction.parameters.iter().filter(|p| p.fate == fate).count();
    let (now, then) = (prediction.now_mm, prediction.identified_mm);
    let mut lines = vec![
        format!(
            "these lengths ({:.1} um each) will tell {} of {} parameters or combinations: {} well, {} worse than 3 tolerances",
            prediction.sigma_mm * 1e3,
            prediction.rank,
            prediction.of,
            count(Fate::Identified),
            count(Fate::TooWeak)
        ),
        format!(
            "predicted 3-D error over the workspace, with --prior datasheet: mean {:.3} mm -> {:.3} mm, 95 % {:.3} -> {:.3} mm",
            now.mean, then.mean, now.p95, then.p95
        ),
    ];
    if let Some(index) = &prediction.observability {
        lines.push(format!(
            "observability O1 {:.3e}, O2 {:.3e}, O3 {:.3e}, O4 {:.3e}, O5 {:.3e}; condition {:.0}",
            index.o1, index.o2, index.o3, index.o4, index.o5, prediction.condition
        ));
    }
    lines.extend(prediction.dependent.iter().map(|text| format!("  {text}")));
    lines.extend(prediction.advice.iter().cloned());
    lines
}
