//! Decodes a stream into samples and faults. Every byte belongs to exactly one of them or is pending:
//! bytes pushed = bytes of samples + bytes of faults + [`Decoder::pending`], however the stream was split.

use std::sync::Arc;

use super::engine::{Engine, Meaning};
use super::fault::{Fault, FaultKind};
use super::framing::{Cut, Framing, LONGEST_END};
use crate::measurement::sample::Sample;

/// A frame without end is reported in pieces of this many bytes.
const GIVE_UP: u64 = 4096;

#[derive(Clone, Debug, PartialEq)]
pub enum Decoded {
    /// A sample, and the length of its frame in bytes.
    Sample(Sample, u64),
    Fault(Fault),
}

impl Decoded {
    /// Number of bytes of the stream.
    pub fn bytes(&self) -> u64 {
        match self {
            Decoded::Sample(_, bytes) => *bytes,
            Decoded::Fault(fault) => fault.bytes,
        }
    }
}

/// Decodes a stream incrementally.
#[derive(Clone, Debug)]
pub struct Decoder {
    engine: Arc<Engine>,
    /// The incomplete frame.
    frame: Vec<u8>,
    /// Offset of the pending bytes in the stream.
    offset: u64,
    /// Bytes of an overlong frame discarded so far; 0 outside of one.
    discarded: u64,
    /// Bytes before the pending ones that start no frame, and why.
    junk: Option<(FaultKind, u64)>,
    /// For unpacking frames.
    buffer: Vec<u8>,
}

impl Decoder {
    pub(super) fn new(engine: Arc<Engine>) -> Self {
        Self { engine, frame: Vec::new(), offset: 0, discarded: 0, junk: None, buffer: Vec::new() }
    }

    /// Number of bytes of the incomplete frame.
    pub fn pending(&self) -> u64 {
        self.frame.len() as u64 + self.discarded + self.junk.as_ref().map_or(0, |(_, bytes)| *bytes)
    }

    /// Decodes the next bytes; samples and faults are appended to `out`.
    pub fn push(&mut self, bytes: &[u8], out: &mut Vec<Decoded>) {
        let engine = Arc::clone(&self.engine);
        let mut rest = bytes;
        while let Some((&byte, tail)) = rest.split_first() {
            // A frame that was received whole is decoded in place.
            let fresh = self.frame.is_empty() && self.discarded == 0 && engine.mask == 0xff;
            if fresh && let Some(len) = engine.framing.terminated_len(rest) {
                let (frame, after) = rest.split_at(len);
                self.decode(&engine, frame, out);
                rest = after;
                continue;
            }
            self.frame.push(byte & engine.mask);
            if engine.framing.is_cut_from_start() {
                self.slide(&engine, out);
            } else if engine.framing.is_complete(&self.frame) {
                self.close(out);
            } else if self.discarded > 0 || self.frame.len() >= engine.framing.max_len() {
                self.overflow(out);
            }
            rest = tail;
        }
    }

    /// The line was silent for the time that terminates a frame.
    pub fn silence(&mut self, out: &mut Vec<Decoded>) {
        if matches!(self.engine.framing, Framing::Idle { .. }) && self.pending() > 0 {
            self.close(out);
        }
    }

    /// The stream was interrupted: the pending bytes become a fault.
    pub fn interrupt(&mut self, out: &mut Vec<Decoded>) {
        self.silence(out);
        if let Some((kind, bytes)) = self.junk.take() {
            self.fault(kind, bytes + self.frame.len() as u64, out);
            self.frame.clear();
        }
        let pending = self.pending();
        if pending > 0 {
            let kind = if self.discarded > 0 { FaultKind::TooLong } else { FaultKind::Framing };
            self.fault(kind, pending, out);
        }
        self.frame.clear();
        self.discarded = 0;
    }

