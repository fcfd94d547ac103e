//! The byte format of a capture, encoded and decoded in one place.

use std::ops::RangeInclusive;

use crc::{CRC_32_ISCSI, Crc, Table};

use super::record::{CaptureRecord, StampedRecord};
use super::sample;
use dbbd_model::base::units::HostNs;

/// CRC-32C is called CRC-32/ISCSI in the catalogue.
const CRC_32C: Crc<u32, Table<16>> = Crc::<u32, Table<16>>::new(&CRC_32_ISCSI);
const CAPTURE_VERSION: u32 = 4;
/// The versions that can be read: no record numbers in version 2, no axes before version 4.
pub(super) const READ: RangeInclusive<u32> = 2..=CAPTURE_VERSION;
pub(super) const HEADER_LEN: usize = 16;
pub(super) const FILE_MAGIC: [u8; 8] = *b"DBBDCAP\n";
/// Begins each record. It is not valid UTF-8, so that no text attachment contains it.
pub(super) const MAGIC: [u8; 4] = [0xdb, 0xbd, 0x5a, 0xa5];
/// Magic, kind, length, host time.
pub(super) const HEAD_LEN: usize = 4 + 1 + 4 + 8;
const TAIL_LEN: usize = 4;
/// Longest payload; a greater length is treated as damage.
pub(super) const MAX_PAYLOAD_BYTES: usize = 64 << 20;

const ATTACHMENT: u8 = 1;
const RAW: u8 = 2;
const FAULT: u8 = 4;
const EVENT: u8 = 5;
const SAMPLES: u8 = 6;
const AXES: u8 = 7;
/// Bit of the kind byte: the payload begins with the record number.
const NUMBERED: u8 = 0x80;

pub(super) fn kind_name(kind: u8) -> &'static str {
    match kind & !NUMBERED {
        ATTACHMENT => "attachment",
        RAW => "raw",
        FAULT => "fault",
        EVENT => "event",
        SAMPLES => "samples",
        AXES => "axes",
        _ => "unknown",
    }
}

pub(super) fn header() -> Vec<u8> {
    let mut bytes = FILE_MAGIC.to_vec();
    bytes.extend(CAPTURE_VERSION.to_le_bytes());
    bytes.extend(CRC_32C.checksum(&bytes).to_le_bytes());
    bytes
}

/// The version in a file header; `None` if its checksum is wrong.
pub(super) fn version(bytes: &[u8]) -> Option<u32> {
    let header = bytes.get(..HEADER_LEN)?;
    let (content, sum) = header.split_at(HEADER_LEN - TAIL_LEN);
    let intact = content.starts_with(&FILE_MAGIC) && CRC_32C.checksum(content).to_le_bytes() == sum;
    intact.then(|| u32_at(content, FILE_MAGIC.len())).flatten()
}

/// Encodes a record with its number.
pub(super) fn encode(
    number: u32,
    host: HostNs,
    record: &CaptureRecord,
) -> Result<Vec<u8>, serde_json::Error> {
    let mut bytes = MAGIC.to_vec();
    bytes.resize(HEAD_LEN, 0);
    bytes.extend(number.to_le_bytes());
    bytes[4] = NUMBERED
        | match record {
            CaptureRecord::Attachment { name, content } => {
                let name = name.as_bytes();
                let len = u16::try_from(name.len()).unwrap_or(u16::MAX);
                bytes.extend(len.to_le_bytes());
                bytes.extend(&name[..usize::from(len)]);
                bytes.extend(content);
                ATTACHMENT
            }
            CaptureRecord::Raw(raw) => {
                bytes.extend(raw);
                RAW
            }
            CaptureRecord::Samples(samples) => {
                sample::pack(samples, &mut bytes);
                SAMPLES
            }
            CaptureRecord::Axes(raw) => {
                bytes.extend(raw);
                AXES
            }
            CaptureRecord::Fault(json) => {
                bytes.extend(json);
                FAULT
            }
            CaptureRecord::Event(event) => {
                bytes.extend(serde_json::to_vec(event)?);
                EVENT
            }
        };
    let len = u32::try_from(bytes.len() - HEAD_LEN).unwrap_or(u32::MAX);
    bytes[5..9].copy_from_slice(&len.to_le_bytes());
    bytes[9..17].copy_from_slice(&host.0.to_le_bytes());
    bytes.extend(CRC_32C.checksum(&bytes[4..]).to_le_bytes());
    Ok(bytes)
}

