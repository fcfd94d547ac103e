//! `dbbd check`.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::identify::{Given, LENGTHS, Named, ROBOT, parse_point, read_workspace};
use super::{Outcome, Output};
use super::{bar_u, length_sd, positive, tolerance};
use crate::base::{FileSet, files, serialised};
use crate::catalogue::{CliFinding, ConformityFinding, EstimationFinding};
use crate::conformity::{self, CheckInput, InterimCheck, Rule};
use crate::diagnostic::Diagnostic;
use crate::estimation::change::Hypothesis;
use crate::estimation::expected::{BallMounting, Mounting};
use crate::estimation::{Beside, DistanceQuantities, Options, Priors, ResultFile};
use crate::measurement::{LengthModel, PreparedMeasurement};
use crate::provenance::Provenance;
use crate::report::check;
use crate::robot::{Coordinate, ParamId, Robot, Unit};

/// Check whether a calibrated robot is still what it was.
///
/// Fits only what mounting changes and tests the rest against the posterior of the calibration, noise and repeatability;
/// names what most likely changed, and decides about a tolerance. Exit code 0 pass, 3 undecided, 4 fail (without
/// --tolerance: changed). More: docs/explanation/check.md.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Measurements CSV, or a capture, as for `dbbd identify`; 12 to 24 poses to a ball suffice.
    #[arg(value_name = "RUN|CSV")]
    input: PathBuf,
    /// The robot-identified.toml of the calibration, with its table [posterior].
    #[arg(long, value_name = "FILE")]
    robot: String,
    /// Directory for check.json and check.html.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Base balls: CSV centre,x_mm,y_mm,z_mm in the robot base, to centimetres [default: a capture's plan].
    #[arg(long, value_name = "C.csv")]
    centres: Option<PathBuf>,
    /// Tool ball in the flange frame, mm, where it is another one than that of the calibration.
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_point, allow_hyphen_values = true)]
    tool: Option<[f64; 3]>,
    /// Tolerance of the position error over the workspace that 95 % of the poses must keep, mm.
    #[arg(long, value_name = "MM", value_parser = tolerance)]
    tolerance: Option<f64>,
    /// Largest probability of a wrong decision: the guard band (JCGM 106).
    #[arg(long, value_name = "P", default_value_t = 0.05, value_parser = risk, requires = "tolerance")]
    risk: f64,
    /// Decide by the median of the position error alone, without a guard band.
    #[arg(long, conflicts_with = "risk", requires = "tolerance")]
    simple_acceptance: bool,
    /// Standard deviation of every length, mm [default: that of the data with the robot's repeatability, at least that of
    /// the result.json beside the robot].
    #[arg(long, value_name = "MM", value_parser = length_sd)]
    sigma: Option<f64>,
    /// Standard deviation with which the tool ball is mounted again, mm.
    #[arg(long, value_name = "MM", default_value_t = Mounting::SEAT_REPEAT_MM, value_parser = length_sd)]
    tool_repeat: f64,
    /// The base balls are mounted as in the calibration: one that moved is named as a change [default: they were mounted
    /// anew].
    #[arg(long)]
    balls_kept: bool,
    /// Standard deviation of the base balls about --centres, mm [default: they may be anywhere]; with --balls-kept about
    /// where the calibration had them [default: 0.01].
    #[arg(long, value_name = "MM", value_parser = positive)]
    ball_repeat: Option<f64>,
    /// Standard uncertainty (k = 1) of the bar's length, mm [default: half of a capture's job's length_u_mm, else 0.05].
    #[arg(long, value_name = "MM", value_parser = bar_u)]
    bar_u: Option<f64>,
    /// CSV a1_deg..a6_deg: the poses over which the position error is taken [default: 2000 within the axis limits].
    #[arg(long, value_name = "FILE.csv")]
    workspace: Option<PathBuf>,
    /// Identify what changed, with the posterior as prior, and write robot-identified.toml with it, and its lengths.csv,
    /// into --out.
    #[arg(long)]
    update: bool,
}

