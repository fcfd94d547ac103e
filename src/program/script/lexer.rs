//! Words of a program: names, numbers, texts, signs. Where a language ends statements by lines, their ends are words.

use crate::catalogue::ProgramFinding;
use crate::diagnostic::Diagnostic;
use crate::program::Language;
use crate::program::text::{Span, Text};

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Token {
    /// As it is written; of RAPID in capitals.
    Name(String),
    Number(f64),
    Text(String),
    /// Brackets, operators, separators.
    Sign(&'static str),
    LineEnd,
    End,
}

/// Signs, the longer before those that they begin with.
const SIGNS: &[&str] = &[
    ":=", "<>", "<=", ">=", "==", "!=", "(", ")", "{", "}", "[", "]", ",", ";", ":", ".", "\\", "=", "<",
    ">", "+", "-", "*", "/", "%", "?", "@", "|",
];

/// Splits a text into words with their bytes; the last is [`Token::End`].
pub(crate) fn tokens(file: Text<'_>, language: Language) -> Result<Vec<(Token, Span)>, Diagnostic> {
    let text = file.text;
    if text.starts_with('\u{feff}') {
        return Err(file.wrong(&(0..3), ProgramFinding::ByteOrderMark));
    }
    let mut tokens = Vec::new();
    let mut at = 0;
    while let Some(rest) = text.get(at..).filter(|rest| !rest.is_empty()) {
        let (token, length) = next(file, at, rest, language)?;
        tokens.extend(token.map(|token| (token, at..at + length)));
        at += length;
    }
    tokens.extend([(Token::LineEnd, at..at), (Token::End, at..at)]);
    Ok(tokens)
}

fn next(
    file: Text<'_>,
    at: usize,
    rest: &str,
    language: Language,
) -> Result<(Option<Token>, usize), Diagnostic> {
    let length = |accepted: fn(char) -> bool| rest.find(|c| !accepted(c)).unwrap_or(rest.len());
    let prefix = |length: usize| rest.get(..length).unwrap_or("");
    let Some(first) = rest.chars().next() else { return Ok((None, rest.len())) };
    // `!=` of URScript is no comment: only RAPID's begin with `!`.
    if first == language.comment() {
        return Ok((None, length(|c| c != '\n')));
    }
    match first {
        '\n' => Ok(((language == Language::Urscript).then_some(Token::LineEnd), 1)),
        c if c.is_whitespace() => Ok((None, c.len_utf8())),
        '"' => {
            let inside = rest.get(1..).unwrap_or("");
            let end = inside.find(['"', '\n']).filter(|end| inside.as_bytes().get(*end) == Some(&b'"'));
            let Some(end) = end else {
                return Err(file.wrong(&(at..at + length(|c| c != '\n')), ProgramFinding::OpenText));
            };
            Ok((Some(Token::Text(inside.get(..end).unwrap_or("").to_owned())), end + 2))
        }
        c if c.is_ascii_digit() => number(file, at, rest),
        c if c.is_alphabetic() || c == '_' => {
            let length = length(|c| c.is_alphanumeric() || c == '_');
            // RAPID knows no case.
            let name = match language {
                Language::Rapid => prefix(length).to_ascii_uppercase(),
                _ => prefix(length).to_owned(),
            };
            Ok((Some(Token::Name(name)), length))
        }
        _ => match SIGNS.iter().find(|sign| rest.starts_with(**sign)) {
            Some(sign) => Ok((Some(Token::Sign(sign)), sign.len())),
            None => {
                let wrong = ProgramFinding::UnknownCharacter { character: first };
                Err(file.wrong(&(at..at + first.len_utf8()), wrong))
            }
        },
    }
}

fn number(file: Text<'_>, at: usize, rest: &str) -> Result<(Option<Token>, usize), Diagnostic> {
    let digits = |from: usize| {
        let tail = rest.get(from..).unwrap_or("");
        from + tail.find(|c: char| !c.is_ascii_digit()).unwrap_or(tail.len())
    };
    let mut end = digits(0);
    if rest.get(end..).is_some_and(|tail| tail.starts_with('.')) {
        end = digits(end + 1);
    }
    if rest.get(end..).is_some_and(|tail| tail.starts_with(['E', 'e'])) {
        let sign = usize::from(rest.get(end + 1..).is_some_and(|tail| tail.starts_with(['+', '-'])));
        let after = digits(end + 1 + sign);
        end = if after > end + 1 + sign { after } else { end };
    }
    let literal = rest.get(..end).unwrap_or("");
    match literal.parse::<f64>().ok().filter(|value| value.is_finite()) {
        Some(value) => Ok((Some(Token::Number(value)), end)),
        None => {
            let number = literal.to_owned();
            Err(file.wrong(&(at..at + end), ProgramFinding::NumberOutOfRange { number }))
        }
    }
}