/// The record at the start of a buffer.
pub(super) enum ParsedRecord {
    /// A complete record, its length in bytes, and its number if it has one.
    Complete(StampedRecord, usize, Option<u32>),
    /// Kind and length of a record whose checksum is right but whose content is not understood.
    Unknown(u8, usize),
    /// Kind of a record whose checksum is wrong.
    BadChecksum(u8),
    /// Kind and length of a record that ends beyond the buffer.
    Truncated(u8, usize),
    /// Fewer bytes than the head of a record.
    ShortHead,
    Nothing,
}

/// Number of bytes that [`decode`] needs to judge a record at the start of `bytes`.
pub(super) fn needed(bytes: &[u8]) -> usize {
    let len = u32_at(bytes, 5).and_then(|len| usize::try_from(len).ok());
    match len.filter(|len| bytes.starts_with(&MAGIC) && *len <= MAX_PAYLOAD_BYTES) {
        Some(len) => HEAD_LEN + len + TAIL_LEN,
        None => HEAD_LEN,
    }
}

/// Decodes the record at the start of `bytes`, which must hold [`needed`] bytes or all that are left.
pub(super) fn decode(bytes: &[u8]) -> ParsedRecord {
    if !bytes.starts_with(&MAGIC[..bytes.len().min(MAGIC.len())]) {
        return ParsedRecord::Nothing;
    }
    let (Some(&kind), Some(len), Some(host)) = (bytes.get(4), u32_at(bytes, 5), u64_at(bytes, 9)) else {
        return ParsedRecord::ShortHead;
    };
    let len = usize::try_from(len).unwrap_or(usize::MAX);
    if len > MAX_PAYLOAD_BYTES {
        return ParsedRecord::Nothing;
    }
    let total = HEAD_LEN + len + TAIL_LEN;
    let Some((content, sum)) = bytes.get(4..total).and_then(|all| all.split_at_checked(total - 4 - TAIL_LEN))
    else {
        return ParsedRecord::Truncated(kind, total);
    };
    if CRC_32C.checksum(content).to_le_bytes() != sum {
        return ParsedRecord::BadChecksum(kind);
    }
    let payload = content.get(HEAD_LEN - MAGIC.len()..).unwrap_or_default();
    let (number, payload) = match payload.split_first_chunk() {
        _ if kind & NUMBERED == 0 => (None, payload),
        Some((number, rest)) => (Some(u32::from_le_bytes(*number)), rest),
        None => return ParsedRecord::Unknown(kind, total),
    };
    match parse(kind & !NUMBERED, payload) {
        Some(record) => ParsedRecord::Complete(StampedRecord { host: HostNs(host), record }, total, number),
        None => ParsedRecord::Unknown(kind, total),
    }
}

fn parse(kind: u8, payload: &[u8]) -> Option<CaptureRecord> {
    match kind {
        ATTACHMENT => {
            let (len, rest) = payload.split_at_checked(2)?;
            let len = usize::from(u16::from_le_bytes([len[0], len[1]]));
            let (name, content) = rest.split_at_checked(len)?;
            let name = String::from_utf8(name.to_vec()).ok()?;
            Some(CaptureRecord::Attachment { name, content: content.to_vec() })
        }
        RAW => Some(CaptureRecord::Raw(payload.to_vec())),
        AXES => Some(CaptureRecord::Axes(payload.to_vec())),
        FAULT => Some(CaptureRecord::Fault(payload.to_vec())),
        EVENT => Some(CaptureRecord::Event(serde_json::from_slice(payload).ok()?)),
        SAMPLES => Some(CaptureRecord::Samples(sample::unpack(payload)?)),
        _ => None,
    }
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
}

