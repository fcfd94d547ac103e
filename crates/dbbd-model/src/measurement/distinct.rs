//! Repeated rows of a table.

use std::cmp::Ordering;

use super::{Measurement, Measurements};
use crate::math::distributions::binomial_tail;
use crate::measurement::MeasurementFinding;

#[derive(Clone, Debug)]
pub struct DistinctMeasurements {
    pub measurements: Measurements,
    /// Number of measurements that were removed as repeated.
    pub repeated: usize,
}

impl Measurements {
    /// Keeps the first of equal rows. Rows that differ only in their index count as equal only if at least half of the
    /// table is repeated in this way: a few can be a pose that was measured again with the same length.
    ///
    /// # Errors
    /// Different rows with the same index.
    pub fn distinct(mut self) -> Result<DistinctMeasurements, MeasurementFinding> {
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
        // The three rows of a position are repeated only together.
        let is_repeated = |at: usize| repeated.binary_search(&at).is_ok();
        let all_repeated = |at: &usize| rows[*at].datum.rows(*at).all(is_repeated);
        let repeated: Vec<usize> = repeated.iter().copied().filter(all_repeated).collect();
        let count = repeated.iter().filter(|at| rows[**at].datum.is_first()).count();
        let mut place = 0;
        self.rows.retain(|_| {
            place += 1;
            repeated.binary_search(&(place - 1)).is_err()
        });
        Ok(DistinctMeasurements { measurements: self, repeated: count })
    }

    /// Whether one of two tables has rows of the other, beyond chance: no robot measures twice alike.
    pub fn repeats(&self, other: &Self) -> bool {
        let beyond_chance = |held: usize, of: &Self| are_lengths_known(held, of.rows.len());
        beyond_chance(self.holds(other), other) || beyond_chance(other.holds(self), self)
    }

    /// The number of rows of `other` that are in this table too. The index and rounding of one of the two tables do not
    /// matter.
    pub fn holds(&self, other: &Self) -> usize {
        let mut known: Vec<&Measurement> = self.rows.iter().collect();
        known.sort_unstable_by(|a, b| a.length_mm.total_cmp(&b.length_mm));
        let is_held = |row: &&Measurement| {
            let first = known.partition_point(|known| known.length_mm < row.length_mm - ROUNDED_MM);
            let mut near =
                known[first..].iter().take_while(|known| known.length_mm <= row.length_mm + ROUNDED_MM);
            near.any(|known| is_same_pose(known, row))
        };
        other.rows.iter().filter(is_held).count()
    }
}

/// Probability that a length of a pose that was measured again agrees with the earlier one to [`ROUNDED_MM`], with lengths that
/// repeat to 3 um. With 14 um it is 2 %.
const AGREES: f64 = 0.1;
/// Probability with which lengths that are new count as known.
const FALSE_ALARM: f64 = 1e-3;

/// Whether some of the lengths are known, if so many agree with known ones. All that agree are a copy, however few they are.
pub fn are_lengths_known(held: usize, lengths: usize) -> bool {
    held > 0 && (held == lengths || binomial_tail(held, lengths, AGREES) < FALSE_ALARM)
}

/// Half of the third decimal (mm) and of the second (degrees), with a margin for binary rounding.
const ROUNDED_MM: f64 = 0.000_501;
const ROUNDED_DEG: f64 = 0.005_001;

fn is_same_pose(a: &Measurement, b: &Measurement) -> bool {
    let mut axes = a.axes.degrees().into_iter().zip(b.axes.degrees());
    (a.datum, a.target) == (b.datum, b.target) && axes.all(|(a, b)| (a - b).abs() <= ROUNDED_DEG)
}

/// Compares indices. The rows of a position, and of several targets at one pose, may share an index.
fn by_index(a: &Measurement, b: &Measurement) -> Ordering {
    let place = |row: &Measurement| row.datum.is_plane().then_some((row.datum, row.target));
    a.index.cmp(&b.index).then_with(|| place(a).cmp(&place(b)))
}

/// Compares everything but the index.
fn by_content(a: &Measurement, b: &Measurement) -> Ordering {
    let sigma = |row: &Measurement| row.sigma_mm.unwrap_or(0.0);
    let axes = a.axes.degrees().into_iter().zip(b.axes.degrees());
    a.length_mm
        .total_cmp(&b.length_mm)
        .then_with(|| (a.datum, a.target).cmp(&(b.datum, b.target)))
        .then_with(|| sigma(a).total_cmp(&sigma(b)))
        .then_with(|| axes.fold(Ordering::Equal, |order, (a, b)| order.then_with(|| a.total_cmp(&b))))
}

