//! The check of a frame from its table: a CRC of the catalogue, or one by its parameters.

use crc::Algorithm;

use super::Source;
use crate::catalogue::ProtocolFinding::{
    self, AfterCharacter, CrcDiffers, CrcWidth, EncodingMissing, NameAndParameters, OptionalWithoutAfter,
    ParametersMissing, ParametersWithoutCrc, UnknownCrc,
};
use crate::device::protocol::check::{self, Check, Crc, Sum};
use crate::device::protocol::table::{CheckKind, CheckTable};
use crate::diagnostic::Diagnostic;

pub(super) fn compile_check(source: Source, table: &CheckTable) -> Result<Option<Check>, Diagnostic> {
    let wrong = |finding: ProtocolFinding| Err(source.table("check", finding));
    let parameters = [
        table.width.is_some(),
        table.poly.is_some(),
        table.init.is_some(),
        table.refin.is_some(),
        table.refout.is_some(),
        table.xorout.is_some(),
        table.check.is_some(),
    ];
    let by_parameters = parameters.contains(&true);
    if table.kind != CheckKind::Crc && (table.name.is_some() || by_parameters) {
        return wrong(ParametersWithoutCrc);
    }
    let after = match table.after.as_deref().map(str::as_bytes) {
        None => None,
        Some([after]) => Some(*after),
        Some(_) => return Err(source.key("check", "after", AfterCharacter)),
    };
    if table.optional && after.is_none() {
        return wrong(OptionalWithoutAfter);
    }
    let sum = match table.kind {
        CheckKind::None => return Ok(None),
        CheckKind::Xor8 => Sum::Xor8,
        CheckKind::Sum8 => Sum::Sum8,
        CheckKind::Crc => Sum::Crc(Box::new(match &table.name {
            Some(_) if by_parameters => return wrong(NameAndParameters),
            Some(name) => Crc::new(check::named(name).ok_or_else(|| unknown_crc(source, name))?),
            None => crc_by_parameters(source, table)?,
        })),
    };
    let Some(encoding) = table.enc else { return wrong(EncodingMissing) };
    Ok(Some(Check { sum, encoding, after, optional: table.optional, from: table.over_from }))
}

fn unknown_crc(source: Source, name: &str) -> Diagnostic {
    let finding = UnknownCrc { name: name.into(), known: check::NAMES.join(", ") };
    source.key("check", "name", finding).nearest(name, check::NAMES.iter().copied())
}

fn crc_by_parameters(source: Source, t: &CheckTable) -> Result<Crc, Diagnostic> {
    let (Some(width), Some(poly), Some(init), Some(refin), Some(refout), Some(xorout), Some(check)) =
        (t.width, t.poly, t.init, t.refin, t.refout, t.xorout, t.check)
    else {
        return Err(source.table("check", ParametersMissing));
    };
    if !matches!(width, 8 | 16 | 24 | 32) {
        return Err(source.table("check", CrcWidth));
    }
    let xorout = xorout & (u32::MAX >> (32 - width));
    let crc = Crc::new(Algorithm { width, poly, init, refin, refout, xorout, check, residue: 0 });
    crc.verify().map_err(|check| source.key("check", "check", CrcDiffers { check }))?;
    Ok(crc)
}
