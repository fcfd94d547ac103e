//! Fields: how a value is written in a frame, and what it says of the sample.

use super::decimal::Decimal;
use crate::sample::Sample;
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
    /// An IEEE 754 number of 4 or 8 bytes.
    Float { bytes: usize, big_endian: bool },
    /// Some bits of a group of bytes; the last of a group goes past it.
    Bits { bits: u32, shift: u32, group: usize, big_endian: bool, signed: bool, last: bool },
    /// Fixed text.
    Literal { text: Vec<u8>, any_case: bool },
    /// A decimal number.
    Decimal(Decimal),
    /// So many hexadecimal digits, in two's complement where signed.
    Hex { digits: usize, signed: bool },
    /// One of some words; its value is the place in the list.
    Word { words: Vec<Vec<u8>>, default: Option<usize> },
    /// Text up to a separator, which may be absent at the end.
    Column { sep: u8 },
}

/// What a value says.
#[derive(Clone, Debug)]
pub(super) enum Role {
    /// The reading.
    Length(Scale, Limits),
    /// The sequence number.
    Sequence,
    /// The device's clock.
    Ticks,
    /// The temperature, degrees Celsius.
    Temperature(Scale),
    /// Status bits; their names by bit.
    Status(Vec<(u32, String)>),
    /// Status words; the flag of each.
    StatusWord(Vec<u32>, Vec<(u32, String)>),
    /// Millimetres in the unit that each word names; none where the word says that the reading is bad.
    Unit(Vec<Option<f64>>),
    /// A figure of merit: the reading is good while it is within these.
    Quality(f64, f64),
}

/// Which raw values are no readings.
#[derive(Clone, Debug, Default)]
pub(super) struct Limits {
    /// Outside these the device does not vouch for the reading.
    pub(super) valid: Option<(f64, f64)>,
    /// Above this they are error codes.
    pub(super) error_above: Option<f64>,
    /// Values that stand for a word.
    pub(super) sentinels: Vec<(f64, String)>,
}

impl Limits {
    /// The device's word, where the value is none.
    fn word(&self, raw: f64) -> Option<String> {
        let sentinel = self.sentinels.iter().find(|(value, _)| *value == raw);
        let error = || self.error_above.is_some_and(|limit| raw > limit).then(|| format!("error {raw}"));
        sentinel.map(|(_, word)| word.clone()).or_else(error)
    }

    fn vouched(&self, raw: f64) -> bool {
        self.valid.is_none_or(|(low, high)| (low..=high).contains(&raw))
    }
}

/// A sample that is being read.
pub(super) struct Reading {
    pub(super) sample: Sample,
    /// Millimetres in the unit that the frame names.
    pub(super) unit_mm: f64,
    /// The device's word for having none.
    pub(super) refused: Option<String>,
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

    /// Quantity of a raw step of 1.
    pub(super) fn slope(&self) -> f64 {
        self.numerator / self.denominator * self.unit
    }

    fn raw(&self, quantity: f64) -> f64 {
        (quantity / self.unit - self.offset) * self.denominator / self.numerator
    }
}

impl Form {
    /// Length in bytes; none when it depends on the value.
    pub(super) fn len(&self) -> Option<usize> {
        match self {
            Form::Skip(bytes) | Form::Integer { bytes, .. } | Form::Float { bytes, .. } => Some(*bytes),
            Form::Bits { group, last, .. } => Some(if *last { *group } else { 0 }),
            Form::Literal { text, .. } => Some(text.len()),
            Form::Hex { digits, .. } => Some(*digits),
            Form::Decimal(decimal) => decimal.width,
            Form::Word { words, default: Some(_) } => {
                let len = words.first().map(Vec::len);
                len.filter(|len| words.iter().all(|word| word.len() == *len))
            }
            Form::Word { .. } | Form::Column { .. } => None,
        }
    }

    /// The step between two values that can be written, where they stand at even steps.
    pub(super) fn step(&self) -> f64 {
        match self {
            Form::Decimal(decimal) => 10f64.powi(-(decimal.decimals as i32)),
            Form::Float { .. } => 0.0,
            _ => 1.0,
        }
    }

