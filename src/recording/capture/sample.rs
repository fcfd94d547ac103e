//! Samples as a capture keeps them: packed, so that a kilohertz for an hour stays small.
//!
//! A record of samples holds one or more, each as below; what "before" means begins anew with each
//! record (numbers at 0, no temperature), so that a lost record costs nobody else.
//!
//! | bytes | what |
//! |---|---|
//! | 1 | flags: 1 valid, 2 a sequence number follows, 4 ticks follow, 8 the strobe is known, 16 it is high, 32 there is a temperature, 64 it is not the one before and follows, 128 the status is not the one before and follows |
//! | 8 | reading, mm: IEEE 754 binary64, little-endian |
//! | 1.. | sequence number less the one before: zigzag LEB128 |
//! | 1.. | ticks less those before: zigzag LEB128 |
//! | 8 | temperature, degrees Celsius: binary64, little-endian |
//! | 1.. | status: LEB128 |
//! | 1.. | offset less the one before: zigzag LEB128 |

use crate::base::units::DeviceTicks;
use crate::measurement::sample::Sample;

const VALID: u8 = 1;
const SEQUENCE: u8 = 2;
const TICKS: u8 = 4;
const TRIGGER: u8 = 8;
const HIGH: u8 = 16;
const TEMPERATURE: u8 = 32;
const TEMPERATURE_NEW: u8 = 64;
const STATUS_NEW: u8 = 128;

/// What precedes a sample in its record.
#[derive(Default)]
struct Before {
    sequence: u64,
    ticks: u64,
    offset: u64,
    temperature: Option<u64>,
    status: u32,
}

pub(super) fn pack(samples: &[Sample], to: &mut Vec<u8>) {
    let mut before = Before::default();
    for sample in samples {
        let at = to.len();
        to.push(u8::from(sample.valid) * VALID);
        to.extend(sample.reading_mm.to_le_bytes());
        let mut flags = match sample.trigger {
            Some(true) => TRIGGER | HIGH,
            Some(false) => TRIGGER,
            None => 0,
        };
        if let Some(sequence) = sample.sequence {
            flags |= SEQUENCE;
            step(to, &mut before.sequence, u64::from(sequence));
        }
        if let Some(ticks) = sample.ticks {
            flags |= TICKS;
            step(to, &mut before.ticks, ticks.0);
        }
        if let Some(bits) = sample.temperature_c.map(f64::to_bits) {
            flags |= TEMPERATURE;
            if before.temperature.replace(bits) != Some(bits) {
                flags |= TEMPERATURE_NEW;
                to.extend(bits.to_le_bytes());
            }
        }
        if before.status != sample.status {
            flags |= STATUS_NEW;
            before.status = sample.status;
            number(to, u64::from(sample.status));
        }
        step(to, &mut before.offset, sample.offset);
        to[at] |= flags;
    }
}

/// The samples of a payload; `None` when it is not understood to its last byte.
pub(super) fn unpack(mut bytes: &[u8]) -> Option<Vec<Sample>> {
    let mut before = Before::default();
    let mut samples = Vec::new();
    let from = &mut bytes;
    while let Some((&flags, rest)) = from.split_first() {
        *from = rest;
        let has = |flag: u8| flags & flag != 0;
        let reading_mm = f64::from_bits(word(from)?);
        let sequence = if has(SEQUENCE) {
            Some(u32::try_from(stepped(from, &mut before.sequence)?).ok()?)
        } else {
            None
        };
        let ticks = if has(TICKS) { Some(stepped(from, &mut before.ticks)?) } else { None };
        if has(TEMPERATURE_NEW) {
            before.temperature = Some(word(from)?);
        }
        let temperature_c = if has(TEMPERATURE) { Some(f64::from_bits(before.temperature?)) } else { None };
        if has(STATUS_NEW) {
            before.status = u32::try_from(numbered(from)?).ok()?;
        }
        samples.push(Sample {
            reading_mm,
            sequence,
            ticks: ticks.map(DeviceTicks),
            trigger: has(TRIGGER).then(|| has(HIGH)),
            temperature_c,
            valid: has(VALID),
            status: before.status,
            offset: stepped(from, &mut before.offset)?,
        });
    }
    Some(samples)
}

/// Appends `now` as its difference to `before`, which it becomes.
fn step(to: &mut Vec<u8>, before: &mut u64, now: u64) {
    let difference = now.wrapping_sub(*before).cast_signed();
    *before = now;
    number(to, ((difference << 1) ^ (difference >> 63)).cast_unsigned());
}

fn stepped(from: &mut &[u8], before: &mut u64) -> Option<u64> {
    let zigzag = numbered(from)?;
    let difference = (zigzag >> 1).cast_signed() ^ -((zigzag & 1).cast_signed());
    *before = before.wrapping_add_signed(difference);
    Some(*before)
}

/// Appends seven bits a byte, the lowest first; the top bit says that more follow.
fn number(to: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        to.push((value & 0x7f) as u8 | 0x80);
        value >>= 7;
    }
    to.push(value as u8);
}

fn numbered(from: &mut &[u8]) -> Option<u64> {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let (&byte, rest) = from.split_first()?;
        *from = rest;
        let bits = u64::from(byte & 0x7f);
        // The tenth byte has room for one bit.
        if bits.checked_shl(shift)? >> shift != bits {
            return None;
        }
        value |= bits << shift;
        if byte & 0x80 == 0 {
            return Some(value);
        }
    }
    None
}

fn word(from: &mut &[u8]) -> Option<u64> {
    let (bytes, rest) = from.split_first_chunk::<8>()?;
    *from = rest;
    Some(u64::from_le_bytes(*bytes))
}
