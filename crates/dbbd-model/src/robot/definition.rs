//! A robot: geometry, limits, speeds, tolerance, and the posterior of its identification.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::kinematics::Geometry;
use super::posterior::RobotPosterior;
use super::uncertainty::RobotUncertainty;
use super::{AXES, Joint, ParamId};
use crate::base::serialised;
use crate::diagnostic::Names;
use crate::diagnostic::{Diagnostic, nearest};
use crate::provenance::ProvenanceFinding;
use crate::provenance::{Artefact, ArtefactRole, Identity, Provenance, TracedArtefact};
use crate::robot::RobotFinding;

/// The robots that come with dbbd: name and file.
const BUILT_IN: &[(&str, &str)] = include!("../../../../robots/built-in.rs");

/// A robot with its file.
pub struct LoadedRobot {
    pub robot: Robot,
    pub source: TracedArtefact,
    /// Doubts about the file.
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
    /// Limits of the axes of the controller.
    pub limits_deg: [[f64; 2]; AXES],
    /// Limits of the own angle of each coupled joint.
    pub coupled_limits_deg: [Option<[f64; 2]>; AXES],
    pub max_speed_deg_s: [f64; AXES],
    pub max_acceleration_deg_s2: [Option<f64>; AXES],
    pub tolerance: Tolerance,
    /// Pose repeatability by ISO 9283.
    pub repeatability_mm: Option<f64>,
    /// The nominal robot of an identified one.
    pub nominal: Option<Box<Robot>>,
    /// The posterior of its identification.
    pub posterior: Option<RobotPosterior>,
    /// The posterior with the errors of the joints, for the position uncertainty.
    pub uncertainty: Option<Box<RobotUncertainty>>,
    /// The source of the numbers in the file.
    pub source: Option<String>,
    /// Whether the last of the masses is the payload.
    pub payload: bool,
    pub provenance: Provenance,
    /// Codes of the warnings of its identification.
    pub doubts: Vec<String>,
}

/// The maker's tolerance of each geometric parameter, as one standard deviation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tolerance {
    /// Of a and d.
    pub length_mm: f64,
    /// Of alpha, theta and beta.
    pub angle_deg: f64,
}

impl Default for Tolerance {
    /// For an industrial robot without an accuracy option, which has a position error of about a millimetre.
    fn default() -> Self {
        Self { length_mm: 1.0, angle_deg: 0.1 }
    }
}

/// The languages of the makers, by the first word of a robot's name.
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

/// Repeatability by ISO 9283 is the mean distance plus three standard deviations of the distance. For an isotropic normal
/// error with the standard deviation s of each coordinate that is (1.596 + 3 * 0.673) s.
const REPEATABILITY: f64 = 3.616;

