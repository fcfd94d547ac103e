//! Compiles a field and checks the keys of its kind and role.

use std::collections::{BTreeMap, BTreeSet};

use serde::de::DeserializeOwned;

use crate::protocol::ProtocolFinding::{
    self, BitGroup, BitsBits, BlankFill, ClockDecimals, ClockKeys, ColumnSeparator, CountScale, DecimalMark,
    DecimalWidth, FlagBit, FloatBits, HexDigits, IntegerBits, IntegerEndian, KeyType, KeyWithoutMeaning,
    LengthUnit, LiteralText, MapDefault, MapRole, MapWords, QualityRange, ReadDecimals, RoleWithoutValue,
    ScaleFactors, ScaleZero, SentinelNumber, SequenceModulo, SkipBytes, TemperatureUnit, TooManyWords,
    UnitKind, UnitWithoutMm, UnitWords, ValidRange, WordOrder,
};
use crate::protocol::decimal::DecimalFill;
use crate::protocol::decimal::DecimalFormat;
use crate::protocol::field::Endian;
use crate::protocol::field::{
    FieldForm, FieldRole, FieldScale, MessageField, RawLimits, StatusFlags, TickCounter,
};
use crate::protocol::framing::LONGEST_FRAME;
use dbbd_model::base::FileFinding;
use dbbd_model::base::fixed_array::FixedArray;
use dbbd_model::base::parse::from_toml_value;
use serde::Deserialize;

/// A field of a message in the file; which further keys it has depends on kind and role.
#[derive(Clone, Deserialize)]
pub(super) struct FieldTable {
    kind: FieldKind,
    role: Option<RoleName>,
    #[serde(flatten)]
    keys: toml::Table,
}

#[derive(Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum FieldKind {
    /// Bytes without meaning.
    Skip,
    Uint,
    /// Two's complement integer.
    Int,
    /// Fixed text.
    Lit,
    /// Decimal number as text.
    Dec,
    /// Hexadecimal number as text.
    Hex,
    /// IEEE 754 number of 4 or 8 bytes.
    Float,
    /// Bits of a group of bytes, from the lowest.
    Bits,
    /// One of some words.
    Map,
    /// A column of separated values that is skipped, with its separator.
    Column,
}

#[derive(Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum RoleName {
    Length,
    Seq,
    TDev,
    Temp,
    Status,
    Unit,
    Quality,
}

#[derive(Clone, Copy, PartialEq, Eq, Deserialize)]
enum FieldUnit {
    #[serde(rename = "um")]
    Micrometre,
    #[serde(rename = "mm")]
    Millimetre,
    #[serde(rename = "inch")]
    Inch,
    /// Counts of a scale, of which `per` make a millimetre.
    #[serde(rename = "count")]
    Count,
    /// The unit that the field with role `unit` states.
    #[serde(rename = "device")]
    Device,
    #[serde(rename = "C")]
    Celsius,
}

type FieldWords = BTreeMap<String, String>;

/// The keys of a field that are not consumed yet.
struct FieldKeys(toml::Table);

impl FieldKeys {
    fn take<T: DeserializeOwned>(&mut self, key: &str) -> Result<Option<T>, ProtocolFinding> {
        let wrong = |finding: FileFinding| KeyType { key: key.into(), why: finding.to_string() };
        self.0.remove(key).map(|value| from_toml_value(value).map_err(wrong)).transpose()
    }

    fn take_or_default<T: DeserializeOwned + Default>(&mut self, key: &str) -> Result<T, ProtocolFinding> {
        self.take(key).map(Option::unwrap_or_default)
    }
}

pub(super) fn compile(table: &FieldTable) -> Result<MessageField, ProtocolFinding> {
    let mut keys = FieldKeys(table.keys.clone());
    let unit = table.keys.get("unit").and_then(toml::Value::as_str).unwrap_or_default();
    let (form, meanings) = form(table.kind, &mut keys, unit)?;
    let role = table.role.map(|role| compile_role(role, &mut keys, &form, &meanings)).transpose()?;
    match keys.0.into_iter().next() {
        Some((key, _)) => Err(KeyWithoutMeaning { key }),
        None => Ok(MessageField { form, role }),
    }
}

