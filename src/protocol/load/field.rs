//! Fields: which keys go with which kind and role.

use std::collections::BTreeMap;

use toml::Spanned;

use super::source::Source;
use crate::diag::Diagnostic;
use crate::protocol::decimal::Decimal;
use crate::protocol::field::{Field, Form, Limits, Role, Scale};
use crate::protocol::framing::LONGEST_FRAME;
use crate::protocol::table::field::{Endian, FieldKind, FieldTable, Fill, RoleName, Unit};

/// Checks a field and compiles it.
pub(super) fn compile(source: Source, table: &Spanned<FieldTable>) -> Result<Field, Diagnostic> {
    let wrong = |message: String| source.wrong(table.span(), message);
    let mut keys = table.get_ref().clone();
    let words = keys.map.clone().unwrap_or_default();
    let form = form(&mut keys).map_err(wrong)?;
    let role = role(&mut keys, &form, &words).map_err(wrong)?;
    let left_over = [
        ("bytes", keys.bytes.is_some()),
        ("bits", keys.bits.is_some()),
        ("endian", keys.endian.is_some()),
        ("text", keys.text.is_some()),
        ("decimals", keys.decimals.is_some()),
        ("digits", keys.digits.is_some()),
        ("modulo", keys.modulo.is_some()),
        ("tick_ns", keys.tick_ns.is_some()),
        ("wrap_bits", keys.wrap_bits.is_some()),
        ("unit", keys.unit.is_some()),
        ("scale_num", keys.scale_num.is_some()),
        ("scale_den", keys.scale_den.is_some()),
        ("offset", keys.offset.is_some()),
        ("times", keys.times.is_some()),
        ("per", keys.per.is_some()),
        ("invert", keys.invert.is_some()),
        ("valid", keys.valid.is_some()),
        ("error_above", keys.error_above.is_some()),
        ("sentinels", keys.sentinels.is_some()),
        ("signed", keys.signed.is_some()),
        ("width", keys.width.is_some()),
        ("pad_to", keys.pad_to.is_some()),
        ("fill", keys.fill.is_some()),
        ("sign", keys.sign.is_some()),
        ("blanks", keys.blanks.is_some()),
        ("any_case", keys.any_case.is_some()),
        ("map", keys.map.is_some()),
        ("default", keys.default.is_some()),
        ("optional", keys.optional.is_some()),
        ("sep", keys.sep.is_some()),
        ("flags", keys.flags.is_some()),
    ];
    if let Some((key, _)) = left_over.iter().find(|(_, left)| *left) {
        return Err(wrong(format!("`{key}` has no meaning in a field of this kind and role")));
    }
    Ok(Field { form, role })
}

