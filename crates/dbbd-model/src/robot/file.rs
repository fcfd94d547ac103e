//! The robot file (TOML).

use std::fmt;

use nalgebra::Vector3;
use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use super::controller::{ControllerModel, ControllerTable};
use super::controller_frames::{ControllerFrames, FrameTable};
use super::definition::USUAL_BALL_U_MM;
use super::joint_table::{JointTable, coupling, is_zero};
use super::kinematics::Geometry;
use super::load::{ArmLoad, Mass, Payload};
use super::posterior::RobotPosterior;
use super::uncertainty::RobotUncertainty;
use super::{AXES, DhRow, Drift, Joint, JointErrors, MeasurementConditions, Pose, Robot, Tolerance};
use crate::base::InternalFinding;
use crate::base::date::is_moment;
use crate::base::fixed_array::fixed_array;
use crate::base::parse::from_toml;
use crate::base::serialised;
use crate::diagnostic::Diagnostic;
use crate::plausibility::{PlausibilityFinding, Quantity};
use crate::provenance::Provenance;
use crate::robot::RobotFinding;

/// The keys of the file; angles in degrees.
#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RobotFile {
    name: String,
    serial: Option<String>,
    controller_serial: Option<String>,
    language: Option<String>,
    convention: String,
    source: Option<String>,
    repeatability_mm: Option<f64>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    warnings: Vec<String>,
    date: Option<String>,
    temperature_c: Option<f64>,
    controller: Option<ControllerTable>,
    joint: Vec<JointTable>,
    #[serde(default)]
    tool: RobotToolTable,
    #[serde(default)]
    tolerance: Tolerance,
    mounting: Option<MountingTable>,
    /// The flange of the controller in that of the table.
    flange: Option<FrameTable>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    mass: Vec<MassTable>,
    #[serde(default, deserialize_with = "one_or_several", skip_serializing_if = "Vec::is_empty")]
    payload: Vec<PayloadTable>,
    #[serde(default, skip_serializing_if = "Provenance::is_empty")]
    provenance: Provenance,
    drift: Option<Drift>,
    posterior: Option<RobotPosterior>,
    nominal: Option<Box<RobotFile>>,
    uncertainty: Option<RobotUncertainty>,
}

#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RobotToolTable {
    /// Missing where nobody has stated it: a robot of the catalogue has no tool.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "fixed_array")]
    ball_mm: Option<[f64; 3]>,
    #[serde(default = "usual_ball_u_mm")]
    ball_u_mm: f64,
}

impl Default for RobotToolTable {
    fn default() -> Self {
        Self { ball_mm: None, ball_u_mm: usual_ball_u_mm() }
    }
}

fn usual_ball_u_mm() -> f64 {
    USUAL_BALL_U_MM
}

#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct MassTable {
    joint: usize,
    kg: f64,
    #[serde(deserialize_with = "fixed_array")]
    centre_mm: [f64; 3],
    /// Whether the masses follow from the size of the arm.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    assumed: bool,
}

#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct MountingTable {
    /// The robot base in the World of the controller, whose Z is up: mm, and KUKA's A, B, C in degrees.
    #[serde(default, skip_serializing_if = "is_zeros", deserialize_with = "fixed_array")]
    xyz_mm: [f64; 3],
    #[serde(default, skip_serializing_if = "is_zeros", deserialize_with = "fixed_array")]
    abc_deg: [f64; 3],
    /// Direction of gravity in the robot base; its length does not matter. Without it, it follows from `abc_deg`.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "fixed_array")]
    gravity: Option<[f64; 3]>,
}

fn is_zeros(numbers: &[f64; 3]) -> bool {
    *numbers == [0.0; 3]
}

#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PayloadTable {
    #[serde(default, skip_serializing_if = "String::is_empty")]
    name: String,
    kg: f64,
    #[serde(deserialize_with = "fixed_array")]
    centre_mm: [f64; 3],
    #[serde(default, skip_serializing_if = "is_zero")]
    u_kg: f64,
    #[serde(default, skip_serializing_if = "is_zero")]
    u_mm: f64,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    measured: bool,
}

