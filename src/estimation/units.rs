//! Whether lengths and axis angles are in the units that their columns name. A table in metres or radians is fitted as
//! well, by a robot that does not exist.

use crate::measurement::{BaseBall, Measurement};
use crate::robot::{AXES, Geometry};

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
    let agree = |axes: &dyn Fn(&Measurement) -> [f64; AXES], per_mm: f64| {
        let near = |row: &&Measurement| {
            expected(row, &axes(row))
                .is_some_and(|mm| (row.length_mm - per_mm * mm).abs() <= AGREES * per_mm * mm)
        };
        rows.len() >= FEWEST && rows.iter().filter(near).count() as f64 >= MOST * rows.len() as f64
    };
    if agree(&|row| row.axes.radians(), 1.0) {
        return None;
    }
    if let Some((unit, _)) = LENGTHS.iter().find(|(_, per_mm)| agree(&|row| row.axes.radians(), *per_mm)) {
        return Some(("length_mm", unit));
    }
    agree(&|row| row.axes.degrees(), 1.0).then_some(("a1_deg..a6_deg", "radians"))
}
