//! Compiles messages and rejects, and checks that their fields fit the frame.

use std::ops::Range;

use toml::Spanned;

use super::field;
use super::field::FieldTable;
use crate::protocol::ProtocolFinding::{
    self, FramingByte, MatchedByte, NoFixedLength, OtherLength, RejectCode, RejectNumber, RejectText,
    RoleCount, TooLong,
};
use crate::protocol::engine::{MatchByte, RejectCodeFormat};
use crate::protocol::engine::{MessageFormat, RejectMessage};
use crate::protocol::field::{FieldForm, MessageField};
use crate::protocol::framing::Framing;
use crate::protocol::source::DefinitionSource;
use crate::protocol::source::hex_bytes;
use dbbd_model::diagnostic::Diagnostic;
use serde::Deserialize;
use std::collections::BTreeMap;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MessageTable {
    name: String,
    #[serde(default)]
    r#match: Vec<Spanned<MatchByte>>,
    fields: Vec<Spanned<FieldTable>>,
}

/// A message of the device that it has no reading.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RejectTable {
    prefix: Option<String>,
    eq: Option<String>,
    hex: Option<String>,
    /// Whether the message is followed by the check of the frame.
    #[serde(default)]
    checked: bool,
    code: Option<RejectCodeFormat>,
    #[serde(default)]
    map: BTreeMap<String, String>,
    /// There is only one action; the key makes files readable.
    #[serde(default, rename = "action")]
    _action: RejectAction,
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
enum RejectAction {
    #[default]
    DropSample,
}

/// Compiles a message; `check_len` is the length of the check after it.
pub(super) fn compile(
    source: &DefinitionSource,
    table: &Spanned<MessageTable>,
    framing: &Framing,
    check_len: usize,
) -> Result<MessageFormat, Diagnostic> {
    let MessageTable { name, r#match: matches, fields } = table.get_ref();
    let wrong = |finding: ProtocolFinding| source.wrong(table.span(), finding);
    let fields = fields
        .iter()
        .map(|field| field::compile(field.get_ref()).map_err(|finding| source.wrong(field.span(), finding)));
    let mut fields: Vec<MessageField> = fields.collect::<Result<_, _>>()?;
    field::group_bits(&mut fields).map_err(wrong)?;
    for role in ["length", "seq", "t_dev", "temp", "status", "unit", "quality"] {
        let count = fields.iter().filter(|field| field.role.is_some() && field.name() == role).count();
        if count > 1 || (role == "length" && count == 0) {
            return Err(wrong(RoleCount { message: name.clone(), role, count }));
        }
    }
    let len = fields.iter().map(|field| field.form.len()).sum::<Option<usize>>();
    fits(name, len, framing, check_len).map_err(wrong)?;
    let skipped = skipped(&fields);
    let free = |byte: usize| skipped.iter().any(|skipped| skipped.contains(&byte));
    if let Some(byte) = framing.reserved().find(|byte| !free(*byte)) {
        return Err(wrong(FramingByte { message: name.clone(), byte }));
    }
    if let Some(matched) = matches.iter().find(|matched| !free(matched.get_ref().at)) {
        return Err(source.wrong(matched.span(), MatchedByte { byte: matched.get_ref().at }));
    }
    Ok(MessageFormat { matches: matches.iter().map(|matched| *matched.get_ref()).collect(), fields, len })
}

/// Whether content of this length fits into the frame.
fn fits(name: &str, len: Option<usize>, framing: &Framing, check_len: usize) -> Result<(), ProtocolFinding> {
    let (room, exact) = framing.content_len();
    let (room, message) = (room.saturating_sub(check_len), name.to_owned());
    match len {
        Some(bytes) if bytes > room => Err(TooLong { message, bytes, room }),
        Some(bytes) if exact && bytes != room => Err(OtherLength { message, bytes, room }),
        None if exact => Err(NoFixedLength { message, room }),
        _ => Ok(()),
    }
}

/// The bytes of the fields of kind `skip`.
fn skipped(fields: &[MessageField]) -> Vec<Range<usize>> {
    let (mut start, mut skipped) = (0usize, Vec::new());
    for field in fields {
        let end = field.form.len().map_or(usize::MAX, |len| start.saturating_add(len));
        if matches!(field.form, FieldForm::Skip(_)) {
            skipped.push(start..end);
        }
        start = end;
    }
    skipped
}

pub(super) fn reject(table: &RejectTable) -> Result<RejectMessage, ProtocolFinding> {
    let (text, whole) = match (&table.prefix, &table.eq, &table.hex) {
        (Some(prefix), None, None) => (prefix.clone().into_bytes(), false),
        (None, Some(eq), None) => (eq.clone().into_bytes(), true),
        (None, None, Some(hex)) => (hex_bytes(hex).unwrap_or_default(), false),
        _ => return Err(RejectText),
    };
    if text.is_empty() {
        return Err(RejectText);
    }
    if table.code.is_some() && whole || table.code.is_none() && !table.map.is_empty() {
        return Err(RejectCode);
    }
    let base = if table.code == Some(RejectCodeFormat::Hex) { 16 } else { 10 };
    let words = table.map.iter().map(|(code, word)| {
        let number = u32::from_str_radix(code, base).map_err(|_| RejectNumber { code: code.clone() })?;
        Ok((number, word.clone()))
    });
    let words = words.collect::<Result<_, _>>()?;
    Ok(RejectMessage { text, whole, checked: table.checked, code: table.code, words })
}
