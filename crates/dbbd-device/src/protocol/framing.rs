//! Cuts a stream into frames and removes their wrapping.
//!
//! There are two families: frames with a terminator, which `is_complete` detects, and frames with a header or a known
//! length, which `cut` finds from the start of the pending bytes.

use super::field::Endian;
use super::source::hex_bytes;
use super::tagged::TagOrder;
use super::tagged::TaggedRecord;
use crate::protocol::ProtocolFinding::{
    self, DelimiterEnd, FixedSync, GapKeys, LengthField, LengthSync, LineEnds, LineStart, MaxLength,
};
use serde::Deserialize;

/// Longest frame of any definition, bytes.
pub(super) const LONGEST_FRAME: usize = 4096;
/// Longest terminator of a frame, bytes.
pub(super) const LONGEST_END: usize = 4;

#[derive(Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
pub(super) enum FramingTable {
    /// Consistent overhead byte stuffing.
    Cobs {
        #[serde(default)]
        delimiter: u8,
        max_len: usize,
    },
    /// Lines of text.
    Line { start: Option<String>, end: Vec<String>, max_len: usize },
    /// Records with a terminator.
    Delim { end: String, max_len: usize },
    /// Records of one length, which may start with synchronising bytes.
    Fixed {
        #[serde(default)]
        sync: String,
        len: usize,
    },
    /// Records with a length field.
    Length {
        #[serde(default)]
        sync: String,
        len_at: usize,
        #[serde(default = "one")]
        len_bytes: u8,
        #[serde(default)]
        len_endian: Endian,
        #[serde(default)]
        len_adds: usize,
        max_len: usize,
    },
    /// Bytes whose high bits are their position in the record.
    Tagged {
        data_bits: u32,
        #[serde(default)]
        order: TagOrder,
        tags: Vec<String>,
    },
    /// Replies identified by their length alone, or terminated by silence.
    Gap { len: Option<Vec<usize>>, idle_us: Option<u32>, max_len: Option<usize> },
}

fn one() -> u8 {
    1
}

#[derive(Clone, Debug)]
pub(super) enum Framing {
    /// Consistent overhead byte stuffing (Cheshire and Baker, IEEE/ACM Trans. Networking 7(2), 1999).
    Cobs {
        /// Terminates a frame and does not occur in it; the stuffed bytes are XORed with it.
        delimiter: u8,
        /// Longest frame with its delimiter, bytes.
        max_len: usize,
    },
    /// Lines of text, or records with a terminator.
    Line {
        /// First character of a line, if it is fixed.
        start: Option<u8>,
        /// Terminators, the longest first.
        ends: Vec<Vec<u8>>,
        /// Longest frame with start and terminator, bytes.
        max_len: usize,
    },
    /// Records of one length.
    Fixed { sync: Vec<u8>, len: usize },
    /// Records with a length field.
    Length { sync: Vec<u8>, at: usize, bytes: usize, endian: Endian, adds: usize, max_len: usize },
    /// Bytes whose high bits are their position in the record.
    Tagged(TaggedRecord),
    /// Replies identified by their length alone, the shortest first.
    Lengths(Vec<usize>),
    /// Records terminated by silence.
    Idle { max_len: usize },
}

/// Result of the search for a frame at the start of the pending bytes.
pub(super) enum FrameCut<'a> {
    /// A frame may start here: more bytes are needed.
    More,
    /// No frame starts at the first byte.
    Skip,
    /// A frame of this length.
    Frame(usize),
    /// A frame of one of these lengths, the shortest first.
    OneOf(&'a [usize]),
}

