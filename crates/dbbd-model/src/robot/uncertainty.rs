//! The uncertainty of a robot: the covariance of its parameters and of the errors of its joints, as the robot file
//! holds it.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::posterior::with_steps;
use super::tolerance::Tolerance;
use super::{AXES, Geometry, Joint, ParamId};
use crate::base::fixed_array::fixed_array;
use crate::math::distributions::{chi_square_exceeded, f_exceeded, lower_freedom};

/// Significant digits of the root in a robot file.
const DIGITS: usize = 4;

/// A Gaussian process of an angle with Matern-5/2 covariance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GaussianProcess {
    pub(crate) sd_rad: f64,
    #[serde(rename = "likeness_rad")]
    pub(crate) length_scale_rad: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotUncertainty {
    /// Standard deviation with which a pose repeats in each direction, mm.
    pub pose_mm: f64,
    /// What the lengths of a visit shared in the identification, root mean square, mm: errors of the pose and of its joints.
    /// `None` if no visit had several lengths that show it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shared_mm: Option<f64>,
    /// The part of `pose_mm` that neither the bar nor the stated repeatability explains, mm: the predicted position uncertainty over a
    /// workspace contains it.
    #[serde(default)]
    pub unexplained_mm: f64,
    /// Degrees of freedom of the standard deviation of a length, which the covariance follows; `None` if it was not estimated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub degrees_of_freedom: Option<f64>,
    /// Degrees of freedom of the t-distribution of the errors of a visit, whose covariance is what is predicted; `None` for normal
    /// ones.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub visit_degrees_of_freedom: Option<f64>,
    /// Gaussian processes whose sum is the prior of the smooth function of a joint's angle. It still holds at angles
    /// that were not measured.
    pub smooth: Vec<GaussianProcess>,
    /// The factor on the smooth function of each joint.
    #[serde(default = "one_each", deserialize_with = "fixed_array")]
    pub smooth_of_joints: [f64; AXES],
    /// Random error of each joint's angle from visit to visit, one standard deviation, rad.
    #[serde(default, deserialize_with = "fixed_array")]
    pub(crate) scatter_rad: [f64; AXES],
    /// Error of each joint's angle by backlash where the sense of approach is not known, one standard deviation, rad.
    #[serde(deserialize_with = "fixed_array")]
    pub(crate) unapproached_rad: [f64; AXES],
    /// Parameters of the robot and its tool ball, and coordinates of the base balls.
    pub parameters: Vec<ParamId>,
    /// A root of the covariance, C = root root': a row for each parameter, then a row for each coefficient of the
    /// joints' errors in the order of `JointErrors::terms`.
    #[serde(serialize_with = "write_root", deserialize_with = "read_root")]
    pub root: DMatrix<f64>,
}

impl RobotUncertainty {
    /// Whether the root has a row for each parameter and coefficient of this geometry, and the numbers are possible.
    pub(super) fn fits(&self, geometry: &Geometry) -> bool {
        self.root.nrows() == self.parameters.len() + geometry.joint_errors.count()
            && self.root.iter().all(|value| value.is_finite())
            && self.pose_mm.is_finite()
            && self.shared_mm.is_none_or(|mm| mm >= 0.0 && mm.is_finite())
            && (0.0..f64::INFINITY).contains(&self.unexplained_mm)
            && self.degrees_of_freedom.is_none_or(|freedom| freedom > 0.0)
            && self.visit_degrees_of_freedom.is_none_or(|freedom| freedom > 4.0)
            && self.smooth.iter().all(|part| part.sd_rad.is_finite() && part.length_scale_rad > 0.0)
    }

    /// The degrees of freedom nu with which e' C^-1 e / 3 <= F(0.95; 3, nu) is a 95 % region of the error e of a pose of covariance C:
    /// a visit is t-distributed, and the standard deviation of a length is known to its own degrees of freedom. `None` for a normal
    /// error of known covariance.
    pub fn region_degrees_of_freedom(&self) -> Option<f64> {
        const DIMENSIONS: f64 = 3.0;
        const OUTSIDE: f64 = 0.05;
        let normal = chi_square_exceeded(OUTSIDE, DIMENSIONS) / DIMENSIONS;
        let quantile =
            |freedom: Option<f64>| freedom.map_or(normal, |freedom| f_exceeded(OUTSIDE, DIMENSIONS, freedom));
        // The scale of a t-distribution is a smaller matrix than its covariance.
        let scale = self.visit_degrees_of_freedom.map_or(1.0, |freedom| (freedom - 2.0) / freedom);
        let radius =
            scale * quantile(self.visit_degrees_of_freedom) * quantile(self.degrees_of_freedom) / normal;
        lower_freedom(OUTSIDE, DIMENSIONS, radius)
    }

