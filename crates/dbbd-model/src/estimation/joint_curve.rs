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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{JointErrorModel, JointErrors, RobotUncertainty};

    /// The cosine acts at 0 degrees, both alike at 45, and with the other sign at 180; backlash is added in the sense of
    /// approach. The standard deviations of both parts are independent.
    #[test]
    fn curve_has_the_harmonic_and_backlash_with_their_uncertainty() {
        let mut robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        let joint = Joint::J1;
        robot.geometry.gear[0] = [2e-4, -1e-4];
        let mut errors = [(); AXES].map(|()| JointErrorModel::default());
        errors[0].backlash = 3e-5;
        robot.geometry.joint_errors = JointErrors::new(errors);
        let sign = robot.geometry.row(joint).sign;
        let half = 0.5f64.sqrt();
        for (angle_deg, of_angle) in [(0.0, 2e-4), (45.0, 1e-4 * half), (90.0, -1e-4), (180.0, -2e-4)] {
            let found = point(&robot, joint, angle_deg, 0.0);
            let expected = [of_angle + 3e-5, of_angle - 3e-5].map(|error| sign * error);
            for (found, expected) in [found.rising, found.falling].into_iter().zip(expected) {
                assert!((found - expected).abs() < 1e-16, "{angle_deg}: {found} {expected}");
            }
        }
        let rows = 2 + robot.geometry.joint_errors.count();
        let root = DMatrix::from_partial_diagonal(rows, 2, &[3e-6, 4e-6]);
        let parameters = vec![ParamId::GearCos(joint), ParamId::GearSin(joint)];
        let uncertainty = RobotUncertainty { parameters, root, ..robot.known_uncertainty() };
        robot.uncertainty = Some(Box::new(uncertainty));
        let found = sds(&robot, joint, &[0.0, 45.0, 90.0]);
        for (found, expected) in found.iter().zip([3e-6, 5e-6 * half, 4e-6]) {
            assert!((found - expected).abs() < 1e-18, "{found} {expected}");
        }
        let curve = joint_curve(&robot, joint);
        let range = robot.joint_range_deg(joint);
        assert_eq!((curve.len(), [curve[0].angle_deg, curve[360].angle_deg]), (361, range));
    }
}
