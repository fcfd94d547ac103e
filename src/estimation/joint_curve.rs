//! The error of a joint as a table: the correction of its angle over the axis, by either sense, with its uncertainty.

use crate::robot::{AXES, Approach, Joint, ParamId, Robot, TermKind};

/// Angles of a table.
const STEPS: usize = 361;

/// The correction at an angle: what the joint is further than its axis says, in the sense of the axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointPoint {
    pub angle_deg: f64,
    /// By rising and by falling angles, rad.
    pub rising: f64,
    pub falling: f64,
    /// Standard deviation of their mean, rad.
    pub sd: f64,
}

/// The correction of a joint over the range of its own angle: first harmonic, smooth function, ripple and backlash. Its mean is shared
/// with the joint's offset.
pub fn joint_curve(robot: &Robot, joint: Joint) -> Vec<JointPoint> {
    let [low, high] = robot.joint_range_deg(joint);
    let angle_deg = |step: usize| low + (high - low) * step as f64 / (STEPS - 1) as f64;
    (0..STEPS).map(|step| point(robot, joint, angle_deg(step))).collect()
}

fn point(robot: &Robot, joint: Joint, angle_deg: f64) -> JointPoint {
    let (angle, at) = (angle_deg.to_radians(), joint.index());
    let geometry = &robot.geometry;
    let sign = geometry.row(joint).sign;
    let [cos_part, sin_part] = geometry.gear[at];
    let (sin, cos) = angle.sin_cos();
    let error = geometry.joint_errors.of(joint);
    let of_angle = cos_part * cos + sin_part * sin + error.map_or(0.0, |error| error.of_angle(angle));
    let backlash = error.map_or(0.0, |error| error.backlash);
    JointPoint {
        angle_deg,
        rising: sign * (of_angle + backlash),
        falling: sign * (of_angle - backlash),
        sd: sd(robot, joint, angle),
    }
}

/// One standard deviation of the correction by the angle alone, rad.
fn sd(robot: &Robot, joint: Joint, angle: f64) -> f64 {
    let Some(unknown) = robot.uncertainty.as_deref() else { return 0.0 };
    let (sin, cos) = angle.sin_cos();
    let mut row = unknown.root.row(0) * 0.0;
    for (at, id) in unknown.parameters.iter().enumerate() {
        match id {
            ParamId::GearCos(own) if *own == joint => row += unknown.root.row(at) * cos,
            ParamId::GearSin(own) if *own == joint => row += unknown.root.row(at) * sin,
            _ => {}
        }
    }
    let errors = &robot.geometry.joint_errors;
    let (terms, mut at, mut beside) = (errors.terms(), 0, unknown.smooth_variance());
    errors.derivatives(&[angle; AXES], Approach::default(), |place, value| {
        if place == joint.index() && terms[at].kind != TermKind::Backlash {
            row += unknown.root.row(unknown.parameters.len() + at) * value;
            if let TermKind::Smooth { frequency } = terms[at].kind {
                beside -= unknown.spectral_density(frequency) * value * value;
            }
        }
        at += 1;
    });
    (row.norm_squared() + beside.max(0.0)).sqrt()
}
