//! Decodes a stream into samples and faults. Every byte belongs to exactly one of them or is pending:
//! bytes pushed = bytes of samples + bytes of faults + [`ProtocolDecoder::pending`], however the stream was split.

use std::sync::Arc;

use super::engine::{MessageMeaning, ProtocolEngine};
use super::fault::{LineFault, LineFaultKind};
use super::framing::{FrameCut, Framing, LONGEST_END};
use dbbd_model::measurement::sample::Sample;

/// A frame without end is reported in pieces of this many bytes.
const GIVE_UP: u64 = 4096;

#[derive(Clone, Debug, PartialEq)]
pub enum DecodedItem {
    /// A sample, and the length of its frame in bytes.
    Sample(Sample, u64),
    Fault(LineFault),
}

impl DecodedItem {
    /// Number of bytes of the stream.
    pub fn bytes(&self) -> u64 {
        match self {
            DecodedItem::Sample(_, bytes) => *bytes,
            DecodedItem::Fault(fault) => fault.bytes,
        }
    }
}

/// Decodes a stream incrementally.
#[derive(Clone, Debug)]
pub struct ProtocolDecoder {
    engine: Arc<ProtocolEngine>,
    /// The incomplete frame.
    frame: Vec<u8>,
    /// Offset of the pending bytes in the stream.
    offset: u64,
    /// Bytes of an overlong frame discarded so far; 0 outside of one.
    discarded: u64,
    /// Bytes before the pending ones that start no frame, and why.
    junk: Option<(LineFaultKind, u64)>,
    /// Buffer for unpacking frames.
    buffer: Vec<u8>,
    decimals: DecimalsSeen,
}

/// Numbers of decimals of a device that shows always the same in one unit. Two readings in a row fix it: in one a digit may
/// be lost.
#[derive(Clone, Copy, Debug, Default)]
struct DecimalsSeen {
    last: Option<usize>,
    fixed: Option<usize>,
}

impl DecimalsSeen {
    /// Whether a reading has the number of decimals of those before.
    fn is_as_before(&mut self, decimals: Option<usize>) -> bool {
        if self.fixed.is_none() && decimals.is_some() && self.last == decimals {
            self.fixed = decimals;
        }
        self.last = decimals;
        self.fixed.is_none() || decimals.is_none() || self.fixed == decimals
    }
}

impl ProtocolDecoder {
    pub(super) fn new(engine: Arc<ProtocolEngine>) -> Self {
        Self {
            engine,
            frame: Vec::new(),
            offset: 0,
            discarded: 0,
            junk: None,
            buffer: Vec::new(),
            decimals: DecimalsSeen::default(),
        }
    }

    /// Number of bytes of the incomplete frame.
    pub fn pending(&self) -> u64 {
        self.frame.len() as u64 + self.discarded + self.junk.as_ref().map_or(0, |(_, bytes)| *bytes)
    }