    /// Random error of each joint's angle on a visit with these senses of approach, one standard deviation, rad. It
    /// adds to the joint's known errors.
    pub(crate) fn of_visit(&self, senses: [i8; AXES]) -> [f64; AXES] {
        let of_sense = |joint: usize| if senses[joint] == 0 { self.unapproached_rad[joint] } else { 0.0 };
        std::array::from_fn(|joint| self.scatter_rad[joint].hypot(of_sense(joint)))
    }

    /// Parameters with this root of their covariance, and nothing else that is unknown.
    pub(crate) fn of_root(parameters: Vec<ParamId>, root: DMatrix<f64>) -> Self {
        Self {
            parameters,
            root,
            pose_mm: 0.0,
            shared_mm: None,
            unexplained_mm: 0.0,
            degrees_of_freedom: None,
            visit_degrees_of_freedom: None,
            smooth: Vec::new(),
            smooth_of_joints: [1.0; AXES],
            scatter_rad: [0.0; AXES],
            unapproached_rad: [0.0; AXES],
        }
    }

    /// The uncertainty without its root: what it says of a single pose.
    pub(crate) fn rootless(&self) -> Self {
        Self { parameters: Vec::new(), smooth: self.smooth.clone(), root: DMatrix::zeros(0, 0), ..*self }
    }

    /// The uncertainty with a tool whose place on the flange is known exactly.
    pub(crate) fn without_tool(mut self) -> Self {
        for (row, id) in self.parameters.iter().enumerate() {
            if matches!(id, ParamId::Tool(_)) {
                self.root.row_mut(row).fill(0.0);
            }
        }
        self
    }

    /// The uncertainty at a tool whose place on the flange is known exactly. Lengths to the tool ball do not show whether an offset is
    /// that of the ball or of the flange: the prior of the identification decides it. If the flange is off by more than this prior
    /// with the standard deviation s, the estimates are off by C e s / p^2, with their posterior covariance C, the unit vector e
    /// of the flange's parameter and the standard deviation p of its prior (the bias of a Bayes estimate by a wrong prior mean).
    pub(crate) fn at_exact_tool(mut self, tolerance: &Tolerance) -> Self {
        let priors = [tolerance.flange_prior_mm(), tolerance.flange_prior_rad()];
        let columns =
            tolerance.flange_beyond_prior().into_iter().zip(priors).filter_map(|((id, beyond), prior)| {
                let row = self.parameters.iter().position(|other| *other == id)?;
                (beyond > 0.0)
                    .then(|| &self.root * self.root.row(row).transpose() * (beyond / (prior * prior)))
            });
        let columns: Vec<DVector<f64>> = columns.collect();
        for column in columns {
            let at = self.root.ncols();
            self.root = self.root.insert_column(at, 0.0);
            self.root.set_column(at, &column);
        }
        self.without_tool()
    }

    /// Adds the variances of independent steps. A step moves several parameters together (mm or rad).
    pub(super) fn widen(&mut self, steps: &[Vec<(ParamId, f64)>]) {
        self.root = with_steps(&self.root, &self.parameters, steps);
    }

    /// The uncertainty rounded to the digits of a robot file, so that a result in memory is equal to its file.
    pub(crate) fn with_digits_of_file(mut self) -> Self {
        self.root.apply(|value| *value = rounded(*value));
        self
    }

    /// The variance of the smooth function of a joint, rad^2.
    pub(crate) fn smooth_variance(&self, joint: Joint) -> f64 {
        let variance: f64 = self.smooth.iter().map(|part| part.sd_rad.powi(2)).sum();
        variance * self.smooth_of_joints[joint.index()].powi(2)
    }

    /// The spectral density of the smooth function of a joint at an angular frequency (1/rad), rad^3.
    pub(crate) fn spectral_density(&self, joint: Joint, frequency: f64) -> f64 {
        let density: f64 = self.smooth.iter().map(|part| part.spectral_density(frequency)).sum();
        density * self.smooth_of_joints[joint.index()].powi(2)
    }
}

fn one_each() -> [f64; AXES] {
    [1.0; AXES]
}

