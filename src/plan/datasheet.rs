//! What is known before anything is measured: lengths, robot, bar.

use super::Job;
use crate::identifiability::Belief;
use crate::model::{LengthModel, Robot};

/// ISO 9283 repeatability is the mean distance plus three standard deviations; for an isotropic
/// normal error of deviation s that is (1.596 + 3 * 0.673) s.
const REPEATABILITY: f64 = 3.616;

/// Standard deviation of one length, mm: of the bar and of the robot's repeatability together.
pub(crate) fn length_sigma_mm(job: &Job, robot: &Robot) -> f64 {
    (job.bar.sigma_um * 1e-3).hypot(robot.repeatability_mm.unwrap_or(0.0) / REPEATABILITY)
}

/// What is known before anything is measured: the robot's tolerance, the bar's certificate.
pub(crate) fn datasheet(job: &Job, robot: &Robot) -> Belief {
    let model = LengthModel::new(robot.geometry.clone(), &job.balls());
    // A certificate states two standard deviations.
    Belief::datasheet(robot, model, job.bar.length_u_mm.map(|u| 0.5 * u))
}
