//! `Robot`: positions, axis angles, derivatives, URDF.

use std::path::{Path, PathBuf};

use dbbd_job::files;
use dbbd_job::report::export::{urdf, urdf_patch};
use dbbd_job::robot_files::RobotName;
use dbbd_job::sim::truth;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::math::map_pieces;
use dbbd_model::robot::inverse::{branches, nearest};
use dbbd_model::robot::{AXES, Geometry, LoadedRobot, Pose, Robot};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arrays::{Floats, Numbers, Rows, array, matrix, poses};
use crate::error::{Failure, Outcome, failed, to_python, warn};

/// The unit of the axis angles of a call.
#[derive(Clone, Copy)]
enum Angle {
    Degree,
    Radian,
}

impl Angle {
    fn to_rad(self, axes: &[f64; AXES]) -> [f64; AXES] {
        match self {
            Self::Degree => axes.map(f64::to_radians),
            Self::Radian => *axes,
        }
    }

    fn of_rad(self, axes: [f64; AXES]) -> [f64; AXES] {
        match self {
            Self::Degree => axes.map(f64::to_degrees),
            Self::Radian => axes,
        }
    }
}

/// A robot: its geometry, limits and tolerance, and what its identification left unknown.
#[pyclass(name = "Robot", module = "dbbd", frozen)]
pub(crate) struct PyRobot {
    pub(crate) read: LoadedRobot,
    /// The file that it was read from.
    pub(crate) file: Option<PathBuf>,
}

impl PyRobot {
    pub(crate) fn robot(&self) -> &Robot {
        &self.read.robot
    }

    /// Of a robot that is in no file.
    pub(crate) fn of(robot: Robot) -> Outcome<Self> {
        let source = robot.traced(&robot.to_toml().map_err(failed)?);
        Ok(Self { read: LoadedRobot { robot, source, findings: Vec::new() }, file: None })
    }

    fn fk<'py>(&self, py: Python<'py>, q: &Numbers<'py>, frame: &str, unit: Angle) -> PyResult<Floats<'py>> {
        let place = match frame {
            "ball" => Geometry::ball,
            "flange" => Geometry::flange,
            _ => return Err(PyValueError::new_err("frame is 'ball' or 'flange'")),
        };
        let (q, geometry) = (Rows::<AXES>::of(q, "q")?, &self.robot().geometry);
        let numbers = py.detach(|| pieces(&q.rows, |axes| matrix(&place(geometry, &unit.to_rad(axes)))));
        array(py, numbers, &q.shape(&[4, 4]))
    }

    fn ik<'py>(
        &self,
        py: Python<'py>,
        pose: &Numbers<'py>,
        near: Option<&Numbers<'py>>,
        unit: Angle,
    ) -> Outcome<Floats<'py>> {
        let (poses, single) = poses(pose, "pose")?;
        let geometry = &self.robot().geometry;
        let Some(near) = near else {
            let [pose] = poses.as_slice() else {
                return Err(PyValueError::new_err("several poses need near").into());
            };
            let found = py.detach(|| branches(geometry, pose)).map_err(failed)?;
            let (count, flat) = (found.len(), found.into_iter().flat_map(|axes| unit.of_rad(axes)).collect());
            return Ok(array(py, flat, &[count, AXES])?);
        };
        let near = Rows::<AXES>::of(near, "near")?;
        if !near.single && near.rows.len() != poses.len() {
            return Err(PyValueError::new_err("near must have a row, or as many as there are poses").into());
        }
        let pairs: Vec<(&Pose, [f64; AXES])> = poses
            .iter()
            .zip(near.rows.iter().cycle())
            .map(|(pose, near)| (pose, unit.to_rad(near)))
            .collect();
        if let ([(pose, near)], true) = (pairs.as_slice(), single) {
            let axes = nearest(geometry, pose, near).map_err(failed)?;
            return Ok(array(py, unit.of_rad(axes).to_vec(), &[AXES])?);
        }
        let numbers = py.detach(|| {
            pieces(&pairs, |(pose, near)| {
                nearest(geometry, pose, near).map_or([f64::NAN; AXES], |axes| unit.of_rad(axes))
            })
        });
        Ok(array(py, numbers, &[poses.len(), AXES])?)
    }

    fn jacobian<'py>(&self, py: Python<'py>, q: &Numbers<'py>, unit: Angle) -> PyResult<Floats<'py>> {
        let (q, geometry) = (Rows::<AXES>::of(q, "q")?, &self.robot().geometry);
        // By a degree the ball moves, and the flange turns, by so much of what it does by a radian.
        let per = match unit {
            Angle::Degree => 1f64.to_radians(),
            Angle::Radian => 1.0,
        };
        let numbers = py.detach(|| {
            pieces(&q.rows, |axes| {
                let columns = geometry.axis_jacobian(&unit.to_rad(axes));
                std::array::from_fn::<f64, 36, _>(|at| {
                    let ((moved, turned), row) = (columns[at % AXES], at / AXES);
                    if row < 3 { moved[row] * per } else { turned[row - 3] }
                })
            })
        });
        array(py, numbers, &q.shape(&[AXES, AXES]))
    }
}

