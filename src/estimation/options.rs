//! What the user asked of an identification.

use std::borrow::Cow;

use super::Workspace;
use super::priors::{Prior, Priors};
use crate::catalogue::EstimationFinding;
use crate::robot::{AXES, ParamId, Robot};

/// What a robot's error consists of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ErrorModel {
    /// The geometry by its prior, and errors of the joints as the evidence speaks for them.
    #[default]
    Joints,
    /// Its geometry.
    Geometric,
}

/// What to estimate, and from what.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// The parameters to estimate; all that are identifiable when absent.
    pub estimate: Option<Vec<ParamId>>,
    pub model: ErrorModel,
    /// Parameters to fix at their start values.
    pub hold: Vec<ParamId>,
    /// Standard deviation of every length, mm; that of the data's `sigma_mm` and residuals when absent.
    pub sigma_mm: Option<f64>,
    /// What is known of the robot beforehand.
    pub prior: Prior,
    /// Standard uncertainty of each bar's length by its certificate, mm.
    pub bar_u_mm: Option<f64>,
    /// Number of cross-validation folds; `None` chooses 5 when there are enough lengths.
    pub folds: Option<usize>,
    /// Trials of a Monte Carlo of the uncertainties (GUM supplement 1); none when absent.
    pub monte_carlo: Option<usize>,
    /// Axis vectors (rad) over which the 3-D error is predicted; uniform within the limits when absent.
    pub workspace: Option<Vec<[f64; AXES]>>,
}

/// Poses over which the error is predicted when the user gives none, and their seed.
const WORKSPACE_POSES: usize = 2000;
const WORKSPACE_SEED: u64 = 1;

impl Options {
    /// That they can be followed with so many lengths.
    ///
    /// # Errors
    /// What no identification can follow, though each value alone is possible.
    pub fn check(&self, lengths: usize) -> Result<(), EstimationFinding> {
        if let Some(folds) = self.folds.filter(|folds| *folds == 1 || *folds > lengths) {
            return Err(EstimationFinding::NoFolds { folds, lengths });
        }
        match &self.prior {
            Prior::Given(sd) if sd.is_empty() => Err(EstimationFinding::EmptyPrior),
            _ => Ok(()),
        }
    }

    /// The axis angles (rad) over which a 3-D error is predicted.
    pub fn workspace_poses(&self, robot: &Robot) -> Cow<'_, [[f64; AXES]]> {
        match &self.workspace {
            Some(poses) => Cow::Borrowed(poses),
            None => Cow::Owned(Workspace::uniform(robot, WORKSPACE_POSES, WORKSPACE_SEED)),
        }
    }

    /// Whether the user's list is followed as it is: there is one, and no prior that could carry
    /// what the data do not.
    pub fn follows_list(&self) -> bool {
        self.estimate.is_some() && self.prior == Prior::None
    }

    /// Whether errors of the joints are looked for: what the user lists is complete, and a Monte Carlo draws the lengths
    /// of the geometry alone.
    pub(super) fn seeks_joint_errors(&self) -> bool {
        self.model == ErrorModel::Joints
            && self.estimate.is_none()
            // A prior with correlations is that of the geometry.
            && self.prior != Prior::Posterior
            && self.monte_carlo.is_none()
    }

    /// What is known of the robot and the bar before any length.
    pub fn priors(&self, robot: &Robot) -> Priors {
        Priors::of(robot, self.bar_u_mm, &self.prior)
    }
}
