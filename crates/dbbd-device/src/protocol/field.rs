//! Fields of a frame: the form of a value, and its role in the sample.

use super::decimal::DecimalFormat;
use super::table::Endian;
use dbbd_model::base::units::DeviceTicks;
use dbbd_model::measurement::sample::Sample;

#[derive(Clone, Debug)]
pub(super) struct MessageField {
    pub(super) form: FieldForm,
    pub(super) role: Option<FieldRole>,
}

#[derive(Clone, Debug)]
pub(super) enum FieldForm {
    /// Bytes without meaning, written as zeros.
    Skip(usize),
    /// An integer of 1 to 4 bytes.
    Integer { bytes: usize, signed: bool, endian: Endian },
    /// An IEEE 754 number of 4 or 8 bytes.
    Float { bytes: usize, endian: Endian },
    /// Bits of a group of bytes; the last field of a group consumes it.
    Bits { bits: u32, shift: u32, group: usize, endian: Endian, signed: bool, last: bool },
    /// Fixed text.
    Literal { text: Vec<u8>, any_case: bool },
    /// A decimal number.
    Decimal(DecimalFormat),
    /// Hexadecimal digits, in two's complement if signed.
    Hex { digits: usize, signed: bool },
    /// One of a list of words; its value is the index.
    Word { words: Vec<Vec<u8>>, default: Option<usize> },
    /// Text up to a separator, which may be missing at the end.
    Column { sep: u8 },
}

#[derive(Clone, Debug)]
pub(super) enum FieldRole {
    Length(FieldScale, RawLimits),
    /// Wraps to 0 at `modulo`.
    Sequence {
        modulo: u32,
    },
    Ticks(TickCounter),
    Temperature(FieldScale),
    Status(StatusFlags),
    /// Status by words; the flag of each word.
    StatusWord(Vec<u32>, StatusFlags),
    /// Millimetres per unit of each word; `None` for a word that means an invalid reading.
    Unit(Vec<Option<f64>>),
    /// A figure of merit; the reading is valid within these limits.
    Quality(f64, f64),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TickCounter {
    pub tick_ns: u32,
    /// The counter wraps to 0 after 2^wrap_bits ticks.
    pub wrap_bits: u32,
}

/// Name of the status flag that carries the strobe of the controller.
pub(super) const STROBE: &str = "trigger";

/// Names of the status bits, lowest first, and masks of the flags that the decoder uses; 0 if missing.
#[derive(Clone, Debug, Default)]
pub(super) struct StatusFlags {
    pub(super) names: Vec<(u32, String)>,
    trigger: u32,
    valid: u32,
    /// Over, under, overspeed: an invalid reading.
    refused: u32,
}

impl StatusFlags {
    pub(super) fn new(names: Vec<(u32, String)>) -> Self {
        let mask =
            |wanted: &str| names.iter().find(|(_, name)| name == wanted).map_or(0, |(bit, _)| 1 << bit);
        let refused = mask("over") | mask("under") | mask("overspeed");
        Self { trigger: mask(STROBE), valid: mask("valid"), refused, names }
    }

    /// Sets strobe and validity of a sample by its status.
    #[inline]
    fn apply(&self, sample: &mut Sample) {
        let status = sample.status;
        sample.trigger = (self.trigger != 0).then_some(status & self.trigger != 0);
        sample.valid &= (self.valid == 0 || status & self.valid != 0) && status & self.refused == 0;
    }

    /// The status of a sample, with the flags of its strobe and validity.
    fn status(&self, sample: &Sample) -> u32 {
        let set = |status: u32, mask: u32, wanted: bool| if wanted { status | mask } else { status & !mask };
        let status = sample.trigger.map_or(sample.status, |on| set(sample.status, self.trigger, on));
        set(status, self.valid, sample.valid)
    }
}

#[derive(Clone, Copy)]
enum RawValue {
    Whole(i64),
    Real(f64),
}

impl RawValue {
    #[inline]
    fn real(self) -> f64 {
        match self {
            RawValue::Whole(value) => value as f64,
            RawValue::Real(value) => value,
        }
    }

