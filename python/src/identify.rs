//! `identify` and its `Result`.

use std::collections::BTreeMap;

use dbbd_job::request::aged;
use dbbd_job::request::identify::{
    AskedIdentification, RequestedPrior, ResultDocument, known_lengths, plausible_deviation,
    stated_conditions,
};
use dbbd_model::base::serialised;
use dbbd_model::conformity::UncertaintyBudget;
use dbbd_model::design::calibrate;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::{AngleSource, CompletedCalibration, ErrorModel, Input, Options, Positions};
use dbbd_model::measurement::{ApproachedPose, LengthModel};
use dbbd_model::plausibility::Quantity;
use dbbd_model::robot::RobotFinding;
use dbbd_model::robot::parameter::SetUpCounts;
use dbbd_model::robot::{AXES, AxisAngles, ParamId};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arrays::{Floats, Numbers, Rows, Wholes, approaches, array};
use crate::error::{Failure, Outcome, failed, to_python};
use crate::lengths::{Given, GivenPositions, PayloadGiven, balls, checked, workspace};
use crate::robot::PyRobot;

/// What is known of a robot beforehand, as a caller gives it.
#[derive(FromPyObject)]
pub(crate) enum PriorGiven {
    Name(String),
    Deviations(BTreeMap<String, f64>),
}

/// The result of an identification.
#[pyclass(name = "Result", module = "dbbd", frozen)]
pub(crate) struct PyResult_ {
    found: CompletedCalibration,
    budget: UncertaintyBudget,
}

impl PyResult_ {
    fn document(&self) -> ResultDocument<'_> {
        ResultDocument::without_files(&self.found, &self.budget)
    }
}

#[pymethods]
impl PyResult_ {
    /// Every parameter as in result.json: name, unit, start, nominal, identified, correction, sd, interval95, status, reason.
    #[getter]
    fn parameters(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        to_python(py, &self.found.result.parameters)
    }

    /// The parameters estimated, in the order of `covariance`.
    #[getter]
    fn names(&self) -> Vec<String> {
        self.found.posterior.ids().iter().map(ToString::to_string).collect()
    }

    /// Covariance of the parameters estimated (mm, rad).
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Floats<'py>> {
        let covariance = self.found.posterior.covariance();
        // It is symmetric: its columns are its rows.
        array(py, covariance.as_slice().to_vec(), &[covariance.nrows(), covariance.ncols()])
    }

    /// What was found, a dictionary each with code, severity, text and values.
    #[getter]
    fn findings(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        to_python(py, &self.found.diagnostics().collect::<Vec<_>>())
    }

    /// Whether the result has warnings.
    #[getter]
    fn has_warnings(&self) -> bool {
        self.found.result.has_warnings()
    }

    /// The identified robot, with the nominal one and what is not known of it.
    #[getter]
    fn robot(&self) -> std::result::Result<PyRobot, Failure> {
        PyRobot::of(self.found.robot.clone())
    }

    /// As `result.json` has it, without the files that a result in memory was not made from.
    fn to_json(&self) -> std::result::Result<String, Failure> {
        serialised::json(&self.document()).map_err(failed)
    }

    /// The same as a dictionary.
    fn to_dict(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        to_python(py, &self.document())
    }

    /// Where the tool ball is at axis angles (degrees, N x 6 or 6): its places in the robot base (mm) and their 3-D standard
    /// deviations (mm), after the best rigid alignment over the poses. `approach` (N x 6) is the sense of each axis's last
    /// move: 1 by rising angles, -1 by falling ones, 0 not known.
    #[pyo3(signature = (q, *, approach=None))]
    fn predict_deg<'py>(
        &self,
        py: Python<'py>,
        q: Numbers<'py>,
        approach: Option<Wholes<'py>>,
    ) -> PyResult<(Floats<'py>, Floats<'py>)> {
        let q = Rows::<AXES>::of(&q, "q")?;
        let poses = poses(&q, approach.as_ref())?;
        let (balls, sd) = py.detach(|| {
            let positions = Positions::of(&self.found.robot, &poses);
            let sd: Vec<f64> = (0..poses.len()).map(|at| positions.sd_mm(at)).collect();
            let balls = positions.balls.iter().flat_map(|ball| [ball.x, ball.y, ball.z]).collect();
            (balls, sd)
        });
        Ok((array(py, balls, &q.shape(&[3]))?, array(py, sd, &q.shape(&[]))?))
    }

    /// The covariances (mm^2, N x 3 x 3 or 3 x 3) of the places that `predict_deg` returns; each has the square of the standard deviation
    /// as its trace.
    #[pyo3(signature = (q, *, approach=None))]
    fn covariance_deg<'py>(
        &self,
        py: Python<'py>,
        q: Numbers<'py>,
        approach: Option<Wholes<'py>>,
    ) -> PyResult<Floats<'py>> {
        let q = Rows::<AXES>::of(&q, "q")?;
        let poses = poses(&q, approach.as_ref())?;
        let covariances = py.detach(|| {
            let positions = Positions::of(&self.found.robot, &poses);
            (0..poses.len())
                .flat_map(|at| positions.covariance(at).iter().copied().collect::<Vec<_>>())
                .collect()
        });
        array(py, covariances, &q.shape(&[3, 3]))
    }

    fn __repr__(&self) -> String {
        let (robot, made_from) = (&self.found.robot.name, self.found.result.made_from);
        format!("<dbbd.Result of {robot:?} from {made_from}>")
    }
}

