//! The options of an identification, and the setting of an estimate.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

use super::Workspace;
use super::priors::{Prior, Priors};
use crate::estimation::EstimationFinding;
use crate::measurement::{LengthModel, Measurements};
use crate::robot::parameter::{self, SetUpCounts};
use crate::robot::{AXES, MeasurementConditions, ParamId, Robot};

/// The errors of a robot that are modelled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ErrorModel {
    /// The geometry with its prior, and errors of the joints if the evidence supports them.
    #[default]
    #[serde(rename = "joint_errors")]
    Joints,
    /// The geometry alone.
    Geometric,
}

#[derive(Clone, Debug, Default)]
pub struct Options {
    /// The parameters to estimate; by default all identifiable ones.
    pub estimate: Option<Vec<ParamId>>,
    pub model: ErrorModel,
    /// Parameters to fix at their start values.
    pub hold: Vec<ParamId>,
    /// Standard deviation of every length, mm; by default it follows from `sigma_mm` of the data and from the
    /// residuals.
    pub sigma_mm: Option<f64>,
    pub prior: Prior,
    /// Standard uncertainty of each bar's length by its certificate, mm.
    pub bar_u_mm: Option<f64>,
    /// Number of cross-validation folds; by default 5 if there are enough lengths.
    pub folds: Option<usize>,
    /// Trials of a Monte Carlo of the uncertainties (GUM Supplement 1); by default none.
    pub monte_carlo: Option<usize>,
    /// Axis vectors (rad) over which the position error is predicted; by default uniform within the axis limits.
    pub workspace: Option<Vec<[f64; AXES]>>,
    /// The largest expanded uncertainty with which the calibration is still used, mm: it ends the validity of the result.
    pub tolerance_mm: Option<f64>,
    /// Date and temperature of the measurement.
    pub measured: MeasurementConditions,
}

/// Poses and seed of the default workspace.
const WORKSPACE_POSES: usize = 2000;
const WORKSPACE_SEED: u64 = 1;

impl Options {
    /// # Errors
    /// Too few lengths for the folds, or a prior without parameters.
    pub fn check(&self, lengths: usize) -> Result<(), EstimationFinding> {
        if let Some(folds) = self.folds.filter(|folds| *folds == 1 || *folds > lengths) {
            return Err(EstimationFinding::NoFolds { folds, lengths });
        }
        if matches!(&self.prior, Prior::Given(sd) if sd.is_empty()) {
            return Err(EstimationFinding::EmptyPrior);
        }
        Ok(())
    }

    /// The axis vectors (rad) over which the position error is predicted.
    pub fn workspace_poses(&self, robot: &Robot) -> Cow<'_, [[f64; AXES]]> {
        match &self.workspace {
            Some(poses) => Cow::Borrowed(poses),
            None => Cow::Owned(Workspace::uniform(robot, WORKSPACE_POSES, WORKSPACE_SEED)),
        }
    }

    /// Whether all identifiable parameters of the user's list are estimated, even if they are poorly observable.
    pub fn follows_list(&self) -> bool {
        self.estimate.is_some() && self.prior == Prior::None
    }

    /// Whether errors that the geometry does not explain are estimated too. A list of parameters names all unknowns.
    pub(super) fn seeks_joint_errors(&self) -> bool {
        self.estimate.is_none()
    }
}

/// The robot with its priors, the start of the fit, and the options.
#[derive(Clone)]
pub(crate) struct Setting<'a> {
    pub(crate) robot: &'a Robot,
    /// The robot's geometry in the set-up as it was given.
    pub(crate) start: &'a LengthModel,
    pub(crate) set_up: SetUpCounts,
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
        let priors = Priors::of(robot, options.bar_u_mm, &options.prior);
        Self { robot, start, set_up, options: Cow::Borrowed(options), priors }
    }

    /// The parameters asked for, in canonical order; by default all but the optional ones.
    pub(super) fn asked(&self) -> Vec<ParamId> {
        let mut ids = match &self.options.estimate {
            Some(list) => list.clone(),
            None => parameter::all_parameters(&self.robot.parallel_joints(), self.set_up),
        };
        ids.retain(|id| !self.options.hold.contains(id));
        ids.sort();
        ids
    }

    /// Every parameter of the model and the parameters `more`, in canonical order.
    pub(super) fn all_and(&self, set_up: SetUpCounts, more: &[ParamId]) -> Vec<ParamId> {
        let mut ids = parameter::all_parameters(&self.robot.parallel_joints(), set_up);
        ids.extend(more);
        ids.sort();
        ids.dedup();
        ids
    }
}
