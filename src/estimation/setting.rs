//! What an estimate starts from.

use std::borrow::Cow;

use super::Options;
use super::priors::{Prior, Priors};
use crate::measurement::{LengthModel, Measurements};
use crate::robot::parameter::{self, SetUp};
use crate::robot::{ParamId, Robot};

/// The robot with its priors, the start of the fit, and what the user asked for.
#[derive(Clone)]
pub(crate) struct Setting<'a> {
    pub(crate) robot: &'a Robot,
    /// The robot's geometry in the set-up as it was given.
    pub(crate) start: &'a LengthModel,
    pub(crate) set_up: SetUp,
    pub(crate) options: Cow<'a, Options>,
    pub(crate) priors: Priors,
}

impl<'a> Setting<'a> {
    pub(super) fn new(
        robot: &'a Robot,
        start: &'a LengthModel,
        observations: &Measurements,
        options: &'a Options,
    ) -> Self {
        let set_up = observations.set_up(start.balls.len());
        Self { robot, start, set_up, options: Cow::Borrowed(options), priors: options.priors(robot) }
    }

    /// With a prior on the geometry: the user's, else the robot's tolerance.
    pub(super) fn bound(self) -> Self {
        if self.options.prior != Prior::None {
            return self;
        }
        let options = Options { prior: Prior::Datasheet, ..self.options.clone().into_owned() };
        Self { options: Cow::Owned(options), ..self }
    }

    /// With all standard deviations of the prior so many times as large.
    pub(super) fn widened(self, times: f64) -> Self {
        Self { priors: self.priors.widened(times), ..self }
    }

    /// The parameters asked for, without the optional groups that nobody named.
    pub(super) fn asked(&self) -> Vec<ParamId> {
        let mut ids = match &self.options.estimate {
            Some(list) => list.clone(),
            None => parameter::all(&self.robot.parallel_joints(), self.set_up),
        };
        ids.retain(|id| !self.options.hold.contains(id));
        ids.sort();
        ids
    }

    /// Every parameter of the model and those of `more`, in canonical order.
    pub(super) fn all_and(&self, set_up: SetUp, more: &[ParamId]) -> Vec<ParamId> {
        let mut ids = parameter::all(&self.robot.parallel_joints(), set_up);
        ids.extend(more);
        ids.sort();
        ids.dedup();
        ids
    }
}
