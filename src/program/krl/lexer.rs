//! Words of KRL: names (in capitals), numbers, signs, ends of lines. Comments, folds and `&` lines carry no program;
//! that folds are balanced is checked here.

use super::syntax::{Span, Text};
use crate::catalogue::ProgramFinding;
use crate::diagnostic::Diagnostic;

#[derive(Clone, Debug, PartialEq)]
pub(super) enum Token {
    /// A name or keyword, in capitals.
    Name(String),
    /// `#NAME`, in capitals.
    Enum(String),
    Int(i64),
    Real(f64),
    Text(String),
    /// Brackets, operators, `,` `:` `.`
    Sign(&'static str),
    LineEnd,
    End,
}

/// Signs, the longer before those that they begin with.
const SIGNS: &[&str] =
    &["==", "<>", "<=", ">=", "(", ")", "{", "}", "[", "]", ",", ":", ".", "=", "<", ">", "+", "-", "*", "/"];

/// Splits a text into words with their bytes; the last is [`Token::End`].
pub(super) fn tokens(file: Text<'_>) -> Result<Vec<(Token, Span)>, Diagnostic> {
    // The DOS end-of-file mark of old controllers.
    let text = file.text.strip_suffix('\u{1a}').unwrap_or(file.text);
    let mut lexer = Lexer { file: Text { text, ..file }, at: 0, tokens: Vec::new(), folds: Vec::new() };
    if text.starts_with('\u{feff}') {
        return Err(lexer.wrong(0..3, ProgramFinding::ByteOrderMark));
    }
    lexer.all()?;
    if let Some(span) = lexer.folds.pop() {
        return Err(lexer.wrong(span, ProgramFinding::FoldNotClosed));
    }
    Ok(lexer.ended())
}

/// As [`tokens`], for the line that begins at the byte `start` and ends with the text; folds are not checked.
pub(super) fn line_tokens(file: Text<'_>, start: usize) -> Result<Vec<(Token, Span)>, Diagnostic> {
    let mut lexer = Lexer { file, at: start, tokens: Vec::with_capacity(64), folds: Vec::new() };
    lexer.all()?;
    Ok(lexer.ended())
}

struct Lexer<'a> {
    file: Text<'a>,
    at: usize,
    tokens: Vec<(Token, Span)>,
    folds: Vec<Span>,
}

impl<'a> Lexer<'a> {
    fn all(&mut self) -> Result<(), Diagnostic> {
        while self.at < self.file.text.len() {
            self.next()?;
        }
        Ok(())
    }

    fn ended(mut self) -> Vec<(Token, Span)> {
        let end = self.file.text.len()..self.file.text.len();
        self.tokens.extend([(Token::LineEnd, end.clone()), (Token::End, end)]);
        self.tokens
    }

    fn wrong(&self, span: Span, finding: ProgramFinding) -> Diagnostic {
        self.file.wrong(&span, finding)
    }

