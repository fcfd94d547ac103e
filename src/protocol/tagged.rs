//! Records whose bytes carry data in their low bits and their place in the high ones.
//!
//! A tag is written from the highest bit: `0` and `1` must stand there; a letter is a value that is
//! the same in every byte of a record, and follows the data in the content, one byte a letter.

/// The tags of a record.
#[derive(Clone, Debug)]
pub(super) struct Tagged {
    data_bits: u32,
    low_first: bool,
    /// Mask and value, byte by byte.
    tags: Vec<(u8, u8)>,
    /// Masks of the letters, in the order in which they stand.
    letters: Vec<u8>,
}

impl Tagged {
    /// Compiles tags; says what is wrong with them.
    pub(super) fn new(data_bits: u32, low_first: bool, tags: &[String]) -> Result<Self, String> {
        if !(1..=7).contains(&data_bits) || tags.is_empty() || tags.len() > 16 {
            return Err("data_bits must be 1 to 7, and tags 1 to 16".into());
        }
        let (mut fixed, mut letters) = (Vec::new(), Vec::<(char, u8)>::new());
        for (place, tag) in tags.iter().enumerate() {
            if tag.chars().count() != 8 - data_bits as usize {
                return Err(format!("tag `{tag}` must have {} bits", 8 - data_bits));
            }
            let (mut mask, mut value, mut seen) = (0u8, 0u8, Vec::<(char, u8)>::new());
            for (bit, symbol) in tag.chars().enumerate() {
                let bit = 0x80u8 >> bit;
                match symbol {
                    '0' | '1' => {
                        mask |= bit;
                        value |= if symbol == '1' { bit } else { 0 };
                    }
                    letter if letter.is_ascii_alphabetic() => {
                        let known = seen.iter().position(|(known, _)| *known == letter);
                        let last = seen.len().wrapping_sub(1);
                        match known.and_then(|at| Some((at, seen.get_mut(at)?))) {
                            Some((at, (_, mask))) if at == last => *mask |= bit,
                            Some(_) => return Err(format!("the bits of `{letter}` do not stand together")),
                            None => seen.push((letter, bit)),
                        }
                    }
                    other => return Err(format!("`{other}` in a tag: 0, 1 or a letter")),
                }
            }
            if place > 0 && seen != letters {
                return Err("the letters must stand at the same bits in every tag".into());
            }
            letters = seen;
            fixed.push((mask, value));
        }
        let letters = letters.into_iter().map(|(_, mask)| mask).collect();
        Ok(Self { data_bits, low_first, tags: fixed, letters })
    }

    /// Bytes of a record.
    pub(super) fn len(&self) -> usize {
        self.tags.len()
    }

    fn data_len(&self) -> usize {
        (self.tags.len() * self.data_bits as usize).div_ceil(8)
    }

    /// Bytes of its content: the data as an integer, lowest byte first, then the letters.
    pub(super) fn body_len(&self) -> usize {
        self.data_len() + self.letters.len()
    }

    /// Whether these may be the first bytes of a record.
    pub(super) fn fits(&self, pending: &[u8]) -> bool {
        let first = pending.first().copied().unwrap_or(0);
        pending.iter().zip(&self.tags).all(|(byte, (mask, value))| {
            byte & mask == *value && self.letters.iter().all(|letter| byte & letter == first & letter)
        })
    }

    /// The content of a record.
    pub(super) fn unwrap(&self, frame: &[u8]) -> Option<Vec<u8>> {
        if frame.len() != self.len() || !self.fits(frame) {
            return None;
        }
        let data = u8::MAX >> (8 - self.data_bits);
        let fold = |value: u128, byte: &u8| (value << self.data_bits) | u128::from(byte & data);
        let value =
            if self.low_first { frame.iter().rev().fold(0, fold) } else { frame.iter().fold(0, fold) };
        let mut body = value.to_le_bytes()[..self.data_len()].to_vec();
        let first = frame.first()?;
        body.extend(self.letters.iter().map(|mask| (first & mask) >> mask.trailing_zeros()));
        Some(body)
    }

    /// The record of a content; bits that have no room are lost.
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
        if !self.low_first {
            parts.reverse();
        }
        parts.iter().zip(&self.tags).map(|(part, (_, tag))| part | tag | high).collect()
    }
}