impl Framing {
    /// Checks `[framing]` and compiles it.
    pub(super) fn new(table: &FramingTable) -> Result<Self, ProtocolFinding> {
        let framing = match table {
            FramingTable::Cobs { delimiter, max_len } => {
                Self::Cobs { delimiter: *delimiter, max_len: *max_len }
            }
            FramingTable::Line { start, end, max_len } => {
                let start = match start.as_deref().map(str::as_bytes) {
                    None => None,
                    Some([start]) => Some(*start),
                    Some(_) => return Err(LineStart),
                };
                let mut ends: Vec<Vec<u8>> = end.iter().map(|end| end.clone().into_bytes()).collect();
                if ends.is_empty() || ends.iter().any(|end| !(1..=LONGEST_END).contains(&end.len())) {
                    return Err(LineEnds);
                }
                ends.sort_by_key(|end| std::cmp::Reverse(end.len()));
                Self::Line { start, ends, max_len: *max_len }
            }
            FramingTable::Delim { end, max_len } => {
                let end = hex_bytes(end).filter(|end| (1..=LONGEST_END).contains(&end.len()));
                Self::Line { start: None, ends: vec![end.ok_or(DelimiterEnd)?], max_len: *max_len }
            }
            FramingTable::Fixed { sync, len } => {
                let sync = hex_bytes(sync).filter(|sync| sync.len() < *len);
                Self::Fixed { sync: sync.ok_or(FixedSync)?, len: *len }
            }
            FramingTable::Length { sync, len_at, len_bytes, len_endian, len_adds, max_len } => {
                let sync = hex_bytes(sync).filter(|sync| sync.len() <= *len_at).ok_or(LengthSync)?;
                if !matches!(len_bytes, 1 | 2) || *len_at >= LONGEST_FRAME || *len_adds >= LONGEST_FRAME {
                    return Err(LengthField);
                }
                let (bytes, endian) = (usize::from(*len_bytes), *len_endian);
                Self::Length { sync, at: *len_at, bytes, endian, adds: *len_adds, max_len: *max_len }
            }
            FramingTable::Tagged { data_bits, order, tags } => {
                Self::Tagged(TaggedRecord::new(*data_bits, *order, tags)?)
            }
            FramingTable::Gap { len: Some(lens), idle_us: None, max_len: None } if !lens.is_empty() => {
                let mut lens = lens.clone();
                lens.sort_unstable();
                Self::Lengths(lens)
            }
            FramingTable::Gap { len: None, idle_us: Some(1..), max_len: Some(max_len) } => {
                Self::Idle { max_len: *max_len }
            }
            FramingTable::Gap { .. } => return Err(GapKeys),
        };
        let shortest = if matches!(framing, Self::Cobs { .. } | Self::Line { .. }) { 8 } else { 1 };
        if (shortest..=LONGEST_FRAME).contains(&framing.max_len()) { Ok(framing) } else { Err(MaxLength) }
    }

    /// Longest frame, bytes, with its wrapping.
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

    /// Largest length of the content, bytes, and whether it is fixed.
    pub(super) fn content_len(&self) -> (usize, bool) {
        match self {
            Framing::Cobs { max_len, .. } | Framing::Line { max_len, .. } => {
                (max_len.saturating_sub(1), false)
            }
            Framing::Fixed { len, .. } => (*len, true),
            Framing::Tagged(tagged) => (tagged.body_len(), true),
            Framing::Length { .. } | Framing::Lengths(_) | Framing::Idle { .. } => (self.max_len(), false),
        }
    }

    /// Positions in the content that belong to the framing.
    pub(super) fn reserved(&self) -> impl Iterator<Item = usize> {
        let (sync, length) = match self {
            Framing::Fixed { sync, .. } => (sync.len(), 0..0),
            Framing::Length { sync, at, bytes, .. } => (sync.len(), *at..at + bytes),
            Framing::Cobs { .. }
            | Framing::Line { .. }
            | Framing::Tagged(_)
            | Framing::Lengths(_)
            | Framing::Idle { .. } => (0, 0..0),
        };
        (0..sync).chain(length)
    }

    /// Whether frames are found by their start, not by a terminator.
    pub(super) fn is_cut_from_start(&self) -> bool {
        !matches!(self, Framing::Cobs { .. } | Framing::Line { .. } | Framing::Idle { .. })
    }

