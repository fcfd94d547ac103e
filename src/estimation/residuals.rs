//! Residuals of lengths, summed up in one pass.

use super::lengths::Weighted;
use super::result::{BeforeAfter, Residual};
use crate::measurement::{LengthModel, MeasurementPieces, Measurements, PreparedMeasurement};

/// Residuals as they add up.
#[derive(Clone, Copy, Default)]
struct Tally {
    count: usize,
    sum: f64,
    squares: f64,
    max: f64,
}

impl Tally {
    fn add(&mut self, residual: f64) {
        *self =
            self.with(Self { count: 1, sum: residual, squares: residual * residual, max: residual.abs() });
    }

    fn with(self, other: Self) -> Self {
        Self {
            count: self.count + other.count,
            sum: self.sum + other.sum,
            squares: self.squares + other.squares,
            max: self.max.max(other.max),
        }
    }

    fn residual(self) -> Residual {
        let count = self.count.max(1) as f64;
        Residual { rms: (self.squares / count).sqrt(), mean: self.sum / count, max: self.max }
    }
}

/// The residuals of the lengths that were used; `None` when one of all, or the sum of their squares, is not finite.
pub(super) fn residuals(before: &LengthModel, after: &LengthModel, used: &Weighted) -> Option<BeforeAfter> {
    let (before, after) = (before.prepare(), after.prepare());
    let pieces = used.in_pieces(|_, readings, sigma| {
        let (mut tallies, mut finite) = ([Tally::default(); 2], true);
        for (reading, sigma) in readings.iter().zip(sigma) {
            let residuals = [&before, &after].map(|model| reading.length_mm - model.length(reading));
            finite &= residuals[1].is_finite();
            if *sigma != f64::INFINITY {
                tallies.iter_mut().zip(residuals).for_each(|(tally, residual)| tally.add(residual));
            }
        }
        finite.then_some(tallies)
    });
    let mut sums = [Tally::default(); 2];
    for tallies in pieces {
        let [before, after] = tallies?;
        sums = [sums[0].with(before), sums[1].with(after)];
    }
    let [before, after] = sums.map(Tally::residual);
    (before.rms.is_finite() && after.rms.is_finite()).then_some(BeforeAfter { before, after })
}

/// The residuals of other lengths; `None` when the sum of their squares is not finite.
pub(super) fn residual_on(model: &LengthModel, set: &Measurements) -> Option<Residual> {
    let prepared = model.prepare();
    let mut tally = Tally::default();
    for reading in set.rows.iter().map(PreparedMeasurement::from) {
        tally.add(reading.length_mm - prepared.length(&reading));
    }
    Some(tally.residual()).filter(|residual| residual.rms.is_finite())
}
