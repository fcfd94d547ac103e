//! Framing: how a frame begins and ends.

use toml::Spanned;

use super::source::Source;
use super::vectors;
use crate::diag::Diagnostic;
use crate::protocol::decoder::LONGEST_END;
use crate::protocol::framing::{Framing, LONGEST_FRAME};
use crate::protocol::table::field::Endian;
use crate::protocol::table::{FramingTable, Order};
use crate::protocol::tagged::Tagged;

/// Checks `[framing]` and compiles it.
pub(super) fn compile(source: Source, table: &Spanned<FramingTable>) -> Result<Framing, Diagnostic> {
    let wrong = |message: &str| Err(source.wrong(table.span(), format!("[framing]: {message}")));
    let framing = match table.get_ref() {
        FramingTable::Cobs { delimiter, max_len } => {
            Framing::Cobs { delimiter: *delimiter, max_len: *max_len }
        }
        FramingTable::Line { start, end, max_len } => {
            let start = match start.as_deref().map(str::as_bytes) {
                None => None,
                Some([start]) => Some(*start),
                Some(_) => return wrong("start must be one ASCII character"),
            };
            let mut ends: Vec<Vec<u8>> = end.iter().map(|end| end.clone().into_bytes()).collect();
            if ends.is_empty() || ends.iter().any(|end| end.is_empty() || end.len() > LONGEST_END) {
                return wrong("end must list one or more line ends of 1 to 4 bytes");
            }
            ends.sort_by_key(|end| std::cmp::Reverse(end.len()));
            Framing::Line { start, ends, max_len: *max_len }
        }
        FramingTable::Delim { end, max_len } => match vectors::bytes(end) {
            Some(end) if (1..=LONGEST_END).contains(&end.len()) => {
                Framing::Line { start: None, ends: vec![end], max_len: *max_len }
            }
            _ => return wrong("end must be 1 to 4 bytes in hexadecimal"),
        },
        FramingTable::Fixed { sync, len } => match vectors::bytes(sync) {
            Some(sync) if sync.len() < *len => Framing::Fixed { sync, len: *len },
            _ => return wrong("sync must be hexadecimal and shorter than len"),
        },
        FramingTable::Length { sync, len_at, len_bytes, len_endian, len_adds, max_len } => {
            let Some(sync) = vectors::bytes(sync).filter(|sync| sync.len() <= *len_at) else {
                return wrong("sync must be hexadecimal, and end before len_at");
            };
            if !matches!(len_bytes, 1 | 2) || *len_at >= LONGEST_FRAME || *len_adds >= LONGEST_FRAME {
                return wrong("len_bytes must be 1 or 2, len_at and len_adds below 4096");
            }
            Framing::Length {
                sync,
                at: *len_at,
                bytes: usize::from(*len_bytes),
                big_endian: *len_endian == Endian::Be,
                adds: *len_adds,
                max_len: *max_len,
            }
        }
        FramingTable::Tagged { data_bits, order, tags } => {
            match Tagged::new(*data_bits, *order == Order::LowFirst, tags) {
                Ok(tagged) => Framing::Tagged(tagged),
                Err(message) => return wrong(&message),
            }
        }
        FramingTable::Gap { len: Some(lens), idle_us: None, max_len: None } if !lens.is_empty() => {
            let mut lens = lens.clone();
            lens.sort_unstable();
            Framing::Lengths(lens)
        }
        FramingTable::Gap { len: None, idle_us: Some(1..), max_len: Some(max_len) } => {
            Framing::Idle { max_len: *max_len }
        }
        FramingTable::Gap { .. } => return wrong("a gap needs `len = [..]`, or `idle_us` and `max_len`"),
    };
    let shortest = if matches!(framing, Framing::Cobs { .. } | Framing::Line { .. }) { 8 } else { 1 };
    if !(shortest..=LONGEST_FRAME).contains(&framing.max_len()) {
        return wrong("max_len must be 8 to 4096 bytes");
    }
    Ok(framing)
}
