//! Cuts a stream into frames and takes a frame's wrapping off.
//!
//! Two families: frames that end with something (`complete` sees the end), and frames that begin
//! with something or are known by their length (`cut` looks at what is pending from its start).

use super::table::Endian;
use super::tagged::Tagged;

/// Longest frame that a definition may ask for, bytes.
pub(super) const LONGEST_FRAME: usize = 4096;

/// How frames are separated.
#[derive(Clone, Debug)]
pub(super) enum Framing {
    /// Consistent overhead byte stuffing (Cheshire and Baker, IEEE/ACM Trans. Networking 7(2), 1999).
    Cobs {
        /// Ends a frame and occurs nowhere in it; the stuffed bytes are XORed with it.
        delimiter: u8,
        /// Longest frame, bytes, with the delimiter.
        max_len: usize,
    },
    /// Lines of text, or records with an end of their own.
    Line {
        /// The character that begins a line, where there is one.
        start: Option<u8>,
        /// What ends a line; longer ends first.
        ends: Vec<Vec<u8>>,
        /// Longest line, bytes, with start and end.
        max_len: usize,
    },
    /// Records of one length.
    Fixed { sync: Vec<u8>, len: usize },
    /// Records with a length field.
    Length { sync: Vec<u8>, at: usize, bytes: usize, endian: Endian, adds: usize, max_len: usize },
    /// Bytes whose high bits tell their place.
    Tagged(Tagged),
    /// Replies known by their length alone, shortest first.
    Lengths(Vec<usize>),
    /// Records that end with silence.
    Idle { max_len: usize },
}

/// What the bytes that are pending begin with.
pub(super) enum Cut<'a> {
    /// Perhaps a frame: more is needed to tell.
    More,
    /// No frame begins with the first byte.
    Skip,
    /// A frame of this length.
    Frame(usize),
    /// A frame of one of these lengths, shortest first.
    OneOf(&'a [usize]),
}

impl Framing {
    /// Longest frame, bytes, with all its wrapping.
    pub(super) fn max_len(&self) -> usize {
        match self {
            Framing::Cobs { max_len, .. }
            | Framing::Line { max_len, .. }
            | Framing::Length { max_len, .. }
            | Framing::Idle { max_len } => *max_len,
            Framing::Fixed { len, .. } => *len,
            Framing::Tagged(tagged) => tagged.len(),
            Framing::Lengths(lens) => lens.iter().copied().max().unwrap_or(0),
        }
    }

    /// Bytes that the content may have at most, and whether it must have just as many.
    pub(super) fn room(&self) -> (usize, bool) {
        match self {
            Framing::Cobs { max_len, .. } | Framing::Line { max_len, .. } => {
                (max_len.saturating_sub(1), false)
            }
            Framing::Fixed { len, .. } => (*len, true),
            Framing::Tagged(tagged) => (tagged.body_len(), true),
            _ => (self.max_len(), false),
        }
    }

    /// Places in the content that the framing itself writes.
    pub(super) fn own(&self) -> impl Iterator<Item = usize> {
        let (sync, length) = match self {
            Framing::Fixed { sync, .. } => (sync.len(), 0..0),
            Framing::Length { sync, at, bytes, .. } => (sync.len(), *at..at + bytes),
            _ => (0, 0..0),
        };
        (0..sync).chain(length)
    }

    /// Whether frames are found from their beginning.
    pub(super) fn slides(&self) -> bool {
        !matches!(self, Framing::Cobs { .. } | Framing::Line { .. } | Framing::Idle { .. })
    }

