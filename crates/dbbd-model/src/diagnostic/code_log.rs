//! The codes that the tests provoke: debug builds append each code that a finding is asked for to the file that
//! `DBBD_CODE_LOG` names.
//!
//! A finding that is printed, serialised or compared in a test is asked for its code; a finding that nobody looks at is
//! not logged. Tests run in parallel in several processes: an append of one line is atomic, and a process writes a code
//! once.

use super::FindingCode;

#[cfg(debug_assertions)]
pub fn log_code(code: FindingCode) {
    use std::collections::BTreeSet;
    use std::ffi::OsString;
    use std::io::Write;
    use std::sync::{LazyLock, Mutex, PoisonError};

    static LOG: LazyLock<Option<OsString>> = LazyLock::new(|| std::env::var_os("DBBD_CODE_LOG"));
    static LOGGED: Mutex<BTreeSet<FindingCode>> = Mutex::new(BTreeSet::new());

    let Some(path) = &*LOG else { return };
    if !LOGGED.lock().unwrap_or_else(PoisonError::into_inner).insert(code) {
        return;
    }
    // A code that could not be written is missed by the check of the log.
    if let Ok(mut log) = std::fs::OpenOptions::new().create(true).append(true).open(path) {
        let _ = log.write_all(format!("{code}\n").as_bytes());
    }
}

#[cfg(not(debug_assertions))]
pub fn log_code(_: FindingCode) {}
