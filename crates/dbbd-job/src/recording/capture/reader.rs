//! Reads a capture in one pass and past every damage, with at most its longest record in memory.

use std::io::{self, Read};

use super::format::{self, HEAD_LEN, HEADER_LEN, MAGIC, ParsedRecord};
use super::record::StampedRecord;
use crate::recording::RecordingFinding;

/// Least number of bytes read from the source at once.
const CHUNK: usize = 1 << 18;
/// A candidate for a record of at most this length is always checked.
const SHORT: usize = 1 << 10;
/// Number of bytes that may be checked for records in vain: a fixed number, and more for each byte of the file. The
/// limit bounds the time for a file of forged record heads.
const WASTE: u64 = format::MAX_PAYLOAD_BYTES as u64;
const WASTE_PER_BYTE: u64 = 4;

#[derive(Clone, Debug, PartialEq)]
pub enum CapturePart {
    Record(StampedRecord),
    Damage(CaptureDamage),
}

/// A range of bytes that is no complete record.
#[derive(Clone, Debug, PartialEq)]
pub struct CaptureDamage {
    pub offset: u64,
    pub bytes: u64,
    pub finding: RecordingFinding,
}

/// The parts of a capture in order; together they cover every byte after the file header. Only the source can
/// fail, never the content. The time is linear in the number of bytes.
#[derive(Debug)]
pub struct CaptureReader<R> {
    source: R,
    /// Bytes that were read; the bytes from `at` on are not delivered yet.
    buffer: Vec<u8>,
    at: usize,
    /// File offset of the next byte.
    offset: u64,
    ended: bool,
    version: Option<u32>,
    /// Whether the file has no valid header, and this is not reported yet.
    headless: bool,
    /// Number expected for the next record; `None` after damage, which explains the gap.
    number: Option<u32>,
    /// Bytes that were checked as candidates and were no record.
    wasted_bytes: u64,
}

/// Position of a record according to its number.
enum RecordPlace {
    Next,
    /// This many records before the record are missing.
    Ahead(u32),
    /// The record was read before.
    Behind,
}

impl<R: Read> CaptureReader<R> {
    pub fn new(source: R) -> io::Result<Self> {
        let mut reader = Self {
            source,
            buffer: Vec::new(),
            at: 0,
            offset: 0,
            ended: false,
            version: None,
            headless: true,
            number: None,
            wasted_bytes: 0,
        };
        reader.fill(HEADER_LEN)?;
        reader.version = format::version(reader.rest());
        if reader.version.is_some() {
            (reader.headless, reader.number) = (false, Some(0));
            reader.advance(HEADER_LEN);
        }
        Ok(reader)
    }

    /// Format version; `None` if the file header is damaged.
    pub fn version(&self) -> Option<u32> {
        self.version
    }

    /// A finding if this version of dbbd cannot read the format.
    pub fn other_format(&self) -> Option<RecordingFinding> {
        let other = self.version.filter(|format| !format::READ.contains(format));
        other.map(|format| RecordingFinding::OtherFormat { format, supported: *format::READ.end() })
    }

    fn rest(&self) -> &[u8] {
        &self.buffer[self.at..]
    }

    fn advance(&mut self, bytes: usize) {
        self.at += bytes;
        self.offset += bytes as u64;
    }

    /// Makes `bytes` bytes available, or all that are left.
    fn fill(&mut self, bytes: usize) -> io::Result<()> {
        if self.ended || self.rest().len() >= bytes {
            return Ok(());
        }
        self.buffer.drain(..self.at);
        self.at = 0;
        // The size is in proportion to the buffer, because the buffer is moved each time.
        let more = (bytes - self.buffer.len()).max(CHUNK).max(self.buffer.len() / 4) as u64;
        let got = self.source.by_ref().take(more).read_to_end(&mut self.buffer)?;
        self.ended = (got as u64) < more;
        Ok(())
    }

    fn decode_next(&mut self) -> io::Result<ParsedRecord> {
        self.fill(HEAD_LEN)?;
        let needed = format::needed(self.rest());
        if needed > SHORT && self.wasted_bytes > WASTE + WASTE_PER_BYTE * self.offset {
            return Ok(ParsedRecord::Nothing);
        }
        self.fill(needed)?;
        let found = format::decode(self.rest());
        if !matches!(found, ParsedRecord::Complete(..)) {
            self.wasted_bytes += needed.min(self.rest().len()) as u64;
        }
        Ok(found)
    }

    fn place(&self, number: Option<u32>) -> RecordPlace {
        match number.zip(self.number).map(|(number, next)| number.wrapping_sub(next)) {
            None | Some(0) => RecordPlace::Next,
            Some(ahead) if ahead <= u32::MAX / 2 => RecordPlace::Ahead(ahead),
            Some(_) => RecordPlace::Behind,
        }
    }

