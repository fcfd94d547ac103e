//! `dbbd identify`.

mod say;

use std::path::PathBuf;

use super::value;
use dbbd_job::request::Request;
use dbbd_job::request::identify::{Exclusion, IdentifyRequest, RequestedPrior, SetUpRelation};
use dbbd_job::robot_files::RobotName;
use dbbd_model::estimation::ErrorModel;
pub(super) use say::show;

/// Identify the robot's parameters from lengths or positions, and report which of them are identifiable.
///
/// Each parameter has a standard deviation, or the reason why it has none. The report predicts the 3-D error over the
/// workspace, and recommends the further measurement that would help most. A capture is matched again with the identified
/// robot until the pairs of poses and lengths no longer change. More: docs/explanation/identification.md.
#[derive(clap::Args)]
pub(crate) struct IdentifyArgs {
    /// Measurements CSV (index,centre,a1_deg,..,a6_deg,length_mm[,sigma_mm][,bar][,target]), or a capture, which contains the
    /// robot and the base balls of its plan, or a table of positions (see --positions). `bar` numbers the bars (1, 2, ..;
    /// absent: 1), each with an offset of its own. One bar set to two lengths keeps its number: its offset is then separable
    /// from a scale of the robot.
    input: PathBuf,
    /// Further captures and tables of the same robot, in the order in which they were measured. Identity, certificate of the bar
    /// and temperatures of all count. A part that was measured on the same day with the same bar and balls as the one before
    /// goes on in its set-up; else its base balls and the zero of its bar are its own.
    #[arg(value_name = "INPUT")]
    further: Vec<PathBuf>,
    /// All parts have one set-up: base balls and bar were not touched in between.
    #[arg(long, conflicts_with = "new_setup")]
    same_setup: bool,
    /// Each part has a set-up of its own.
    #[arg(long)]
    new_setup: bool,
    /// Directory for report.html, result.json, parameters.csv, covariance.csv (mm, rad), lengths.csv and positions.csv (the
    /// observations that the result rests on), and the identified robot as robot-identified.toml; `dbbd export --for` writes
    /// it for other programs and for its controller.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Robot: a built-in name or a TOML file.
    #[arg(long, value_name = "NAME|FILE|DIR")]
    robot: Option<RobotName>,
    /// Parameters to estimate: names, ranges, groups (`alpha1-5,a1-5,d4-6`; geometric, tool, targets, centres, bar, tracker,
    /// all; compliance, gear) [default: all that are identifiable, and errors of the joints, see --model]. Without a prior
    /// exactly this list is estimated. Other parameters count as exact, also in the predicted position uncertainty.
    #[arg(long, value_name = "LIST")]
    estimate: Option<String>,
    /// Parameters to fix at their start values (--hold).
    #[arg(long, alias = "fix", value_name = "LIST")]
    hold: Option<String>,
    /// Positions of targets on the tool, beside the lengths of the input: CSV a1_deg,..,a6_deg,x_mm,y_mm,z_mm[,target]
    /// [,sigma_mm][,index] in the frame of a tracker, whose place is estimated. Target 1 is the tool ball; the places of
    /// further targets (2, 3, ..) on the tool are estimated.
    #[arg(long, value_name = "POS.csv")]
    positions: Option<PathBuf>,
    /// Base balls: CSV centre,x_mm,y_mm,z_mm in the robot base. Centimetres suffice if they are estimated.
    #[arg(long, value_name = "C.csv")]
    centres: Option<PathBuf>,
    /// Tool ball in the flange frame, mm, in place of that in the robot file.
    #[arg(long, value_name = "X,Y,Z", value_parser = value::tool_ball, allow_hyphen_values = true)]
    tool: Option<[f64; 3]>,
    /// Standard deviation of every length and coordinate, mm, in place of the column sigma_mm.
    #[arg(long, value_name = "MM", value_parser = value::positive)]
    sigma: Option<f64>,
    /// Largest expanded uncertainty (k = 2) with which the calibration is still used, mm: the result states until when, at most
    /// twelve months. Without it the result states its uncertainty and no date.
    #[arg(long, value_name = "MM", value_parser = value::tolerance)]
    tolerance: Option<f64>,
    /// Standard uncertainty (k = 1) of each bar's length by its certificate, mm [default: half of length_u_mm in a capture's
    /// job]. It is the prior of each bar's offset; without it a bar counts as known to about 0.1 mm, but may be far off.
    #[arg(long, value_name = "MM", value_parser = value::bar_u)]
    bar_u: Option<f64>,
    /// Further observations that only check the result: lengths to the same balls, or positions in the same frame.
    #[arg(long, value_name = "OBS.csv")]
    validate: Option<PathBuf>,
    /// Number of cross-validation folds; 0 for none [default: 5 with at least three lengths per parameter and at most 20000
    /// lengths].
    #[arg(long, value_name = "N")]
    folds: Option<usize>,
    /// What is known of the robot before: `posterior`, the posterior of its earlier identification (the table [posterior] of
    /// robot-identified.toml; with --tool, without the tool ball); `datasheet`, the tolerance in its file; or a CSV
    /// name,unit,sd. `none`: nothing, but for what the lengths know worse than three tolerances [default: posterior if the
    /// robot file has one, else datasheet; with --estimate none].
    #[arg(long, value_name = "none|posterior|datasheet|FILE")]
    prior: Option<String>,
    /// The error model of the robot. `joints`: its geometry and the errors of its joints (first harmonic, smooth function of
    /// the angle, backlash by the sense of approach, ripple, compliance under the weight of the arm); each
    /// group only as far as the evidence of the lengths supports it. `geometric`: the same is estimated, and the geometry
    /// nearest to it is written. With `--estimate` the list is all that is unknown.
    #[arg(long, value_enum, value_name = "MODEL", default_value = "joints")]
    model: ErrorModelChoice,
    /// Draw the lengths N times and fit them: gives standard deviations and 95 % intervals without linearisation (GUM
    /// supplement 1), beside the linear ones; 100 to 1000000, usually 1000.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(100..=1_000_000))]
    monte_carlo: Option<u32>,
    /// Serial numbers, bar certificate, operator, laboratory, date and temperatures, in place of those of a capture: a TOML
    /// file with the keys of a job's table [identity].
    #[arg(long, value_name = "FILE")]
    identity: Option<PathBuf>,
    /// Poses, CSV a1_deg,..,a6_deg, over which the 3-D error is predicted [default: 2000 within the axis limits].
    #[arg(long, value_name = "FILE.csv")]
    workspace: Option<PathBuf>,
    /// Rows that are left out of the fit by their index, as `3,7-9`, and why (`3,7-9:the door was slammed`); may be repeated. The
    /// result lists them with the operator and the reason.
    #[arg(long, value_name = "ROWS[:WHY]")]
    exclude: Vec<Exclusion>,
    /// Replace an earlier result in DIR [default: its files move to DIR/previous-1, DIR/previous-2 and so on].
    #[arg(long)]
    replace: bool,
}

