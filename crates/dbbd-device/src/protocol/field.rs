//! Fields of a frame: the form of a value, and its role in the sample.

use super::decimal::DecimalFormat;
use dbbd_model::base::units::DeviceTicks;
use dbbd_model::measurement::sample::Sample;
use serde::Deserialize;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Endian {
    #[default]
    Le,
    Be,
    /// Words of two bytes, the lowest word first and in each word the highest byte first, as most Modbus devices have it.
    Cdab,
    /// Words of two bytes, the highest word first and in each word the lowest byte first.
    Badc,
}

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
    /// Sequence number that wraps to 0 at `modulo`.
    Sequence {
        modulo: u32,
    },
    Ticks(TickCounter),
    Temperature(FieldScale),
    Status(StatusFlags),
    /// Status as a word; the flag of each word.
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
    /// Number of decimals of the reading, if it is to stay the same.
    pub(super) decimals: Option<usize>,
    /// Whether the device shows that many in another unit only.
    pub(super) is_other_unit: bool,
}

impl Default for SampleBuilder {
    fn default() -> Self {
        let sample = Sample::of(0.0);
        Self { sample, unit_mm: 1.0, refused: None, decimals: None, is_other_unit: false }
    }
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
            FieldForm::Skip(_)
            | FieldForm::Integer { .. }
            | FieldForm::Bits { .. }
            | FieldForm::Literal { .. }
            | FieldForm::Hex { .. }
            | FieldForm::Word { .. }
            | FieldForm::Column { .. } => 1.0,
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
        (_, Endian::Cdab) => field.chunks(2).rev().flatten().fold(0, fold),
        (_, Endian::Badc) => field.chunks(2).flat_map(|word| word.iter().rev()).fold(0, fold),
    }
}

/// The value of an integer of up to 32 bits.
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
    let swap_words = |body: &mut [u8]| body.chunks_mut(2).for_each(<[u8]>::reverse);
    match endian {
        Endian::Le => {}
        Endian::Be => body[at..].reverse(),
        Endian::Cdab => swap_words(&mut body[at..]),
        Endian::Badc => {
            body[at..].reverse();
            swap_words(&mut body[at..]);
        }
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
                if let FieldForm::Decimal(decimal) = &self.form
                    && let Some([min, max]) = decimal.read_decimals
                {
                    let decimals = decimal.decimals(rest)?;
                    reading.decimals = Some(decimals);
                    reading.is_other_unit = !(min..=max).contains(&decimals);
                }
            }
            Some(FieldRole::Temperature(scale)) => sample.temperature_c = Some(scale.quantity(value.real())),
            Some(FieldRole::Sequence { .. }) => sample.sequence = Some(value.count()?),
            Some(FieldRole::Ticks(_)) => {
                let ticks = match &self.form {
                    FieldForm::Decimal(decimal) if decimal.decimals > 0 => {
                        RawValue::Real((value.real() / self.form.step()).round())
                    }
                    FieldForm::Decimal(_)
                    | FieldForm::Float { .. }
                    | FieldForm::Skip(_)
                    | FieldForm::Integer { .. }
                    | FieldForm::Bits { .. }
                    | FieldForm::Literal { .. }
                    | FieldForm::Hex { .. }
                    | FieldForm::Word { .. }
                    | FieldForm::Column { .. } => value,
                };
                sample.ticks = Some(DeviceTicks(ticks.count()?));
            }
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
            None => {
                if let FieldForm::Word { words, default } = &self.form {
                    default.unwrap_or(words.len()) as f64
                } else {
                    0.0
                }
            }
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
            Some(FieldRole::Ticks(_)) => sample.ticks?.0 as f64 * self.form.step(),
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

#[cfg(test)]
mod tests {
    use super::*;

    fn read(form: &FieldForm, bytes: &[u8]) -> Option<(f64, Vec<u8>)> {
        form.read(bytes).map(|(value, tail)| (value.real(), tail.to_vec()))
    }

    fn written(form: &FieldForm, value: f64) -> Option<Vec<u8>> {
        let mut body = Vec::new();
        form.write(value, &mut body).map(|()| body)
    }

