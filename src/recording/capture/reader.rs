//! Reads a capture in one pass, past every damage, with no more of it in memory than its longest record.

use std::io::{self, Read};

use super::format::{self, Found, HEAD_LEN, HEADER_LEN, MAGIC};
use super::record::Stamped;
use crate::catalogue::RecordingFinding;

/// What is read from the source at least, when it is read.
const CHUNK: usize = 1 << 18;
/// A record of so many bytes is always looked at.
const SHORT: usize = 1 << 10;
/// Bytes that may be looked at in vain beyond [`IN_VAIN_SHARE`].
const IN_VAIN: u64 = format::LONGEST as u64;
/// Bytes that may be looked at in vain for each byte of the file.
const IN_VAIN_SHARE: u64 = 4;

#[derive(Clone, Debug, PartialEq)]
pub enum Part {
    Record(Stamped),
    /// Bytes that are none.
    Damage(Damage),
}

/// Bytes of a capture that are no whole record.
#[derive(Clone, Debug, PartialEq)]
pub struct Damage {
    pub offset: u64,
    pub bytes: u64,
    pub finding: RecordingFinding,
}

/// The parts of a capture in order; together they are all of its bytes after the header. No bytes make it
/// fail, only their source can, and the time that it takes grows with their number alone.
#[derive(Debug)]
pub struct Reader<R> {
    source: R,
    /// What was read and not yet given, from `at`.
    buffer: Vec<u8>,
    at: usize,
    /// Offset in the file of what is next.
    offset: u64,
    ended: bool,
    version: Option<u32>,
    /// Whether the file begins without its header, which is not said yet.
    headless: bool,
    /// The number of the next record, where it is known: a damage explains what is missing.
    number: Option<u32>,
    /// Bytes that were looked at and were no whole record.
    in_vain: u64,
}

/// Where a record is by its number.
enum Place {
    Next,
    /// So many records before it are missing.
    Ahead(u32),
    /// It was read already.
    Behind,
}

