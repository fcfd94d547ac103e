//! Writes an identified robot into files for another program or for its controller, and states the error that these
//! files leave.

use super::kuka::MachineDataProposal;
use super::ros_calibration::ros_calibration;
use super::{frames, joint_errors, mastering, urdf};
use crate::program::{Language, stamped};
use crate::report::ReportFinding;
use dbbd_model::base::InternalFinding;
use dbbd_model::base::serialised;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::{CalibrationResult, SimplifiedModelError};
use dbbd_model::provenance::Provenance;
use dbbd_model::robot::{DhRow, Geometry, Robot};
use serde::Serialize;

/// The program or controller that reads the files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HandBackTarget {
    /// A URDF, as ROS, MuJoCo, Drake and others read it.
    Urdf,
    /// A URDF; for a Universal Robots arm also the file of its ROS description.
    Ros,
    /// Machine data and mastering of a KUKA controller.
    Kuka,
    /// A controller that takes only the zeros of its axes; its language if dbbd writes this language.
    ZerosOnly(Option<Language>),
    /// The DH table, as RoboDK has it.
    RoboDk,
}

/// The files for a target: name and content.
pub struct HandBack {
    pub files: Vec<(&'static str, Vec<u8>)>,
    /// What each step of entering the files brings.
    pub steps: Vec<EnteredFiles>,
    /// The position errors of the model in the files, compared with the identified robot; `None` if the files contain
    /// everything.
    pub left_out: Option<SimplifiedModelError>,
}

/// The mean distance of the tool ball from the identified robot's over the workspace, aligned, mm, where only these files are entered.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EnteredFiles {
    pub files: Vec<&'static str>,
    /// Of the nominal robot.
    pub before_mm: f64,
    pub after_mm: f64,
}

impl EnteredFiles {
    fn of(files: &[&'static str], robot: &Robot, entered: &Geometry) -> Self {
        let nominal = Geometry { rows: robot.controller().geometry.rows, ..robot.geometry.rigid() };
        let [before_mm, after_mm] =
            [&nominal, entered].map(|geometry| SimplifiedModelError::by(robot, geometry).mean_mm);
        Self { files: files.to_vec(), before_mm, after_mm }
    }

    /// Whether the controller is no farther from the robot with these files than without.
    pub fn helps(&self) -> bool {
        self.after_mm <= self.before_mm
    }
}

/// The nominal robot with the zeros of the identified one, and its tool ball.
fn mastered(robot: &Robot) -> Geometry {
    let nominal = &robot.controller().geometry;
    let rows = std::array::from_fn(|at| DhRow { theta: robot.geometry.rows[at].theta, ..nominal.rows[at] });
    Geometry { rows, ..robot.geometry.rigid() }
}

impl HandBack {
    /// The files for a robot; its result is needed where the target takes zeros of axes. `provenance` names the sources
    /// of the files.
    ///
    /// # Errors
    /// The robot is not identified, its result is missing, or its make is not the make of the target.
    pub fn of(
        target: HandBackTarget,
        robot: &Robot,
        result: Option<&CalibrationResult>,
        provenance: &Provenance,
    ) -> Result<Self, Diagnostic> {
        let zeros = || -> Result<Vec<mastering::AxisOffset>, Diagnostic> {
            let result = result.filter(|_| robot.nominal.is_some()).ok_or(ReportFinding::NoResult)?;
            Ok(mastering::offsets(result, robot))
        };
        let with_errors = SimplifiedModelError::of(robot);
        let by = |geometry: &Geometry| Some(SimplifiedModelError::by(robot, geometry));
        let entered = |files: &[&'static str], geometry: &Geometry| EnteredFiles::of(files, robot, geometry);
        let (mut files, steps, left_out) = match target {
            HandBackTarget::Urdf | HandBackTarget::Ros => {
                let yaml = if target == HandBackTarget::Ros { ros_calibration(robot) } else { None };
                let yaml = yaml.map(|text| (ROS_CALIBRATION, text.into_bytes()));
                let files = [(URDF, urdf::urdf(robot).into_bytes())].into_iter().chain(yaml).collect();
                (files, vec![entered(&[URDF], &robot.geometry.rigid())], with_errors)
            }
            HandBackTarget::Kuka => {
                let (offsets, result) = (zeros()?, result.ok_or(ReportFinding::NoResult)?);
                let proposal = MachineDataProposal::of(robot).ok_or(ReportFinding::NotKuka)?;
                let frames = frames::data_list(&robot.name, &frames::frames(result), &offsets);
                let files = vec![
                    (MASTERING, mastering::csv(&offsets)?),
                    (MACHINE_DATA, proposal.text(&robot.name).into_bytes()),
                    (frames::FILE, stamped(Language::Krl, &frames, provenance)?.into_bytes()),
                ];
                let whole = proposal.geometry(robot);
                let steps = vec![
                    entered(&[MASTERING], &mastered(robot)),
                    entered(&[MASTERING, MACHINE_DATA], &whole),
                ];
                (files, steps, by(&whole))
            }
            HandBackTarget::ZerosOnly(language) => {
                let wanted = language.map(Language::name);
                if let Some(own) = robot.controller_language().filter(|own| Some(*own) != wanted) {
                    let (robot, language) = (robot.name.clone(), own.to_owned());
                    return Err(ReportFinding::OtherMake { robot, language }.into());
                }
                let mastered = mastered(robot);
                let steps = vec![entered(&[MASTERING], &mastered)];
                (vec![(MASTERING, mastering::csv(&zeros()?)?)], steps, by(&mastered))
            }
            HandBackTarget::RoboDk => {
                let rows = robot.geometry.rows.map(|row| DhRow { beta: 0.0, ..row });
                let table = Geometry { rows, ..robot.geometry.rigid() };
                (vec![(ROBODK, dh_table(robot)?)], vec![entered(&[ROBODK], &table)], by(&table))
            }
        };
        if with_errors.is_some() {
            files.push(("joint-errors.csv", joint_errors::csv(robot).into_bytes()));
        }
        // Of a robot that was not identified nothing is entered.
        let steps = if robot.nominal.is_some() { steps } else { Vec::new() };
        Ok(Self { files, steps, left_out: left_out.filter(|left_out| left_out.max_mm > SAME_MM) })
    }
}

/// The identified robot as a URDF.
const URDF: &str = "robot-identified.urdf";
/// The file that `ur_description` takes as `kinematics_params`.
const ROS_CALIBRATION: &str = "robot_calibration.yaml";
const MASTERING: &str = "mastering.csv";
const MACHINE_DATA: &str = "machine-data.txt";
const ROBODK: &str = "robodk.csv";
/// Largest error of rounding in a table that contains everything, mm.
const SAME_MM: f64 = 1e-6;

/// The table in modified DH. RoboDK has no beta: if a beta is not zero, the finding states the error without it.
fn dh_table(robot: &Robot) -> Result<Vec<u8>, InternalFinding> {
    let columns = ["joint", "alpha_deg", "a_mm", "theta_deg", "d_mm", "beta_deg", "sense"];
    let rows = robot.geometry.rows.iter().zip(1..).map(|(row, joint)| {
        let [alpha, theta, beta] = [row.alpha, row.theta, row.beta].map(f64::to_degrees);
        (joint, alpha, row.a, theta, row.d, beta, row.sign)
    });
    serialised::csv_table(columns, rows).map(Into::into)
}
