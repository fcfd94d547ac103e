//! `dbbd identify`: the robot's parameters from lengths.

mod choices;
mod given;
mod inputs;
mod page;
mod say;
mod tables;

use std::error::Error;
use std::path::{Path, PathBuf};

use super::{Outcome, Output, Verdict};
use crate::files;
use crate::identify::result::{Warning, WarningKind};
use crate::identify::{self, Options, Prior, PriorScale};
use crate::model::parameter::{self, SetUp};
pub(crate) use inputs::observations;
pub(crate) use page::error_maps;
pub(crate) use tables::LENGTHS;

use given::{Given, check_bars, check_lengths};
use inputs::{parse_point, parse_positive, parse_scale, read_prior, read_workspace};

/// How often a capture is aligned anew with what was identified.
const ALIGNMENTS: usize = 5;

/// Identify the robot's parameters from lengths, and say which of them the data can tell.
///
/// Each parameter comes with its standard deviation or the reason why it has none, with the 3-D error predicted
/// over the workspace and the further measurement that would help most. A capture is aligned anew with what was
/// identified, until nothing changes. More: docs/identification.md.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Observations CSV (index,centre,a1_deg,..,a6_deg,length_mm[,sigma_mm][,bar]), or a capture, which carries
    /// the robot and the base balls of its plan. `bar` numbers bars that have an offset each (1, 2, ..; absent =
    /// 1). One bar set to two lengths keeps its number: then its offset can be told from a scale of the robot.
    input: PathBuf,
    /// Directory for report.html, result.json, parameters.csv, covariance.csv (mm, rad) and lengths.csv (the
    /// observations that the result rests on); the identified robot as robot-identified.toml and as
    /// robot-identified.urdf (m, rad; a joint variable is the controller's axis angle); for the controller
    /// mastering.csv (zero error of each axis, degrees) and DBB_RESULT.dat (tool ball, base balls and offsets in KRL;
    /// nothing in it acts by itself).
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Robot: a built-in name or a TOML file.
    #[arg(long, value_name = "NAME|FILE")]
    robot: Option<String>,
    /// Parameters to estimate: names, ranges, groups (`alpha1-5,a1-5,d4-6`; geometric, tool, centres, bar, all;
    /// compliance, gear); without it, all that the data can tell, and compliance (if the robot file has a [[mass]]
    /// or [payload]) and gear error where an F-test, lengths held out and the predicted 3-D error speak for them. Followed as it is when
    /// there is no prior; what it does not name counts as exact, in the predicted 3-D error too.
    #[arg(long, value_name = "LIST")]
    estimate: Option<String>,
    /// Parameters to hold at their start values.
    #[arg(long, value_name = "LIST")]
    hold: Option<String>,
    /// Base balls: CSV centre,x_mm,y_mm,z_mm in the robot base; to centimetres when they are estimated.
    #[arg(long, value_name = "C.csv")]
    centres: Option<PathBuf>,
    /// Tool ball in the flange frame, mm, in place of the robot file's.
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_point, allow_hyphen_values = true)]
    tool: Option<[f64; 3]>,
    /// Standard deviation of every length, mm, in place of the data's sigma_mm.
    #[arg(long, value_name = "MM", value_parser = parse_positive)]
    sigma: Option<f64>,
    /// Standard uncertainty (k = 1) of each bar's length by its certificate, mm [default: half of a capture's job's
    /// length_u_mm]. With a prior it binds each bar's offset. Without one an offset is estimated where the lengths
    /// tell it to three times that, and else held; its uncertainty then counts in the standard deviations and in the
    /// predicted error.
    #[arg(long, value_name = "MM", value_parser = parse_positive)]
    bar_u: Option<f64>,
    /// Further observations, to the same balls, that only check the result.
    #[arg(long, value_name = "OBS.csv")]
    validate: Option<PathBuf>,
    /// Cross-validation folds; 0 for none [default: 5 when there are three lengths per parameter
    /// and at most 20000 lengths].
    #[arg(long, value_name = "N")]
    folds: Option<usize>,
    /// What is known of the robot beforehand: the tolerance in its file, or a CSV name,unit,sd.
    #[arg(long, value_name = "none|datasheet|FILE", default_value = "none")]
    prior: String,
    /// Factor on every standard deviation of the prior: above 1 the lengths count for more; `auto` takes the one
    /// with which lengths held out are predicted best.
    #[arg(long, value_name = "X|auto", default_value = "1", value_parser = parse_scale)]
    prior_scale: PriorScale,
    /// Draw the lengths anew N times and fit them: standard deviations and 95 % intervals without linearising
    /// (GUM supplement 1), beside the linear ones; 100 to 1000000, usually 1000.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(100..=1_000_000))]
    monte_carlo: Option<u32>,
    /// Poses (CSV a1_deg,..,a6_deg) over which the 3-D error is predicted, in place of 2000 within the limits.
    #[arg(long, value_name = "FILE.csv")]
    workspace: Option<PathBuf>,
}

pub(crate) fn run(args: &Args, out: &Output) -> Verdict {
    let mut given = Given::read(args, out)?;
    let set_up = SetUp { centres: given.centres.len(), bars: given.observations.bars() };
    let options = options(args, &given, set_up)?;
    let validation = match &args.validate {
        Some(path) => {
            let name = path.display().to_string();
            let set = observations(path)?;
            check_lengths(&name, &set, &given.robot, &given.centres)?;
            check_bars(&name, &set, given.observations.bars())?;
            Some(set)
        }
        None => None,
    };
    let find = |given: &Given| {
        identify::identify(&given.robot, &given.observations, &given.centres, validation.as_ref(), &options)
    };
    let mut found = find(&given)?;
    // The lengths that the identified robot predicts speak in the alignment, until nothing changes.
    for _ in 0..ALIGNMENTS {
        if !given.align_again(&found) {
            break;
        }
        found = find(&given)?;
    }
    let own = given.commanded.then(|| identify::own_accuracy(&given.robot, &found, &given.observations));
    let doubts = given.doubts.drain(..).chain(own.flatten());
    found.result.warnings.extend(doubts.map(|text| Warning { kind: WarningKind::Doubt, text }));
    files::directory(&args.out)?;
    tables::write_results(&args.out, &found, &given.observations)?;
    let page = page::html(&given.robot, &given.observations, &found, given.sources)?;
    files::write(&args.out.join("report.html"), page)?;
    say::say(out, &found.result, &args.out);
    out.document(&found.result)?;
    let doubt = found.result.warnings.iter().any(|warning| warning.kind == WarningKind::Doubt);
    Ok(if doubt { Outcome::Doubt } else { Outcome::Done })
}

fn options(args: &Args, given: &Given, set_up: SetUp) -> Result<Options, Box<dyn Error>> {
    let betas = given.robot.parallel_joints();
    let list = |text: &Option<String>| {
        text.as_deref().map(|text| parameter::parse_list(text, &betas, set_up)).transpose()
    };
    Ok(Options {
        estimate: list(&args.estimate)?,
        hold: list(&args.hold)?.unwrap_or_default(),
        sigma_mm: args.sigma,
        prior_scale: args.prior_scale,
        monte_carlo: args.monte_carlo.map(|trials| trials as usize),
        prior: match args.prior.as_str() {
            "none" => Prior::None,
            "datasheet" => Prior::Datasheet,
            file => Prior::Given(read_prior(Path::new(file), set_up)?),
        },
        folds: args.folds,
        workspace: args.workspace.as_deref().map(read_workspace).transpose()?,
        bar_u_mm: given.bar_u_mm,
    })
}