    #[inline]
    fn count<T: TryFrom<i64>>(self) -> Option<T> {
        let whole = match self {
            RawValue::Whole(value) => value,
            RawValue::Real(value) => whole(value)?,
        };
        T::try_from(whole).ok()
    }
}

/// Raw values that are no readings.
#[derive(Clone, Debug, Default)]
pub(super) struct RawLimits {
    /// Readings outside of these are invalid.
    pub(super) valid: Option<(f64, f64)>,
    /// Values above this are error codes.
    pub(super) error_above: Option<f64>,
    /// Values that mean an error, with its name.
    pub(super) sentinels: Vec<(f64, String)>,
}

impl RawLimits {
    /// The error that a value means.
    #[inline]
    fn error(&self, raw: f64) -> Option<String> {
        let sentinel = self.sentinels.iter().find(|(value, _)| *value == raw);
        let code = || self.error_above.is_some_and(|limit| raw > limit).then(|| format!("error {raw}"));
        sentinel.map(|(_, word)| word.clone()).or_else(code)
    }

    #[inline]
    fn is_valid(&self, raw: f64) -> bool {
        self.valid.is_none_or(|(low, high)| (low..=high).contains(&raw))
    }
}

/// A sample that is being read.
pub(super) struct SampleBuilder {
    pub(super) sample: Sample,
    /// Millimetres per unit of the frame.
    pub(super) unit_mm: f64,
    /// The device's message that it has no reading.
    pub(super) refused: Option<String>,
}

/// quantity = (raw * numerator / denominator + offset) * unit, exact while raw * numerator < 2^53.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FieldScale {
    pub(super) numerator: f64,
    pub(super) denominator: f64,
    pub(super) offset: f64,
    /// Millimetres per unit, negative for an inverted sense; 1 for a temperature.
    pub(super) unit: f64,
}

impl FieldScale {
    #[inline]
    fn quantity(&self, raw: f64) -> f64 {
        (raw * self.numerator / self.denominator + self.offset) * self.unit
    }

    /// Quantity per raw step of 1.
    pub(super) fn slope(&self) -> f64 {
        self.numerator / self.denominator * self.unit
    }

    fn raw(&self, quantity: f64) -> f64 {
        (quantity / self.unit - self.offset) * self.denominator / self.numerator
    }
}

impl FieldForm {
    /// Length in bytes; `None` if it depends on the value.
    pub(super) fn len(&self) -> Option<usize> {
        match self {
            FieldForm::Skip(bytes) | FieldForm::Integer { bytes, .. } | FieldForm::Float { bytes, .. } => {
                Some(*bytes)
            }
            FieldForm::Bits { group, last, .. } => Some(if *last { *group } else { 0 }),
            FieldForm::Literal { text, .. } => Some(text.len()),
            FieldForm::Hex { digits, .. } => Some(*digits),
            FieldForm::Decimal(decimal) => decimal.width,
            FieldForm::Word { words, default: Some(_) } => {
                let len = words.first().map(Vec::len);
                len.filter(|len| words.iter().all(|word| word.len() == *len))
            }
            FieldForm::Word { .. } | FieldForm::Column { .. } => None,
        }
    }

    /// Step between adjacent values; 0 for a float.
    pub(super) fn step(&self) -> f64 {
        match self {
            FieldForm::Decimal(decimal) => 1.0 / 10f64.powi(decimal.decimals as i32),
            FieldForm::Float { .. } => 0.0,
            _ => 1.0,
        }
    }

