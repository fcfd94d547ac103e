//! What is known before anything is measured: lengths, robot, bar.

use super::Job;
use crate::identifiability::Belief;
use crate::model::{LengthModel, Robot};

/// Standard deviation of one length, mm: of the bar and of the robot's repeatability together.
pub(crate) fn length_sigma_mm(job: &Job, robot: &Robot) -> f64 {
    (job.bar.sigma_um * 1e-3).hypot(robot.repeatability_sd_mm().unwrap_or(0.0))
}

/// What is known before anything is measured: the robot's tolerance, the bar's certificate.
pub(crate) fn datasheet(job: &Job, robot: &Robot) -> Belief {
    let model = LengthModel::new(robot.geometry.clone(), &job.balls());
    // A certificate states two standard deviations.
    Belief::datasheet(robot, model, job.bar.length_u_mm.map(|u| 0.5 * u))
}
