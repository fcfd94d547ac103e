//! The text of a program file and its edits.

use std::ops::Range;

use dbbd_model::diagnostic::{Diagnostic, Finding};

/// A range of bytes of a text.
pub type Span = Range<usize>;

/// A file, as the user named it, with its text.
#[derive(Clone, Copy, Debug)]
pub struct Text<'a> {
    pub file: &'a str,
    pub text: &'a str,
}

impl Text<'_> {
    pub(crate) fn wrong(&self, span: &Span, finding: impl Finding) -> Diagnostic {
        Diagnostic::span(self.file, self.text, span.clone(), finding)
    }

    /// The beginning of the text, without leading blanks.
    pub(crate) fn beginning(&self) -> String {
        let first = self.text.lines().map(str::trim).find(|line| !line.is_empty()).unwrap_or("");
        first.chars().take(40).collect()
    }

    /// The line (from 1) of a byte.
    pub(crate) fn line(&self, at: usize) -> usize {
        self.text.as_bytes().get(..at).unwrap_or_default().iter().filter(|byte| **byte == b'\n').count() + 1
    }
}

/// A span with the text that replaces it.
pub(crate) type Edit = (Span, String);

/// Applies edits, which do not overlap. If a new number without sign would follow a name directly, a blank is put
/// between them.
pub(crate) fn rewritten(text: &str, mut edits: Vec<Edit>) -> String {
    let is_of_word = |character: char| character.is_ascii_alphanumeric() || character == '_';
    edits.sort_by_key(|(span, _)| span.start);
    let mut edited = String::with_capacity(text.len() + 4 * edits.len());
    let mut at = 0;
    for (span, new) in edits {
        edited.push_str(text.get(at..span.start).unwrap_or(""));
        if edited.ends_with(is_of_word) && new.starts_with(is_of_word) {
            edited.push(' ');
        }
        edited.push_str(&new);
        at = span.end;
    }
    edited.push_str(text.get(at..).unwrap_or(""));
    edited
}

/// A number with as many decimals as `written`, but at least `min_decimals`.
pub(crate) fn number_like(written: &str, value: f64, min_decimals: usize) -> String {
    let decimals = written
        .split_once('.')
        .map_or(0, |(_, tail)| tail.find(|c: char| !c.is_ascii_digit()).unwrap_or(tail.len()));
    fixed(value, decimals.clamp(min_decimals, 9))
}

/// A number with a fixed number of decimals; zero has no sign.
pub(crate) fn fixed(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(positive) if positive.chars().all(|c| c == '0' || c == '.') => positive.to_owned(),
        _ => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_does_not_become_a_part_of_a_name() {
        let edits = |new: &str| vec![(3..7, new.to_owned()), (11..13, "7".to_owned())];
        assert_eq!(rewritten("{A1-0.5,A2 +1}", edits("0.07")), "{A1 0.07,A2 7}");
        assert_eq!(rewritten("{A1-0.5,A2 +1}", edits("-0.6")), "{A1-0.6,A2 7}");
    }

    #[test]
    fn numbers_have_neither_a_negative_zero_nor_an_exponent() {
        assert_eq!(fixed(-0.0, 3), "0.000");
        assert_eq!(fixed(-0.000_4, 3), "0.000");
        assert_eq!(fixed(-0.000_6, 3), "-0.001");
        assert_eq!(fixed(1e-9, 4), "0.0000");
        assert_eq!(fixed(-123_456.789_01, 4), "-123456.7890");
    }
}
