//! Iteration over many measurements, piece by piece.

use super::PreparedMeasurement;
use crate::math::map_pieces;

/// Measurements that can be prepared one piece at a time, to save memory.
pub trait MeasurementPieces: Sync {
    /// Applies `work` to the index of the first measurement of each piece, to the piece, and to its standard deviations
    /// (mm). The slice of standard deviations is empty if all are 1, an excluded measurement has an infinite one. The results are
    /// in order.
    fn in_pieces<R: Send>(&self, work: impl Fn(usize, &[PreparedMeasurement], &[f64]) -> R + Sync) -> Vec<R>;
}

impl MeasurementPieces for [PreparedMeasurement] {
    fn in_pieces<R: Send>(&self, work: impl Fn(usize, &[PreparedMeasurement], &[f64]) -> R + Sync) -> Vec<R> {
        (self, &[][..]).in_pieces(work)
    }
}

impl MeasurementPieces for (&[PreparedMeasurement], &[f64]) {
    fn in_pieces<R: Send>(&self, work: impl Fn(usize, &[PreparedMeasurement], &[f64]) -> R + Sync) -> Vec<R> {
        let (measurements, sigma) = *self;
        map_pieces(measurements, |first, piece| {
            work(first, piece, sigma.get(first..first + piece.len()).unwrap_or(&[]))
        })
    }
}