    /// Decodes the next bytes; samples and faults are appended to `out`.
    pub fn push(&mut self, bytes: &[u8], out: &mut Vec<DecodedItem>) {
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
    pub fn idle(&mut self, out: &mut Vec<DecodedItem>) {
        if matches!(self.engine.framing, Framing::Idle { .. }) && self.pending() > 0 {
            self.close(out);
        }
    }

    /// The stream was interrupted: the pending bytes become a fault.
    pub fn interrupt(&mut self, out: &mut Vec<DecodedItem>) {
        self.idle(out);
        if let Some((kind, bytes)) = self.junk.take() {
            self.fault(kind, bytes + self.frame.len() as u64, out);
            self.frame.clear();
        }
        let pending = self.pending();
        if pending > 0 {
            let kind = if self.discarded > 0 { LineFaultKind::TooLong } else { LineFaultKind::Framing };
            self.fault(kind, pending, out);
        }
        self.frame.clear();
        self.discarded = 0;
    }

    /// Takes complete frames from the start of the pending bytes.
    fn slide(&mut self, engine: &ProtocolEngine, out: &mut Vec<DecodedItem>) {
        while !self.frame.is_empty() {
            let prefix = engine.ignored.iter().find(|prefix| self.frame.starts_with(prefix));
            if let Some(prefix) = prefix {
                self.take(prefix.len(), MessageMeaning::Ignored, out);
                continue;
            }
            let one;
            let lens = match engine.framing.cut(&self.frame) {
                FrameCut::More => return,
                FrameCut::Skip => {
                    self.skip(LineFaultKind::Framing, out);
                    continue;
                }
                FrameCut::Frame(len) => {
                    one = [len];
                    &one[..]
                }
                FrameCut::OneOf(lens) => lens,
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
                None => self.skip(wrong.unwrap_or(LineFaultKind::Framing), out),
            }
        }
    }

    /// Drops the first pending byte, which starts no frame.
    fn skip(&mut self, why: LineFaultKind, out: &mut Vec<DecodedItem>) {
        self.frame.remove(0);
        let (kind, bytes) = self.junk.take().unwrap_or((why, 0));
        if bytes + 1 >= GIVE_UP {
            self.fault(kind, bytes + 1, out);
        } else {
            self.junk = Some((kind, bytes + 1));
        }
    }

    fn take(&mut self, len: usize, meaning: MessageMeaning, out: &mut Vec<DecodedItem>) {
        if let Some((kind, bytes)) = self.junk.take() {
            self.fault(kind, bytes, out);
        }
        self.accept(meaning, len as u64, out);
        self.frame.drain(..len.min(self.frame.len()));
    }

    fn close(&mut self, out: &mut Vec<DecodedItem>) {
        if self.discarded > 0 {
            self.fault(LineFaultKind::TooLong, self.pending(), out);
        } else {
            let (engine, frame) = (Arc::clone(&self.engine), std::mem::take(&mut self.frame));
            self.decode(&engine, &frame, out);
            self.frame = frame;
        }
        self.frame.clear();
        self.discarded = 0;
    }

    /// Discards an overlong frame, except the last bytes, which may belong to its terminator.
    fn overflow(&mut self, out: &mut Vec<DecodedItem>) {
        let kept = self.frame.len().min(LONGEST_END);
        self.discarded += (self.frame.len() - kept) as u64;
        self.frame.drain(..self.frame.len() - kept);
        if self.discarded >= GIVE_UP {
            let given_up = self.discarded;
            self.fault(LineFaultKind::TooLong, given_up, out);
            // Still within the overlong frame: the next byte counts as discarded.
            self.discarded = 0;
            if !self.frame.is_empty() {
                self.discarded = 1;
                self.frame.remove(0);
            }
        }
    }

    fn decode(&mut self, engine: &ProtocolEngine, frame: &[u8], out: &mut Vec<DecodedItem>) {
        let kind = match engine.meaning(frame, &mut self.buffer) {
            Ok(meaning) => return self.accept(meaning, frame.len() as u64, out),
            Err(kind) => kind,
        };
        // An intact frame may follow a damaged start before the same terminator.
        let checked = engine.check.is_some();
        for start in 1..frame.len() {
            let rest = &frame[start..];
            if engine.framing.may_start(rest, checked)
                && let Ok(MessageMeaning::Sample(sample, decimals)) = engine.meaning(rest, &mut self.buffer)
            {
                self.fault(kind, start as u64, out);
                return self.accept(MessageMeaning::Sample(sample, decimals), rest.len() as u64, out);
            }
        }
        self.fault(kind, frame.len() as u64, out);
    }

    fn accept(&mut self, meaning: MessageMeaning, bytes: u64, out: &mut Vec<DecodedItem>) {
        match meaning {
            MessageMeaning::Sample(mut sample, decimals) if self.decimals.is_as_before(decimals) => {
                sample.offset = self.offset;
                out.push(DecodedItem::Sample(sample, bytes));
                self.offset += bytes;
            }
            MessageMeaning::Sample(..) | MessageMeaning::OtherUnit => {
                self.fault(LineFaultKind::OtherUnit, bytes, out);
            }
            MessageMeaning::Reject(word) => self.fault(LineFaultKind::Reject(word), bytes, out),
            MessageMeaning::Ignored => self.fault(LineFaultKind::Ignored, bytes, out),
        }
    }

    fn fault(&mut self, kind: LineFaultKind, bytes: u64, out: &mut Vec<DecodedItem>) {
        out.push(DecodedItem::Fault(LineFault { kind, offset: self.offset, bytes, count: 1 }));
        self.offset += bytes;
    }
}
