//! `dbbd check`.

use std::path::{Path, PathBuf};

use super::{CommandOutput, value};
use dbbd_job::request::Request;
use dbbd_job::request::check::{CheckDocument, CheckRequest};
use dbbd_job::robot_files::RobotName;
use dbbd_model::conformity::change::{ChangeTest, Hypothesis};
use dbbd_model::conformity::expected::Mounting;
use dbbd_model::conformity::{DecisionRule, InterimCheck};
use dbbd_model::robot::ParamUnit;

/// Check whether a calibrated robot has changed.
///
/// Fits only what mounting changes, and tests the remaining residuals against the posterior of the calibration, noise and
/// repeatability. Names the most likely change, and decides on a tolerance. Exit code 0: pass; 3: undecided; 4: fail (without
/// --tolerance: changed). More: docs/explanation/check.md.
#[derive(clap::Args)]
pub(crate) struct CheckArgs {
    /// Measurements CSV, or a capture, as for `dbbd identify`; 12 to 24 poses suffice.
    #[arg(value_name = "RUN|CSV")]
    input: PathBuf,
    /// The robot-identified.toml of the calibration, with its table [posterior].
    #[arg(long, value_name = "NAME|FILE|DIR")]
    robot: RobotName,
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
    #[arg(long, value_name = "P", default_value_t = CheckRequest::RISK, value_parser = value::risk, requires = "tolerance")]
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
    /// Standard uncertainty (k = 1) of the bar's length, mm [default: half of length_u_mm in a capture's job, else 0.07].
    #[arg(long, value_name = "MM", value_parser = value::bar_u)]
    bar_u: Option<f64>,
    /// Poses, CSV a1_deg..a6_deg, over which the position error is taken [default: 2000 within the axis limits].
    #[arg(long, value_name = "FILE.csv")]
    workspace: Option<PathBuf>,
    /// Identify what changed, with the posterior as prior, and write robot-identified.toml and lengths.csv to --out.
    #[arg(long)]
    update: bool,
    /// Replace an earlier result in DIR [default: its files move to DIR/previous-1, DIR/previous-2 and so on].
    #[arg(long)]
    replace: bool,
}

/// What the arguments ask for.
pub(super) fn request(args: &CheckArgs) -> Request {
    Request::Check(CheckRequest {
        input: args.input.clone(),
        robot: args.robot.clone(),
        out: args.out.clone(),
        centres: args.centres.clone(),
        tool_mm: args.tool,
        tolerance_mm: args.tolerance,
        rule: if args.simple_acceptance {
            DecisionRule::SimpleAcceptance
        } else {
            DecisionRule::GuardBand { risk: args.risk }
        },
        sigma_mm: args.sigma,
        tool_repeat_mm: args.tool_repeat,
        balls_kept: args.balls_kept,
        ball_repeat_mm: args.ball_repeat,
        bar_u_mm: args.bar_u,
        workspace: args.workspace.clone(),
        update: args.update,
        replace: args.replace,
    })
}

pub(super) fn show(out: &CommandOutput, document: &CheckDocument, directory: &Path) {
    check_lines(&document.checked.check).into_iter().for_each(|line| out.result(line));
    out.result(format!("results in {}", directory.display()));
}

/// The check on the terminal.
fn check_lines(check: &InterimCheck) -> Vec<String> {
    /// More hypotheses are in check.json.
    const MAX_PRINTED_CHANGES: usize = 3;
    let (test, decision) = (&check.test, &check.decision);
    let mut lines = vec![format!(
        "{}: {} lengths, sigma {:.4} mm; innovation chi-square {:.1} of {} degrees of freedom; that nothing changed: p {}{:.1e}",
        check.robot,
        check.lengths,
        check.sigma_mm,
        test.chi_square,
        test.freedom,
        if test.p <= ChangeTest::MIN_P { "<= " } else { "" },
        test.p
    )];
    if check.is_of_another() {
        lines.push("the lengths are of no change of this robot: another robot or tool?".into());
    } else if test.changed && !check.is_explained() {
        lines.push(
            "changed, but no single hypothesis explains it; the most likely ones are in check.json".into(),
        );
    } else if test.changed {
        let words = ["changed: "].into_iter().chain(std::iter::repeat("     or: "));
        let likeliest = check.changes.iter().take(MAX_PRINTED_CHANGES);
        lines.extend(words.zip(likeliest).map(|(word, likely)| format!("{word}{}", change(likely))));
    } else {
        lines.push(format!("nothing changed (probability {:.3})", check.unchanged_probability));
    }
    let position = &check.predicted_position_uncertainty_mm;
    if !check.is_of_another() {
        lines.push(format!(
            "position error over the workspace, 95 % of the poses of all likely robots: calibrated {:.3} mm, now {:.3} mm",
            position.calibrated.p95, position.now.p95
        ));
        lines.push(format!(
            "position error that one of them keeps at 95 % of its poses: median {:.3} mm, upper limit {:.3} mm",
            decision.position_error_mm, decision.upper_mm
        ));
    }
    if let Some(updated) = position.updated {
        lines.push(format!("with what changed identified again (--update): {:.3} mm", updated.p95));
    }
    lines.extend(check.validity.iter().map(|validity| format!("valid {validity}")));
    let word = decision.decision.name();
    lines.push(match (decision.tolerance_mm, decision.specific_risk) {
        (Some(tolerance), Some(risk)) => {
            format!("{word} against {tolerance} mm ({}), risk {risk:.3}", decision.rule)
        }
        (Some(tolerance), None) => format!("{word} against {tolerance} mm: these lengths decide nothing"),
        _ => format!("{word} (no tolerance is given: neither pass nor fail)"),
    });
    lines
}

fn change(hypothesis: &Hypothesis) -> String {
    let parts = hypothesis.parameters.iter().zip(&hypothesis.change).zip(&hypothesis.sd);
    let parts: Vec<String> = parts
        .map(|((id, change), sd)| {
            if matches!(id.unit(), ParamUnit::Rad) {
                format!("{id} {:+.4} deg (u {:.4})", change.to_degrees(), sd.to_degrees())
            } else {
                format!("{id} {change:+.4} mm (u {sd:.4})")
            }
        })
        .collect();
    let alike: Vec<String> = hypothesis.alike.iter().map(ToString::to_string).collect();
    let alike = if alike.is_empty() { String::new() } else { format!(" (or {})", alike.join(", ")) };
    format!("{}{alike}, probability {:.3}", parts.join(" and "), hypothesis.probability)
}
