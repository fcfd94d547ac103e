//! Many readings as a computation goes over them: piece by piece, as often as it likes.

use super::Reading;
use crate::linalg::map_pieces;

/// Readings that come in pieces, so that no more of them need be made ready at a time.
pub trait Readings: Sync {
    /// Applies `work` to each piece and to the standard deviations (mm) that weigh its readings, in order; these are
    /// absent where all weigh alike, and infinite for a reading that is left out.
    fn in_pieces<R: Send>(&self, work: impl Fn(&[Reading], &[f64]) -> R + Sync) -> Vec<R>;
}

impl Readings for [Reading] {
    fn in_pieces<R: Send>(&self, work: impl Fn(&[Reading], &[f64]) -> R + Sync) -> Vec<R> {
        (self, &[][..]).in_pieces(work)
    }
}

impl Readings for (&[Reading], &[f64]) {
    fn in_pieces<R: Send>(&self, work: impl Fn(&[Reading], &[f64]) -> R + Sync) -> Vec<R> {
        let (readings, sigma) = *self;
        map_pieces(readings, |first, piece| work(piece, sigma.get(first..first + piece.len()).unwrap_or(&[])))
    }
}
