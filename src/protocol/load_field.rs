//! The loader's part for fields: which keys go with which kind and role.

use toml::Spanned;

use super::field::{Field, Form, Role, Scale};
use super::loader::{LONGEST_FRAME, Source};
use super::table::{Endian, FieldKind, FieldTable, RoleName, Unit};
use crate::diag::Diagnostic;

/// Checks a field and compiles it.
pub(super) fn compile(source: Source, table: &Spanned<FieldTable>) -> Result<Field, Diagnostic> {
    let wrong = |message: String| source.wrong(table.span(), message);
    let mut keys = table.get_ref().clone();
    let form = form(&mut keys).map_err(wrong)?;
    let role = role(&mut keys, &form).map_err(wrong)?;
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
        ("invert", keys.invert.is_some()),
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
        FieldKind::Lit => match keys.text.take() {
            Some(text) if !text.is_empty() => Form::Literal(text.into_bytes()),
            _ => return Err("lit needs `text`".into()),
        },
        FieldKind::Dec => match keys.decimals.take().unwrap_or(0) {
            decimals @ 0..=12 => Form::Decimal { decimals },
            _ => return Err("decimals must be at most 12".into()),
        },
        FieldKind::Hex => match keys.digits.take() {
            Some(digits @ 1..=8) => Form::Hex { digits },
            _ => return Err("hex needs `digits`, 1 to 8".into()),
        },
    })
}

/// Takes the keys of the field's role.
fn role(keys: &mut FieldTable, form: &Form) -> Result<Option<Role>, String> {
    let Some(role) = keys.role else { return Ok(None) };
    let bits = match form {
        Form::Skip(_) | Form::Literal(_) => return Err("a field without a value has no role".into()),
        Form::Integer { bytes, .. } => 8 * *bytes as u32,
        Form::Hex { digits } => 4 * *digits as u32,
        Form::Decimal { .. } => 32,
    };
    Ok(Some(match role {
        RoleName::Length => Role::Length(scale(keys, true)?),
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
    }))
}

fn scale(keys: &mut FieldTable, length: bool) -> Result<Scale, String> {
    let unit = match (keys.unit.take(), length) {
        (Some(Unit::Micrometre), true) => 1e-3,
        (Some(Unit::Inch), true) => 25.4,
        (Some(Unit::Millimetre), true) | (Some(Unit::Celsius), false) => 1.0,
        (_, true) => return Err("a length needs `unit`: um, mm or inch".into()),
        (_, false) => return Err("a temp needs `unit`: C".into()),
    };
    let (numerator, denominator) = (keys.scale_num.take().unwrap_or(1), keys.scale_den.take().unwrap_or(1));
    if numerator == 0 || denominator == 0 {
        return Err("scale_num and scale_den must not be 0".into());
    }
    let offset = keys.offset.take().unwrap_or(0.0);
    if !offset.is_finite() {
        return Err("offset must be a number".into());
    }
    let sense = if keys.invert.take().unwrap_or(false) { -1.0 } else { 1.0 };
    Ok(Scale { numerator: numerator.into(), denominator: denominator.into(), offset, unit: unit * sense })
}
