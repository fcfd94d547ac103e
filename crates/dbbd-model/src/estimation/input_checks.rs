//! Checks of the inputs of an estimation before anything is computed.

use nalgebra::Vector3;

use crate::diagnostic::Diagnostic;
use crate::estimation::EstimationFinding::{self, PositionsElsewhere, PositionsMirrored};
use crate::math::RigidAlignment;
use crate::math::robust::median;
use crate::measurement::MeasurementFinding::{self, OtherUnit};
use crate::measurement::{BaseBall, MeasuredPosition, Measurement, Measurements, TargetId};
use crate::plausibility::{ANGLE_UNITS, LENGTH_UNITS, OtherUnit as MistakenUnit, Quantity};
use crate::robot::{AXES, Geometry, Pose, Robot};

/// Checks that all balls and bars of the rows exist, that lengths and positions fit the robot, and their units.
///
/// # Errors
/// An unknown ball, bar or target; another unit; positions of another robot.
pub fn check_measurements(
    file: &str,
    observations: &Measurements,
    robot: &Robot,
    centres: &[BaseBall],
) -> Result<(), Diagnostic> {
    observations.check(file, observations.set_up(centres.len()))?;
    let refused = |mistake: UnitMistake| {
        let UnitMistake { columns, unit } = mistake;
        Diagnostic::file(file, OtherUnit { columns: columns.into(), unit: unit.into() })
    };
    if let Some(mistake) = unit_of_lengths(&robot.geometry, centres, &observations.rows) {
        return Err(refused(mistake));
    }
    let of_positions = unit_of_positions(&robot.geometry, observations);
    of_positions.map_err(|why| Diagnostic::file(file, why))?.map_or(Ok(()), |mistake| Err(refused(mistake)))
}

/// Longer lengths have a finding of their own, mm.
const LONGEST_MM: f64 = 1e5;

/// Doubtful features of observations that pass [`check_measurements`], and missing data of their robot.
pub fn doubts(
    file: &str,
    observations: &Measurements,
    robot: &Robot,
    centres: &[BaseBall],
) -> Vec<Diagnostic> {
    let doubts = [
        observations.without_sigma().map(Diagnostic::from),
        observations.beyond(robot.controller()).map(Diagnostic::from),
        observations.warm().map(Diagnostic::from),
        far_rows(observations, robot, centres).map(Diagnostic::from),
        frozen(observations).map(Diagnostic::from),
        other_sigma(observations),
        one_decimal(observations).map(Diagnostic::from),
        two_decimals(observations, robot).map(Diagnostic::from),
    ];
    let unknown = robot.asked_repeatability().map(Diagnostic::from);
    unknown.into_iter().chain(doubts.into_iter().flatten().map(|doubt| doubt.in_file(file))).collect()
}

/// Standard deviations that no bar has, or one that is far from the median.
fn other_sigma(observations: &Measurements) -> Option<Diagnostic> {
    /// Ratio to the median or its inverse.
    const FAR: f64 = 50.0;
    let given = observations.rows.iter().filter_map(|row| Some((row.index, row.sigma_mm?)));
    let given: Vec<(u32, f64)> = given.collect();
    let usual_mm = median(&mut given.iter().map(|(_, sigma_mm)| *sigma_mm).collect::<Vec<_>>())?;
    if let Some(other_unit) = Quantity::LengthSd.impossible("median of sigma_mm", usual_mm) {
        return Some(other_unit.into());
    }
    let is_far = |sigma_mm: f64| sigma_mm > FAR * usual_mm || sigma_mm * FAR < usual_mm;
    let &(index, sigma_mm) = given.iter().find(|(_, sigma_mm)| is_far(*sigma_mm))?;
    Some(MeasurementFinding::OtherSigma { index, sigma_mm, usual_mm }.into())
}

/// Lengths that differ but all have only one decimal.
fn one_decimal(observations: &Measurements) -> Option<MeasurementFinding> {
    const MIN_LENGTHS: usize = 10;
    let rows = observations.rows.iter().filter(|row| row.datum.ball().is_some());
    let tenths: Vec<f64> = rows.map(|row| 10.0 * row.length_mm).collect();
    let is_rounded = tenths.iter().all(|value| (value - value.round()).abs() < 1e-6);
    let differ = tenths.windows(2).any(|pair| pair[0] != pair[1]);
    (tenths.len() >= MIN_LENGTHS && is_rounded && differ)
        .then_some(MeasurementFinding::OneDecimal { rows: tenths.len() })
}