/// `[payload]`, or several `[[payload]]`.
fn one_or_several<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<PayloadTable>, D::Error> {
    struct OneOrSeveral;

    impl<'de> Visitor<'de> for OneOrSeveral {
        type Value = Vec<PayloadTable>;

        fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
            out.write_str("a payload or several")
        }

        fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Self::Value, A::Error> {
            Ok(vec![PayloadTable::deserialize(MapAccessDeserializer::new(map))?])
        }

        fn visit_seq<A: SeqAccess<'de>>(self, several: A) -> Result<Self::Value, A::Error> {
            Vec::deserialize(SeqAccessDeserializer::new(several))
        }
    }

    deserializer.deserialize_any(OneOrSeveral)
}

impl MountingTable {
    /// The table of a robot that does not stand upright in the origin of its World.
    fn of(base: &Pose, gravity: &Vector3<f64>) -> Option<Self> {
        let FrameTable { xyz_mm, abc_deg } = FrameTable::of(base);
        let gravity = (!is_along(gravity, &down(base))).then(|| (*gravity).into());
        (*base != Pose::identity() || gravity.is_some()).then_some(Self { xyz_mm, abc_deg, gravity })
    }

    fn base(&self) -> Result<Pose, Diagnostic> {
        FrameTable { xyz_mm: self.xyz_mm, abc_deg: self.abc_deg }.pose()
    }

    /// The direction of gravity in the robot base as a unit vector.
    fn direction(&self) -> Result<Vector3<f64>, Diagnostic> {
        let down = down(&self.base()?);
        let Some(gravity) = self.gravity else { return Ok(down) };
        let unit = Vector3::from(gravity).try_normalize(0.0);
        let unit =
            unit.filter(|unit| unit.iter().all(|part| part.is_finite())).ok_or(RobotFinding::Gravity)?;
        if self.abc_deg != [0.0; 3] && !is_along(&unit, &down) {
            return Err(RobotFinding::GravityOfMounting { down: down.into() }.into());
        }
        Ok(unit)
    }
}

/// Down in the robot base.
fn down(base: &Pose) -> Vector3<f64> {
    base.rotation.transpose() * ArmLoad::DOWN
}

fn is_along(one: &Vector3<f64>, other: &Vector3<f64>) -> bool {
    /// Rounding of angles with four decimals.
    const ROUNDED: f64 = 1e-5;
    (one - other).norm() < ROUNDED
}

impl Robot {
    pub fn from_toml(file: &str, text: &str) -> Result<Self, Diagnostic> {
        let parsed: RobotFile = from_toml(file, text)?;
        parsed.into_robot().map_err(|(joint, finding)| {
            let line = joint.and_then(|at| line_of_table(text, "[[joint]]", at)).unwrap_or(0);
            finding.in_line_of(file, line)
        })
    }

    /// The robot file, with numbers in full precision.
    pub fn to_toml(&self) -> Result<String, InternalFinding> {
        serialised::toml(&RobotFile::from_robot(self))
    }

    /// The `[[joint]]` tables of the file.
    pub fn joint_tables(&self) -> Vec<JointTable> {
        Joint::ALL.into_iter().map(|joint| JointTable::of(self, joint)).collect()
    }
}

impl RobotFile {
    /// Checks the values that do not belong to a joint or a mass.
    fn check_values(&self) -> Result<(), PlausibilityFinding> {
        let ball_mm = self.tool.ball_mm.into_iter().flatten().map(f64::abs).fold(0.0, f64::max);
        // If the nominal ball is at the flange, the identified one may be very near to it.
        let ball_mm = (ball_mm > 0.0 && self.nominal.is_none()).then_some(ball_mm);
        let values = [
            ("[tolerance] length_mm", Some(self.tolerance.length_mm), Quantity::LengthTolerance),
            ("[tolerance] angle_deg", Some(self.tolerance.angle_deg), Quantity::AngleTolerance),
            ("[tolerance] flange_mm", self.tolerance.flange_mm, Quantity::LengthTolerance),
            ("[tolerance] flange_deg", self.tolerance.flange_deg, Quantity::AngleTolerance),
            ("[tool] ball_u_mm", Some(self.tool.ball_u_mm), Quantity::LengthTolerance),
            ("repeatability_mm", self.repeatability_mm, Quantity::Repeatability),
            ("temperature_c", self.temperature_c, Quantity::Temperature),
            ("[tool] ball_mm", ball_mm, Quantity::ToolBallDistance),
        ];
        let coordinates =
            self.tool.ball_mm.unwrap_or_default().map(|mm| ("[tool] ball_mm", Some(mm), Quantity::ArmLength));
        coordinates
            .into_iter()
            .chain(values)
            .try_for_each(|(key, value, quantity)| value.map_or(Ok(()), |value| quantity.check(key, value)))
    }
}