impl Robot {
    pub fn built_in() -> &'static [(&'static str, &'static str)] {
        BUILT_IN
    }

    pub fn built_in_file(name: &str) -> Option<&'static str> {
        BUILT_IN.iter().find(|(built_in, _)| *built_in == name).map(|(_, text)| *text)
    }

    /// A built-in robot by its name.
    pub fn by_name(name: &str) -> Option<Result<Self, Diagnostic>> {
        Self::built_in_file(name).map(|text| Self::from_toml(name, text))
    }

    /// The robot as an artefact with the text of its file.
    pub fn traced(&self, text: &str) -> TracedArtefact {
        let role = if self.nominal.is_some() { ArtefactRole::IdentifiedRobot } else { ArtefactRole::Robot };
        let artefact = Artefact { serial: self.serial.clone(), ..Artefact::new(role, &self.name, text) };
        let mut provenance = self.provenance.clone();
        let (robot, controller) = (self.serial.clone(), self.controller_serial.clone());
        provenance.identity.extend(&Identity { robot, controller, ..Identity::default() });
        TracedArtefact { artefact, provenance }
    }

    /// The language of its controller: that of the file, else that of the maker in its name.
    pub fn controller_language(&self) -> Option<&str> {
        let maker = self.name.split([' ', '-', '_']).next().unwrap_or("");
        let by_name =
            || LANGUAGES.iter().find(|(name, _)| name.eq_ignore_ascii_case(maker)).map(|(_, of)| *of);
        self.language.as_deref().or_else(by_name)
    }

    /// The finding for a name that is neither a built-in robot nor a file.
    pub fn unknown(name: &str) -> Diagnostic {
        let known = || BUILT_IN.iter().map(|(built_in, _)| *built_in);
        let meant =
            nearest(name, known()).map_or_else(String::new, |near| format!("did you mean `{near}`? "));
        let built_in = known().collect::<Vec<_>>().join(", ");
        Diagnostic::new(RobotFinding::NoSuchRobot { name: name.into(), meant, built_in })
    }

    /// Standard deviation of each coordinate of a repeated pose, mm, if the repeatability is known.
    pub fn repeatability_sd_mm(&self) -> Option<f64> {
        self.repeatability_mm.map(|mm| mm / REPEATABILITY)
    }

    /// The finding if the repeatability is unknown.
    pub fn asked_repeatability(&self) -> Option<RobotFinding> {
        let robot = self.name.clone();
        self.repeatability_mm.is_none().then_some(RobotFinding::NoRepeatability { robot })
    }

    /// A robot by the name of a built-in one or of a file; `file` reads a file, if it exists.
    pub fn named(
        name: &str,
        file: impl FnOnce(&Path) -> Option<Result<String, Diagnostic>>,
    ) -> Result<LoadedRobot, Diagnostic> {
        let text = match Self::built_in_file(name) {
            Some(text) => text.to_owned(),
            None => file(Path::new(name)).ok_or_else(|| Self::unknown(name))??,
        };
        let robot = Self::from_toml(name, &text)?;
        let edited = serialised::is_sealed_toml(&text) == Some(false);
        let edited = edited.then(|| Diagnostic::file(name, ProvenanceFinding::RobotEdited));
        let unlike = robot.unlike_built_in().map(|finding| Diagnostic::file(name, finding));
        let findings = edited.into_iter().chain(unlike).collect();
        Ok(LoadedRobot { source: robot.traced(&text), robot, findings })
    }

    /// The finding if a nominal robot differs from the built-in robot with its name.
    pub fn unlike_built_in(&self) -> Option<RobotFinding> {
        /// Rounding of published tables, mm and degrees.
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

    /// Replaces the tool ball (flange frame, mm); what an earlier identification determined of the old one is dropped.
    pub fn set_tool(&mut self, tool_mm: [f64; 3]) {
        self.geometry.tool = tool_mm.into();
        self.posterior =
            self.posterior.take().and_then(|known| known.keeping(|id| !matches!(id, ParamId::Tool(_))));
    }

    /// The finding if its identification had warnings.
    pub fn doubtful(&self) -> Option<ProvenanceFinding> {
        let doubts = Names::of(&self.doubts);
        (!self.doubts.is_empty())
            .then(|| ProvenanceFinding::DoubtfulRobot { robot: self.name.clone(), doubts })
    }

    /// The robot as its controller knows it: of an identified robot, the nominal one.
    pub fn controller(&self) -> &Robot {
        self.nominal.as_deref().unwrap_or(self)
    }

    /// The joints whose axis is nominally parallel to the one before, which need Hayati's beta.
    pub fn parallel_joints(&self) -> Vec<Joint> {
        let after_first = Joint::ALL.into_iter().skip(1);
        after_first.filter(|joint| self.geometry.row(*joint).alpha.sin().abs() < 0.1).collect()
    }

    /// The axis accelerations for planning, degrees/s^2: those of the file, else full speed in 0.4 s.
    pub fn acceleration_deg_s2(&self) -> [f64; AXES] {
        std::array::from_fn(|i| self.max_acceleration_deg_s2[i].unwrap_or(self.max_speed_deg_s[i] / 0.4))
    }

    /// An upper bound of the distance from the shoulder to the wrist, mm: the links between them, stretched.
    pub fn reach_mm(&self) -> f64 {
        let rows = &self.geometry.rows;
        let upper: f64 = (1..3).map(|i| rows[i].a.abs()).sum();
        upper + rows[3].a.hypot(rows[3].d)
    }

    /// The limits of each axis at axis angles, all in degrees. The axis of a coupled joint has the limits that those of the
    /// joint leave at the angle of the second axis.
    pub fn limits_at_deg(&self, axes_deg: &[f64; AXES]) -> [[f64; 2]; AXES] {
        std::array::from_fn(|place| {
            let [low, high] = self.limits_deg[place];
            let Some([least, most]) = self.coupled_limits_deg[place] else { return [low, high] };
            let added = self.geometry.coupling.added(place, axes_deg);
            [low.max(least - added), high.min(most - added)]
        })
    }

    /// Smallest distance of the axes (rad) from their limits, degrees; negative outside.
    pub fn limit_margin_deg(&self, axes: &[f64; AXES]) -> f64 {
        let axes_deg = axes.map(f64::to_degrees);
        let limits = self.limits_at_deg(&axes_deg).into_iter().zip(axes_deg);
        limits.map(|([low, high], deg)| (deg - low).min(high - deg)).fold(f64::INFINITY, f64::min)
    }

    /// Whether all axes (rad) are within their limits.
    pub fn is_within_limits(&self, axes: &[f64; AXES]) -> bool {
        self.limit_margin_deg(axes) >= 0.0
    }

    /// The range of the own angle of a joint, degrees.
    pub fn joint_range_deg(&self, joint: Joint) -> [f64; 2] {
        let place = joint.index();
        let [low, high] = self.limits_deg[place];
        let Some(by) = self.geometry.coupling.of(joint) else { return [low, high] };
        let added = self.limits_deg[by.axis.index()].map(|deg| by.factor * deg);
        let [least, most] = [added[0].min(added[1]), added[0].max(added[1])];
        self.coupled_limits_deg[place].unwrap_or([low + least, high + most])
    }
}
