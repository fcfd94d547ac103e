//! `dbbd identify`: the robot's parameters from lengths and positions.

mod given;
mod inputs;
mod say;
mod tables;

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::{Outcome, Output, artefact, bar_u, positive};
use crate::base::{clock, date, files};
use crate::catalogue::EstimationFinding;
use crate::conformity::Budget;
use crate::design::{Calibrated, calibrate_run};
use crate::diagnostic::Diagnostic;
use crate::estimation::{ErrorModel, Input, Options, Prior, ResultFile};
use crate::measurement::Measurements;
use crate::provenance::{Artefact, Provenance, Role};
use crate::robot::parameter::{self, SetUp};
pub(crate) use inputs::observations;
pub(crate) use tables::{LENGTHS, POSITIONS, ROBOT};

pub(crate) use given::{Given, Named};
pub(crate) use inputs::parse_point;
use inputs::read_prior;
pub(crate) use inputs::read_workspace;

/// How often a capture is aligned anew with what was identified.
const ALIGNMENTS: usize = 5;

/// Identify the robot's parameters from lengths or positions, and report which of them are identifiable.
///
/// Each parameter comes with its standard deviation or the reason why it has none, with the 3-D error predicted
/// over the workspace and the further measurement that would help most. A capture is aligned anew with what was
/// identified, until nothing changes. More: docs/explanation/identification.md.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Measurements CSV (index,centre,a1_deg,..,a6_deg,length_mm[,sigma_mm][,bar][,target]), or a capture, which carries
    /// the robot and the base balls of its plan, or a table of positions (see --positions). `bar` numbers bars that have an offset each (1, 2, ..; absent =
    /// 1). One bar set to two lengths keeps its number: then its offset is separable from a scale of the robot.
    input: PathBuf,
    /// Directory for report.html, result.json, parameters.csv, covariance.csv (mm, rad), lengths.csv and
    /// positions.csv (the observations that the result rests on); the identified robot as robot-identified.toml and as
    /// robot-identified.urdf (m, rad; a joint variable is the controller's axis angle); for the controller
    /// mastering.csv (zero error of each axis, degrees) and DBB_RESULT.dat (tool ball, base balls and offsets in KRL;
    /// nothing in it acts by itself).
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Robot: a built-in name or a TOML file.
    #[arg(long, value_name = "NAME|FILE")]
    robot: Option<String>,
    /// Parameters to estimate: names, ranges, groups (`alpha1-5,a1-5,d4-6`; geometric, tool, targets, centres, bar,
    /// tracker, all; compliance, gear); without it, all that are identifiable, and errors of the joints (see --model). Followed as
    /// it is when there is no prior; what it does not name counts as exact, in the predicted 3-D error too.
    #[arg(long, value_name = "LIST")]
    estimate: Option<String>,
    /// Parameters to fix at their start values (--hold).
    #[arg(long, alias = "fix", value_name = "LIST")]
    hold: Option<String>,
    /// Positions of targets on the tool beside the lengths of the input: CSV a1_deg,..,a6_deg,x_mm,y_mm,z_mm[,target]
    /// [,sigma_mm][,index] in the frame of a tracker, whose place is estimated. Target 1 is the tool ball; the places of further
    /// ones (2, 3, ..) on the tool are estimated.
    #[arg(long, value_name = "POS.csv")]
    positions: Option<PathBuf>,
    /// Base balls: CSV centre,x_mm,y_mm,z_mm in the robot base; to centimetres when they are estimated.
    #[arg(long, value_name = "C.csv")]
    centres: Option<PathBuf>,
    /// Tool ball in the flange frame, mm, in place of the robot file's.
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_point, allow_hyphen_values = true)]
    tool: Option<[f64; 3]>,
    /// Standard deviation of every length and coordinate, mm, in place of the data's sigma_mm.
    #[arg(long, value_name = "MM", value_parser = positive)]
    sigma: Option<f64>,
    /// Standard uncertainty (k = 1) of each bar's length by its certificate, mm [default: half of a capture's job's
    /// length_u_mm]. With a prior it binds each bar's offset. Without one an offset is estimated where the lengths
    /// tell it to three times that, and else held; its uncertainty then counts in the standard deviations and in the
    /// predicted error.
    #[arg(long, value_name = "MM", value_parser = bar_u)]
    bar_u: Option<f64>,
    /// Further observations, lengths to the same balls or positions in the same frame, that only check the result.
    #[arg(long, value_name = "OBS.csv")]
    validate: Option<PathBuf>,
    /// Cross-validation folds; 0 for none [default: 5 when there are three lengths per parameter
    /// and at most 20000 lengths].
    #[arg(long, value_name = "N")]
    folds: Option<usize>,
    /// What is known of the robot beforehand: `posterior`, what its earlier identification left unknown (the table
    /// [posterior] of robot-identified.toml; with --tool without the tool ball); `datasheet`, the tolerance in its file;
    /// or a CSV name,unit,sd [default: posterior where the robot file has it, else none].
    #[arg(long, value_name = "none|posterior|datasheet|FILE")]
    prior: Option<String>,
    /// What a robot's error consists of: `joints`, its geometry and errors of its joints (first harmonic, smooth function
    /// of the angle, backlash by the sense of approach, ripple, compliance if the robot file has a [[mass]] or [payload]),
    /// each group as far as the evidence of the lengths speaks for it; `geometric`, the geometry alone. Without
    /// `--prior` the geometry is then bound by the tolerance of the robot file. The geometry alone is taken where the evidence does
    /// not speak for errors of the joints, where there are fewer than 30 lengths beyond the parameters, or more than 16384,
    /// where they are exact, and with `--estimate`, `--prior none`, `--prior posterior` or `--monte-carlo`.
    #[arg(long, value_enum, value_name = "MODEL", default_value = "joints")]
    model: Model,
    /// Draw the lengths anew N times and fit them: standard deviations and 95 % intervals without linearising
    /// (GUM supplement 1), beside the linear ones; 100 to 1000000, usually 1000.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(100..=1_000_000))]
    monte_carlo: Option<u32>,
    /// Serial numbers, bar certificate, operator, laboratory, date and temperatures, in place of those of a capture: a
    /// TOML file with the keys of a job's table [identity].
    #[arg(long, value_name = "FILE")]
    identity: Option<PathBuf>,
    /// Poses (CSV a1_deg,..,a6_deg) over which the 3-D error is predicted, in place of 2000 within the limits.
    #[arg(long, value_name = "FILE.csv")]
    workspace: Option<PathBuf>,
}

