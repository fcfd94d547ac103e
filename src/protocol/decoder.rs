//! Bytes in, samples and faults out. Every byte is in exactly one of them or still pending:
//! bytes pushed = bytes of samples + bytes of faults + [`Decoder::pending`], however they were cut.

use std::sync::Arc;

use super::engine::{Engine, Meaning};
use super::sample::{Fault, FaultKind, Sample};

/// A frame that never ends is given up in pieces of this many bytes.
const GIVE_UP: u64 = 4096;

/// What a run of bytes became.
#[derive(Clone, Debug, PartialEq)]
pub enum Decoded {
    /// A sample, and the length of its frame in bytes.
    Sample(Sample, u64),
    /// Bytes that are no sample.
    Fault(Fault),
}

impl Decoded {
    /// How many bytes of the stream it stands for.
    pub fn bytes(&self) -> u64 {
        match self {
            Decoded::Sample(_, bytes) => *bytes,
            Decoded::Fault(fault) => fault.bytes,
        }
    }
}

/// Decodes a stream piece by piece.
#[derive(Clone, Debug)]
pub struct Decoder {
    engine: Arc<Engine>,
    /// The frame that is not complete.
    frame: Vec<u8>,
    /// Offset in the stream of what is pending.
    offset: u64,
    /// Bytes of an endless frame thrown away so far; 0 outside one.
    discarded: u64,
}

impl Decoder {
    pub(super) fn new(engine: Arc<Engine>) -> Self {
        Self { engine, frame: Vec::new(), offset: 0, discarded: 0 }
    }

    /// Bytes that belong to a frame that is not complete.
    pub fn pending(&self) -> u64 {
        self.frame.len() as u64 + self.discarded
    }

    /// Decodes the next bytes; what they complete is appended to `out`.
    pub fn push(&mut self, bytes: &[u8], out: &mut Vec<Decoded>) {
        for &byte in bytes {
            self.frame.push(byte);
            if self.engine.framing.complete(&self.frame) {
                self.close(out);
            } else if self.discarded > 0 || self.frame.len() >= self.engine.framing.max_len() {
                self.overflow(out);
            }
        }
    }

    /// The stream was interrupted: what is pending will not be completed.
    pub fn interrupt(&mut self, out: &mut Vec<Decoded>) {
        let pending = self.pending();
        if pending > 0 {
            let kind = if self.discarded > 0 { FaultKind::TooLong } else { FaultKind::Framing };
            self.fault(kind, pending, out);
        }
        self.frame.clear();
        self.discarded = 0;
    }

    /// A frame is complete.
    fn close(&mut self, out: &mut Vec<Decoded>) {
        if self.discarded > 0 {
            self.fault(FaultKind::TooLong, self.pending(), out);
        } else {
            let frame = std::mem::take(&mut self.frame);
            self.decode(&frame, out);
            self.frame = frame;
        }
        self.frame.clear();
        self.discarded = 0;
    }

    /// A frame is too long: all up to its end is thrown away, save what its end may still need.
    fn overflow(&mut self, out: &mut Vec<Decoded>) {
        let kept = self.frame.len().min(LONGEST_END);
        self.discarded += (self.frame.len() - kept) as u64;
        self.frame.drain(..self.frame.len() - kept);
        if self.discarded >= GIVE_UP {
            let given_up = self.discarded;
            self.fault(FaultKind::TooLong, given_up, out);
            // Still inside the endless frame: the next byte stays marked as discarded.
            self.discarded = 0;
            if !self.frame.is_empty() {
                self.discarded = 1;
                self.frame.remove(0);
            }
        }
    }

    fn decode(&mut self, frame: &[u8], out: &mut Vec<Decoded>) {
        let kind = match self.engine.meaning(frame) {
            Ok(meaning) => return self.accept(meaning, frame.len() as u64, out),
            Err(kind) => kind,
        };
        // A good frame may follow a bad start within the same end.
        let checked = self.engine.check.is_some();
        for start in 1..frame.len() {
            let rest = &frame[start..];
            if self.engine.framing.may_begin(rest, checked)
                && let Ok(Meaning::Sample(sample)) = self.engine.meaning(rest)
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
        out.push(Decoded::Fault(Fault { kind, offset: self.offset, bytes }));
        self.offset += bytes;
    }
}

/// Longest end of a frame, bytes; the loader holds the ends to it.
pub(super) const LONGEST_END: usize = 4;
