//! `dbbd check`.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::identify::{LENGTHS, LoadedInputs, NamedInputs, ROBOT, read_workspace};
use super::{CommandOutcome, CommandOutput, artefact, value};
use dbbd_job::file_set::FileSet;
use dbbd_job::files;
use dbbd_job::report;
use dbbd_model::base::serialised;
use dbbd_model::conformity::ConformityFinding;
use dbbd_model::conformity::{self, CheckInput, DecisionRule, InterimCheck};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::EstimationFinding;
use dbbd_model::estimation::change::Hypothesis;
use dbbd_model::estimation::expected::{BallMounting, Mounting};
use dbbd_model::estimation::{Beside, DistanceQuantities, Options, Priors, ResultFile};
use dbbd_model::measurement::{LengthModel, PreparedMeasurement};
use dbbd_model::provenance::Provenance;
use dbbd_model::robot::{Coordinate, ParamId, ParamUnit, Robot};

/// Check whether a calibrated robot has changed.
///
/// Fits only what mounting changes, and tests the remaining residuals against the posterior of the calibration, noise and
/// repeatability. Names the most likely change, and decides on a tolerance. Exit code 0: pass; 3: undecided; 4: fail (without
/// --tolerance: changed). More: docs/explanation/check.md.
#[derive(clap::Args)]
pub(crate) struct CheckArgs {
    /// Measurements CSV, or a capture, as for `dbbd identify`; 12 to 24 poses per ball suffice.
    #[arg(value_name = "RUN|CSV")]
    input: PathBuf,
    /// The robot-identified.toml of the calibration, with its table [posterior].
    #[arg(long, value_name = "FILE")]
    robot: String,
    /// Directory for check.json and check.html.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Base balls: CSV centre,x_mm,y_mm,z_mm in the robot base, to centimetres [default: those of a capture's plan].
    #[arg(long, value_name = "C.csv")]
    centres: Option<PathBuf>,
    /// Tool ball in the flange frame, mm, if it is not the one of the calibration.
    #[arg(long, value_name = "X,Y,Z", value_parser = value::tool_ball, allow_hyphen_values = true)]
    tool: Option<[f64; 3]>,
    /// Tolerance, mm, of the position error of 95 % of the poses of the workspace.
    #[arg(long, value_name = "MM", value_parser = value::tolerance)]
    tolerance: Option<f64>,
    /// Largest probability of a wrong decision, which sets the guard band (JCGM 106).
    #[arg(long, value_name = "P", default_value_t = 0.05, value_parser = value::risk, requires = "tolerance")]
    risk: f64,
    /// Decide by the median of the position error alone, without a guard band.
    #[arg(long, conflicts_with = "risk", requires = "tolerance")]
    simple_acceptance: bool,
    /// Standard deviation of every length, mm [default: that of the data combined with the robot's repeatability, at least
    /// that in the result.json beside the robot].
    #[arg(long, value_name = "MM", value_parser = value::length_sd)]
    sigma: Option<f64>,
    /// Standard deviation of the place of the tool ball when it is mounted again, mm.
    #[arg(long, value_name = "MM", default_value_t = Mounting::SEAT_REPEAT_MM, value_parser = value::length_sd)]
    tool_repeat: f64,
    /// The base balls are still mounted as in the calibration: a ball that moved is reported as a change [default: they were
    /// mounted again].
    #[arg(long)]
    balls_kept: bool,
    /// Standard deviation of the base balls about --centres, mm [default: unlimited]; with --balls-kept, about their places
    /// in the calibration [default: 0.01].
    #[arg(long, value_name = "MM", value_parser = value::positive)]
    ball_repeat: Option<f64>,
    /// Standard uncertainty (k = 1) of the bar's length, mm [default: half of length_u_mm in a capture's job, else 0.05].
    #[arg(long, value_name = "MM", value_parser = value::bar_u)]
    bar_u: Option<f64>,
    /// Poses, CSV a1_deg..a6_deg, over which the position error is taken [default: 2000 within the axis limits].
    #[arg(long, value_name = "FILE.csv")]
    workspace: Option<PathBuf>,
    /// Identify what changed, with the posterior as prior, and write robot-identified.toml and lengths.csv to --out.
    #[arg(long)]
    update: bool,
}

