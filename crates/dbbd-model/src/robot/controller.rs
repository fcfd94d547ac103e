//! The model of the arm with which a controller computes axis angles.

use serde::{Deserialize, Serialize};

use super::{AXES, DhRow, RobotFinding};
use crate::diagnostic::Diagnostic;
use crate::plausibility::Quantity;

/// The model of the arm in a controller. A controller turns a Cartesian target into axis angles with it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ControllerModel {
    /// The nominal table.
    Nominal,
    /// The controller's own table from the maker's calibration, which is the table of the robot.
    Calibrated,
    /// The controller has its own table, which is not known here: the axis angles at a Cartesian target are not known
    /// either.
    Unknown,
}

impl ControllerModel {
    /// Every controller of this language holds a factory calibration.
    const ALWAYS_CALIBRATED: &str = "urscript";

    /// The model of a robot whose file does not state it.
    pub(super) fn usual(language: Option<&str>) -> Self {
        if language == Some(Self::ALWAYS_CALIBRATED) { Self::Unknown } else { Self::Nominal }
    }
}

/// The `[controller]` table of a robot file.
#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ControllerTable {
    model: ControllerModel,
    /// The table of a calibrated controller.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    joint: Vec<ControllerJointTable>,
}

/// A row as in `[[joint]]`; the sense of the axis and its limits are those of `[[joint]]`.
#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ControllerJointTable {
    alpha_deg: f64,
    a_mm: f64,
    theta_offset_deg: f64,
    /// Nearly parallel axes have offsets of many metres that cancel each other.
    d_mm: f64,
    #[serde(default)]
    beta_deg: f64,
}

impl ControllerTable {
    /// The table for the file of a robot with this model and these rows.
    pub(super) fn of(model: ControllerModel, rows: &[DhRow; AXES]) -> Self {
        let joint = |row: &DhRow| ControllerJointTable {
            alpha_deg: row.alpha.to_degrees(),
            a_mm: row.a,
            theta_offset_deg: row.theta.to_degrees(),
            d_mm: row.d,
            beta_deg: row.beta.to_degrees(),
        };
        let joint = match model {
            ControllerModel::Calibrated => rows.iter().map(joint).collect(),
            ControllerModel::Nominal | ControllerModel::Unknown => Vec::new(),
        };
        Self { model, joint }
    }

    pub(super) fn model(&self) -> ControllerModel {
        self.model
    }

