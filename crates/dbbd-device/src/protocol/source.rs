//! The text of a definition file with its parameters: `${name}` is a value that the user sets.
//!
//! Parameters are substituted before the text is parsed, so that a key that takes a number may be written as
//! `"${name}"`. `${name:04}` writes an integer with four digits, `${name:02x}` in hexadecimal.

use std::collections::BTreeMap;
use std::ops::Range;

use serde::Deserialize;
use serde::de::DeserializeOwned;

use crate::protocol::ProtocolFinding::{
    self, BraceOpen, NoParameters, ParameterFormat, ParameterNotANumber, ParameterNotWhole, ParameterRange,
    ParameterWord, UnknownParameter,
};
use dbbd_model::base::parse::{from_toml, from_toml_text};
use dbbd_model::diagnostic::{Diagnostic, Finding};
use toml::Spanned;

/// A parameter that the user sets.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ProtocolParamTable {
    r#type: ProtocolParamKind,
    min: Option<f64>,
    max: Option<f64>,
    #[serde(default)]
    of: Vec<String>,
    default: Spanned<toml::Value>,
}

#[derive(Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum ProtocolParamKind {
    Float,
    Int,
    Enum,
}

/// Bytes of pairs of hexadecimal digits; white space is ignored.
pub(super) fn hex_bytes(hex: &str) -> Option<Vec<u8>> {
    let digits: Option<Vec<u8>> = hex
        .chars()
        .filter(|c| !c.is_whitespace())
        .map(|c| c.to_digit(16).and_then(|digit| u8::try_from(digit).ok()))
        .collect();
    let digits = digits.filter(|digits| digits.len().is_multiple_of(2))?;
    Some(digits.chunks_exact(2).map(|pair| 16 * pair[0] + pair[1]).collect())
}

pub(super) struct DefinitionSource<'a> {
    file: &'a str,
    original: &'a str,
    /// The text with its parameters substituted.
    text: String,
    /// The file with the chosen values as its defaults.
    pub(super) with_chosen_defaults: String,
    /// Names and values of the parameters.
    pub(super) params: BTreeMap<String, String>,
    /// Substituted ranges of the text, with the ranges of the file that they replace.
    substituted: Vec<(Range<usize>, Range<usize>)>,
}

/// The part of a file that declares the parameters.
#[derive(Deserialize)]
struct DefinitionHead {
    #[serde(default)]
    params: BTreeMap<String, ProtocolParamTable>,
}

impl<'a> DefinitionSource<'a> {
    /// Substitutes the chosen values, or the defaults.
    pub(super) fn new(
        file: &'a str,
        original: &'a str,
        chosen: &[(String, String)],
    ) -> Result<Self, Diagnostic> {
        let DefinitionHead { params } = from_toml(file, original)?;
        if let Some((name, _)) = chosen.iter().find(|(name, _)| !params.contains_key(name)) {
            return Err(Diagnostic::file(file, unknown(name, &params)).nearest(name, names(&params)));
        }
        let mut values = BTreeMap::new();
        let mut defaults: Vec<(Range<usize>, String)> = Vec::new();
        for (name, param) in &params {
            let value = match chosen.iter().rev().find(|(chosen, _)| chosen == name) {
                Some((_, given)) => {
                    let value = parse(name, param, given).map_err(|wrong| Diagnostic::file(file, wrong))?;
                    let is_text = param.r#type == ProtocolParamKind::Enum;
                    let literal = if is_text { format!("\"{value}\"") } else { value.clone() };
                    defaults.push((param.default.span(), literal));
                    value
                }
                None => {
                    let default = param.default.get_ref();
                    let default = default.as_str().map_or_else(|| default.to_string(), str::to_owned);
                    parse(name, param, &default)
                        .map_err(|wrong| Diagnostic::span(file, original, param.default.span(), wrong))?
                }
            };
            values.insert(name.clone(), value);
        }
        let mut with_chosen_defaults = original.to_owned();
        defaults.sort_by_key(|(span, _)| std::cmp::Reverse(span.start));
        for (span, value) in defaults {
            with_chosen_defaults.replace_range(span, &value);
        }
        let (text, substituted) = (String::with_capacity(original.len()), Vec::new());
        let mut source = Self { file, original, text, with_chosen_defaults, params: values, substituted };
        source.substitute(&params)?;
        Ok(source)
    }

