//! What the user asked of an identification.

use std::borrow::Cow;
use std::collections::BTreeMap;

use crate::identifiability::Workspace;
use crate::model::{AXES, ParamId, Robot};

/// What to estimate, from what, and how much to tell.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// The parameters to estimate; all that the data can tell when absent.
    pub estimate: Option<Vec<ParamId>>,
    /// Parameters to hold at their start values.
    pub hold: Vec<ParamId>,
    /// Standard deviation of every length, mm; that of the data's `sigma_mm` and residuals when absent.
    pub sigma_mm: Option<f64>,
    /// What is known of the robot beforehand.
    pub prior: Prior,
    /// Standard uncertainty of each bar's length by its certificate, mm.
    pub bar_u_mm: Option<f64>,
    /// How far the prior is trusted.
    pub prior_scale: PriorScale,
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
    /// The axis angles (rad) over which a 3-D error is predicted.
    pub(super) fn workspace_poses(&self, robot: &Robot) -> Cow<'_, [[f64; AXES]]> {
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

    /// The standard deviation of a parameter's true error as the prior has it, mm or rad (rad/(N m) of a
    /// compliance), a bar's offset as its certificate has it; `None` for one that has neither.
    pub(super) fn prior_sd(&self, robot: &Robot, id: ParamId) -> Option<f64> {
        let scale = if let PriorScale::By(scale) = self.prior_scale { scale } else { 1.0 };
        let by_prior = self.prior.sd(robot, id).map(|sd| scale * sd);
        by_prior.or_else(|| self.bar_u_mm.filter(|_| matches!(id, ParamId::BarOffset(_))))
    }

    /// What is known of the parameters that may be held.
    pub(super) fn tolerances<'a>(&self, robot: &'a Robot) -> Tolerances<'a> {
        Tolerances { robot, bar_mm: self.bar_u_mm.unwrap_or(robot.tolerance.length_mm / BAR_BETTER) }
    }
}

/// One standard deviation of the true error of what may be held: the robot's tolerance, the bar's certificate.
#[derive(Clone, Copy)]
pub(super) struct Tolerances<'a> {
    robot: &'a Robot,
    bar_mm: f64,
}

/// A bar without certificate is known better than a robot's lengths by this factor at least.
const BAR_BETTER: f64 = 10.0;
/// A parameter counts as identified when its standard deviation is at most this many tolerances.
const WEAK: f64 = 3.0;

impl Tolerances<'_> {
    /// mm or rad; `None` of balls.
    fn of(&self, id: ParamId) -> Option<f64> {
        match id {
            ParamId::BarOffset(_) => Some(self.bar_mm),
            _ => tolerance(self.robot, id).or_else(|| plausible(self.robot, id)),
        }
    }

    /// The largest standard deviation with which a parameter counts as identified, mm or rad; balls have no limit.
    pub(super) fn weak_limit(&self, id: ParamId) -> Option<f64> {
        self.of(id).map(|sd| WEAK * sd)
    }

    /// The error of a parameter that is held; optional ones are taken for none, as where they are not asked for.
    pub(super) fn held(&self, id: ParamId) -> f64 {
        self.of(id).filter(|_| !id.is_optional()).unwrap_or(0.0)
    }
}

/// What is known of the robot beforehand: one standard deviation of each geometric parameter about
/// its nominal value.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Prior {
    /// Nothing.
    #[default]
    None,
    /// The tolerance in the robot's file.
    Datasheet,
    /// Given for some parameters; the datasheet's for the rest.
    Given(BTreeMap<ParamId, f64>),
}

/// A factor on every standard deviation of the prior: above 1 the lengths count for more.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum PriorScale {
    /// 1.
    #[default]
    AsGiven,
    /// This one.
    By(f64),
    /// The one with which held-out lengths are predicted best.
    CrossValidated,
}

impl Prior {
    /// The standard deviation of a parameter's true error, mm or rad; `None` for one that has no tolerance.
    fn sd(&self, robot: &Robot, id: ParamId) -> Option<f64> {
        if let Self::Given(given) = self
            && let Some(sd) = given.get(&id)
        {
            return Some(*sd);
        }
        tolerance(robot, id).or_else(|| plausible(robot, id))
    }
}

/// The maker's tolerance of a geometric parameter, one standard deviation in mm or rad.
pub fn tolerance(robot: &Robot, id: ParamId) -> Option<f64> {
    id.is_geometric().then(|| match id.unit() {
        "mm" => robot.tolerance.length_mm,
        _ => robot.tolerance.angle_deg.to_radians(),
    })
}

/// What an optional parameter may plausibly be, one standard deviation: a gear error as large as the tolerance
/// of a joint's angle, a compliance that gives way by as much under the greatest torque.
fn plausible(robot: &Robot, id: ParamId) -> Option<f64> {
    let angle = robot.tolerance.angle_deg.to_radians();
    match id {
        ParamId::GearCos(_) | ParamId::GearSin(_) => Some(angle),
        ParamId::Compliance(j) => {
            Some(angle / robot.geometry.greatest_torques()[j - 1]).filter(|c| c.is_finite())
        }
        _ => None,
    }
}
