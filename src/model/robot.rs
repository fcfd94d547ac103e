//! The robot file: nominal geometry, limits, speeds, tolerance.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::AXES;
use super::kinematics::{Geometry, Mass, Row};
use crate::diag::{Diagnostic, nearest};

/// The robots that come with dbbd: name and file.
const BUILT_IN: &[(&str, &str)] = include!("../../robots/built-in.rs");

/// A robot as its file describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct Robot {
    /// Name in words.
    pub name: String,
    /// The table, the tool ball and the masses.
    pub geometry: Geometry,
    /// Limits of the controller's axis angles, degrees.
    pub limits_deg: [[f64; 2]; AXES],
    /// Greatest axis speeds, degrees/s.
    pub max_speed_deg_s: [f64; AXES],
    /// Greatest axis accelerations, degrees/s^2, where they are known.
    pub max_acceleration_deg_s2: [Option<f64>; AXES],
    /// What the maker promises.
    pub tolerance: Tolerance,
    /// Repeatability of a pose, mm, where it is known.
    pub repeatability_mm: Option<f64>,
    /// The nominal robot that an identified one came from.
    pub nominal: Option<Box<Robot>>,
    /// Where the file's numbers come from.
    pub source: Option<String>,
    /// Whether the last of the masses is the payload.
    pub payload: bool,
}

/// One standard deviation of what the maker promises of each geometric parameter.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tolerance {
    /// Of the lengths a and d, mm.
    pub length_mm: f64,
    /// Of the angles alpha, theta and beta, degrees.
    pub angle_deg: f64,
}

impl Default for Tolerance {
    /// An industrial robot without an accuracy option: a millimetre of position error.
    fn default() -> Self {
        Self { length_mm: 1.0, angle_deg: 0.1 }
    }
}

#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RobotFile {
    name: String,
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
    #[serde(default, skip_serializing_if = "Option::is_none")]
    nominal: Option<Box<RobotFile>>,
}

#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct JointTable {
    alpha_deg: f64,
    a_mm: f64,
    theta_offset_deg: f64,
    d_mm: f64,
    sign: i8,
    #[serde(default)]
    beta_deg: f64,
    limits_deg: [f64; 2],
    max_speed_deg_s: f64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    max_acceleration_deg_s2: Option<f64>,
    #[serde(default, skip_serializing_if = "is_zero")]
    compliance_rad_per_nm: f64,
    #[serde(default, skip_serializing_if = "is_zero")]
    gear_cos_rad: f64,
    #[serde(default, skip_serializing_if = "is_zero")]
    gear_sin_rad: f64,
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

/// ISO 9283 repeatability is the mean distance plus three standard deviations; for an isotropic
/// normal error of deviation s that is (1.596 + 3 * 0.673) s.
const REPEATABILITY: f64 = 3.616;

