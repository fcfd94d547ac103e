//! `dbbd plan`.

use std::path::{Path, PathBuf};

use super::{CommandOutput, output, value};
use dbbd_job::plan::goal::outcome::{GoalOutcome, GoalPoint};
use dbbd_job::plan::prediction::Identifiability;
use dbbd_job::plan::{Plan, PlanPrediction, PoseKind};
use dbbd_job::request::Request;
use dbbd_job::request::plan::{CheckPoses, PlanDocument, PlanRequest, PlannedPoses, RepeatedRows};
use dbbd_job::robot_files::RobotName;
use dbbd_model::conformity::change::CheckPower;
use dbbd_model::robot::ParamUnit;

/// Plan the poses of a calibration from a job, and check them.
///
/// Plans circles in any plane about a base ball, with dwells or in continuous motion in both directions, or poses chosen by
/// optimal design. Checks every pose and the path between them: reach, axis limits, singularities, stroke, cup, obstacles, and
/// the risk that a robot within its tolerance leaves the stroke. Refuses an unsafe plan with the row, the quantity and the
/// limit. If only the risk is too great, plans a few safe poses to be measured first. A job with a `[goal]` gets the base balls,
/// the bar and the number of poses that reach it soonest. plan.html shows the poses and what they identify. More:
/// docs/explanation/planning.md.
#[derive(clap::Args)]
pub(crate) struct PlanArgs {
    /// The job: bar, base balls, circles, motion, limits (examples/*.toml explain every key).
    job: PathBuf,
    /// Directory for plan.csv, plan.json, plan.html and centres.csv (the base balls, for `identify --centres`); with a goal also
    /// for job.toml, which has what was chosen.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Robot by built-in name or file, in place of the job's. With a robot-identified.toml the plan uses the identified robot:
    /// the lengths.csv beside it counts as --measured; the commanded poses are those of the nominal robot.
    #[arg(long, value_name = "NAME|FILE|DIR")]
    robot: Option<RobotName>,
    /// Measurements CSV of lengths measured before to the same base balls (may be repeated). The plan uses the robot that is
    /// most likely given these lengths and its tolerance; risks and predictions use its posterior.
    #[arg(long, value_name = "OBS.csv")]
    measured: Vec<PathBuf>,
    /// Plan this many safe poses about the job's base balls in place of its circles, 6 to 242: a stage to be measured before
    /// a plan that is refused for its risk of leaving the stroke.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(6..=242))]
    stage: Option<u32>,
    /// Plan the poses of these captures' plans that have no length in any of them, in place of the job's circles.
    #[arg(long, value_name = "RUN", num_args = 1.., conflicts_with_all = ["stage", "check", "repeat"])]
    remaining: Vec<PathBuf>,
    /// Plan poses to be measured again: those of a capture, a table of lengths or a result (its directory). ROWS are indices as
    /// 3,7-9, or the outliers of a result [default: all]. Their lengths supersede the earlier ones in `identify`.
    #[arg(long, value_name = "RUN[:ROWS]", value_parser = value::run_rows, conflicts_with_all = ["stage", "check"])]
    repeat: Option<(PathBuf, RepeatedRows)>,
    /// Plan a short check of a calibrated robot; --robot is its robot-identified.toml. In place of the job's circles, chooses
    /// the poses about its base balls that are most sensitive to a change of any parameter. plan.json and plan.html state
    /// the smallest changes that are detected with 95 % probability at 1 % false alarms.
    #[arg(long, requires = "robot", conflicts_with_all = ["stage", "measured"])]
    check: bool,
    /// Plan N lengths, 10 to 242 [default: 20], that renew a calibration; --robot is its robot-identified.toml. In place of the job's circles, chooses
    /// the poses about its base balls that leave the least position error, with what is known of the robot today: its
    /// posterior, widened by the months since. `identify` with the same --robot then continues the posterior.
    #[arg(long, value_name = "N", requires = "robot", num_args = 0..=1, require_equals = true,
        conflicts_with_all = ["stage", "measured", "check", "remaining", "repeat"], value_parser = clap::value_parser!(u32).range(10..=242))]
    renew: Option<Option<u32>>,
    /// Number of poses of the check, 12 to 24.
    #[arg(long, value_name = "N", requires = "check", default_value_t = CheckPoses::COUNT, value_parser = clap::value_parser!(u32).range(12..=24))]
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
    /// Replace an earlier result in DIR [default: its files move to DIR/previous-1, DIR/previous-2 and so on].
    #[arg(long)]
    replace: bool,
}

