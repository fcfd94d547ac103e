//! The `[[joint]]` tables of a robot file.

use serde::{Deserialize, Serialize};

use super::dh_row::DhRow;
use super::{
    AXES, CoupledAxis, Coupling, Joint, JointErrorModel, Ripple, Robot, SmoothJointError, VisitedAngles,
};
use crate::base::fixed_array::fixed_array;
use crate::diagnostic::Diagnostic;
use crate::plausibility::Quantity;
use crate::robot::RobotFinding;

/// Largest limit, degrees.
const MAX_JOINT_DEG: f64 = 1e5;

#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointTable {
    pub alpha_deg: f64,
    pub a_mm: f64,
    pub theta_offset_deg: f64,
    pub d_mm: f64,
    pub sign: i8,
    #[serde(default)]
    pub beta_deg: f64,
    #[serde(deserialize_with = "fixed_array")]
    pub limits_deg: [f64; 2],
    pub max_speed_deg_s: f64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_acceleration_deg_s2: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coupling: Option<CouplingTable>,
    #[serde(default, skip_serializing_if = "is_zero")]
    pub compliance_rad_per_nm: f64,
    #[serde(default, skip_serializing_if = "is_zero")]
    pub payload_compliance_rad_per_nm: f64,
    #[serde(default, skip_serializing_if = "is_zero")]
    pub gear_cos_rad: f64,
    #[serde(default, skip_serializing_if = "is_zero")]
    pub gear_sin_rad: f64,
    /// Half of the reversal error.
    #[serde(default, skip_serializing_if = "is_zero")]
    backlash_rad: f64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    visited: Option<VisitedAngles>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    smooth: Option<SmoothJointError>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    ripple: Vec<Ripple>,
}

/// A joint that turns by its own axis and a second one.
#[derive(Clone, Copy, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CouplingTable {
    /// The second axis, from 1.
    pub axis: usize,
    pub factor: i8,
    /// Limits of the joint's own angle.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "fixed_array")]
    pub limits_deg: Option<[f64; 2]>,
}

/// +1 or -1 for the file.
fn sign_of(value: f64) -> i8 {
    if value < 0.0 { -1 } else { 1 }
}

#[allow(clippy::trivially_copy_pass_by_ref)] // serde calls it so
pub(super) fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

impl JointTable {
    /// Checks what the types do not ensure: possible numbers, limits in order.
    pub fn check(&self, joint: usize) -> Result<(), Diagnostic> {
        let numbers = [
            ("alpha_deg", self.alpha_deg, Quantity::AxisAngle),
            ("a_mm", self.a_mm, Quantity::ArmLength),
            ("theta_offset_deg", self.theta_offset_deg, Quantity::AxisAngle),
            ("d_mm", self.d_mm, Quantity::ArmLength),
            ("beta_deg", self.beta_deg, Quantity::ParallelAxisAngle),
            ("compliance_rad_per_nm", self.compliance_rad_per_nm, Quantity::JointCoefficient),
            ("payload_compliance_rad_per_nm", self.payload_compliance_rad_per_nm, Quantity::JointCoefficient),
            ("gear_cos_rad", self.gear_cos_rad, Quantity::JointCoefficient),
            ("gear_sin_rad", self.gear_sin_rad, Quantity::JointCoefficient),
            ("backlash_rad", self.backlash_rad, Quantity::JointCoefficient),
        ];
        let smooth = self.smooth.iter().flat_map(|smooth| {
            let SmoothJointError { centre, half_width, coefficients } = smooth;
            let width = ("smooth.half_width_rad", *half_width, Quantity::JointWidth);
            let coefficients =
                coefficients.iter().map(|value| ("smooth.coefficients", *value, Quantity::JointCoefficient));
            coefficients.chain([("smooth.centre_rad", *centre, Quantity::JointMiddle), width])
        });
        let visited = self.visited.iter().flat_map(|visited| {
            let VisitedAngles { middle, scale } = *visited;
            [
                ("visited.middle_rad", middle, Quantity::JointMiddle),
                ("visited.scale_rad", scale, Quantity::JointWidth),
            ]
        });
        let ripple = self.ripple.iter().flat_map(|ripple| {
            [
                ("ripple.cos_rad", ripple.cos, Quantity::JointCoefficient),
                ("ripple.sin_rad", ripple.sin, Quantity::JointCoefficient),
            ]
        });
        let checked = |(key, value, quantity): (&str, f64, Quantity)| {
            quantity.check(format!("joint {joint}: {key}"), value)
        };
        numbers.into_iter().chain(smooth).chain(visited).chain(ripple).try_for_each(checked)?;
        if self.sign.abs() != 1 {
            return Err(RobotFinding::JointSign { joint, sign: self.sign }.into());
        }
        for [low_deg, high_deg] in [Some(self.limits_deg), self.coupled_limits_deg()].into_iter().flatten() {
            if !(low_deg >= -MAX_JOINT_DEG && high_deg <= MAX_JOINT_DEG && low_deg < high_deg) {
                return Err(RobotFinding::JointLimits { joint, low_deg, high_deg }.into());
            }
        }
        let largest_deg = self.limits_deg.into_iter().map(f64::abs).fold(0.0, f64::max);
        self.coupled(joint)?;
        let speed = ("max_speed_deg_s", self.max_speed_deg_s, Quantity::JointSpeed);
        let acceleration = self
            .max_acceleration_deg_s2
            .map(|value| ("max_acceleration_deg_s2", value, Quantity::JointAcceleration));
        let limit = ("limits_deg", largest_deg, Quantity::JointLimit);
        [limit, speed].into_iter().chain(acceleration).try_for_each(checked)?;
        Ok(())
    }