pub(super) fn risk(text: &str) -> Result<f64, CliFinding> {
    match text.parse::<f64>() {
        Ok(risk) if risk > 0.0 && risk < 0.5 => Ok(risk),
        _ => Err(CliFinding::NotARisk),
    }
}

pub(crate) fn run(args: &Args, out: &Output) -> Result<Outcome, Diagnostic> {
    if args.update {
        files::keeps(&args.out.join(ROBOT), [Path::new(&args.robot)])?;
    }
    let named = Named {
        input: &args.input,
        positions: None,
        robot: Some(&args.robot),
        tool: args.tool,
        centres: args.centres.as_deref(),
        bar_u: args.bar_u,
    };
    let given = Given::read(named, out)?;
    if given.observations.set_up(0).trackers > 0 {
        return Err(EstimationFinding::LengthsOnly.into());
    }
    given.planned_for(&given.robot).map_err(Diagnostic::from)?;
    given.robot.doubtful().into_iter().for_each(|doubt| out.finding(Diagnostic::file(&args.robot, doubt)));
    let start = LengthModel::new(given.robot.geometry.clone(), &given.centres);
    let readings: Vec<PreparedMeasurement> =
        given.observations.rows.iter().map(PreparedMeasurement::from).collect();
    let workspace =
        args.workspace.as_deref().map(|path| read_workspace(path, &given.robot, out)).transpose()?;
    let workspace = Options { workspace, ..Options::default() };
    let noise = Noise::of(args, &given)?;
    out.about(&noise.finding.into_iter().collect::<Vec<_>>());
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
    let found = input.check().map_err(|finding| Diagnostic::file(&args.robot, finding))?;
    let (known, lengths) = (given.known_lengths(Some(&args.robot), out)?, readings.len());
    if 2 * known > lengths {
        out.finding(ConformityFinding::LengthsOfCalibration { known, lengths });
    }
    given.findings().into_iter().for_each(|finding| out.finding(finding));
    findings(args, &found).into_iter().for_each(|finding| out.finding(finding));
    let set_up = input.set_up();
    let found = Made {
        check: &found,
        distance: set_up.and_then(|model| DistanceQuantities::of(&given.observations.rows, &model)),
        provenance: &given.provenance,
    };
    write(args, &found, &given)?;
    out.document(&found)?;
    let found = found.check;
    lines(found).into_iter().for_each(|line| out.result(line));
    out.result(format!("results in {}", args.out.display()));
    Ok(match found.decision.decision {
        conformity::Outcome::Pass => Outcome::Done,
        conformity::Outcome::Undecided => Outcome::Doubt,
        conformity::Outcome::Fail => Outcome::Failed,
    })
}

fn rule(args: &Args) -> Rule {
    if args.simple_acceptance { Rule::SimpleAcceptance } else { Rule::GuardBand { risk: args.risk } }
}

/// What mounting changes; a tool ball that the posterior does not hold is as uncertain as any.
fn mounting(args: &Args, given: &Given) -> Mounting {
    let another = || Priors::datasheet(&given.robot, given.bar_u_mm).sd(ParamId::Tool(Coordinate::X));
    let tool_mm = if args.tool.is_some() { another() } else { args.tool_repeat };
    let balls = match args.ball_repeat {
        repeat if args.balls_kept => BallMounting::Kept(repeat.unwrap_or(Mounting::SEAT_REPEAT_MM)),
        Some(repeat) => BallMounting::About(repeat),
        None => BallMounting::Anywhere,
    };
    Mounting { tool_mm, balls, ..Mounting::again(&given.robot, given.bar_u_mm) }
}

/// The standard deviation of a length, mm, and that a part of it is not known.
pub(super) struct Noise {
    pub(super) sigma_mm: f64,
    pub(super) finding: Option<ConformityFinding>,
}

impl Noise {
    /// Of bar and repeatability, at least that of the result.json beside a robot file.
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

