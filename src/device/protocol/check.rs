//! The value that guards a frame: XOR, sum, or a CRC by name or by parameters.
//!
//! CRCs follow the Rocksoft model: width, polynomial, initial value, reflection of input and output,
//! final XOR; the check value is the CRC over the nine characters "123456789".

use std::fmt;
use std::sync::Mutex;

use crc::{Algorithm, Table};

use super::table::CheckEncoding;
use crate::base::sync::lock;

#[derive(Clone, Debug)]
pub(super) struct Check {
    pub(super) sum: Sum,
    pub(super) encoding: CheckEncoding,
    /// The character between content and check.
    pub(super) after: Option<u8>,
    /// Whether a frame without that character is taken unchecked.
    pub(super) optional: bool,
    /// So many bytes at the beginning are not covered.
    pub(super) from: usize,
}

#[derive(Clone, Debug)]
pub(super) enum Sum {
    Xor8,
    Sum8,
    Crc(Box<Crc>),
}

/// A CRC of up to 32 bits with its table.
#[derive(Clone)]
pub(super) struct Crc(crc::Crc<u32, Table<1>>);

/// A CRC of the catalogue: name and parameters.
macro_rules! catalogue {
    ($($name:literal => $constant:ident),* $(,)?) => {
        /// The parameters of the catalogue's CRCs that a definition may name.
        pub(super) fn named(name: &str) -> Option<Algorithm<u32>> {
            match name {
                $($name => {
                    let a = &crc::$constant;
                    Some(Algorithm {
                        width: a.width, poly: a.poly.into(), init: a.init.into(), refin: a.refin,
                        refout: a.refout, xorout: a.xorout.into(), check: a.check.into(), residue: 0,
                    })
                })*
                _ => None,
            }
        }

        pub(super) const NAMES: &[&str] = &[$($name),*];
    };
}

catalogue! {
    "CRC-8/SMBUS" => CRC_8_SMBUS,
    "CRC-16/ARC" => CRC_16_ARC,
    "CRC-16/IBM-3740" => CRC_16_IBM_3740,
    "CRC-16/IBM-SDLC" => CRC_16_IBM_SDLC,
    "CRC-16/KERMIT" => CRC_16_KERMIT,
    "CRC-16/MODBUS" => CRC_16_MODBUS,
    "CRC-16/SPI-FUJITSU" => CRC_16_SPI_FUJITSU,
    "CRC-16/XMODEM" => CRC_16_XMODEM,
    "CRC-32/ISO-HDLC" => CRC_32_ISO_HDLC,
}

impl Crc {
    pub(super) fn new(parameters: Algorithm<u32>) -> Self {
        // A table borrows its parameters for as long as the program runs: each set of them is kept once.
        static KEPT: Mutex<Vec<&Algorithm<u32>>> = Mutex::new(Vec::new());
        let mut kept = lock(&KEPT);
        let known = kept.iter().copied().find(|known| **known == parameters);
        let algorithm = known.unwrap_or_else(|| {
            let new: &Algorithm<u32> = Box::leak(Box::new(parameters));
            kept.push(new);
            new
        });
        Self(crc::Crc::<u32, Table<1>>::new(algorithm))
    }

    /// Whether the parameters give the check value that is stated with them; else the one that they give.
    pub(super) fn verify(&self) -> Result<(), u32> {
        let check = self.0.checksum(b"123456789");
        if check == self.0.algorithm.check { Ok(()) } else { Err(check) }
    }
}

impl fmt::Debug for Crc {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.algorithm.fmt(out)
    }
}

impl fmt::Display for Check {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.sum {
            Sum::Xor8 => write!(out, "XOR of the bytes"),
            Sum::Sum8 => write!(out, "sum of the bytes"),
            Sum::Crc(crc) => {
                write!(out, "CRC-{}, polynomial {:#x}", crc.0.algorithm.width, crc.0.algorithm.poly)
            }
        }?;
        if self.optional { write!(out, ", may be absent") } else { Ok(()) }
    }
}

impl Check {
    fn bits(&self) -> u8 {
        match &self.sum {
            Sum::Xor8 | Sum::Sum8 => 8,
            Sum::Crc(crc) => crc.0.algorithm.width,
        }
    }

    /// The share of frames of noise that pass.
    pub(super) fn undetected(&self) -> f64 {
        if self.optional { 1.0 } else { 0.5f64.powi(self.bits().into()) }
    }

    /// Length of the check as sent, with the character before it.
    pub(super) fn len(&self) -> usize {
        self.digits() + usize::from(self.after.is_some())
    }

    /// The content without its check; none when the check is wrong or missing.
    pub(super) fn strip<'a>(&self, body: &'a [u8]) -> Option<&'a [u8]> {
        if let (Some(after), true) = (self.after, self.optional)
            && !body.contains(&after)
        {
            return Some(body);
        }
        let (content, tail) = body.split_at_checked(body.len().checked_sub(self.len())?)?;
        let sent = match self.after {
            Some(after) => tail.strip_prefix(&[after])?,
            None => tail,
        };
        (self.sent(sent)? == self.value(content)).then_some(content)
    }

    pub(super) fn append(&self, body: &mut Vec<u8>) {
        let (value, digits) = (self.value(body), self.digits());
        body.extend(self.after);
        match self.encoding {
            CheckEncoding::Hex => body.extend(format!("{value:0digits$X}").into_bytes()),
            CheckEncoding::Le => body.extend(&value.to_le_bytes()[..digits.min(4)]),
            CheckEncoding::Be => body.extend(&value.to_be_bytes()[4 - digits.min(4)..]),
        }
    }

    /// Length of the value as sent.
    fn digits(&self) -> usize {
        let bytes = usize::from(self.bits().div_ceil(8));
        if self.encoding == CheckEncoding::Hex { 2 * bytes } else { bytes }
    }

    /// The value that was sent; hexadecimal digits are read in either case.
    fn sent(&self, sent: &[u8]) -> Option<u32> {
        let digit = |byte: &u8| char::from(*byte).to_digit(16);
        let byte = |value: u32, byte: &u8| value << 8 | u32::from(*byte);
        match self.encoding {
            CheckEncoding::Hex => sent.iter().try_fold(0, |value, byte| Some(value << 4 | digit(byte)?)),
            CheckEncoding::Le => Some(sent.iter().rev().fold(0, byte)),
            CheckEncoding::Be => Some(sent.iter().fold(0, byte)),
        }
    }

    fn value(&self, content: &[u8]) -> u32 {
        let content = content.get(self.from..).unwrap_or_default();
        match &self.sum {
            Sum::Xor8 => content.iter().fold(0, |sum, byte| sum ^ u32::from(*byte)),
            Sum::Sum8 => content.iter().fold(0u8, |sum, byte| sum.wrapping_add(*byte)).into(),
            Sum::Crc(crc) => crc.0.checksum(content),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// In 32 bits of room, whatever the width: the catalogue's own check values.
    #[test]
    fn every_named_crc_gives_its_check_value() {
        for name in NAMES {
            assert_eq!(Crc::new(named(name).unwrap()).verify(), Ok(()), "{name}");
        }
    }

    /// A width that no integer has.
    #[test]
    fn a_crc_of_24_bits_gives_its_check_value() {
        assert_eq!(Crc::new(crc::CRC_24_OPENPGP).verify(), Ok(()));
    }
}
