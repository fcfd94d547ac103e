//! A robot: geometry, limits, speeds, tolerance, and what an identification left unknown.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::kinematics::Geometry;
use super::posterior::RobotPosterior;
use super::uncertainty::RobotUncertainty;
use super::{AXES, Joint, ParamId};
use crate::base::serialised;
use crate::catalogue::{Names, ProvenanceFinding, RobotFinding};
use crate::diagnostic::{Diagnostic, nearest};
use crate::provenance::{Artefact, Identity, Provenance, Role, Traced};

/// The robots that come with dbbd: name and file.
const BUILT_IN: &[(&str, &str)] = include!("../../robots/built-in.rs");

/// A robot with the file that it was read from.
pub struct RobotRead {
    pub robot: Robot,
    pub source: Traced,
    /// What is doubtful in the file.
    pub findings: Vec<Diagnostic>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Robot {
    pub name: String,
    /// Serial number of the arm.
    pub serial: Option<String>,
    /// Serial number of its controller.
    pub controller_serial: Option<String>,
    /// The language of its controller's programs, such as `krl`.
    pub language: Option<String>,
    /// The table, the tool ball and the masses.
    pub geometry: Geometry,
    /// Of the controller's axes.
    pub limits_deg: [[f64; 2]; AXES],
    /// Of the own angle of each coupled joint, where it has limits.
    pub coupled_limits_deg: [Option<[f64; 2]>; AXES],
    pub max_speed_deg_s: [f64; AXES],
    /// Where they are known.
    pub max_acceleration_deg_s2: [Option<f64>; AXES],
    pub tolerance: Tolerance,
    /// Of a pose by ISO 9283, where it is known.
    pub repeatability_mm: Option<f64>,
    /// The nominal robot that an identified one came from.
    pub nominal: Option<Box<Robot>>,
    /// What its identification left unknown.
    pub posterior: Option<RobotPosterior>,
    /// The same with the errors of its joints, for a prediction of the position.
    pub uncertainty: Option<Box<RobotUncertainty>>,
    /// Where the file's numbers come from.
    pub source: Option<String>,
    /// Whether the last of the masses is the payload.
    pub payload: bool,
    /// What an identified robot was made from.
    pub provenance: Provenance,
    /// The codes of the warnings of its identification.
    pub doubts: Vec<String>,
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

/// The languages of makers' controllers, by the first word of a robot's name.
const LANGUAGES: [(&str, &str); 9] = [
    ("KUKA", "krl"),
    ("ABB", "rapid"),
    ("Universal", "urscript"),
    ("UR", "urscript"),
    ("Staubli", "val3"),
    ("Stäubli", "val3"),
    ("Fanuc", "karel"),
    ("Yaskawa", "inform"),
    ("Motoman", "inform"),
];

/// ISO 9283 repeatability is the mean distance plus three standard deviations; for an isotropic
/// normal error of deviation s that is (1.596 + 3 * 0.673) s.
const REPEATABILITY: f64 = 3.616;

impl Robot {
    pub fn built_in() -> &'static [(&'static str, &'static str)] {
        BUILT_IN
    }

    pub fn built_in_file(name: &str) -> Option<&'static str> {
        BUILT_IN.iter().find(|(built_in, _)| *built_in == name).map(|(_, text)| *text)
    }

    /// A built-in robot by its name, if there is one.
    pub fn by_name(name: &str) -> Option<Result<Self, Diagnostic>> {
        Self::built_in_file(name).map(|text| Self::from_toml(name, text))
    }

    /// The robot as an artefact, `text` being its file.
    pub fn traced(&self, text: &str) -> Traced {
        let role = if self.nominal.is_some() { Role::IdentifiedRobot } else { Role::Robot };
        let artefact = Artefact { serial: self.serial.clone(), ..Artefact::new(role, &self.name, text) };
        let mut provenance = self.provenance.clone();
        let (robot, controller) = (self.serial.clone(), self.controller_serial.clone());
        provenance.identity.extend(&Identity { robot, controller, ..Identity::default() });
        Traced { artefact, provenance }
    }

    /// The language of its controller's programs: the file's, else that of the maker in its name.
    pub fn controller_language(&self) -> Option<&str> {
        let maker = self.name.split([' ', '-', '_']).next().unwrap_or("");
        let by_name =
            || LANGUAGES.iter().find(|(name, _)| name.eq_ignore_ascii_case(maker)).map(|(_, of)| *of);
        self.language.as_deref().or_else(by_name)
    }

    /// That a name is neither built in nor a file.
    pub fn unknown(name: &str) -> Diagnostic {
        let known = || BUILT_IN.iter().map(|(built_in, _)| *built_in);
        let meant =
            nearest(name, known()).map_or_else(String::new, |near| format!("did you mean `{near}`? "));
        let built_in = known().collect::<Vec<_>>().join(", ");
        Diagnostic::new(RobotFinding::NoSuchRobot { name: name.into(), meant, built_in })
    }

