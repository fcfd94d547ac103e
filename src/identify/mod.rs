//! From lengths to parameters: fit, loss, stages, outliers, validation, summary.
//!
//! The lengths L = |p - c| + b are fitted by least squares over a base set of the parameters asked
//! for, chosen at the nominal geometry with the fitted set-up. What the data are too weak for is held
//! (or carries the prior), and every number comes with its standard deviation or the reason why it has none.

mod covariance;
mod diagnosis;
mod distribution;
mod estimate;
mod fit;
mod folds;
mod groups;
mod interval;
mod joints;
mod lengths;
mod monte_carlo;
mod options;
mod own_accuracy;
mod places;
mod prior;
pub mod result;
mod scale;
mod sigma;
mod solver;
mod summary;
mod units;
mod verdict;

use std::borrow::Cow;

use nalgebra::DMatrix;

pub use estimate::IdentifyError;
pub use joints::senses;
pub use options::{Options, Prior, PriorScale, tolerance};
pub use own_accuracy::own_accuracy;
pub use result::Identification;
pub use units::mistaken as mistaken_unit;

use crate::model::parameter::SetUp;
use crate::model::{Centre, LengthModel, Observation, Observations, ParamId, Reading, Robot};
use estimate::Estimate;
use lengths::Lengths;
use result::{Folds, GroupChoice, PriorUsed, Warning, WarningKind};

/// A result with what stands behind it.
#[derive(Clone, Debug)]
pub struct Identified {
    /// What `result.json` holds.
    pub result: Identification,
    /// The identified robot, with the nominal one inside, tool ball included.
    pub robot: Robot,
    /// The identified robot, set-up and bar.
    pub model: LengthModel,
    /// The estimated parameters, and
    pub estimated: Vec<ParamId>,
    /// their covariance, in the units of the parameters.
    pub covariance: DMatrix<f64>,
    /// The nominal robot with the fitted set-up.
    pub before: LengthModel,
    /// The places of the observations that were set aside, in order.
    pub out: Vec<usize>,
    /// The predicted 3-D error over the workspace.
    pub predicted: ErrorMap,
}

impl Identified {
    /// The residuals of observations, measured minus predicted.
    pub fn residuals<'a>(
        &'a self,
        rows: impl IntoIterator<Item = &'a Observation>,
    ) -> impl Iterator<Item = ResidualPair> {
        let (before, after) = (self.before.prepare(), self.model.prepare());
        rows.into_iter().map(Reading::from).map(move |reading| ResidualPair {
            before: reading.length - before.length(&reading),
            after: reading.length - after.length(&reading),
        })
    }
}

/// Where the ball is (robot base, mm) and the root mean square of its predicted 3-D error there, mm.
pub type ErrorMap = Vec<([f64; 3], f64)>;

/// The residuals of one observation, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResidualPair {
    /// With the nominal robot and the fitted set-up.
    pub before: f64,
    /// With the identified robot.
    pub after: f64,
}

/// Identifies the robot from `observations`, starting from its nominal geometry (its `[nominal]`
/// table where it has one) and the base balls at `centres`. `validation` is a separate set of lengths
/// to the same balls on which nothing is fitted.
///
/// # Errors
/// [`IdentifyError`]: numbers that are not finite, nothing to estimate.
pub fn identify(
    robot: &Robot,
    observations: &Observations,
    centres: &[Centre],
    validation: Option<&Observations>,
    options: &Options,
) -> Result<Identified, IdentifyError> {
    let start = LengthModel::new(robot.geometry.clone(), centres);
    let lengths = Lengths::of(&observations.rows, options);
    let Settled { asked, options, prior, estimate, groups } =
        settle(robot, &start, &lengths, observations, options)?;
    let folds = match options.folds {
        Some(0 | 1) => None,
        Some(folds) => Some(folds),
        None => {
            let enough = folds::LENGTHS_PER_PARAMETER * estimate.base.len();
            (enough..=folds::MOST_UNASKED).contains(&lengths.len()).then_some(folds::DEFAULT_FOLDS)
        }
    };
    let hold_out = |folds| -> Result<Option<Folds>, IdentifyError> {
        // Optional groups are chosen anew in each fold: a choice made with the lengths held out would have seen them.
        let fit =
            |training: &Lengths| Ok(groups::choose(robot, &start, training, asked.clone(), &options)?.0);
        let out = folds::held_out(&lengths, &estimate.fit.out, folds, fit)?;
        Ok(out.map(|residuals| Folds { folds, rms: folds::rms(&residuals) }))
    };
    let folds = folds.map(hold_out).transpose()?.flatten();
    let mut found =
        summary::summarise(robot, observations, &start, &lengths, &estimate, folds, validation, &options)?;
    let result = &mut found.result;
    result.prior = prior;
    result.groups = groups;
    interval::tell(result, &estimate, &lengths);
    if result.groups.iter().any(|group| group.added) {
        let text = "robot-identified.toml holds compliance or gear error: a program that reads only its lengths and \
                    angles computes with another robot; `--hold compliance,gear` identifies without them";
        result.warnings.push(Warning { kind: WarningKind::Note, text: text.into() });
    }
    if let Some(trials) = options.monte_carlo {
        monte_carlo::tell(result, options.tolerances(robot), &estimate, &lengths, trials);
    }
    Ok(found)
}

/// Only the fit of [`identify`]: the model found, without covariance, folds or predictions.
///
/// # Errors
/// As [`identify`].
pub fn fit(
    robot: &Robot,
    observations: &Observations,
    centres: &[Centre],
    options: &Options,
) -> Result<LengthModel, IdentifyError> {
    let start = LengthModel::new(robot.geometry.clone(), centres);
    let lengths = Lengths::of(&observations.rows, options);
    Ok(settle(robot, &start, &lengths, observations, options)?.estimate.fit.model)
}

/// An estimate with what was left to the data settled.
struct Settled<'a> {
    /// Without the optional groups that nobody named.
    asked: Vec<ParamId>,
    options: Cow<'a, Options>,
    prior: Option<PriorUsed>,
    estimate: Estimate,
    groups: Vec<GroupChoice>,
}

/// Settles the prior's scale, then the optional groups.
fn settle<'a>(
    robot: &Robot,
    start: &LengthModel,
    lengths: &Lengths,
    observations: &Observations,
    options: &'a Options,
) -> Result<Settled<'a>, IdentifyError> {
    let set_up = SetUp { centres: start.centres.len(), bars: observations.bars() };
    let asked = estimate::asked(robot, set_up, options);
    let (options, prior) = scale::settle(robot, start, lengths, &asked, options)?;
    let (estimate, groups) = groups::choose(robot, start, lengths, asked.clone(), &options)?;
    Ok(Settled { asked, options, prior, estimate, groups })
}