/// What a robot's error consists of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Model {
    Joints,
    Geometric,
}

impl Args {
    fn named(&self) -> Named<'_> {
        Named {
            input: &self.input,
            positions: self.positions.as_deref(),
            robot: self.robot.as_deref(),
            tool: self.tool,
            centres: self.centres.as_deref(),
            bar_u: self.bar_u,
        }
    }
}

pub(crate) fn run(args: &Args, out: &Output) -> Result<Outcome, Diagnostic> {
    let read = [Some(&args.input), args.positions.as_ref()].into_iter().flatten();
    files::keeps(&args.out.join(LENGTHS), read.clone().map(PathBuf::as_path))?;
    files::keeps(&args.out.join(POSITIONS), read.map(PathBuf::as_path))?;
    files::keeps(&args.out.join(ROBOT), args.robot.as_deref().map(Path::new))?;
    let mut given = Given::read(args.named(), out)?;
    if let Some(file) =
        args.prior.as_deref().filter(|prior| !["none", "datasheet", "posterior"].contains(prior))
    {
        given.provenance.add(&Artefact::file(Role::Prior, Path::new(file))?);
    }
    if let Some(path) = &args.identity {
        let stated = artefact::identity(path)?;
        out.about(&artefact::other_run(&given.provenance.identity, given.centres.len(), &stated));
        given.provenance.identity.extend(&stated);
    }
    let set_up = given.observations.set_up(given.centres.len());
    let today = date::utc(clock::unix_ns());
    given.provenance.identity.old_certificate(&today).into_iter().for_each(|finding| out.finding(finding));
    tables::is_of_robot(&args.out, &given.robot.name, given.provenance.identity.robot.as_deref())?;
    let options = options(args, &mut given, set_up, out)?;
    let validation = args.validate.as_deref().map(|path| given.validation(path, out)).transpose()?;
    let busy = out.busy(&format!("identifying from {} measurements", given.observations.count()), None);
    out.done(20);
    // What was found in the inputs may be why nothing can be computed.
    let inputs = || given.findings().into_iter().for_each(|finding| out.finding(finding));
    let mut found = find(&given, validation.as_ref(), &options).inspect_err(|_| inputs())?;
    out.done(60);
    // The lengths that the identified robot predicts are used in the alignment, until nothing changes.
    for _ in 0..ALIGNMENTS {
        if !given.align_again(&found.result) {
            break;
        }
        found = find(&given, validation.as_ref(), &options)?;
    }
    out.done(90);
    let Calibrated { result: found, observations } = found;
    given.observations = observations.unwrap_or(given.observations);
    drop(busy);
    let budget = Budget::of(&found, &given.observations, given.bar_u_mm, &given.provenance.identity);
    let provenance =
        tables::write_results(&args.out, &found, &given.observations, given.provenance, &budget)?;
    // Its findings are its warnings: it is written before they are reported.
    out.document(&Recorded { result: &ResultFile::from(&found), budget: &budget, provenance: &provenance })?;
    say::say(out, &found, &args.out);
    Ok(if found.is_doubtful() { Outcome::Doubt } else { Outcome::Done })
}

