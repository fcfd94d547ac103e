//! Positions of targets in the frame of a tracker, and their CSV. A position is three rows, one for each coordinate.

use std::fmt::Write;
use std::ops::Range;

use nalgebra::Vector3;

use super::table::{APPROACH, AXIS_COLUMNS, ApproachColumns, PAYLOAD, PayloadColumn, TARGET, angles};
use super::{Measurement, Measurements, context};
use crate::base::table::TableReader;
use crate::diagnostic::Diagnostic;
use crate::measurement::MeasurementFinding::NoMeasurement;
use crate::robot::{AXES, Coordinate, Datum, TargetId};

/// The columns by which a table of positions is recognised.
pub const PLACE: [&str; 3] = ["x_mm", "y_mm", "z_mm"];

/// A position of a target measured by a tracker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredPosition {
    /// The controller's axis angles, rad.
    pub axes: [f64; AXES],
    pub target: TargetId,
    /// Position of the target in the tracker's frame, mm.
    pub place: Vector3<f64>,
}

impl Datum {
    /// The range of rows of the measurement that row number `at` belongs to.
    pub(crate) fn rows(self, at: usize) -> Range<usize> {
        match self {
            Self::Ball(..) => at..at + 1,
            Self::Plane(coordinate) => at - coordinate.index()..at - coordinate.index() + 3,
        }
    }

    /// Whether this row is the first of its measurement.
    pub fn is_first(self) -> bool {
        !matches!(self, Self::Plane(Coordinate::Y | Coordinate::Z))
    }
}

impl Measurement {
    /// The three rows of a position, otherwise as this row.
    pub fn at_place(&self, place: [f64; 3]) -> [Self; 3] {
        Coordinate::ALL.map(|coordinate| {
            let (datum, length_mm) = (Datum::Plane(coordinate), place[coordinate.index()]);
            Self { datum, length_mm, ..self.clone() }
        })
    }
}

impl Measurements {
    /// Reads the CSV `a1_deg,..,a6_deg,x_mm,y_mm,z_mm[,index][,target][,sigma_mm][,approach1,..,approach6]`, columns in any
    /// order. The default target is the tool ball, the default index the row number; `sigma_mm` applies to each coordinate.
    pub fn positions_from_table(table: &mut TableReader<'_>) -> Result<Self, Diagnostic> {
        let (axes, place) = (table.required(AXIS_COLUMNS)?, table.required(PLACE)?);
        let (index, target) = (table.optional("index")?, table.optional(TARGET)?);
        let (sigma, approach) = (table.optional("sigma_mm")?, ApproachColumns::of(table)?);
        let mut payloads = PayloadColumn::of(table)?;
        let mut rows = Vec::new();
        let mut number = 0;
        while let Some(row) = table.row()? {
            number += 1;
            let of_position = Measurement {
                index: row.given(index, |at| row.whole(at, 0))?.unwrap_or(number),
                datum: Datum::Plane(Coordinate::X),
                target: row.given(target, |at| row.numbered(at))?.unwrap_or(TargetId::FIRST),
                axes: angles(&row, axes)?,
                approach: approach.read(&row)?,
                length_mm: 0.0,
                sigma_mm: row.given(sigma, |at| row.positive(at))?,
                payload: payloads.read(&row),
                context: None,
            };
            let [x, y, z] = place;
            rows.extend(of_position.at_place([row.number(x)?, row.number(y)?, row.number(z)?]));
        }
        if rows.is_empty() {
            return Err(Diagnostic::file(table.file(), NoMeasurement));
        }
        let read = Self::new(rows, Vec::new()).map_err(|finding| Diagnostic::file(table.file(), finding))?;
        Ok(Self { payloads: payloads.names, ..read })
    }

    /// The positions among the rows.
    pub fn positions(&self) -> impl Iterator<Item = MeasuredPosition> {
        self.triples().map(|(_, rows)| MeasuredPosition {
            axes: rows[0].axes.radians(),
            target: rows[0].target,
            place: Vector3::from_fn(|axis, _| rows[axis].length_mm),
        })
    }