/// Poses with the sense of each axis's last move.
fn poses(q: &Rows<AXES>, approach: Option<&Wholes<'_>>) -> PyResult<Vec<ApproachedPose>> {
    let senses = approaches(approach, q.rows.len())?;
    let pose = |(axes, approach): (&[f64; AXES], _)| ApproachedPose {
        axes: AxisAngles::from_degrees(*axes),
        approach,
    };
    Ok(q.rows.iter().zip(senses).map(pose).collect())
}

/// The prior that is given. Its standard deviations are checked as those of a table are.
fn prior(given: PriorGiven, set_up: SetUpCounts) -> Outcome<RequestedPrior<BTreeMap<ParamId, f64>>> {
    let given = match given {
        PriorGiven::Name(name) => match RequestedPrior::named(&name) {
            RequestedPrior::None => return Ok(RequestedPrior::None),
            RequestedPrior::Datasheet => return Ok(RequestedPrior::Datasheet),
            RequestedPrior::Posterior => return Ok(RequestedPrior::Posterior),
            RequestedPrior::Table(_) => {
                let why = "prior is 'none', 'datasheet', 'posterior' or a dictionary of standard deviations";
                return Err(PyValueError::new_err(why).into());
            }
        },
        PriorGiven::Deviations(given) => given,
    };
    let mut deviations = BTreeMap::new();
    for (name, sd) in given {
        let id: ParamId = name.parse().map_err(|why: RobotFinding| failed(why))?;
        set_up.check(id).map_err(failed)?;
        if !(sd > 0.0 && sd.is_finite()) {
            return Err(PyValueError::new_err(format!("prior of {name} must be positive")).into());
        }
        plausible_deviation(id, sd).map_err(failed)?;
        deviations.insert(id, sd);
    }
    Ok(RequestedPrior::Table(deviations))
}

fn error_model(name: &str) -> PyResult<ErrorModel> {
    match name {
        "joints" => Ok(ErrorModel::Joints),
        "geometric" => Ok(ErrorModel::Geometric),
        _ => Err(PyValueError::new_err("model is 'joints' or 'geometric'")),
    }
}