    /// Noise, repeatability and, where the calibration's own result is beside the robot, what its model lacks.
    fn of(args: &Args, given: &Given) -> Result<Self, Diagnostic> {
        if let Some(sigma_mm) = args.sigma {
            return Ok(Self { sigma_mm, finding: None });
        }
        Self::at_least(conformity::own_sigma_mm(&given.observations, &given.robot), &args.robot, &given.robot)
    }
}

fn findings(args: &Args, found: &InterimCheck) -> Vec<ConformityFinding> {
    let mut findings = found.findings.clone();
    let decision = &found.decision;
    if let (conformity::Outcome::Undecided, Some(tolerance_mm), Some(risk)) =
        (decision.decision, decision.tolerance_mm, decision.specific_risk)
    {
        let position_error_mm = decision.position_error_mm;
        findings.push(ConformityFinding::Undecided { tolerance_mm, position_error_mm, risk });
    }
    if args.update && found.update().is_none() && found.is_explained() {
        findings.push(ConformityFinding::NothingToUpdate);
    }
    findings
}

/// `check.json`.
#[derive(Serialize)]
struct Made<'a> {
    #[serde(flatten)]
    check: &'a InterimCheck,
    #[serde(skip_serializing_if = "Option::is_none")]
    distance: Option<DistanceQuantities>,
    provenance: &'a Provenance,
}

fn write(args: &Args, made: &Made<'_>, given: &Given) -> Result<(), Diagnostic> {
    let found = made.check;
    let mut set = FileSet::begin(&args.out)?;
    set.write("check.json", serialised::sealed_json(made)?)?;
    set.write("check.html", check::html(found, made.distance.as_ref(), made.provenance)?)?;
    if let Some(robot) = found.update().filter(|_| args.update) {
        let robot = Robot { provenance: given.provenance.clone(), ..robot.clone() };
        set.write(ROBOT, serialised::sealed_toml(&robot.to_toml()?))?;
        set.write_pieces(LENGTHS, given.observations.csv_pieces(|_| true))?;
    }
    set.finish()
}

/// The check on the terminal.
fn lines(found: &InterimCheck) -> Vec<String> {
    let (test, decision) = (&found.test, &found.decision);
    let mut lines = vec![format!(
        "{}: {} lengths, sigma {:.4} mm; innovation chi-square {:.1} of {} degrees of freedom, p {:.1e}",
        found.robot, found.lengths, found.sigma_mm, test.chi_square, test.freedom, test.p
    )];
    if test.changed && !found.is_explained() {
        lines.push("changed, and nothing alone explains it; what is likeliest is in check.json".into());
    } else if test.changed {
        lines.extend(found.changes.iter().take(MOST_CHANGES).map(change));
    } else {
        lines.push(format!("nothing changed (probability {:.3})", found.unchanged_probability));
    }
    let position = &found.predicted_position_uncertainty_mm;
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
        conformity::Outcome::Pass => "pass",
        conformity::Outcome::Fail => "fail",
        conformity::Outcome::Undecided => "undecided",
    };
    lines.push(match (decision.tolerance_mm, decision.specific_risk) {
        (Some(tolerance), Some(risk)) => {
            format!("{word} against {tolerance} mm ({}), risk {risk:.3}", decision.rule)
        }
        _ => format!("{word} (no tolerance given: by the change alone)"),
    });
    lines
}

/// Hypotheses that are said here; all are in check.json.
const MOST_CHANGES: usize = 3;

fn change(hypothesis: &Hypothesis) -> String {
    let parts = hypothesis.parameters.iter().zip(&hypothesis.change).zip(&hypothesis.sd);
    let parts: Vec<String> = parts
        .map(|((id, change), sd)| match id.unit() {
            Unit::Rad => format!("{id} {:+.4} +- {:.4} deg", change.to_degrees(), sd.to_degrees()),
            _ => format!("{id} {change:+.4} +- {sd:.4} mm"),
        })
        .collect();
    let alike: Vec<String> = hypothesis.alike.iter().map(ToString::to_string).collect();
    let alike = if alike.is_empty() { String::new() } else { format!(" (or {})", alike.join(", ")) };
    format!("changed: {}{alike}, probability {:.3}", parts.join(" and "), hypothesis.probability)
}