/// Takes the keys of the field's kind.
fn form(keys: &mut FieldTable) -> Result<Form, String> {
    Ok(match keys.kind {
        FieldKind::Skip => match keys.bytes.take() {
            Some(bytes @ 1..=LONGEST_FRAME) => Form::Skip(bytes),
            _ => return Err("skip needs `bytes`, at least 1".into()),
        },
        FieldKind::Uint | FieldKind::Int => {
            let bytes = match keys.bits.take() {
                Some(bits @ (8 | 16 | 24 | 32)) => bits / 8,
                _ => return Err("an integer needs `bits`: 8, 16, 24 or 32".into()),
            };
            let big_endian = match keys.endian.take() {
                Some(endian) => endian == Endian::Be,
                None if bytes == 1 => false,
                None => return Err("an integer of several bytes needs `endian`: le or be".into()),
            };
            Form::Integer { bytes, signed: keys.kind == FieldKind::Int, big_endian }
        }
        FieldKind::Float => match (keys.bits.take(), keys.endian.take()) {
            (Some(bits @ (32 | 64)), Some(endian)) => {
                Form::Float { bytes: bits / 8, big_endian: endian == Endian::Be }
            }
            _ => return Err("a float needs `bits`: 32 or 64, and `endian`: le or be".into()),
        },
        FieldKind::Bits => match keys.bits.take() {
            Some(bits @ 1..=32) => Form::Bits {
                bits: bits as u32,
                shift: 0,
                group: 0,
                big_endian: keys.endian.take() == Some(Endian::Be),
                signed: keys.signed.take().unwrap_or(false),
                last: false,
            },
            _ => return Err("bits needs `bits`, 1 to 32".into()),
        },
        FieldKind::Lit => match keys.text.take() {
            Some(text) if !text.is_empty() => {
                Form::Literal { text: text.into_bytes(), any_case: keys.any_case.take().unwrap_or(false) }
            }
            _ => return Err("lit needs `text`".into()),
        },
        FieldKind::Dec => {
            let decimal = Decimal {
                decimals: keys.decimals.take().unwrap_or(0),
                width: keys.width.take(),
                pad_to: keys.pad_to.take().unwrap_or(0),
                fill: keys.fill.take().unwrap_or_default(),
                sign: keys.sign.take().unwrap_or_default(),
                blanks: keys.blanks.take().unwrap_or(false),
            };
            if decimal.decimals > 12
                || decimal.pad_to > 32
                || decimal.width.is_some_and(|w| !(1..=32).contains(&w))
            {
                return Err("decimals must be at most 12, width and pad_to at most 32".into());
            }
            if decimal.fill == Fill::Blank && !decimal.blanks {
                return Err("fill = \"blank\" needs blanks = true: what is written must be read".into());
            }
            Form::Decimal(decimal)
        }
        FieldKind::Hex => match keys.digits.take() {
            Some(digits @ 1..=8) => Form::Hex { digits, signed: keys.signed.take().unwrap_or(false) },
            _ => return Err("hex needs `digits`, 1 to 8".into()),
        },
        FieldKind::Map => {
            let map = keys.map.take().unwrap_or_default();
            let mut words: Vec<&String> = map.keys().collect();
            // A word that begins another must not be taken for it.
            words.sort_by_key(|word| (std::cmp::Reverse(word.len()), (*word).clone()));
            let optional = keys.optional.take().unwrap_or(false);
            let default = keys.default.take();
            let at = default.as_ref().and_then(|default| words.iter().position(|word| *word == default));
            if words.is_empty() || words.iter().any(|word| word.is_empty()) {
                return Err("map needs `map`: words and what they say".into());
            }
            if at.is_none() != optional || default.is_some() && at.is_none() {
                return Err(
                    "map needs either `optional = true` or `default`: the word of the map that is written"
                        .into(),
                );
            }
            Form::Word { words: words.iter().map(|word| word.as_bytes().to_vec()).collect(), default: at }
        }
        FieldKind::Column => match keys.sep.take().as_deref().map(str::as_bytes) {
            Some([sep]) => Form::Column { sep: *sep },
            _ => return Err("column needs `sep`: one ASCII character".into()),
        },
    })
}

/// Tells bits that follow each other in a message their places; a group is 1 to 4 whole bytes.
pub(super) fn group_bits(fields: &mut [Field]) -> Result<(), String> {
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
            return Err(format!("{total} bits follow each other: a group is 8, 16, 24 or 32 bits"));
        }
        for (at, field) in run.iter_mut().enumerate() {
            if let Form::Bits { group, last, .. } = &mut field.form {
                (*group, *last) = (total as usize / 8, at + 1 == count);
            }
        }
    }
    Ok(())
}

/// Takes the keys of the field's role.
fn role(
    keys: &mut FieldTable,
    form: &Form,
    words: &BTreeMap<String, String>,
) -> Result<Option<Role>, String> {
    let Some(role) = keys.role else { return Ok(None) };
    let bits = match form {
        Form::Skip(_) | Form::Literal { .. } | Form::Column { .. } => {
            return Err("a field without a value has no role".into());
        }
        Form::Integer { bytes, .. } => 8 * *bytes as u32,
        Form::Bits { bits, .. } => *bits,
        Form::Hex { digits, .. } => 4 * *digits as u32,
        Form::Decimal(_) | Form::Float { .. } => 32,
        Form::Word { words: listed, .. } => return worded(role, listed, words).map(Some),
    };
    Ok(Some(match role {
        RoleName::Length => Role::Length(scale(keys, true)?, limits(keys)?),
        RoleName::Temp => Role::Temperature(scale(keys, false)?),
        RoleName::Seq => match keys.modulo.take() {
            Some(modulo) if modulo >= 2 && u64::from(modulo) <= 1 << bits => Role::Sequence,
            _ => return Err(format!("seq needs `modulo`: from 2 to 2^{bits}")),
        },
        RoleName::TDev => match (keys.tick_ns.take(), keys.wrap_bits.take()) {
            (Some(1..), Some(wrap)) if (8..=bits).contains(&wrap) => Role::Ticks,
            _ => return Err(format!("t_dev needs `tick_ns`, at least 1, and `wrap_bits`: 8 to {bits}")),
        },
        RoleName::Status => {
            let mut flags = Vec::new();
            for (bit, name) in keys.flags.take().unwrap_or_default() {
                match bit.parse::<u32>() {
                    Ok(number) if number < bits => flags.push((number, name)),
                    _ => return Err(format!("flag `{bit}` is not a bit of the field: 0 to {}", bits - 1)),
                }
            }
            flags.sort();
            Role::Status(flags)
        }
        RoleName::Quality => match keys.valid.take() {
            Some([low, high]) if low > 0.0 && low <= high => Role::Quality(low, high),
            _ => return Err("quality needs `valid`: [lowest, highest], the lowest above 0".into()),
        },
        RoleName::Unit => return Err("a unit is a field of kind `map`".into()),
    }))
}