impl Robot {
    /// Names and files of the robots that are built in.
    pub fn built_in() -> &'static [(&'static str, &'static str)] {
        BUILT_IN
    }

    /// A built-in robot by its name, if there is one.
    pub fn by_name(name: &str) -> Option<Result<Self, Diagnostic>> {
        let (_, text) = BUILT_IN.iter().find(|(built_in, _)| *built_in == name)?;
        Some(Self::from_toml(name, text))
    }

    /// Standard deviation of each coordinate of a pose that is repeated, mm, where the repeatability is known.
    pub fn repeatability_sd_mm(&self) -> Option<f64> {
        self.repeatability_mm.map(|mm| mm / REPEATABILITY)
    }

    /// A built-in robot whose name is near `name`.
    pub fn similar_name(name: &str) -> Option<&'static str> {
        nearest(name, BUILT_IN.iter().map(|(built_in, _)| *built_in))
    }

    /// Reads a robot file.
    ///
    /// # Errors
    /// Names the line of an unknown or missing key or a value that cannot be.
    pub fn from_toml(file: &str, text: &str) -> Result<Self, Diagnostic> {
        let parsed: RobotFile = toml::from_str(text).map_err(|error| Diagnostic::toml(file, text, &error))?;
        parsed.check().map_err(|(joint, message)| {
            let line = joint.and_then(|at| line_of_table(text, "[[joint]]", at)).unwrap_or(0);
            Diagnostic::line(file, line, message)
        })?;
        Ok(parsed.into_robot())
    }

    /// Writes the robot file; numbers in full precision.
    pub fn to_toml(&self) -> String {
        // The tables are plain numbers and strings, which TOML can always hold.
        toml::to_string(&RobotFile::from_robot(self)).unwrap_or_default()
    }

    /// The robot as its controller knows it: the nominal one, where this one was identified.
    pub fn controller(&self) -> &Robot {
        self.nominal.as_deref().unwrap_or(self)
    }

    /// The joints j whose axis is nominally parallel to the next, where Hayati's `beta<j>` is needed.
    pub fn parallel_joints(&self) -> Vec<usize> {
        (1..AXES).filter(|&i| self.geometry.rows[i].alpha.sin().abs() < 0.1).collect()
    }

    /// The axis accelerations to plan with, degrees/s^2: the file's, else full speed in 0.4 s.
    pub fn acceleration_deg_s2(&self) -> [f64; AXES] {
        let mut acceleration = [0.0; AXES];
        for i in 0..AXES {
            acceleration[i] = self.max_acceleration_deg_s2[i].unwrap_or(self.max_speed_deg_s[i] / 0.4);
        }
        acceleration
    }

    /// The greatest distance of the wrist's far joint from the shoulder, a bound on the reach, mm:
    /// all lengths after joint 1 but the flange's stretched out.
    pub fn reach_mm(&self) -> f64 {
        let rows = &self.geometry.rows;
        let upper: f64 = (1..3).map(|i| rows[i].a.abs()).sum();
        upper + rows[3].a.hypot(rows[3].d)
    }
}

/// The line (from 1) of the `at`-th (from 0) table header in the text.
fn line_of_table(text: &str, header: &str, at: usize) -> Option<usize> {
    text.lines().enumerate().filter(|(_, line)| line.trim() == header).nth(at).map(|(line, _)| line + 1)
}

impl RobotFile {
    /// What the types do not say: six joints, finite numbers, limits in order.
    fn check(&self) -> Result<(), (Option<usize>, String)> {
        if self.convention != "modified-dh" {
            let message = format!("convention `{}` is not known: only `modified-dh` is", self.convention);
            return Err((None, message));
        }
        if self.joint.len() != AXES {
            return Err((None, format!("has {} [[joint]] tables: a robot here has six", self.joint.len())));
        }
        for (at, joint) in self.joint.iter().enumerate() {
            let wrong = |message: String| Err((Some(at), format!("joint {}: {message}", at + 1)));
            let numbers = [
                ("alpha_deg", joint.alpha_deg),
                ("a_mm", joint.a_mm),
                ("theta_offset_deg", joint.theta_offset_deg),
                ("d_mm", joint.d_mm),
                ("beta_deg", joint.beta_deg),
                ("compliance_rad_per_nm", joint.compliance_rad_per_nm),
                ("gear_cos_rad", joint.gear_cos_rad),
                ("gear_sin_rad", joint.gear_sin_rad),
            ];
            if let Some((key, value)) = numbers.iter().find(|(_, value)| !value.is_finite()) {
                return wrong(format!("{key} = {value} is not a finite number"));
            }
            if joint.sign.abs() != 1 {
                return wrong(format!("sign = {} must be 1 or -1", joint.sign));
            }
            let [low, high] = joint.limits_deg;
            if !(low.is_finite() && high.is_finite() && low < high) {
                return wrong(format!("limits_deg = [{low}, {high}] must be [low, high]"));
            }
            for speed in [Some(joint.max_speed_deg_s), joint.max_acceleration_deg_s2].into_iter().flatten() {
                if !(speed.is_finite() && speed > 0.0) {
                    return wrong(format!("a speed or acceleration of {speed} must be positive"));
                }
            }
        }
        let Tolerance { length_mm, angle_deg } = self.tolerance;
        if !(length_mm.is_finite() && angle_deg.is_finite() && length_mm > 0.0 && angle_deg > 0.0) {
            return Err((None, "[tolerance]: length_mm and angle_deg must be positive".into()));
        }
        let masses = self.mass.iter().map(|mass| (mass.kg, mass.centre_mm));
        let payload = self.payload.iter().map(|payload| (payload.kg, payload.centre_mm));
        for (kg, centre) in masses.chain(payload) {
            if !(kg.is_finite() && kg >= 0.0 && centre.iter().all(|x| x.is_finite())) {
                return Err((None, format!("a mass of {kg} kg at {centre:?} mm cannot be")));
            }
        }
        if let Some(mass) = self.mass.iter().find(|mass| !(1..=AXES).contains(&mass.joint)) {
            return Err((None, format!("[[mass]]: joint = {} must be 1 to 6", mass.joint)));
        }
        if !self.tool.ball_mm.iter().all(|x| x.is_finite()) {
            return Err((None, "[tool]: ball_mm must be finite numbers".into()));
        }
        self.nominal.as_ref().map_or(Ok(()), |nominal| nominal.check())
    }

