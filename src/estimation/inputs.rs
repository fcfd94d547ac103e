//! What is wrong or doubtful in the inputs of an estimation, before anything is computed.

use super::units::{mistaken, mistaken_positions};
use crate::catalogue::MeasurementFinding::{self, OtherUnit};
use crate::diagnostic::Diagnostic;
use crate::math::robust::median;
use crate::measurement::{BaseBall, Measurements, TargetId};
use crate::robot::{AXES, Robot};

/// Every length must have its ball, positions must follow the robot, all in millimetres and degrees; `file` is where they
/// are.
///
/// # Errors
/// A ball or bar that is not there; lengths, positions or angles in another unit; positions of another robot.
pub fn check_measurements(
    file: &str,
    observations: &Measurements,
    robot: &Robot,
    centres: &[BaseBall],
) -> Result<(), Diagnostic> {
    observations.check(file, observations.set_up(centres.len()))?;
    let mistaken = match mistaken(&robot.geometry, centres, &observations.rows) {
        Some(mistaken) => Some(mistaken),
        None => {
            mistaken_positions(&robot.geometry, observations).map_err(|why| Diagnostic::file(file, why))?
        }
    };
    match mistaken {
        Some((columns, unit)) => {
            Err(Diagnostic::file(file, OtherUnit { columns: columns.into(), unit: unit.into() }))
        }
        None => Ok(()),
    }
}

/// What no bar is long is said elsewhere, mm.
const LONGEST_MM: f64 = 1e5;

/// What is doubtful in observations that [`check_measurements`] takes, and unknown of their robot; `file` is where they are.
pub fn doubts(
    file: &str,
    observations: &Measurements,
    robot: &Robot,
    centres: &[BaseBall],
) -> Vec<Diagnostic> {
    let doubts = [
        observations.without_sigma(),
        observations.beyond(robot.controller()),
        observations.warm(),
        far_rows(observations, robot, centres),
        frozen(observations),
        other_sigma(observations),
        one_decimal(observations),
        two_decimals(observations, robot),
    ];
    let unknown = robot.asked_repeatability().map(Diagnostic::from);
    unknown
        .into_iter()
        .chain(doubts.into_iter().flatten().map(|doubt| Diagnostic::file(file, doubt)))
        .collect()
}

/// A standard deviation of a row that is far from the usual.
fn other_sigma(observations: &Measurements) -> Option<MeasurementFinding> {
    /// Times the usual, either way.
    const FAR: f64 = 50.0;
    let given = observations.rows.iter().filter_map(|row| Some((row.index, row.sigma_mm?)));
    let given: Vec<(u32, f64)> = given.collect();
    let usual_mm = median(&mut given.iter().map(|(_, sigma_mm)| *sigma_mm).collect::<Vec<_>>())?;
    let is_far = |sigma_mm: f64| sigma_mm > FAR * usual_mm || sigma_mm * FAR < usual_mm;
    let &(index, sigma_mm) = given.iter().find(|(_, sigma_mm)| is_far(*sigma_mm))?;
    Some(MeasurementFinding::OtherSigma { index, sigma_mm, usual_mm })
}

/// Lengths that all have one decimal, and are not all equal.
fn one_decimal(observations: &Measurements) -> Option<MeasurementFinding> {
    const LEAST: usize = 10;
    let rows = observations.rows.iter().filter(|row| row.datum.ball().is_some());
    let tenths: Vec<f64> = rows.map(|row| 10.0 * row.length_mm).collect();
    let is_rounded = tenths.iter().all(|value| (value - value.round()).abs() < 1e-6);
    let differ = tenths.windows(2).any(|pair| pair[0] != pair[1]);
    (tenths.len() >= LEAST && is_rounded && differ)
        .then_some(MeasurementFinding::OneDecimal { rows: tenths.len() })
}

