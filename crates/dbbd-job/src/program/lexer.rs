//! Splits the text of a program into tokens. Comments are skipped, but the folds of KRL, which are comments, must be balanced.

use super::Language;
use super::text::{Span, Text};
use crate::program::ProgramFinding;
use dbbd_model::diagnostic::Diagnostic;

#[derive(Clone, Debug, PartialEq)]
pub(super) enum Token {
    /// A name or keyword; in capitals in KRL, RAPID and TP programs, which ignore case.
    Name(String),
    /// `#NAME` of KRL, in capitals.
    Enum(String),
    /// A whole number of KRL. The other languages have one type of number: [`Token::Real`].
    Int(i64),
    Real(f64),
    Text(String),
    /// A bracket, operator or separator.
    Sign(&'static str),
    /// The end of a line, in the languages that end statements by lines: KRL and URScript.
    LineEnd,
    End,
}

/// The signs of KRL. If one sign begins with another one, the longer sign is first.
const KRL_SIGNS: &[&str] =
    &["==", "<>", "<=", ">=", "(", ")", "{", "}", "[", "]", ",", ":", ".", "=", "<", ">", "+", "-", "*", "/"];
const SCRIPT_SIGNS: &[&str] = &[
    ":=", "<>", "<=", ">=", "==", "!=", "(", ")", "{", "}", "[", "]", ",", ";", ":", ".", "\\", "=", "<",
    ">", "+", "-", "*", "/", "%", "?", "@", "|",
];

/// The tokens of a file, each with its bytes; the last one is [`Token::End`].
pub(super) fn tokens(file: Text<'_>, language: Language) -> Result<Vec<(Token, Span)>, Diagnostic> {
    let text = match language {
        // Old KUKA controllers end a file with the end-of-file mark of DOS.
        Language::Krl => file.text.strip_suffix('\u{1a}').unwrap_or(file.text),
        Language::Rapid | Language::Urscript | Language::Fanuc => file.text,
    };
    if text.starts_with('\u{feff}') {
        return Err(file.wrong(&(0..3), ProgramFinding::ByteOrderMark));
    }
    let mut lexer = Lexer {
        file: Text { text, ..file },
        language,
        at: 0,
        tokens: Vec::new(),
        folds: Vec::new(),
        brackets: 0,
    };
    lexer.run()?;
    match lexer.folds.pop() {
        Some(span) => Err(lexer.wrong(span, ProgramFinding::FoldNotClosed)),
        None => Ok(lexer.tokens),
    }
}

/// The same as [`tokens`], for the last line of a KRL text, which begins at the byte `start`. Folds are not checked.
pub(super) fn line_tokens(file: Text<'_>, start: usize) -> Result<Vec<(Token, Span)>, Diagnostic> {
    let tokens = Vec::with_capacity(64);
    let mut lexer =
        Lexer { file, language: Language::Krl, at: start, tokens, folds: Vec::new(), brackets: 0 };
    lexer.run()?;
    Ok(lexer.tokens)
}

struct Lexer<'a> {
    file: Text<'a>,
    language: Language,
    at: usize,
    tokens: Vec<(Token, Span)>,
    /// The folds that are open.
    folds: Vec<Span>,
    /// Number of open brackets: in URScript a statement goes on inside brackets.
    brackets: usize,
}

/// The longest prefix of a text whose characters are all accepted.
fn prefix(text: &str, accepted: impl Fn(char) -> bool) -> &str {
    let end = text.find(|c| !accepted(c)).unwrap_or(text.len());
    text.get(..end).unwrap_or("")
}

/// The text after its first byte, which is an ASCII character.
fn after_first(text: &str) -> &str {
    text.get(1..).unwrap_or("")
}

impl<'a> Lexer<'a> {
    fn run(&mut self) -> Result<(), Diagnostic> {
        while let Some(rest) = self.file.text.get(self.at..)
            && let Some(first) = rest.chars().next()
        {
            self.next(first, rest)?;
        }
        let end = self.at..self.at;
        self.tokens.extend([(Token::LineEnd, end.clone()), (Token::End, end)]);
        Ok(())
    }

    fn wrong(&self, span: Span, finding: ProgramFinding) -> Diagnostic {
        self.file.wrong(&span, finding)
    }

    fn push(&mut self, token: Token, length: usize) {
        self.tokens.push((token, self.at..self.at + length));
        self.at += length;
    }