    #[test]
    fn integers_have_an_order_of_bytes() {
        for bytes in [&[0x12][..], &[0x12, 0x34], &[0x12, 0x34, 0x56], &[0x12, 0x34, 0x56, 0x78]] {
            let high = bytes.iter().fold(0, |sum, byte| 256 * sum + u64::from(*byte));
            let low = bytes.iter().rev().fold(0, |sum, byte| 256 * sum + u64::from(*byte));
            assert_eq!((integer(bytes, Endian::Be), integer(bytes, Endian::Le)), (high, low));
        }
        assert_eq!(integer(&[0x12, 0x34, 0x56], Endian::Le), 0x0056_3412);
    }

    #[test]
    fn integers_are_in_twos_complement() {
        let form = |signed| FieldForm::Integer { bytes: 2, signed, endian: Endian::Be };
        assert_eq!(read(&form(true), &[0xff, 0xfe, 9]), Some((-2.0, vec![9])));
        assert_eq!(read(&form(false), &[0xff, 0xfe]), Some((65_534.0, vec![])));
        assert_eq!(read(&form(true), &[0x7f, 0xff]), Some((32_767.0, vec![])));
        assert_eq!(read(&form(true), &[0x80, 0]), Some((-32_768.0, vec![])));
        assert_eq!(read(&form(true), &[0xff]), None);
        assert_eq!(written(&form(true), -2.0), Some(vec![0xff, 0xfe]));
        let three = FieldForm::Integer { bytes: 3, signed: true, endian: Endian::Le };
        assert_eq!(written(&three, -2.0), Some(vec![0xfe, 0xff, 0xff]));
    }

    #[test]
    fn values_beyond_their_bits_do_not_fit() {
        assert_eq!(
            [-129.0, -128.0, 127.0, 128.0].map(|v| unsigned(v, 8, true)),
            [None, Some(0x80), Some(127), None]
        );
        assert_eq!(
            [-1.0, 0.0, 255.0, 256.0].map(|v| unsigned(v, 8, false)),
            [None, Some(0), Some(255), None]
        );
        assert_eq!(unsigned(2.6, 8, false), Some(3));
        assert_eq!(unsigned(f64::NAN, 8, false), None);
    }

    /// 0xffe5: the upper twelve bits are -2, the lower four 5.
    #[test]
    fn bits_of_a_group_share_its_bytes() {
        let form = |bits, shift, signed, last| FieldForm::Bits {
            bits,
            shift,
            group: 2,
            endian: Endian::Be,
            signed,
            last,
        };
        let (low, high) = (form(4, 0, false, false), form(12, 4, true, true));
        assert_eq!(read(&low, &[0xff, 0xe5, 1]), Some((5.0, vec![0xff, 0xe5, 1])));
        assert_eq!(read(&high, &[0xff, 0xe5, 1]), Some((-2.0, vec![1])));
        let mut body = Vec::new();
        low.write(5.0, &mut body).unwrap();
        high.write(-2.0, &mut body).unwrap();
        assert_eq!(body, [0xff, 0xe5]);
        assert_eq!((low.len(), high.len()), (Some(0), Some(2)));
    }

    /// IEEE 754: 1.5 is 3fc00000, and 3ff8000000000000.
    #[test]
    fn floats_are_ieee_754() {
        let single = FieldForm::Float { bytes: 4, endian: Endian::Le };
        assert_eq!(read(&single, &[0, 0, 0xc0, 0x3f]), Some((1.5, vec![])));
        assert_eq!(written(&single, 1.5), Some(vec![0, 0, 0xc0, 0x3f]));
        let double = FieldForm::Float { bytes: 8, endian: Endian::Be };
        assert_eq!(read(&double, &[0x3f, 0xf8, 0, 0, 0, 0, 0, 0]), Some((1.5, vec![])));
        assert_eq!(written(&double, 1.5), Some(vec![0x3f, 0xf8, 0, 0, 0, 0, 0, 0]));
        assert_eq!(read(&single, &[0, 0, 0x80, 0x7f]), None);
        assert_eq!((single.step(), single.len()), (0.0, Some(4)));
    }

