//! `check` and `Check`.

use dbbd_job::request::aged;
use dbbd_job::request::check::{CheckSigma, CheckedLengths};
use dbbd_job::request::identify::{known_lengths, stated_conditions};
use dbbd_model::conformity::expected::{BallMounting, Mounting};
use dbbd_model::conformity::{CheckInput, DecisionRule};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::Options;
use dbbd_model::measurement::{LengthModel, PreparedMeasurement};
use dbbd_model::plausibility::Quantity;
use pyo3::prelude::*;

use crate::arrays::{Numbers, Wholes};
use crate::error::{Failure, failed, to_python};
use crate::lengths::{Given, PayloadGiven, balls, checked, workspace};
use crate::robot::PyRobot;

/// The result of an interim check.
#[pyclass(name = "Check", module = "dbbd", frozen)]
pub(crate) struct PyCheck {
    found: CheckedLengths,
    findings: Vec<Diagnostic>,
}

#[pymethods]
impl PyCheck {
    /// `pass`, `fail` or `undecided`.
    #[getter]
    fn decision(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        to_python(py, &self.found.check.decision.decision)
    }

    /// What probably changed, likeliest first; empty where the test finds no change.
    #[getter]
    fn changes(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        to_python(py, &self.found.check.changes)
    }

    /// What was found, a dictionary each with code, severity, text and values.
    #[getter]
    fn findings(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        to_python(py, &self.findings)
    }

    /// As `check.json` has it, without the files that a check in memory was not made from.
    fn to_dict(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        to_python(py, &self.found)
    }

    /// The robot with what changed identified again, or None where nothing changed.
    #[getter]
    fn updated(&self) -> Result<Option<PyRobot>, Failure> {
        self.found.check.update().cloned().map(PyRobot::of).transpose()
    }

    fn __repr__(&self) -> String {
        let check = &self.found.check;
        format!("<dbbd.Check of {:?}: {:?}>", check.robot, check.decision.decision)
    }
}

/// Checks whether a calibrated robot is still what it was, from lengths (mm) at axis angles (degrees) to base balls.
///
/// `payload`, `force_n`, `t_s`, `measured` and `temperature_c` are those of `identify`. What is known of the robot fades from its
/// own day to the day `measured`. Lengths that identified a robot that was read from a file are no check of it.
#[pyfunction]
#[pyo3(signature = (
    axes_deg, lengths_mm, ball, *, robot, balls_mm, sigma_mm=None, bar=None, approach=None, index=None, payload=None,
    force_n=None, t_s=None, tolerance_mm=None, risk=Some(0.05), tool_repeat_mm=Mounting::SEAT_REPEAT_MM,
    ball_repeat_mm=None, bar_u_mm=None, workspace_deg=None, measured=None, temperature_c=None
))]
#[allow(clippy::too_many_arguments)] // keywords of a Python function
pub(crate) fn check<'py>(
    py: Python<'py>,
    axes_deg: Numbers<'py>,
    lengths_mm: Numbers<'py>,
    ball: Wholes<'py>,
    robot: &PyRobot,
    balls_mm: Numbers<'py>,
    sigma_mm: Option<Numbers<'py>>,
    bar: Option<Wholes<'py>>,
    approach: Option<Wholes<'py>>,
    index: Option<Wholes<'py>>,
    payload: Option<PayloadGiven>,
    force_n: Option<Numbers<'py>>,
    t_s: Option<Numbers<'py>>,
    tolerance_mm: Option<f64>,
    risk: Option<f64>,
    tool_repeat_mm: f64,
    ball_repeat_mm: Option<f64>,
    bar_u_mm: Option<f64>,
    workspace_deg: Option<Numbers<'py>>,
    measured: Option<String>,
    temperature_c: Option<f64>,
) -> Result<PyCheck, Failure> {
    use numpy::PyUntypedArrayMethods as _;
    for (key, value, quantity) in [
        ("tolerance_mm", tolerance_mm, Quantity::PositionTolerance),
        ("risk", risk, Quantity::DecisionRisk),
        ("bar_u_mm", bar_u_mm, Quantity::StandardLengthUncertainty),
    ] {
        value.map_or(Ok(()), |value| quantity.check(key, value)).map_err(failed)?;
    }
    let (all, each) = match &sigma_mm {
        Some(sigma) if sigma.shape().is_empty() => (sigma.as_array().iter().copied().next(), None),
        each => (None, each.as_ref()),
    };
    let given = Given {
        axes_deg: &axes_deg,
        lengths_mm: &lengths_mm,
        ball: &ball,
        sigma_mm: each,
        bar: bar.as_ref(),
        approach: approach.as_ref(),
        index: index.as_ref(),
        payload: payload.as_ref(),
        force_n: force_n.as_ref(),
        t_s: t_s.as_ref(),
    };
    let (lengths, mut findings) = given.measurements(robot.robot())?;
    let balls = balls(&balls_mm)?;
    findings.extend(checked(&lengths, robot.robot(), &balls)?);
    let of = &aged(robot.robot(), &mut stated_conditions(measured, temperature_c)?);
    let (file, name) = (robot.file.as_deref(), robot.file.as_ref().map(|file| file.to_string_lossy()));
    let noise = CheckSigma::of(all, &lengths, name.as_deref(), of)?;
    findings.extend(noise.finding.map(Diagnostic::from));
    let workspace = Options { workspace: workspace(py, workspace_deg.as_ref(), of)?, ..Options::default() };
    let start = LengthModel::new(of.geometry.clone(), &balls);
    let readings: Vec<PreparedMeasurement> = lengths.rows.iter().map(PreparedMeasurement::from).collect();
    py.detach(|| {
        let balls = ball_repeat_mm.map_or(BallMounting::Anywhere, BallMounting::About);
        let mounting = Mounting { tool_mm: tool_repeat_mm, balls, ..Mounting::again(of, bar_u_mm) };
        let input = CheckInput {
            robot: of,
            start: &start,
            readings: &readings,
            bars: lengths.bars(),
            sigma_mm: noise.sigma_mm,
            mounting,
            tolerance_mm,
            rule: risk.map_or(DecisionRule::SimpleAcceptance, |risk| DecisionRule::GuardBand { risk }),
            workspace: &workspace.workspace_poses(of),
        };
        let mut found = CheckedLengths::of(&input, &lengths).map_err(failed)?;
        findings.extend(found.findings().into_iter().map(Diagnostic::from));
        let no_check = found.of_known_lengths(known_lengths(file, &lengths)?);
        findings.extend(no_check.map(Diagnostic::from));
        Ok(PyCheck { found, findings })
    })
}