/// The error model of the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum ErrorModelChoice {
    Joints,
    Geometric,
}

/// What the arguments ask for.
pub(super) fn request(args: &IdentifyArgs) -> Request {
    Request::Identify(IdentifyRequest {
        input: args.input.clone(),
        further: args.further.clone(),
        set_ups: match (args.same_setup, args.new_setup) {
            (true, _) => SetUpRelation::Same,
            (false, true) => SetUpRelation::New,
            (false, false) => SetUpRelation::ByDay,
        },
        out: args.out.clone(),
        robot: args.robot.clone(),
        estimate: args.estimate.clone(),
        hold: args.hold.clone(),
        positions: args.positions.clone(),
        centres: args.centres.clone(),
        tool_mm: args.tool,
        sigma_mm: args.sigma,
        tolerance_mm: args.tolerance,
        bar_u_mm: args.bar_u,
        validate: args.validate.clone(),
        folds: args.folds,
        prior: args.prior.as_deref().map(RequestedPrior::named),
        model: match args.model {
            ErrorModelChoice::Joints => ErrorModel::Joints,
            ErrorModelChoice::Geometric => ErrorModel::Geometric,
        },
        monte_carlo: args.monte_carlo.map(|trials| trials as usize),
        identity: args.identity.clone(),
        workspace: args.workspace.clone(),
        exclude: args.exclude.clone(),
        replace: args.replace,
    })
}