    /// The value at the start of `rest` (0 if there is none), and the bytes after it.
    #[inline]
    fn read<'a>(&self, rest: &'a [u8]) -> Option<(RawValue, &'a [u8])> {
        const NONE: RawValue = RawValue::Whole(0);
        match self {
            FieldForm::Skip(bytes) => Some((NONE, rest.get(*bytes..)?)),
            FieldForm::Literal { text, any_case } => {
                let (field, tail) = rest.split_at_checked(text.len())?;
                let same = if *any_case { field.eq_ignore_ascii_case(text) } else { field == text };
                same.then_some((NONE, tail))
            }
            FieldForm::Integer { bytes, signed, endian } => {
                let (field, tail) = rest.split_at_checked(*bytes)?;
                Some((signed_value(integer(field, *endian), 8 * *bytes as u32, *signed), tail))
            }
            FieldForm::Float { bytes, endian } => {
                let (field, tail) = rest.split_at_checked(*bytes)?;
                let bits = integer(field, *endian);
                let value =
                    if *bytes == 4 { f32::from_bits(bits as u32).into() } else { f64::from_bits(bits) };
                value.is_finite().then_some((RawValue::Real(value), tail))
            }
            FieldForm::Bits { bits, shift, group, endian, signed, last } => {
                let (field, tail) = rest.split_at_checked(*group)?;
                let value = (integer(field, *endian) >> shift) & ((1 << bits) - 1);
                Some((signed_value(value, *bits, *signed), if *last { tail } else { rest }))
            }
            FieldForm::Decimal(decimal) => {
                decimal.read(rest).map(|(value, tail)| (RawValue::Real(value), tail))
            }
            FieldForm::Hex { digits, signed } => {
                let (field, tail) = rest.split_at_checked(*digits)?;
                let text = std::str::from_utf8(field).ok().filter(|text| !text.starts_with('+'))?;
                let value = u32::from_str_radix(text, 16).ok()?;
                Some((signed_value(value.into(), 4 * *digits as u32, *signed), tail))
            }
            FieldForm::Word { words, default } => {
                let found =
                    words.iter().zip(0..).find_map(|(word, at)| Some((at, rest.strip_prefix(&word[..])?)));
                match found {
                    Some((at, tail)) => Some((RawValue::Whole(at), tail)),
                    None if default.is_none() => Some((RawValue::Whole(words.len() as i64), rest)),
                    None => None,
                }
            }
            FieldForm::Column { sep } => {
                let end = rest.iter().position(|byte| byte == sep);
                Some((NONE, end.map_or(&[], |end| &rest[end + 1..])))
            }
        }
    }

    /// Appends a value; `None` if it does not fit.
    pub(super) fn write(&self, value: f64, body: &mut Vec<u8>) -> Option<()> {
        match self {
            FieldForm::Skip(bytes) => body.extend(std::iter::repeat_n(0, *bytes)),
            FieldForm::Literal { text, .. } => body.extend_from_slice(text),
            FieldForm::Integer { bytes, signed, endian } => {
                let written = unsigned(value, 8 * *bytes as u32, *signed)?;
                bytes_of(written, *bytes, *endian, body);
            }
            FieldForm::Float { bytes, endian } => {
                let bits = if *bytes == 4 { u64::from((value as f32).to_bits()) } else { value.to_bits() };
                bytes_of(bits, *bytes, *endian, body);
            }
            FieldForm::Bits { bits, shift, group, endian, signed, .. } => {
                let written = unsigned(value, *bits, *signed)?;
                if *shift == 0 {
                    body.extend(std::iter::repeat_n(0, *group));
                }
                let at = body.len().checked_sub(*group)?;
                let mut whole = integer(&body[at..], *endian);
                whole |= written << shift;
                body.truncate(at);
                bytes_of(whole, *group, *endian, body);
            }
            FieldForm::Decimal(decimal) => decimal.write(value, body)?,
            FieldForm::Hex { digits, signed } => {
                let written = unsigned(value, 4 * *digits as u32, *signed)?;
                body.extend(format!("{written:0digits$X}").into_bytes());
            }
            FieldForm::Word { words, default } => {
                let at = usize::try_from(whole(value)?).ok()?;
                match words.get(at) {
                    Some(word) => body.extend_from_slice(word),
                    None if default.is_none() => {}
                    None => return None,
                }
            }
            FieldForm::Column { sep } => body.push(*sep),
        }
        Some(())
    }
}

#[inline]
fn integer(field: &[u8], endian: Endian) -> u64 {
    let fold = |value: u64, byte: &u8| (value << 8) | u64::from(*byte);
    match (field, endian) {
        (&[only], _) => only.into(),
        (&[a, b], Endian::Le) => u16::from_le_bytes([a, b]).into(),
        (&[a, b, c, d], Endian::Le) => u32::from_le_bytes([a, b, c, d]).into(),
        (_, Endian::Le) => field.iter().rev().fold(0, fold),
        (_, Endian::Be) => field.iter().fold(0, fold),
    }
}

/// For up to 32 bits.
#[inline]
fn signed_value(value: u64, bits: u32, signed: bool) -> RawValue {
    let negative = signed && value >> (bits - 1) != 0;
    RawValue::Whole(value as i64 - if negative { 1 << bits } else { 0 })
}

/// The bits of a value; `None` if it does not fit.
fn unsigned(value: f64, bits: u32, signed: bool) -> Option<u64> {
    let whole = whole(value.round())?;
    let half = 1i64 << (bits - 1);
    let (low, high) = if signed { (-half, half - 1) } else { (0, 2 * half - 1) };
    (low..=high).contains(&whole).then(|| (whole as u64) & (2 * half as u64 - 1))
}

fn bytes_of(value: u64, bytes: usize, endian: Endian, body: &mut Vec<u8>) {
    let at = body.len();
    body.extend(value.to_le_bytes().iter().take(bytes));
    if endian == Endian::Be {
        body[at..].reverse();
    }
}

/// The value of a float that is an exact integer.
fn whole(value: f64) -> Option<i64> {
    (value.fract() == 0.0 && value.abs() < 9e15).then_some(value as i64)
}

