//! Reads a capture in one pass, past every damage, with no more of it in memory than its longest record.

use std::io::{self, Read};

use super::format::{self, Found, HEAD_LEN, HEADER_LEN, MAGIC};
use super::record::Stamped;

/// What is read from the source at least, when it is read.
const CHUNK: usize = 1 << 18;

/// A stretch of a capture.
#[derive(Clone, Debug, PartialEq)]
pub enum Part {
    /// A whole record.
    Record(Stamped),
    /// Bytes that are none.
    Damage(Damage),
}

/// Bytes of a capture that are no whole record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Damage {
    /// Offset in the file.
    pub offset: u64,
    /// How many bytes.
    pub bytes: u64,
    /// What is wrong with them.
    pub what: String,
}

/// The parts of a capture in order; together they are all of its bytes after the header. No bytes make it
/// fail, only their source can.
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
}

impl<R: Read> Reader<R> {
    /// Reads the header.
    ///
    /// # Errors
    /// When the source fails.
    pub fn new(source: R) -> io::Result<Self> {
        let mut reader = Self { source, buffer: Vec::new(), at: 0, offset: 0, ended: false, version: None };
        reader.fill(HEADER_LEN)?;
        reader.version = format::version(reader.rest());
        if reader.version.is_some() {
            reader.advance(HEADER_LEN);
        }
        Ok(reader)
    }

    /// The format's version by the file's header; none when the header is damaged.
    pub fn version(&self) -> Option<u32> {
        self.version
    }

    /// Whether the file is of a version that this dbbd does not know.
    pub fn is_newer(&self) -> bool {
        self.version.is_some_and(|version| version > format::VERSION)
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
        let more = (bytes - self.buffer.len()).max(CHUNK) as u64;
        let got = self.source.by_ref().take(more).read_to_end(&mut self.buffer)?;
        self.ended = (got as u64) < more;
        Ok(())
    }

    /// What stands at the next byte.
    fn look(&mut self) -> io::Result<Found> {
        self.fill(HEAD_LEN)?;
        self.fill(format::needed(self.rest()))?;
        Ok(format::decode(self.rest()))
    }

    /// Passes over a damage, to the next whole record or to the end.
    fn pass(&mut self, found: &Found) -> io::Result<Damage> {
        let offset = self.offset;
        // What is understood to its end is passed over whole.
        if let Found::Strange(_, len) = found {
            self.advance(*len);
        } else {
            self.advance(1);
            while !self.seek()? && !matches!(self.look()?, Found::Whole(..) | Found::Strange(..)) {
                self.advance(1);
            }
        }
        let to_the_end = self.rest().is_empty();
        let what = describe(found, offset == 0, to_the_end);
        Ok(Damage { offset, bytes: self.offset - offset, what })
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
        if let Found::Whole(stamped, len) = found {
            self.advance(len);
            return Some(Ok(Part::Record(stamped)));
        }
        Some(self.pass(&found).map(Part::Damage))
    }
}

fn describe(found: &Found, first: bool, to_the_end: bool) -> String {
    match found {
        Found::Strange(kind, len) => {
            format!("a record of {len} bytes and kind {kind} whose content is not understood")
        }
        Found::Broken(kind, len) => {
            format!("the checksum of a record of {len} bytes ({}) is wrong", format::kind_name(*kind))
        }
        Found::Short(kind, len) if to_the_end => {
            format!("torn tail: the file ends inside a record of {len} bytes ({})", format::kind_name(*kind))
        }
        Found::Stub if to_the_end => "torn tail: the file ends inside the head of a record".into(),
        Found::Short(kind, _) => format!("the length of a record ({}) is wrong", format::kind_name(*kind)),
        _ if first => "the file's header is damaged".into(),
        _ => "no record begins here".into(),
    }
}
