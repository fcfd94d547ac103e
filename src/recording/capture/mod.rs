//! A run on disk: an append-only log of records that survives a kill.
//!
//! A file is a header of 16 bytes (the magic `DBBDCAP\n`, the format's version as u32, the CRC-32C of
//! these twelve bytes) and records, all numbers little-endian:
//!
//! | bytes | what |
//! |---|---|
//! | 4 | magic `DB BD 5A A5` |
//! | 1 | kind: 1 attachment, 2 raw, 4 fault, 5 event, 6 samples |
//! | 4 | length n of the payload |
//! | 8 | host time, ns |
//! | n | payload |
//! | 4 | CRC-32C over kind to payload |
//!
//! Each record is written by one `write_all`, so a kill loses at most the record being written; the
//! reader goes on after every damage and names it.
//!
//! `docs/reference/capture.md` describes it byte by byte.

mod disk;
mod format;
mod pass;
mod reader;
pub mod record;
mod sample;
mod whole;
mod writer;

pub use disk::Disk;
pub use pass::Pass;
pub use reader::{Damage, Part, Reader};
pub use record::{Event, Record, Stamped};
pub use whole::{Capture, read};
pub use writer::Writer;

/// Transitional name: an error of the writer is a diagnostic as any other.
pub type WriteError = crate::diagnostic::Diagnostic;