    /// Reads the value at the start of `rest`: the value (0 where there is none) and what follows.
    fn read<'a>(&self, rest: &'a [u8]) -> Option<(f64, &'a [u8])> {
        match self {
            Form::Skip(bytes) => Some((0.0, rest.get(*bytes..)?)),
            Form::Literal { text, any_case } => {
                let (field, tail) = rest.split_at_checked(text.len())?;
                let same = if *any_case { field.eq_ignore_ascii_case(text) } else { field == text };
                same.then_some((0.0, tail))
            }
            Form::Integer { bytes, signed, big_endian } => {
                let (field, tail) = rest.split_at_checked(*bytes)?;
                Some((signed_value(integer(field, *big_endian), 8 * *bytes as u32, *signed), tail))
            }
            Form::Float { bytes, big_endian } => {
                let (field, tail) = rest.split_at_checked(*bytes)?;
                let bits = integer(field, *big_endian) as u64;
                let value =
                    if *bytes == 4 { f32::from_bits(bits as u32).into() } else { f64::from_bits(bits) };
                value.is_finite().then_some((value, tail))
            }
            Form::Bits { bits, shift, group, big_endian, signed, last } => {
                let (field, tail) = rest.split_at_checked(*group)?;
                let value = (integer(field, *big_endian) >> shift) & ((1 << bits) - 1);
                Some((signed_value(value, *bits, *signed), if *last { tail } else { rest }))
            }
            Form::Decimal(decimal) => decimal.read(rest),
            Form::Hex { digits, signed } => {
                let (field, tail) = rest.split_at_checked(*digits)?;
                let text = std::str::from_utf8(field).ok().filter(|text| !text.starts_with('+'))?;
                let value = u32::from_str_radix(text, 16).ok()?;
                Some((signed_value(value.into(), 4 * *digits as u32, *signed), tail))
            }
            Form::Word { words, default } => {
                match words
                    .iter()
                    .enumerate()
                    .find_map(|(at, word)| Some((at, rest.strip_prefix(&word[..])?)))
                {
                    Some((at, tail)) => Some((at as f64, tail)),
                    None if default.is_none() => Some((words.len() as f64, rest)),
                    None => None,
                }
            }
            Form::Column { sep } => {
                let end = rest.iter().position(|byte| byte == sep);
                Some((0.0, end.map_or(&[], |end| &rest[end + 1..])))
            }
        }
    }

    /// Writes a value; none when the form cannot hold it.
    pub(super) fn write(&self, value: f64, body: &mut Vec<u8>) -> Option<()> {
        match self {
            Form::Skip(bytes) => body.extend(std::iter::repeat_n(0, *bytes)),
            Form::Literal { text, .. } => body.extend_from_slice(text),
            Form::Integer { bytes, signed, big_endian } => {
                let written = unsigned(value, 8 * *bytes as u32, *signed)?;
                bytes_of(written, *bytes, *big_endian, body);
            }
            Form::Float { bytes, big_endian } => {
                let bits = if *bytes == 4 { u64::from((value as f32).to_bits()) } else { value.to_bits() };
                bytes_of(bits, *bytes, *big_endian, body);
            }
            Form::Bits { bits, shift, group, big_endian, signed, .. } => {
                let written = unsigned(value, *bits, *signed)?;
                if *shift == 0 {
                    body.extend(std::iter::repeat_n(0, *group));
                }
                let at = body.len().checked_sub(*group)?;
                let mut whole = integer(&body[at..], *big_endian) as u64;
                whole |= written << shift;
                body.truncate(at);
                bytes_of(whole, *group, *big_endian, body);
            }
            Form::Decimal(decimal) => decimal.write(value, body)?,
            Form::Hex { digits, signed } => {
                let written = unsigned(value, 4 * *digits as u32, *signed)?;
                body.extend(format!("{written:0digits$X}").into_bytes());
            }
            Form::Word { words, default } => {
                let at = usize::try_from(whole(value)?).ok()?;
                match words.get(at) {
                    Some(word) => body.extend_from_slice(word),
                    None if default.is_none() => {}
                    None => return None,
                }
            }
            Form::Column { sep } => body.push(*sep),
        }
        Some(())
    }
}

fn integer(field: &[u8], big_endian: bool) -> i64 {
    let fold = |value: i64, byte: &u8| (value << 8) | i64::from(*byte);
    if big_endian { field.iter().fold(0, fold) } else { field.iter().rev().fold(0, fold) }
}

fn signed_value(value: i64, bits: u32, signed: bool) -> f64 {
    let negative = signed && value >> (bits - 1) != 0;
    (value - if negative { 1 << bits } else { 0 }) as f64
}

/// The bits of a value, if so many can hold it.
fn unsigned(value: f64, bits: u32, signed: bool) -> Option<u64> {
    let whole = whole(value.round())?;
    let half = 1i64 << (bits - 1);
    let (low, high) = if signed { (-half, half - 1) } else { (0, 2 * half - 1) };
    (low..=high).contains(&whole).then(|| (whole as u64) & (2 * half as u64 - 1))
}

fn bytes_of(value: u64, bytes: usize, big_endian: bool, body: &mut Vec<u8>) {
    let at = body.len();
    body.extend(value.to_le_bytes().iter().take(bytes));
    if big_endian {
        body[at..].reverse();
    }
}

/// The integer that a float holds exactly.
fn whole(value: f64) -> Option<i64> {
    (value.fract() == 0.0 && value.abs() < 9e15).then_some(value as i64)
}