/// The role of a field whose values are words.
fn worded(role: RoleName, listed: &[Vec<u8>], map: &BTreeMap<String, String>) -> Result<Role, String> {
    let says = |word: &Vec<u8>| map.iter().find(|(key, _)| key.as_bytes() == &word[..]).map(|(_, says)| says);
    match role {
        RoleName::Unit => {
            let units = listed.iter().map(|word| match says(word).map(String::as_str) {
                Some("mm") => Ok(Some(1.0)),
                Some("um") => Ok(Some(1e-3)),
                Some("inch") => Ok(Some(25.4)),
                Some("fault") => Ok(None),
                _ => Err("a unit's words say mm, um, inch or fault".to_owned()),
            });
            let units: Vec<Option<f64>> = units.collect::<Result<_, _>>()?;
            if units.contains(&Some(1.0)) {
                Ok(Role::Unit(units))
            } else {
                Err("a unit needs a word for mm".into())
            }
        }
        RoleName::Status => {
            let mut names: Vec<&String> = map.values().collect();
            names.sort();
            names.dedup();
            if names.len() > 32 {
                return Err("more than 32 different words".into());
            }
            let bit = |name: &String| names.iter().position(|known| *known == name).unwrap_or(0) as u32;
            let bits = listed.iter().filter_map(|word| says(word).map(bit)).collect();
            Ok(Role::StatusWord(bits, (0..).zip(names.iter().map(|name| (*name).clone())).collect()))
        }
        _ => Err("a field of kind `map` has role unit, status or none".into()),
    }
}

fn limits(keys: &mut FieldTable) -> Result<Limits, String> {
    let mut sentinels = Vec::new();
    for (value, word) in keys.sentinels.take().unwrap_or_default() {
        sentinels
            .push((value.parse::<f64>().map_err(|_| format!("sentinel `{value}` is not a number"))?, word));
    }
    let valid = keys.valid.take().map(|[low, high]| (low, high));
    if valid.is_some_and(|(low, high)| low.partial_cmp(&high) != Some(std::cmp::Ordering::Less)) {
        return Err("valid must be [lowest, highest]".into());
    }
    Ok(Limits { valid, error_above: keys.error_above.take(), sentinels })
}

fn scale(keys: &mut FieldTable, length: bool) -> Result<Scale, String> {
    let per = keys.per.take();
    let unit = match (keys.unit.take(), length) {
        (Some(Unit::Micrometre), true) => 1e-3,
        (Some(Unit::Inch), true) => 25.4,
        (Some(Unit::Count), true) if per.is_none() => {
            return Err("unit count needs `per`: how many counts make a millimetre".into());
        }
        (Some(Unit::Millimetre | Unit::Device | Unit::Count), true) | (Some(Unit::Celsius), false) => 1.0,
        (_, true) => return Err("a length needs `unit`: um, mm, inch, count or device".into()),
        (_, false) => return Err("a temp needs `unit`: C".into()),
    };
    let (numerator, denominator) = (keys.scale_num.take().unwrap_or(1), keys.scale_den.take().unwrap_or(1));
    if numerator == 0 || denominator == 0 {
        return Err("scale_num and scale_den must not be 0".into());
    }
    let (offset, times) = (keys.offset.take().unwrap_or(0.0), keys.times.take().unwrap_or(1.0));
    let per = per.unwrap_or(1.0);
    if !offset.is_finite() || ![times, per].iter().all(|factor| factor.is_normal()) {
        return Err("offset must be a number, times and per numbers other than 0".into());
    }
    let sense = if keys.invert.take().unwrap_or(false) { -1.0 } else { 1.0 };
    let (numerator, denominator) = (f64::from(numerator), f64::from(denominator));
    // Without an offset a single division keeps decimal values exact.
    Ok(if offset == 0.0 {
        Scale { numerator: numerator * times, denominator: denominator * per, offset, unit: unit * sense }
    } else {
        Scale { numerator, denominator, offset, unit: unit * sense * times / per }
    })
}
