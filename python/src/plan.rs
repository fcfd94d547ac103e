//! `plan` and `Plan`.

use std::path::PathBuf;

use dbbd_job::file_set::EarlierFiles;
use dbbd_job::plan::{Plan, PlanRow};
use dbbd_job::recording::run::read_plan;
use dbbd_job::request::plan::{PlanRequest, PlannedPoses, UnwrittenPlan};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::measurement::PoseKind;
use dbbd_model::robot::AXES;
use numpy::PyArrayDyn;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{Floats, array};
use crate::error::{Failure, to_python};
use crate::lengths::BallPlaces;
use crate::robot::PyRobot;

/// A plan: poses, checks, predictions.
#[pyclass(name = "Plan", module = "dbbd", frozen)]
pub(crate) struct PyPlan {
    made: UnwrittenPlan,
    findings: Vec<Diagnostic>,
}

impl PyPlan {
    pub(crate) fn of(plan: Plan) -> Result<Self, Failure> {
        Ok(Self { made: UnwrittenPlan::from(plan), findings: Vec::new() })
    }

    fn dwells(&self) -> impl Iterator<Item = &PlanRow> {
        self.made.plan.rows.iter().filter(|row| row.kind != PoseKind::Transit && row.dwell_s > 0.0)
    }
}

#[pymethods]
impl PyPlan {
    /// Reads `plan.csv` at `path` with the `plan.json` beside it.
    #[staticmethod]
    fn read(path: PathBuf) -> Result<Self, Failure> {
        Self::of(read_plan(&path)?)
    }

    /// Axis angles of the poses that are measured, degrees, N x 6, in the order of the plan.
    #[getter]
    fn axes_deg<'py>(&self, py: Python<'py>) -> PyResult<Floats<'py>> {
        let flat: Vec<f64> = self.dwells().flat_map(|row| row.axes_deg).collect();
        let count = flat.len() / AXES;
        array(py, flat, &[count, AXES])
    }

    /// Number of the base ball of each of these poses, from 1.
    #[getter]
    fn ball<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<i64>>> {
        let balls: Vec<i64> = self.dwells().map(|row| i64::from(row.centre.number())).collect();
        let count = balls.len();
        array(py, balls, &[count])
    }

    /// Places of the base balls, mm, K x 3.
    #[getter]
    fn balls_mm<'py>(&self, py: Python<'py>) -> PyResult<Floats<'py>> {
        BallPlaces(&self.made.plan.header.job.balls()).array(py)
    }

    /// All rows, a list each: `index`, `circle`, `ball`, `kind`, `xyz_mm`, `abc_deg`, `axes_deg`, `length_mm`, `dwell_s`.
    fn rows<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (rows, columns) = (&self.made.plan.rows, PyDict::new(py));
        columns.set_item("index", rows.iter().map(|row| row.index).collect::<Vec<_>>())?;
        columns.set_item("circle", rows.iter().map(|row| row.circle).collect::<Vec<_>>())?;
        columns.set_item("ball", rows.iter().map(|row| row.centre.number()).collect::<Vec<_>>())?;
        columns.set_item("kind", to_python(py, &rows.iter().map(|row| row.kind).collect::<Vec<_>>())?)?;
        let triples = |of: fn(&PlanRow) -> [f64; 3]| rows.iter().map(of).collect::<Vec<_>>();
        columns.set_item("xyz_mm", triples(|row| row.xyz_mm))?;
        columns.set_item("abc_deg", triples(|row| row.abc_deg))?;
        columns.set_item("axes_deg", rows.iter().map(|row| row.axes_deg).collect::<Vec<_>>())?;
        columns.set_item("length_mm", rows.iter().map(|row| row.length_mm).collect::<Vec<_>>())?;
        columns.set_item("dwell_s", rows.iter().map(|row| row.dwell_s).collect::<Vec<_>>())?;
        Ok(columns)
    }

    /// `plan.json`: job, checks, notes, predictions.
    fn header(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        to_python(py, &self.made.plan.header)
    }

    /// What was found of the job, its robot and the lengths beside the robot, a dictionary each; empty of a plan that was read.
    /// The notes of the plan itself are in `header()`.
    #[getter]
    fn findings(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        to_python(py, &self.findings)
    }

    /// Writes `plan.csv`, `plan.json`, `centres.csv` and, of a plan made now, `plan.html` into a directory.
    fn write(&self, directory: PathBuf) -> Result<(), Failure> {
        self.made.write(&directory, EarlierFiles::Keep)?;
        Ok(())
    }

    fn __repr__(&self) -> String {
        format!("<dbbd.Plan {}: {} poses>", self.made.plan.header.hash, self.dwells().count())
    }
}

/// Plans the job at `job` (a TOML file) for its robot or another one, as the command does, and checks every pose and the path
/// between. A robot that was read from a file has its `lengths.csv` beside it; one in memory has none.
#[pyfunction]
#[pyo3(signature = (job, *, robot=None))]
pub(crate) fn plan(py: Python<'_>, job: PathBuf, robot: Option<&PyRobot>) -> Result<PyPlan, Failure> {
    let request = PlanRequest {
        job,
        out: PathBuf::new(),
        robot: robot.and_then(|robot| robot.file.as_ref()).map(|file| file.display().to_string().into()),
        measured: Vec::new(),
        poses: PlannedPoses::Job,
        replace: false,
    };
    let given = robot.map(|robot| robot.read.clone());
    py.detach(|| {
        let (made, findings) = request.unwritten(given, &())?;
        Ok(PyPlan { made, findings })
    })
}