    /// What the bytes pending begin with.
    pub(super) fn cut(&self, pending: &[u8]) -> Cut<'_> {
        let one = |len: usize| if pending.len() < len { Cut::More } else { Cut::Frame(len) };
        let begins = |sync: &[u8]| {
            let known = sync.len().min(pending.len());
            sync[..known] == pending[..known]
        };
        match self {
            Framing::Fixed { sync, len } if begins(sync) => one(*len),
            Framing::Length { sync, at, bytes, endian, adds, max_len } if begins(sync) => {
                let Some(field) = pending.get(*at..at + bytes) else { return Cut::More };
                let fold = |value: usize, byte: &u8| (value << 8) | usize::from(*byte);
                let value = match endian {
                    Endian::Be => field.iter().fold(0, fold),
                    Endian::Le => field.iter().rev().fold(0, fold),
                };
                match value + adds {
                    len if len > *max_len || len < at + bytes => Cut::Skip,
                    len => one(len),
                }
            }
            Framing::Tagged(tagged) if tagged.fits(pending) => one(tagged.len()),
            Framing::Lengths(lens) => Cut::OneOf(lens),
            _ => Cut::Skip,
        }
    }

    /// Whether the bytes so far are complete: they end a frame.
    pub(super) fn complete(&self, pending: &[u8]) -> bool {
        match self {
            Framing::Cobs { delimiter, .. } => pending.last() == Some(delimiter),
            Framing::Line { ends, .. } => {
                ends.iter().any(|end| pending.last() == end.last() && pending.ends_with(end))
            }
            _ => false,
        }
    }

    /// The length of the frame that ends within `bytes`, where it begins with them and ends with something.
    pub(super) fn whole(&self, bytes: &[u8]) -> Option<usize> {
        let window = &bytes[..bytes.len().min(self.max_len())];
        let last = match self {
            Framing::Cobs { delimiter, .. } => window.iter().position(|byte| byte == delimiter),
            Framing::Line { .. } => (0..window.len()).find(|at| self.complete(&window[..=*at])),
            _ => None,
        };
        last.map(|last| last + 1)
    }

    /// What a complete frame carries, unpacked into `room` where it must be; none when it is malformed.
    pub(super) fn unwrap<'a>(&self, frame: &'a [u8], room: &'a mut Vec<u8>) -> Option<&'a [u8]> {
        room.clear();
        match self {
            Framing::Cobs { delimiter, .. } => {
                let (_, stuffed) = frame.split_last().filter(|(last, _)| *last == delimiter)?;
                uncobs(stuffed, *delimiter, room)?;
                Some(room)
            }
            Framing::Line { start: Some(start), .. } => self.without_end(frame).strip_prefix(&[*start]),
            Framing::Line { start: None, .. } => Some(self.without_end(frame)),
            Framing::Tagged(tagged) => {
                tagged.unwrap(frame, room)?;
                Some(room)
            }
            _ => Some(frame),
        }
    }

    /// Whether a complete frame is nothing but its end.
    pub(super) fn empty(&self, frame: &[u8]) -> bool {
        match self {
            Framing::Cobs { .. } => frame.len() == 1,
            Framing::Line { .. } => self.without_end(frame).is_empty(),
            _ => false,
        }
    }

    /// Whether a frame may begin at the first of these bytes, after a bad start.
    pub(super) fn may_begin(&self, rest: &[u8], checked: bool) -> bool {
        match self {
            // Only a check can tell a frame from the tail of another.
            Framing::Cobs { .. } => checked && rest.len() > 1,
            Framing::Line { start, .. } => start.is_some() && rest.first() == start.as_ref(),
            _ => false,
        }
    }

    /// Puts in what the framing itself writes into the content: synchronising bytes and length.
    /// `guard` is the length of the check that follows.
    pub(super) fn prepare(&self, body: &mut [u8], guard: usize) {
        let total = body.len() + guard;
        let (Framing::Fixed { sync, .. } | Framing::Length { sync, .. }) = self else { return };
        for (byte, sync) in body.iter_mut().zip(sync) {
            *byte = *sync;
        }
        if let Framing::Length { at, bytes, endian, adds, .. } = self
            && let Some(field) = body.get_mut(*at..at + bytes)
        {
            field.copy_from_slice(&total.saturating_sub(*adds).to_le_bytes()[..*bytes]);
            if *endian == Endian::Be {
                field.reverse();
            }
        }
    }

    /// Wraps content into a frame.
    pub(super) fn wrap(&self, body: &[u8]) -> Vec<u8> {
        match self {
            Framing::Cobs { delimiter, .. } => {
                let mut frame = cobs(body, *delimiter);
                frame.push(*delimiter);
                frame
            }
            Framing::Line { start, ends, .. } => {
                let mut frame: Vec<u8> = start.iter().copied().collect();
                frame.extend_from_slice(body);
                frame.extend(ends.first().into_iter().flatten());
                frame
            }
            Framing::Tagged(tagged) => tagged.wrap(body),
            _ => body.to_vec(),
        }
    }

    fn without_end<'a>(&self, frame: &'a [u8]) -> &'a [u8] {
        match self {
            Framing::Line { ends, .. } => {
                ends.iter().find_map(|end| frame.strip_suffix(&end[..])).unwrap_or(frame)
            }
            _ => frame,
        }
    }
}

/// Undoes byte stuffing: each block is a code byte n, then n - 1 bytes, then a zero unless n is 255
/// or the block is the last.
fn uncobs(mut stuffed: &[u8], delimiter: u8, body: &mut Vec<u8>) -> Option<()> {
    while let Some((code, rest)) = stuffed.split_first() {
        let code = code ^ delimiter;
        let (block, tail) = rest.split_at_checked(usize::from(code.checked_sub(1)?))?;
        body.extend_from_slice(block);
        if code < 255 && !tail.is_empty() {
            body.push(delimiter);
        }
        stuffed = tail;
    }
    if delimiter != 0 {
        body.iter_mut().for_each(|byte| *byte ^= delimiter);
    }
    (!body.is_empty()).then_some(())
}

fn cobs(body: &[u8], delimiter: u8) -> Vec<u8> {
    let mut stuffed = Vec::with_capacity(body.len() + body.len() / 254 + 1);
    let mut zero_ended = true;
    let mut rest = body;
    while zero_ended || !rest.is_empty() {
        let run = rest.iter().take(254).take_while(|byte| **byte != 0).count();
        let (block, tail) = rest.split_at(run);
        stuffed.push(u8::try_from(run + 1).unwrap_or(u8::MAX));
        stuffed.extend_from_slice(block);
        // A full block has no zero of its own.
        zero_ended = run < 254 && !tail.is_empty();
        rest = if zero_ended { &tail[1..] } else { tail };
    }
    stuffed.iter_mut().for_each(|byte| *byte ^= delimiter);
    stuffed
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(256))]

        #[test]
        fn stuffing_is_undone(body in prop::collection::vec(prop_oneof![Just(0u8), any::<u8>()], 1..600), delimiter: u8) {
            let stuffed = cobs(&body, delimiter);
            prop_assert!(!stuffed.contains(&delimiter));
            let mut again = Vec::new();
            prop_assert_eq!(uncobs(&stuffed, delimiter, &mut again), Some(()));
            prop_assert_eq!(again, body);
        }
    }

    /// The worked examples of the paper's method: blocks of 254 bytes need no zero of their own.
    #[test]
    fn long_runs_are_split_after_254_bytes() {
        assert_eq!(cobs(&[0], 0), [1, 1]);
        assert_eq!(cobs(&[0x11, 0x22, 0, 0x33], 0), [3, 0x11, 0x22, 2, 0x33]);
        let long = vec![7u8; 254];
        let stuffed = cobs(&long, 0);
        assert_eq!((stuffed.len(), stuffed[0]), (255, 255));
    }
}
