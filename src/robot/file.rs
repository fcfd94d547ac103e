//! The robot file: a robot as TOML holds it.

use serde::{Deserialize, Serialize};

use super::kinematics::{DhRow, Geometry, Mass};
use super::pose::is_part_of_turn;
use super::posterior::RobotPosterior;
use super::uncertainty::RobotUncertainty;
use super::{AXES, CoupledAxis, Coupling, Joint, JointError, JointErrors, Ripple, Robot, Smooth, Tolerance};
use crate::base::parse::from_toml;
use crate::base::serialised;
use crate::catalogue::{CliFinding, RobotFinding};
use crate::diagnostic::Diagnostic;
use crate::provenance::Provenance;

/// The file: what TOML holds, in degrees and with keys that may be absent.
#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RobotFile {
    name: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    serial: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    controller_serial: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    language: Option<String>,
    convention: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    source: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    repeatability_mm: Option<f64>,
    joint: Vec<JointTable>,
    #[serde(default)]
    tool: ToolTable,
    #[serde(default)]
    tolerance: Tolerance,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    mass: Vec<MassTable>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    payload: Option<PayloadTable>,
    #[serde(default, skip_serializing_if = "Provenance::is_empty")]
    provenance: Provenance,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    posterior: Option<RobotPosterior>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    nominal: Option<Box<RobotFile>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    uncertainty: Option<RobotUncertainty>,
}

#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct JointTable {
    pub(crate) alpha_deg: f64,
    pub(crate) a_mm: f64,
    pub(crate) theta_offset_deg: f64,
    pub(crate) d_mm: f64,
    pub(crate) sign: i8,
    #[serde(default)]
    pub(crate) beta_deg: f64,
    pub(crate) limits_deg: [f64; 2],
    pub(crate) max_speed_deg_s: f64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    max_acceleration_deg_s2: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) coupling: Option<CouplingTable>,
    #[serde(default, skip_serializing_if = "is_zero")]
    compliance_rad_per_nm: f64,
    #[serde(default, skip_serializing_if = "is_zero")]
    gear_cos_rad: f64,
    #[serde(default, skip_serializing_if = "is_zero")]
    gear_sin_rad: f64,
    /// Half of the reversal error.
    #[serde(default, skip_serializing_if = "is_zero")]
    backlash_rad: f64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    smooth: Option<Smooth>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    ripple: Vec<Ripple>,
}

/// The joint turns by its own axis and by a second one.
#[derive(Clone, Copy, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CouplingTable {
    /// The second axis, from 1.
    pub(crate) axis: usize,
    pub(crate) factor: i8,
    /// Of the joint's own angle.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) limits_deg: Option<[f64; 2]>,
}

/// +1 or -1 as a file has it.
fn sign_of(value: f64) -> i8 {
    if value < 0.0 { -1 } else { 1 }
}

#[allow(clippy::trivially_copy_pass_by_ref)] // the signature that serde calls
fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

#[derive(Clone, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ToolTable {
    ball_mm: [f64; 3],
}

#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct MassTable {
    joint: usize,
    kg: f64,
    centre_mm: [f64; 3],
}

#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PayloadTable {
    kg: f64,
    centre_mm: [f64; 3],
}

impl Robot {
    pub fn from_toml(file: &str, text: &str) -> Result<Self, Diagnostic> {
        let parsed: RobotFile = from_toml(file, text)?;
        parsed.into_robot().map_err(|(joint, finding)| {
            let line = joint.and_then(|at| line_of_table(text, "[[joint]]", at)).unwrap_or(0);
            Diagnostic::line(file, line, finding)
        })
    }

    /// Writes the robot file; numbers in full precision.
    ///
    /// # Errors
    /// None is known: see [`serialised`].
    pub fn to_toml(&self) -> Result<String, CliFinding> {
        serialised::toml(&RobotFile::from_robot(self))
    }

    /// The joints as the file has them.
    pub(crate) fn joint_tables(&self) -> Vec<JointTable> {
        Joint::ALL.into_iter().map(|joint| JointTable::of(self, joint)).collect()
    }
}

/// The line (from 1) of the `at`-th (from 0) table header in the text.
fn line_of_table(text: &str, header: &str, at: usize) -> Option<usize> {
    text.lines().enumerate().filter(|(_, line)| line.trim() == header).nth(at).map(|(line, _)| line + 1)
}

/// No length of an arm is longer, mm: ten metres.
const MOST_MM: f64 = 1e4;
/// No angle, speed or acceleration is larger, degrees, degrees/s, degrees/s^2.
const MOST_DEG: f64 = 1e5;
/// The same in radians.
const MOST_RAD: f64 = 2e3;
/// No mass is larger, kg.
const MOST_KG: f64 = 5e3;
/// No robot repeats worse, mm.
const MOST_REPEATABILITY_MM: f64 = 5.0;