    /// Standard deviation of each coordinate of a pose that is repeated, mm, where the repeatability is known.
    pub fn repeatability_sd_mm(&self) -> Option<f64> {
        self.repeatability_mm.map(|mm| mm / REPEATABILITY)
    }

    /// That its file should say how it repeats.
    pub fn asked_repeatability(&self) -> Option<RobotFinding> {
        let robot = self.name.clone();
        self.repeatability_mm.is_none().then_some(RobotFinding::NoRepeatability { robot })
    }

    /// A robot by built-in name or by file, whose text `file` reads where there is one of this name.
    ///
    /// # Errors
    /// An unknown name, or what is wrong in the file.
    pub fn named(
        name: &str,
        file: impl FnOnce(&Path) -> Option<Result<String, Diagnostic>>,
    ) -> Result<RobotRead, Diagnostic> {
        let text = match Self::built_in_file(name) {
            Some(text) => text.to_owned(),
            None => file(Path::new(name)).ok_or_else(|| Self::unknown(name))??,
        };
        let robot = Self::from_toml(name, &text)?;
        let edited = serialised::is_sealed_toml(&text) == Some(false);
        let edited = edited.then(|| Diagnostic::file(name, ProvenanceFinding::RobotEdited));
        let unlike = robot.unlike_built_in().map(|finding| Diagnostic::file(name, finding));
        let findings = edited.into_iter().chain(unlike).collect();
        Ok(RobotRead { source: robot.traced(&text), robot, findings })
    }

    /// What a robot that is not identified has otherwise than the built-in one of its name.
    pub fn unlike_built_in(&self) -> Option<RobotFinding> {
        /// Tables of one robot are rounded, mm and degrees.
        const ALIKE: f64 = 1.0;
        if self.nominal.is_some() {
            return None;
        }
        let all = BUILT_IN.iter().filter_map(|(name, text)| Self::from_toml(name, text).ok());
        let built_in = all.into_iter().find(|robot| robot.name == self.name)?;
        let rows = self.geometry.rows.iter().zip(&built_in.geometry.rows).zip(1..);
        rows.into_iter().find_map(|((row, known), joint)| {
            let deg = f64::to_degrees;
            let values = [
                ("alpha_deg", deg(row.alpha), deg(known.alpha)),
                ("a_mm", row.a, known.a),
                ("theta_offset_deg", deg(row.theta), deg(known.theta)),
                ("d_mm", row.d, known.d),
                ("sign", row.sign, known.sign),
            ];
            let (key, value, built_in) =
                values.into_iter().find(|(_, value, known)| (value - known).abs() > ALIKE)?;
            Some(RobotFinding::UnlikeBuiltIn { robot: self.name.clone(), joint, key, value, built_in })
        })
    }

    /// Gives it another tool ball (flange frame, mm), of which nothing is known from an earlier identification.
    pub fn set_tool(&mut self, tool_mm: [f64; 3]) {
        self.geometry.tool = tool_mm.into();
        self.posterior =
            self.posterior.take().and_then(|known| known.keeping(|id| !matches!(id, ParamId::Tool(_))));
    }

    /// That its identification had warnings.
    pub fn doubtful(&self) -> Option<ProvenanceFinding> {
        let doubts = Names::of(&self.doubts);
        (!self.doubts.is_empty())
            .then(|| ProvenanceFinding::DoubtfulRobot { robot: self.name.clone(), doubts })
    }

    /// The robot as its controller knows it: the nominal one, where this one was identified.
    pub fn controller(&self) -> &Robot {
        self.nominal.as_deref().unwrap_or(self)
    }

    /// The joints whose axis is nominally parallel to the one before, where Hayati's beta is needed.
    pub fn parallel_joints(&self) -> Vec<Joint> {
        let after_first = Joint::ALL.into_iter().skip(1);
        after_first.filter(|joint| self.geometry.row(*joint).alpha.sin().abs() < 0.1).collect()
    }

    /// The axis accelerations to plan with, degrees/s^2: the file's, else full speed in 0.4 s.
    pub fn acceleration_deg_s2(&self) -> [f64; AXES] {
        std::array::from_fn(|i| self.max_acceleration_deg_s2[i].unwrap_or(self.max_speed_deg_s[i] / 0.4))
    }

    /// The greatest distance of the wrist's far joint from the shoulder, a bound on the reach, mm:
    /// all lengths after joint 1 but the flange's stretched out.
    pub fn reach_mm(&self) -> f64 {
        let rows = &self.geometry.rows;
        let upper: f64 = (1..3).map(|i| rows[i].a.abs()).sum();
        upper + rows[3].a.hypot(rows[3].d)
    }
}
