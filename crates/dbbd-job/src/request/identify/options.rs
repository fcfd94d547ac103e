//! The options of an identification, independent of the source of its measurements.

use std::collections::BTreeMap;

use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::{EstimationFinding, Options, Prior};
use dbbd_model::robot::parameter::{self, SetUpCounts};
use dbbd_model::robot::{ParamId, Robot};

use super::RequestedPrior;

/// The options that a caller requests; their tables are already read.
pub struct AskedIdentification<'a> {
    /// The parameters to estimate: names, ranges, groups. `None` for all that are identifiable.
    pub estimate: Option<&'a str>,
    /// The parameters to fix at their start values.
    pub hold: Option<&'a str>,
    /// `None` for the posterior of the robot if it has one, else its tolerance; with a list of parameters for none.
    pub prior: Option<RequestedPrior<BTreeMap<ParamId, f64>>>,
    /// The other options.
    pub rest: Options,
}

impl AskedIdentification<'_> {
    /// The options for a robot and this number of measured rows. `known` counts the rows from which the prior was
    /// identified. The finding says why the posterior of the robot is not used.
    ///
    /// # Errors
    /// The errors of `known`, or an option requests something that robot, set-up or rows do not have.
    pub fn options(
        self,
        robot: &Robot,
        rows: usize,
        set_up: SetUpCounts,
        known: impl FnOnce() -> Result<usize, Diagnostic>,
    ) -> Result<(Options, Option<EstimationFinding>), Diagnostic> {
        let Self { estimate, hold, prior, rest } = self;
        let (prior, lost) = match prior {
            // A requested list of parameters is used without a prior.
            None if estimate.is_some() => (Prior::None, None),
            None => Prior::continued(robot, rows, known)?,
            Some(RequestedPrior::None) => (Prior::None, None),
            Some(RequestedPrior::Datasheet) => (Prior::Datasheet, None),
            Some(RequestedPrior::Posterior) => match Prior::continued(robot, rows, known)? {
                (Prior::Posterior, lost) => (Prior::Posterior, lost),
                (Prior::None | Prior::Datasheet | Prior::Given(_), _) => {
                    return Err(EstimationFinding::NoPosterior.into());
                }
            },
            Some(RequestedPrior::Table(deviations)) => {
                Prior::Given(deviations).of_other_lengths(rows, known()?)
            }
        };
        let betas = robot.parallel_joints();
        let list =
            |text: Option<&str>| text.map(|text| parameter::parse_list(text, &betas, set_up)).transpose();
        let (estimate, hold) = (list(estimate)?, list(hold)?.unwrap_or_default());
        let options = Options { estimate, hold, prior, ..rest };
        options.check(rows)?;
        Ok((options, lost))
    }
}
