//! Robots with random joint errors, lengths measured with them, and the error of an identified robot at other poses.

use dbbd_job::sim::truth;
use dbbd_model::estimation::Positions;
use dbbd_model::measurement::{ApproachedPose, Datum, Measurement, Measurements, TargetId};
use dbbd_model::robot::{
    Approach, AxisAngles, BallId, BarId, JointErrorModel, JointErrors, PayloadId, Ripple, Robot,
    SmoothJointError,
};
use nalgebra::{DMatrix, DVector, Vector3};
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

use super::cell::kr60;

pub(crate) const BALLS: [[f64; 3]; 3] =
    [[1300.0, 0.0, 400.0], [900.0, 800.0, 700.0], [1100.0, -700.0, 1000.0]];
const RANGES: [[f64; 2]; 6] =
    [[-70.0, 70.0], [-110.0, -40.0], [60.0, 130.0], [-90.0, 90.0], [-90.0, 90.0], [-120.0, 120.0]];
/// Standard deviations of a length, and of the ball in each direction at a pose, mm.
pub(crate) const LENGTH_MM: f64 = 0.005;
pub(crate) const POSE_MM: f64 = 0.015;
/// Number of check poses, and the 95 % quantile of chi-square with 3 degrees of freedom.
const KEPT: usize = 100;
const CHI_95: f64 = 7.815;

/// A robot well within its tolerance; every fourth has no joint errors.
pub(crate) fn drawn(seed: u64) -> Robot {
    drawn_at(seed, 0.5)
}

/// As [`drawn`], with errors of this share of the tolerance.
pub(crate) fn drawn_at(seed: u64, scale: f64) -> Robot {
    let mut robot = truth::draw_true_robot(&kr60(), seed, scale);
    if seed.is_multiple_of(4) {
        return robot;
    }
    let mut random = Pcg64::seed_from_u64(seed);
    let mut joints = [(); 6].map(|()| JointErrorModel::default());
    for (joint, [low, high]) in joints.iter_mut().zip(RANGES.map(|range| range.map(f64::to_radians))) {
        joint.backlash = random.random_range(-1e-4..1e-4);
        let (half_width, sd) = (1.2 * 0.5 * (high - low) + 0.5, random.random_range(0.0..2e-4));
        let weights: Vec<f64> =
            (1..9).map(|m| random.sample::<f64, _>(StandardNormal) / f64::from(m * m + 4)).collect();
        let rms = (weights.iter().map(|w| w * w).sum::<f64>() / (2.0 * half_width)).sqrt();
        let coefficients = weights.iter().map(|w| w * sd / rms).collect();
        joint.smooth = SmoothJointError { centre: 0.5 * (low + high), half_width, coefficients };
    }
    let (amplitude, phase) = (random.random_range(0.0..5e-5), random.random_range(0.0..6.0_f64));
    let ripple = Ripple {
        order: random.random_range(5..40),
        cos: amplitude * phase.cos(),
        sin: amplitude * phase.sin(),
    };
    joints[random.random_range(0..6)].ripple.push(ripple);
    robot.geometry.joint_errors = JointErrors::new(joints);
    robot
}

/// The knowledge of the sense in which each axis approached a pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Senses {
    Known,
    Unknown,
}

impl Senses {
    pub(crate) fn seen(self, pose: ApproachedPose) -> ApproachedPose {
        match self {
            Self::Known => pose,
            Self::Unknown => ApproachedPose { approach: Approach::default(), ..pose },
        }
    }
}

/// A sequence of poses with the true positions of the ball.
pub(crate) fn poses(truth: &Robot, count: usize, seed: u64) -> Vec<(ApproachedPose, Vector3<f64>)> {
    let mut random = Pcg64::seed_from_u64(seed);
    let axes_deg: Vec<[f64; 6]> =
        (0..count).map(|_| RANGES.map(|[low, high]| random.random_range(low..high))).collect();
    let approaches = Approach::along(axes_deg.iter().map(|axes| axes.map(f64::to_radians)));
    let place = |(axes, approach): (&[f64; 6], Approach)| {
        let pose = ApproachedPose { axes: AxisAngles::from_degrees(*axes), approach };
        let ball = truth.geometry.approached(approach).ball(&pose.axes.radians()).position;
        (pose, ball + Vector3::from_fn(|_, _| POSE_MM * random.sample::<f64, _>(StandardNormal)))
    };
    axes_deg.iter().zip(approaches).map(place).collect()
}

