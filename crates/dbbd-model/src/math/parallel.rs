//! Distributes work over processor cores.

use std::num::NonZero;
use std::panic::resume_unwind;
use std::thread;

/// Items of one piece of work. The pieces, and so the results, do not depend on the number of cores.
const PIECE: usize = 4096;

/// Applies `work` to the index of the first item of each piece and to the piece, on all cores. The results are in order.
pub fn map_pieces<T: Sync, R: Send>(items: &[T], work: impl Fn(usize, &[T]) -> R + Sync) -> Vec<R> {
    in_pieces(items, PIECE, work)
}

/// Applies `work` to each item, on all cores: for items that take long. The results are in order.
pub fn map_items<T: Sync, R: Send>(items: &[T], work: impl Fn(&T) -> R + Sync) -> Vec<R> {
    in_pieces(items, 1, |_, piece| work(&piece[0]))
}

fn in_pieces<T: Sync, R: Send>(items: &[T], size: usize, work: impl Fn(usize, &[T]) -> R + Sync) -> Vec<R> {
    let pieces: Vec<(usize, &[T])> =
        items.chunks(size).enumerate().map(|(n, piece)| (n * size, piece)).collect();
    // Asking for the number of cores costs more than a small piece of work.
    let cores = match pieces.len() {
        0 | 1 => 1,
        count => thread::available_parallelism().map_or(1, NonZero::get).min(count),
    };
    if cores == 1 {
        return pieces.iter().map(|(first, piece)| work(*first, piece)).collect();
    }
    let (pieces, work) = (&pieces, &work);
    let mut done: Vec<(usize, R)> = thread::scope(|scope| {
        let workers: Vec<_> = (0..cores)
            .map(|core| {
                scope.spawn(move || {
                    let mine = (core..pieces.len()).step_by(cores);
                    mine.map(|n| (n, work(pieces[n].0, pieces[n].1))).collect::<Vec<_>>()
                })
            })
            .collect();
        // A panic of a worker continues here: a result without its piece would be wrong.
        let joined = |worker: thread::ScopedJoinHandle<'_, _>| {
            worker.join().unwrap_or_else(|panic| resume_unwind(panic))
        };
        workers.into_iter().flat_map(joined).collect()
    });
    done.sort_by_key(|(n, _)| *n);
    done.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_know_their_first_item_and_results_are_in_order() {
        let items: Vec<usize> = (0..2 * PIECE + 5).collect();
        let firsts = map_pieces(&items, |first, piece| (first, piece[0], piece.len()));
        assert_eq!(firsts, [(0, 0, PIECE), (PIECE, PIECE, PIECE), (2 * PIECE, 2 * PIECE, 5)]);
        assert_eq!(map_items(&[3, 1, 2], |item| item * 10), [30, 10, 20]);
        assert!(map_items(&[0; 0], |item| *item).is_empty());
    }
}
