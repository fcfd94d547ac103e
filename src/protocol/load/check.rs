//! The check of a frame from its table: a CRC of the catalogue, or one by its parameters.

use toml::Spanned;

use super::source::Source;
use crate::diag::{Diagnostic, nearest};
use crate::protocol::check::{self, Check, Crc, Sum, Tabled};
use crate::protocol::table::{CheckEncoding, CheckKind, CheckTable};

pub(super) fn compile_check(
    source: Source,
    table: &Spanned<CheckTable>,
) -> Result<Option<Check>, Diagnostic> {
    let check = table.get_ref();
    let wrong = |message: &str| Err(source.wrong(table.span(), format!("[check]: {message}")));
    let parameters = [
        check.width.is_some(),
        check.poly.is_some(),
        check.init.is_some(),
        check.refin.is_some(),
        check.refout.is_some(),
        check.xorout.is_some(),
        check.check.is_some(),
    ];
    if check.kind != CheckKind::Crc && (check.name.is_some() || parameters.contains(&true)) {
        return wrong("only a crc has a name or parameters");
    }
    let after = match check.after.as_ref().map(|after| (after.get_ref().as_bytes(), after.span())) {
        None => None,
        Some(([after], _)) => Some(*after),
        Some((_, span)) => return Err(source.wrong(span, "after must be one ASCII character")),
    };
    if check.optional && after.is_none() {
        return wrong("optional needs `after`: the character that tells whether there is a check");
    }
    let sum = match check.kind {
        CheckKind::None => return Ok(None),
        CheckKind::Xor8 => Sum::Xor8,
        CheckKind::Sum8 => Sum::Sum8,
        CheckKind::Crc => Sum::Crc(Tabled::new(match &check.name {
            Some(_) if parameters.contains(&true) => {
                return wrong("give a crc by name or by parameters, not both");
            }
            Some(name) => named_crc(source, name)?,
            None => crc_by_parameters(source, table)?,
        })),
    };
    let Some(enc) = check.enc else {
        return wrong("enc is missing: le, be or hex");
    };
    if enc == CheckEncoding::Hex && check.kind == CheckKind::None {
        return wrong("kind none has no encoding");
    }
    Ok(Some(Check::new(sum, enc, after, check.optional, check.over_from)))
}

fn named_crc(source: Source, name: &Spanned<String>) -> Result<Crc, Diagnostic> {
    check::named(name.get_ref()).map(|(crc, _)| crc).ok_or_else(|| {
        let wrong = source.wrong(name.span(), format!("no CRC `{}` in the catalogue", name.get_ref()));
        let known = check::NAMES.join(", ");
        match nearest(name.get_ref(), check::NAMES.iter().copied()) {
            Some(near) => wrong.help(format!("did you mean `{near}`? Known are: {known}")),
            None => {
                wrong.help(format!("known are: {known}; others are given by width, poly, init, .. and check"))
            }
        }
    })
}

fn crc_by_parameters(source: Source, table: &Spanned<CheckTable>) -> Result<Crc, Diagnostic> {
    let t = table.get_ref();
    let (Some(width), Some(poly), Some(init), Some(refin), Some(refout), Some(xorout), Some(expected)) =
        (t.width, t.poly, t.init, t.refin, t.refout, t.xorout, &t.check)
    else {
        return Err(source.wrong(table.span(), "a crc needs a name, or all of its parameters").help(
            "width, poly, init, refin, refout, xorout, and check: the CRC over \"123456789\", which is verified",
        ));
    };
    if !matches!(width, 8 | 16 | 24 | 32) {
        return Err(source.wrong(table.span(), "[check]: width must be 8, 16, 24 or 32"));
    }
    let crc = Crc { width, poly, init, refin, refout, xorout };
    let check = Tabled::new(crc).compute(b"123456789");
    if check != *expected.get_ref() {
        return Err(source
            .wrong(expected.span(), format!("these CRC parameters give check {check:#x}"))
            .help(
                "check is the CRC over the nine characters 123456789: a parameter or this value is wrong",
            ));
    }
    Ok(crc)
}