pub(crate) fn run(args: &CheckArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    if args.update {
        files::keeps(&args.out.join(ROBOT), [Path::new(&args.robot)])?;
    }
    let named = NamedInputs {
        input: &args.input,
        positions: None,
        robot: Some(&args.robot),
        tool: args.tool,
        centres: args.centres.as_deref(),
        bar_u: args.bar_u,
    };
    let given = LoadedInputs::read(named, out)?;
    if given.observations.set_up(0).trackers > 0 {
        return Err(EstimationFinding::LengthsOnly.into());
    }
    given.check_planned_robot()?;
    let earlier = args.out.join("check.json");
    artefact::check_replaced(&earlier, Some(&given.robot.name), &given.provenance)?;
    out.findings_in(&args.robot, given.robot.doubtful());
    let start = LengthModel::new(given.robot.geometry.clone(), &given.centres);
    let readings: Vec<PreparedMeasurement> =
        given.observations.rows.iter().map(PreparedMeasurement::from).collect();
    let workspace =
        args.workspace.as_deref().map(|path| read_workspace(path, &given.robot, out)).transpose()?;
    let workspace = Options { workspace, ..Options::default() };
    let noise = LengthSigma::of(args, &given)?;
    out.findings(noise.finding);
    let input = CheckInput {
        robot: &given.robot,
        start: &start,
        readings: &readings,
        bars: given.observations.bars(),
        sigma_mm: noise.sigma_mm,
        mounting: mounting(args, &given),
        tolerance_mm: args.tolerance,
        rule: rule(args),
        workspace: &workspace.workspace_poses(&given.robot),
    };
    let check = input.check().map_err(|finding| Diagnostic::file(&args.robot, finding))?;
    let (known, lengths) = (given.known_lengths(Some(&args.robot), out)?, readings.len());
    if 2 * known > lengths {
        out.finding(ConformityFinding::LengthsOfCalibration { known, lengths });
    }
    out.findings(given.findings());
    out.findings(findings(args, &check));
    let written = CheckDocument {
        check: &check,
        distance: input.set_up().and_then(|model| DistanceQuantities::of(&given.observations.rows, &model)),
        provenance: &given.provenance,
    };
    write_check(args, &written, &given)?;
    out.document(&written)?;
    check_lines(&check).into_iter().for_each(|line| out.result(line));
    out.result(format!("results in {}", args.out.display()));
    Ok(match check.decision.decision {
        conformity::ConformityOutcome::Pass => CommandOutcome::Done,
        conformity::ConformityOutcome::Undecided => CommandOutcome::Doubt,
        conformity::ConformityOutcome::Fail => CommandOutcome::Failed,
    })
}

fn rule(args: &CheckArgs) -> DecisionRule {
    if args.simple_acceptance {
        DecisionRule::SimpleAcceptance
    } else {
        DecisionRule::GuardBand { risk: args.risk }
    }
}

/// What mounting changes. The posterior does not hold another tool ball: its place has the datasheet's prior.
fn mounting(args: &CheckArgs, given: &LoadedInputs) -> Mounting {
    let datasheet = || Priors::datasheet(&given.robot, given.bar_u_mm).sd(ParamId::Tool(Coordinate::X));
    let tool_mm = if args.tool.is_some() { datasheet() } else { args.tool_repeat };
    let balls = match args.ball_repeat {
        repeat if args.balls_kept => BallMounting::Kept(repeat.unwrap_or(Mounting::SEAT_REPEAT_MM)),
        Some(repeat) => BallMounting::About(repeat),
        None => BallMounting::Anywhere,
    };
    Mounting { tool_mm, balls, ..Mounting::again(&given.robot, given.bar_u_mm) }
}

/// The standard deviation of a length, mm, and a finding if a part of it is unknown.
pub(super) struct LengthSigma {
    pub(super) sigma_mm: f64,
    pub(super) finding: Option<ConformityFinding>,
}

impl LengthSigma {
    /// The standard deviation of bar and repeatability, at least that in the result.json beside a robot file.
    pub(super) fn at_least(own: Option<f64>, file: &str, robot: &Robot) -> Result<Self, Diagnostic> {
        let (path, beside) = ResultFile::beside(Path::new(file), robot, files::read_if_file)?;
        let looked_for = path.display().to_string();
        if let Beside::Own(result) = &beside {
            let sigma_mm = conformity::sigma_mm(own, Some(result.sigma_mm))?;
            return Ok(Self { sigma_mm, finding: None });
        }
        let sigma_mm = conformity::sigma_mm(own, None)?;
        let finding = match beside {
            Beside::Another => ConformityFinding::OtherResultBeside { looked_for, sigma_mm },
            _ => ConformityFinding::NoResultBeside { looked_for, sigma_mm },
        };
        Ok(Self { sigma_mm, finding: Some(finding) })
    }

    /// The standard deviation that is given, else that of the data.
    fn of(args: &CheckArgs, given: &LoadedInputs) -> Result<Self, Diagnostic> {
        if let Some(sigma_mm) = args.sigma {
            return Ok(Self { sigma_mm, finding: None });
        }
        Self::at_least(conformity::own_sigma_mm(&given.observations, &given.robot), &args.robot, &given.robot)
    }
}