/// Angles that all have two decimals, as a pendant shows them: chosen ones seldom use both.
fn two_decimals(observations: &Measurements, robot: &Robot) -> Option<MeasurementFinding> {
    /// Fewer angles have so many by chance.
    const LEAST: usize = 60;
    /// Half of the last digit, uniform, as a standard deviation, degrees.
    const ROUNDING_DEG: f64 = 0.005 / 1.732;
    let rows = &observations.rows;
    let hundredths: Vec<f64> = rows
        .iter()
        .flat_map(|row| row.axes.degrees())
        .filter(|deg| *deg != 0.0)
        .map(|deg| 100.0 * deg)
        .collect();
    let is_whole = |value: f64| (value - value.round()).abs() < 1e-6;
    let is_rounded = hundredths.len() >= LEAST && hundredths.iter().all(|value| is_whole(*value));
    let both = hundredths.iter().filter(|value| !is_whole(**value / 10.0)).count();
    let length_mm = ROUNDING_DEG.to_radians() * robot.reach_mm();
    (is_rounded && 2 * both > hundredths.len())
        .then_some(MeasurementFinding::TwoDecimals { rows: rows.len(), length_mm })
}

/// Lengths at different poses that are equal to the last digit, all or many one after the other.
fn frozen(observations: &Measurements) -> Option<MeasurementFinding> {
    /// Fewer are equal by chance, where a bar has few digits.
    const LEAST: usize = 6;
    let lengths = observations.rows.iter().filter(|row| row.datum.ball().is_some());
    let lengths: Vec<_> = lengths.map(|row| (row.index, row.length_mm, row.axes.degrees())).collect();
    let is_equal =
        |one: &(u32, f64, [f64; AXES]), next: &(u32, f64, [f64; AXES])| one.1 == next.1 && one.2 != next.2;
    let equal = lengths.chunk_by(is_equal).max_by_key(|equal| equal.len())?;
    let (rows, &(index, length_mm, _)) = (equal.len(), equal.first()?);
    match rows {
        _ if rows < LEAST || length_mm.abs() > LONGEST_MM => None,
        _ if rows == lengths.len() => Some(MeasurementFinding::AllEqual { rows, length_mm }),
        _ => Some(MeasurementFinding::FrozenRows { rows, index, length_mm }),
    }
}

/// Rows whose lengths are far from where robot and balls have them, while the others are near: single typing errors, which can
/// spoil a whole result.
fn far_rows(observations: &Measurements, robot: &Robot, centres: &[BaseBall]) -> Option<MeasurementFinding> {
    /// Balls may be given to centimetres, mm.
    const FAR_MM: f64 = 100.0;
    /// No ball is given so badly, mm.
    const FAR_FROM_ALL_MM: f64 = 250.0;
    /// Where more are a little far, robot or balls are others.
    const FEW: f64 = 0.2;
    let off = observations.rows.iter().filter(|row| row.target == TargetId::FIRST).filter_map(|row| {
        let centre = centres.get(row.datum.ball()?.index()).map(|ball| &ball.position);
        Some((row, centre))
    });
    let off = off.map(|(row, centre)| {
        let centre = centre?;
        Some((row.index, (row.length_mm - robot.geometry.length(&row.axes.radians(), centre, 0.0)).abs()))
    });
    let off: Vec<(u32, f64)> = off.collect::<Option<_>>()?;
    let usual_mm = median(&mut off.iter().map(|(_, off_mm)| *off_mm).collect::<Vec<_>>())?;
    if (FAR_FROM_ALL_MM..LONGEST_MM).contains(&usual_mm) {
        return Some(MeasurementFinding::FarFromAll { off_mm: usual_mm });
    }
    let far: Vec<_> =
        off.iter().filter(|(_, off_mm)| *off_mm > usual_mm + FAR_MM || off_mm.is_nan()).collect();
    let &&(index, off_mm) = far.first()?;
    ((far.len() as f64) < FEW * off.len() as f64 || off_mm > FAR_FROM_ALL_MM)
        .then_some(MeasurementFinding::FarLengths { rows: far.len(), index, off_mm })
}