    /// The rows of a calibrated controller, with the senses of the nominal ones.
    ///
    /// # Errors
    /// Rows without a calibrated model or the reverse, or impossible numbers.
    pub(super) fn rows(&self, nominal: &[DhRow; AXES]) -> Result<Option<[DhRow; AXES]>, Diagnostic> {
        let needed = match self.model {
            ControllerModel::Calibrated => AXES,
            ControllerModel::Nominal | ControllerModel::Unknown => 0,
        };
        if self.joint.len() != needed {
            return Err(RobotFinding::ControllerRows { rows: self.joint.len(), needed }.into());
        }
        if needed == 0 {
            return Ok(None);
        }
        let mut rows = *nominal;
        for ((row, joint), number) in rows.iter_mut().zip(&self.joint).zip(1..) {
            let values = [
                ("alpha_deg", joint.alpha_deg, Quantity::AxisAngle),
                ("a_mm", joint.a_mm, Quantity::ArmLength),
                ("theta_offset_deg", joint.theta_offset_deg, Quantity::AxisAngle),
                ("d_mm", joint.d_mm, Quantity::CancelledOffset),
                ("beta_deg", joint.beta_deg, Quantity::ParallelAxisAngle),
            ];
            for (key, value, quantity) in values {
                quantity.check(format!("[[controller.joint]] {number}: {key}"), value)?;
            }
            *row = DhRow {
                alpha: joint.alpha_deg.to_radians(),
                a: joint.a_mm,
                theta: joint.theta_offset_deg.to_radians(),
                d: joint.d_mm,
                beta: joint.beta_deg.to_radians(),
                sign: row.sign,
            };
        }
        Ok(Some(rows))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Robot;

    fn with(name: &str, tables: &str) -> Result<Robot, Diagnostic> {
        let text = Robot::built_in_file(name).unwrap();
        // Top-level tables may follow the arrays of tables.
        Robot::from_toml("robot.toml", &format!("{text}\n{tables}"))
    }

    fn row(alpha_deg: f64, a_mm: f64, d_mm: f64) -> String {
        format!(
            "[[controller.joint]]\nalpha_deg = {alpha_deg:?}\na_mm = {a_mm:?}\ntheta_offset_deg = 0.0\nd_mm = {d_mm:?}\n"
        )
    }

    /// The nominal table of the UR10, with a twist that puts the offsets of the parallel axes a hundred metres away.
    fn calibrated() -> String {
        let rows = [
            row(0.0, 0.0, 127.3),
            row(90.0, 0.0, 100_000.0),
            row(0.01, -612.0, -100_000.0),
            row(0.0, -572.3, 163.941),
            row(90.0, 0.0, 115.7),
            row(-90.0, 0.0, 92.2),
        ];
        format!("[controller]\nmodel = \"calibrated\"\n{}", rows.concat())
    }

    #[test]
    fn the_usual_model_is_that_of_the_make() {
        for (name, model) in [
            ("kr60ha", ControllerModel::Nominal),
            ("irb120", ControllerModel::Nominal),
            ("ur10e", ControllerModel::Unknown),
        ] {
            let robot = Robot::by_name(name).unwrap().unwrap();
            assert_eq!(robot.controller_model, model, "{name}");
            assert!(!robot.to_toml().unwrap().contains("[controller]"), "{name}");
        }
        let nominal = with("ur10", "[controller]\nmodel = \"nominal\"").unwrap();
        assert_eq!(nominal.controller_model, ControllerModel::Nominal);
        assert_eq!(Robot::from_toml("again", &nominal.to_toml().unwrap()).unwrap(), nominal);
    }

    #[test]
    fn a_factory_table_is_the_table_of_the_robot_and_reads_back() {
        let robot = with("ur10", &calibrated()).unwrap();
        assert_eq!(robot.controller_model, ControllerModel::Calibrated);
        assert!(robot.geometry.rows.iter().all(|row| row.d.abs() < 1e3), "{:?}", robot.geometry.rows);
        // 100 m times 0.01 degrees.
        let nominal = Robot::by_name("ur10").unwrap().unwrap();
        let axes = [0.0; AXES];
        let shift = (robot.geometry.flange(&axes).position - nominal.geometry.flange(&axes).position).norm();
        assert!((shift - 17.45).abs() < 0.5, "{shift}");
        assert_reads_back(&robot);
    }

    /// Degrees of the file round the last digit.
    fn assert_reads_back(robot: &Robot) {
        let mut again = Robot::from_toml("again", &robot.to_toml().unwrap()).unwrap();
        let close = |a: &DhRow, b: &DhRow| {
            let off = [a.alpha - b.alpha, a.theta - b.theta, a.beta - b.beta, a.a - b.a, a.d - b.d];
            off.iter().all(|off| off.abs() < 1e-12)
        };
        assert!(again.geometry.rows.iter().zip(&robot.geometry.rows).all(|(a, b)| close(a, b)));
        again.geometry.rows = robot.geometry.rows;
        again.nominal = robot.nominal.clone();
        assert_eq!(again, *robot);
    }

    #[test]
    fn an_identified_robot_has_the_controller_of_its_nominal_one() {
        let nominal = with("ur10", &calibrated()).unwrap();
        let identified = Robot { nominal: Some(Box::new(nominal.clone())), ..nominal };
        let text = identified.to_toml().unwrap();
        assert_eq!(text.matches("[nominal.controller]").count(), 1);
        assert_reads_back(&identified);
        let wrong = Robot::from_toml("again", &format!("{text}\n[controller]\nmodel = \"nominal\""));
        assert_eq!(wrong.unwrap_err().code().as_str(), "E0505");
    }

    #[test]
    fn a_table_without_its_model_and_a_model_without_its_table_are_refused() {
        for wrong in
            ["[controller]\nmodel = \"calibrated\"".to_owned(), calibrated().replace("calibrated", "nominal")]
        {
            assert_eq!(with("ur10", &wrong).unwrap_err().code().as_str(), "E0505", "{wrong}");
        }
        let far = calibrated().replace("100000.0", "2000000.0");
        assert_eq!(with("ur10", &far).unwrap_err().code().as_str(), "E0130");
    }
}
