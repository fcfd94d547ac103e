//! The only place that splits work over cores.

use std::num::NonZero;
use std::panic::resume_unwind;
use std::thread;

/// Items that one piece of work takes: pieces are the same on any number of cores, and so are results.
const PIECE: usize = 4096;

/// Applies `work` to each piece of `items` (with the index of its first item), on all cores when
/// there is more than one piece; the results come in order.
pub fn map_pieces<T: Sync, R: Send>(items: &[T], work: impl Fn(usize, &[T]) -> R + Sync) -> Vec<R> {
    in_pieces(items, PIECE, work)
}

/// Applies `work` to each of `items` that take long, on all cores; the results come in order.
pub fn map_items<T: Sync, R: Send>(items: &[T], work: impl Fn(&T) -> R + Sync) -> Vec<R> {
    in_pieces(items, 1, |_, piece| piece.iter().map(&work).collect::<Vec<R>>())
        .into_iter()
        .flatten()
        .collect()
}

fn in_pieces<T: Sync, R: Send>(items: &[T], size: usize, work: impl Fn(usize, &[T]) -> R + Sync) -> Vec<R> {
    let pieces: Vec<(usize, &[T])> =
        items.chunks(size).enumerate().map(|(n, piece)| (n * size, piece)).collect();
    let in_turn = || pieces.iter().map(|(first, piece)| work(*first, piece)).collect();
    // To ask for the number of cores costs more than a small piece of work.
    if pieces.len() < 2 {
        return in_turn();
    }
    let cores = thread::available_parallelism().map_or(1, NonZero::get).min(pieces.len());
    if cores < 2 {
        return in_turn();
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
        // What panicked there goes on here: a result without its pieces would be a wrong one.
        let joined = |worker: thread::ScopedJoinHandle<'_, _>| {
            worker.join().unwrap_or_else(|panic| resume_unwind(panic))
        };
        workers.into_iter().flat_map(joined).collect()
    });
    done.sort_by_key(|(n, _)| *n);
    done.into_iter().map(|(_, result)| result).collect()
}