    /// The three rows of each position, with the index of the first.
    fn triples(&self) -> impl Iterator<Item = (usize, &[Measurement])> {
        let firsts = self.rows.iter().enumerate().filter(|(_, row)| row.datum == Datum::Plane(Coordinate::X));
        firsts.filter_map(|(at, row)| Some((at, self.rows.get(row.datum.rows(at))?)))
    }

    /// The CSV of the positions for which `keep` accepts the index of their first row; `None` if the table has no positions.
    /// Every number reads back bit for bit.
    pub fn positions_csv(&self, keep: impl Fn(usize) -> bool) -> Option<String> {
        let firsts = || self.triples().map(|(_, rows)| &rows[0]);
        firsts().next()?;
        let targets = firsts().any(|row| row.target != TargetId::FIRST);
        let sigmas = firsts().any(|row| row.sigma_mm.is_some());
        let approach = firsts().any(|row| !row.approach.is_unknown());
        let mut text = format!("index,{},{}", AXIS_COLUMNS.join(","), PLACE.join(","));
        let further = [(targets, TARGET), (sigmas, "sigma_mm")].into_iter();
        let further = further.chain(APPROACH.map(|name| (approach, name))).filter(|(is_there, _)| *is_there);
        further.for_each(|(_, name)| text.extend([",", name]));
        let payloads = self.payloads.len() > 1;
        if payloads {
            text.extend([",", PAYLOAD]);
        }
        text.push('\n');
        for (_, rows) in self.triples().filter(|(at, _)| keep(*at)) {
            let first = &rows[0];
            // Writing to a string does not fail.
            let _ = write!(text, "{}", first.index);
            let numbers = first.axes.degrees().into_iter().chain(rows.iter().map(|row| row.length_mm));
            for number in numbers {
                let _ = write!(text, ",{number}");
            }
            if targets {
                let _ = write!(text, ",{}", first.target);
            }
            if sigmas {
                text.push(',');
                text.extend(first.sigma_mm.map(|sigma| sigma.to_string()));
            }
            if approach {
                first.append_approach(&mut text);
            }
            if payloads {
                let name = self.payloads.get(first.payload.index()).map_or("", String::as_str);
                let _ = write!(text, ",{}", context::quoted(name));
            }
            text.push('\n');
        }
        Some(text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_are_three_rows_and_read_back() {
        let text = "index,a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg,x_mm,y_mm,z_mm,target,sigma_mm\n\
                    4,1,2,3,4,5,6,10.5,-20,30,1,0.05\n7,1,2,3,4,5,60,11,21,31,2,\n";
        let read = Measurements::positions_from_table(&mut TableReader::of("t.csv", text).unwrap()).unwrap();
        assert_eq!((read.rows.len(), read.count(), read.targets()), (6, 2, 2));
        assert_eq!((read.rows[1].length_mm, read.rows[5].length_mm, read.rows[5].index), (-20.0, 31.0, 7));
        let positions: Vec<MeasuredPosition> = read.positions().collect();
        assert_eq!(
            (positions[1].place, positions[1].target),
            (Vector3::new(11.0, 21.0, 31.0), TargetId::at(1))
        );
        assert!((positions[1].axes[5] - 60f64.to_radians()).abs() < 1e-15);
        assert_eq!(read.positions_csv(|_| true).as_deref(), Some(text));
        let second = read.positions_csv(|first| first == 3).unwrap();
        assert_eq!(second.lines().nth(1), text.lines().nth(2));
        assert_eq!(Measurements::default().positions_csv(|_| true), None);
    }

    #[test]
    fn a_row_knows_the_rows_of_its_measurement() {
        let length = Datum::Ball(crate::robot::BallId::FIRST, crate::robot::BarId::FIRST);
        assert_eq!((length.rows(5), length.is_first()), (5..6, true));
        let planes = Coordinate::ALL.map(Datum::Plane);
        assert_eq!([planes[0].rows(6), planes[1].rows(7), planes[2].rows(8)], [6..9, 6..9, 6..9]);
        assert_eq!(planes.map(Datum::is_first), [true, false, false]);
    }
}
