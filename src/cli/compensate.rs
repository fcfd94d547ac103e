//! `dbbd compensate`.

use std::path::{Path, PathBuf};

use super::{CommandOutput, value};
use dbbd_job::program::Moved;
use dbbd_job::request::Request;
use dbbd_job::request::compensate::{CompensateDocument, CompensateRequest, DEFAULT_LIMIT_MM, ProgramDatum};
use dbbd_job::robot_files::RobotName;
use dbbd_model::estimation::ProgramUncertainty;

/// A share of an uncertainty that is named: a tenth of its square.
const NAMED_SHARE: f64 = 0.3;

/// Correct the points of a program for an identified robot.
///
/// Corrects the points of a program in KRL (PROGRAM.src and the PROGRAM.dat beside it), RAPID, URScript or of a FANUC; the
/// extension of the file selects the language. Every other byte remains. Only points in these files are corrected, not XHOME points and
/// relative motions.
///
/// Lengths do not determine the robot's base frame. The points are corrected in the robot's own frame, so that they are right
/// with respect to each other; shift $BASE by what corrected points miss if a place in the room matters. $BASE is taken in the robot's
/// own base ($ROBROOT null). What is flange and what is a ball that was mounted beside its place,
/// the identification decides by [tool] ball_u_mm and [tolerance] flange_mm, flange_deg of the robot file. $TOOL is that of the
/// program, never the ball.
#[derive(clap::Args)]
pub(crate) struct CompensateArgs {
    /// The program: .src of KRL (motions by PTP, LIN, CIRC, SPTP, SLIN, SCIRC and SPL, inline forms or plain), .mod of
    /// RAPID (MoveAbsJ, MoveJ, MoveL, MoveC), .script of URScript (movej, movel, movec) or .ls of a FANUC (J, L, C).
    #[arg(value_name = "PROGRAM")]
    program: PathBuf,
    /// The identified robot: robot-identified.toml.
    #[arg(long, value_name = "NAME|FILE|DIR")]
    robot: RobotName,
    /// Directory for the corrected program; not that of the program itself.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The controller's $config.dat, for TOOL_DATA and BASE_DATA; in RAPID a module that declares tools and work objects;
    /// of a FANUC its SYSFRAME.VA.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["tool", "base"])]
    config: Option<PathBuf>,
    /// $TOOL (in URScript the TCP, of a FANUC the tool frame) if the program does not set it: mm and degrees, in the flange frame.
    #[arg(long, value_name = "X,Y,Z,A,B,C", value_parser = value::frame, allow_hyphen_values = true)]
    tool: Option<[f64; 6]>,
    /// $BASE (of a FANUC the user frame) if the program does not set it: mm and degrees, in the robot's base.
    #[arg(long, value_name = "X,Y,Z,A,B,C", value_parser = value::frame, allow_hyphen_values = true)]
    base: Option<[f64; 6]>,
    /// Where the robot stands before the program, degrees: a first pose without S and T, ConfJ or qnear is reached in the branch that is
    /// nearest.
    #[arg(long, value_name = "A1,..,A6", value_parser = value::six_angles, allow_hyphen_values = true)]
    start: Option<[f64; 6]>,
    /// What the flange carries while the program runs: the name of a [[payload]] of the robot file, or its mass in kg and its
    /// centre in the flange frame in mm [default: the first of the robot file].
    #[arg(long, value_name = "NAME|KG,X,Y,Z", allow_hyphen_values = true)]
    payload: Option<String>,
    /// The controller computes with the nominal table, although its make has a factory calibration (Universal Robots).
    #[arg(long, value_name = "MODEL", value_parser = ["nominal"])]
    controller_model: Option<String>,
    /// Where the predicted uncertainty is zero in the mean: the poses over which robot and program are aligned. `program`: the
    /// points of each tool, whose base is measured at them. `workspace`: the whole robot, as in result.json, for a base that is
    /// measured elsewhere. Or a table of poses with the columns a1_deg..a6_deg.
    #[arg(long, value_name = "program|workspace|FILE", default_value = "program")]
    datum: String,
    /// Refuse the program if a commanded point would move by more than this, mm.
    #[arg(long, value_name = "MM", default_value_t = DEFAULT_LIMIT_MM)]
    limit: f64,
    /// The plan of a program that `dbbd krl` or `dbbd program` wrote: it is corrected about the base balls as they are mounted
    /// [default: the plan of the program in a directory beside it].
    #[arg(long, value_name = "PLAN.csv")]
    plan: Option<PathBuf>,
    /// Replace files that exist in DIR [default: refuse].
    #[arg(long)]
    replace: bool,
}

/// What the arguments ask for.
pub(super) fn request(args: &CompensateArgs) -> Request {
    Request::Compensate(CompensateRequest {
        program: args.program.clone(),
        robot: args.robot.clone(),
        out: args.out.clone(),
        config: args.config.clone(),
        tool_mm_deg: args.tool,
        base_mm_deg: args.base,
        start_deg: args.start,
        payload: args.payload.clone(),
        plan: args.plan.clone(),
        nominal_controller: args.controller_model.is_some(),
        datum: match args.datum.as_str() {
            "program" => ProgramDatum::Program,
            "workspace" => ProgramDatum::Workspace,
            file => ProgramDatum::File(file.into()),
        },
        limit_mm: args.limit,
        replace: args.replace,
    })
}

pub(super) fn show(out: &CommandOutput, document: &CompensateDocument, directory: &Path) {
    let CompensateDocument { points, left, .. } = document;
    for Moved { name, line, shift_mm, turn_deg, .. } in points {
        out.detail(format!("line {line}: {name} moved by {shift_mm:.3} mm, {turn_deg:.4} deg"));
    }
    let (mean_mm, largest_mm) = (document.mean_shift_mm(), document.largest_shift_mm());
    out.result(format!(
        "{} points corrected, by {mean_mm:.3} mm on average and {largest_mm:.3} mm at most; {left} left as they are; \
         written to {}",
        points.len(),
        directory.display()
    ));
    if let Some(ProgramUncertainty { before, after, flange }) = document.predicted {
        let of_flange = if flange.mean > NAMED_SHARE * after.mean {
            format!(
                "; of the mean {:.3} mm are the flange's, whose tolerance is not stated (flange_mm, flange_deg)",
                flange.mean
            )
        } else {
            String::new()
        };
        out.result(format!(
            "predicted position uncertainty of the program's tool at its points (datum: {}): mean {:.3} mm before, {:.3} after{of_flange}; largest {:.3} mm before, {:.3} after",
            document.datum, before.mean, after.mean, before.max, after.max
        ));
    }
    out.progress("corrected in the robot's own frame; run it first in T1, slowly");
}
