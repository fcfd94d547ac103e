//! Fields: how a value is written in a frame, and what it says of the sample.

use super::sample::Sample;
use crate::units::DeviceTicks;

/// One field of a message.
#[derive(Clone, Debug)]
pub(super) struct Field {
    pub(super) form: Form,
    pub(super) role: Option<Role>,
}

/// How a value is written.
#[derive(Clone, Debug)]
pub(super) enum Form {
    /// Bytes without meaning; written as zeros.
    Skip(usize),
    /// An integer of 1 to 4 bytes.
    Integer { bytes: usize, signed: bool, big_endian: bool },
    /// Fixed text.
    Literal(Vec<u8>),
    /// A decimal number; written with so many decimals.
    Decimal { decimals: usize },
    /// So many hexadecimal digits.
    Hex { digits: usize },
}

/// What a value says.
#[derive(Clone, Debug)]
pub(super) enum Role {
    /// The reading.
    Length(Scale),
    /// The sequence number.
    Sequence,
    /// The device's clock.
    Ticks,
    /// The temperature, degrees Celsius.
    Temperature(Scale),
    /// Status bits; their names by bit.
    Status(Vec<(u32, String)>),
}

/// quantity = (raw * numerator / denominator + offset) * unit, exact while raw * numerator < 2^53.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Scale {
    pub(super) numerator: f64,
    pub(super) denominator: f64,
    pub(super) offset: f64,
    /// Millimetres in the unit, negative when the sense is inverted; 1 for a temperature.
    pub(super) unit: f64,
}

impl Scale {
    fn quantity(&self, raw: f64) -> f64 {
        (raw * self.numerator / self.denominator + self.offset) * self.unit
    }

    fn raw(&self, quantity: f64) -> f64 {
        (quantity / self.unit - self.offset) * self.denominator / self.numerator
    }
}

impl Form {
    /// Length in bytes; none when it depends on the value.
    pub(super) fn len(&self) -> Option<usize> {
        match self {
            Form::Skip(bytes) | Form::Integer { bytes, .. } => Some(*bytes),
            Form::Literal(text) => Some(text.len()),
            Form::Hex { digits } => Some(*digits),
            Form::Decimal { .. } => None,
        }
    }

    /// Reads the value at the start of `rest`: the value (0 where there is none) and what follows.
    fn read<'a>(&self, rest: &'a [u8]) -> Option<(f64, &'a [u8])> {
        match self {
            Form::Skip(bytes) => Some((0.0, rest.get(*bytes..)?)),
            Form::Literal(text) => Some((0.0, rest.strip_prefix(&text[..])?)),
            Form::Integer { bytes, signed, big_endian } => {
                let (field, tail) = rest.split_at_checked(*bytes)?;
                let fold = |value: i64, byte: &u8| (value << 8) | i64::from(*byte);
                let value =
                    if *big_endian { field.iter().fold(0, fold) } else { field.iter().rev().fold(0, fold) };
                let bits = 8 * *bytes;
                let negative = *signed && value >> (bits - 1) != 0;
                Some(((value - if negative { 1 << bits } else { 0 }) as f64, tail))
            }
            Form::Decimal { .. } => {
                let number = |byte: &&u8| byte.is_ascii_digit() || matches!(byte, b'+' | b'-' | b'.');
                let (field, tail) = rest.split_at(rest.iter().take_while(number).count());
                let value: f64 = std::str::from_utf8(field).ok()?.parse().ok()?;
                value.is_finite().then_some((value, tail))
            }
            Form::Hex { digits } => {
                let (field, tail) = rest.split_at_checked(*digits)?;
                let text = std::str::from_utf8(field).ok().filter(|text| !text.starts_with('+'))?;
                Some((u32::from_str_radix(text, 16).ok()?.into(), tail))
            }
        }
    }

    /// Writes a value; none when the form cannot hold it.
    fn write(&self, value: f64, body: &mut Vec<u8>) -> Option<()> {
        match self {
            Form::Skip(bytes) => body.extend(std::iter::repeat_n(0, *bytes)),
            Form::Literal(text) => body.extend_from_slice(text),
            Form::Integer { bytes, signed, big_endian } => {
                let whole = whole(value.round())?;
                let (low, high) = if *signed {
                    let half = 1i64 << (8 * bytes - 1);
                    (-half, half - 1)
                } else {
                    (0, (1i64 << (8 * bytes)) - 1)
                };
                let written = (low..=high).contains(&whole).then(|| whole.to_le_bytes())?;
                let at = body.len();
                body.extend(written.iter().take(*bytes));
                if *big_endian {
                    body[at..].reverse();
                }
            }
            Form::Decimal { decimals } => {
                value.is_finite().then(|| body.extend(format!("{value:.decimals$}").into_bytes()))?;
            }
            Form::Hex { digits } => {
                let text = format!("{:0digits$X}", u32::try_from(whole(value)?).ok()?);
                (text.len() == *digits).then(|| body.extend(text.into_bytes()))?;
            }
        }
        Some(())
    }
}

