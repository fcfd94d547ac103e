//! The robot of a request, and the findings about its file.

use dbbd_device::clock;
use dbbd_model::base::date;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::EstimationFinding;
use dbbd_model::robot::{LoadedRobot, MeasurementConditions, Robot, RobotFinding};

use super::RequestSession;
use crate::robot_files::RobotName;

/// Reads a robot, and reports the findings about its file. A warning about its identification is not reported: a
/// further measurement is its cure.
pub(super) fn robot_for_measurement(
    name: &RobotName,
    session: &RequestSession<'_>,
) -> Result<LoadedRobot, Diagnostic> {
    let mut read = name.read()?;
    session.findings(std::mem::take(&mut read.findings));
    Ok(read)
}

/// Lets a robot carry another payload: a payload of its file by name, or `KG,X,Y,Z`.
pub fn carrying(
    name: &str,
    robot: &mut Robot,
    payload: Option<&str>,
) -> Result<Option<RobotFinding>, Diagnostic> {
    let Some(payload) = payload else { return Ok(None) };
    robot.geometry.load.carry(payload).map_err(|finding| finding.in_file(name))?;
    let beyond = robot.geometry.load.beyond_measured().filter(|_| robot.nominal.is_some());
    Ok(beyond.map(|[kg, measured_kg]| match measured_kg > 0.0 {
        true => RobotFinding::PayloadNeverMeasured { kg, measured_kg },
        false => RobotFinding::NoPayloadMeasured { kg },
    }))
}

/// The robot with what is known of it today.
pub(super) fn today(robot: &Robot) -> Robot {
    aged(robot, &mut MeasurementConditions::default())
}

/// The robot with what is known of it on the day on which lengths were measured. If that day is not known it is today, which
/// the conditions of an identified robot then state: from this day on its uncertainty grows.
pub fn aged(robot: &Robot, measured: &mut MeasurementConditions) -> Robot {
    let day = measured.date.clone().unwrap_or_else(|| date::utc(clock::unix_ns()));
    let aged = robot.under(&MeasurementConditions { date: Some(day), ..measured.clone() });
    measured.date = measured.date.take().or_else(|| aged.measured.date.clone());
    aged
}

/// The finding if the file of an identified robot lacks its posterior, or has values to which the posterior does not
/// belong.
pub fn edited(robot: &Robot) -> Option<EstimationFinding> {
    match &robot.posterior {
        Some(known) => (!known.is_of(&robot.geometry)).then_some(EstimationFinding::PosteriorOfOtherValues),
        None => robot.nominal.as_ref().map(|_| EstimationFinding::PosteriorLost),
    }
}