/// Angles that all have two decimals, as a teach pendant displays them. Commanded angles seldom use both decimals.
fn two_decimals(observations: &Measurements, robot: &Robot) -> Option<MeasurementFinding> {
    /// Fewer angles may have two decimals by chance.
    const MIN_LENGTHS: usize = 60;
    /// Standard deviation of rounding to the last digit, degrees.
    const ROUNDING_DEG: f64 = 0.005 / 1.732;
    let rows = &observations.rows;
    let hundredths: Vec<f64> = rows
        .iter()
        .flat_map(|row| row.axes.degrees())
        .filter(|deg| *deg != 0.0)
        .map(|deg| 100.0 * deg)
        .collect();
    let is_whole = |value: f64| (value - value.round()).abs() < 1e-6;
    let is_rounded = hundredths.len() >= MIN_LENGTHS && hundredths.iter().all(|value| is_whole(*value));
    let both = hundredths.iter().filter(|value| !is_whole(**value / 10.0)).count();
    let length_mm = ROUNDING_DEG.to_radians() * robot.reach_mm();
    (is_rounded && 2 * both > hundredths.len())
        .then_some(MeasurementFinding::TwoDecimals { rows: rows.len(), length_mm })
}

/// Consecutive lengths at different poses that are exactly equal.
fn frozen(observations: &Measurements) -> Option<MeasurementFinding> {
    /// Fewer may be equal by chance if the bar has few digits.
    const MIN_LENGTHS: usize = 6;
    let lengths = observations.rows.iter().filter(|row| row.datum.ball().is_some());
    let lengths: Vec<_> = lengths.map(|row| (row.index, row.length_mm, row.axes.degrees())).collect();
    let is_equal =
        |one: &(u32, f64, [f64; AXES]), next: &(u32, f64, [f64; AXES])| one.1 == next.1 && one.2 != next.2;
    let equal = lengths.chunk_by(is_equal).max_by_key(|equal| equal.len())?;
    let (rows, &(index, length_mm, _)) = (equal.len(), equal.first()?);
    match rows {
        _ if rows < MIN_LENGTHS || length_mm.abs() > LONGEST_MM => None,
        _ if rows == lengths.len() => Some(MeasurementFinding::AllEqual { rows, length_mm }),
        _ => Some(MeasurementFinding::FrozenRows { rows, index, length_mm }),
    }
}

