//! A run on disk: an append-only log of records that survives a kill.
//!
//! A file is a header of 16 bytes (the magic `DBBDCAP\n`, the format's version as u32, the CRC-32C of
//! these twelve bytes) and records, all numbers little-endian:
//!
//! | bytes | what |
//! |---|---|
//! | 4 | magic `DB BD 5A A5` |
//! | 1 | kind: 1 attachment, 2 raw, 4 fault, 5 event, 6 samples, 7 axes, with 128 added |
//! | 4 | length n of number and payload |
//! | 8 | host time, ns |
//! | 4 | number of the record, from 0, modulo 2^32 |
//! | n - 4 | payload |
//! | 4 | CRC-32C over kind to payload |
//!
//! A record that is missing shows in the numbers. In version 2 nothing is added to the kind, and there are no
//! numbers. Each record is written by one `write_all`, so a kill loses at most the record being written; the
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

pub use disk::{Disk, Interference};
pub use pass::Pass;
pub use reader::{Damage, Part, Reader};
pub use record::{Event, Record, RunEnd, Stamped};
pub use whole::{Capture, read};
pub use writer::Writer;

/// Whether bytes from the beginning of a file are those of a capture, damaged or not: its header, or the begin of a
/// record, which no text holds.
pub fn is_capture(bytes: &[u8]) -> bool {
    bytes.starts_with(&format::FILE_MAGIC)
        || bytes.windows(format::MAGIC.len()).any(|some| some == format::MAGIC)
}
