//! The table of all parameters of a result.

use super::Combination;
use super::estimator::Estimate;
use super::monte_carlo::Draws;
use super::options::Setting;
use super::posterior::Posterior;
use super::result::{ParameterResult, Status};
use crate::robot::ParamId;

/// Why a parameter has its status.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Reason {
    Identified,
    /// Identified as a member of a combination; `shared` if the prior distributes the combination among several
    /// members.
    IdentifiedFor {
        combination: Combination,
        shared: bool,
    },
    /// The lengths determine only the combination; the prior distributes it among its members.
    PriorShares {
        combination: Option<Combination>,
    },
    /// Supported by the prior: the lengths alone give only this standard deviation.
    PriorCarries {
        data_sd: f64,
    },
    /// The evidence gives the prior variance of the parameter's group; `determined` is the fraction that the lengths
    /// determine.
    ByEvidence {
        determined: f64,
    },
    Dependent {
        combination: Option<Combination>,
    },
    FixedAsAsked,
    NotAsked,
    ChangesNoLength,
    /// A coordinate of the set-up whose standard deviation would exceed the limit.
    Open {
        limit: f64,
    },
}

impl Reason {
    fn status(&self) -> Status {
        match self {
            Self::Identified | Self::IdentifiedFor { .. } => Status::Identified,
            Self::ByEvidence { determined } if *determined > 0.5 => Status::Identified,
            Self::PriorShares { .. } | Self::PriorCarries { .. } | Self::ByEvidence { .. } => {
                Status::SupportedByPrior
            }
            Self::Dependent { .. } => Status::Dependent,
            Self::FixedAsAsked | Self::NotAsked | Self::ChangesNoLength => Status::Fixed,
            Self::Open { .. } => Status::PoorlyObservable,
        }
    }
}

pub(super) struct ParameterTable<'a> {
    pub(super) setting: &'a Setting<'a>,
    pub(super) estimate: &'a Estimate,
    pub(super) posterior: &'a Posterior,
    /// Standard deviations of the base set by the data alone; empty if the data do not determine them.
    pub(super) data_sd: Vec<f64>,
    pub(super) coverage_factor: Option<f64>,
    pub(super) draws: Option<&'a Draws>,
    pub(super) combinations: Vec<Combination>,
}

impl ParameterTable<'_> {
    pub(super) fn parameters(&self) -> Vec<ParameterResult> {
        let Setting { robot, start, set_up, .. } = *self.setting;
        let mut nominal = start.clone();
        if let Some(before) = &robot.nominal {
            nominal.geometry = before.geometry.clone();
        }
        let more = [self.estimate.analysis.ids.as_slice(), &self.estimate.kept].concat();
        let ids = self.setting.all_and(set_up, &more);
        ids.into_iter().map(|id| self.parameter(id, start.value(id), nominal.value(id))).collect()
    }

    fn parameter(&self, id: ParamId, start: f64, nominal: f64) -> ParameterResult {
        let identified = self.estimate.fit.model.value(id);
        let sd = self.posterior.sd(id);
        let interval = |(factor, sd): (f64, f64)| [identified - factor * sd, identified + factor * sd];
        let reason = self.reason(id);
        ParameterResult {
            name: id,
            unit: id.unit(),
            start,
            nominal,
            identified,
            correction: identified - nominal,
            sd,
            prior_sd: self.estimate.prior_sd(id),
            interval95: self.coverage_factor.zip(sd).map(interval),
            monte_carlo: self.draws.and_then(|draws| draws.parameter(id)),
            status: reason.status(),
            reason: reason.text(id),
        }
    }

    fn reason(&self, id: ParamId) -> Reason {
        let Setting { options, .. } = self.setting;
        let Estimate { kept, analysis, open, .. } = self.estimate;
        if kept.contains(&id) {
            self.reason_of_estimated(id)
        } else if options.hold.contains(&id) {
            Reason::FixedAsAsked
        } else if open.contains(&id) {
            Reason::Open { limit: id.max_sd().unwrap_or(f64::INFINITY) }
        } else if !analysis.ids.contains(&id) {
            Reason::NotAsked
        } else if analysis.zero().contains(&id) {
            Reason::ChangesNoLength
        } else {
            Reason::Dependent { combination: self.combination(id) }
        }
    }

    /// The reason for an estimated parameter, from the data alone, or for an optional one from prior and posterior.
    fn reason_of_estimated(&self, id: ParamId) -> Reason {
        let Estimate { kept, base, .. } = self.estimate;
        let after = self.posterior.sd(id).unwrap_or(f64::INFINITY);
        let data_sd = base.iter().position(|own| *own == id).and_then(|at| self.data_sd.get(at)).copied();
        if id.is_optional() {
            let before = self.estimate.prior_sd(id).unwrap_or(f64::INFINITY);
            return Reason::ByEvidence { determined: 1.0 - (after / before).powi(2) };
        }
        let Some(data_sd) = data_sd else {
            return Reason::PriorShares { combination: self.combination(id) };
        };
        let has_prior = self.estimate.prior_sd(id).is_some();
        if has_prior && data_sd > self.setting.priors.weak_limit(id) {
            return Reason::PriorCarries { data_sd };
        }
        let Some(combination) = self.combinations.iter().find(|combination| combination.kept == id) else {
            return Reason::Identified;
        };
        let shared = combination.members.iter().any(|(member, _)| *member != id && kept.contains(member));
        Reason::IdentifiedFor { combination: combination.clone(), shared }
    }

    /// The first combination with this member.
    fn combination(&self, id: ParamId) -> Option<Combination> {
        self.combinations.iter().find(|combination| combination.contains(id)).cloned()
    }
}