/// The line (from 1) of the `at`-th (from 0) table header in the text.
fn line_of_table(text: &str, header: &str, at: usize) -> Option<usize> {
    text.lines().enumerate().filter(|(_, line)| line.trim() == header).nth(at).map(|(line, _)| line + 1)
}

/// A finding, with the index of the joint that it is about.
type RobotFileError = (Option<usize>, Diagnostic);

impl RobotFile {
    /// The finding for an arm that does not have six axes.
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

    fn joints(&self) -> Result<[&JointTable; AXES], RobotFileError> {
        let joints: Vec<&JointTable> = self.joint.iter().collect();
        let joints = <[&JointTable; AXES]>::try_from(joints)
            .map_err(|joints| (None, self.not_six(joints.len()).into()))?;
        for (at, joint) in joints.iter().enumerate() {
            joint.check(at + 1).map_err(|finding| (Some(at), finding))?;
        }
        Ok(joints)
    }

    /// The masses that the file states, else those of a usual arm.
    fn load(&self, rows: &[DhRow; AXES]) -> Result<ArmLoad, Diagnostic> {
        let mass = |mass: &MassTable| -> Result<Mass, Diagnostic> {
            Quantity::Mass.check("kg", mass.kg)?;
            mass.centre_mm.into_iter().try_for_each(|mm| Quantity::ArmLength.check("centre_mm", mm))?;
            let joint = Joint::new(mass.joint).ok_or(RobotFinding::MassJoint { joint: mass.joint })?;
            Ok(Mass { joint, kg: mass.kg, centre: mass.centre_mm.into() })
        };
        let payload = |payload: &PayloadTable| -> Result<Payload, Diagnostic> {
            let PayloadTable { name, kg, centre_mm, u_kg, u_mm, measured } = payload.clone();
            let payload = Payload { name, kg, centre: centre_mm.into(), u_kg, u_mm, is_measured: measured };
            payload.check()?;
            Ok(payload)
        };
        let names = || self.payload.iter().map(|payload| payload.name.as_str());
        if let Some(twice) =
            names().enumerate().find(|(at, name)| names().skip(at + 1).any(|other| other == *name))
        {
            return Err(RobotFinding::PayloadTwice { name: twice.1.to_owned() }.into());
        }
        let stated: Vec<Mass> = self.mass.iter().map(mass).collect::<Result<_, _>>()?;
        let load = if stated.is_empty() { ArmLoad::usual(rows) } else { ArmLoad::known(stated) };
        Ok(ArmLoad {
            is_assumed: load.is_assumed || self.mass.iter().any(|mass| mass.assumed),
            payloads: self.payload.iter().map(payload).collect::<Result<_, _>>()?,
            gravity: match &self.mounting {
                Some(mounting) => mounting.direction()?,
                None => ArmLoad::DOWN,
            },
            ..load
        })
    }

    fn frames(&self) -> Result<ControllerFrames, Diagnostic> {
        let base = self.mounting.as_ref().map_or(Ok(Pose::identity()), MountingTable::base)?;
        let flange = self.flange.as_ref().map_or(Ok(Pose::identity()), FrameTable::pose)?;
        Ok(ControllerFrames { base, flange })
    }

    /// Checks everything but joints and masses.
    fn check(&self) -> Result<(), Diagnostic> {
        self.check_values()?;
        if self.name.trim().is_empty() {
            return Err(RobotFinding::NoName.into());
        }
        if let Some(date) = self.date.as_ref().filter(|date| !is_moment(date)) {
            return Err(RobotFinding::NotADate { date: date.clone() }.into());
        }
        if self.drift.is_some_and(|drift| !drift.is_sound()) {
            return Err(RobotFinding::Drift.into());
        }
        if self.posterior.as_ref().is_some_and(|posterior| !posterior.is_sound()) {
            return Err(RobotFinding::Posterior.into());
        }
        Ok(())
    }