    pub(super) fn cut(&self, pending: &[u8]) -> FrameCut<'_> {
        let one = |len: usize| if pending.len() < len { FrameCut::More } else { FrameCut::Frame(len) };
        let begins = |sync: &[u8]| {
            let known = sync.len().min(pending.len());
            sync[..known] == pending[..known]
        };
        match self {
            Framing::Fixed { sync, len } if begins(sync) => one(*len),
            Framing::Length { sync, at, bytes, endian, adds, max_len } if begins(sync) => {
                let Some(field) = pending.get(*at..at + bytes) else { return FrameCut::More };
                let fold = |value: usize, byte: &u8| (value << 8) | usize::from(*byte);
                let value = match endian {
                    Endian::Be | Endian::Cdab => field.iter().fold(0, fold),
                    Endian::Le | Endian::Badc => field.iter().rev().fold(0, fold),
                };
                match value + adds {
                    len if len > *max_len || len < at + bytes => FrameCut::Skip,
                    len => one(len),
                }
            }
            Framing::Tagged(tagged) if tagged.fits(pending) => one(tagged.len()),
            Framing::Lengths(lens) => FrameCut::OneOf(lens),
            // The first byte begins no frame, or a terminator ends it.
            Framing::Fixed { .. }
            | Framing::Length { .. }
            | Framing::Tagged(_)
            | Framing::Cobs { .. }
            | Framing::Line { .. }
            | Framing::Idle { .. } => FrameCut::Skip,
        }
    }

    /// Whether the pending bytes end with a terminator.
    pub(super) fn is_complete(&self, pending: &[u8]) -> bool {
        match self {
            Framing::Cobs { delimiter, .. } => pending.last() == Some(delimiter),
            Framing::Line { ends, .. } => {
                ends.iter().any(|end| pending.last() == end.last() && pending.ends_with(end))
            }
            Framing::Fixed { .. }
            | Framing::Length { .. }
            | Framing::Tagged(_)
            | Framing::Lengths(_)
            | Framing::Idle { .. } => false,
        }
    }

    /// The length of the frame at the start of `bytes`, if its terminator is within them.
    pub(super) fn terminated_len(&self, bytes: &[u8]) -> Option<usize> {
        let window = &bytes[..bytes.len().min(self.max_len())];
        let last = match self {
            Framing::Cobs { delimiter, .. } => window.iter().position(|byte| byte == delimiter),
            Framing::Line { .. } => (0..window.len()).find(|at| self.is_complete(&window[..=*at])),
            Framing::Fixed { .. }
            | Framing::Length { .. }
            | Framing::Tagged(_)
            | Framing::Lengths(_)
            | Framing::Idle { .. } => None,
        };
        last.map(|last| last + 1)
    }

    /// The content of a complete frame, unpacked into `buffer` if necessary; `None` if the frame is malformed.
    pub(super) fn unwrap<'a>(&self, frame: &'a [u8], buffer: &'a mut Vec<u8>) -> Option<&'a [u8]> {
        buffer.clear();
        match self {
            Framing::Cobs { delimiter, .. } => {
                let (_, stuffed) = frame.split_last().filter(|(last, _)| *last == delimiter)?;
                uncobs(stuffed, *delimiter, buffer)?;
                Some(buffer)
            }
            Framing::Line { start: Some(start), .. } => self.without_end(frame).strip_prefix(&[*start]),
            Framing::Line { start: None, .. } => Some(self.without_end(frame)),
            Framing::Tagged(tagged) => {
                tagged.unwrap(frame, buffer)?;
                Some(buffer)
            }
            Framing::Fixed { .. } | Framing::Length { .. } | Framing::Lengths(_) | Framing::Idle { .. } => {
                Some(frame)
            }
        }
    }

    /// Whether a complete frame is only a terminator.
    pub(super) fn is_empty(&self, frame: &[u8]) -> bool {
        match self {
            Framing::Cobs { .. } => frame.len() == 1,
            Framing::Line { .. } => self.without_end(frame).is_empty(),
            Framing::Fixed { .. }
            | Framing::Length { .. }
            | Framing::Tagged(_)
            | Framing::Lengths(_)
            | Framing::Idle { .. } => false,
        }
    }

    /// Whether a frame may start at these bytes, which follow a malformed start.
    pub(super) fn may_start(&self, rest: &[u8], checked: bool) -> bool {
        match self {
            // Only a check distinguishes a frame from the tail of another.
            Framing::Cobs { .. } => checked && rest.len() > 1,
            Framing::Line { start, .. } => start.is_some() && rest.first() == start.as_ref(),
            Framing::Fixed { .. }
            | Framing::Length { .. }
            | Framing::Tagged(_)
            | Framing::Lengths(_)
            | Framing::Idle { .. } => false,
        }
    }

    /// Writes the synchronising bytes and the length into the content; `check_len` is the length of the check after it.
    pub(super) fn prepare(&self, body: &mut [u8], check_len: usize) {
        let total = body.len() + check_len;
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
            Framing::Fixed { .. } | Framing::Length { .. } | Framing::Lengths(_) | Framing::Idle { .. } => {
                body.to_vec()
            }
        }
    }

    fn without_end<'a>(&self, frame: &'a [u8]) -> &'a [u8] {
        let Framing::Line { ends, .. } = self else { return frame };
        ends.iter().find_map(|end| frame.strip_suffix(&end[..])).unwrap_or(frame)
    }
}

