//! The offset, drift and jumps of each bar.

use nalgebra::{DMatrix, DVector};

use super::{Assumptions, BarHistory, EPOCH_DAYS, Jump, Knot, ValueWithSd, YEAR_DAYS};

/// Prior standard deviations of a bar's drift, mm a year, and of a jump, mm.
const DRIFT_MM: f64 = 0.05;
const JUMP_MM: f64 = 1.0;

/// An unknown of a bar, given by its number.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Column {
    Offset(usize),
    Drift(usize),
    /// A jump of a bar that acts from an epoch on.
    Jump(usize, i64),
}

impl Column {
    /// Coefficient of the unknown in the offset of a bar at an epoch; `first` is the plant's first epoch.
    fn value(self, (bar, epoch): Knot, first: i64) -> f64 {
        match self {
            Self::Offset(own) => f64::from(u8::from(own == bar)),
            Self::Drift(own) if own == bar => (epoch - first) as f64 * EPOCH_DAYS / YEAR_DAYS,
            Self::Drift(_) => 0.0,
            Self::Jump(own, from) => f64::from(u8::from(own == bar && epoch >= from)),
        }
    }

    pub(super) fn prior_sd(self, assumed: &Assumptions) -> f64 {
        match self {
            Self::Offset(_) => assumed.bar_u_mm,
            Self::Drift(_) => DRIFT_MM,
            Self::Jump(..) => JUMP_MM,
        }
    }

    /// The design matrix of the offsets at `knots`.
    pub(super) fn design(columns: &[Self], knots: &[Knot]) -> DMatrix<f64> {
        let first = knots.iter().map(|(_, epoch)| *epoch).min().unwrap_or(0);
        DMatrix::from_fn(knots.len(), columns.len(), |at, column| columns[column].value(knots[at], first))
    }

    /// A jump at each epoch of a bar but its first.
    pub(super) fn jumps(knots: &[Knot]) -> Vec<Self> {
        let first_of = |bar: usize| knots.iter().filter(|knot| knot.0 == bar).map(|knot| knot.1).min();
        let later = knots.iter().filter(|(bar, epoch)| first_of(*bar) != Some(*epoch));
        later.map(|(bar, epoch)| Self::Jump(*bar, *epoch)).collect()
    }
}

/// The histories of the bars from the values of the columns and their covariance.
pub(super) fn histories(
    bars: &[String],
    knots: &[Knot],
    columns: &[Column],
    values: &DVector<f64>,
    covariance: &DMatrix<f64>,
) -> Vec<BarHistory> {
    let epochs = knots.iter().map(|(_, epoch)| *epoch);
    let (first, last) = (epochs.clone().min().unwrap_or(0), epochs.max().unwrap_or(0));
    let along = |row: DVector<f64>| ValueWithSd {
        value: row.dot(values),
        sd: (row.dot(&(covariance * &row))).max(0.0).sqrt(),
    };
    let unit = |wanted: Column| {
        along(DVector::from_fn(columns.len(), |at, _| f64::from(u8::from(columns[at] == wanted))))
    };
    let jump = |bar: usize, from: i64| {
        let before = knots.iter().filter(|knot| knot.0 == bar && knot.1 < from).map(|knot| knot.1).max();
        Jump {
            after_day: before.unwrap_or(from) as f64 * EPOCH_DAYS,
            before_day: (from + 1) as f64 * EPOCH_DAYS,
            change_mm: unit(Column::Jump(bar, from)),
        }
    };
    let history = |(bar, name): (usize, &String)| {
        let own_jump = |column: &Column| {
            let Column::Jump(own, from) = *column else { return None };
            (own == bar).then(|| jump(bar, from))
        };
        let now = |at: usize, _| columns[at].value((bar, last), first);
        BarHistory {
            bar: name.clone(),
            offset_mm: unit(Column::Offset(bar)),
            drift_mm_a_year: unit(Column::Drift(bar)),
            jumps: columns.iter().filter_map(own_jump).collect(),
            offset_now_mm: along(DVector::from_fn(columns.len(), now)),
        }
    };
    bars.iter().enumerate().map(history).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A drift begins at the plant's first epoch, a jump acts from its epoch on; other bars have neither.
    #[test]
    fn offset_of_a_bar_at_a_knot() {
        let columns = [Column::Offset(0), Column::Drift(0), Column::Jump(0, 9), Column::Drift(1)];
        let years = |epochs: f64| epochs * EPOCH_DAYS / YEAR_DAYS;
        let design = Column::design(&columns, &[(0, 9), (1, 5), (0, 3)]);
        let expected = [[1.0, years(6.0), 1.0, 0.0], [0.0, 0.0, 0.0, years(2.0)], [1.0, 0.0, 0.0, 0.0]];
        assert_eq!(design, DMatrix::from_fn(3, 4, |row, column| expected[row][column]));
    }

    #[test]
    fn a_bar_may_jump_at_each_epoch_but_its_first() {
        let jumps = Column::jumps(&[(0, 9), (1, 5), (0, 3), (0, 4)]);
        assert!(jumps == [Column::Jump(0, 9), Column::Jump(0, 4)]);
    }
}
