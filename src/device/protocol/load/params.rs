//! Values that the user sets: `${name}` in a definition's text is replaced by one of them.
//!
//! They are put in before the text is read, so that a key that takes a number may say `"${name}"`.
//! `${name:04}` writes an integer with four digits, `${name:02x}` in hexadecimal.

use std::collections::BTreeMap;
use std::ops::Range;

use serde::Deserialize;

use crate::base::parse::from_toml;
use crate::catalogue::ProtocolFinding::{
    self, BraceOpen, NoParameters, ParameterFormat, ParameterNotANumber, ParameterNotWhole, ParameterRange,
    ParameterWord, UnknownParameter,
};
use crate::device::protocol::table::{ParamKind, ParamTable};
use crate::diagnostic::Diagnostic;

/// A text with the values put in.
pub(super) struct Resolved {
    /// What the loader reads.
    pub(super) text: String,
    /// The file with the chosen values as its defaults.
    pub(super) kept: String,
    pub(super) values: Vec<(String, String)>,
    moves: Vec<(Range<usize>, Range<usize>)>,
}

/// The part of a file that names the parameters.
#[derive(Deserialize)]
struct Head {
    #[serde(default)]
    params: BTreeMap<String, ParamTable>,
}

impl Resolved {
    /// A place of the text as a place of the file.
    pub(super) fn original(&self, span: Range<usize>) -> Range<usize> {
        let place = |at: usize| {
            let before = self.moves.iter().rev().find(|(new, _)| new.start <= at);
            match before {
                Some((new, old)) if at < new.end => old.start,
                Some((new, old)) => old.end + (at - new.end),
                None => at,
            }
        };
        place(span.start)..place(span.end)
    }
}

/// Puts the chosen values, else the defaults, into the text.
pub(super) fn resolve(file: &str, text: &str, chosen: &[(String, String)]) -> Result<Resolved, Diagnostic> {
    let head: Head = from_toml(file, text)?;
    if let Some((name, _)) = chosen.iter().find(|(name, _)| !head.params.contains_key(name)) {
        return Err(nearest(Diagnostic::file(file, unknown(name, &head.params)), name, &head.params));
    }
    let (mut values, mut kept) = (BTreeMap::new(), text.to_owned());
    let mut defaults: Vec<(Range<usize>, String)> = Vec::new();
    for (name, param) in &head.params {
        let default = match param.default.get_ref() {
            toml::Value::String(word) => word.clone(),
            other => other.to_string(),
        };
        let value = match chosen.iter().rev().find(|(chosen, _)| chosen == name) {
            Some((_, given)) => {
                let value = parse(name, param, given).map_err(|wrong| Diagnostic::file(file, wrong))?;
                defaults.push((param.default.span(), literal(param, &value)));
                value
            }
            None => parse(name, param, &default)
                .map_err(|wrong| Diagnostic::span(file, text, param.default.span(), wrong))?,
        };
        values.insert(name.clone(), value);
    }
    defaults.sort_by_key(|(span, _)| std::cmp::Reverse(span.start));
    for (span, value) in defaults {
        kept.replace_range(span, &value);
    }
    let (mut out, mut moves, mut at) = (String::with_capacity(text.len()), Vec::new(), 0);
    while let Some(found) = text.get(at..).and_then(|rest| rest.find("${")) {
        let start = at + found;
        let wrong = |end: usize, finding: ProtocolFinding| Diagnostic::span(file, text, start..end, finding);
        let Some(length) = text[start..].find('}') else {
            return Err(wrong(start + 2, BraceOpen));
        };
        let end = start + length + 1;
        let (name, format) = match text[start + 2..end - 1].split_once(':') {
            Some((name, format)) => (name, Some(format)),
            None => (&text[start + 2..end - 1], None),
        };
        let (Some(value), Some(param)) = (values.get(name), head.params.get(name)) else {
            return Err(nearest(wrong(end, unknown(name, &head.params)), name, &head.params));
        };
        // A number alone in its quotes is the number.
        let alone = format.is_none()
            && param.r#type != ParamKind::Enum
            && text[..start].ends_with('"')
            && text[end..].starts_with('"');
        let old = if alone { start - 1..end + 1 } else { start..end };
        out.push_str(&text[at..old.start]);
        let from = out.len();
        let written = match format {
            None => value.clone(),
            Some(format) => formatted(value, format)
                .ok_or_else(|| wrong(end, ParameterFormat { format: format.into(), value: value.clone() }))?,
        };
        out.push_str(&written);
        moves.push((from..out.len(), old.clone()));
        at = old.end;
    }
    out.push_str(text.get(at..).unwrap_or_default());
    Ok(Resolved { text: out, kept, values: values.into_iter().collect(), moves })
}

fn unknown(name: &str, params: &BTreeMap<String, ParamTable>) -> ProtocolFinding {
    let (name, known) = (name.to_owned(), params.keys().map(String::as_str).collect::<Vec<_>>().join(", "));
    if known.is_empty() { NoParameters { name } } else { UnknownParameter { name, known } }
}

fn nearest(wrong: Diagnostic, name: &str, params: &BTreeMap<String, ParamTable>) -> Diagnostic {
    wrong.nearest(name, params.keys().map(String::as_str))
}

/// The value in its usual writing, if the parameter may have it.
fn parse(name: &str, param: &ParamTable, text: &str) -> Result<String, ProtocolFinding> {
    let (name, value) = (name.to_owned(), text.to_owned());
    let (least, most) = (param.min.unwrap_or(f64::NEG_INFINITY), param.max.unwrap_or(f64::INFINITY));
    let (number, written) = match param.r#type {
        ParamKind::Float => match text.parse::<f64>() {
            Ok(number) if number.is_finite() => (number, format!("{number:?}")),
            _ => return Err(ParameterNotANumber { name, value }),
        },
        ParamKind::Int => match text.parse::<i64>() {
            Ok(number) => (number as f64, number.to_string()),
            Err(_) => return Err(ParameterNotWhole { name, value }),
        },
        ParamKind::Enum => {
            let plain = text.chars().all(|c| !c.is_control() && c != '"' && c != '\\');
            return match param.of.contains(&value) && plain {
                true => Ok(value),
                false => Err(ParameterWord { name, value, known: param.of.join(", ") }),
            };
        }
    };
    if (least..=most).contains(&number) {
        Ok(written)
    } else {
        Err(ParameterRange { name, value, least, most })
    }
}

fn literal(param: &ParamTable, value: &str) -> String {
    if param.r#type == ParamKind::Enum { format!("\"{value}\"") } else { value.to_owned() }
}

fn formatted(value: &str, format: &str) -> Option<String> {
    let number: u64 = value.parse().ok()?;
    let (width, hex) = match format.strip_suffix('x') {
        Some(width) => (width, true),
        None => (format, false),
    };
    let width: usize = width.strip_prefix('0')?.parse().ok().filter(|width| *width <= 16)?;
    let text = if hex { format!("{number:0width$x}") } else { format!("{number:0width$}") };
    (text.len() == width).then_some(text)
}
