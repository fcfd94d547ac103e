//! Packed samples of a capture: an hour at 1 kHz stays small.
//!
//! A record holds one or more samples, each as below. "Before" starts again with each record (numbers at 0, no
//! temperature), so that a lost record does not affect the next.
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

use dbbd_model::base::units::DeviceTicks;
use dbbd_model::measurement::sample::Sample;

const VALID: u8 = 1;
const SEQUENCE: u8 = 2;
const TICKS: u8 = 4;
const TRIGGER: u8 = 8;
const HIGH: u8 = 16;
const TEMPERATURE: u8 = 32;
const TEMPERATURE_NEW: u8 = 64;
const STATUS_NEW: u8 = 128;

/// The sample before in the same record.
#[derive(Default)]
struct PreviousSample {
    sequence: u64,
    ticks: u64,
    offset: u64,
    temperature: Option<u64>,
    status: u32,
}

pub(super) fn pack(samples: &[Sample], out: &mut Vec<u8>) {
    let mut before = PreviousSample::default();
    for sample in samples {
        let at = out.len();
        out.push(u8::from(sample.valid) * VALID);
        out.extend(sample.reading_mm.to_le_bytes());
        let mut flags = match sample.trigger {
            Some(true) => TRIGGER | HIGH,
            Some(false) => TRIGGER,
            None => 0,
        };
        if let Some(sequence) = sample.sequence {
            flags |= SEQUENCE;
            write_delta(out, &mut before.sequence, u64::from(sequence));
        }
        if let Some(ticks) = sample.ticks {
            flags |= TICKS;
            write_delta(out, &mut before.ticks, ticks.0);
        }
        if let Some(bits) = sample.temperature_c.map(f64::to_bits) {
            flags |= TEMPERATURE;
            if before.temperature.replace(bits) != Some(bits) {
                flags |= TEMPERATURE_NEW;
                out.extend(bits.to_le_bytes());
            }
        }
        if before.status != sample.status {
            flags |= STATUS_NEW;
            before.status = sample.status;
            write_leb128(out, u64::from(sample.status));
        }
        write_delta(out, &mut before.offset, sample.offset);
        out[at] |= flags;
    }
}

/// The samples of a payload; `None` if it is not understood to its last byte.
pub(super) fn unpack(mut bytes: &[u8]) -> Option<Vec<Sample>> {
    let mut before = PreviousSample::default();
    let mut samples = Vec::new();
    let input = &mut bytes;
    while let Some((&flags, rest)) = input.split_first() {
        *input = rest;
        let has = |flag: u8| flags & flag != 0;
        let reading_mm = f64::from_bits(read_u64(input)?);
        let sequence = if has(SEQUENCE) {
            Some(u32::try_from(read_delta(input, &mut before.sequence)?).ok()?)
        } else {
            None
        };
        let ticks = if has(TICKS) { Some(read_delta(input, &mut before.ticks)?) } else { None };
        if has(TEMPERATURE_NEW) {
            before.temperature = Some(read_u64(input)?);
        }
        let temperature_c = if has(TEMPERATURE) { Some(f64::from_bits(before.temperature?)) } else { None };
        if has(STATUS_NEW) {
            before.status = u32::try_from(read_leb128(input)?).ok()?;
        }
        samples.push(Sample {
            reading_mm,
            sequence,
            ticks: ticks.map(DeviceTicks),
            trigger: has(TRIGGER).then(|| has(HIGH)),
            temperature_c,
            valid: has(VALID),
            status: before.status,
            offset: read_delta(input, &mut before.offset)?,
        });
    }
    Some(samples)
}

/// Appends the difference of `now` and `before`, then stores `now` in `before`.
fn write_delta(out: &mut Vec<u8>, before: &mut u64, now: u64) {
    let difference = now.wrapping_sub(*before).cast_signed();
    *before = now;
    write_leb128(out, ((difference << 1) ^ (difference >> 63)).cast_unsigned());
}

fn read_delta(input: &mut &[u8], before: &mut u64) -> Option<u64> {
    let zigzag = read_leb128(input)?;
    let difference = (zigzag >> 1).cast_signed() ^ -((zigzag & 1).cast_signed());
    *before = before.wrapping_add_signed(difference);
    Some(*before)
}

/// Appends in LEB128: seven bits per byte, the lowest first; the top bit marks that more follow.
fn write_leb128(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push((value & 0x7f) as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

fn read_leb128(input: &mut &[u8]) -> Option<u64> {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let (&byte, rest) = input.split_first()?;
        *input = rest;
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

fn read_u64(input: &mut &[u8]) -> Option<u64> {
    let (bytes, rest) = input.split_first_chunk::<8>()?;
    *input = rest;
    Some(u64::from_le_bytes(*bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The examples of the DWARF standard (section 7.6): 2, 127, 128, 129, 12857.
    #[test]
    fn numbers_take_seven_bits_per_byte() {
        for (value, bytes) in [
            (2, &[2][..]),
            (127, &[0x7f][..]),
            (128, &[0x80, 1][..]),
            (129, &[0x81, 1][..]),
            (12_857, &[0xb9, 0x64][..]),
            (u64::MAX, &[0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 1][..]),
        ] {
            let mut out = Vec::new();
            write_leb128(&mut out, value);
            assert_eq!(out, bytes);
            let mut rest = bytes;
            assert_eq!((read_leb128(&mut rest), rest.len()), (Some(value), 0));
        }
        let long = [0x80; 10];
        assert_eq!(read_leb128(&mut &long[..]), None);
        assert_eq!(read_leb128(&mut &[0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 2][..]), None);
        assert_eq!(read_leb128(&mut &[0x80][..]), None);
    }

    /// Zigzag: 0, -1, 1, -2, 2 are 0, 1, 2, 3, 4.
    #[test]
    fn small_differences_of_either_sign_are_short() {
        for (before, now, byte) in [(5, 5, 0), (5, 4, 1), (5, 6, 2), (5, 3, 3), (5, 7, 4), (0, u64::MAX, 1)] {
            let (mut out, mut last) = (Vec::new(), before);
            write_delta(&mut out, &mut last, now);
            assert_eq!((&out[..], last), (&[byte][..], now));
            let mut last = before;
            assert_eq!(read_delta(&mut &out[..], &mut last), Some(now));
            assert_eq!(last, now);
        }
    }

    #[test]
    fn sample_has_the_documented_bytes() {
        let mut out = Vec::new();
        let sample = Sample {
            sequence: Some(3),
            ticks: Some(DeviceTicks(100)),
            trigger: Some(true),
            temperature_c: Some(1.5),
            status: 5,
            offset: 2,
            ..Sample::of(1.5)
        };
        pack(&[sample, sample], &mut out);
        let reading = [0, 0, 0, 0, 0, 0, 0xf8, 0x3f];
        let first = [&[0xff_u8][..], &reading, &[6], &[0xc8, 1], &reading, &[5], &[4]].concat();
        // Nothing changed: only the differences, which are 0.
        let second = [&[0x3f_u8][..], &reading, &[0, 0, 0]].concat();
        assert_eq!(out, [first, second].concat());
        assert_eq!(unpack(&out), Some(vec![sample, sample]));
        assert_eq!(unpack(&out[..out.len() - 1]), None);
        assert_eq!(unpack(&[]), Some(vec![]));
    }

    #[test]
    fn temperature_of_before_must_be_known() {
        let reading = 1.5f64.to_le_bytes();
        assert_eq!(unpack(&[&[VALID | TEMPERATURE][..], &reading, &[0]].concat()), None);
    }
}
