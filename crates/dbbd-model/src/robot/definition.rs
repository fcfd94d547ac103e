//! A robot: geometry, limits, speeds, tolerance, and the posterior of its identification.

use nalgebra::{DMatrix, DVector, Vector3};

use super::controller::ControllerModel;
use super::controller_frames::ControllerFrames;
use super::joint_axes::PARALLEL;
use super::kinematics::Geometry;
use super::load::ArmLoad;
use super::maker::Maker;
use super::parameter::all_parameters;
use super::posterior::RobotPosterior;
use super::tolerance::Tolerance;
use super::uncertainty::RobotUncertainty;
use super::{AXES, Coupling, DhRow, Drift, Joint, JointErrors, MeasurementConditions, ParamId, PriorRule};
use crate::base::serialised::Seal;
use crate::diagnostic::Names;
use crate::diagnostic::{Diagnostic, nearest};
use crate::provenance::ProvenanceFinding;
use crate::provenance::{Artefact, ArtefactRole, Identity, Provenance, TracedArtefact};
use crate::robot::RobotFinding;

/// The robots that come with dbbd: name and file.
const BUILT_IN: &[(&str, &str)] = include!("../../../../robots/built-in.rs");

/// A robot with its file.
#[derive(Clone, Debug)]
pub struct LoadedRobot {
    pub robot: Robot,
    pub source: TracedArtefact,
    /// Warnings about the file.
    pub findings: Vec<Diagnostic>,
}

impl LoadedRobot {
    /// A robot from the text of its file, with the warnings about it.
    ///
    /// # Errors
    /// The text is not the file of a robot.
    pub fn from_toml(file: &str, text: &str) -> Result<Self, Diagnostic> {
        let robot = Robot::from_toml(file, text)?;
        let edited = Seal::Toml.check(text).is_err();
        let edited = edited.then(|| Diagnostic::file(file, ProvenanceFinding::RobotEdited));
        let unlike = robot.unlike_built_in().map(|finding| Diagnostic::file(file, finding));
        let findings = edited.into_iter().chain(unlike).collect();
        Ok(Self { source: robot.traced(text), robot, findings })
    }
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
    /// The model with which the controller computes; an identified robot has that of its nominal robot.
    pub controller_model: ControllerModel,
    /// The frames from which the controller counts.
    pub frames: ControllerFrames,
    /// The DH table, the tool ball and the masses that load the joints.
    pub geometry: Geometry,
    /// Limits of the axes of the controller.
    pub limits_deg: [[f64; 2]; AXES],
    /// Limits of the own angle of each coupled joint.
    pub coupled_limits_deg: [Option<[f64; 2]>; AXES],
    pub max_speed_deg_s: [f64; AXES],
    pub max_acceleration_deg_s2: [Option<f64>; AXES],
    pub tolerance: Tolerance,
    /// Whether it is stated where the tool ball is. A robot of the catalogue has no tool, and its ball is at the flange until it
    /// is stated.
    pub has_tool: bool,
    /// Standard uncertainty of each coordinate of the tool ball on the flange, mm.
    pub ball_u_mm: f64,
    /// Pose repeatability by ISO 9283.
    pub repeatability_mm: Option<f64>,
    /// The nominal robot of an identified one.
    pub nominal: Option<Box<Robot>>,
    /// The posterior of its identification.
    pub posterior: Option<RobotPosterior>,
    /// The posterior with the errors of the joints, for the position uncertainty.
    pub uncertainty: Option<Box<RobotUncertainty>>,
    /// Date and temperature of the identification.
    pub measured: MeasurementConditions,
    /// How fast the zeros of the joints wander.
    pub drift: Drift,
    /// The source of the numbers in the file.
    pub source: Option<String>,
    pub provenance: Provenance,
    /// Codes of the warnings of its identification.
    pub warnings: Vec<String>,
}

/// A tool ball is mounted to tenths of a millimetre.
pub(super) const USUAL_BALL_U_MM: f64 = 0.5;

/// Repeatability by ISO 9283 is the mean distance plus three standard deviations of the distance. For an isotropic normal
/// error with the standard deviation s of each coordinate that is (1.596 + 3 * 0.673) s.
const REPEATABILITY: f64 = 3.616;