/// What `work` makes of each item, one after the other, on all cores.
fn pieces<T: Sync, const W: usize>(items: &[T], work: impl Fn(&T) -> [f64; W] + Sync) -> Vec<f64> {
    map_pieces(items, |_, piece| piece.iter().flat_map(&work).collect::<Vec<f64>>()).concat()
}

#[pymethods]
impl PyRobot {
    /// A robot by built-in name (`built_in` lists them), by its TOML file, or by the directory of a result. What is wrong in
    /// the file, or was in its identification, is a DbbdWarning.
    /// `tool_mm` states the tool ball in the frame of the flange: a built-in robot has none.
    #[staticmethod]
    #[pyo3(signature = (name_or_path, *, tool_mm=None))]
    fn load(py: Python<'_>, name_or_path: PathBuf, tool_mm: Option<[f64; 3]>) -> Result<Self, Failure> {
        let name = RobotName::from(&*name_or_path.to_string_lossy());
        let mut read = name.read()?;
        if let Some(tool_mm) = tool_mm {
            read.robot.set_tool(tool_mm);
        }
        let warnings = read.robot.calibration_warnings().map(|warnings| Diagnostic::file(&*name, warnings));
        read.findings.iter().chain(&warnings).try_for_each(|finding| warn(py, finding))?;
        Ok(Self { read, file: name.file().map(Path::to_owned) })
    }