    /// Skips records that were read before.
    fn repeated(&mut self) -> io::Result<CaptureDamage> {
        let (offset, mut records) = (self.offset, 0);
        while let ParsedRecord::Complete(_, len, number) = self.decode_next()?
            && matches!(self.place(number), RecordPlace::Behind)
        {
            self.advance(len);
            records += 1;
        }
        let bytes = self.offset - offset;
        Ok(CaptureDamage {
            offset,
            bytes,
            finding: RecordingFinding::RecordsRepeated { offset, bytes, records },
        })
    }

    /// Delivers the record at the next byte. Before it comes a finding if its number shows missing or repeated records.
    fn record(&mut self, stamped: StampedRecord, len: usize, number: Option<u32>) -> io::Result<CapturePart> {
        let offset = self.offset;
        let damage = |finding| Ok(CapturePart::Damage(CaptureDamage { offset, bytes: 0, finding }));
        if std::mem::take(&mut self.headless) {
            return damage(RecordingFinding::NoHeader);
        }
        match self.place(number) {
            RecordPlace::Behind => return self.repeated().map(CapturePart::Damage),
            RecordPlace::Ahead(records) => {
                self.number = number;
                return damage(RecordingFinding::RecordsMissing { offset, records });
            }
            RecordPlace::Next => {}
        }
        self.number = number.map(|number| number.wrapping_add(1));
        self.advance(len);
        Ok(CapturePart::Record(stamped))
    }

    /// Skips damage up to the next complete record or the end.
    fn pass(&mut self, found: &ParsedRecord) -> io::Result<CaptureDamage> {
        let offset = self.offset;
        (self.headless, self.number) = (false, None);
        // A record with a right checksum is skipped as a whole.
        if let ParsedRecord::Unknown(_, len) = found {
            self.advance(*len);
        } else {
            self.advance(1);
            while !self.seek()?
                && !matches!(self.decode_next()?, ParsedRecord::Complete(..) | ParsedRecord::Unknown(..))
            {
                self.advance(1);
            }
        }
        let bytes = self.offset - offset;
        Ok(CaptureDamage { offset, bytes, finding: damage(offset, bytes, self.rest().is_empty(), found) })
    }

    /// Advances to the next magic; `true` if there is none.
    fn seek(&mut self) -> io::Result<bool> {
        loop {
            self.fill(MAGIC.len())?;
            if let Some(next) = self.rest().windows(MAGIC.len()).position(|window| window == MAGIC) {
                self.advance(next);
                return Ok(false);
            }
            // The buffer may end with the first bytes of a magic.
            let kept = if self.ended { 0 } else { MAGIC.len() - 1 };
            self.advance(self.rest().len().saturating_sub(kept));
            if self.ended {
                return Ok(true);
            }
        }
    }
}

impl<R: Read> Iterator for CaptureReader<R> {
    type Item = io::Result<CapturePart>;

    fn next(&mut self) -> Option<Self::Item> {
        let found = match self.decode_next() {
            Ok(found) => found,
            Err(error) => return Some(Err(error)),
        };
        if self.rest().is_empty() {
            return None;
        }
        if let ParsedRecord::Complete(stamped, len, number) = found {
            return Some(self.record(stamped, len, number));
        }
        Some(self.pass(&found).map(CapturePart::Damage))
    }
}

/// The finding for bytes that are no complete record.
fn damage(offset: u64, bytes: u64, to_the_end: bool, found: &ParsedRecord) -> RecordingFinding {
    let record = format::kind_name;
    match *found {
        ParsedRecord::Unknown(kind, _) => RecordingFinding::StrangeRecord { offset, bytes, kind },
        ParsedRecord::BadChecksum(kind) => {
            RecordingFinding::WrongChecksum { offset, bytes, record: record(kind) }
        }
        ParsedRecord::Truncated(kind, record_bytes) if to_the_end => {
            RecordingFinding::TornRecord { offset, bytes, record: record(kind), record_bytes }
        }
        ParsedRecord::ShortHead if to_the_end => RecordingFinding::TornHead { offset, bytes },
        ParsedRecord::Truncated(kind, _) => {
            RecordingFinding::WrongLength { offset, bytes, record: record(kind) }
        }
        _ if offset == 0 => RecordingFinding::DamagedHeader { offset, bytes },
        ParsedRecord::Complete(..) | ParsedRecord::ShortHead | ParsedRecord::Nothing => {
            RecordingFinding::NoRecord { offset, bytes }
        }
    }
}