/// Identifies a robot's parameters from lengths, from positions, or from both, as the command `identify` does.
///
/// `axes_deg` (N x 6, the controller's axis angles), `lengths_mm` (N, between the ball centres), `ball` (N or one number, from
/// 1), `balls_mm` (K x 3, robot base). `sigma_mm` is a number for all lengths, the user's word, or an array, that of the data.
/// `estimate` and `hold` are lists as the command takes them ("alpha1-5,a1-5,d4-6"); `prior` is 'none', 'datasheet',
/// 'posterior' or a dictionary of standard deviations (mm, rad) by names.
///
/// As in a table of lengths: `payload` (names of payloads in the robot's file, one for all or N; '': the first), `force_n` (N, with
/// which the bar pulls) and `t_s` (s since the start; both N or one number, NaN: not known).
///
/// `measured` is the day of the measurement, 'YYYY-MM-DD' with or without a time, and `temperature_c` the robot's temperature
/// then. What is known of an identified robot fades until that day, without `measured` until today. The robot of the result has
/// this day; without `measured` a robot that was not identified before has none, and what is known of it never fades.
///
/// Positions: `positions_mm` (M x 3, in the frame of a tracker, whose place is estimated) at `positions_deg` (M x 6), of `target`
/// (M or one number, from 1: the tool ball), with `positions_sigma_mm` of each coordinate and `positions_approach`.
#[pyfunction]
#[pyo3(signature = (
    axes_deg=None, lengths_mm=None, ball=None, *, robot, balls_mm=None, positions_deg=None, positions_mm=None, target=None,
    positions_sigma_mm=None, positions_approach=None, sigma_mm=None, bar=None, approach=None, index=None, payload=None,
    force_n=None, t_s=None, tool_mm=None, estimate=None, hold=None, prior=None, model="joints", bar_u_mm=None, tolerance_mm=None, folds=None,
    monte_carlo=None, workspace_deg=None, measured=None, temperature_c=None
))]
#[allow(clippy::too_many_arguments)] // keywords of a Python function
pub(crate) fn identify<'py>(
    py: Python<'py>,
    axes_deg: Option<Numbers<'py>>,
    lengths_mm: Option<Numbers<'py>>,
    ball: Option<Wholes<'py>>,
    robot: &PyRobot,
    balls_mm: Option<Numbers<'py>>,
    positions_deg: Option<Numbers<'py>>,
    positions_mm: Option<Numbers<'py>>,
    target: Option<Wholes<'py>>,
    positions_sigma_mm: Option<Numbers<'py>>,
    positions_approach: Option<Wholes<'py>>,
    sigma_mm: Option<Numbers<'py>>,
    bar: Option<Wholes<'py>>,
    approach: Option<Wholes<'py>>,
    index: Option<Wholes<'py>>,
    payload: Option<PayloadGiven>,
    force_n: Option<Numbers<'py>>,
    t_s: Option<Numbers<'py>>,
    tool_mm: Option<[f64; 3]>,
    estimate: Option<&str>,
    hold: Option<&str>,
    prior: Option<PriorGiven>,
    model: &str,
    bar_u_mm: Option<f64>,
    tolerance_mm: Option<f64>,
    folds: Option<usize>,
    monte_carlo: Option<usize>,
    workspace_deg: Option<Numbers<'py>>,
    measured: Option<String>,
    temperature_c: Option<f64>,
) -> std::result::Result<PyResult_, Failure> {
    use numpy::PyUntypedArrayMethods as _;
    // One number for all is the user's word; an array is that of the data.
    let (all, each) = match &sigma_mm {
        Some(sigma) if sigma.shape().is_empty() => (sigma.as_array().iter().copied().next(), None),
        each => (None, each.as_ref()),
    };
    let tracked = match (&positions_deg, &positions_mm) {
        (Some(axes_deg), Some(places_mm)) => {
            let (target, sigma_mm) = (target.as_ref(), positions_sigma_mm.as_ref());
            let approach = positions_approach.as_ref();
            Some(GivenPositions { axes_deg, places_mm, target, sigma_mm, approach }.measurements()?)
        }
        (None, None) => None,
        _ => return Err(PyValueError::new_err("positions_deg and positions_mm belong together").into()),
    };
    let (lengths, mut findings) = match (&axes_deg, &lengths_mm, &ball) {
        (Some(axes_deg), Some(lengths_mm), Some(ball)) => {
            let given = Given {
                axes_deg,
                lengths_mm,
                ball,
                sigma_mm: each,
                bar: bar.as_ref(),
                approach: approach.as_ref(),
                index: index.as_ref(),
                payload: payload.as_ref(),
                force_n: force_n.as_ref(),
                t_s: t_s.as_ref(),
            };
            let (lengths, findings) = given.measurements(robot.robot())?;
            let joined = tracked.map_or(Ok(lengths.clone()), |tracked| lengths.and(&tracked));
            (joined.map_err(failed)?, findings)
        }
        (None, None, None) => {
            let needed = || PyValueError::new_err("lengths_mm or positions_mm are needed");
            (tracked.ok_or_else(needed)?, Vec::new())
        }
        _ => return Err(PyValueError::new_err("axes_deg, lengths_mm and ball belong together").into()),
    };
    let (mut robot, file) = (robot.robot().clone(), robot.file.as_deref());
    if let Some(tool_mm) = tool_mm {
        robot.set_tool(tool_mm);
    }
    robot.check_tool().map_err(failed)?;
    let balls = balls_mm.as_ref().map_or(Ok(Vec::new()), balls)?;
    findings.extend(checked(&lengths, &robot, &balls)?);
    for (key, value, quantity) in [
        ("bar_u_mm", bar_u_mm, Quantity::StandardLengthUncertainty),
        ("tolerance_mm", tolerance_mm, Quantity::PositionTolerance),
    ] {
        value.map_or(Ok(()), |value| quantity.check(key, value)).map_err(failed)?;
    }
    let mut measured = stated_conditions(measured, temperature_c)?;
    let robot = aged(&robot, &mut measured);
    let rest = Options {
        model: error_model(model)?,
        sigma_mm: all,
        bar_u_mm,
        tolerance_mm,
        folds,
        monte_carlo,
        workspace: workspace(py, workspace_deg.as_ref(), &robot)?,
        measured,
        ..Options::default()
    };
    let set_up = lengths.set_up(balls.len());
    let prior = prior.map(|given| self::prior(given, set_up)).transpose()?;
    // Nothing says from which lengths a dictionary of standard deviations was identified.
    let file = file.filter(|_| !matches!(prior, Some(RequestedPrior::Table(_))));
    let asked = AskedIdentification { estimate, hold, prior, rest };
    let known = || known_lengths(file, &lengths);
    let (options, lost) = asked.options(&robot, lengths.rows.len(), set_up, known)?;
    findings.extend(lost.map(Diagnostic::from));
    let start = LengthModel::before(robot.geometry.clone(), &balls, &lengths);
    py.detach(|| {
        let input = Input {
            robot: &robot,
            observations: &lengths,
            start: &start,
            validation: None,
            options: &options,
            axes: AngleSource::Given,
        };
        let found = calibrate(&input, findings).map_err(failed)?;
        let budget = UncertaintyBudget::of(&found, &lengths, bar_u_mm, &robot.provenance.identity);
        Ok(PyResult_ { found, budget })
    })
}