    /// Takes complete frames from the start of the pending bytes.
    fn slide(&mut self, engine: &Engine, out: &mut Vec<Decoded>) {
        while !self.frame.is_empty() {
            let prefix = engine.ignored.iter().find(|prefix| self.frame.starts_with(prefix));
            if let Some(prefix) = prefix {
                self.take(prefix.len(), Meaning::Ignored, out);
                continue;
            }
            let one;
            let lens = match engine.framing.cut(&self.frame) {
                Cut::More => return,
                Cut::Skip => {
                    self.skip(FaultKind::Framing, out);
                    continue;
                }
                Cut::Frame(len) => {
                    one = [len];
                    &one[..]
                }
                Cut::OneOf(lens) => lens,
            };
            let mut wrong = None;
            let fits = lens.iter().take_while(|len| **len <= self.frame.len()).find_map(|len| {
                match engine.meaning(&self.frame[..*len], &mut self.buffer) {
                    Ok(meaning) => Some((*len, meaning)),
                    Err(kind) => {
                        wrong = Some(kind);
                        None
                    }
                }
            });
            match fits {
                Some((len, meaning)) => self.take(len, meaning, out),
                None if lens.last().is_some_and(|longest| *longest > self.frame.len()) => return,
                None => self.skip(wrong.unwrap_or(FaultKind::Framing), out),
            }
        }
    }

    /// Drops the first pending byte, which starts no frame.
    fn skip(&mut self, why: FaultKind, out: &mut Vec<Decoded>) {
        self.frame.remove(0);
        let (kind, bytes) = self.junk.take().unwrap_or((why, 0));
        if bytes + 1 >= GIVE_UP {
            self.fault(kind, bytes + 1, out);
        } else {
            self.junk = Some((kind, bytes + 1));
        }
    }

    fn take(&mut self, len: usize, meaning: Meaning, out: &mut Vec<Decoded>) {
        if let Some((kind, bytes)) = self.junk.take() {
            self.fault(kind, bytes, out);
        }
        self.accept(meaning, len as u64, out);
        self.frame.drain(..len.min(self.frame.len()));
    }

    fn close(&mut self, out: &mut Vec<Decoded>) {
        if self.discarded > 0 {
            self.fault(FaultKind::TooLong, self.pending(), out);
        } else {
            let (engine, frame) = (Arc::clone(&self.engine), std::mem::take(&mut self.frame));
            self.decode(&engine, &frame, out);
            self.frame = frame;
        }
        self.frame.clear();
        self.discarded = 0;
    }

    /// Discards an overlong frame, except the last bytes, which may belong to its terminator.
    fn overflow(&mut self, out: &mut Vec<Decoded>) {
        let kept = self.frame.len().min(LONGEST_END);
        self.discarded += (self.frame.len() - kept) as u64;
        self.frame.drain(..self.frame.len() - kept);
        if self.discarded >= GIVE_UP {
            let given_up = self.discarded;
            self.fault(FaultKind::TooLong, given_up, out);
            // Still within the overlong frame: the next byte counts as discarded.
            self.discarded = 0;
            if !self.frame.is_empty() {
                self.discarded = 1;
                self.frame.remove(0);
            }
        }
    }

    fn decode(&mut self, engine: &Engine, frame: &[u8], out: &mut Vec<Decoded>) {
        let kind = match engine.meaning(frame, &mut self.buffer) {
            Ok(meaning) => return self.accept(meaning, frame.len() as u64, out),
            Err(kind) => kind,
        };
        // An intact frame may follow a damaged start before the same terminator.
        let checked = engine.check.is_some();
        for start in 1..frame.len() {
            let rest = &frame[start..];
            if engine.framing.may_start(rest, checked)
                && let Ok(Meaning::Sample(sample)) = engine.meaning(rest, &mut self.buffer)
            {
                self.fault(kind, start as u64, out);
                return self.accept(Meaning::Sample(sample), rest.len() as u64, out);
            }
        }
        self.fault(kind, frame.len() as u64, out);
    }

    fn accept(&mut self, meaning: Meaning, bytes: u64, out: &mut Vec<Decoded>) {
        match meaning {
            Meaning::Sample(sample) => {
                out.push(Decoded::Sample(Sample { offset: self.offset, ..sample }, bytes));
                self.offset += bytes;
            }
            Meaning::Reject(word) => self.fault(FaultKind::Reject(word), bytes, out),
            Meaning::Ignored => self.fault(FaultKind::Ignored, bytes, out),
        }
    }

    fn fault(&mut self, kind: FaultKind, bytes: u64, out: &mut Vec<Decoded>) {
        out.push(Decoded::Fault(Fault { kind, offset: self.offset, bytes, count: 1 }));
        self.offset += bytes;
    }
}
