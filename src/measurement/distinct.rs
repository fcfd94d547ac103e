//! Rows that are in a table more than once.

use std::cmp::Ordering;

use super::{Measurement, Measurements};
use crate::catalogue::MeasurementFinding;

/// A table without its repeated rows.
#[derive(Clone, Debug)]
pub struct Distinct {
    pub measurements: Measurements,
    /// Measurements that were left out.
    pub repeated: usize,
}

impl Measurements {
    /// Each row once: of equal rows the first. Rows that differ only in their index are equal where half of the table is
    /// there twice; fewer can be a pose that was repeated, whose length came out the same.
    ///
    /// # Errors
    /// Different rows with one index.
    pub fn distinct(mut self) -> Result<Distinct, MeasurementFinding> {
        let rows = &self.rows;
        let mut repeated = Vec::new();
        if !rows.is_sorted_by(|a, b| a.index < b.index) {
            for [first, other] in equal_neighbours(rows, by_index) {
                if rows[first] != rows[other] {
                    return Err(MeasurementFinding::EqualIndices { index: rows[first].index });
                }
                repeated.push(other);
            }
        }
        let twins: Vec<usize> = equal_neighbours(rows, by_content)
            .into_iter()
            .filter(|[first, other]| rows[*first].context == rows[*other].context)
            .map(|[_, other]| other)
            .collect();
        if 2 * twins.len() >= rows.len() {
            repeated.extend(twins);
        }
        repeated.sort_unstable();
        repeated.dedup();
        // Of a position all coordinates repeat or none.
        let is_repeated = |at: usize| repeated.binary_search(&at).is_ok();
        let whole = |at: &usize| rows[*at].datum.rows(*at).all(is_repeated);
        let repeated: Vec<usize> = repeated.iter().copied().filter(whole).collect();
        let count = repeated.iter().filter(|at| rows[**at].datum.is_first()).count();
        let mut place = 0;
        self.rows.retain(|_| {
            place += 1;
            repeated.binary_search(&(place - 1)).is_err()
        });
        Ok(Distinct { measurements: self, repeated: count })
    }
}

impl Measurements {
    /// How many rows of the other table are in this one, whatever their index: as they were measured, before a change of the
    /// bar's zero was taken out, also where one of the two was rounded. A pose that was driven again has the same length to so
    /// many digits once in some fifty times.
    pub fn holds(&self, other: &Self) -> usize {
        let mut known: Vec<(f64, &Measurement)> =
            self.rows.iter().map(|row| (measured_mm(row), row)).collect();
        known.sort_unstable_by(|(a, _), (b, _)| a.total_cmp(b));
        let held = |row: &&Measurement| {
            let length_mm = measured_mm(row);
            let first = known.partition_point(|(known_mm, _)| *known_mm < length_mm - ROUNDED_MM);
            let near = known[first..].iter().take_while(|(known_mm, _)| *known_mm <= length_mm + ROUNDED_MM);
            near.into_iter().any(|(_, known)| is_rounded(known, row))
        };
        other.rows.iter().filter(held).count()
    }
}

/// A length with what was taken out of it as a change of the zero, mm.
fn measured_mm(row: &Measurement) -> f64 {
    row.length_mm + row.context.as_ref().and_then(|context| context.zero_mm).unwrap_or(0.0)
}

/// Half of the last digit of three decimals, mm, and of two, degrees, and a trifle for the binary numbers.
const ROUNDED_MM: f64 = 0.000_501;
const ROUNDED_DEG: f64 = 0.005_001;

/// Whether two rows of nearly one length are of one pose.
fn is_rounded(a: &Measurement, b: &Measurement) -> bool {
    let mut axes = a.axes.degrees().into_iter().zip(b.axes.degrees());
    (a.datum, a.target) == (b.datum, b.target) && axes.all(|(a, b)| (a - b).abs() <= ROUNDED_DEG)
}

/// By the index; the rows of a position, and those of several targets at one pose, may share theirs.
fn by_index(a: &Measurement, b: &Measurement) -> Ordering {
    let place = |row: &Measurement| row.datum.is_plane().then_some((row.datum, row.target));
    a.index.cmp(&b.index).then_with(|| place(a).cmp(&place(b)))
}

/// By what was measured, whatever its index.
fn by_content(a: &Measurement, b: &Measurement) -> Ordering {
    let sigma = |row: &Measurement| row.sigma_mm.unwrap_or(0.0);
    let axes = a.axes.degrees().into_iter().zip(b.axes.degrees());
    a.length_mm
        .total_cmp(&b.length_mm)
        .then_with(|| (a.datum, a.target).cmp(&(b.datum, b.target)))
        .then_with(|| sigma(a).total_cmp(&sigma(b)))
        .then_with(|| {
            axes.map(|(a, b)| a.total_cmp(&b)).find(|order| order.is_ne()).unwrap_or(Ordering::Equal)
        })
}

/// The places of rows that are equal by an order, each with the row before it that it equals.
fn equal_neighbours(
    rows: &[Measurement],
    order: impl Fn(&Measurement, &Measurement) -> Ordering,
) -> Vec<[usize; 2]> {
    let mut places: Vec<usize> = (0..rows.len()).collect();
    places.sort_unstable_by(|&a, &b| order(&rows[a], &rows[b]).then(a.cmp(&b)));
    let pairs = places.windows(2).map(|pair| [pair[0], pair[1]]);
    pairs.filter(|[a, b]| order(&rows[*a], &rows[*b]).is_eq()).collect()
}