/// The form of a field, and the meanings of its words if it is a map.
fn form(
    kind: FieldKind,
    keys: &mut FieldKeys,
    unit: &str,
) -> Result<(FieldForm, Vec<String>), ProtocolFinding> {
    let form = match kind {
        FieldKind::Skip => match keys.take("bytes")? {
            Some(bytes @ 1..=LONGEST_FRAME) => FieldForm::Skip(bytes),
            _ => return Err(SkipBytes),
        },
        FieldKind::Uint | FieldKind::Int => {
            let bytes = match keys.take("bits")? {
                Some(bits @ (8 | 16 | 24 | 32)) => bits / 8,
                _ => return Err(IntegerBits),
            };
            let endian = match keys.take("endian")? {
                Some(Endian::Cdab | Endian::Badc) if bytes != 4 => return Err(WordOrder),
                None if bytes > 1 => return Err(IntegerEndian),
                endian => endian.unwrap_or_default(),
            };
            FieldForm::Integer { bytes, signed: kind == FieldKind::Int, endian }
        }
        FieldKind::Float => match (keys.take("bits")?, keys.take("endian")?) {
            (Some(bits @ (32 | 64)), Some(endian)) => FieldForm::Float { bytes: bits / 8, endian },
            _ => return Err(FloatBits),
        },
        FieldKind::Bits => match keys.take("bits")? {
            Some(bits @ 1..=32) => FieldForm::Bits {
                bits,
                shift: 0,
                group: 0,
                endian: keys.take_or_default::<Endian>("endian")?,
                signed: keys.take_or_default("signed")?,
                last: false,
            },
            _ => return Err(BitsBits),
        },
        FieldKind::Lit => match keys.take_or_default::<String>("text")? {
            text if text.is_empty() => return Err(LiteralText),
            text => {
                FieldForm::Literal { text: text.into_bytes(), any_case: keys.take_or_default("any_case")? }
            }
        },
        FieldKind::Dec => decimal(keys, unit)?,
        FieldKind::Hex => match keys.take("digits")? {
            Some(digits @ 1..=8) => FieldForm::Hex { digits, signed: keys.take_or_default("signed")? },
            _ => return Err(HexDigits),
        },
        FieldKind::Map => return map(keys),
        FieldKind::Column => match keys.take_or_default::<String>("sep")?.as_bytes() {
            [sep] => FieldForm::Column { sep: *sep },
            _ => return Err(ColumnSeparator),
        },
    };
    Ok((form, Vec::new()))
}

fn decimal(keys: &mut FieldKeys, unit: &str) -> Result<FieldForm, ProtocolFinding> {
    let read: BTreeMap<String, FixedArray<usize, 2>> = keys.take_or_default("read_decimals")?;
    if read.values().any(|FixedArray([min, max])| min > max) {
        return Err(ReadDecimals);
    }
    let read_decimals = read.get(unit).map(|range| range.0);
    let decimals: usize = keys.take_or_default("decimals")?;
    let mark: Option<String> = keys.take("decimal")?;
    let decimal = DecimalFormat {
        // What is written must be read.
        decimals: read_decimals.map_or(decimals, |[min, max]| decimals.clamp(min, max)),
        read_decimals,
        mark: match mark.as_deref() {
            None | Some(".") => b'.',
            Some(",") => b',',
            Some(_) => return Err(DecimalMark),
        },
        width: keys.take("width")?,
        pad_to: keys.take_or_default("pad_to")?,
        fill: keys.take_or_default("fill")?,
        sign: keys.take_or_default("sign")?,
        blanks: keys.take_or_default("blanks")?,
    };
    if decimal.decimals > 12 || decimal.pad_to > 32 || decimal.width.is_some_and(|w| !(1..=32).contains(&w)) {
        return Err(DecimalWidth);
    }
    if decimal.fill == DecimalFill::Blank && !decimal.blanks {
        return Err(BlankFill);
    }
    Ok(FieldForm::Decimal(decimal))
}