    fn rest(&self) -> &'a str {
        self.file.text.get(self.at..).unwrap_or("")
    }

    /// The longest prefix of `text` whose characters all satisfy `accepted`.
    fn prefix(text: &str, accepted: impl Fn(char) -> bool) -> &str {
        let end = text.find(|c| !accepted(c)).unwrap_or(text.len());
        text.get(..end).unwrap_or("")
    }

    fn push(&mut self, token: Token, length: usize) {
        self.tokens.push((token, self.at..self.at + length));
        self.at += length;
    }

    fn next(&mut self) -> Result<(), Diagnostic> {
        let rest = self.rest();
        let Some(first) = rest.chars().next() else { return Ok(()) };
        // Only where it is needed: a line may be long.
        let line = || Self::prefix(rest, |c| c != '\n');
        let starts_line = matches!(self.tokens.last(), None | Some((Token::LineEnd, _)));
        match first {
            '\n' => self.push(Token::LineEnd, 1),
            ' ' | '\t' | '\r' => self.at += 1,
            ';' => self.comment(line())?,
            '&' if starts_line => self.at += line().len(),
            '"' => {
                let line = line();
                let inside = line.get(1..).unwrap_or("");
                let Some(length) = inside.find('"') else {
                    return Err(self.wrong(self.at..self.at + line.len(), ProgramFinding::OpenText));
                };
                self.push(Token::Text(inside.get(..length).unwrap_or("").to_owned()), length + 2);
            }
            '\'' => self.based(line())?,
            '#' => {
                let name = Self::prefix(rest.get(1..).unwrap_or(""), name_character);
                self.push(Token::Enum(name.to_ascii_uppercase()), name.len() + 1);
            }
            c if c.is_ascii_digit() => self.number(rest)?,
            c if name_character(c) => {
                let name = Self::prefix(rest, name_character);
                self.push(Token::Name(name.to_ascii_uppercase()), name.len());
            }
            c => match SIGNS.iter().find(|sign| rest.starts_with(**sign)) {
                Some(sign) => self.push(Token::Sign(sign), sign.len()),
                None => {
                    let unknown = ProgramFinding::UnknownCharacter { character: c };
                    return Err(self.wrong(self.at..self.at + c.len_utf8(), unknown));
                }
            },
        }
        Ok(())
    }

    fn comment(&mut self, line: &str) -> Result<(), Diagnostic> {
        let span = self.at..self.at + line.trim_end().len();
        let word = Self::prefix(line.get(1..).unwrap_or("").trim_start(), |c| c.is_ascii_alphabetic());
        if word.eq_ignore_ascii_case("FOLD") {
            self.folds.push(span);
        } else if word.eq_ignore_ascii_case("ENDFOLD") && self.folds.pop().is_none() {
            return Err(self.wrong(span, ProgramFinding::FoldNotOpen));
        }
        self.at += line.len();
        Ok(())
    }

    /// `'B0101'` and `'HFF'`.
    fn based(&mut self, line: &str) -> Result<(), Diagnostic> {
        let inside = line.get(1..).unwrap_or("");
        let length = inside.find('\'').unwrap_or(inside.len());
        let literal = inside.get(..length).unwrap_or("");
        let radix = match literal.chars().next() {
            Some('B' | 'b') => Some(2),
            Some('H' | 'h') => Some(16),
            _ => None,
        };
        let digits = literal.get(1..).filter(|digits| !digits.starts_with(['+', '-']));
        // The 32 bits of an INT as they are: the highest is its sign.
        let bits = radix.zip(digits).and_then(|(radix, digits)| u32::from_str_radix(digits, radix).ok());
        let value = bits.map(|bits| i64::from(bits.cast_signed()));
        match value {
            Some(value) if length < inside.len() => {
                self.push(Token::Int(value), length + 2);
                Ok(())
            }
            _ => Err(self.wrong(self.at..self.at + 1 + length, ProgramFinding::NotBinaryOrHexadecimal)),
        }
    }

    fn number(&mut self, rest: &str) -> Result<(), Diagnostic> {
        let digits = |text: &str| Self::prefix(text, |c| c.is_ascii_digit()).len();
        let mut length = digits(rest);
        let tail = rest.get(length..).unwrap_or("");
        let mut real = false;
        if let Some(fraction) = tail.strip_prefix('.') {
            real = true;
            length += 1 + digits(fraction);
        }
        let tail = rest.get(length..).unwrap_or("");
        if tail.starts_with(['E', 'e']) {
            let exponent = tail.get(1..).unwrap_or("");
            let sign = usize::from(exponent.starts_with(['+', '-']));
            let count = digits(exponent.get(sign..).unwrap_or(""));
            if count > 0 {
                real = true;
                length += 1 + sign + count;
            }
        }
        let literal = rest.get(..length).unwrap_or("");
        let token = if real {
            literal.parse().ok().filter(|value: &f64| value.is_finite()).map(Token::Real)
        } else {
            // The lowest INT is written as the negative of one more than the highest.
            literal.parse().ok().filter(|value: &i64| *value <= 1 << 31).map(Token::Int)
        };
        let Some(token) = token else {
            let number = literal.to_owned();
            return Err(self.wrong(self.at..self.at + length, ProgramFinding::NumberOutOfRange { number }));
        };
        self.push(token, length);
        Ok(())
    }
}

fn name_character(c: char) -> bool {
    c.is_ascii_alphanumeric() || c == '_' || c == '$'
}