impl Field {
    /// Reads the field into the sample; what follows, or none when the bytes do not fit.
    pub(super) fn read<'a>(&self, rest: &'a [u8], reading: &mut Reading) -> Option<&'a [u8]> {
        let (value, tail) = self.form.read(rest)?;
        let count = || whole(value).filter(|count| *count >= 0);
        let sample = &mut reading.sample;
        match &self.role {
            None => {}
            Some(Role::Length(scale, limits)) => {
                sample.reading_mm = scale.quantity(value);
                sample.valid &= limits.vouched(value);
                reading.refused = limits.word(value);
            }
            Some(Role::Temperature(scale)) => sample.temperature_c = Some(scale.quantity(value)),
            Some(Role::Sequence) => sample.sequence = Some(u32::try_from(count()?).ok()?),
            Some(Role::Ticks) => sample.ticks = Some(DeviceTicks(u64::try_from(count()?).ok()?)),
            Some(Role::Status(flags)) => {
                sample.status = u32::try_from(count()?).ok()?;
                judge(sample, flags);
            }
            Some(Role::StatusWord(bits, flags)) => {
                let bit = bits.get(usize::try_from(count()?).ok()?);
                sample.status = bit.map_or(0, |bit| 1 << bit);
                judge(sample, flags);
            }
            Some(Role::Unit(units)) => match units.get(usize::try_from(count()?).ok()?)? {
                Some(mm) => reading.unit_mm = *mm,
                None => sample.valid = false,
            },
            Some(Role::Quality(low, high)) => sample.valid &= (*low..=*high).contains(&value),
        }
        Some(tail)
    }

    /// Writes the sample's value; none when there is none or the field cannot hold it.
    pub(super) fn write(&self, sample: &Sample, body: &mut Vec<u8>) -> Option<()> {
        let value = match &self.role {
            None => match &self.form {
                Form::Word { words, default } => default.unwrap_or(words.len()) as f64,
                _ => 0.0,
            },
            Some(Role::Length(scale, limits)) => {
                let raw = scale.raw(sample.reading_mm);
                let raw = if self.form.step() == 1.0 { raw.round() } else { raw };
                if limits.word(raw).is_some() || sample.valid && !limits.vouched(raw) {
                    return None;
                }
                raw
            }
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
            Some(Role::StatusWord(bits, _)) => {
                let at = bits.iter().position(|bit| sample.status == 1 << bit);
                let Form::Word { words, default } = &self.form else { return None };
                at.or(*default).unwrap_or(words.len()) as f64
            }
            Some(Role::Unit(units)) => {
                let wanted = if sample.valid { Some(1.0) } else { None };
                let at = units.iter().position(|unit| *unit == wanted);
                at.or_else(|| units.iter().position(|unit| *unit == Some(1.0)))? as f64
            }
            Some(Role::Quality(low, high)) => {
                if sample.valid {
                    *high
                } else {
                    *low - 1.0
                }
            }
        };
        self.form.write(value, body)
    }

    /// The value that stands for having no reading, where there is one.
    pub(super) fn sentinel(&self) -> Option<f64> {
        match &self.role {
            Some(Role::Length(_, limits)) => limits.sentinels.first().map(|(value, _)| *value),
            _ => None,
        }
    }

    /// Whether the field can say that a reading is not to be trusted.
    pub(super) fn doubts(&self) -> bool {
        match &self.role {
            Some(Role::Status(flags)) => bit(flags, "valid").is_some(),
            Some(Role::Unit(units)) => units.contains(&None),
            Some(Role::Quality(..)) => true,
            _ => false,
        }
    }

    /// Name of the role, for messages.
    pub(super) fn name(&self) -> &'static str {
        match self.role {
            None => "a field",
            Some(Role::Length(..)) => "length",
            Some(Role::Sequence) => "seq",
            Some(Role::Ticks) => "t_dev",
            Some(Role::Temperature(_)) => "temp",
            Some(Role::Status(_) | Role::StatusWord(..)) => "status",
            Some(Role::Unit(_)) => "unit",
            Some(Role::Quality(..)) => "quality",
        }
    }
}

/// What the flags say of the sample.
fn judge(sample: &mut Sample, flags: &[(u32, String)]) {
    let set = |name: &str| bit(flags, name).map(|mask| sample.status & mask != 0);
    sample.trigger = set("trigger");
    let refused = ["over", "under", "overspeed"].iter().any(|name| set(name) == Some(true));
    sample.valid &= set("valid").unwrap_or(true) && !refused;
}

fn bit(flags: &[(u32, String)], name: &str) -> Option<u32> {
    flags.iter().find(|(_, flag)| flag == name).map(|(bit, _)| 1 << bit)
}