/// What the arguments ask for.
pub(super) fn request(args: &PlanArgs) -> Request {
    let poses = match args.stage {
        _ if args.check => PlannedPoses::Check(CheckPoses {
            poses: args.poses,
            balls_kept: args.balls_kept,
            tolerance_mm: args.tolerance,
            risk: args.risk,
        }),
        Some(poses) => PlannedPoses::Stage { poses },
        None if !args.remaining.is_empty() => PlannedPoses::Remaining { runs: args.remaining.clone() },
        None => match (&args.repeat, args.renew) {
            (Some((run, rows)), _) => PlannedPoses::Repeat { run: run.clone(), rows: rows.clone() },
            (None, Some(asked)) => PlannedPoses::Renew { poses: asked.unwrap_or(PlannedPoses::RENEWAL) },
            (None, None) => PlannedPoses::Job,
        },
    };
    Request::Plan(PlanRequest {
        job: args.job.clone(),
        out: args.out.clone(),
        robot: args.robot.clone(),
        measured: args.measured.clone(),
        poses,
        replace: args.replace,
    })
}

pub(super) fn show(out: &CommandOutput, document: &PlanDocument, directory: &Path) {
    let plan = &document.plan;
    out.result(format!(
        "plan {} for {}: {} poses to measure, {} visits of a reference pose, {} module(s); {:.1} min at full override",
        plan.header.hash,
        document.robot,
        document.count(PoseKind::Measure),
        document.count(PoseKind::Reference),
        plan.rows.last().map_or(0, |row| row.circle),
        plan.duration_s() / 60.0
    ));
    if let Some(payload) = &plan.header.job.payload {
        out.result(format!(
            "the flange carries `{payload}` during the run: mount it, and tell the controller"
        ));
    }
    plan.header.goal.iter().map(|goal| goal_line(goal, plan)).for_each(|line| out.result(line));
    plan.header.predictions.iter().map(headline).for_each(|line| out.result(line));
    out.detail("worst of what was checked along the whole path:");
    for check in &plan.header.checks {
        out.detail(format!("  {check}"));
    }
    for ball in &plan.header.taught {
        let angles = ball.axes_deg.map(|angle| format!("{angle:.4}")).join(", ");
        out.result(format!(
            "teach base ball {}: the tool ball on it at A1..A6 = {angles}; the risk rests on it",
            ball.centre
        ));
    }
    plan.header.goal.iter().flat_map(curve_lines).for_each(|line| out.detail(line));
    plan.header.predictions.iter().flat_map(prediction_lines).for_each(|line| out.detail(line));
    plan.header.check.iter().flat_map(check_power_lines).for_each(|line| out.result(line));
    let job = if plan.header.goal.is_some() { ", job.toml" } else { "" };
    out.progress(format!(
        "wrote plan.csv, plan.json, plan.html{job} and centres.csv to {}",
        directory.display()
    ));
}

/// What the run reaches of the goal, and what it takes.
fn goal_line(goal: &GoalOutcome, plan: &Plan) -> String {
    let job = &plan.header.job;
    format!(
        "goal of {} mm ({}): 90 % of such robots keep {:.3} mm after {:.0} min with a bar of {} mm and {} ball(s)",
        goal.position_mm,
        goal.of.name(),
        goal.reached_mm,
        goal.minutes,
        job.bar.length_mm,
        job.centres.len()
    )
}

/// What less and more time would reach.
fn curve_lines(goal: &GoalOutcome) -> Vec<String> {
    let line = |point: &GoalPoint| {
        let GoalPoint { minutes, position_mm, bar_mm, balls, poses } = point;
        format!(
            "  {minutes:.0} min: {position_mm:.3} mm, {poses} poses about {balls} ball(s), bar of {bar_mm} mm"
        )
    };
    let lines = goal.curve.iter().map(line);
    [String::from("what 90 % of such robots keep after other times:")].into_iter().chain(lines).collect()
}

/// How far off the tool ball is now, and is expected to be after the identification.
fn headline(prediction: &PlanPrediction) -> String {
    format!(
        "mean error of the tool ball over the workspace: {:.3} mm now, {:.3} mm expected after",
        prediction.now_mm.mean, prediction.identified_mm.mean
    )
}

/// What else a prediction states.
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
            "predicted position uncertainty over the workspace: 95 % {:.3} mm -> {:.3} mm",
            now.p95, then.p95
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

/// What a check can detect, on the terminal.
fn check_power_lines(power: &CheckPower) -> Vec<String> {
    let smallest = |angles: bool| {
        let of_unit = power.detectable.iter().filter(|change| (change.unit == ParamUnit::Rad) == angles);
        let smallest = of_unit.filter_map(|change| {
            let size = change.smallest?;
            Some(if angles {
                format!("{} {:.4} deg", change.name, size.to_degrees())
            } else {
                format!("{} {size:.3} mm", change.name)
            })
        });
        smallest.collect::<Vec<String>>().join(", ")
    };
    vec![
        format!(
            "smallest changes found with {:.0} % probability at {:.0} % of false alarms:",
            100.0 * power.power,
            100.0 * power.false_alarm
        ),
        format!("  {}", smallest(true)),
        format!("  {}", smallest(false)),
        format!(
            "smallest tolerance of the position error that it decides: {:.3} mm",
            power.least_tolerance_mm
        ),
    ]
}