/// The integer that a float holds exactly.
fn whole(value: f64) -> Option<i64> {
    (value.fract() == 0.0 && value.abs() < 9e15).then_some(value as i64)
}

impl Field {
    /// Reads the field into the sample; what follows, or none when the bytes do not fit.
    pub(super) fn read<'a>(&self, rest: &'a [u8], sample: &mut Sample) -> Option<&'a [u8]> {
        let (value, tail) = self.form.read(rest)?;
        let count = || whole(value).filter(|count| *count >= 0);
        match &self.role {
            None => {}
            Some(Role::Length(scale)) => sample.reading_mm = scale.quantity(value),
            Some(Role::Temperature(scale)) => sample.temperature_c = Some(scale.quantity(value)),
            Some(Role::Sequence) => sample.sequence = Some(u32::try_from(count()?).ok()?),
            Some(Role::Ticks) => sample.ticks = Some(DeviceTicks(u64::try_from(count()?).ok()?)),
            Some(Role::Status(flags)) => {
                sample.status = u32::try_from(count()?).ok()?;
                let set = |name: &str| bit(flags, name).map(|mask| sample.status & mask != 0);
                sample.trigger = set("trigger");
                let refused = ["over", "under", "overspeed"].iter().any(|name| set(name) == Some(true));
                sample.valid = set("valid").unwrap_or(true) && !refused;
            }
        }
        Some(tail)
    }

    /// Writes the sample's value; none when there is none or the field cannot hold it.
    pub(super) fn write(&self, sample: &Sample, body: &mut Vec<u8>) -> Option<()> {
        let value = match &self.role {
            None => 0.0,
            Some(Role::Length(scale)) => scale.raw(sample.reading_mm),
            Some(Role::Temperature(scale)) => scale.raw(sample.temperature_c?),
            Some(Role::Sequence) => sample.sequence?.into(),
            Some(Role::Ticks) => sample.ticks?.0 as f64,
            Some(Role::Status(flags)) => {
                let mut status = sample.status;
                for (name, wanted) in [("trigger", sample.trigger), ("valid", Some(sample.valid))] {
                    if let (Some(mask), Some(wanted)) = (bit(flags, name), wanted) {
                        status = if wanted { status | mask } else { status & !mask };
                    }
                }
                status.into()
            }
        };
        self.form.write(value, body)
    }

    /// Name of the role, for messages.
    pub(super) fn name(&self) -> &'static str {
        match self.role {
            None => "a field",
            Some(Role::Length(_)) => "length",
            Some(Role::Sequence) => "seq",
            Some(Role::Ticks) => "t_dev",
            Some(Role::Temperature(_)) => "temp",
            Some(Role::Status(_)) => "status",
        }
    }
}

fn bit(flags: &[(u32, String)], name: &str) -> Option<u32> {
    flags.iter().find(|(_, flag)| flag == name).map(|(bit, _)| 1 << bit)
}
