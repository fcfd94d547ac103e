//! Lengths and positions at poses, as arrays.

use std::sync::Arc;

use dbbd_job::request::checked_workspace;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::{check_measurements, measurement_findings};
use dbbd_model::measurement::{
    BaseBall, ContextColumn, DistinctMeasurements, Measurement, MeasurementContext, MeasurementFinding,
    Measurements,
};
use dbbd_model::plausibility::Quantity;
use dbbd_model::robot::{
    AXES, AxisAngles, BallId, BarId, Coordinate, Datum, MeasurementConditions, PayloadId, Robot, TargetId,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{Floats, Numbers, Rows, Wholes, approaches, array, column, shape_error};
use crate::error::{Outcome, failed, warn};

/// Where the lengths of a call are, as a message names it.
pub(crate) const ARRAYS: &str = "measurements";
const FORCE: &str = "force_n";

/// The payload of each length by its name, as a caller gives it.
#[derive(FromPyObject)]
pub(crate) enum PayloadGiven {
    All(String),
    Each(Vec<String>),
}

/// The arrays of a call with lengths.
pub(crate) struct Given<'a, 'py> {
    pub(crate) axes_deg: &'a Numbers<'py>,
    pub(crate) lengths_mm: &'a Numbers<'py>,
    pub(crate) ball: &'a Wholes<'py>,
    pub(crate) sigma_mm: Option<&'a Numbers<'py>>,
    pub(crate) bar: Option<&'a Wholes<'py>>,
    pub(crate) approach: Option<&'a Wholes<'py>>,
    pub(crate) index: Option<&'a Wholes<'py>>,
    pub(crate) payload: Option<&'a PayloadGiven>,
    pub(crate) force_n: Option<&'a Numbers<'py>>,
    pub(crate) t_s: Option<&'a Numbers<'py>>,
}

impl Given<'_, '_> {
    /// The table, its rows once, with the payloads of the robot; what was found in it.
    pub(crate) fn measurements(&self, robot: &Robot) -> Outcome<(Measurements, Vec<Diagnostic>)> {
        let axes = Rows::<AXES>::of(self.axes_deg, "axes_deg")?.rows;
        let count = axes.len();
        let lengths = column(self.lengths_mm, "lengths_mm", count)?;
        let balls = ids(Some(self.ball), "ball", count, BallId::new)?;
        let bars = ids(self.bar, "bar", count, BarId::new)?;
        let sigmas = match self.sigma_mm {
            Some(sigma) => column(sigma, "sigma_mm", count)?.into_iter().map(Some).collect(),
            None => vec![None; count],
        };
        let approaches = approaches(self.approach, count)?;
        let indices = match self.index {
            Some(index) => whole(index, "index", count, 0, Some)?,
            None => (1..=count as u32).collect(),
        };
        let (carried, names) = payloads(self.payload, count)?;
        let (times, forces) = (known(self.t_s, "t_s", count)?, known(self.force_n, FORCE, count)?);
        let plausible = |force_n: &f64| Quantity::BarForce.check(FORCE, *force_n);
        let mut given = forces.iter().flatten();
        given.try_for_each(plausible).map_err(|finding| Diagnostic::file(ARRAYS, finding))?;
        let context = |at: usize| {
            let (time_s, force_n) = (times[at], forces[at]);
            let is_known = time_s.is_some() || force_n.is_some();
            is_known
                .then(|| Arc::new(MeasurementContext { time_s, force_n, ..MeasurementContext::default() }))
        };
        let row = |at: usize| Measurement {
            index: indices[at],
            datum: Datum::Ball(balls[at], bars[at]),
            target: TargetId::FIRST,
            axes: AxisAngles::from_degrees(axes[at]),
            approach: approaches[at],
            length_mm: lengths[at],
            sigma_mm: sigmas[at],
            payload: carried[at],
            context: context(at),
        };
        let time = self.t_s.map(|_| ContextColumn::TimeS);
        let columns = time.into_iter().chain(self.force_n.map(|_| ContextColumn::ForceN)).collect();
        let table = Measurements::new((0..count).map(row).collect(), columns).map_err(failed)?;
        let table = Measurements { payloads: names, ..table };
        let DistinctMeasurements { measurements, repeated } = table.distinct().map_err(failed)?;
        let found = (repeated > 0)
            .then(|| Diagnostic::file(ARRAYS, MeasurementFinding::Repeated { repeated, rows: count }));
        let carrying = measurements.carrying(&robot.geometry.load);
        let measurements = carrying.map_err(|finding| Diagnostic::file(ARRAYS, finding))?;
        Ok((measurements, found.into_iter().collect()))
    }
}

/// The payloads of the rows, and the names to which their numbers belong, as in a table that was read.
fn payloads(given: Option<&PayloadGiven>, count: usize) -> PyResult<(Vec<PayloadId>, Vec<String>)> {
    let each: Vec<&str> = match given {
        None => return Ok((vec![PayloadId::FIRST; count], Vec::new())),
        Some(PayloadGiven::All(name)) => vec![name.as_str(); count],
        Some(PayloadGiven::Each(names)) if names.len() == count => names.iter().map(String::as_str).collect(),
        Some(PayloadGiven::Each(names)) => {
            return Err(shape_error("payload", &format!("({count},) or a name"), &[names.len()]));
        }
    };
    // The first name is the one of rows that name none.
    let mut names = vec![String::new()];
    let mut carried = Vec::new();
    for name in each {
        let place = names.iter().position(|known| known == name).unwrap_or(names.len());
        if place == names.len() {
            names.push(name.to_owned());
        }
        carried.push(PayloadId::at(place));
    }
    Ok((carried, names))
}

/// A column of numbers; NaN where one is not known.
fn known(array: Option<&Numbers<'_>>, name: &str, count: usize) -> PyResult<Vec<Option<f64>>> {
    let Some(array) = array else { return Ok(vec![None; count]) };
    let numbers = column(array, name, count)?;
    if numbers.iter().any(|number| number.is_infinite()) {
        return Err(PyValueError::new_err(format!("{name} must be finite, or NaN where it is not known")));
    }
    Ok(numbers.into_iter().map(|number| Some(number).filter(|number| !number.is_nan())).collect())
}

/// The arrays of a call with positions.
pub(crate) struct GivenPositions<'a, 'py> {
    pub(crate) axes_deg: &'a Numbers<'py>,
    pub(crate) places_mm: &'a Numbers<'py>,
    pub(crate) target: Option<&'a Wholes<'py>>,
    pub(crate) sigma_mm: Option<&'a Numbers<'py>>,
    pub(crate) approach: Option<&'a Wholes<'py>>,
}

impl GivenPositions<'_, '_> {
    /// The table, three rows a position.
    pub(crate) fn measurements(&self) -> Outcome<Measurements> {
        let axes = Rows::<AXES>::of(self.axes_deg, "positions_deg")?.rows;
        let places = Rows::<3>::of(self.places_mm, "positions_mm")?.rows;
        let count = axes.len();
        if places.len() != count {
            return Err(PyValueError::new_err("positions_deg and positions_mm must have as many rows").into());
        }
        let targets = ids(self.target, "target", count, TargetId::new)?;
        let sigmas = match self.sigma_mm {
            Some(sigma) => column(sigma, "positions_sigma_mm", count)?.into_iter().map(Some).collect(),
            None => vec![None; count],
        };
        let approaches = approaches(self.approach, count)?;
        let position = |at: usize| {
            let row = Measurement {
                index: at as u32 + 1,
                datum: Datum::Plane(Coordinate::X),
                target: targets[at],
                axes: AxisAngles::from_degrees(axes[at]),
                approach: approaches[at],
                length_mm: 0.0,
                sigma_mm: sigmas[at],
                payload: PayloadId::FIRST,
                context: None,
            };
            row.at_place(places[at])
        };
        Measurements::new((0..count).flat_map(position).collect(), Vec::new()).map_err(failed)
    }
}

/// What is counted from 1; all the first where there is no array.
fn ids<T: Clone>(
    array: Option<&Wholes<'_>>,
    name: &str,
    count: usize,
    id: fn(u32) -> Option<T>,
) -> PyResult<Vec<T>> {
    match array {
        Some(array) => whole(array, name, count, 1, id),
        None => Ok(id(1).map_or_else(Vec::new, |first| vec![first; count])),
    }
}

/// A column of whole numbers from `least`.
fn whole<T>(
    array: &Wholes<'_>,
    name: &str,
    count: usize,
    least: u32,
    read: fn(u32) -> Option<T>,
) -> PyResult<Vec<T>> {
    let numbers = column(array, name, count)?.into_iter();
    let numbers: Option<_> = numbers.map(|number| u32::try_from(number).ok().and_then(read)).collect();
    numbers.ok_or_else(|| PyValueError::new_err(format!("{name} must be whole numbers from {least}")))
}

/// Base balls by an array of the shape (K, 3), or (3,) of one.
pub(crate) fn balls(array: &Numbers<'_>) -> PyResult<Vec<BaseBall>> {
    let rows = Rows::<3>::of(array, "balls_mm")?.rows;
    Ok(rows
        .into_iter()
        .enumerate()
        .map(|(at, mm)| BaseBall { id: BallId::at(at), position: mm.into() })
        .collect())
}

/// The findings about the measurements, after what makes them unusable.
pub(crate) fn checked(lengths: &Measurements, robot: &Robot, balls: &[BaseBall]) -> Outcome<Vec<Diagnostic>> {
    check_measurements(ARRAYS, lengths, robot, balls)?;
    Ok(measurement_findings(ARRAYS, lengths, robot, balls))
}

/// The poses of a workspace, rad; a warning if the robot's limits do not allow them.
pub(crate) fn workspace(
    py: Python<'_>,
    given: Option<&Numbers<'_>>,
    robot: &Robot,
) -> Outcome<Option<Vec<[f64; AXES]>>> {
    const ARGUMENT: &str = "workspace_deg";
    let Some(given) = given else { return Ok(None) };
    let axes = Rows::<AXES>::of(given, ARGUMENT)?.rows.into_iter().map(AxisAngles::from_degrees);
    let (poses, beyond) = checked_workspace(&axes.collect::<Vec<_>>(), robot)
        .map_err(|finding| Diagnostic::file(ARGUMENT, finding))?;
    beyond.iter().try_for_each(|finding| warn(py, &Diagnostic::file(ARGUMENT, finding.clone())))?;
    Ok(Some(poses))
}

/// The places of base balls.
pub(crate) struct BallPlaces<'a>(pub(crate) &'a [BaseBall]);

