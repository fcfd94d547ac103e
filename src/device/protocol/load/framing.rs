//! Framing: how a frame begins and ends.

use super::vectors;
use crate::catalogue::ProtocolFinding::{
    self, DelimiterEnd, FixedSync, GapKeys, LengthField, LengthSync, LineEnds, LineStart, MaxLength,
};
use crate::device::protocol::decoder::LONGEST_END;
use crate::device::protocol::framing::{Framing, LONGEST_FRAME};
use crate::device::protocol::table::FramingTable;
use crate::device::protocol::tagged::Tagged;

/// Checks `[framing]` and compiles it.
pub(super) fn compile(table: &FramingTable) -> Result<Framing, ProtocolFinding> {
    let framing = match table {
        FramingTable::Cobs { delimiter, max_len } => {
            Framing::Cobs { delimiter: *delimiter, max_len: *max_len }
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
            Framing::Line { start, ends, max_len: *max_len }
        }
        FramingTable::Delim { end, max_len } => {
            let end = vectors::bytes(end).filter(|end| (1..=LONGEST_END).contains(&end.len()));
            Framing::Line { start: None, ends: vec![end.ok_or(DelimiterEnd)?], max_len: *max_len }
        }
        FramingTable::Fixed { sync, len } => {
            let sync = vectors::bytes(sync).filter(|sync| sync.len() < *len);
            Framing::Fixed { sync: sync.ok_or(FixedSync)?, len: *len }
        }
        FramingTable::Length { sync, len_at, len_bytes, len_endian, len_adds, max_len } => {
            let sync = vectors::bytes(sync).filter(|sync| sync.len() <= *len_at).ok_or(LengthSync)?;
            if !matches!(len_bytes, 1 | 2) || *len_at >= LONGEST_FRAME || *len_adds >= LONGEST_FRAME {
                return Err(LengthField);
            }
            Framing::Length {
                sync,
                at: *len_at,
                bytes: usize::from(*len_bytes),
                endian: *len_endian,
                adds: *len_adds,
                max_len: *max_len,
            }
        }
        FramingTable::Tagged { data_bits, order, tags } => {
            Framing::Tagged(Tagged::new(*data_bits, *order, tags)?)
        }
        FramingTable::Gap { len: Some(lens), idle_us: None, max_len: None } if !lens.is_empty() => {
            let mut lens = lens.clone();
            lens.sort_unstable();
            Framing::Lengths(lens)
        }
        FramingTable::Gap { len: None, idle_us: Some(1..), max_len: Some(max_len) } => {
            Framing::Idle { max_len: *max_len }
        }
        FramingTable::Gap { .. } => return Err(GapKeys),
    };
    let shortest = if matches!(framing, Framing::Cobs { .. } | Framing::Line { .. }) { 8 } else { 1 };
    if (shortest..=LONGEST_FRAME).contains(&framing.max_len()) { Ok(framing) } else { Err(MaxLength) }
}
