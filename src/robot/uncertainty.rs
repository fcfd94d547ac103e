//! What is not known of a robot: the covariance of its parameters and of the errors of its joints, as its file holds it.

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::{ParamId, Robot};

/// Digits of the root that a file holds.
const DIGITS: usize = 4;

#[derive(Clone, Debug, PartialEq)]
pub struct RobotUncertainty {
    /// Parameters of the robot and its tool ball.
    pub parameters: Vec<ParamId>,
    /// A root of the covariance, C = root root': a row each parameter, then a row each coefficient of the joints' errors
    /// in the order of [`super::JointErrors::terms`].
    pub root: DMatrix<f64>,
    /// Standard deviation with which a pose repeats in each direction, mm.
    pub pose_mm: f64,
    /// Before any length: standard deviation of a smooth function of a joint's angle, and the angle over which it is
    /// alike, rad. It holds where the angles were not measured.
    pub smooth_rad: f64,
    pub likeness_rad: f64,
    /// Whether the sense of approach was known: else backlash is a part of `pose_mm`.
    pub backlash_is_known: bool,
}

impl RobotUncertainty {
    /// Of a robot by its file: with the errors of its joints, by what its identification left unknown, or by its tolerance.
    pub fn of(robot: &Robot) -> Self {
        let by_posterior = || {
            let posterior = robot.posterior.as_ref().filter(|posterior| posterior.is_of(&robot.geometry))?;
            let parameters = posterior.ids().to_vec();
            let known = posterior.root_of(&parameters);
            let rows = known.nrows() + robot.geometry.joint_errors.count();
            let mut root = DMatrix::zeros(rows, known.ncols());
            root.rows_mut(0, known.nrows()).copy_from(&known);
            Some(Self { parameters, root, ..Self::nominal(robot) })
        };
        robot.uncertainty.as_deref().cloned().or_else(by_posterior).unwrap_or_else(|| Self::nominal(robot))
    }

    /// Of a robot that is known by its tolerance.
    fn nominal(robot: &Robot) -> Self {
        let parallel = robot.parallel_joints();
        let geometric = super::parameter::all(&parallel, 0).into_iter().filter(|id| id.is_geometric());
        let parameters: Vec<ParamId> = geometric.collect();
        let angle_rad = robot.tolerance.angle_deg.to_radians();
        let sd =
            |id: &ParamId| if id.unit() == super::Unit::Mm { robot.tolerance.length_mm } else { angle_rad };
        let count = parameters.len();
        let rows = count + robot.geometry.joint_errors.count();
        let root = DMatrix::from_fn(rows, count, |i, j| if i == j { sd(&parameters[i]) } else { 0.0 });
        Self {
            parameters,
            root,
            pose_mm: robot.repeatability_sd_mm().unwrap_or(0.0),
            smooth_rad: 0.0,
            likeness_rad: 1.0,
            backlash_is_known: true,
        }
    }

    /// Whether its rows are those of this robot.
    fn fits(&self, robot: &Robot) -> bool {
        self.root.nrows() == self.parameters.len() + robot.geometry.joint_errors.count()
            && self.root.iter().all(|value| value.is_finite())
            && [self.pose_mm, self.smooth_rad, self.likeness_rad].iter().all(|value| value.is_finite())
            && self.likeness_rad > 0.0
    }
}

#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct UncertaintyTable {
    pose_mm: f64,
    smooth_rad: f64,
    likeness_rad: f64,
    backlash_is_known: bool,
    parameters: Vec<ParamId>,
    root: Vec<Vec<f64>>,
}

impl UncertaintyTable {
    pub(super) fn of(uncertainty: &RobotUncertainty) -> Self {
        let rows = uncertainty.root.row_iter();
        Self {
            pose_mm: uncertainty.pose_mm,
            smooth_rad: uncertainty.smooth_rad,
            likeness_rad: uncertainty.likeness_rad,
            backlash_is_known: uncertainty.backlash_is_known,
            parameters: uncertainty.parameters.clone(),
            root: rows.map(|row| row.iter().copied().map(rounded).collect()).collect(),
        }
    }

    /// `None` where it does not fit the robot.
    pub(super) fn uncertainty(&self, robot: &Robot) -> Option<RobotUncertainty> {
        let columns = self.root.first().map_or(0, Vec::len);
        if self.root.iter().any(|row| row.len() != columns) {
            return None;
        }
        let uncertainty = RobotUncertainty {
            parameters: self.parameters.clone(),
            root: DMatrix::from_fn(self.root.len(), columns, |i, j| self.root[i][j]),
            pose_mm: self.pose_mm,
            smooth_rad: self.smooth_rad,
            likeness_rad: self.likeness_rad,
            backlash_is_known: self.backlash_is_known,
        };
        uncertainty.fits(robot).then_some(uncertainty)
    }
}

/// To the digits that are written.
fn rounded(value: f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    format!("{value:.*e}", DIGITS - 1).parse().unwrap_or(value)
}
