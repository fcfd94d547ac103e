//! Whether lengths, positions and axis angles are in the units that their columns name, and positions of this robot. A table in metres or radians is fitted as
//! well, by a robot that does not exist.

use nalgebra::Vector3;

use crate::catalogue::EstimationFinding::{self, PositionsElsewhere, PositionsMirrored};
use crate::math::Alignment;
use crate::measurement::{BaseBall, Measurement, Measurements, Position};
use crate::robot::{AXES, Geometry, Pose};

/// Units in which a length is given by mistake, and how many of them are a millimetre.
const LENGTHS: [(&str, f64); 3] = [("metres", 1e-3), ("inches", 1.0 / 25.4), ("micrometres", 1e3)];
/// A length agrees with the one expected when it is off by no more than this share: tool and ball are known to some centimetres.
const AGREES: f64 = 0.15;
/// So many of the lengths must agree.
const MOST: f64 = 0.9;
/// Fewer lengths agree by chance.
const FEWEST: usize = 4;

/// What the table seems to hold instead of millimetres and degrees: the column's name and its unit. The lengths are compared
/// with those that the nominal robot would give between its ball and the base balls.
pub(super) fn mistaken(
    geometry: &Geometry,
    centres: &[BaseBall],
    rows: &[Measurement],
) -> Option<(&'static str, &'static str)> {
    let expected = |row: &Measurement, axes: &[f64; AXES]| {
        let centre = centres.get(row.datum.ball()?.index())?;
        Some(geometry.length(axes, &centre.position, 0.0))
    };
    let lengths: Vec<&Measurement> = rows.iter().filter(|row| !row.datum.is_plane()).collect();
    let agree = |axes: &dyn Fn(&Measurement) -> [f64; AXES], per_mm: f64| {
        let near = |row: &&&Measurement| {
            expected(row, &axes(row))
                .is_some_and(|mm| (row.length_mm - per_mm * mm).abs() <= AGREES * per_mm * mm)
        };
        let count = lengths.len();
        count >= FEWEST && lengths.iter().filter(near).count() as f64 >= MOST * count as f64
    };
    if agree(&|row| row.axes.radians(), 1.0) {
        return None;
    }
    if let Some((unit, _)) = LENGTHS.iter().find(|(_, per_mm)| agree(&|row| row.axes.radians(), *per_mm)) {
        return Some(("length_mm", unit));
    }
    agree(&|row| row.axes.degrees(), 1.0).then_some(("a1_deg..a6_deg", "radians"))
}

/// Fewer positions follow any poses.
const FEWEST_POSITIONS: usize = 8;
/// Rounds of fitting the target and the frame in turn.
const ROUNDS: usize = 30;

/// What a table of positions seems to hold instead of millimetres and degrees, as [`mistaken`].
///
/// # Errors
/// Positions that no place of the tracker and of the target explains, in any unit.
pub(super) fn mistaken_positions(
    geometry: &Geometry,
    observations: &Measurements,
) -> Result<Option<(&'static str, &'static str)>, EstimationFinding> {
    let Some(target) = observations.positions().map(|position| position.target).min() else {
        return Ok(None);
    };
    let positions: Vec<Position> =
        observations.positions().filter(|position| position.target == target).collect();
    if positions.len() < FEWEST_POSITIONS {
        return Ok(None);
    }
    let places: Vec<Vector3<f64>> = positions.iter().map(|position| position.place).collect();
    let flanges = |factor: f64| -> Vec<Pose> {
        positions.iter().map(|position| geometry.flange(&position.axes.map(|angle| factor * angle))).collect()
    };
    let Some(found) = following(&places, &flanges(1.0), geometry.tool) else { return Ok(None) };
    let near = |scale: f64, per_mm: f64| (scale * per_mm - 1.0).abs() <= AGREES;
    if found.misfit <= AGREES {
        let other = LENGTHS.iter().find(|(_, per_mm)| near(found.scale, *per_mm));
        return Ok(other.map(|(unit, _)| ("x_mm..z_mm", *unit)));
    }
    let fits = |other: Option<Alignment>| {
        other.is_some_and(|other| other.misfit <= AGREES && near(other.scale, 1.0))
    };
    let in_radians = flanges(1f64.to_radians().recip());
    if fits(following(&places, &in_radians, geometry.tool)) {
        return Ok(Some(("a1_deg..a6_deg", "radians")));
    }
    let mirrored: Vec<Vector3<f64>> =
        places.iter().map(|place| Vector3::new(-place.x, place.y, place.z)).collect();
    Err(match fits(following(&mirrored, &flanges(1.0), geometry.tool)) {
        true => PositionsMirrored,
        false => PositionsElsewhere { misfit_percent: 100.0 * found.misfit },
    })
}

/// How places follow flanges by a target, from `target` on, and a frame that suit them best.
fn following(places: &[Vector3<f64>], flanges: &[Pose], mut target: Vector3<f64>) -> Option<Alignment> {
    let on_tool = |target: Vector3<f64>| -> Vec<Vector3<f64>> {
        flanges.iter().map(|flange| flange.position + flange.rotation * target).collect()
    };
    let mut found = Alignment::of(places, &on_tool(target))?;
    for _ in 0..ROUNDS {
        let there = places.iter().map(|place| found.rotation * (place * found.scale));
        let pairs: Vec<(Vector3<f64>, &Pose)> = there.zip(flanges).collect();
        // The frame's shift for this target, then the target for this shift.
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
        found = Alignment::of(places, &on_tool(target))?;
    }
    Some(found)
}