impl BallPlaces<'_> {
    /// As an array of the shape (K, 3), mm.
    pub(crate) fn array<'py>(&self, py: Python<'py>) -> PyResult<Floats<'py>> {
        let flat =
            self.0.iter().flat_map(|ball| [ball.position.x, ball.position.y, ball.position.z]).collect();
        array(py, flat, &[self.0.len(), 3])
    }
}

/// A table as the arguments of `identify` and `check`; None where an argument is not known.
pub(crate) fn table<'py>(
    py: Python<'py>,
    lengths: &Measurements,
    balls: &BallPlaces<'_>,
    measured: &MeasurementConditions,
) -> PyResult<Bound<'py, PyDict>> {
    let (rows, count) = (&lengths.rows, lengths.rows.len());
    let ball = |row: &Measurement| row.datum.ball().map_or(0, |ball| i64::from(ball.number()));
    let table = PyDict::new(py);
    table.set_item(
        "axes_deg",
        array(py, rows.iter().flat_map(|row| row.axes.degrees()).collect(), &[count, AXES])?,
    )?;
    table.set_item("lengths_mm", array(py, rows.iter().map(|row| row.length_mm).collect(), &[count])?)?;
    table.set_item("ball", array(py, rows.iter().map(ball).collect(), &[count])?)?;
    table.set_item("index", array(py, rows.iter().map(|row| i64::from(row.index)).collect(), &[count])?)?;
    let senses = rows.iter().flat_map(|row| row.approach.senses()).map(i64::from).collect();
    table.set_item("approach", array(py, senses, &[count, AXES])?)?;
    let sigma: Option<Vec<f64>> = rows.iter().map(|row| row.sigma_mm).collect();
    table.set_item("sigma_mm", sigma.map(|sigma| array(py, sigma, &[count])).transpose()?)?;
    table.set_item("balls_mm", balls.array(py)?)?;
    let name = |row: &Measurement| lengths.payloads.get(row.payload.index()).cloned().unwrap_or_default();
    let names = (!lengths.payloads.is_empty()).then(|| rows.iter().map(name).collect::<Vec<String>>());
    table.set_item("payload", names)?;
    let of_context = |of: fn(&MeasurementContext) -> Option<f64>| {
        let numbers = rows.iter().map(|row| row.context.as_deref().and_then(of).unwrap_or(f64::NAN));
        let numbers: Vec<f64> = numbers.collect();
        let is_known = numbers.iter().any(|number| !number.is_nan());
        is_known.then(|| array(py, numbers, &[count])).transpose()
    };
    table.set_item(FORCE, of_context(|context| context.force_n)?)?;
    table.set_item("t_s", of_context(|context| context.time_s)?)?;
    table.set_item("measured", measured.date.as_deref())?;
    table.set_item("temperature_c", measured.temperature_c)?;
    Ok(table)
}
