//! What the user asked of an identification.

use std::collections::BTreeMap;

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
    /// Number of cross-validation folds; `None` chooses 5 when there are enough lengths.
    pub folds: Option<usize>,
    /// Axis vectors (rad) over which the 3-D error is predicted; uniform within the limits when absent.
    pub workspace: Option<Vec<[f64; AXES]>>,
}

impl Options {
    /// Whether the user's list is followed as it is: there is one, and no prior that could carry
    /// what the data do not.
    pub fn follows_list(&self) -> bool {
        self.estimate.is_some() && self.prior == Prior::None
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

impl Prior {
    /// The standard deviation of a parameter's true error, mm or rad; `None` for one that has no tolerance.
    pub fn sd(&self, robot: &Robot, id: ParamId) -> Option<f64> {
        if let Self::Given(given) = self
            && let Some(sd) = given.get(&id)
        {
            return Some(*sd);
        }
        tolerance(robot, id)
    }
}

/// The maker's tolerance of a geometric parameter, one standard deviation in mm or rad.
pub fn tolerance(robot: &Robot, id: ParamId) -> Option<f64> {
    id.is_geometric().then(|| match id.unit() {
        "mm" => robot.tolerance.length_mm,
        _ => robot.tolerance.angle_deg.to_radians(),
    })
}