    /// The second axis. It must be between axis 1 and the joint, because only axis 1 turns the plane of the arm.
    fn coupled(&self, joint: usize) -> Result<Option<CoupledAxis>, RobotFinding> {
        let Some(CouplingTable { axis, factor, .. }) = self.coupling else { return Ok(None) };
        let second = Joint::new(axis).filter(|_| (2..joint).contains(&axis) && factor.abs() == 1);
        let axis = second.ok_or(RobotFinding::Coupling { joint, axis, factor })?;
        Ok(Some(CoupledAxis { axis, factor: f64::from(factor) }))
    }

    /// Limits of the joint's own angle.
    pub fn coupled_limits_deg(&self) -> Option<[f64; 2]> {
        self.coupling.and_then(|coupling| coupling.limits_deg)
    }

    pub fn row(&self) -> DhRow {
        DhRow {
            alpha: self.alpha_deg.to_radians(),
            a: self.a_mm,
            theta: self.theta_offset_deg.to_radians(),
            d: self.d_mm,
            beta: self.beta_deg.to_radians(),
            sign: f64::from(self.sign),
        }
    }

    pub fn error(&self) -> JointErrorModel {
        JointErrorModel {
            smooth: self.smooth.clone().unwrap_or_default(),
            backlash: self.backlash_rad,
            visited: self.visited.unwrap_or_default(),
            ripple: self.ripple.clone(),
        }
    }

    pub fn of(robot: &Robot, joint: Joint) -> Self {
        let (row, at) = (robot.geometry.row(joint), joint.index());
        let [gear_cos_rad, gear_sin_rad] = robot.geometry.gear[at];
        let error = robot.geometry.joint_errors.of(joint).cloned().unwrap_or_default();
        let coupling = robot.geometry.coupling.of(joint).map(|by| CouplingTable {
            axis: by.axis.number(),
            factor: sign_of(by.factor),
            limits_deg: robot.coupled_limits_deg[at],
        });
        Self {
            alpha_deg: row.alpha.to_degrees(),
            a_mm: row.a,
            theta_offset_deg: row.theta.to_degrees(),
            d_mm: row.d,
            sign: sign_of(row.sign),
            beta_deg: row.beta.to_degrees(),
            limits_deg: robot.limits_deg[at],
            max_speed_deg_s: robot.max_speed_deg_s[at],
            max_acceleration_deg_s2: robot.max_acceleration_deg_s2[at],
            coupling,
            compliance_rad_per_nm: robot.geometry.compliance[at],
            payload_compliance_rad_per_nm: robot.geometry.payload_compliance[at],
            gear_cos_rad,
            gear_sin_rad,
            backlash_rad: error.backlash,
            visited: Some(error.visited).filter(|visited| *visited != VisitedAngles::default()),
            smooth: Some(error.smooth).filter(|smooth| !smooth.coefficients.is_empty()),
            ripple: error.ripple,
        }
    }
}

/// The couplings of the joints. At every angle of the second axis the axis of the joint must have a possible angle. An error
/// carries the index of the joint.
pub(super) fn coupling(joints: &[&JointTable; AXES]) -> Result<Coupling, (usize, RobotFinding)> {
    let mut coupling = [None; AXES];
    for (at, table) in joints.iter().enumerate() {
        coupling[at] = table.coupled(at + 1).map_err(|finding| (at, finding))?;
        let (Some(by), Some([least, most])) = (coupling[at], table.coupled_limits_deg()) else { continue };
        for axis_deg in joints[by.axis.index()].limits_deg {
            let ([low, high], added) = (table.limits_deg, by.factor * axis_deg);
            if low.max(least - added) >= high.min(most - added) {
                let (joint, axis) = (at + 1, by.axis.number());
                return Err((at, RobotFinding::NoCoupledAngle { joint, axis, axis_deg }));
            }
        }
    }
    Ok(Coupling::new(coupling))
}
