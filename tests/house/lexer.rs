//! Cuts Rust source text into tokens. Comments and white space are dropped, so that the words of a comment, a string or a
//! character never count as code.

use std::iter::Peekable;
use std::str::CharIndices;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TokenKind {
    /// An identifier or keyword, also a raw one.
    Word,
    Number,
    /// A string of any kind.
    Text,
    /// A character or a byte.
    Character,
    Lifetime,
    /// `::`, `->`, `=>` or a single sign.
    Sign,
}

#[derive(Clone, Debug)]
pub(crate) struct Token {
    pub(crate) kind: TokenKind,
    pub(crate) text: String,
    /// Of its first character, from 1.
    pub(crate) line: usize,
    /// Of its last character.
    pub(crate) last_line: usize,
}

impl Token {
    pub(crate) fn is(&self, text: &str) -> bool {
        self.text == text
    }

    pub(crate) fn is_word(&self) -> bool {
        self.kind == TokenKind::Word
    }
}

/// The tokens of a source text.
pub(crate) fn tokens(source: &str) -> Vec<Token> {
    let mut lexer = Lexer { source, chars: source.char_indices().peekable() };
    let mut found: Vec<Token> = Vec::new();
    let (mut line, mut counted) = (1, 0);
    while let Some((start, kind)) = lexer.next_kind() {
        let end = lexer.position();
        line += source[counted..start].matches('\n').count();
        let last_line = line + source[start..end].matches('\n').count();
        counted = end;
        if let Some(kind) = kind {
            found.push(Token { kind, text: source[start..end].to_owned(), line, last_line });
        }
        line = last_line;
    }
    found
}

struct Lexer<'s> {
    source: &'s str,
    chars: Peekable<CharIndices<'s>>,
}

impl Lexer<'_> {
    fn position(&mut self) -> usize {
        self.chars.peek().map_or(self.source.len(), |(at, _)| *at)
    }

    fn rest(&mut self) -> &str {
        let at = self.position();
        &self.source[at..]
    }

    fn skip(&mut self, characters: usize) {
        for _ in 0..characters {
            self.chars.next();
        }
    }

    fn skip_while(&mut self, wanted: impl Fn(char) -> bool) {
        while self.chars.next_if(|(_, c)| wanted(*c)).is_some() {}
    }

    /// Passes the next token, comment or white space; gives its start, and its kind if it is a token.
    fn next_kind(&mut self) -> Option<(usize, Option<TokenKind>)> {
        let start = self.position();
        let (_, first) = *self.chars.peek()?;
        if first.is_whitespace() {
            self.skip_while(char::is_whitespace);
            return Some((start, None));
        }
        if self.rest().starts_with("//") {
            self.skip_while(|c| c != '\n');
            return Some((start, None));
        }
        if self.rest().starts_with("/*") {
            self.block_comment();
            return Some((start, None));
        }
        let kind = if let Some((prefix, hashes)) = raw_string(self.rest()) {
            self.skip(prefix);
            self.raw_string_end(hashes);
            TokenKind::Text
        } else if let Some(prefix) =
            ["\"", "b\"", "c\""].iter().find(|prefix| self.rest().starts_with(**prefix))
        {
            self.skip(prefix.len());
            self.quoted_end('"');
            TokenKind::Text
        } else if self.rest().starts_with("b'") {
            self.skip(2);
            self.quoted_end('\'');
            TokenKind::Character
        } else if first == '\'' {
            self.character_or_lifetime()
        } else if first.is_alphabetic() || first == '_' {
            self.word();
            TokenKind::Word
        } else if first.is_ascii_digit() {
            self.number();
            TokenKind::Number
        } else {
            let double = ["::", "->", "=>"].iter().any(|sign| self.rest().starts_with(sign));
            self.skip(if double { 2 } else { 1 });
            TokenKind::Sign
        };
        Some((start, Some(kind)))
    }

    /// Block comments nest.
    fn block_comment(&mut self) {
        let mut depth = 0;
        loop {
            if self.rest().starts_with("/*") {
                depth += 1;
                self.skip(2);
            } else if self.rest().starts_with("*/") {
                depth -= 1;
                self.skip(2);
            } else if self.chars.next().is_none() {
                return;
            }
            if depth == 0 {
                return;
            }
        }
    }

    fn quoted_end(&mut self, quote: char) {
        while let Some((_, c)) = self.chars.next() {
            if c == '\\' {
                self.chars.next();
            } else if c == quote {
                return;
            }
        }
    }

    fn raw_string_end(&mut self, hashes: usize) {
        let end = format!("\"{}", "#".repeat(hashes));
        while !self.rest().starts_with(&end) && self.chars.next().is_some() {}
        self.skip(end.len());
    }

    /// `'a'` is a character, `'a` a lifetime; `'\''` begins with a backslash.
    fn character_or_lifetime(&mut self) -> TokenKind {
        self.skip(1);
        let mut ahead = self.rest().chars();
        let (inside, after) = (ahead.next(), ahead.next());
        if inside == Some('\\') || after == Some('\'') {
            self.quoted_end('\'');
            TokenKind::Character
        } else {
            self.word();
            TokenKind::Lifetime
        }
    }

    fn word(&mut self) {
        if self.rest().starts_with("r#") {
            self.skip(2);
        }
        self.skip_while(|c| c.is_alphanumeric() || c == '_');
    }

    /// The point of `1.5` and of `1.` belongs to the number, that of `1..2` and `1.max(2)` does not.
    fn number(&mut self) {
        let is_decimal = !["0x", "0b", "0o"].iter().any(|prefix| self.rest().starts_with(prefix));
        self.digits(is_decimal);
        let mut ahead = self.rest().chars();
        let (point, after) = (ahead.next(), ahead.next());
        if point == Some('.') && !after.is_some_and(|c| c == '.' || c == '_' || c.is_alphabetic()) {
            self.skip(1);
            self.digits(is_decimal);
        }
    }

    /// Digits with suffix; the sign of a decimal exponent belongs to them.
    fn digits(&mut self, is_decimal: bool) {
        self.skip_while(|c| c.is_alphanumeric() || c == '_');
        let at = self.position();
        let is_exponent = is_decimal && self.source[..at].ends_with(['e', 'E']);
        if is_exponent && self.rest().starts_with(['-', '+']) {
            self.skip(1);
            self.skip_while(|c| c.is_alphanumeric() || c == '_');
        }
    }
}