/// Pairs of places whose rows are equal by `order`; the second is the later row.
fn equal_neighbours(
    rows: &[Measurement],
    order: impl Fn(&Measurement, &Measurement) -> Ordering,
) -> Vec<[usize; 2]> {
    let mut places: Vec<usize> = (0..rows.len()).collect();
    places.sort_unstable_by(|&a, &b| order(&rows[a], &rows[b]).then(a.cmp(&b)));
    let pairs = places.windows(2).map(|pair| [pair[0], pair[1]]);
    pairs.filter(|[a, b]| order(&rows[*a], &rows[*b]).is_eq()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(rows: &[(u32, f64, f64)]) -> Measurements {
        let header = "index,centre,a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg,length_mm\n";
        let row = |(index, axis, length): &(u32, f64, f64)| format!("{index},1,{axis},0,0,0,0,0,{length}\n");
        Measurements::from_csv("t.csv", &[header.to_owned(), rows.iter().map(row).collect()].concat())
            .unwrap()
    }

    fn kept(rows: &[(u32, f64, f64)]) -> (Vec<u32>, usize) {
        let found = table(rows).distinct().unwrap();
        (found.measurements.rows.iter().map(|row| row.index).collect(), found.repeated)
    }

    #[test]
    fn the_first_of_equal_rows_is_kept() {
        assert_eq!(kept(&[(1, 0.0, 300.0), (2, 1.0, 301.0), (1, 0.0, 300.0)]), (vec![1, 2], 1));
        // One of three with another index may have been measured again, two of four are a table that is there twice.
        assert_eq!(kept(&[(1, 0.0, 300.0), (2, 1.0, 301.0), (3, 0.0, 300.0)]), (vec![1, 2, 3], 0));
        assert_eq!(
            kept(&[(1, 0.0, 300.0), (2, 1.0, 301.0), (3, 0.0, 300.0), (4, 1.0, 301.0)]),
            (vec![1, 2], 2)
        );
        let other = table(&[(1, 0.0, 300.0), (1, 0.0, 300.1)]).distinct();
        assert!(matches!(other, Err(MeasurementFinding::EqualIndices { index: 1 })));
    }

    /// Lengths rounded to 1 um and angles to 0.01 degrees agree to half of that.
    #[test]
    fn rows_of_another_table_are_recognised() {
        let known = table(&[(1, 10.0, 300.0), (2, 20.0, 301.0), (3, 30.0, 302.0)]);
        let held = |axis, length| known.holds(&table(&[(9, axis, length)]));
        assert_eq!([held(20.0, 301.0005), held(20.0, 300.9995), held(20.005, 301.0)], [1, 1, 1]);
        assert_eq!(
            [held(20.0, 301.0006), held(20.0, 300.9994), held(20.006, 301.0), held(10.0, 301.0)],
            [0; 4]
        );
        assert_eq!(known.holds(&known), 3);
        // A copy may have a share of the rows; one of two may agree by chance.
        let (copy, by_chance) = (table(&[(9, 20.0, 301.0)]), table(&[(1, 10.0, 300.2), (2, 20.0, 301.0)]));
        assert!(known.repeats(&copy) && copy.repeats(&known));
        assert!(!known.repeats(&by_chance) && !by_chance.repeats(&known));
    }

    /// Sums in exact arithmetic: with a chance of a tenth, 6 of 12 have a probability of 5e-4 and 5 of 12 of 4e-3, 9 of 24 of
    /// 4e-4 and 8 of 24 of 2e-3. A third of a table that overlaps another one is known.
    #[test]
    fn a_part_of_a_table_is_known_beyond_chance() {
        let known = are_lengths_known;
        assert_eq!(
            [known(0, 0), known(0, 1), known(1, 1), known(1, 2), known(2, 2)],
            [false, false, true, false, true]
        );
        assert_eq!([known(5, 12), known(6, 12), known(8, 24), known(9, 24)], [false, true, false, true]);
        let rows = |from: u32| -> Vec<(u32, f64, f64)> {
            (from..from + 30).map(|at| (at, f64::from(at), 300.0 + f64::from(at))).collect()
        };
        let [monday, tuesday, wednesday] = [1, 21, 26].map(|from| table(&rows(from)));
        assert!(monday.repeats(&tuesday) && !monday.repeats(&wednesday));
    }
}