    /// The robot, if all numbers are possible.
    fn into_robot(self) -> Result<Robot, RobotFileError> {
        if self.convention != "modified-dh" {
            return Err((None, RobotFinding::Convention { convention: self.convention }.into()));
        }
        let joints = self.joints()?;
        let coupling = coupling(&joints).map_err(|(at, finding)| (Some(at), finding.into()))?;
        self.check().map_err(|finding| (None, finding))?;
        let rows = joints.map(JointTable::row);
        let stated = self.controller.as_ref().map(|stated| stated.rows(&rows)).transpose();
        let calibrated = stated.map_err(|finding| (None, finding))?.flatten();
        let load = self.load(&rows).map_err(|finding| (None, finding))?;
        let frames = self.frames().map_err(|finding| (None, finding))?;
        let mut robot = Robot {
            frames,
            geometry: Geometry {
                rows,
                coupling,
                tool: self.tool.ball_mm.unwrap_or_default().into(),
                load,
                compliance: joints.map(|joint| joint.compliance_rad_per_nm),
                payload_compliance: joints.map(|joint| joint.payload_compliance_rad_per_nm),
                gear: joints.map(|joint| [joint.gear_cos_rad, joint.gear_sin_rad]),
                joint_errors: JointErrors::new(joints.map(JointTable::error)),
            },
            limits_deg: joints.map(|joint| joint.limits_deg),
            coupled_limits_deg: joints.map(JointTable::coupled_limits_deg),
            max_speed_deg_s: joints.map(|joint| joint.max_speed_deg_s),
            max_acceleration_deg_s2: joints.map(|joint| joint.max_acceleration_deg_s2),
            tolerance: self.tolerance,
            has_tool: self.tool.ball_mm.is_some(),
            ball_u_mm: self.tool.ball_u_mm,
            repeatability_mm: self.repeatability_mm,
            source: self.source,
            serial: self.serial,
            controller_serial: self.controller_serial,
            language: self.language,
            controller_model: ControllerModel::Nominal,
            provenance: self.provenance,
            warnings: self.warnings,
            posterior: self.posterior,
            uncertainty: None,
            measured: MeasurementConditions { date: self.date, temperature_c: self.temperature_c },
            drift: self.drift.unwrap_or_default(),
            // The line of a joint of the nominal robot is not known: the text has the joints of both robots.
            nominal: match self.nominal {
                Some(nominal) => {
                    Some(Box::new(nominal.into_robot().map_err(|(_, finding)| (None, finding))?))
                }
                None => None,
            },
            name: self.name,
        };
        if self.uncertainty.as_ref().is_some_and(|uncertainty| !uncertainty.fits(&robot.geometry)) {
            return Err((None, RobotFinding::Uncertainty.into()));
        }
        robot.uncertainty = self.uncertainty.map(Box::new);
        let usual = || ControllerModel::usual(robot.controller_language());
        let stated = self.controller.as_ref().map(ControllerTable::model);
        robot.controller_model = match (&robot.nominal, stated) {
            (Some(_), Some(_)) => return Err((None, RobotFinding::ControllerOfIdentified.into())),
            (Some(nominal), None) => nominal.controller_model,
            (None, stated) => stated.unwrap_or_else(usual),
        };
        if let Some(rows) = calibrated {
            robot.geometry.rows = rows;
            robot.geometry.shorten_offsets();
        }
        Ok(robot)
    }