fn u64_at(bytes: &[u8], at: usize) -> Option<u64> {
    Some(u64::from_le_bytes(bytes.get(at..at + 8)?.try_into().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The catalogue of parametrised CRC algorithms: CRC-32/ISCSI of "123456789" is e3069283.
    #[test]
    fn checksum_has_the_published_check_value() {
        assert_eq!(CRC_32C.checksum(b"123456789"), 0xe306_9283);
    }

    #[test]
    fn file_header_holds_the_version() {
        let header = header();
        assert_eq!((header.len(), &header[..12]), (HEADER_LEN, &b"DBBDCAP\n\x04\0\0\0"[..]));
        assert_eq!(version(&header), Some(4));
        for at in 0..HEADER_LEN {
            let mut damaged = header.clone();
            damaged[at] ^= 1;
            assert_eq!(version(&damaged), None, "{at}");
        }
        assert_eq!(version(&header[..15]), None);
    }

    /// Magic, kind 2 with the bit of the number, length 4 + 3, host time, number, bytes, checksum.
    #[test]
    fn record_has_the_documented_bytes() {
        let record = CaptureRecord::Raw(vec![7, 8, 9]);
        let bytes = encode(0x0102, HostNs(0x0304), &record).unwrap();
        let head = [0xdb, 0xbd, 0x5a, 0xa5, 0x82, 7, 0, 0, 0, 4, 3, 0, 0, 0, 0, 0, 0, 2, 1, 0, 0, 7, 8, 9];
        assert_eq!(bytes[..24], head);
        assert_eq!(bytes[24..], CRC_32C.checksum(&head[4..]).to_le_bytes());
        assert_eq!((needed(&bytes), needed(&bytes[..9]), needed(&bytes[..8])), (28, 28, HEAD_LEN));
        let ParsedRecord::Complete(stamped, 28, Some(0x0102)) = decode(&bytes) else {
            panic!("not complete")
        };
        assert_eq!((stamped.host, stamped.record), (HostNs(0x0304), record));
    }

    #[test]
    fn damage_is_told_apart() {
        let bytes = encode(1, HostNs(2), &CaptureRecord::Axes(vec![7, 8, 9])).unwrap();
        assert!(matches!(decode(&bytes[..27]), ParsedRecord::Truncated(0x87, 28)));
        assert!(matches!(decode(&bytes[..16]), ParsedRecord::ShortHead));
        assert!(matches!(decode(&bytes[1..]), ParsedRecord::Nothing));
        let mut damaged = bytes.clone();
        damaged[22] ^= 1;
        assert!(matches!(decode(&damaged), ParsedRecord::BadChecksum(0x87)));
        let mut long = bytes;
        long[5..9].copy_from_slice(&(MAX_PAYLOAD_BYTES as u32 + 1).to_le_bytes());
        assert!(matches!(decode(&long), ParsedRecord::Nothing));
        assert_eq!(needed(&long), HEAD_LEN);
        long[5..9].copy_from_slice(&(MAX_PAYLOAD_BYTES as u32).to_le_bytes());
        assert_eq!(needed(&long), HEAD_LEN + MAX_PAYLOAD_BYTES + TAIL_LEN);
    }

    #[test]
    fn records_of_all_kinds_return() {
        let attachment = CaptureRecord::Attachment { name: "plan.csv".into(), content: vec![1, 2] };
        for record in [
            attachment,
            CaptureRecord::Samples(vec![dbbd_model::measurement::sample::Sample::of(1.0)]),
            CaptureRecord::Fault(b"{}".to_vec()),
        ] {
            let bytes = encode(9, HostNs(5), &record).unwrap();
            let ParsedRecord::Complete(stamped, ..) = decode(&bytes) else { panic!("{record:?}") };
            assert_eq!(stamped.record, record);
        }
        assert_eq!(
            [1, 0x82, 4, 5, 6, 7, 3].map(kind_name),
            ["attachment", "raw", "fault", "event", "samples", "axes", "unknown"]
        );
    }
}