    #[test]
    fn hexadecimal_digits_are_in_twos_complement() {
        let form = |signed| FieldForm::Hex { digits: 4, signed };
        assert_eq!(read(&form(true), b"FFFEx"), Some((-2.0, b"x".to_vec())));
        assert_eq!(read(&form(false), b"fffe"), Some((65_534.0, vec![])));
        assert_eq!(read(&form(false), b"+FFE"), None);
        assert_eq!(written(&form(true), -2.0), Some(b"FFFE".to_vec()));
        assert_eq!(written(&form(false), 10.0), Some(b"000A".to_vec()));
    }

    #[test]
    fn words_are_numbered_from_zero() {
        let words = |default| FieldForm::Word { words: vec![b"OK".to_vec(), b"ERR".to_vec()], default };
        assert_eq!(read(&words(None), b"ERRx"), Some((1.0, b"x".to_vec())));
        // None of them is the number after the last, unless one must be there.
        assert_eq!(read(&words(None), b"zz"), Some((2.0, b"zz".to_vec())));
        assert_eq!(read(&words(Some(0)), b"zz"), None);
        assert_eq!(written(&words(None), 1.0), Some(b"ERR".to_vec()));
        assert_eq!(written(&words(None), 2.0), Some(vec![]));
        assert_eq!(written(&words(Some(0)), 2.0), None);
    }

    #[test]
    fn column_ends_at_the_separator() {
        let form = FieldForm::Column { sep: b',' };
        assert_eq!(read(&form, b"abc,d"), Some((0.0, b"d".to_vec())));
        assert_eq!(read(&form, b"abc"), Some((0.0, vec![])));
        let literal = |any_case| FieldForm::Literal { text: b"MM".to_vec(), any_case };
        assert_eq!(read(&literal(true), b"mm1"), Some((0.0, b"1".to_vec())));
        assert_eq!(read(&literal(false), b"mm1"), None);
        assert_eq!(read(&FieldForm::Skip(2), b"abc"), Some((0.0, b"c".to_vec())));
    }

    /// (4 * 5 / 2 + 1) * -2 = -22; a step of 1 is 5 / 2 * -2 = -5.
    #[test]
    fn scale_and_its_inverse() {
        let scale = FieldScale { numerator: 5.0, denominator: 2.0, offset: 1.0, unit: -2.0 };
        assert_eq!((scale.quantity(4.0), scale.raw(-22.0), scale.slope()), (-22.0, 4.0, -5.0));
    }

    #[test]
    fn step_follows_the_decimals() {
        let decimal = FieldForm::Decimal(DecimalFormat { decimals: 3, ..DecimalFormat::default() });
        assert_eq!(decimal.step(), 0.001);
        assert_eq!(FieldForm::Skip(1).step(), 1.0);
    }

    #[test]
    fn raw_values_beyond_the_limits_are_errors_or_invalid() {
        let sentinels = vec![(-9.0, "off".to_owned())];
        let limits = RawLimits { valid: Some((-5.0, 5.0)), error_above: Some(100.0), sentinels };
        assert_eq!(limits.error(-9.0).as_deref(), Some("off"));
        assert_eq!([limits.error(100.0).is_some(), limits.error(101.0).is_some()], [false, true]);
        assert_eq!([-5.1, -5.0, 5.0, 5.1].map(|raw| limits.is_valid(raw)), [false, true, true, false]);
        assert!(RawLimits::default().is_valid(1e9) && RawLimits::default().error(1e9).is_none());
    }

    #[test]
    fn flags_show_strobe_and_validity() {
        let names = [(0, "trigger"), (2, "valid"), (3, "over"), (5, "overspeed")];
        let flags = StatusFlags::new(names.map(|(bit, name)| (bit, name.to_owned())).to_vec());
        let applied = |status: u32| {
            let mut sample = Sample { status, ..Sample::of(1.0) };
            flags.apply(&mut sample);
            (sample.trigger, sample.valid)
        };
        assert_eq!(applied(0b000101), (Some(true), true));
        assert_eq!(applied(0b000100), (Some(false), true));
        assert_eq!(applied(0b000001), (Some(true), false));
        assert_eq!(applied(0b001100), (Some(false), false));
        assert_eq!(applied(0b100100), (Some(false), false));
        let status =
            |trigger, valid| flags.status(&Sample { status: 0b10, trigger, valid, ..Sample::of(1.0) });
        assert_eq!(
            [status(Some(true), true), status(Some(false), true), status(None, false)],
            [0b111, 0b110, 0b10]
        );
    }
}
