//! The check of a frame: XOR, sum, or a CRC by name or by parameters.
//!
//! CRCs follow the Rocksoft model: width, polynomial, initial value, reflection of input and output,
//! final XOR; the check value is the CRC over the nine characters "123456789".

use std::fmt;
use std::sync::Mutex;

use crc::{Algorithm, Table};

use super::source::DefinitionSource;
use crate::protocol::ProtocolFinding::{
    AfterCharacter, CrcDiffers, CrcWidth, EncodingMissing, NameAndParameters, OptionalWithoutAfter,
    ParametersMissing, ParametersWithoutCrc, UnknownCrc,
};
use crate::sync::lock;
use dbbd_model::diagnostic::Diagnostic;
use serde::Deserialize;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CheckTable {
    kind: CheckKind,
    enc: Option<CheckEncoding>,
    after: Option<String>,
    /// Number of bytes at the start that are not covered.
    #[serde(default)]
    over_from: usize,
    #[serde(default)]
    optional: bool,
    name: Option<String>,
    width: Option<u8>,
    poly: Option<u32>,
    init: Option<u32>,
    refin: Option<bool>,
    refout: Option<bool>,
    xorout: Option<u32>,
    check: Option<u32>,
}

#[derive(Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum CheckKind {
    None,
    Xor8,
    Sum8,
    Crc,
}

/// Lowest byte first, highest byte first, or hexadecimal digits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum CheckEncoding {
    Le,
    Be,
    Hex,
}

#[derive(Clone, Debug)]
pub(super) struct FrameCheck {
    sum: ChecksumAlgorithm,
    encoding: CheckEncoding,
    /// Character between content and check.
    after: Option<u8>,
    /// Whether a frame without that character is accepted unchecked.
    optional: bool,
    /// Number of bytes at the start that are not covered.
    from: usize,
}

#[derive(Clone, Debug)]
enum ChecksumAlgorithm {
    Xor8,
    Sum8,
    Crc(Box<TabulatedCrc>),
}

/// A CRC of up to 32 bits with its tables, which take the bytes of a block at once.
#[derive(Clone)]
struct TabulatedCrc {
    crc: crc::Crc<u32, Table<BLOCK>>,
    /// The initial value as bytes, which are XORed with the first bytes of the data.
    first: [u8; 4],
}

/// Bytes of a block.
const BLOCK: usize = 16;

