//! Reads TOML texts, and explains why one is refused.

use std::ops::Range;

use serde::Deserialize;
use serde::de::DeserializeOwned;

use crate::base::FileFinding::{
    self, ArrayLength, ArrayLengthByComma, DecimalComma, NotToml, NotTomlButAnother,
};
use crate::diagnostic::Diagnostic;

/// Deserialises a TOML file.
pub fn from_toml<'de, T: Deserialize<'de>>(file: &str, text: &'de str) -> Result<T, Diagnostic> {
    toml::de::Deserializer::parse(text)
        .and_then(T::deserialize)
        .map_err(|error| wrong_toml(file, text, &error))
}

/// Deserialises a TOML text that is part of a file. The error has its byte range in the text.
pub fn from_toml_text<'de, T: Deserialize<'de>>(text: &'de str) -> Result<T, (Range<usize>, FileFinding)> {
    toml::de::Deserializer::parse(text).and_then(T::deserialize).map_err(|error| {
        let span = error.span().unwrap_or_default();
        (span.clone(), not_toml(text, span, &error))
    })
}

pub fn from_toml_value<T: DeserializeOwned>(value: toml::Value) -> Result<T, FileFinding> {
    let text = value.to_string();
    T::deserialize(value).map_err(|error| not_toml(&text, 0..text.len(), &error))
}

fn wrong_toml(file: &str, text: &str, error: &toml::de::Error) -> Diagnostic {
    let finding = match file.rsplit_once('.') {
        Some((_, kind @ ("csv" | "json" | "src" | "dat"))) => {
            NotTomlButAnother { why: error.message().to_owned(), kind: kind.into() }
        }
        _ => not_toml(text, error.span().unwrap_or_default(), error),
    };
    let diagnostic = match error.span() {
        Some(span) => Diagnostic::span(file, text, span, finding),
        None => Diagnostic::file(file, finding),
    };
    let mut words = error.message().split('`').skip(1).step_by(2);
    match words.next() {
        Some(word) if error.message().starts_with("unknown") => diagnostic.nearest(word, words),
        _ => diagnostic,
    }
}

/// Translates an error of the `toml` crate at a byte range of a text.
fn not_toml(text: &str, span: Range<usize>, error: &toml::de::Error) -> FileFinding {
    let (before, after) = text.split_at_checked(span.start).unwrap_or_default();
    let place = text.get(span).unwrap_or("");
    if let Some((found, expected)) = lengths(error.message()) {
        return match without_commas(place, expected) {
            Some(meant) => ArrayLengthByComma { found, expected, meant },
            None => ArrayLength { found, expected },
        };
    }
    let digit = |c: Option<char>| c.is_some_and(|c| c.is_ascii_digit());
    if after.starts_with(',') && digit(after.chars().nth(1)) && digit(before.chars().next_back()) {
        return DecimalComma { why: error.message().to_owned() };
    }
    match error.message().split_once(", expected ") {
        Some((found, expected)) if found.starts_with("invalid ") => {
            let found = found.replace("floating point", "number").replace("integer", "whole number");
            NotToml { why: format!("{found}, and {} is needed", plain(expected)) }
        }
        _ => NotToml { why: error.message().to_owned() },
    }
}

/// The expected type in the terms of the file instead of Rust's.
fn plain(expected: &str) -> &str {
    match expected.trim() {
        "f64" => "a number",
        "u8" | "u16" | "u32" | "u64" | "usize" | "nonzero u32" => "a whole number, 0 or more,",
        "i8" | "i32" | "i64" => "a whole number",
        "a boolean" => "true or false",
        "a string" => "a text in quotes",
        other => match other.strip_prefix("an array of length ") {
            Some("2") => "an array `[low, high]` of two values",
            Some("3") => "an array of three values",
            Some("6") => "an array of six values",
            _ => other,
        },
    }
}

/// The number of values found and expected, from a message about a wrong length.
fn lengths(message: &str) -> Option<(usize, usize)> {
    let (found, expected) = message.strip_prefix("invalid length ")?.split_once(", expected ")?;
    Some((found.parse().ok()?, expected.strip_suffix(" values")?.parse().ok()?))
}

/// The array with decimal points, if decimal commas explain why it has more than `expected` values.
fn without_commas(array: &str, expected: usize) -> Option<String> {
    let values = array.trim().strip_prefix('[')?.strip_suffix(']')?;
    let values: Vec<&str> = values.split(',').map(str::trim).filter(|value| !value.is_empty()).collect();
    let mut excess = values.len().checked_sub(expected).filter(|excess| *excess > 0)?;
    let mut numbers: Vec<String> = Vec::new();
    let mut open = false;
    for value in values {
        let decimals = value.bytes().all(|byte| byte.is_ascii_digit());
        match numbers.last_mut() {
            Some(last) if open && decimals && excess > 0 => {
                *last = format!("{last}.{value}");
                excess -= 1;
                open = false;
            }
            _ => {
                open = value.parse::<i64>().is_ok();
                numbers.push(value.to_owned());
            }
        }
    }
    (excess == 0).then(|| format!("[{}]", numbers.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::fixed_array::fixed_array;

    #[derive(Debug, Deserialize, PartialEq)]
    struct Numbers {
        #[serde(deserialize_with = "fixed_array")]
        pair: [f64; 2],
        list: Vec<i64>,
        #[serde(deserialize_with = "fixed_array")]
        nested: Vec<[f64; 3]>,
    }

    fn numbers(pair: &str, nested: &str) -> Result<Numbers, FileFinding> {
        let text = format!("pair = {pair}\nlist = [1, 2, 3]\nnested = {nested}\n");
        from_toml_text(&text).map_err(|(_, finding)| finding)
    }

    #[test]
    fn arrays_have_as_many_values_as_their_type() {
        let found = numbers("[1.5, 2]", "[[1, 2, 3], [4, 5, 6]]").unwrap();
        assert_eq!((found.pair, found.list.len(), found.nested[1]), ([1.5, 2.0], 3, [4.0, 5.0, 6.0]));
        let ok = "[[1, 2, 3]]";
        assert!(matches!(numbers("[1]", ok), Err(ArrayLength { found: 1, expected: 2 })));
        assert!(matches!(numbers("[1.5, 2.5, 3.5]", ok), Err(ArrayLength { found: 3, expected: 2 })));
        assert!(matches!(
            numbers("[1, 2]", "[[1.5, 2.5, 3.5, 4.5]]"),
            Err(ArrayLength { found: 4, expected: 3 })
        ));
        match numbers("[45,5, 0,25]", ok) {
            Err(ArrayLengthByComma { found: 4, expected: 2, meant }) => assert_eq!(meant, "[45.5, 0.25]"),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn decimal_commas_are_explained() {
        for (array, expected, meant) in [
            ("[45,5, 0,0]", 2, Some("[45.5, 0.0]")),
            ("[1,5, 2]", 2, Some("[1.5, 2]")),
            ("[-1,25, 0, 7]", 3, Some("[-1.25, 0, 7]")),
            ("[1.5, 2.5, 3.5]", 2, None),
            ("[1, 2]", 2, None),
            ("1, 2", 1, None),
        ] {
            assert_eq!(without_commas(array, expected).as_deref(), meant, "{array}");
        }
        let text = "a = 1,5\n";
        let found = from_toml_text::<toml::Table>(text).unwrap_err().1;
        assert!(matches!(found, DecimalComma { .. }), "{found:?}");
        assert_eq!(lengths("invalid length 4, expected 2 values"), Some((4, 2)));
        assert_eq!(lengths("invalid length 4"), None);
    }
}