impl MessageField {
    /// Reads the field into the sample. Returns the bytes after it; `None` if they do not match.
    #[inline]
    pub(super) fn read<'a>(&self, rest: &'a [u8], reading: &mut SampleBuilder) -> Option<&'a [u8]> {
        let (value, tail) = self.form.read(rest)?;
        let sample = &mut reading.sample;
        match &self.role {
            None => {}
            Some(FieldRole::Length(scale, limits)) => {
                let raw = value.real();
                sample.reading_mm = scale.quantity(raw);
                sample.valid &= limits.is_valid(raw);
                reading.refused = limits.error(raw);
            }
            Some(FieldRole::Temperature(scale)) => sample.temperature_c = Some(scale.quantity(value.real())),
            Some(FieldRole::Sequence { .. }) => sample.sequence = Some(value.count()?),
            Some(FieldRole::Ticks(_)) => sample.ticks = Some(DeviceTicks(value.count()?)),
            Some(FieldRole::Status(flags)) => {
                sample.status = value.count()?;
                flags.apply(sample);
            }
            Some(FieldRole::StatusWord(bits, flags)) => {
                let bit = bits.get(value.count::<usize>()?);
                sample.status = bit.map_or(0, |bit| 1 << bit);
                flags.apply(sample);
            }
            Some(FieldRole::Unit(units)) => match units.get(value.count::<usize>()?)? {
                Some(mm) => reading.unit_mm = *mm,
                None => sample.valid = false,
            },
            Some(FieldRole::Quality(low, high)) => sample.valid &= (*low..=*high).contains(&value.real()),
        }
        Some(tail)
    }

    /// Appends the sample's value; `None` if it is missing or does not fit.
    pub(super) fn write(&self, sample: &Sample, body: &mut Vec<u8>) -> Option<()> {
        let value = match &self.role {
            None => match &self.form {
                FieldForm::Word { words, default } => default.unwrap_or(words.len()) as f64,
                _ => 0.0,
            },
            Some(FieldRole::Length(scale, limits)) => {
                let raw = scale.raw(sample.reading_mm);
                let raw = if self.form.step() == 1.0 { raw.round() } else { raw };
                if limits.error(raw).is_some() || sample.valid && !limits.is_valid(raw) {
                    return None;
                }
                raw
            }
            Some(FieldRole::Temperature(scale)) => scale.raw(sample.temperature_c?),
            Some(FieldRole::Sequence { .. }) => sample.sequence?.into(),
            Some(FieldRole::Ticks(_)) => sample.ticks?.0 as f64,
            Some(FieldRole::Status(flags)) => flags.status(sample).into(),
            Some(FieldRole::StatusWord(bits, _)) => {
                let at = bits.iter().position(|bit| sample.status == 1 << bit);
                let FieldForm::Word { words, default } = &self.form else { return None };
                at.or(*default).unwrap_or(words.len()) as f64
            }
            Some(FieldRole::Unit(units)) => {
                let wanted = if sample.valid { Some(1.0) } else { None };
                let at = units.iter().position(|unit| *unit == wanted);
                at.or_else(|| units.iter().position(|unit| *unit == Some(1.0)))? as f64
            }
            Some(FieldRole::Quality(low, high)) => {
                if sample.valid {
                    *high
                } else {
                    *low - 1.0
                }
            }
        };
        self.form.write(value, body)
    }

    /// The value that means no reading, if there is one.
    pub(super) fn sentinel(&self) -> Option<f64> {
        match &self.role {
            Some(FieldRole::Length(_, limits)) => limits.sentinels.first().map(|(value, _)| *value),
            _ => None,
        }
    }

    /// Whether the field can mark a reading as invalid.
    pub(super) fn has_validity(&self) -> bool {
        match &self.role {
            Some(FieldRole::Status(flags)) => flags.valid != 0,
            Some(FieldRole::Unit(units)) => units.contains(&None),
            Some(FieldRole::Quality(..)) => true,
            _ => false,
        }
    }

    /// Name of the role, for messages.
    pub(super) fn name(&self) -> &'static str {
        match self.role {
            None => "a field",
            Some(FieldRole::Length(..)) => "length",
            Some(FieldRole::Sequence { .. }) => "seq",
            Some(FieldRole::Ticks(_)) => "t_dev",
            Some(FieldRole::Temperature(_)) => "temp",
            Some(FieldRole::Status(_) | FieldRole::StatusWord(..)) => "status",
            Some(FieldRole::Unit(_)) => "unit",
            Some(FieldRole::Quality(..)) => "quality",
        }
    }
}