/// Whether all lengths can be those of an arm.
fn are_lengths(mm: &[f64]) -> bool {
    mm.iter().all(|mm| mm.abs() <= MOST_MM)
}

/// What is wrong, and in which joint (from 0) where it is one.
type Wrong = (Option<usize>, RobotFinding);

impl JointTable {
    /// What the types do not say: finite numbers, limits in order.
    fn check(&self, joint: usize) -> Result<(), RobotFinding> {
        let numbers = [
            ("alpha_deg", self.alpha_deg, MOST_DEG),
            ("a_mm", self.a_mm, MOST_MM),
            ("theta_offset_deg", self.theta_offset_deg, MOST_DEG),
            ("d_mm", self.d_mm, MOST_MM),
            ("beta_deg", self.beta_deg, MOST_DEG),
            ("compliance_rad_per_nm", self.compliance_rad_per_nm, 1.0),
            ("gear_cos_rad", self.gear_cos_rad, 1.0),
            ("gear_sin_rad", self.gear_sin_rad, 1.0),
            ("backlash_rad", self.backlash_rad, 1.0),
        ];
        let smooth = self.smooth.iter().flat_map(|smooth| {
            let Smooth { centre, half_width, coefficients } = smooth;
            // The logarithm of a width that is none is no number.
            let width = ("smooth.half_width_rad", half_width.ln() + half_width, MOST_RAD);
            let coefficients = coefficients.iter().map(|value| ("smooth.coefficients", *value, 1.0));
            coefficients.chain([("smooth.centre_rad", *centre, MOST_RAD), width])
        });
        let ripple = self
            .ripple
            .iter()
            .flat_map(|ripple| [("ripple.cos_rad", ripple.cos, 1.0), ("ripple.sin_rad", ripple.sin, 1.0)]);
        let mut numbers = numbers.into_iter().chain(smooth).chain(ripple);
        let possible = |value: f64, most: f64| value.abs() <= most;
        if let Some((key, value, most)) = numbers.find(|(_, value, most)| !possible(*value, *most)) {
            return Err(RobotFinding::JointNumber { joint, key: key.into(), value, most });
        }
        if self.sign.abs() != 1 {
            return Err(RobotFinding::JointSign { joint, sign: self.sign });
        }
        if let Some((key, value)) = self.radians() {
            return Err(RobotFinding::Radians { joint, key: key.into(), value });
        }
        let of_joint = self.coupling.and_then(|coupling| coupling.limits_deg);
        for [low_deg, high_deg] in [Some(self.limits_deg), of_joint].into_iter().flatten() {
            if !(low_deg >= -MOST_DEG && high_deg <= MOST_DEG && low_deg < high_deg) {
                return Err(RobotFinding::JointLimits { joint, low_deg, high_deg });
            }
        }
        self.coupled(joint)?;
        let mut speeds = [Some(self.max_speed_deg_s), self.max_acceleration_deg_s2].into_iter().flatten();
        match speeds.find(|speed| !(*speed > 0.0 && *speed <= MOST_DEG)) {
            Some(value) => Err(RobotFinding::JointSpeed { joint, value }),
            None => Ok(()),
        }
    }

    /// An angle that was given in radians: a part of a turn as an arm has it, a range of axis angles, a speed.
    fn radians(&self) -> Option<(&'static str, f64)> {
        use std::f64::consts::TAU;
        /// No joint of an arm is slower, degrees/s.
        const LEAST_SPEED: f64 = 6.0;
        let turns = [("alpha_deg", self.alpha_deg), ("theta_offset_deg", self.theta_offset_deg)];
        let [low, high] = self.limits_deg;
        let narrow = low.abs() < TAU + 0.1 && high.abs() < TAU + 0.1 && low < high;
        let slow = self.max_speed_deg_s > 0.0 && self.max_speed_deg_s < LEAST_SPEED;
        let turn = turns.into_iter().find(|(_, value)| is_part_of_turn(*value));
        turn.or(narrow.then_some(("limits_deg", high)))
            .or(slow.then_some(("max_speed_deg_s", self.max_speed_deg_s)))
    }

    /// The second axis, which lies between axis 1 and the joint: the plane of the arm turns about axis 1 alone.
    fn coupled(&self, joint: usize) -> Result<Option<CoupledAxis>, RobotFinding> {
        let Some(CouplingTable { axis, factor, .. }) = self.coupling else { return Ok(None) };
        let before = Joint::new(axis).filter(|_| (2..joint).contains(&axis) && factor.abs() == 1);
        let second = before.ok_or(RobotFinding::Coupling { joint, axis, factor })?;
        Ok(Some(CoupledAxis { axis: second, factor: f64::from(factor) }))
    }