impl GaussianProcess {
    /// The spectral density at an angular frequency (1/rad), rad^3.
    pub(crate) fn spectral_density(&self, frequency: f64) -> f64 {
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

/// The value rounded to the digits of a robot file.
fn rounded(value: f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    format!("{value:.*e}", DIGITS - 1).parse().unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Coordinate;

    /// One length shows the sum of flange and ball. With the priors p = 0.05 and b = 0.5 mm the flange takes the share
    /// g = p^2 / (p^2 + b^2), and its estimate is off by (1 - g) of the flange and g of the ball: with a flange of t = 0.4 mm the
    /// variance is (1 - g)^2 t^2 + g^2 b^2.
    #[test]
    fn exact_tool_is_as_uncertain_as_a_flange_that_nobody_stated() {
        let (p, b, t) = (0.05_f64, 0.5_f64, 0.4_f64);
        let g = p * p / (p * p + b * b);
        let parameters = vec![ParamId::D(Joint::J6), ParamId::Tool(Coordinate::Z)];
        // What the sum leaves open: flange and ball move against each other.
        let open = (p * p * (1.0 - g)).sqrt();
        let unknown = RobotUncertainty::of_root(parameters, DMatrix::from_row_slice(2, 1, &[open, -open]));
        let variance =
            |tolerance: Tolerance| unknown.clone().at_exact_tool(&tolerance).root.row(0).norm_squared();
        let expected = (1.0 - g).powi(2) * t * t + g * g * b * b;
        let found = variance(Tolerance::of(t, 0.05));
        assert!((found / expected - 1.0).abs() < 1e-12, "{found} {expected}");
        let stated = Tolerance { flange_mm: Some(p), ..Tolerance::of(t, 0.05) };
        assert!((variance(stated) / (open * open) - 1.0).abs() < 1e-12);
        assert_eq!(unknown.clone().at_exact_tool(&stated).root.row(1).norm(), 0.0);
    }

    /// scipy.stats.f.isf(0.05, 3, nu) is (8 / 10) f.isf(0.05, 3, 10), times f.isf(0.05, 3, 100) / (chi2.isf(0.05, 3) / 3).
    #[test]
    fn region_of_t_distributed_visits() {
        let none = RobotUncertainty::of_root(Vec::new(), DMatrix::zeros(0, 0));
        let of = |visit_degrees_of_freedom, degrees_of_freedom| {
            RobotUncertainty { visit_degrees_of_freedom, degrees_of_freedom, ..none.clone() }
                .region_degrees_of_freedom()
        };
        assert_eq!(of(None, None), None);
        for (visit, length, expected) in [
            (Some(10.0), None, 26.567093399698155),
            (Some(10.0), Some(100.0), 21.10834475293512),
            (None, Some(100.0), 100.0),
        ] {
            let found = of(visit, length).unwrap();
            assert!((found / expected - 1.0).abs() < 1e-6, "{visit:?} {length:?}: {found}");
        }
    }

    /// 2 times the integral of k(t) cos(w t) from 0 by scipy.integrate.quad; k is the Matern-5/2 covariance
    /// sd^2 (1 + a + a^2 / 3) e^-a with a = sqrt(5) t / l, sd = 0.7, l = 0.8.
    #[test]
    fn spectral_density_is_the_fourier_transform_of_the_covariance() {
        let process = GaussianProcess { sd_rad: 0.7, length_scale_rad: 0.8 };
        for (frequency, expected) in
            [(0.0, 0.9349745569919119), (2.0, 0.2704857681755575), (5.0, 0.0126197839999988)]
        {
            let found = process.spectral_density(frequency);
            assert!((found / expected - 1.0).abs() < 1e-9, "{frequency}: {found}");
        }
        let unknown = RobotUncertainty {
            smooth: vec![process, GaussianProcess { sd_rad: 0.1, ..process }],
            smooth_of_joints: [1.0, 2.0, 1.0, 1.0, 1.0, 1.0],
            ..RobotUncertainty::of_root(Vec::new(), DMatrix::zeros(0, 0))
        };
        assert!((unknown.smooth_variance(Joint::J1) - 0.5).abs() < 1e-15);
        let sum = process.spectral_density(2.0) * (1.0 + 1.0 / 49.0);
        assert!((unknown.spectral_density(Joint::J2, 2.0) - 4.0 * sum).abs() < 1e-15);
    }

    /// A joint that scatters by 3 urad, with 4 urad of backlash where its sense is not known.
    #[test]
    fn a_visit_has_backlash_where_its_sense_is_not_known() {
        let unknown = RobotUncertainty {
            scatter_rad: [3e-6; AXES],
            unapproached_rad: [4e-6; AXES],
            ..RobotUncertainty::of_root(Vec::new(), DMatrix::zeros(0, 0))
        };
        let found = unknown.of_visit([1, -1, 0, 0, 0, 0]);
        let expected = [3e-6, 3e-6, 5e-6, 5e-6, 5e-6, 5e-6];
        assert!(found.iter().zip(expected).all(|(sd, rad)| (sd - rad).abs() < 1e-18), "{found:?}");
    }

    #[test]
    fn roots_are_written_with_four_digits() {
        assert_eq!([1.23456, -9.87654e-7, 0.0, 1e300].map(rounded), [1.235, -9.877e-7, 0.0, 1e300]);
        assert!(rounded(f64::NAN).is_nan());
    }
}
