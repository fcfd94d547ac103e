//! The value that guards a frame: XOR, sum, or a CRC by name or by parameters.
//!
//! CRCs follow the Rocksoft model: width, polynomial, initial value, reflection of input and output,
//! final XOR; the check value is the CRC over the nine characters "123456789".

use super::table::CheckEncoding;

/// How a frame's check is computed and where it stands.
#[derive(Clone, Debug)]
pub(super) struct Check {
    pub(super) sum: Sum,
    pub(super) hex: bool,
    pub(super) big_endian: bool,
    /// The character between content and check.
    pub(super) after: Option<u8>,
    /// Whether a frame without that character is taken unchecked.
    pub(super) optional: bool,
    /// So many bytes at the beginning are not covered.
    pub(super) from: usize,
}

/// The arithmetic.
#[derive(Clone, Debug)]
pub(super) enum Sum {
    Xor8,
    Sum8,
    Crc(Tabled),
}

/// Parameters of a CRC of up to 32 bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Crc {
    pub(super) width: u8,
    pub(super) poly: u32,
    pub(super) init: u32,
    pub(super) refin: bool,
    pub(super) refout: bool,
    pub(super) xorout: u32,
}

/// A CRC of the catalogue: name, parameters, check value.
macro_rules! catalogue {
    ($($name:literal => $constant:ident),* $(,)?) => {
        /// The catalogue's CRCs that a definition may name, with their check values.
        pub(super) fn named(name: &str) -> Option<(Crc, u32)> {
            match name {
                $($name => {
                    let a = &crc::$constant;
                    let crc = Crc {
                        width: a.width, poly: a.poly.into(), init: a.init.into(),
                        refin: a.refin, refout: a.refout, xorout: a.xorout.into(),
                    };
                    Some((crc, a.check.into()))
                })*
                _ => None,
            }
        }

        /// Their names.
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

/// A CRC with what each byte does to its register. (The `crc` crate's tables need parameters that are known when it is compiled.)
#[derive(Clone, Debug)]
pub(super) struct Tabled {
    crc: Crc,
    table: Box<[u32; 256]>,
}

impl Tabled {
    pub(super) fn new(crc: Crc) -> Self {
        let width = u32::from(crc.width.clamp(8, 32));
        let top = 1u32 << (width - 1);
        let entry = |byte: usize| {
            let mut register = (byte as u32) << (width - 8);
            for _ in 0..8 {
                let carry = register & top != 0;
                register = (register << 1) ^ if carry { crc.poly } else { 0 };
            }
            register & (u32::MAX >> (32 - width))
        };
        Self { crc, table: Box::new(std::array::from_fn(entry)) }
    }

    /// The CRC over `bytes`.
    pub(super) fn compute(&self, bytes: &[u8]) -> u32 {
        let Self { crc, table } = self;
        let width = u32::from(crc.width.clamp(8, 32));
        let mask = u32::MAX >> (32 - width);
        let mut register = crc.init & mask;
        for &byte in bytes {
            let byte = if crc.refin { byte.reverse_bits() } else { byte };
            let [.., at] = ((register >> (width - 8)) ^ u32::from(byte)).to_be_bytes();
            register = ((register << 8) & mask) ^ table[usize::from(at)];
        }
        if crc.refout {
            register = register.reverse_bits() >> (32 - width);
        }
        (register ^ crc.xorout) & mask
    }
}

impl std::fmt::Display for Check {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match &self.sum {
            Sum::Xor8 => write!(f, "XOR of the bytes"),
            Sum::Sum8 => write!(f, "sum of the bytes"),
            Sum::Crc(Tabled { crc, .. }) => write!(f, "CRC-{}, polynomial {:#x}", crc.width, crc.poly),
        }?;
        if self.optional { write!(f, ", may be absent") } else { Ok(()) }
    }
}

impl Check {
    pub(super) fn new(
        sum: Sum,
        encoding: CheckEncoding,
        after: Option<u8>,
        optional: bool,
        from: usize,
    ) -> Self {
        let (hex, big_endian) = (encoding == CheckEncoding::Hex, encoding == CheckEncoding::Be);
        Self { sum, hex, big_endian, after, optional, from }
    }

    /// The share of frames of noise that pass.
    pub(super) fn undetected(&self) -> f64 {
        let bits = match &self.sum {
            Sum::Xor8 | Sum::Sum8 => 8,
            Sum::Crc(Tabled { crc, .. }) => i32::from(crc.width),
        };
        if self.optional { 1.0 } else { 0.5f64.powi(bits) }
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
        let written = self.written(content);
        // Hexadecimal digits are read in either case.
        let right = if self.hex { written == sent.to_ascii_uppercase() } else { written == sent };
        right.then_some(content)
    }

    /// Appends the check to the content.
    pub(super) fn append(&self, body: &mut Vec<u8>) {
        let written = self.written(body);
        body.extend(self.after);
        body.extend(written);
    }

    fn digits(&self) -> usize {
        let bytes = match &self.sum {
            Sum::Xor8 | Sum::Sum8 => 1,
            Sum::Crc(Tabled { crc, .. }) => usize::from(crc.width.div_ceil(8)),
        };
        if self.hex { 2 * bytes } else { bytes }
    }

    fn written(&self, content: &[u8]) -> Vec<u8> {
        let content = content.get(self.from..).unwrap_or_default();
        let value = match &self.sum {
            Sum::Xor8 => content.iter().fold(0, |sum, byte| sum ^ u32::from(*byte)),
            Sum::Sum8 => content.iter().fold(0u8, |sum, byte| sum.wrapping_add(*byte)).into(),
            Sum::Crc(crc) => crc.compute(content),
        };
        let digits = self.digits();
        if self.hex {
            return format!("{value:0digits$X}").into_bytes();
        }
        let mut bytes = value.to_le_bytes()[..digits.min(4)].to_vec();
        if self.big_endian {
            bytes.reverse();
        }
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The catalogue's own check values, computed by an implementation that is not the catalogue's.
    #[test]
    fn every_named_crc_gives_its_check_value() {
        for name in NAMES {
            let (crc, check) = named(name).unwrap();
            assert_eq!(Tabled::new(crc).compute(b"123456789"), check, "{name}");
        }
    }

    /// A width that no table of the catalogue's macro has, by its parameters.
    #[test]
    fn a_crc_of_24_bits_gives_its_check_value() {
        let a = &crc::CRC_24_OPENPGP;
        let crc = Crc {
            width: a.width,
            poly: a.poly,
            init: a.init,
            refin: a.refin,
            refout: a.refout,
            xorout: a.xorout,
        };
        assert_eq!(Tabled::new(crc).compute(b"123456789"), a.check);
    }
}