    fn substitute(&mut self, params: &BTreeMap<String, ProtocolParamTable>) -> Result<(), Diagnostic> {
        let original = self.original;
        let mut at = 0;
        while let Some(found) = original.get(at..).and_then(|rest| rest.find("${")) {
            let start = at + found;
            let wrong = |end: usize, finding: ProtocolFinding| {
                Diagnostic::span(self.file, original, start..end, finding)
            };
            let length = original[start..].find('}').ok_or_else(|| wrong(start + 2, BraceOpen))?;
            let end = start + length + 1;
            let (name, format) = match original[start + 2..end - 1].split_once(':') {
                Some((name, format)) => (name, Some(format)),
                None => (&original[start + 2..end - 1], None),
            };
            let (Some(value), Some(param)) = (self.params.get(name), params.get(name)) else {
                return Err(wrong(end, unknown(name, params)).nearest(name, names(params)));
            };
            // A number alone in its quotes replaces the quotes too.
            let alone = format.is_none()
                && param.r#type != ProtocolParamKind::Enum
                && original[..start].ends_with('"')
                && original[end..].starts_with('"');
            let replaced = if alone { start - 1..end + 1 } else { start..end };
            let written = match format {
                None => value.clone(),
                Some(format) => formatted(value, format).ok_or_else(|| {
                    wrong(end, ParameterFormat { format: format.into(), value: value.clone() })
                })?,
            };
            self.text.push_str(&original[at..replaced.start]);
            let from = self.text.len();
            self.text.push_str(&written);
            at = replaced.end;
            self.substituted.push((from..self.text.len(), replaced));
        }
        self.text.push_str(original.get(at..).unwrap_or_default());
        Ok(())
    }

    pub(super) fn parse<T: DeserializeOwned>(&self) -> Result<T, Diagnostic> {
        from_toml_text(&self.text).map_err(|(span, finding)| self.wrong(span, finding))
    }

    /// A finding at a range of the text.
    pub(super) fn wrong(&self, span: Range<usize>, finding: impl Finding) -> Diagnostic {
        let in_file = |at: usize| match self.substituted.iter().rev().find(|(new, _)| new.start <= at) {
            Some((new, old)) if at < new.end => old.start,
            Some((new, old)) => old.end + (at - new.end),
            None => at,
        };
        Diagnostic::span(self.file, self.original, in_file(span.start)..in_file(span.end), finding)
    }

    /// A finding at the head of a table.
    pub(super) fn table(&self, table: &str, finding: impl Finding) -> Diagnostic {
        let start = self.text.find(&format!("[{table}]")).unwrap_or(0);
        self.wrong(start..start, finding)
    }

    /// A finding at the value of a key: of its first occurrence after the head of its table, or of a key of the
    /// file itself if the table is empty.
    pub(super) fn key(&self, table: &str, key: &str, finding: impl Finding) -> Diagnostic {
        let head = if table.is_empty() { Some(0) } else { self.text.find(&format!("[{table}]")) };
        let head = head.unwrap_or(0);
        let after_head = self.text.get(head..).unwrap_or_default();
        let value = after_head.match_indices(key).find_map(|(at, _)| {
            let (before, after) = (&after_head[..at], &after_head[at + key.len()..]);
            let value =
                after.trim_start_matches([' ', '\t']).strip_prefix('=')?.trim_start_matches([' ', '\t']);
            let is_whole_name = !before.ends_with(|c: char| c.is_alphanumeric() || c == '_');
            is_whole_name.then(|| after_head.len() - value.len())
        });
        let start = head + value.unwrap_or(0);
        self.wrong(start..start, finding)
    }
}

fn names(params: &BTreeMap<String, ProtocolParamTable>) -> impl Iterator<Item = &str> {
    params.keys().map(String::as_str)
}

fn unknown(name: &str, params: &BTreeMap<String, ProtocolParamTable>) -> ProtocolFinding {
    let (name, known) = (name.to_owned(), names(params).collect::<Vec<_>>().join(", "));
    if known.is_empty() { NoParameters { name } } else { UnknownParameter { name, known } }
}

/// The value in its normal form, if the parameter may have it.
fn parse(name: &str, param: &ProtocolParamTable, text: &str) -> Result<String, ProtocolFinding> {
    let (name, value) = (name.to_owned(), text.to_owned());
    let (least, most) = (param.min.unwrap_or(f64::NEG_INFINITY), param.max.unwrap_or(f64::INFINITY));
    let (number, written) = match param.r#type {
        ProtocolParamKind::Float => match text.parse::<f64>() {
            Ok(number) if number.is_finite() => (number, format!("{number:?}")),
            _ => return Err(ParameterNotANumber { name, value }),
        },
        ProtocolParamKind::Int => match text.parse::<i64>() {
            Ok(number) => (number as f64, number.to_string()),
            Err(_) => return Err(ParameterNotWhole { name, value }),
        },
        ProtocolParamKind::Enum => {
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
