//! Data that threads share.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// The data of a mutex. A thread that panics ends the process, so none leaves them half changed.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