/// Single lengths that are far from those of the nominal robot (typing errors), or all of them (another robot or ball).
fn far_rows(observations: &Measurements, robot: &Robot, centres: &[BaseBall]) -> Option<MeasurementFinding> {
    /// Balls may be given to centimetres only, mm.
    const FAR_MM: f64 = 100.0;
    /// But not worse than this, mm.
    const FAR_FROM_ALL_MM: f64 = 250.0;
    /// With a larger fraction of far rows it is probably another robot or ball.
    const FEW: f64 = 0.2;
    let lengths = observations.rows.iter().filter(|row| row.target == TargetId::FIRST);
    let off = lengths.filter(|row| row.datum.ball().is_some()).map(|row| {
        let expected_mm = nominal_mm(&robot.geometry, centres, row, &row.axes.radians())?;
        Some((row.index, (row.length_mm - expected_mm).abs()))
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

/// A length agrees with the nominal one within this fraction: tool and ball are known to some centimetres.
const AGREES: f64 = 0.15;
/// The fraction of lengths that must agree.
const MAX_SHARE: f64 = 0.9;
/// Fewer lengths may agree by chance.
const MIN_LENGTHS: usize = 4;

/// Columns that are in another unit than their name says. A table in metres or radians could be fitted as well, by a robot
/// that does not exist.
struct UnitMistake {
    columns: &'static str,
    unit: &'static str,
}

impl UnitMistake {
    fn of_angles(unit: &MistakenUnit) -> Self {
        Self { columns: "a1_deg..a6_deg", unit: unit.name }
    }
}

/// The length of a row by the nominal robot at axis angles (rad), mm; `None` for a position or an unknown ball.
fn nominal_mm(
    geometry: &Geometry,
    centres: &[BaseBall],
    row: &Measurement,
    axes: &[f64; AXES],
) -> Option<f64> {
    Some(geometry.length(axes, &centres.get(row.datum.ball()?.index())?.position, 0.0))
}

/// Compares the lengths in several units with those of the nominal robot.
fn unit_of_lengths(geometry: &Geometry, centres: &[BaseBall], rows: &[Measurement]) -> Option<UnitMistake> {
    let lengths: Vec<&Measurement> = rows.iter().filter(|row| !row.datum.is_plane()).collect();
    let agree = |degrees: f64, unit_mm: f64| {
        let is_near = |row: &&&Measurement| {
            nominal_mm(geometry, centres, row, &row.axes.radians().map(|angle| degrees * angle))
                .is_some_and(|mm| (unit_mm * row.length_mm - mm).abs() <= AGREES * mm)
        };
        let count = lengths.len();
        count >= MIN_LENGTHS && lengths.iter().filter(is_near).count() as f64 >= MAX_SHARE * count as f64
    };
    if agree(1.0, 1.0) {
        return None;
    }
    if let Some(unit) = LENGTH_UNITS.iter().find(|unit| agree(1.0, unit.factor)) {
        return Some(UnitMistake { columns: "length_mm", unit: unit.name });
    }
    ANGLE_UNITS.iter().find(|unit| agree(unit.factor, 1.0)).map(UnitMistake::of_angles)
}

/// Fewer positions can be fitted to any poses.
const MIN_POSITIONS: usize = 8;
/// Iterations of fitting target and frame in turn.
const ROUNDS: usize = 30;

/// Fits the positions to the nominal robot, in several units.
///
/// # Errors
/// The positions do not fit the robot in any unit.
fn unit_of_positions(
    geometry: &Geometry,
    observations: &Measurements,
) -> Result<Option<UnitMistake>, EstimationFinding> {
    let Some(target) = observations.positions().map(|position| position.target).min() else {
        return Ok(None);
    };
    let positions: Vec<MeasuredPosition> =
        observations.positions().filter(|position| position.target == target).collect();
    if positions.len() < MIN_POSITIONS {
        return Ok(None);
    }
    let places: Vec<Vector3<f64>> = positions.iter().map(|position| position.place).collect();
    let flanges = |factor: f64| -> Vec<Pose> {
        positions.iter().map(|position| geometry.flange(&position.axes.map(|angle| factor * angle))).collect()
    };
    let Some(found) = fit_frame(&places, &flanges(1.0), geometry.tool) else { return Ok(None) };
    let is_near = |scale: f64, unit_mm: f64| (scale / unit_mm - 1.0).abs() <= AGREES;
    if found.misfit <= AGREES {
        let other = LENGTH_UNITS.iter().find(|unit| is_near(found.scale, unit.factor));
        return Ok(other.map(|unit| UnitMistake { columns: "x_mm..z_mm", unit: unit.name }));
    }
    let fits = |places: &[Vector3<f64>], flanges: &[Pose]| {
        let found = fit_frame(places, flanges, geometry.tool);
        found.is_some_and(|found| found.misfit <= AGREES && is_near(found.scale, 1.0))
    };
    if let Some(unit) = ANGLE_UNITS.iter().find(|unit| fits(&places, &flanges(unit.factor))) {
        return Ok(Some(UnitMistake::of_angles(unit)));
    }
    let mirrored: Vec<Vector3<f64>> =
        places.iter().map(|place| Vector3::new(-place.x, place.y, place.z)).collect();
    Err(match fits(&mirrored, &flanges(1.0)) {
        true => PositionsMirrored,
        false => PositionsElsewhere { misfit_percent: 100.0 * found.misfit },
    })
}

/// Fits a frame and a target on the flange, from `target` on, to the places of the target. Returns the alignment of the places.
fn fit_frame(places: &[Vector3<f64>], flanges: &[Pose], mut target: Vector3<f64>) -> Option<RigidAlignment> {
    let on_tool = |target: Vector3<f64>| -> Vec<Vector3<f64>> {
        flanges.iter().map(|flange| flange.position + flange.rotation * target).collect()
    };
    let mut found = RigidAlignment::of(places, &on_tool(target))?;
    for _ in 0..ROUNDS {
        let there = places.iter().map(|place| found.rotation * (place * found.scale));
        let pairs: Vec<(Vector3<f64>, &Pose)> = there.zip(flanges).collect();
        // The shift of the frame for this target, then the target for this shift.
        let shift = pairs
            .iter()
            .map(|(there, flange)| flange.position + flange.rotation * target - there)
            .sum::<Vector3<f64>>()
            / pairs.len() as f64;
        target = pairs
            .iter()
            .map(|(there, flange)| flange.rotation.transpose() * (there + shift - flange.position))
            .sum::<Vector3<f64>>()
            / pairs.len() as f64;
        found = RigidAlignment::of(places, &on_tool(target))?;
    }
    Some(found)
}