/// A result with what it was made from.
#[derive(Serialize)]
struct Recorded<'a> {
    #[serde(flatten)]
    result: &'a ResultFile,
    budget: &'a Budget,
    provenance: &'a Provenance,
}

fn find(
    given: &Given,
    validation: Option<&Measurements>,
    options: &Options,
) -> Result<Calibrated, Diagnostic> {
    let start = given.start();
    let input = Input { validation, ..given.input(&start, options) };
    Ok(calibrate_run(&input, given.findings())?)
}

fn options(args: &Args, given: &mut Given, set_up: SetUp, out: &Output) -> Result<Options, Diagnostic> {
    let prior = match args.prior.as_deref() {
        None => given.continued(args.robot.as_deref(), out)?,
        Some("none") => Prior::None,
        Some("datasheet") => Prior::Datasheet,
        Some("posterior") => match given.continued(args.robot.as_deref(), out)? {
            Prior::Posterior => Prior::Posterior,
            _ => return Err(EstimationFinding::NoPosterior.into()),
        },
        Some(file) => Prior::Given(out.table(Path::new(file), |table| read_prior(table, set_up))?),
    };
    // What was known before is doubtful; without it all is measured anew.
    let doubtful = given.robot.doubtful().filter(|_| matches!(prior, Prior::Posterior));
    doubtful.into_iter().for_each(|doubt| out.finding(doubt));
    let betas = given.robot.parallel_joints();
    let list = |text: &Option<String>| {
        text.as_deref().map(|text| parameter::parse_list(text, &betas, set_up)).transpose()
    };
    let options = Options {
        estimate: list(&args.estimate)?,
        hold: list(&args.hold)?.unwrap_or_default(),
        sigma_mm: args.sigma,
        monte_carlo: args.monte_carlo.map(|trials| trials as usize),
        prior,
        model: match args.model {
            Model::Joints if args.prior.as_deref() != Some("none") => ErrorModel::Joints,
            _ => ErrorModel::Geometric,
        },
        folds: args.folds,
        workspace: args
            .workspace
            .as_deref()
            .map(|path| read_workspace(path, &given.robot, out))
            .transpose()?,
        bar_u_mm: given.bar_u_mm,
    };
    options.check(given.observations.rows.len())?;
    Ok(options)
}
