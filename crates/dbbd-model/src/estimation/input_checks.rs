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
        let UnitMistake { columns, unit, rows, index } = mistake;
        Diagnostic::file(file, OtherUnit { columns: columns.into(), unit: unit.into(), rows, index })
    };
    if let Some(mistake) = unit_of_lengths(&robot.geometry, centres, &observations.rows) {
        return Err(refused(mistake));
    }
    let of_positions = unit_of_positions(&robot.geometry, observations);
    of_positions.map_err(|why| Diagnostic::file(file, why))?.map_or(Ok(()), |mistake| Err(refused(mistake)))
}

/// Longer lengths have a finding of their own, mm.
const LONGEST_MM: f64 = 1e5;

/// WithWarnings features of observations that pass [`check_measurements`], and missing data of their robot.
pub fn measurement_findings(
    file: &str,
    observations: &Measurements,
    robot: &Robot,
    centres: &[BaseBall],
) -> Vec<Diagnostic> {
    let found = [
        observations.without_sigma().map(Diagnostic::from),
        observations.beyond(robot.controller()).map(Diagnostic::from),
        observations.warm().map(Diagnostic::from),
        far_rows(observations, robot, centres).map(Diagnostic::from),
        frozen(observations).map(Diagnostic::from),
        other_sigma(observations),
        one_decimal(observations).map(Diagnostic::from),
        few_decimals(observations, robot).map(Diagnostic::from),
    ];
    let unknown = robot.asked_repeatability().map(Diagnostic::from);
    unknown.into_iter().chain(found.into_iter().flatten().map(|finding| finding.in_file(file))).collect()
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

/// Angles that all have so few decimals, the last of which most of them use, as a teach pendant displays them.
fn few_decimals(observations: &Measurements, robot: &Robot) -> Option<MeasurementFinding> {
    /// Fewer angles may have few decimals by chance.
    const MIN_ANGLES: usize = 60;
    let rows = &observations.rows;
    let angles = rows.iter().flat_map(|row| row.axes.degrees()).filter(|deg| *deg != 0.0);
    let angles: Vec<f64> = angles.collect();
    let whole = |decimals: i32| {
        let step_deg = 10f64.powi(-decimals);
        let is_whole = |deg: &&f64| (*deg / step_deg - (*deg / step_deg).round()).abs() < 1e-6;
        angles.iter().filter(is_whole).count()
    };
    let decimals = (0..=2).find(|decimals| whole(*decimals) == angles.len())?;
    // Rounding has a uniform distribution over a step.
    let sd_deg = 10f64.powi(-decimals) / 12f64.sqrt();
    let length_mm = sd_deg.to_radians() * robot.reach_mm();
    (angles.len() >= MIN_ANGLES && 2 * whole(decimals - 1) < angles.len())
        .then_some(MeasurementFinding::FewDecimals { rows: rows.len(), decimals, length_mm })
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
    /// No ball is given worse than this, mm.
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
/// The fraction of lengths that must agree in a unit.
const MIN_SHARE_NEAR: f64 = 0.9;
/// Fewer lengths may agree by chance.
const MIN_LENGTHS: usize = 4;

/// Columns that are in another unit than their name says. A table in metres or radians could be fitted as well, by a robot
/// that does not exist.
struct UnitMistake {
    columns: &'static str,
    unit: &'static str,
    /// Number of rows with the mistake, and the index of the first of them.
    rows: usize,
    index: u32,
}

const ANGLES: &str = "a1_deg..a6_deg";

/// The length of a row by the nominal robot at axis angles (rad), mm; `None` for a position or an unknown ball.
fn nominal_mm(
    geometry: &Geometry,
    centres: &[BaseBall],
    row: &Measurement,
    axes: &[f64; AXES],
) -> Option<f64> {
    Some(geometry.length(axes, &centres.get(row.datum.ball()?.index())?.position, 0.0))
}

/// Compares the lengths in several units with those of the nominal robot: all, or those rows that disagree as they are.
fn unit_of_lengths(geometry: &Geometry, centres: &[BaseBall], rows: &[Measurement]) -> Option<UnitMistake> {
    /// In the other unit the rows must agree better by this factor. Otherwise a ball or a tool is elsewhere.
    const CLEARLY: f64 = 5.0;
    /// A smaller share of rows that disagree are mistakes of single rows.
    const MIN_SHARE_OFF: f64 = 0.2;
    let misfit = |row: &Measurement, degrees: f64, unit_mm: f64| {
        nominal_mm(geometry, centres, row, &row.axes.radians().map(|angle| degrees * angle))
            .map_or(f64::INFINITY, |mm| (unit_mm * row.length_mm - mm).abs() / mm)
    };
    let lengths: Vec<&Measurement> = rows.iter().filter(|row| !row.datum.is_plane()).collect();
    let off: Vec<&Measurement> =
        lengths.iter().copied().filter(|row| misfit(row, 1.0, 1.0) > AGREES).collect();
    let least = MIN_LENGTHS.max((MIN_SHARE_OFF * lengths.len() as f64) as usize);
    let misfits = |degrees: f64, unit_mm: f64| -> Vec<f64> {
        off.iter().map(|row| misfit(row, degrees, unit_mm)).collect()
    };
    let as_given = median(&mut misfits(1.0, 1.0))?;
    let agree = |degrees: f64, unit_mm: f64| {
        let mut misfits = misfits(degrees, unit_mm);
        let near = misfits.iter().filter(|misfit| **misfit <= AGREES).count();
        off.len() >= least
            && near as f64 >= MIN_SHARE_NEAR * off.len() as f64
            && median(&mut misfits).is_some_and(|misfit| CLEARLY * misfit <= as_given)
    };
    let of_lengths = LENGTH_UNITS.iter().find(|unit| agree(1.0, unit.factor)).map(|unit| ("length_mm", unit));
    let of_angles = || ANGLE_UNITS.iter().find(|unit| agree(unit.factor, 1.0)).map(|unit| (ANGLES, unit));
    let (columns, unit) = of_lengths.or_else(of_angles)?;
    Some(UnitMistake { columns, unit: unit.name, rows: off.len(), index: off.first()?.index })
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
    let mistake = |columns: &'static str, unit: &MistakenUnit| UnitMistake {
        columns,
        unit: unit.name,
        rows: observations.rows.len(),
        index: observations.rows.first().map_or(1, |row| row.index),
    };
    let is_near = |scale: f64, unit_mm: f64| (scale / unit_mm - 1.0).abs() <= AGREES;
    if found.misfit <= AGREES {
        let other = LENGTH_UNITS.iter().find(|unit| is_near(found.scale, unit.factor));
        return Ok(other.map(|unit| mistake("x_mm..z_mm", unit)));
    }
    let fits = |places: &[Vector3<f64>], flanges: &[Pose]| {
        let found = fit_frame(places, flanges, geometry.tool);
        found.is_some_and(|found| found.misfit <= AGREES && is_near(found.scale, 1.0))
    };
    if let Some(unit) = ANGLE_UNITS.iter().find(|unit| fits(&places, &flanges(unit.factor))) {
        return Ok(Some(mistake(ANGLES, unit)));
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{AxisAngles, BallId};
    use crate::test_support::cell::{CENTRE, kr60, measure, three_planes};

    fn lengths() -> Measurements {
        measure(&kr60(), &three_planes(1, CENTRE), 16, 40.0)
    }

    fn ball(x_off_mm: f64) -> [BaseBall; 1] {
        [BaseBall { id: BallId::at(0), position: Vector3::from(CENTRE) + Vector3::new(x_off_mm, 0.0, 0.0) }]
    }

    fn with_angles(of: impl Fn(usize, f64) -> f64) -> Measurements {
        let mut table = lengths();
        for (at, row) in table.rows.iter_mut().enumerate() {
            row.axes = AxisAngles::from_degrees(row.axes.degrees().map(|deg| of(at, deg)));
        }
        table
    }

    fn mistake(table: &Measurements, x_off_mm: f64) -> Option<(&'static str, &'static str, usize, u32)> {
        let found = unit_of_lengths(&kr60().geometry, &ball(x_off_mm), &table.rows)?;
        Some((found.columns, found.unit, found.rows, found.index))
    }

    #[test]
    fn rows_in_radians_are_refused_all_or_half_of_them() {
        let first = lengths().rows[0].index;
        assert_eq!(mistake(&lengths(), 0.0), None);
        let all = with_angles(|_, deg| deg.to_radians());
        let count = all.rows.len();
        assert_eq!(mistake(&all, 0.0), Some((ANGLES, "radians", count, first)));
        let half = with_angles(|at, deg| if 2 * at < count { deg } else { deg.to_radians() });
        assert_eq!(mistake(&half, 0.0), Some((ANGLES, "radians", count / 2, half.rows[count / 2].index)));
        // A share of 3/10, but not of 1/10, is a table of two parts.
        let some = |share: f64| {
            with_angles(|at, deg| if at as f64 >= share * count as f64 { deg } else { deg.to_radians() })
        };
        assert!(mistake(&some(0.3), 0.0).is_some() && mistake(&some(0.1), 0.0).is_none());
        // Nine of ten rows that are off agree in radians; eight of nine do not show a unit.
        let one_foreign = |rows: usize| {
            let mut table = with_angles(|at, deg| if at < rows { deg.to_radians() } else { deg });
            table.rows[count - 1].length_mm *= 3.0;
            mistake(&table, 0.0).map(|found| found.2)
        };
        assert_eq!([one_foreign(9), one_foreign(8)], [Some(10), None]);
        // Some lengths to a ball that is elsewhere agree about as well in gon; a whole table in gon agrees far better.
        assert_eq!(mistake(&lengths(), 90.0), None);
        let gon = with_angles(|_, deg| deg / 0.9);
        assert_eq!(mistake(&gon, 20.0).map(|found| found.1), Some("gon"));
    }

    /// `off_mm` is the error of the first `rows` lengths.
    fn far(rows: usize, off_mm: f64) -> Option<MeasurementFinding> {
        let mut table = lengths();
        table.rows[..rows].iter_mut().for_each(|row| row.length_mm += off_mm);
        far_rows(&table, &kr60(), &ball(0.0))
    }

    #[test]
    fn single_lengths_that_are_far_are_mistakes_and_all_of_them_another_cell() {
        let (index, count) = (lengths().rows[0].index, lengths().rows.len());
        let is_far = |rows: usize, mm: f64| match far(rows, mm) {
            Some(MeasurementFinding::FarLengths { rows: found, index: first, off_mm }) => {
                (found, first) == (rows, index) && (off_mm - mm.abs()).abs() < 1e-6
            }
            _ => false,
        };
        assert!(is_far(1, 101.0) && is_far(9, -150.0) && far(1, 99.0).is_none());
        // A quarter of the rows that are less than a cell off may belong to another ball.
        assert!(far(count / 4, 150.0).is_none() && is_far(count / 4, 251.0));
        assert!(far(count, 249.0).is_none());
        let Some(MeasurementFinding::FarFromAll { off_mm }) = far(count, -251.0) else {
            panic!("another cell is not found")
        };
        assert!((off_mm - 251.0).abs() < 1e-6);
    }

    #[test]
    fn angles_of_a_pendant_have_few_decimals() {
        let rounded = |step_deg: f64| {
            let table = with_angles(|_, deg| (deg / step_deg).round() * step_deg);
            match few_decimals(&table, &kr60()) {
                Some(MeasurementFinding::FewDecimals { rows, decimals, length_mm }) => {
                    assert_eq!(rows, table.rows.len());
                    // A uniform distribution over a step, at the reach of the robot.
                    let expected = (step_deg / 12f64.sqrt()).to_radians() * kr60().reach_mm();
                    assert!((length_mm / expected - 1.0).abs() < 1e-12);
                    Some(decimals)
                }
                _ => None,
            }
        };
        assert_eq!([1.0, 0.1, 0.01].map(rounded), [0, 1, 2].map(Some));
        // As commanded angles are, and as a controller logs them.
        assert_eq!([10.0, 0.001].map(rounded), [None, None]);
    }
}
