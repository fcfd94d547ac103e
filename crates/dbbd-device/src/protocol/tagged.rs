//! Records whose bytes hold data in their low bits and their position in the high bits.
//!
//! A tag is written from the highest bit: `0` and `1` are fixed; a letter is a value that is equal in every byte of a
//! record. The values of the letters follow the data in the content, one byte per letter.

use crate::protocol::ProtocolFinding::{
    self, TagBits, TagCount, TagLetterApart, TagLettersDiffer, TagSymbol,
};
use serde::Deserialize;

/// Which byte of a tagged record holds the lowest bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum TagOrder {
    #[default]
    LowFirst,
    HighFirst,
}

#[derive(Clone, Debug)]
pub(super) struct TaggedRecord {
    data_bits: u32,
    order: TagOrder,
    /// Mask and value for each byte.
    tags: Vec<(u8, u8)>,
    /// Masks of the letters, in order.
    letters: Vec<u8>,
}

/// Fixed bits and masks of the letters.
#[derive(Default)]
struct Tag {
    mask: u8,
    value: u8,
    letters: Vec<(char, u8)>,
}

impl Tag {
    fn read(text: &str) -> Result<Self, ProtocolFinding> {
        let mut tag = Self::default();
        for (bit, symbol) in text.chars().enumerate() {
            let bit = 0x80u8 >> bit;
            match symbol {
                '0' => tag.mask |= bit,
                '1' => (tag.mask, tag.value) = (tag.mask | bit, tag.value | bit),
                letter if letter.is_ascii_alphabetic() => {
                    match tag.letters.iter_mut().find(|(known, _)| *known == letter) {
                        Some((_, mask)) if *mask & (bit << 1) != 0 => *mask |= bit,
                        Some(_) => return Err(TagLetterApart { letter }),
                        None => tag.letters.push((letter, bit)),
                    }
                }
                symbol => return Err(TagSymbol { symbol }),
            }
        }
        Ok(tag)
    }
}

impl TaggedRecord {
    pub(super) fn new(data_bits: u32, order: TagOrder, tags: &[String]) -> Result<Self, ProtocolFinding> {
        if !(1..=7).contains(&data_bits) || tags.is_empty() || tags.len() > 16 {
            return Err(TagCount);
        }
        let (mut fixed, mut letters) = (Vec::new(), Vec::<(char, u8)>::new());
        for (place, tag) in tags.iter().enumerate() {
            if tag.chars().count() != 8 - data_bits as usize {
                return Err(TagBits { tag: tag.clone(), bits: 8 - data_bits });
            }
            let Tag { mask, value, letters: seen } = Tag::read(tag)?;
            if place > 0 && seen != letters {
                return Err(TagLettersDiffer);
            }
            letters = seen;
            fixed.push((mask, value));
        }
        let letters = letters.into_iter().map(|(_, mask)| mask).collect();
        Ok(Self { data_bits, order, tags: fixed, letters })
    }

    pub(super) fn len(&self) -> usize {
        self.tags.len()
    }

    fn data_len(&self) -> usize {
        (self.tags.len() * self.data_bits as usize).div_ceil(8)
    }

    /// Length of the content: the data as an integer, lowest byte first, then the letters.
    pub(super) fn body_len(&self) -> usize {
        self.data_len() + self.letters.len()
    }

    /// Whether a record may start with these bytes.
    pub(super) fn fits(&self, pending: &[u8]) -> bool {
        let first = pending.first().copied().unwrap_or(0);
        pending.iter().zip(&self.tags).all(|(byte, (mask, value))| {
            byte & mask == *value && self.letters.iter().all(|letter| byte & letter == first & letter)
        })
    }

    pub(super) fn unwrap(&self, frame: &[u8], body: &mut Vec<u8>) -> Option<()> {
        if frame.len() != self.len() || !self.fits(frame) {
            return None;
        }
        let data = u8::MAX >> (8 - self.data_bits);
        let fold = |value: u128, byte: &u8| (value << self.data_bits) | u128::from(byte & data);
        let value = if self.order == TagOrder::LowFirst {
            frame.iter().rev().fold(0, fold)
        } else {
            frame.iter().fold(0, fold)
        };
        body.extend_from_slice(&value.to_le_bytes()[..self.data_len()]);
        let first = frame.first()?;
        body.extend(self.letters.iter().map(|mask| (first & mask) >> mask.trailing_zeros()));
        Some(())
    }