    fn from_robot(robot: &Robot) -> Self {
        let ArmLoad { masses, is_assumed, payloads, gravity } = &robot.geometry.load;
        let mass = |mass: &Mass| MassTable {
            joint: mass.joint.number(),
            kg: mass.kg,
            centre_mm: mass.centre.into(),
            assumed: *is_assumed,
        };
        let payload = |payload: &Payload| {
            let Payload { name, kg, centre, u_kg, u_mm, is_measured } = payload.clone();
            PayloadTable { name, kg, centre_mm: centre.into(), u_kg, u_mm, measured: is_measured }
        };
        // The masses of a usual arm follow from the nominal geometry: an identified one has another.
        // An identified robot has its controller in the nominal one.
        let usual = ControllerModel::usual(robot.controller_language());
        let is_stated = robot.nominal.is_none() && robot.controller_model != usual;
        let is_written = robot.nominal.is_some() || *masses != ArmLoad::usual(&robot.geometry.rows).masses;
        Self {
            name: robot.name.clone(),
            serial: robot.serial.clone(),
            controller_serial: robot.controller_serial.clone(),
            language: robot.language.clone(),
            convention: "modified-dh".into(),
            source: robot.source.clone(),
            repeatability_mm: robot.repeatability_mm,
            warnings: robot.warnings.clone(),
            date: robot.measured.date.clone(),
            temperature_c: robot.measured.temperature_c,
            controller: is_stated.then(|| ControllerTable::of(robot.controller_model, &robot.geometry.rows)),
            joint: robot.joint_tables(),
            tool: RobotToolTable {
                ball_mm: robot.has_tool.then(|| robot.geometry.tool.into()),
                ball_u_mm: robot.ball_u_mm,
            },
            tolerance: robot.tolerance,
            mounting: MountingTable::of(&robot.frames.base, gravity),
            flange: (robot.frames.flange != Pose::identity()).then(|| FrameTable::of(&robot.frames.flange)),
            mass: masses.iter().filter(|_| is_written).map(mass).collect(),
            payload: payloads.iter().map(payload).collect(),
            provenance: robot.provenance.clone(),
            drift: robot.drift.is_learnt().then_some(robot.drift),
            posterior: robot.posterior.clone(),
            nominal: robot.nominal.as_ref().map(|nominal| Box::new(Self::from_robot(nominal))),
            uncertainty: robot.uncertainty.as_deref().cloned(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{JointErrorModel, Ripple, SmoothJointError, VisitedAngles};

    #[test]
    fn robots_read_back_and_errors_have_their_line() {
        for (name, text) in Robot::built_in() {
            let robot = Robot::from_toml(name, text).unwrap();
            assert_eq!(Robot::from_toml(name, &robot.to_toml().unwrap()).unwrap(), robot);
            let wrong = Robot::from_toml(name, &text.replacen("sign = ", "sign = 2 # ", 1)).unwrap_err();
            assert_eq!(wrong.code().as_str(), "E0505");
            let first = text.lines().position(|line| line == "[[joint]]").unwrap();
            assert_eq!(wrong.line_number(), first + 1);
        }
    }

    #[test]
    fn gravity_and_payloads_read_back_and_are_checked() {
        let (_, text) = Robot::built_in()[0];
        let with = |tables: &str| Robot::from_toml("robot.toml", &format!("{text}\n{tables}"));
        let on_wall =
            with("[mounting]\ngravity = [0.0, 9.81, 0.0]\n[payload]\nkg = 3.0\ncentre_mm = [0.0, 0.0, 80.0]");
        let on_wall = on_wall.unwrap();
        assert_eq!(on_wall.geometry.load.gravity, Vector3::y());
        assert_eq!(on_wall.geometry.load.carried().unwrap().kg, 3.0);
        assert_eq!(Robot::from_toml("robot.toml", &on_wall.to_toml().unwrap()).unwrap(), on_wall);
        let payload = |name: &str| {
            format!(
                "[[payload]]\nname = \"{name}\"\nkg = 0.0\ncentre_mm = [0.0, 0.0, 0.0]\nu_kg = 0.5\nu_mm = 5.0\n"
            )
        };
        let several = with(&[payload("bar"), payload("gripper")].concat()).unwrap();
        let names: Vec<&str> = several.geometry.load.payloads.iter().map(|one| one.name.as_str()).collect();
        assert_eq!(names, ["bar", "gripper"]);
        assert_eq!(Robot::from_toml("robot.toml", &several.to_toml().unwrap()).unwrap(), several);
        for wrong in ["[mounting]\ngravity = [0.0, 0.0, 0.0]", &payload("bar").repeat(2)] {
            assert_eq!(with(wrong).unwrap_err().code().as_str(), "E0505", "{wrong}");
        }
        assert_eq!(with("[payload]\nkg = 3.0").unwrap_err().code().as_str(), "E0120");
    }

    #[test]
    fn joint_errors_read_back() {
        let mut robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        let error = JointErrorModel {
            visited: VisitedAngles { middle: 0.2, scale: 0.4 },
            smooth: SmoothJointError { centre: 0.25, half_width: 3.0, coefficients: vec![1e-4, -2e-5] },
            backlash: 7.2e-5,
            ripple: vec![Ripple { order: 40, cos: 1e-5, sin: -2e-5 }],
        };
        robot.geometry.joint_errors = JointErrors::new(std::array::from_fn(|at| {
            if at == 1 { error.clone() } else { JointErrorModel::default() }
        }));
        let text = robot.to_toml().unwrap();
        assert_eq!(Robot::from_toml("robot.toml", &text).unwrap(), robot);
        let wrong = text.replacen("half_width_rad = 3.0", "half_width_rad = 0.0", 1);
        assert_eq!(Robot::from_toml("robot.toml", &wrong).unwrap_err().code().as_str(), "E0130");
    }
}