macro_rules! catalogue {
    ($($name:literal => $constant:ident),* $(,)?) => {
        /// Parameters of a CRC that a definition may name.
        fn named(name: &str) -> Option<Algorithm<u32>> {
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

        const NAMES: &[&str] = &[$($name),*];
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

impl TabulatedCrc {
    fn new(parameters: Algorithm<u32>) -> Self {
        // A table borrows its parameters for the life of the program: each set is leaked once.
        static KEPT: Mutex<Vec<&Algorithm<u32>>> = Mutex::new(Vec::new());
        let mut kept = lock(&KEPT);
        let known = kept.iter().copied().find(|known| **known == parameters);
        let algorithm = known.unwrap_or_else(|| {
            let new: &Algorithm<u32> = Box::leak(Box::new(parameters));
            kept.push(new);
            new
        });
        let unused = 32 - algorithm.width;
        let first = match algorithm.refin {
            true => (algorithm.init.reverse_bits() >> unused).to_le_bytes(),
            false => (algorithm.init << unused).to_be_bytes(),
        };
        Self { crc: crc::Crc::<u32, Table<BLOCK>>::new(algorithm), first }
    }

    fn checksum(&self, bytes: &[u8]) -> u32 {
        let (head, blocks) = bytes.split_at(bytes.len() % BLOCK);
        if head.len() < self.first.len() {
            return self.crc.checksum(bytes);
        }
        // With the initial value in the bytes, zeros in front change nothing: they fill a block.
        let mut block = [0; BLOCK];
        let tail = &mut block[BLOCK - head.len()..];
        tail.copy_from_slice(head);
        tail.iter_mut().zip(self.first).for_each(|(byte, first)| *byte ^= first);
        let mut digest = self.crc.digest_with_initial(0);
        digest.update(&block);
        digest.update(blocks);
        digest.finalize()
    }

    /// Compares the stated check value with the one that the parameters give; `Err` with the latter.
    fn verify(&self) -> Result<(), u32> {
        let check = self.checksum(b"123456789");
        if check == self.crc.algorithm.check { Ok(()) } else { Err(check) }
    }
}

impl fmt::Debug for TabulatedCrc {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.crc.algorithm.fmt(out)
    }
}

impl fmt::Display for FrameCheck {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.sum {
            ChecksumAlgorithm::Xor8 => write!(out, "XOR of the bytes"),
            ChecksumAlgorithm::Sum8 => write!(out, "sum of the bytes"),
            ChecksumAlgorithm::Crc(crc) => {
                write!(out, "CRC-{}, polynomial {:#x}", crc.crc.algorithm.width, crc.crc.algorithm.poly)
            }
        }?;
        if self.optional { write!(out, ", may be absent") } else { Ok(()) }
    }
}

impl FrameCheck {
    /// Checks `[check]` and compiles it; `None` for kind `none`.
    pub(super) fn new(source: &DefinitionSource, t: &CheckTable) -> Result<Option<Self>, Diagnostic> {
        let wrong = |finding| source.table("check", finding);
        let after = match t.after.as_deref().map(str::as_bytes) {
            None => None,
            Some([after]) => Some(*after),
            Some(_) => return Err(source.key("check", "after", AfterCharacter)),
        };
        let crc = match (&t.name, t.width, t.poly, t.init, t.refin, t.refout, t.xorout, t.check) {
            (None, None, None, None, None, None, None, None) => None,
            _ if t.kind != CheckKind::Crc => return Err(wrong(ParametersWithoutCrc)),
            (Some(name), None, None, None, None, None, None, None) => Some(named(name).ok_or_else(|| {
                let finding = UnknownCrc { name: name.clone(), known: NAMES.join(", ") };
                source.key("check", "name", finding).nearest(name, NAMES.iter().copied())
            })?),
            (Some(_), ..) => return Err(wrong(NameAndParameters)),
            (
                None,
                Some(width),
                Some(poly),
                Some(init),
                Some(refin),
                Some(refout),
                Some(xorout),
                Some(check),
            ) => {
                if !matches!(width, 8 | 16 | 24 | 32) {
                    return Err(wrong(CrcWidth));
                }
                let xorout = xorout & (u32::MAX >> (32 - width));
                Some(Algorithm { width, poly, init, refin, refout, xorout, check, residue: 0 })
            }
            _ => return Err(wrong(ParametersMissing)),
        };
        if t.optional && after.is_none() {
            return Err(wrong(OptionalWithoutAfter));
        }
        let sum = match t.kind {
            CheckKind::None => return Ok(None),
            CheckKind::Xor8 => ChecksumAlgorithm::Xor8,
            CheckKind::Sum8 => ChecksumAlgorithm::Sum8,
            CheckKind::Crc => {
                let crc = TabulatedCrc::new(crc.ok_or_else(|| wrong(ParametersMissing))?);
                crc.verify().map_err(|check| source.key("check", "check", CrcDiffers { check }))?;
                ChecksumAlgorithm::Crc(Box::new(crc))
            }
        };
        let encoding = t.enc.ok_or_else(|| wrong(EncodingMissing))?;
        Ok(Some(Self { sum, encoding, after, optional: t.optional, from: t.over_from }))
    }

    fn bits(&self) -> u8 {
        match &self.sum {
            ChecksumAlgorithm::Xor8 | ChecksumAlgorithm::Sum8 => 8,
            ChecksumAlgorithm::Crc(crc) => crc.crc.algorithm.width,
        }
    }

    /// Share of random frames that pass.
    pub(super) fn undetected(&self) -> f64 {
        if self.optional { 1.0 } else { 0.5f64.powi(self.bits().into()) }
    }

    /// Length as sent, with the character before it.
    pub(super) fn len(&self) -> usize {
        self.digits() + usize::from(self.after.is_some())
    }

    /// The content without its check; `None` if the check is wrong or missing.
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

    /// The value as sent; hexadecimal digits of either case.
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
            ChecksumAlgorithm::Xor8 => content.iter().fold(0, |sum, byte| sum ^ u32::from(*byte)),
            ChecksumAlgorithm::Sum8 => content.iter().fold(0u8, |sum, byte| sum.wrapping_add(*byte)).into(),
            ChecksumAlgorithm::Crc(crc) => crc.checksum(content),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Computed with 32 bits for any width, against the check values of the catalogue.
    #[test]
    fn named_crcs_give_their_check_values() {
        for name in NAMES {
            assert_eq!(TabulatedCrc::new(named(name).unwrap()).verify(), Ok(()), "{name}");
        }
    }

    /// Blocks give what single bytes give, whatever the length.
    #[test]
    fn blocks_are_the_sum_of_their_bytes() {
        let bytes: Vec<u8> = (0..50_u8).map(|at| at.wrapping_mul(73)).collect();
        for name in NAMES {
            let blocks = TabulatedCrc::new(named(name).unwrap());
            let single = crc::Crc::<u32, Table<1>>::new(blocks.crc.algorithm);
            for len in 0..bytes.len() {
                assert_eq!(blocks.checksum(&bytes[..len]), single.checksum(&bytes[..len]), "{name} {len}");
            }
        }
    }

    /// No integer has this width.
    #[test]
    fn crc_of_24_bits_gives_its_check_value() {
        assert_eq!(TabulatedCrc::new(crc::CRC_24_OPENPGP).verify(), Ok(()));
    }

    fn check(sum: ChecksumAlgorithm, encoding: CheckEncoding) -> FrameCheck {
        FrameCheck { sum, encoding, after: None, optional: false, from: 0 }
    }

    fn crc(name: &str, encoding: CheckEncoding) -> FrameCheck {
        check(ChecksumAlgorithm::Crc(Box::new(TabulatedCrc::new(named(name).unwrap()))), encoding)
    }

    fn appended(check: &FrameCheck, content: &[u8]) -> Vec<u8> {
        let mut body = content.to_vec();
        check.append(&mut body);
        assert_eq!(check.strip(&body), Some(content));
        assert_eq!(body.len(), content.len() + check.len());
        body[content.len()..].to_vec()
    }

    /// The catalogue of parametrised CRC algorithms (reveng.sourceforge.io).
    #[test]
    fn crcs_have_the_published_check_values() {
        for (name, value) in [
            ("CRC-8/SMBUS", 0xf4),
            ("CRC-16/ARC", 0xbb3d),
            ("CRC-16/IBM-3740", 0x29b1),
            ("CRC-16/IBM-SDLC", 0x906e),
            ("CRC-16/KERMIT", 0x2189),
            ("CRC-16/MODBUS", 0x4b37),
            ("CRC-16/SPI-FUJITSU", 0xe5cc),
            ("CRC-16/XMODEM", 0x31c3),
            ("CRC-32/ISO-HDLC", 0xcbf4_3926),
        ] {
            assert_eq!(crc(name, CheckEncoding::Le).value(b"123456789"), value, "{name}");
        }
    }

    /// The characters are 0x31 to 0x39: their XOR is 0x31, their sum 477 = 0x1dd.
    #[test]
    fn exclusive_or_and_sum_of_the_check_characters() {
        assert_eq!(check(ChecksumAlgorithm::Xor8, CheckEncoding::Le).value(b"123456789"), 0x31);
        assert_eq!(check(ChecksumAlgorithm::Sum8, CheckEncoding::Le).value(b"123456789"), 0xdd);
    }

    #[test]
    fn check_is_sent_in_its_order() {
        let name = "CRC-16/MODBUS";
        assert_eq!(appended(&crc(name, CheckEncoding::Le), b"123456789"), [0x37, 0x4b]);
        assert_eq!(appended(&crc(name, CheckEncoding::Be), b"123456789"), [0x4b, 0x37]);
        assert_eq!(appended(&crc(name, CheckEncoding::Hex), b"123456789"), *b"4B37");
        let long = crc("CRC-32/ISO-HDLC", CheckEncoding::Be);
        assert_eq!(appended(&long, b"123456789"), [0xcb, 0xf4, 0x39, 0x26]);
        assert_eq!(appended(&check(ChecksumAlgorithm::Sum8, CheckEncoding::Hex), b"\x05"), *b"05");
    }

    #[test]
    fn damaged_frames_do_not_pass() {
        let check = check(ChecksumAlgorithm::Sum8, CheckEncoding::Hex);
        assert_eq!(check.strip(b"1234566"), None);
        assert_eq!(check.strip(b"\x1d1d"), Some(&b"\x1d"[..]));
        assert_eq!(check.strip(b"\x1d1D"), Some(&b"\x1d"[..]));
        assert_eq!(check.strip(b"\x1d1g"), None);
        assert_eq!(check.strip(b"0"), None);
    }

    #[test]
    fn bytes_before_the_covered_part_do_not_count() {
        let check = FrameCheck { from: 2, ..check(ChecksumAlgorithm::Xor8, CheckEncoding::Le) };
        assert_eq!(appended(&check, &[0xff, 0x0f, 0x12, 0x01]), [0x13]);
        assert_eq!(appended(&check, &[0xff]), [0]);
    }

    #[test]
    fn optional_check_counts_if_it_is_there() {
        let starred = check(ChecksumAlgorithm::Xor8, CheckEncoding::Hex);
        let starred = FrameCheck { after: Some(b'*'), ..starred };
        assert_eq!(appended(&starred, b"ab"), *b"*03");
        assert_eq!(starred.strip(b"ab"), None);
        assert_eq!(starred.strip(b"ab+03"), None);
        let optional = FrameCheck { optional: true, ..starred };
        assert_eq!(optional.strip(b"ab"), Some(&b"ab"[..]));
        assert_eq!(optional.strip(b"ab*03"), Some(&b"ab"[..]));
        assert_eq!(optional.strip(b"ab*04"), None);
        assert_eq!(optional.undetected(), 1.0);
    }

    #[test]
    fn share_of_undetected_frames_is_two_to_the_minus_width() {
        assert_eq!(check(ChecksumAlgorithm::Xor8, CheckEncoding::Le).undetected(), 1.0 / 256.0);
        assert_eq!(crc("CRC-16/ARC", CheckEncoding::Le).undetected(), 1.0 / 65_536.0);
    }
}