impl<R: Read> Reader<R> {
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
            in_vain: 0,
        };
        reader.fill(HEADER_LEN)?;
        reader.version = format::version(reader.rest());
        if reader.version.is_some() {
            (reader.headless, reader.number) = (false, Some(0));
            reader.advance(HEADER_LEN);
        }
        Ok(reader)
    }

    /// The format's version by the file's header; none when the header is damaged.
    pub fn version(&self) -> Option<u32> {
        self.version
    }

    /// The format, if it is another than this version reads.
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

    /// Has so many bytes at hand, or all that there are.
    fn fill(&mut self, bytes: usize) -> io::Result<()> {
        if self.ended || self.rest().len() >= bytes {
            return Ok(());
        }
        self.buffer.drain(..self.at);
        self.at = 0;
        // In proportion to what is at hand, which is moved each time.
        let more = (bytes - self.buffer.len()).max(CHUNK).max(self.buffer.len() / 4) as u64;
        let got = self.source.by_ref().take(more).read_to_end(&mut self.buffer)?;
        self.ended = (got as u64) < more;
        Ok(())
    }

    /// What is at the next byte.
    fn look(&mut self) -> io::Result<Found> {
        self.fill(HEAD_LEN)?;
        let needed = format::needed(self.rest());
        if needed > SHORT && self.in_vain > IN_VAIN + IN_VAIN_SHARE * self.offset {
            return Ok(Found::Nothing);
        }
        self.fill(needed)?;
        let found = format::decode(self.rest());
        if !matches!(found, Found::Whole(..)) {
            self.in_vain += needed.min(self.rest().len()) as u64;
        }
        Ok(found)
    }

    fn place(&self, number: Option<u32>) -> Place {
        match number.zip(self.number).map(|(number, next)| number.wrapping_sub(next)) {
            None | Some(0) => Place::Next,
            Some(ahead) if ahead <= u32::MAX / 2 => Place::Ahead(ahead),
            Some(_) => Place::Behind,
        }
    }

    /// Passes over records that were read already.
    fn repeated(&mut self) -> io::Result<Damage> {
        let (offset, mut records) = (self.offset, 0);
        while let Found::Whole(_, len, number) = self.look()?
            && matches!(self.place(number), Place::Behind)
        {
            self.advance(len);
            records += 1;
        }
        let bytes = self.offset - offset;
        Ok(Damage { offset, bytes, finding: RecordingFinding::RecordsRepeated { offset, bytes, records } })
    }

    /// The whole record at the next byte, or what its number says of those before it.
    fn record(&mut self, stamped: Stamped, len: usize, number: Option<u32>) -> io::Result<Part> {
        let offset = self.offset;
        let damage = |finding| Ok(Part::Damage(Damage { offset, bytes: 0, finding }));
        if std::mem::take(&mut self.headless) {
            return damage(RecordingFinding::NoHeader);
        }
        match self.place(number) {
            Place::Behind => return self.repeated().map(Part::Damage),
            Place::Ahead(records) => {
                self.number = number;
                return damage(RecordingFinding::RecordsMissing { offset, records });
            }
            Place::Next => {}
        }
        self.number = number.map(|number| number.wrapping_add(1));
        self.advance(len);
        Ok(Part::Record(stamped))
    }

    /// Passes over a damage, to the next whole record or to the end.
    fn pass(&mut self, found: &Found) -> io::Result<Damage> {
        let offset = self.offset;
        (self.headless, self.number) = (false, None);
        // What is understood to its end is passed over whole.
        if let Found::Strange(_, len) = found {
            self.advance(*len);
        } else {
            self.advance(1);
            while !self.seek()? && !matches!(self.look()?, Found::Whole(..) | Found::Strange(..)) {
                self.advance(1);
            }
        }
        let bytes = self.offset - offset;
        Ok(Damage { offset, bytes, finding: damage(offset, bytes, self.rest().is_empty(), found) })
    }

    /// Goes on to the next magic; whether there is none.
    fn seek(&mut self) -> io::Result<bool> {
        loop {
            self.fill(MAGIC.len())?;
            if let Some(next) = self.rest().windows(MAGIC.len()).position(|window| window == MAGIC) {
                self.advance(next);
                return Ok(false);
            }
            // The begin of a magic may be at hand.
            let kept = if self.ended { 0 } else { MAGIC.len() - 1 };
            self.advance(self.rest().len().saturating_sub(kept));
            if self.ended {
                return Ok(true);
            }
        }
    }
}

impl<R: Read> Iterator for Reader<R> {
    type Item = io::Result<Part>;

    fn next(&mut self) -> Option<Self::Item> {
        let found = match self.look() {
            Ok(found) => found,
            Err(error) => return Some(Err(error)),
        };
        if self.rest().is_empty() {
            return None;
        }
        if let Found::Whole(stamped, len, number) = found {
            return Some(self.record(stamped, len, number));
        }
        Some(self.pass(&found).map(Part::Damage))
    }
}

/// What is wrong with bytes that are no whole record.
fn damage(offset: u64, bytes: u64, to_the_end: bool, found: &Found) -> RecordingFinding {
    let record = format::kind_name;
    match *found {
        Found::Strange(kind, _) => RecordingFinding::StrangeRecord { offset, bytes, kind },
        Found::Broken(kind) => RecordingFinding::WrongChecksum { offset, bytes, record: record(kind) },
        Found::Short(kind, record_bytes) if to_the_end => {
            RecordingFinding::TornRecord { offset, bytes, record: record(kind), record_bytes }
        }
        Found::Stub if to_the_end => RecordingFinding::TornHead { offset, bytes },
        Found::Short(kind, _) => RecordingFinding::WrongLength { offset, bytes, record: record(kind) },
        _ if offset == 0 => RecordingFinding::DamagedHeader { offset, bytes },
        _ => RecordingFinding::NoRecord { offset, bytes },
    }
}