fn findings(args: &CheckArgs, check: &InterimCheck) -> Vec<ConformityFinding> {
    let mut findings = check.findings.clone();
    let decision = &check.decision;
    if let (conformity::ConformityOutcome::Undecided, Some(tolerance_mm), Some(risk)) =
        (decision.decision, decision.tolerance_mm, decision.specific_risk)
    {
        let position_error_mm = decision.position_error_mm;
        findings.push(ConformityFinding::Undecided { tolerance_mm, position_error_mm, risk });
    }
    if args.update && check.update().is_none() && check.is_explained() {
        findings.push(ConformityFinding::NothingToUpdate);
    }
    findings
}

/// `check.json`.
#[derive(Serialize)]
struct CheckDocument<'a> {
    #[serde(flatten)]
    check: &'a InterimCheck,
    #[serde(skip_serializing_if = "Option::is_none")]
    distance: Option<DistanceQuantities>,
    provenance: &'a Provenance,
}

fn write_check(
    args: &CheckArgs,
    written: &CheckDocument<'_>,
    given: &LoadedInputs,
) -> Result<(), Diagnostic> {
    let &CheckDocument { check, ref distance, provenance } = written;
    let mut set = FileSet::begin(&args.out)?;
    set.write("check.json", serialised::sealed_json(written)?)?;
    set.write("check.html", report::check::html(check, distance.as_ref(), provenance)?)?;
    if let Some(robot) = check.update().filter(|_| args.update) {
        let robot = Robot { provenance: given.provenance.clone(), ..robot.clone() };
        set.write(ROBOT, serialised::sealed_toml(&robot.to_toml()?))?;
        set.write_pieces(LENGTHS, given.observations.csv_pieces(|_| true))?;
    }
    set.finish()
}

/// The check on the terminal.
fn check_lines(check: &InterimCheck) -> Vec<String> {
    /// More hypotheses are in check.json.
    const MAX_PRINTED_CHANGES: usize = 3;
    let (test, decision) = (&check.test, &check.decision);
    let mut lines = vec![format!(
        "{}: {} lengths, sigma {:.4} mm; innovation chi-square {:.1} of {} degrees of freedom, p {:.1e}",
        check.robot, check.lengths, check.sigma_mm, test.chi_square, test.freedom, test.p
    )];
    if test.changed && !check.is_explained() {
        lines.push(
            "changed, but no single hypothesis explains it; the most likely ones are in check.json".into(),
        );
    } else if test.changed {
        lines.extend(check.changes.iter().take(MAX_PRINTED_CHANGES).map(change));
    } else {
        lines.push(format!("nothing changed (probability {:.3})", check.unchanged_probability));
    }
    let position = &check.predicted_position_uncertainty_mm;
    lines.push(format!(
        "position error over the workspace, 95 % of the poses of all likely robots: calibrated {:.3} mm, now {:.3} mm",
        position.calibrated.p95, position.now.p95
    ));
    lines.push(format!(
        "position error that one of them keeps at 95 % of its poses: median {:.3} mm, upper limit {:.3} mm",
        decision.position_error_mm, decision.upper_mm
    ));
    if let Some(updated) = position.updated {
        lines.push(format!("with what changed identified anew (--update): {:.3} mm", updated.p95));
    }
    let word = match decision.decision {
        conformity::ConformityOutcome::Pass => "pass",
        conformity::ConformityOutcome::Fail => "fail",
        conformity::ConformityOutcome::Undecided => "undecided",
    };
    lines.push(match (decision.tolerance_mm, decision.specific_risk) {
        (Some(tolerance), Some(risk)) => {
            format!("{word} against {tolerance} mm ({}), risk {risk:.3}", decision.rule)
        }
        _ => format!("{word} (no tolerance given: by the change alone)"),
    });
    lines
}

fn change(hypothesis: &Hypothesis) -> String {
    let parts = hypothesis.parameters.iter().zip(&hypothesis.change).zip(&hypothesis.sd);
    let parts: Vec<String> = parts
        .map(|((id, change), sd)| match id.unit() {
            ParamUnit::Rad => format!("{id} {:+.4} +- {:.4} deg", change.to_degrees(), sd.to_degrees()),
            _ => format!("{id} {change:+.4} +- {sd:.4} mm"),
        })
        .collect();
    let alike: Vec<String> = hypothesis.alike.iter().map(ToString::to_string).collect();
    let alike = if alike.is_empty() { String::new() } else { format!(" (or {})", alike.join(", ")) };
    format!("changed: {}{alike}, probability {:.3}", parts.join(" and "), hypothesis.probability)
}