pub(crate) fn lengths(truth: &Robot, poses_: usize, balls: usize, seed: u64) -> Measurements {
    let mut random = Pcg64::seed_from_u64(seed ^ 0xface);
    let mut rows = Vec::new();
    for (pose, place) in poses(truth, poses_, seed) {
        for (ball, centre) in BALLS.into_iter().take(balls).enumerate() {
            let noise: f64 = random.sample(StandardNormal);
            rows.push(Measurement {
                index: rows.len() as u32 + 1,
                datum: Datum::Ball(BallId::at(ball), BarId::FIRST),
                target: TargetId::FIRST,
                axes: pose.axes,
                approach: pose.approach,
                length_mm: (place - Vector3::from(centre)).norm() + LENGTH_MM * noise,
                sigma_mm: Some(LENGTH_MM),
                payload: PayloadId::FIRST,
                context: None,
            });
        }
    }
    Measurements { rows, ..Measurements::default() }
}

/// The errors of one robot at check poses, at which it was not measured.
pub(crate) struct Judged {
    /// Mean 3-D errors, true and predicted, mm.
    pub(crate) mean: f64,
    pub(crate) predicted: f64,
    /// Share of the poses whose 95 % region contains the true position.
    pub(crate) covered: f64,
}

pub(crate) fn judged(truth: &Robot, found: &Robot, senses: Senses, seed: u64) -> Judged {
    let kept = poses(truth, KEPT, seed).into_iter().map(|(pose, place)| (senses.seen(pose), place));
    let (kept, places): (Vec<ApproachedPose>, Vec<Vector3<f64>>) = kept.unzip();
    let positions = Positions::new(&found.geometry, &found.known_uncertainty(), &kept);
    let errors = without_rigid_motion(&positions.balls, &places);
    let mut judged = Judged { mean: 0.0, predicted: 0.0, covered: 0.0 };
    for (at, error) in errors.iter().enumerate() {
        let covariance = positions.covariance(at);
        let inverse = covariance.try_inverse().unwrap();
        judged.covered += f64::from(u8::from(error.dot(&(inverse * error)) < CHI_95)) / KEPT as f64;
        judged.mean += error.norm() / KEPT as f64;
        judged.predicted += expected_size(&covariance.symmetric_eigenvalues()) / KEPT as f64;
    }
    judged
}

/// The error of an identified robot at other poses.
pub(crate) fn mean_error(truth: &Robot, found: &Robot, seed: u64) -> Judged {
    judged(truth, found, Senses::Known, seed)
}

/// The mean length of a normal vector with these variances, by 400 draws.
fn expected_size(variances: &Vector3<f64>) -> f64 {
    let mut random = Pcg64::seed_from_u64(9);
    let draw = |_| {
        variances
            .iter()
            .map(|variance| variance * random.sample::<f64, _>(StandardNormal).powi(2))
            .sum::<f64>()
            .sqrt()
    };
    (0..400).map(draw).sum::<f64>() / 400.0
}

/// Differences after the best small rigid motion is removed.
fn without_rigid_motion(balls: &[Vector3<f64>], places: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let centroid = balls.iter().sum::<Vector3<f64>>() / balls.len() as f64;
    let motions = DMatrix::from_fn(3 * balls.len(), 6, |row, column| match column {
        0..3 => f64::from(u8::from(row % 3 == column)),
        _ => Vector3::ith(column - 3, 1.0).cross(&(balls[row / 3] - centroid))[row % 3] * 1e-3,
    });
    let gaps = DVector::from_fn(3 * balls.len(), |row, _| (places[row / 3] - balls[row / 3])[row % 3]);
    let motion = (motions.transpose() * &motions).cholesky().unwrap().solve(&(motions.transpose() * &gaps));
    let left = gaps - motions * motion;
    (0..balls.len()).map(|at| left.fixed_rows::<3>(3 * at).into_owned()).collect()
}