    fn row(&self) -> DhRow {
        DhRow {
            alpha: self.alpha_deg.to_radians(),
            a: self.a_mm,
            theta: self.theta_offset_deg.to_radians(),
            d: self.d_mm,
            beta: self.beta_deg.to_radians(),
            sign: f64::from(self.sign),
        }
    }

    fn error(&self) -> JointError {
        let (smooth, ripple) = (self.smooth.clone().unwrap_or_default(), self.ripple.clone());
        JointError { smooth, backlash: self.backlash_rad, ripple }
    }

    fn of(robot: &Robot, joint: Joint) -> Self {
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
            gear_cos_rad,
            gear_sin_rad,
            backlash_rad: error.backlash,
            smooth: Some(error.smooth).filter(|smooth| !smooth.coefficients.is_empty()),
            ripple: error.ripple,
        }
    }
}

impl RobotFile {
    /// What an arm with another number of axes would need.
    fn not_six(&self, joints: usize) -> RobotFinding {
        let needed = match joints {
            4 => {
                "an arm of four axes (SCARA, palletiser) needs a linear axis or a coupled one in the model, and poses of four coordinates"
            }
            7 => {
                "an arm of seven axes has a curve of axis angles for a pose: the angle of its elbow would have to be part of every pose"
            }
            _ => {
                "an arm with fewer axes does not reach every orientation, one with more has free axes that would have to be part of every pose"
            }
        };
        RobotFinding::JointCount { robot: self.name.clone(), joints, needed: needed.into() }
    }

    fn joints(&self) -> Result<[&JointTable; AXES], Wrong> {
        let joints: Vec<&JointTable> = self.joint.iter().collect();
        let joints =
            <[&JointTable; AXES]>::try_from(joints).map_err(|joints| (None, self.not_six(joints.len())))?;
        for (at, joint) in joints.iter().enumerate() {
            joint.check(at + 1).map_err(|finding| (Some(at), finding))?;
        }
        Ok(joints)
    }

    /// The couplings of the joints; where an axis may be, so may the axis of a joint that is coupled with it.
    fn coupling(joints: &[&JointTable; AXES]) -> Result<Coupling, Wrong> {
        let mut coupling = [None; AXES];
        for (at, joint) in joints.iter().enumerate() {
            let wrong = |finding| (Some(at), finding);
            coupling[at] = joint.coupled(at + 1).map_err(wrong)?;
            let of_joint = joint.coupling.and_then(|coupling| coupling.limits_deg);
            let (Some(by), Some([least, most])) = (coupling[at], of_joint) else { continue };
            for axis_deg in joints[by.axis.index()].limits_deg {
                let ([low, high], added) = (joint.limits_deg, by.factor * axis_deg);
                if low.max(least - added) >= high.min(most - added) {
                    let (joint, axis) = (at + 1, by.axis.number());
                    return Err(wrong(RobotFinding::NoCoupledAngle { joint, axis, axis_deg }));
                }
            }
        }
        Ok(Coupling::new(coupling))
    }

    /// The masses, the payload last.
    fn masses(&self) -> Result<Vec<Mass>, RobotFinding> {
        let masses = self.mass.iter().map(|mass| (mass.joint, mass.kg, mass.centre_mm));
        let payload = self.payload.iter().map(|payload| (AXES, payload.kg, payload.centre_mm));
        let checked = |(joint, kg, centre_mm): (usize, f64, [f64; 3])| {
            if !((0.0..=MOST_KG).contains(&kg) && are_lengths(&centre_mm)) {
                return Err(RobotFinding::Mass { kg, centre_mm });
            }
            let joint = Joint::new(joint).ok_or(RobotFinding::MassJoint { joint })?;
            Ok(Mass { joint, kg, centre: centre_mm.into() })
        };
        masses.chain(payload).map(checked).collect()
    }

