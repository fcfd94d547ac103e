//! What is not known of a robot: the covariance of its parameters and of the errors of its joints, as its file holds it.

use nalgebra::DMatrix;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::{AXES, ParamId, Robot};

/// Digits of the root that a file holds.
const DIGITS: usize = 4;

/// A Gaussian process of an angle with Matern-5/2 covariance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GaussianProcess {
    pub sd_rad: f64,
    #[serde(rename = "likeness_rad")]
    pub length_scale_rad: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotUncertainty {
    /// Standard deviation with which a pose repeats in each direction, mm.
    pub pose_mm: f64,
    /// What a smooth function of a joint's angle is the sum of, before any length. It holds where the angles were not
    /// measured.
    pub smooth: Vec<GaussianProcess>,
    /// What an unknown sense of approach leaves of each joint's angle, rad.
    pub unapproached_rad: [f64; AXES],
    /// Parameters of the robot and its tool ball, and coordinates of the base balls.
    pub parameters: Vec<ParamId>,
    /// A root of the covariance, C = root root': a row each parameter, then a row each coefficient of the joints' errors
    /// in the order of [`super::JointErrors::terms`].
    #[serde(serialize_with = "write_root", deserialize_with = "read_root")]
    pub root: DMatrix<f64>,
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
        let geometric =
            super::parameter::all_parameters(&parallel, 0).into_iter().filter(|id| id.is_geometric());
        let parameters: Vec<ParamId> = geometric.collect();
        let angle_rad = robot.tolerance.angle_deg.to_radians();
        let sd = |id: &ParamId| {
            if id.unit() == super::ParamUnit::Mm { robot.tolerance.length_mm } else { angle_rad }
        };
        let count = parameters.len();
        let rows = count + robot.geometry.joint_errors.count();
        let root = DMatrix::from_fn(rows, count, |i, j| if i == j { sd(&parameters[i]) } else { 0.0 });
        Self {
            parameters,
            root,
            pose_mm: robot.repeatability_sd_mm().unwrap_or(0.0),
            smooth: Vec::new(),
            unapproached_rad: [0.0; AXES],
        }
    }

    /// Whether its rows are those of this robot.
    pub(super) fn fits(&self, robot: &Robot) -> bool {
        self.root.nrows() == self.parameters.len() + robot.geometry.joint_errors.count()
            && self.root.iter().all(|value| value.is_finite())
            && self.pose_mm.is_finite()
            && self.smooth.iter().all(|part| part.sd_rad.is_finite() && part.length_scale_rad > 0.0)
    }

    /// The variance of a smooth function, rad^2.
    pub fn smooth_variance(&self) -> f64 {
        self.smooth.iter().map(|part| part.sd_rad.powi(2)).sum()
    }

    /// Its spectral density at an angular frequency (1/rad), rad^3.
    pub fn spectral_density(&self, frequency: f64) -> f64 {
        self.smooth.iter().map(|part| part.spectral_density(frequency)).sum()
    }
}

impl GaussianProcess {
    /// The spectral density at an angular frequency (1/rad), rad^3.
    pub fn spectral_density(&self, frequency: f64) -> f64 {
        let a2 = 5.0 / self.length_scale_rad.powi(2);
        self.sd_rad * self.sd_rad * (16.0 / 3.0) * a2 * a2 * a2.sqrt() / (a2 + frequency * frequency).powi(3)
    }
}

fn write_root<S: Serializer>(root: &DMatrix<f64>, to: S) -> Result<S::Ok, S::Error> {
    to.collect_seq(root.row_iter().map(|row| row.iter().copied().map(rounded).collect::<Vec<f64>>()))
}

fn read_root<'de, D: Deserializer<'de>>(from: D) -> Result<DMatrix<f64>, D::Error> {
    let rows: Vec<Vec<f64>> = Vec::deserialize(from)?;
    let columns = rows.first().map_or(0, Vec::len);
    // Rows that differ in length fit no robot.
    let whole = rows.iter().all(|row| row.len() == columns);
    Ok(DMatrix::from_fn(rows.len(), columns, |i, j| if whole { rows[i][j] } else { f64::NAN }))
}

/// To the digits that are written.
fn rounded(value: f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    format!("{value:.*e}", DIGITS - 1).parse().unwrap_or(value)
}
