//! Compiles a field and checks the keys of its kind and role.

use std::collections::{BTreeMap, BTreeSet};

use serde::de::DeserializeOwned;

use crate::base::parse::from_toml_value;
use crate::catalogue::FileFinding;
use crate::catalogue::ProtocolFinding::{
    self, BitGroup, BitsBits, BlankFill, ClockKeys, ColumnSeparator, CountScale, DecimalWidth, FlagBit,
    FloatBits, HexDigits, IntegerBits, IntegerEndian, KeyType, KeyWithoutMeaning, LengthUnit, LiteralText,
    MapDefault, MapRole, MapWords, QualityRange, RoleWithoutValue, ScaleFactors, ScaleZero, SentinelNumber,
    SequenceModulo, SkipBytes, TemperatureUnit, TooManyWords, UnitKind, UnitWithoutMm, UnitWords, ValidRange,
};
use crate::device::protocol::decimal::Decimal;
use crate::device::protocol::field::{Clock, Field, Flags, Form, Limits, Role, Scale};
use crate::device::protocol::framing::LONGEST_FRAME;
use crate::device::protocol::table::{Endian, FieldKind, FieldTable, Fill, RoleName, Unit};

type Words = BTreeMap<String, String>;

/// The keys of a field that are not consumed yet.
struct Keys(toml::Table);

impl Keys {
    fn take<T: DeserializeOwned>(&mut self, key: &str) -> Result<Option<T>, ProtocolFinding> {
        let wrong = |finding: FileFinding| KeyType { key: key.into(), why: finding.to_string() };
        self.0.remove(key).map(|value| from_toml_value(value).map_err(wrong)).transpose()
    }

    fn take_or_default<T: DeserializeOwned + Default>(&mut self, key: &str) -> Result<T, ProtocolFinding> {
        self.take(key).map(Option::unwrap_or_default)
    }
}

pub(super) fn compile(table: &FieldTable) -> Result<Field, ProtocolFinding> {
    let mut keys = Keys(table.keys.clone());
    let (form, meanings) = form(table.kind, &mut keys)?;
    let role = table.role.map(|role| compile_role(role, &mut keys, &form, &meanings)).transpose()?;
    match keys.0.into_iter().next() {
        Some((key, _)) => Err(KeyWithoutMeaning { key }),
        None => Ok(Field { form, role }),
    }
}

