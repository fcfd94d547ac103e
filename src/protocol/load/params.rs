//! Values that the user sets: `${name}` in a definition's text stands for one of them.
//!
//! They are put in before the text is read, so that a key that takes a number may say `"${name}"`.
//! `${name:04}` writes an integer with four digits, `${name:02x}` in hexadecimal.

use std::collections::BTreeMap;
use std::ops::Range;

use serde::Deserialize;

use crate::diag::{Diagnostic, nearest};
use crate::protocol::table::{ParamKind, ParamTable};

/// A text with the values put in.
pub(super) struct Resolved {
    /// What the loader reads.
    pub(super) text: String,
    /// The file with the chosen values as its defaults.
    pub(super) kept: String,
    /// Names and values.
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
    let head: Head = toml::from_str(text).map_err(|error| Diagnostic::toml(file, text, &error))?;
    if let Some((name, _)) = chosen.iter().find(|(name, _)| !head.params.contains_key(name)) {
        return Err(unknown(Diagnostic::file(file, format!("no parameter `{name}`")), name, &head.params));
    }
    let (mut values, mut kept) = (BTreeMap::new(), text.to_owned());
    let mut defaults: Vec<(Range<usize>, String)> = Vec::new();
    for (name, param) in &head.params {
        let default = match param.default.get_ref() {
            toml::Value::String(word) => word.clone(),
            other => other.to_string(),
        };
        let wrong = |message: String| Diagnostic::span(file, text, param.default.span(), message);
        let value = match chosen.iter().rev().find(|(chosen, _)| chosen == name) {
            Some((_, given)) => {
                let value = parse(param, given).map_err(|why| {
                    Diagnostic::file(file, format!("parameter `{name}` = `{given}`: {why}"))
                })?;
                defaults.push((param.default.span(), literal(param, &value)));
                value
            }
            None => parse(param, &default).map_err(|why| wrong(format!("parameter `{name}`: {why}")))?,
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
        let wrong = |end: usize, message: String| Diagnostic::span(file, text, start..end, message);
        let Some(length) = text[start..].find('}') else {
            return Err(wrong(start + 2, "`${` without `}`".into()));
        };
        let end = start + length + 1;
        let (name, format) = match text[start + 2..end - 1].split_once(':') {
            Some((name, format)) => (name, Some(format)),
            None => (&text[start + 2..end - 1], None),
        };
        let (Some(value), Some(param)) = (values.get(name), head.params.get(name)) else {
            return Err(unknown(wrong(end, format!("no parameter `{name}`")), name, &head.params));
        };
        // A number alone in its quotes stands for the number.
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
                .ok_or_else(|| wrong(end, format!("`{format}` is no format for `{value}`")))?,
        };
        out.push_str(&written);
        moves.push((from..out.len(), old.clone()));
        at = old.end;
    }
    out.push_str(text.get(at..).unwrap_or_default());
    Ok(Resolved { text: out, kept, values: values.into_iter().collect(), moves })
}

fn unknown(wrong: Diagnostic, name: &str, params: &BTreeMap<String, ParamTable>) -> Diagnostic {
    let known = params.keys().map(String::as_str).collect::<Vec<_>>().join(", ");
    match nearest(name, params.keys().map(String::as_str)) {
        Some(near) => wrong.help(format!("did you mean `{near}`? [params] has: {known}")),
        None if known.is_empty() => wrong.help("the definition has no [params]"),
        None => wrong.help(format!("[params] has: {known}")),
    }
}

/// The value in its usual writing, if the parameter may have it.
fn parse(param: &ParamTable, text: &str) -> Result<String, String> {
    let (min, max) = (param.min.unwrap_or(f64::NEG_INFINITY), param.max.unwrap_or(f64::INFINITY));
    let within = |value: f64| {
        if (min..=max).contains(&value) { Ok(()) } else { Err(format!("must be {min} to {max}")) }
    };
    match param.r#type {
        ParamKind::Float => {
            let value: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
            if !value.is_finite() {
                return Err("not a finite number".into());
            }
            within(value).map(|()| format!("{value:?}"))
        }
        ParamKind::Int => {
            let value: i64 = text.parse().map_err(|_| "not a whole number".to_owned())?;
            within(value as f64).map(|()| value.to_string())
        }
        ParamKind::Enum => {
            let plain = text.chars().all(|c| !c.is_control() && c != '"' && c != '\\');
            if param.of.iter().any(|word| word == text) && plain {
                Ok(text.to_owned())
            } else {
                Err(format!("must be one of: {}", param.of.join(", ")))
            }
        }
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
