//! The predicted position uncertainty of an estimate with errors of the joints.

use super::ErrorSummary;
use super::joint_fit::JointFit;
use super::lengths::Lengths;
use super::options::Setting;
use super::position::{Positions, compressed};
use super::result::MapPoint;
use crate::measurement::{ApproachedPose, PreparedMeasurement};
use crate::robot::{AXES, Approach, AxisAngles, RobotUncertainty};

/// Robots that are drawn.
const ROBOTS: usize = 100;
/// Poses of the workspace, and as many of those measured, by which the uncertainty is compressed.
const COMPRESSING: usize = 150;

/// What is left over the workspace.
pub(super) struct JointPrediction {
    pub(super) summary: ErrorSummary,
    pub(super) map: Vec<MapPoint>,
    /// For the robot's file.
    pub(super) unknown: RobotUncertainty,
}

impl JointPrediction {
    pub(super) fn of(setting: &Setting<'_>, fit: &JointFit, lengths: &Lengths) -> Self {
        let geometry = &fit.model.geometry;
        let poses: Vec<ApproachedPose> =
            setting.options.workspace_poses(setting.robot).iter().map(unapproached).collect();
        let some = |poses: &[ApproachedPose]| -> Vec<ApproachedPose> {
            poses.iter().step_by(poses.len().div_ceil(COMPRESSING).max(1)).copied().collect()
        };
        let measured: Vec<ApproachedPose> =
            (0..lengths.len()).map(|at| lengths.reading(at)).map(|reading| measured_pose(&reading)).collect();
        let few = [some(&poses), some(&measured)].concat();
        let unknown = compressed(&fit.model, &fit.uncertainty(), &few);
        let positions = Positions::new(geometry, &unknown, &poses, &[]);
        let moved = positions.draws(ROBOTS, unexplained_mm(setting, fit, lengths));
        let summary = ErrorSummary::of(&moved);
        let rms = |pose: usize| (moved.rows(3 * pose, 3).norm_squared() / ROBOTS as f64).sqrt();
        let point =
            |(pose, ball): (usize, &nalgebra::Vector3<f64>)| MapPoint { position: *ball, rms_mm: rms(pose) };
        Self { summary, map: positions.balls.iter().enumerate().map(point).collect(), unknown }
    }
}

fn measured_pose(reading: &PreparedMeasurement) -> ApproachedPose {
    ApproachedPose {
        axes: AxisAngles::from_degrees(reading.axes.map(f64::to_degrees)),
        approach: reading.approach,
    }
}

fn unapproached(axes: &[f64; AXES]) -> ApproachedPose {
    ApproachedPose {
        axes: AxisAngles::from_degrees(axes.map(f64::to_degrees)),
        approach: Approach::default(),
    }
}

/// What the lengths scatter beyond what is given of them and of the robot's repeatability, mm: it is of the robot, such
/// as backlash where the sense of approach is not known.
fn unexplained_mm(setting: &Setting<'_>, fit: &JointFit, lengths: &Lengths) -> f64 {
    if !lengths.known || lengths.vouched {
        return 0.0;
    }
    let given = lengths.weighted(super::lengths::Sigma::Given, &[]).rms_sigma();
    let repeatability = setting.robot.repeatability_sd_mm().unwrap_or(0.0);
    let square = fit.noise.sigma_mm().powi(2) - given.powi(2) - repeatability.powi(2);
    square.max(0.0).sqrt().min(fit.noise.pose_mm)
}
