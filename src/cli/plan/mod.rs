//! `dbbd plan`: poses from a job, checked before anything moves.

mod page;

use std::path::PathBuf;

use serde::Serialize;

use super::{Outcome, Output, Verdict, files};
use crate::model::Centre;
use crate::plan::{Check, Job, Kind, Plan};

/// Arguments of the verb.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The job: bar, base balls, circles, motion, limits (examples/*.toml explain every key).
    job: PathBuf,
    /// Directory for plan.csv, plan.json, plan.html and centres.csv (the base balls, as `identify` takes them).
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Robot by built-in name or file, in place of the job's; an identified one plans on its corrected
    /// model and commands the controller's nominal one.
    #[arg(long, value_name = "NAME|FILE")]
    robot: Option<String>,
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
}

pub(crate) fn run(args: &Args, out: &Output) -> Verdict {
    let name = args.job.display().to_string();
    let job = Job::from_toml(&name, &files::read(&args.job)?)?;
    let robot = files::robot(args.robot.as_deref().unwrap_or(&job.robot))?;
    let plan = Plan::build(&job, &robot)?;

    let (csv, json) = plan.to_files();
    files::directory(&args.out)?;
    files::write(&args.out.join("plan.csv"), csv)?;
    files::write(&args.out.join("plan.json"), json)?;
    files::write(&args.out.join("plan.html"), page::html(&plan, &robot, &name)?)?;
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
    };
    out.document(&summary)?;
    out.result(format!("plan {} for {}", summary.hash, summary.robot));
    out.result(format!(
        "{} poses to measure, {} visits of a reference pose, {} circle(s); {:.1} min at full override",
        summary.measure,
        summary.reference,
        job.circles.len(),
        summary.duration_s / 60.0
    ));
    out.result("worst of what was checked along the whole path:");
    for check in summary.checks {
        out.result(format!("  {check}"));
    }
    out.progress(format!("wrote plan.csv, plan.json, plan.html and centres.csv to {}", args.out.display()));
    Ok(Outcome::Done)
}
