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
//! Missing records show as gaps in the numbers. Version 2 adds nothing to the kind and has no numbers.
//! Each record is written by one `write_all`: a killed process loses at most the record being written. The
//! reader continues after damage and reports it.
//!
//! `docs/reference/capture.md` describes the format byte by byte.

mod format;
mod pass;
mod reader;
pub mod record;
mod sample;
mod writer;

pub use pass::{Capture, CaptureSummary, read_capture};
pub use reader::{CaptureDamage, CapturePart, CaptureReader};
pub use record::{CaptureRecord, RunEnd, RunEvent, StampedRecord};
pub use writer::{CaptureWriter, Disk, Interference};

/// Whether the first bytes of a file are those of a capture, damaged or not: a file header, or the start of a record,
/// which no text contains.
pub fn is_capture(bytes: &[u8]) -> bool {
    bytes.starts_with(&format::FILE_MAGIC)
        || bytes.windows(format::MAGIC.len()).any(|some| some == format::MAGIC)
}