    /// The robot, when its numbers can be.
    fn into_robot(self) -> Result<Robot, Wrong> {
        if self.convention != "modified-dh" {
            return Err((None, RobotFinding::Convention { convention: self.convention }));
        }
        let joints = self.joints()?;
        let coupling = Self::coupling(&joints)?;
        let Tolerance { length_mm, angle_deg } = self.tolerance;
        let [most_mm, most_deg] = [100.0, 45.0];
        if !(length_mm > 0.0 && length_mm <= most_mm && angle_deg > 0.0 && angle_deg <= most_deg) {
            return Err((None, RobotFinding::Tolerance { length_mm, angle_deg }));
        }
        if self.name.trim().is_empty() {
            return Err((None, RobotFinding::NoName));
        }
        if let Some(value) = self.repeatability_mm.filter(|mm| !(*mm > 0.0 && *mm <= MOST_REPEATABILITY_MM)) {
            return Err((None, RobotFinding::Repeatability { value }));
        }
        let masses = self.masses().map_err(|finding| (None, finding))?;
        if !are_lengths(&self.tool.ball_mm) {
            return Err((None, RobotFinding::ToolBall { ball_mm: self.tool.ball_mm }));
        }
        if self.posterior.as_ref().is_some_and(|posterior| !posterior.is_sound()) {
            return Err((None, RobotFinding::Posterior));
        }
        let mut robot = Robot {
            geometry: Geometry {
                rows: joints.map(JointTable::row),
                coupling,
                tool: self.tool.ball_mm.into(),
                masses,
                compliance: joints.map(|joint| joint.compliance_rad_per_nm),
                gear: joints.map(|joint| [joint.gear_cos_rad, joint.gear_sin_rad]),
                joint_errors: JointErrors::new(joints.map(JointTable::error)),
            },
            limits_deg: joints.map(|joint| joint.limits_deg),
            coupled_limits_deg: joints.map(|joint| joint.coupling.and_then(|coupling| coupling.limits_deg)),
            max_speed_deg_s: joints.map(|joint| joint.max_speed_deg_s),
            max_acceleration_deg_s2: joints.map(|joint| joint.max_acceleration_deg_s2),
            tolerance: self.tolerance,
            repeatability_mm: self.repeatability_mm,
            source: self.source,
            serial: self.serial,
            controller_serial: self.controller_serial,
            language: self.language,
            provenance: self.provenance,
            payload: self.payload.is_some(),
            posterior: self.posterior,
            uncertainty: None,
            // A joint of the nominal robot has no line: the text holds those of both.
            nominal: match self.nominal {
                Some(nominal) => {
                    Some(Box::new(nominal.into_robot().map_err(|(_, finding)| (None, finding))?))
                }
                None => None,
            },
            name: self.name,
        };
        if self.uncertainty.as_ref().is_some_and(|uncertainty| !uncertainty.fits(&robot)) {
            return Err((None, RobotFinding::Uncertainty));
        }
        robot.uncertainty = self.uncertainty.map(Box::new);
        Ok(robot)
    }

    fn from_robot(robot: &Robot) -> Self {
        let (masses, payload) = match robot.geometry.masses.split_last() {
            Some((payload, masses)) if robot.payload => (masses, Some(payload)),
            _ => (robot.geometry.masses.as_slice(), None),
        };
        let mass = |mass: &Mass| MassTable {
            joint: mass.joint.number(),
            kg: mass.kg,
            centre_mm: mass.centre.into(),
        };
        Self {
            name: robot.name.clone(),
            serial: robot.serial.clone(),
            controller_serial: robot.controller_serial.clone(),
            language: robot.language.clone(),
            convention: "modified-dh".into(),
            source: robot.source.clone(),
            repeatability_mm: robot.repeatability_mm,
            joint: robot.joint_tables(),
            tool: ToolTable { ball_mm: robot.geometry.tool.into() },
            tolerance: robot.tolerance,
            mass: masses.iter().map(mass).collect(),
            payload: payload.map(|payload| PayloadTable { kg: payload.kg, centre_mm: payload.centre.into() }),
            provenance: robot.provenance.clone(),
            posterior: robot.posterior.clone(),
            nominal: robot.nominal.as_ref().map(|nominal| Box::new(Self::from_robot(nominal))),
            uncertainty: robot.uncertainty.as_deref().cloned(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_reads_back_and_a_wrong_number_has_its_line() {
        for (name, text) in Robot::built_in() {
            let robot = Robot::from_toml(name, text).unwrap();
            assert_eq!(Robot::from_toml(name, &robot.to_toml().unwrap()).unwrap(), robot);
            let wrong = Robot::from_toml(name, &text.replacen("sign = ", "sign = 2 # ", 1)).unwrap_err();
            assert_eq!(wrong.code.0, "E0505");
            let first = text.lines().position(|line| line == "[[joint]]").unwrap();
            assert_eq!(wrong.line, first + 1);
        }
    }

    #[test]
    fn errors_of_the_joints_read_back() {
        let mut robot = Robot::by_name("kr60ha").unwrap().unwrap();
        let error = JointError {
            smooth: Smooth { centre: 0.25, half_width: 3.0, coefficients: vec![1e-4, -2e-5] },
            backlash: 7.2e-5,
            ripple: vec![Ripple { order: 40, cos: 1e-5, sin: -2e-5 }],
        };
        robot.geometry.joint_errors = JointErrors::new(std::array::from_fn(|at| {
            if at == 1 { error.clone() } else { JointError::default() }
        }));
        let text = robot.to_toml().unwrap();
        assert_eq!(Robot::from_toml("robot.toml", &text).unwrap(), robot);
        let wrong = text.replacen("half_width_rad = 3.0", "half_width_rad = 0.0", 1);
        assert_eq!(Robot::from_toml("robot.toml", &wrong).unwrap_err().code.0, "E0505");
    }
}