/// The number of characters up to and with the quote that opens a raw string, and of its hashes.
fn raw_string(rest: &str) -> Option<(usize, usize)> {
    let prefix = ["r", "br", "cr"].into_iter().find(|prefix| {
        rest.strip_prefix(prefix).is_some_and(|rest| rest.trim_start_matches('#').starts_with('"'))
    })?;
    let hashes = rest[prefix.len()..].find('"')?;
    Some((prefix.len() + hashes + 1, hashes))
}

#[cfg(test)]
mod tests {
    use super::{TokenKind, tokens};

    fn texts(source: &str) -> Vec<String> {
        tokens(source).into_iter().map(|token| token.text).collect()
    }

    #[test]
    fn comments_are_dropped_and_nest() {
        assert_eq!(texts("a /* b /* c */ d */ e // f\ng"), ["a", "e", "g"]);
    }

    #[test]
    fn strings_are_one_token() {
        let source = r####"f("a \" // b", r"\", r#"c " d"#, b"e\\", br##"g"#"##, r#type)"####;
        let strings = [r#""a \" // b""#, r#"r"\""#, r##"r#"c " d"#"##, r#"b"e\\""#, r###"br##"g"#"##"###];
        let found: Vec<String> = tokens(source)
            .into_iter()
            .filter(|token| token.kind == TokenKind::Text)
            .map(|token| token.text)
            .collect();
        assert_eq!(found, strings);
        assert!(texts(source).contains(&"r#type".to_owned()));
    }

    #[test]
    fn lifetimes_are_no_characters() {
        let kinds: Vec<_> =
            tokens(r#"'a 'b' '\'' b'\\' '_ 'static '"' '°'"#).iter().map(|t| t.kind).collect();
        use TokenKind::{Character, Lifetime};
        assert_eq!(
            kinds,
            [Lifetime, Character, Character, Character, Lifetime, Lifetime, Character, Character]
        );
    }

    #[test]
    fn numbers_end_where_they_end() {
        assert_eq!(
            texts("1.5e-3-2. 0..3 1.max 0x1e-1"),
            ["1.5e-3", "-", "2.", "0", ".", ".", "3", "1", ".", "max", "0x1e", "-", "1"]
        );
    }

    #[test]
    fn lines_are_counted_through_comments_and_strings() {
        let found = tokens("a /*\n*/ \"\n\" b\n  c");
        let lines: Vec<_> = found.iter().map(|token| (token.line, token.last_line)).collect();
        assert_eq!(lines, [(1, 1), (2, 3), (3, 3), (4, 4)]);
    }
}