    fn into_robot(self) -> Robot {
        let joint = |i: usize| &self.joint[i];
        let row = |i: usize| Row {
            alpha: joint(i).alpha_deg.to_radians(),
            a: joint(i).a_mm,
            theta: joint(i).theta_offset_deg.to_radians(),
            d: joint(i).d_mm,
            beta: joint(i).beta_deg.to_radians(),
            sign: f64::from(joint(i).sign),
        };
        let mut masses: Vec<Mass> = self
            .mass
            .iter()
            .map(|mass| Mass { joint: mass.joint, kg: mass.kg, centre: Vector3::from(mass.centre_mm) })
            .collect();
        if let Some(payload) = &self.payload {
            masses.push(Mass { joint: AXES, kg: payload.kg, centre: Vector3::from(payload.centre_mm) });
        }
        Robot {
            geometry: Geometry {
                rows: std::array::from_fn(row),
                tool: Vector3::from(self.tool.ball_mm),
                masses,
                compliance: std::array::from_fn(|i| joint(i).compliance_rad_per_nm),
                gear: std::array::from_fn(|i| [joint(i).gear_cos_rad, joint(i).gear_sin_rad]),
            },
            limits_deg: std::array::from_fn(|i| joint(i).limits_deg),
            max_speed_deg_s: std::array::from_fn(|i| joint(i).max_speed_deg_s),
            max_acceleration_deg_s2: std::array::from_fn(|i| joint(i).max_acceleration_deg_s2),
            tolerance: self.tolerance,
            repeatability_mm: self.repeatability_mm,
            source: self.source,
            payload: self.payload.is_some(),
            nominal: self.nominal.map(|nominal| Box::new(nominal.into_robot())),
            name: self.name,
        }
    }

    fn from_robot(robot: &Robot) -> Self {
        let joint = |i: usize| {
            let row = &robot.geometry.rows[i];
            JointTable {
                alpha_deg: row.alpha.to_degrees(),
                a_mm: row.a,
                theta_offset_deg: row.theta.to_degrees(),
                d_mm: row.d,
                sign: if row.sign < 0.0 { -1 } else { 1 },
                beta_deg: row.beta.to_degrees(),
                limits_deg: robot.limits_deg[i],
                max_speed_deg_s: robot.max_speed_deg_s[i],
                max_acceleration_deg_s2: robot.max_acceleration_deg_s2[i],
                compliance_rad_per_nm: robot.geometry.compliance[i],
                gear_cos_rad: robot.geometry.gear[i][0],
                gear_sin_rad: robot.geometry.gear[i][1],
            }
        };
        let masses = &robot.geometry.masses;
        let (masses, payload) = match masses.split_last() {
            Some((payload, masses)) if robot.payload => (masses, Some(payload)),
            _ => (masses.as_slice(), None),
        };
        Self {
            name: robot.name.clone(),
            convention: "modified-dh".into(),
            source: robot.source.clone(),
            repeatability_mm: robot.repeatability_mm,
            joint: (0..AXES).map(joint).collect(),
            tool: ToolTable { ball_mm: robot.geometry.tool.into() },
            tolerance: robot.tolerance,
            mass: masses
                .iter()
                .map(|mass| MassTable { joint: mass.joint, kg: mass.kg, centre_mm: mass.centre.into() })
                .collect(),
            payload: payload.map(|payload| PayloadTable { kg: payload.kg, centre_mm: payload.centre.into() }),
            nominal: robot.nominal.as_ref().map(|nominal| Box::new(Self::from_robot(nominal))),
        }
    }
}