impl Robot {
    /// A robot whose table is not set yet, with limits (degrees) and speeds (degrees/s), the usual tolerance, and its ball at the
    /// flange.
    pub fn rigid(name: &str, limits_deg: [[f64; 2]; AXES], max_speed_deg_s: [f64; AXES]) -> Self {
        let rows = [DhRow { sign: 1.0, ..DhRow::default() }; AXES];
        Self {
            name: name.to_owned(),
            serial: None,
            controller_serial: None,
            language: None,
            controller_model: ControllerModel::Nominal,
            frames: ControllerFrames::default(),
            geometry: Geometry {
                rows,
                coupling: Coupling::default(),
                tool: Vector3::zeros(),
                load: ArmLoad::usual(&rows),
                compliance: [0.0; AXES],
                payload_compliance: [0.0; AXES],
                gear: [[0.0; 2]; AXES],
                joint_errors: JointErrors::default(),
            },
            limits_deg,
            coupled_limits_deg: [None; AXES],
            max_speed_deg_s,
            max_acceleration_deg_s2: [None; AXES],
            tolerance: Tolerance::default(),
            has_tool: false,
            ball_u_mm: USUAL_BALL_U_MM,
            repeatability_mm: None,
            nominal: None,
            posterior: None,
            uncertainty: None,
            measured: MeasurementConditions::default(),
            drift: Drift::default(),
            source: None,
            provenance: Provenance::default(),
            warnings: Vec::new(),
        }
    }

    /// Replaces the table; the masses of a usual arm follow from it.
    pub fn set_rows(&mut self, rows: [DhRow; AXES]) {
        if self.geometry.load.is_assumed {
            let ArmLoad { masses, .. } = ArmLoad::usual(&rows);
            self.geometry.load.masses = masses;
        }
        self.geometry.rows = rows;
    }

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