fn map(keys: &mut FieldKeys) -> Result<(FieldForm, Vec<String>), ProtocolFinding> {
    let mut map: Vec<(String, String)> = keys.take_or_default::<FieldWords>("map")?.into_iter().collect();
    // A word that is the start of another must be tried after it.
    map.sort_by_key(|(word, _)| std::cmp::Reverse(word.len()));
    let (words, meanings): (Vec<String>, Vec<String>) = map.into_iter().unzip();
    let (optional, default): (bool, Option<String>) =
        (keys.take_or_default("optional")?, keys.take("default")?);
    let at = default.as_ref().and_then(|default| words.iter().position(|word| word == default));
    if words.is_empty() || words.iter().any(String::is_empty) {
        return Err(MapWords);
    }
    if at.is_none() != optional || default.is_some() && at.is_none() {
        return Err(MapDefault);
    }
    Ok((
        FieldForm::Word { words: words.into_iter().map(String::into_bytes).collect(), default: at },
        meanings,
    ))
}

/// Assigns adjacent bit fields of a message to groups of 1 to 4 whole bytes.
pub(super) fn group_bits(fields: &mut [MessageField]) -> Result<(), ProtocolFinding> {
    let is_bits = |field: &MessageField| matches!(field.form, FieldForm::Bits { .. });
    for run in fields.chunk_by_mut(|a, b| is_bits(a) && is_bits(b)) {
        let (mut total, count) = (0, run.len());
        for field in run.iter_mut() {
            if let FieldForm::Bits { bits, shift, .. } = &mut field.form {
                *shift = total;
                total += *bits;
            }
        }
        if total > 32 || total % 8 != 0 {
            return Err(BitGroup { bits: total });
        }
        for (at, field) in run.iter_mut().enumerate() {
            if let FieldForm::Bits { group, last, .. } = &mut field.form {
                (*group, *last) = (total as usize / 8, at + 1 == count);
            }
        }
    }
    Ok(())
}

fn compile_role(
    role: RoleName,
    keys: &mut FieldKeys,
    form: &FieldForm,
    meanings: &[String],
) -> Result<FieldRole, ProtocolFinding> {
    let bits = match form {
        FieldForm::Skip(_) | FieldForm::Literal { .. } | FieldForm::Column { .. } => {
            return Err(RoleWithoutValue);
        }
        FieldForm::Integer { bytes, .. } => 8 * *bytes as u32,
        FieldForm::Bits { bits, .. } => *bits,
        FieldForm::Hex { digits, .. } => 4 * *digits as u32,
        FieldForm::Decimal(_) | FieldForm::Float { .. } => 32,
        FieldForm::Word { .. } => return role_of_words(role, meanings),
    };
    Ok(match role {
        RoleName::Length => FieldRole::Length(scale(keys, ScaledQuantity::Length)?, limits(keys)?),
        RoleName::Temp => FieldRole::Temperature(scale(keys, ScaledQuantity::Temperature)?),
        RoleName::Seq => match keys.take("modulo")? {
            Some(modulo @ 2u32..) if u64::from(modulo) <= 1 << bits => FieldRole::Sequence { modulo },
            _ => return Err(SequenceModulo { bits }),
        },
        RoleName::TDev => {
            // The last decimal is the tick.
            let decimals = if let FieldForm::Decimal(decimal) = form { decimal.decimals } else { 0 };
            let ticks = 10u32.checked_pow(decimals as u32).ok_or(ClockDecimals)?;
            let bits = if ticks > 1 { 52 } else { bits };
            match (keys.take("tick_ns")?, keys.take("wrap_bits")?) {
                (Some(tick_ns @ 1u32..), _) if tick_ns % ticks != 0 => return Err(ClockDecimals),
                (Some(tick_ns @ 1..), Some(wrap_bits)) if (8..=bits).contains(&wrap_bits) => {
                    FieldRole::Ticks(TickCounter { tick_ns: tick_ns / ticks, wrap_bits })
                }
                _ => return Err(ClockKeys { bits }),
            }
        }
        RoleName::Status => {
            let mut flags = Vec::new();
            for (bit, name) in keys.take_or_default::<FieldWords>("flags")? {
                match bit.parse::<u32>() {
                    Ok(number) if number < bits => flags.push((number, name)),
                    _ => return Err(FlagBit { bit, highest: bits - 1 }),
                }
            }
            flags.sort();
            FieldRole::Status(StatusFlags::new(flags))
        }
        RoleName::Quality => match keys.take::<FixedArray<f64, 2>>("valid")? {
            Some(FixedArray([low, high])) if low > 0.0 && low <= high => FieldRole::Quality(low, high),
            _ => return Err(QualityRange),
        },
        RoleName::Unit => return Err(UnitKind),
    })
}