    fn next(&mut self, first: char, rest: &'a str) -> Result<(), Diagnostic> {
        // A line may be long: its end is only searched where it is needed.
        let line = || prefix(rest, |c| c != '\n');
        let is_krl = self.language == Language::Krl;
        let starts_line = matches!(self.tokens.last(), None | Some((Token::LineEnd, _)));
        match first {
            // Checked before the signs: `!` begins a comment of RAPID, and `!=` is an operator of URScript.
            c if c == self.language.comment() => {
                if is_krl {
                    self.fold(line())?;
                }
                self.at += line().len();
            }
            '\n' if self.goes_on(after_first(rest)) => self.at += 1,
            '\n' => {
                self.brackets = 0;
                self.push(Token::LineEnd, 1);
            }
            // PolyScope notes here the node of the program tree to which the next lines belong.
            '$' if self.language == Language::Urscript && starts_line => self.at += line().len(),
            ' ' | '\t' | '\r' => self.at += 1,
            c if !is_krl && c.is_whitespace() => self.at += c.len_utf8(),
            '&' if is_krl && starts_line => self.at += line().len(),
            '"' => self.text(line(), '"')?,
            '\'' if is_krl => self.based_number(line())?,
            '\'' if self.language == Language::Fanuc => self.text(line(), '\'')?,
            '#' if is_krl => {
                let name = prefix(after_first(rest), |c| self.is_in_name(c));
                self.push(Token::Enum(name.to_ascii_uppercase()), name.len() + 1);
            }
            c if c.is_ascii_digit() => self.number(rest)?,
            // PolyScope writes `.5`; no component of a structure begins with a digit.
            '.' if !is_krl && after_first(rest).starts_with(|c: char| c.is_ascii_digit()) => {
                self.number(rest)?
            }
            c if self.is_in_name(c) && !c.is_numeric() => {
                let name = prefix(rest, |c| self.is_in_name(c));
                let is_case_kept = self.language == Language::Urscript;
                let token = if is_case_kept { name.to_owned() } else { name.to_ascii_uppercase() };
                self.push(Token::Name(token), name.len());
            }
            character => {
                let signs = if is_krl { KRL_SIGNS } else { SCRIPT_SIGNS };
                let Some(sign) = signs.iter().find(|sign| rest.starts_with(**sign)) else {
                    let span = self.at..self.at + character.len_utf8();
                    let language = self.language.title();
                    return Err(self.wrong(span, ProgramFinding::UnknownCharacter { character, language }));
                };
                match *sign {
                    "(" | "[" => self.brackets += 1,
                    ")" | "]" => self.brackets = self.brackets.saturating_sub(1),
                    _ => {}
                }
                self.push(Token::Sign(sign), sign.len());
            }
        }
        Ok(())
    }

    /// Whether a statement goes on in the next line. An open bracket is given up at a keyword that begins a line.
    fn goes_on(&self, next: &str) -> bool {
        const BEGIN: [&str; 10] =
            ["def", "end", "thread", "while", "if", "elif", "else", "return", "global", "local"];
        match self.language {
            Language::Krl => false,
            Language::Rapid | Language::Fanuc => true,
            Language::Urscript => {
                let word = prefix(next.trim_start(), |c| self.is_in_name(c));
                self.brackets > 0 && !BEGIN.contains(&word)
            }
        }
    }

    fn is_in_name(&self, c: char) -> bool {
        match self.language {
            Language::Krl | Language::Fanuc => c.is_ascii_alphanumeric() || c == '_' || c == '$',
            Language::Rapid | Language::Urscript => c.is_alphanumeric() || c == '_',
        }
    }

    /// Opens or closes a fold if the comment says so.
    fn fold(&mut self, comment: &str) -> Result<(), Diagnostic> {
        let span = self.at..self.at + comment.trim_end().len();
        let word = prefix(after_first(comment).trim_start(), |c| c.is_ascii_alphabetic());
        if word.eq_ignore_ascii_case("FOLD") {
            self.folds.push(span);
        } else if word.eq_ignore_ascii_case("ENDFOLD") && self.folds.pop().is_none() {
            return Err(self.wrong(span, ProgramFinding::FoldNotOpen));
        }
        Ok(())
    }

    /// `"text"`, which ends on its line.
    fn text(&mut self, line: &str, quote: char) -> Result<(), Diagnostic> {
        let Some((text, _)) = after_first(line).split_once(quote) else {
            return Err(self.wrong(self.at..self.at + line.len(), ProgramFinding::OpenText));
        };
        self.push(Token::Text(text.to_owned()), text.len() + 2);
        Ok(())
    }

    /// `'B0101'` and `'HFF'` of KRL.
    fn based_number(&mut self, line: &str) -> Result<(), Diagnostic> {
        let inside = after_first(line);
        let (literal, is_closed) =
            inside.split_once('\'').map_or((inside, false), |(literal, _)| (literal, true));
        let radix = match literal.as_bytes().first() {
            Some(b'B' | b'b') => Some(2),
            Some(b'H' | b'h') => Some(16),
            _ => None,
        };
        let digits = literal.get(1..).filter(|digits| !digits.starts_with(['+', '-']));
        let bits = radix.zip(digits).and_then(|(radix, digits)| u32::from_str_radix(digits, radix).ok());
        let Some(bits) = bits.filter(|_| is_closed) else {
            let span = self.at..self.at + 1 + literal.len();
            return Err(self.wrong(span, ProgramFinding::NotBinaryOrHexadecimal));
        };
        // The 32 bits of an INT: the highest is its sign.
        self.push(Token::Int(i64::from(bits.cast_signed())), literal.len() + 2);
        Ok(())
    }

    fn number(&mut self, rest: &str) -> Result<(), Diagnostic> {
        let tail = |from: usize| rest.get(from..).unwrap_or("");
        let digits_end = |from: usize| from + prefix(tail(from), |c| c.is_ascii_digit()).len();
        let whole_end = digits_end(0);
        let mut end = whole_end;
        if tail(end).starts_with('.') {
            end = digits_end(end + 1);
        }
        if tail(end).starts_with(['E', 'e']) {
            let digits = end + 1 + usize::from(tail(end + 1).starts_with(['+', '-']));
            end = if digits_end(digits) > digits { digits_end(digits) } else { end };
        }
        let literal = rest.get(..end).unwrap_or("");
        let token = if self.language == Language::Krl && end == whole_end {
            // The lowest INT is written as the negative of one more than the highest.
            literal.parse().ok().filter(|value: &i64| *value <= 1 << 31).map(Token::Int)
        } else {
            literal.parse().ok().filter(|value: &f64| value.is_finite()).map(Token::Real)
        };
        let Some(token) = token else {
            let number = literal.to_owned();
            return Err(self.wrong(self.at..self.at + end, ProgramFinding::NumberOutOfRange { number }));
        };
        self.push(token, end);
        Ok(())
    }
}