    /// A built-in robot by its name, with a tool ball (flange frame, mm).
    pub fn by_name_with_tool(name: &str, tool_mm: [f64; 3]) -> Option<Result<Self, Diagnostic>> {
        Self::by_name(name).map(|robot| robot.map(|robot| robot.with_tool(tool_mm)))
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

    /// The language of the controller: the one in the file, else the language of the maker that the first word of the name is.
    pub fn controller_language(&self) -> Option<&str> {
        let first = self.name.split([' ', '-', '_']).next().unwrap_or("");
        self.language.as_deref().or_else(|| Maker::of_word(first)?.language())
    }

    /// Sets the language of the controller, and the model that controllers of this language have.
    pub fn set_language(&mut self, language: Option<&str>) {
        self.language = language.map(str::to_owned);
        self.controller_model = ControllerModel::usual(self.controller_language());
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

    /// The uncertainty of the robot that its file states: with the errors of its joints, else the posterior of its
    /// identification, else its tolerance.
    pub fn known_uncertainty(&self) -> RobotUncertainty {
        let by_posterior = || {
            let posterior = self.posterior.as_ref().filter(|posterior| posterior.is_of(&self.geometry))?;
            let parameters = posterior.ids().to_vec();
            let root = posterior.root_of(&parameters);
            Some(self.rigid_uncertainty(parameters, &root))
        };
        let by_tolerance = || {
            let parallel = self.parallel_joints();
            let parameters: Vec<ParamId> =
                all_parameters(&parallel, 0).into_iter().filter(|id| id.is_geometric()).collect();
            let angle_rad = self.tolerance.angle_deg.to_radians();
            let sd = |id: &ParamId| match id.prior() {
                PriorRule::LengthTolerance => self.tolerance.length_mm,
                PriorRule::AngleTolerance => angle_rad,
                PriorRule::FlangeLength => self.tolerance.flange_prior_mm(),
                PriorRule::FlangeAngle => self.tolerance.flange_prior_rad(),
                PriorRule::DeflectionOverTorque(_)
                | PriorRule::MassErrorOverTorque(_)
                | PriorRule::Certificate { .. }
                | PriorRule::Free(_) => 0.0,
            };
            let sd = DVector::from_iterator(parameters.len(), parameters.iter().map(sd));
            self.rigid_uncertainty(parameters, &DMatrix::from_diagonal(&sd))
        };
        self.uncertainty.as_deref().cloned().or_else(by_posterior).unwrap_or_else(by_tolerance)
    }

    /// Whether the uncertainty after an identification is known.
    pub fn has_posterior(&self) -> bool {
        self.uncertainty.is_some() || self.posterior.as_ref().is_some_and(|known| known.is_of(&self.geometry))
    }

    /// The uncertainty with this root of the parameters' covariance; the coefficients of the joint errors are exact.
    fn rigid_uncertainty(&self, parameters: Vec<ParamId>, known: &DMatrix<f64>) -> RobotUncertainty {
        let rows = known.nrows() + self.geometry.joint_errors.count();
        RobotUncertainty {
            pose_mm: self.repeatability_sd_mm().unwrap_or(0.0),
            ..RobotUncertainty::of_root(parameters, known.clone().resize_vertically(rows, 0.0))
        }
    }

    /// The finding if the repeatability is unknown.
    pub fn asked_repeatability(&self) -> Option<RobotFinding> {
        let robot = self.name.clone();
        self.repeatability_mm.is_none().then_some(RobotFinding::NoRepeatability { robot })
    }

    /// The finding if a nominal robot differs from the built-in robot with its name.
    fn unlike_built_in(&self) -> Option<RobotFinding> {
        /// Rounding of published tables, mm and degrees.
        const ALIKE: f64 = 1.0;
        /// Only an axis that is parallel to the one before has a beta, degrees.
        const NO_BETA: f64 = 1e-6;
        if self.nominal.is_some() || self.controller_model == ControllerModel::Calibrated {
            return None;
        }
        let all = BUILT_IN.iter().filter_map(|(name, text)| Self::from_toml(name, text).ok());
        let built_in = all.into_iter().find(|robot| robot.name == self.name)?;
        let parallel = built_in.parallel_joints();
        Joint::ALL.into_iter().zip(1..).find_map(|(joint, number)| {
            let [row, known] = [self, &built_in].map(|robot| robot.geometry.row(joint));
            let deg = f64::to_degrees;
            let beta_alike = if parallel.contains(&joint) { ALIKE } else { NO_BETA };
            let values = [
                ("alpha_deg", deg(row.alpha), deg(known.alpha), ALIKE),
                ("a_mm", row.a, known.a, ALIKE),
                ("theta_offset_deg", deg(row.theta), deg(known.theta), ALIKE),
                ("d_mm", row.d, known.d, ALIKE),
                ("sign", row.sign, known.sign, ALIKE),
                ("beta_deg", deg(row.beta), deg(known.beta), beta_alike),
            ];
            let (key, value, built_in, _) =
                values.into_iter().find(|(_, value, known, alike)| (value - known).abs() > *alike)?;
            Some(RobotFinding::UnlikeBuiltIn {
                robot: self.name.clone(),
                joint: number,
                key,
                value,
                built_in,
            })
        })
    }

    /// Replaces the tool ball (flange frame, mm); the posterior of the old tool ball is dropped.
    pub fn set_tool(&mut self, tool_mm: [f64; 3]) {
        self.geometry.tool = tool_mm.into();
        self.has_tool = true;
        self.posterior =
            self.posterior.take().and_then(|known| known.keeping(|id| !matches!(id, ParamId::Tool(_))));
    }

    /// The finding if the identification of the robot had warnings.
    pub fn calibration_warnings(&self) -> Option<ProvenanceFinding> {
        let warnings = Names::of(&self.warnings);
        (!self.warnings.is_empty())
            .then(|| ProvenanceFinding::RobotWithWarnings { robot: self.name.clone(), warnings })
    }

    /// The same robot with another tool, whose place on the flange is known exactly (flange frame, mm): what the flange and the tool
    /// ball have in common is uncertain by the flange.
    pub fn with_exact_tool(mut self, tool_mm: [f64; 3]) -> Self {
        self.uncertainty = Some(Box::new(self.known_uncertainty().at_exact_tool(&self.tolerance)));
        self.geometry.tool = tool_mm.into();
        self.has_tool = true;
        self
    }

    /// The same robot with a tool ball (flange frame, mm).
    #[must_use]
    pub fn with_tool(mut self, tool_mm: [f64; 3]) -> Self {
        self.set_tool(tool_mm);
        self
    }

    /// Refuses a robot whose tool ball nobody has stated: programs and lengths are about the ball.
    pub fn check_tool(&self) -> Result<(), RobotFinding> {
        if self.has_tool { Ok(()) } else { Err(RobotFinding::NoToolBall { robot: self.name.clone() }) }
    }

    /// The robot as its controller knows it: of an identified robot, the nominal one.
    pub fn controller(&self) -> &Robot {
        self.nominal.as_deref().unwrap_or(self)
    }

    /// The joints whose axis is nominally parallel to the one before, which need Hayati's beta.
    pub fn parallel_joints(&self) -> Vec<Joint> {
        let after_first = Joint::ALL.into_iter().skip(1);
        after_first.filter(|joint| self.geometry.row(*joint).alpha.sin().abs() < PARALLEL).collect()
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

    /// An upper bound of the distance from the shoulder to the tool ball, mm: all that is between them, stretched.
    pub fn ball_reach_mm(&self) -> f64 {
        let links = self.geometry.rows.iter().skip(1).map(|row| row.a.hypot(row.d));
        links.sum::<f64>() + self.geometry.tool.norm()
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

#[cfg(test)]
mod tests {
    use super::*;

    fn robot(name: &str) -> Robot {
        Robot::by_name(name).unwrap().unwrap()
    }

    /// ISO 9283: mean distance 2 sqrt(2 / pi) s plus three standard deviations sqrt(3 - 8 / pi) s of the distance.
    #[test]
    fn repeatability_is_mean_plus_three_standard_deviations_of_the_distance() {
        use std::f64::consts::PI;
        let factor = 2.0 * (2.0 / PI).sqrt() + 3.0 * (3.0 - 8.0 / PI).sqrt();
        assert!((REPEATABILITY - factor).abs() < 1e-3);
        let sd = robot("kr60ha").repeatability_sd_mm().unwrap();
        assert!((sd * factor - 0.05).abs() < 1e-4 * 0.05);
    }

    /// From the table of the file: a2 = 850, hypot(a3, d4) = hypot(145, 820), a1 = 350 before.
    #[test]
    fn reach_accelerations_and_parallel_joints_follow_the_table() {
        let robot = robot("kr60ha");
        assert!((robot.reach_mm() - (350.0 + 850.0 + 145f64.hypot(820.0))).abs() < 1e-9);
        let with_tool = robot.clone().with_tool([30.0, 40.0, 0.0]);
        assert!((with_tool.ball_reach_mm() - (robot.reach_mm() + 170.0 + 50.0)).abs() < 1e-9);
        assert_eq!(robot.acceleration_deg_s2()[1], 102.0 / 0.4);
        assert_eq!(robot.parallel_joints(), [Joint::J3]);
        assert_eq!(super::tests::robot("ur10e").parallel_joints(), [Joint::J3, Joint::J4]);
    }

    #[test]
    fn margins_of_the_limits_are_those_of_the_nearest_axis() {
        let robot = robot("kr60ha");
        let mut axes = [0.0, -50.0, 20.0, 0.0, 0.0, 0.0].map(f64::to_radians);
        // Axis 2 is 85 degrees from both of its limits of -135 and 35.
        assert!((robot.limit_margin_deg(&axes) - 85.0).abs() < 1e-9);
        axes[4] = 120f64.to_radians();
        assert!((robot.limit_margin_deg(&axes) + 1.0).abs() < 1e-9 && !robot.is_within_limits(&axes));
        axes[4] = -110f64.to_radians();
        assert!((robot.limit_margin_deg(&axes) - 9.0).abs() < 1e-9 && robot.is_within_limits(&axes));
    }

    #[test]
    fn limits_of_a_coupled_joint_move_with_its_second_axis() {
        let mut robot = robot("kr60ha");
        let by = Some(super::super::CoupledAxis { axis: Joint::J2, factor: 1.0 });
        robot.geometry.coupling = super::super::Coupling::new([None, None, by, None, None, None]);
        robot.coupled_limits_deg[2] = Some([-60.0, 90.0]);
        let mut axes_deg = [0.0; AXES];
        axes_deg[1] = -100.0;
        // A3 + A2 from -60 to 90 leaves 40 to 190, the axis itself -120 to 158.
        assert_eq!(robot.limits_at_deg(&axes_deg)[2], [40.0, 158.0]);
        assert_eq!(robot.limits_at_deg(&[0.0; AXES])[2], [-60.0, 90.0]);
        assert_eq!(robot.joint_range_deg(Joint::J3), [-60.0, 90.0]);
        robot.coupled_limits_deg[2] = None;
        assert_eq!(robot.limits_at_deg(&axes_deg)[2], [-120.0, 158.0]);
        assert_eq!(robot.joint_range_deg(Joint::J3), [-120.0 - 135.0, 158.0 + 35.0]);
    }

    #[test]
    fn the_uncertainty_is_that_of_the_posterior_or_of_the_tolerance() {
        let mut robot = robot("kr60ha");
        robot.tolerance = Tolerance::of(0.5, 0.2);
        let nominal = robot.known_uncertainty();
        let sd = |id: ParamId| {
            let at = nominal.parameters.iter().position(|own| *own == id).unwrap();
            nominal.root.row(at).norm()
        };
        assert_eq!(nominal.parameters.len(), 25);
        assert_eq!((sd(ParamId::A(Joint::J2)), sd(ParamId::D(Joint::J6))), (0.5, 0.05));
        assert!((sd(ParamId::Beta(Joint::J3)) - 0.2f64.to_radians()).abs() < 1e-15);
        assert!((nominal.pose_mm * REPEATABILITY - 0.05).abs() < 1e-12);
        let ids = [ParamId::A(Joint::J2), ParamId::Theta(Joint::J3)];
        let root = DMatrix::from_row_slice(2, 2, &[0.3, 0.0, 1e-4, 2e-4]);
        robot.posterior = RobotPosterior::new(&ids, &robot.geometry, &root);
        robot.geometry.joint_errors.push(Joint::J1, 2);
        let known = robot.known_uncertainty();
        assert_eq!(known.parameters, ids);
        // Below the parameters are the coefficients of the joint errors, which are exact: 6 backlashes, 2 parts of a ripple.
        assert_eq!(known.root.shape(), (10, 2));
        let covariance = &known.root * known.root.transpose();
        assert!((covariance[(0, 1)] - 0.3e-4).abs() < 1e-18 && covariance[(9, 9)] == 0.0);
        // A value that was changed by hand is not that of the identification.
        robot.geometry.rows[1].a += 1.0;
        assert_eq!(robot.known_uncertainty().parameters.len(), 25);
    }

    #[test]
    fn a_new_tool_ball_drops_what_was_known_of_the_old_one() {
        let mut robot = robot("kr60ha");
        let ids = [ParamId::A(Joint::J2), ParamId::Tool(crate::robot::Coordinate::X)];
        let root = DMatrix::from_row_slice(2, 2, &[0.3, 0.0, 0.1, 0.2]);
        robot.posterior = RobotPosterior::new(&ids, &robot.geometry, &root);
        robot.set_tool([1.0, 2.0, 3.0]);
        assert_eq!(robot.posterior.as_ref().map(RobotPosterior::ids), Some(&ids[..1]));
        assert!((robot.posterior.unwrap().sd(ids[0]).unwrap() - 0.3).abs() < 1e-15);
        assert_eq!(robot.geometry.tool.z, 3.0);
    }

    #[test]
    fn the_language_is_that_of_the_maker() {
        for (name, language) in [
            ("kr60ha", "krl"),
            ("irb120", "rapid"),
            ("ur10e", "urscript"),
            ("m10id12", "fanuc"),
            ("gp25", "inform"),
        ] {
            assert_eq!(robot(name).controller_language(), Some(language));
        }
        let own = Robot { language: Some("krl".into()), ..robot("irb120") };
        assert_eq!(own.controller_language(), Some("krl"));
        assert!(own.unlike_built_in().is_none());
        let mut other = robot("irb120");
        other.geometry.rows[2].a += 1.5;
        assert!(matches!(
            other.unlike_built_in(),
            Some(RobotFinding::UnlikeBuiltIn { joint: 3, key: "a_mm", .. })
        ));
        // Axis 3 is parallel to axis 2, and axis 4 is not parallel to axis 3.
        let with_beta = |row: usize| {
            let mut other = robot("irb120");
            other.geometry.rows[row].beta = 0.1_f64.to_radians();
            other.unlike_built_in()
        };
        assert!(with_beta(2).is_none());
        assert!(matches!(with_beta(3), Some(RobotFinding::UnlikeBuiltIn { joint: 4, key: "beta_deg", .. })));
    }
}