    /// The record of a content; excess bits are dropped.
    pub(super) fn wrap(&self, body: &[u8]) -> Vec<u8> {
        let (data, letters) = body.split_at(self.data_len().min(body.len()));
        let mut value = data.iter().rev().fold(0u128, |value, byte| (value << 8) | u128::from(*byte));
        let high = self.letters.iter().zip(letters);
        let high = high.fold(0, |bits, (mask, letter)| bits | (letter << mask.trailing_zeros() & mask));
        let low = u8::MAX >> (8 - self.data_bits);
        let mut parts: Vec<u8> = Vec::new();
        for _ in &self.tags {
            parts.push((value & u128::from(low)) as u8);
            value >>= self.data_bits;
        }
        if self.order == TagOrder::HighFirst {
            parts.reverse();
        }
        parts.iter().zip(&self.tags).map(|(part, (_, tag))| part | tag | high).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(data_bits: u32, order: TagOrder, tags: &[&str]) -> Result<TaggedRecord, ProtocolFinding> {
        let tags: Vec<String> = tags.iter().map(|tag| (*tag).to_owned()).collect();
        TaggedRecord::new(data_bits, order, &tags)
    }

    fn unwrapped(record: &TaggedRecord, frame: &[u8]) -> Option<Vec<u8>> {
        let mut body = Vec::new();
        record.unwrap(frame, &mut body).map(|()| body)
    }

    /// 0x1234 in sevens of bits is 0x24 and 0x34.
    #[test]
    fn data_are_spread_over_the_low_bits() {
        for (order, frame) in [(TagOrder::LowFirst, [0x34, 0xa4]), (TagOrder::HighFirst, [0x24, 0xb4])] {
            let record = record(7, order, &["0", "1"]).unwrap();
            assert_eq!(record.wrap(&[0x34, 0x12]), frame);
            assert_eq!(unwrapped(&record, &frame), Some(vec![0x34, 0x12]));
            assert_eq!(unwrapped(&record, &[frame[1], frame[0]]), None);
            assert_eq!(unwrapped(&record, &frame[..1]), None);
            assert_eq!((record.len(), record.body_len()), (2, 2));
        }
    }

    /// Five bits of data; the letters are bits 6 and 5 of each byte.
    #[test]
    fn letters_are_equal_in_every_byte() {
        let record = record(5, TagOrder::LowFirst, &["0ab", "1ab"]).unwrap();
        assert_eq!(record.body_len(), 4);
        assert_eq!(record.wrap(&[0xff, 0x03, 1, 0]), [0x5f, 0xdf]);
        assert_eq!(unwrapped(&record, &[0x5f, 0xdf]), Some(vec![0xff, 0x03, 1, 0]));
        assert_eq!(unwrapped(&record, &[0x21, 0xa0]), Some(vec![0x01, 0x00, 0, 1]));
        assert!(!record.fits(&[0x5f, 0x9f]) && record.fits(&[0x5f]));
    }

    #[test]
    fn letter_of_two_bits_is_a_number() {
        let record = record(5, TagOrder::LowFirst, &["0aa"]).unwrap();
        assert_eq!(unwrapped(&record, &[0x7f]), Some(vec![0x1f, 3]));
        assert_eq!(record.wrap(&[0x1f, 2]), [0x5f]);
    }

    #[test]
    fn a_letter_has_adjacent_bits() {
        for tag in ["a0a", "a1a", "aba"] {
            let refused = record(5, TagOrder::LowFirst, &[tag]).err();
            assert!(matches!(refused, Some(TagLetterApart { letter: 'a' })), "{tag}: {refused:?}");
        }
        assert!(record(4, TagOrder::LowFirst, &["0aab"]).is_ok());
    }

    #[test]
    fn impossible_tags_are_refused() {
        assert!(record(1, TagOrder::LowFirst, &["0000000"]).is_ok());
        assert!(record(7, TagOrder::LowFirst, &["0"; 16]).is_ok());
        for (bits, tags) in [
            (0, vec!["00000000"]),
            (8, vec![""]),
            (7, vec![]),
            (7, vec!["0"; 17]),
            (7, vec!["00"]),
            (5, vec!["0ab", "1ba"]),
            (5, vec!["0a?"]),
        ] {
            assert!(record(bits, TagOrder::LowFirst, &tags).is_err(), "{bits} {tags:?}");
        }
    }
}