    /// Names of the robots that are built in.
    #[staticmethod]
    fn built_in() -> Vec<&'static str> {
        Robot::built_in().iter().map(|(name, _)| *name).collect()
    }

    /// Its name.
    #[getter]
    fn name(&self) -> &str {
        &self.robot().name
    }

    /// Lowest and highest angle of each axis, degrees, 6 x 2.
    #[getter]
    fn limits_deg<'py>(&self, py: Python<'py>) -> PyResult<Floats<'py>> {
        array(py, self.robot().controller().limits_deg.concat(), &[AXES, 2])
    }

    /// Tool ball in the flange frame, mm.
    #[getter]
    fn tool_mm<'py>(&self, py: Python<'py>) -> PyResult<Floats<'py>> {
        array(py, self.robot().geometry.tool.as_slice().to_vec(), &[3])
    }

    /// Whether it was identified: its file holds the nominal robot as well.
    #[getter]
    fn identified(&self) -> bool {
        self.robot().nominal.is_some()
    }

    /// The robot as its controller knows it.
    fn nominal(&self) -> Result<Self, Failure> {
        Self::of(self.robot().controller().clone())
    }

    /// The same robot with another tool ball (flange frame, mm).
    fn with_tool(&self, tool_mm: [f64; 3]) -> Result<Self, Failure> {
        let mut robot = self.robot().clone();
        robot.set_tool(tool_mm);
        Self::of(robot)
    }

    /// A true robot drawn from `scale` times the tolerance of this one; the same seed gives the same robot.
    #[pyo3(signature = (seed, scale=1.0))]
    fn drawn(&self, seed: u64, scale: f64) -> Result<Self, Failure> {
        Self::of(truth::draw_true_robot(self.robot(), seed, scale))
    }

    /// Poses at axis angles (degrees, N x 6 or 6): homogeneous matrices in the robot base, mm, N x 4 x 4 or 4 x 4. `frame` is
    /// 'ball', the tool ball with the flange's orientation, or 'flange'.
    #[pyo3(signature = (q, *, frame="ball"))]
    fn fk_deg<'py>(&self, py: Python<'py>, q: Numbers<'py>, frame: &str) -> PyResult<Floats<'py>> {
        self.fk(py, &q, frame, Angle::Degree)
    }

    /// As `fk_deg`, at axis angles in radians.
    #[pyo3(signature = (q, *, frame="ball"))]
    fn fk_rad<'py>(&self, py: Python<'py>, q: Numbers<'py>, frame: &str) -> PyResult<Floats<'py>> {
        self.fk(py, &q, frame, Angle::Radian)
    }

    /// Axis angles (degrees) that put the tool ball at a pose (homogeneous matrix, mm, as `fk_deg` gives it).
    ///
    /// Without `near` every branch of one pose, K x 6. With `near` (6 or N x 6) the nearest for each pose, turns included:
    /// 6 of one pose, which raises where it is out of reach, or N x 6 of N, NaN where one is.
    #[pyo3(signature = (pose, near=None))]
    fn ik_deg<'py>(
        &self,
        py: Python<'py>,
        pose: Numbers<'py>,
        near: Option<Numbers<'py>>,
    ) -> Result<Floats<'py>, Failure> {
        self.ik(py, &pose, near.as_ref(), Angle::Degree)
    }

    /// As `ik_deg`, with axis angles in radians.
    #[pyo3(signature = (pose, near=None))]
    fn ik_rad<'py>(
        &self,
        py: Python<'py>,
        pose: Numbers<'py>,
        near: Option<Numbers<'py>>,
    ) -> Result<Floats<'py>, Failure> {
        self.ik(py, &pose, near.as_ref(), Angle::Radian)
    }

    /// Derivatives of the tool ball by the axis angles, N x 6 x 6 or 6 x 6, in the robot base: rows 1 to 3 its place (mm per
    /// degree), 4 to 6 the rotation (degrees per degree).
    fn jacobian_deg<'py>(&self, py: Python<'py>, q: Numbers<'py>) -> PyResult<Floats<'py>> {
        self.jacobian(py, &q, Angle::Degree)
    }

    /// As `jacobian_deg`, at axis angles in radians, by radians.
    fn jacobian_rad<'py>(&self, py: Python<'py>, q: Numbers<'py>) -> PyResult<Floats<'py>> {
        self.jacobian(py, &q, Angle::Radian)
    }

    /// Writes the robot as a TOML file, in full precision.
    fn save(&self, path: PathBuf) -> Result<(), Failure> {
        Ok(files::write_file(&path, self.robot().to_toml().map_err(failed)?)?)
    }

    /// Writes the robot as a URDF (m, rad); a joint variable is the controller's axis angle.
    fn to_urdf(&self, path: PathBuf) -> Result<(), Failure> {
        Ok(files::write_file(&path, urdf::urdf(self.robot()))?)
    }

    /// Your URDF with this robot's joints, as text, and what became of each joint; nothing else of it changes. `joints` names
    /// the six of the arm, base to flange, where the URDF has several chains.
    #[pyo3(signature = (users_urdf, *, joints=vec![]))]
    fn patch_urdf(
        &self,
        py: Python<'_>,
        users_urdf: PathBuf,
        joints: Vec<String>,
    ) -> Result<(String, Py<PyAny>), Failure> {
        let (name, text) = (users_urdf.display().to_string(), files::read_text(&users_urdf)?);
        let patched = urdf_patch::patch(&name, &text, self.robot(), &joints)?;
        let joints = to_python(py, &patched.joints)?;
        Ok((patched.text, joints))
    }

    fn __repr__(&self) -> String {
        format!("<dbbd.Robot {:?}>", self.robot().name)
    }
}