/// The form of a field, and the meanings of its words if it is a map.
fn form(kind: FieldKind, keys: &mut Keys) -> Result<(Form, Vec<String>), ProtocolFinding> {
    let form = match kind {
        FieldKind::Skip => match keys.take("bytes")? {
            Some(bytes @ 1..=LONGEST_FRAME) => Form::Skip(bytes),
            _ => return Err(SkipBytes),
        },
        FieldKind::Uint | FieldKind::Int => {
            let bytes = match keys.take("bits")? {
                Some(bits @ (8 | 16 | 24 | 32)) => bits / 8,
                _ => return Err(IntegerBits),
            };
            let endian = match keys.take("endian")? {
                None if bytes > 1 => return Err(IntegerEndian),
                endian => endian.unwrap_or_default(),
            };
            Form::Integer { bytes, signed: kind == FieldKind::Int, endian }
        }
        FieldKind::Float => match (keys.take("bits")?, keys.take("endian")?) {
            (Some(bits @ (32 | 64)), Some(endian)) => Form::Float { bytes: bits / 8, endian },
            _ => return Err(FloatBits),
        },
        FieldKind::Bits => match keys.take("bits")? {
            Some(bits @ 1..=32) => Form::Bits {
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
            text => Form::Literal { text: text.into_bytes(), any_case: keys.take_or_default("any_case")? },
        },
        FieldKind::Dec => decimal(keys)?,
        FieldKind::Hex => match keys.take("digits")? {
            Some(digits @ 1..=8) => Form::Hex { digits, signed: keys.take_or_default("signed")? },
            _ => return Err(HexDigits),
        },
        FieldKind::Map => return map(keys),
        FieldKind::Column => match keys.take_or_default::<String>("sep")?.as_bytes() {
            [sep] => Form::Column { sep: *sep },
            _ => return Err(ColumnSeparator),
        },
    };
    Ok((form, Vec::new()))
}

fn decimal(keys: &mut Keys) -> Result<Form, ProtocolFinding> {
    let decimal = Decimal {
        decimals: keys.take_or_default("decimals")?,
        width: keys.take("width")?,
        pad_to: keys.take_or_default("pad_to")?,
        fill: keys.take_or_default("fill")?,
        sign: keys.take_or_default("sign")?,
        blanks: keys.take_or_default("blanks")?,
    };
    if decimal.decimals > 12 || decimal.pad_to > 32 || decimal.width.is_some_and(|w| !(1..=32).contains(&w)) {
        return Err(DecimalWidth);
    }
    if decimal.fill == Fill::Blank && !decimal.blanks {
        return Err(BlankFill);
    }
    Ok(Form::Decimal(decimal))
}

fn map(keys: &mut Keys) -> Result<(Form, Vec<String>), ProtocolFinding> {
    let mut map: Vec<(String, String)> = keys.take_or_default::<Words>("map")?.into_iter().collect();
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
    Ok((Form::Word { words: words.into_iter().map(String::into_bytes).collect(), default: at }, meanings))
}

/// Assigns adjacent bit fields of a message to groups of 1 to 4 whole bytes.
pub(super) fn group_bits(fields: &mut [Field]) -> Result<(), ProtocolFinding> {
    let is_bits = |field: &Field| matches!(field.form, Form::Bits { .. });
    for run in fields.chunk_by_mut(|a, b| is_bits(a) && is_bits(b)) {
        let (mut total, count) = (0, run.len());
        for field in run.iter_mut() {
            if let Form::Bits { bits, shift, .. } = &mut field.form {
                *shift = total;
                total += *bits;
            }
        }
        if total > 32 || total % 8 != 0 {
            return Err(BitGroup { bits: total });
        }
        for (at, field) in run.iter_mut().enumerate() {
            if let Form::Bits { group, last, .. } = &mut field.form {
                (*group, *last) = (total as usize / 8, at + 1 == count);
            }
        }
    }
    Ok(())
}

fn compile_role(
    role: RoleName,
    keys: &mut Keys,
    form: &Form,
    meanings: &[String],
) -> Result<Role, ProtocolFinding> {
    let bits = match form {
        Form::Skip(_) | Form::Literal { .. } | Form::Column { .. } => return Err(RoleWithoutValue),
        Form::Integer { bytes, .. } => 8 * *bytes as u32,
        Form::Bits { bits, .. } => *bits,
        Form::Hex { digits, .. } => 4 * *digits as u32,
        Form::Decimal(_) | Form::Float { .. } => 32,
        Form::Word { .. } => return role_of_words(role, meanings),
    };
    Ok(match role {
        RoleName::Length => Role::Length(scale(keys, Quantity::Length)?, limits(keys)?),
        RoleName::Temp => Role::Temperature(scale(keys, Quantity::Temperature)?),
        RoleName::Seq => match keys.take("modulo")? {
            Some(modulo @ 2u32..) if u64::from(modulo) <= 1 << bits => Role::Sequence { modulo },
            _ => return Err(SequenceModulo { bits }),
        },
        RoleName::TDev => match (keys.take("tick_ns")?, keys.take("wrap_bits")?) {
            (Some(tick_ns @ 1..), Some(wrap_bits)) if (8..=bits).contains(&wrap_bits) => {
                Role::Ticks(Clock { tick_ns, wrap_bits })
            }
            _ => return Err(ClockKeys { bits }),
        },
        RoleName::Status => {
            let mut flags = Vec::new();
            for (bit, name) in keys.take_or_default::<Words>("flags")? {
                match bit.parse::<u32>() {
                    Ok(number) if number < bits => flags.push((number, name)),
                    _ => return Err(FlagBit { bit, highest: bits - 1 }),
                }
            }
            flags.sort();
            Role::Status(Flags::new(flags))
        }
        RoleName::Quality => match keys.take::<[f64; 2]>("valid")? {
            Some([low, high]) if low > 0.0 && low <= high => Role::Quality(low, high),
            _ => return Err(QualityRange),
        },
        RoleName::Unit => return Err(UnitKind),
    })
}

fn role_of_words(role: RoleName, meanings: &[String]) -> Result<Role, ProtocolFinding> {
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
            if units.contains(&Some(1.0)) { Ok(Role::Unit(units)) } else { Err(UnitWithoutMm) }
        }
        RoleName::Status => {
            let names: BTreeSet<&String> = meanings.iter().collect();
            if names.len() > 32 {
                return Err(TooManyWords);
            }
            let bit = |name| names.iter().position(|known| *known == name).unwrap_or(0) as u32;
            let bits = meanings.iter().map(bit).collect();
            let names = (0..).zip(names.iter().map(|name| (*name).clone())).collect();
            Ok(Role::StatusWord(bits, Flags::new(names)))
        }
        _ => Err(MapRole),
    }
}

fn limits(keys: &mut Keys) -> Result<Limits, ProtocolFinding> {
    let mut sentinels = Vec::new();
    for (value, word) in keys.take_or_default::<Words>("sentinels")? {
        sentinels.push((value.parse::<f64>().map_err(|_| SentinelNumber { value })?, word));
    }
    let valid = keys.take("valid")?.map(|[low, high]: [f64; 2]| (low, high));
    if valid.is_some_and(|(low, high)| low.partial_cmp(&high) != Some(std::cmp::Ordering::Less)) {
        return Err(ValidRange);
    }
    Ok(Limits { valid, error_above: keys.take("error_above")?, sentinels })
}

#[derive(Clone, Copy)]
enum Quantity {
    Length,
    Temperature,
}

fn scale(keys: &mut Keys, quantity: Quantity) -> Result<Scale, ProtocolFinding> {
    let per: Option<f64> = keys.take("per")?;
    let unit = match (quantity, keys.take("unit")?) {
        (Quantity::Length, Some(Unit::Micrometre)) => 1e-3,
        (Quantity::Length, Some(Unit::Inch)) => 25.4,
        (Quantity::Length, Some(Unit::Count)) if per.is_none() => return Err(CountScale),
        (Quantity::Length, Some(Unit::Millimetre | Unit::Device | Unit::Count)) => 1.0,
        (Quantity::Temperature, Some(Unit::Celsius)) => 1.0,
        (Quantity::Length, _) => return Err(LengthUnit),
        (Quantity::Temperature, _) => return Err(TemperatureUnit),
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
        Scale { numerator: numerator * times, denominator: denominator * per, offset, unit: unit * sense }
    } else {
        Scale { numerator, denominator, offset, unit: unit * sense * times / per }
    })
}
