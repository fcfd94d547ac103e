//! `plan` and `Plan`.

use std::path::PathBuf;

use dbbd_job::files;
use dbbd_job::plan::{Job, Plan, PlanRow, PlanningPrior};
use dbbd_job::recording::run::read_plan;
use dbbd_job::report;
use dbbd_job::robot_files::named_robot;
use dbbd_model::measurement::{BaseBall, PoseKind};
use dbbd_model::robot::{AXES, LoadedRobot};
use numpy::PyArrayDyn;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{Floats, array};
use crate::error::{Failure, failed, to_python};
use crate::lengths::BallPlaces;
use crate::robot::PyRobot;

/// A plan: poses, checks, predictions.
#[pyclass(name = "Plan", module = "dbbd", frozen)]
pub(crate) struct PyPlan {
    plan: Plan,
    /// `plan.html`, of a plan that was made now.
    page: Option<String>,
}

impl PyPlan {
    pub(crate) fn of(plan: Plan) -> Result<Self, Failure> {
        Ok(Self { plan, page: None })
    }

    fn dwells(&self) -> impl Iterator<Item = &PlanRow> {
        self.plan.rows.iter().filter(|row| row.kind != PoseKind::Transit && row.dwell_s > 0.0)
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
        let balls: Vec<i64> = self.dwells().map(|row| i64::from(row.centre)).collect();
        let count = balls.len();
        array(py, balls, &[count])
    }

    /// Places of the base balls, mm, K x 3.
    #[getter]
    fn balls_mm<'py>(&self, py: Python<'py>) -> PyResult<Floats<'py>> {
        BallPlaces(&self.plan.header.job.balls()).array(py)
    }

    /// All rows, a list each: `index`, `circle`, `ball`, `kind`, `xyz_mm`, `abc_deg`, `axes_deg`, `length_mm`, `dwell_s`.
    fn rows<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (rows, columns) = (&self.plan.rows, PyDict::new(py));
        columns.set_item("index", rows.iter().map(|row| row.index).collect::<Vec<_>>())?;
        columns.set_item("circle", rows.iter().map(|row| row.circle).collect::<Vec<_>>())?;
        columns.set_item("ball", rows.iter().map(|row| row.centre).collect::<Vec<_>>())?;
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
        to_python(py, &self.plan.header)
    }

    /// Writes `plan.csv`, `plan.json`, `centres.csv` and, of a plan made now, `plan.html` into a directory.
    fn write(&self, directory: PathBuf) -> Result<(), Failure> {
        let (csv, json) = self.plan.to_files().map_err(failed)?;
        let _writing = files::exclusive(&directory)?;
        let file = |name: &str| -> PathBuf { directory.join(name) };
        files::write_file(&file("plan.csv"), csv)?;
        files::write_file(&file("plan.json"), json)?;
        if let Some(page) = &self.page {
            files::write_file(&file("plan.html"), page)?;
        }
        Ok(files::write_file(&file("centres.csv"), BaseBall::to_csv(&self.plan.header.job.balls()))?)
    }

    fn __repr__(&self) -> String {
        format!("<dbbd.Plan {}: {} poses>", self.plan.header.hash, self.dwells().count())
    }
}

/// Plans the job at `job` (a TOML file) for its robot or another one, and checks every pose and the path between.
#[pyfunction]
#[pyo3(signature = (job, *, robot=None))]
pub(crate) fn plan(py: Python<'_>, job: PathBuf, robot: Option<&PyRobot>) -> Result<PyPlan, Failure> {
    py.detach(|| {
        let name = job.display().to_string();
        let read = Job::from_toml(&name, &files::read_text(&job)?)?;
        let own;
        let LoadedRobot { robot, source, .. } = match robot {
            Some(robot) => &robot.read,
            None => {
                own = named_robot(&read.robot)?;
                &own
            }
        };
        read.check_against(robot.controller()).map_err(failed)?;
        let prior = PlanningPrior::datasheet(&read, robot);
        let mut plan = Plan::build_with(&read, robot, &prior)
            .map_err(|refusal| dbbd_model::diagnostic::Diagnostic::from(refusal).in_file(&name))?;
        plan.header.provenance = dbbd_job::artefact::made_from([&read.traced(&job)?, source]);
        let map = plan.predict(robot, &prior);
        let page = report::plan::html(&plan, robot, &map)?;
        Ok(PyPlan { plan, page: Some(page) })
    })
}
