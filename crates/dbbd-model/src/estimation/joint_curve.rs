//! The error of a joint as a table: the correction of its angle over its range, for either sense of approach, with its
//! uncertainty.

use nalgebra::DMatrix;

use crate::robot::{AXES, Approach, Joint, ParamId, Robot, TermKind};

/// Number of angles in a table.
const STEPS: usize = 361;

/// The correction at an angle: true angle of the joint minus the angle that its axis reports, in the sense of the axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointPoint {
    pub angle_deg: f64,
    /// Correction of an axis that came through rising and through falling angles, rad.
    pub rising: f64,
    pub falling: f64,
    /// Standard deviation of the mean of `rising` and `falling`, rad.
    pub sd: f64,
}

/// The correction of a joint over the range of its own angle: first harmonic, smooth function, ripple and backlash. The
/// mean of the correction cannot be separated from the joint's offset.
pub fn joint_curve(robot: &Robot, joint: Joint) -> Vec<JointPoint> {
    let [low, high] = robot.joint_range_deg(joint);
    let angle_deg = |step: usize| low + (high - low) * step as f64 / (STEPS - 1) as f64;
    let angles_deg: Vec<f64> = (0..STEPS).map(angle_deg).collect();
    let sds = sds(robot, joint, &angles_deg);
    angles_deg.iter().zip(sds).map(|(angle_deg, sd)| point(robot, joint, *angle_deg, sd)).collect()
}

fn point(robot: &Robot, joint: Joint, angle_deg: f64, sd: f64) -> JointPoint {
    let (angle, at) = (angle_deg.to_radians(), joint.index());
    let geometry = &robot.geometry;
    let sign = geometry.row(joint).sign;
    let [cos_part, sin_part] = geometry.gear[at];
    let (sin, cos) = angle.sin_cos();
    let error = geometry.joint_errors.of(joint);
    let of_angle = cos_part * cos + sin_part * sin + error.map_or(0.0, |error| error.of_angle(angle));
    let backlash = error.map_or(0.0, |error| error.backlash);
    JointPoint { angle_deg, rising: sign * (of_angle + backlash), falling: sign * (of_angle - backlash), sd }
}

/// Standard deviation of the part of the correction that the angle alone determines (without backlash), rad.
fn sds(robot: &Robot, joint: Joint, angles_deg: &[f64]) -> Vec<f64> {
    let Some(uncertainty) = robot.uncertainty.as_deref() else { return vec![0.0; angles_deg.len()] };
    let errors = &robot.geometry.joint_errors;
    let terms = errors.terms();
    // A row for each angle, a column for each row of the root.
    let mut derivatives = DMatrix::zeros(angles_deg.len(), uncertainty.root.nrows());
    let mut outside = vec![uncertainty.smooth_variance(joint); angles_deg.len()];
    for (row, angle_deg) in angles_deg.iter().enumerate() {
        let angle = angle_deg.to_radians();
        for (at, id) in uncertainty.parameters.iter().enumerate() {
            if *id == ParamId::GearCos(joint) {
                derivatives[(row, at)] = angle.cos();
            } else if *id == ParamId::GearSin(joint) {
                derivatives[(row, at)] = angle.sin();
            }
        }
        let mut at = 0;
        errors.derivatives(&[angle; AXES], Approach::default(), |place, value| {
            if place == joint.index() && terms[at].kind != TermKind::Backlash {
                derivatives[(row, uncertainty.parameters.len() + at)] = value;
                if let TermKind::Smooth { frequency } = terms[at].kind {
                    outside[row] -= uncertainty.spectral_density(joint, frequency) * value * value;
                }
            }
            at += 1;
        });
    }
    let moved = derivatives * &uncertainty.root;
    let sd = |(row, outside): (usize, f64)| (moved.row(row).norm_squared() + outside.max(0.0)).sqrt();
    outside.into_iter().enumerate().map(sd).collect()
}
