//! Many measurements as a computation goes over them: piece by piece, as often as it likes.

use super::PreparedMeasurement;
use crate::math::map_pieces;

/// Measurements that come in pieces, so that no more of them need be prepared at a time.
pub trait MeasurementPieces: Sync {
    /// Applies `work` to the place of the first of each piece, to the piece, and to the standard deviations (mm) that
    /// weigh its measurements, in order; these are absent where all weigh alike, and infinite for a measurement that is left out.
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