fn role_of_words(role: RoleName, meanings: &[String]) -> Result<FieldRole, ProtocolFinding> {
    match role {
        RoleName::Unit => {
            let units = meanings.iter().map(|meaning| match meaning.as_str() {
                "mm" => Ok(Some(1.0)),
                "um" => Ok(Some(1e-3)),
                "inch" => Ok(Some(25.4)),
                "fault" => Ok(None),
                _ => Err(UnitWords),
            });
            let units: Vec<Option<f64>> = units.collect::<Result<_, _>>()?;
            if units.contains(&Some(1.0)) { Ok(FieldRole::Unit(units)) } else { Err(UnitWithoutMm) }
        }
        RoleName::Status => {
            let names: BTreeSet<&String> = meanings.iter().collect();
            if names.len() > 32 {
                return Err(TooManyWords);
            }
            let bit = |name| names.iter().position(|known| *known == name).unwrap_or(0) as u32;
            let bits = meanings.iter().map(bit).collect();
            let names = (0..).zip(names.iter().map(|name| (*name).clone())).collect();
            Ok(FieldRole::StatusWord(bits, StatusFlags::new(names)))
        }
        RoleName::Length | RoleName::Seq | RoleName::TDev | RoleName::Temp | RoleName::Quality => {
            Err(MapRole)
        }
    }
}

fn limits(keys: &mut FieldKeys) -> Result<RawLimits, ProtocolFinding> {
    let mut sentinels = Vec::new();
    for (value, word) in keys.take_or_default::<FieldWords>("sentinels")? {
        sentinels.push((value.parse::<f64>().map_err(|_| SentinelNumber { value })?, word));
    }
    let valid = keys.take("valid")?.map(|[low, high]: [f64; 2]| (low, high));
    if valid.is_some_and(|(low, high)| low.partial_cmp(&high) != Some(std::cmp::Ordering::Less)) {
        return Err(ValidRange);
    }
    Ok(RawLimits { valid, error_above: keys.take("error_above")?, sentinels })
}

#[derive(Clone, Copy)]
enum ScaledQuantity {
    Length,
    Temperature,
}

fn scale(keys: &mut FieldKeys, quantity: ScaledQuantity) -> Result<FieldScale, ProtocolFinding> {
    let per: Option<f64> = keys.take("per")?;
    let unit = match (quantity, keys.take("unit")?) {
        (ScaledQuantity::Length, Some(FieldUnit::Micrometre)) => 1e-3,
        (ScaledQuantity::Length, Some(FieldUnit::Inch)) => 25.4,
        (ScaledQuantity::Length, Some(FieldUnit::Count)) if per.is_none() => return Err(CountScale),
        (ScaledQuantity::Length, Some(FieldUnit::Millimetre | FieldUnit::Device | FieldUnit::Count)) => 1.0,
        (ScaledQuantity::Temperature, Some(FieldUnit::Celsius)) => 1.0,
        (ScaledQuantity::Length, _) => return Err(LengthUnit),
        (ScaledQuantity::Temperature, _) => return Err(TemperatureUnit),
    };
    let numerator: u32 = keys.take("scale_num")?.unwrap_or(1);
    let denominator: u32 = keys.take("scale_den")?.unwrap_or(1);
    if numerator == 0 || denominator == 0 {
        return Err(ScaleZero);
    }
    let offset: f64 = keys.take_or_default("offset")?;
    let (times, per): (f64, f64) = (keys.take("times")?.unwrap_or(1.0), per.unwrap_or(1.0));
    if !offset.is_finite() || ![times, per].iter().all(|factor| factor.is_normal()) {
        return Err(ScaleFactors);
    }
    let sense = if keys.take_or_default("invert")? { -1.0 } else { 1.0 };
    let (numerator, denominator) = (f64::from(numerator), f64::from(denominator));
    // Without an offset, a single division keeps decimal values exact.
    Ok(if offset == 0.0 {
        FieldScale {
            numerator: numerator * times,
            denominator: denominator * per,
            offset,
            unit: unit * sense,
        }
    } else {
        FieldScale { numerator, denominator, offset, unit: unit * sense * times / per }
    })
}