/// Removes byte stuffing: each block is a code byte n, then n - 1 bytes, then a zero unless n is 255 or the block
/// is the last.
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
        // A full block has no zero.
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
        fn byte_stuffing_round_trips(body in prop::collection::vec(prop_oneof![Just(0u8), any::<u8>()], 1..600), delimiter: u8) {
            let stuffed = cobs(&body, delimiter);
            prop_assert!(!stuffed.contains(&delimiter));
            let mut again = Vec::new();
            prop_assert_eq!(uncobs(&stuffed, delimiter, &mut again), Some(()));
            prop_assert_eq!(again, body);
        }
    }

    /// Worked examples of the paper: blocks of 254 bytes need no zero.
    #[test]
    fn long_blocks_are_split_after_254_bytes() {
        assert_eq!(cobs(&[0], 0), [1, 1]);
        assert_eq!(cobs(&[0x11, 0x22, 0, 0x33], 0), [3, 0x11, 0x22, 2, 0x33]);
        let long = vec![7u8; 254];
        let stuffed = cobs(&long, 0);
        assert_eq!((stuffed.len(), stuffed[0]), (255, 255));
    }

    fn length(at: usize, bytes: usize, endian: Endian, adds: usize) -> Framing {
        Framing::Length { sync: vec![0xaa], at, bytes, endian, adds, max_len: 16 }
    }

    fn lines() -> Framing {
        Framing::Line { start: Some(b'#'), ends: vec![b"\r\n".to_vec(), b"\n".to_vec()], max_len: 8 }
    }

    /// Blocks of 254 bytes have the code 255 and no zero; with one more byte a second block follows.
    #[test]
    fn byte_stuffing_of_255_bytes() {
        let stuffed = cobs(&[7; 255], 0);
        assert_eq!((stuffed.len(), stuffed[0], stuffed[255], stuffed[256]), (257, 255, 2, 7));
        assert_eq!(cobs(&[0x11, 0, 0, 0], 0), [2, 0x11, 1, 1, 1]);
        // With another delimiter all bytes are XORed with it.
        assert_eq!(cobs(&[0x7e, 0x01], 0x7e), [3 ^ 0x7e, 0, 0x01 ^ 0x7e]);
    }

    #[test]
    fn malformed_byte_stuffing_is_refused() {
        let unpacked = |stuffed: &[u8]| {
            let mut body = Vec::new();
            uncobs(stuffed, 0, &mut body).map(|()| body)
        };
        assert_eq!(unpacked(&[3, 0x11, 0x22, 2, 0x33]), Some(vec![0x11, 0x22, 0, 0x33]));
        assert_eq!(unpacked(&[4, 0x11, 0x22]), None);
        assert_eq!(unpacked(&[2, 0x11, 0]), None);
        assert_eq!(unpacked(&[1]), None);
        assert_eq!(unpacked(&[]), None);
    }

    #[test]
    fn length_field_ends_a_frame() {
        let framing = length(1, 1, Endian::Be, 3);
        let cut = |bytes: &[u8]| match framing.cut(bytes) {
            FrameCut::Frame(len) => Some(len),
            _ => None,
        };
        assert!(matches!(framing.cut(&[0xaa]), FrameCut::More));
        assert!(matches!(framing.cut(&[0xaa, 2, 0, 0]), FrameCut::More));
        assert_eq!(cut(&[0xaa, 2, 0, 0, 0]), Some(5));
        assert_eq!(cut(&[0xaa, 2, 0, 0, 0, 0xaa]), Some(5));
        assert!(matches!(framing.cut(&[0xab, 2, 0, 0, 0]), FrameCut::Skip));
        assert!(matches!(framing.cut(&[0xaa, 13, 0]), FrameCut::More));
        assert!(matches!(framing.cut(&[0xaa, 14, 0]), FrameCut::Skip));
    }

    #[test]
    fn frame_shorter_than_its_head_is_skipped() {
        let framing = length(1, 1, Endian::Le, 0);
        assert!(matches!(framing.cut(&[0xaa, 1, 0]), FrameCut::Skip));
        assert!(matches!(framing.cut(&[0xaa, 2, 0]), FrameCut::Frame(2)));
        let framing = length(2, 2, Endian::Le, 1);
        assert!(matches!(framing.cut(&[0xaa, 0, 2, 0]), FrameCut::Skip));
        assert!(matches!(framing.cut(&[0xaa, 0, 3, 0]), FrameCut::Frame(4)));
    }

    #[test]
    fn length_of_two_bytes_has_an_order() {
        for (endian, field) in [(Endian::Le, [5, 0]), (Endian::Be, [0, 5])] {
            let framing = length(1, 2, endian, 3);
            assert!(matches!(framing.cut(&[&[0xaa], &field[..], &[0; 5]].concat()), FrameCut::Frame(8)));
            // Six bytes and a check of two are eight, less the three that the field does not count.
            let mut body = [0; 6];
            framing.prepare(&mut body, 2);
            assert_eq!(body[..3], [0xaa, field[0], field[1]]);
        }
    }

    #[test]
    fn records_of_one_length_begin_with_their_bytes() {
        let framing = Framing::Fixed { sync: vec![0x5a, 0xa5], len: 4 };
        assert!(matches!(framing.cut(&[0x5a]), FrameCut::More));
        assert!(matches!(framing.cut(&[0x5a, 0xa5, 1, 2]), FrameCut::Frame(4)));
        assert!(matches!(framing.cut(&[0x5a, 0xa4]), FrameCut::Skip));
        let mut body = [9; 4];
        framing.prepare(&mut body, 0);
        assert_eq!(body, [0x5a, 0xa5, 9, 9]);
        assert_eq!(framing.reserved().collect::<Vec<_>>(), [0, 1]);
        assert_eq!(framing.content_len(), (4, true));
    }

    #[test]
    fn lengths_of_replies_are_tried_in_order() {
        let framing = Framing::Lengths(vec![3, 9]);
        assert!(matches!(framing.cut(&[1]), FrameCut::OneOf([3, 9])));
        assert_eq!(framing.max_len(), 9);
    }

    #[test]
    fn line_ends_with_its_longest_terminator() {
        let framing = lines();
        assert_eq!(framing.terminated_len(b"#12\r\n#3"), Some(5));
        assert_eq!(framing.terminated_len(b"#12\n#3"), Some(4));
        assert_eq!(framing.terminated_len(b"#123456\n"), Some(8));
        assert_eq!(framing.terminated_len(b"#1234567\n"), None);
        let mut buffer = Vec::new();
        assert_eq!(framing.unwrap(b"#12\r\n", &mut buffer), Some(&b"12"[..]));
        assert_eq!(framing.unwrap(b"12\r\n", &mut buffer), None);
        assert_eq!(framing.wrap(b"12"), b"#12\r\n");
        assert!(framing.is_empty(b"\r\n") && !framing.is_empty(b"#\n"));
        assert!(framing.may_start(b"#1", false) && !framing.may_start(b"1#", true));
    }

    #[test]
    fn stuffed_frame_ends_with_its_delimiter() {
        let framing = Framing::Cobs { delimiter: 0, max_len: 8 };
        let frame = framing.wrap(&[0x11, 0x22, 0, 0x33]);
        assert_eq!(frame, [3, 0x11, 0x22, 2, 0x33, 0]);
        let mut buffer = Vec::new();
        assert_eq!(framing.unwrap(&frame, &mut buffer), Some(&[0x11, 0x22, 0, 0x33][..]));
        assert_eq!(framing.unwrap(&frame[..5], &mut Vec::new()), None);
        assert_eq!(framing.terminated_len(&[1, 2, 0, 4, 0]), Some(3));
        assert!(framing.may_start(&[2, 1], true) && !framing.may_start(&[2, 1], false));
        assert!(!framing.may_start(&[2], true));
        assert_eq!(framing.content_len(), (7, false));
    }

    #[test]
    fn places_of_sync_and_length_are_reserved() {
        assert_eq!(length(2, 2, Endian::Le, 0).reserved().collect::<Vec<_>>(), [0, 2, 3]);
        assert_eq!(lines().reserved().count(), 0);
    }
}
