//! The tokens of a program with the position of its parser.

use super::Language;
use super::lexer::{Token, line_tokens, tokens};
use super::text::{Span, Text};
use crate::program::ProgramFinding;
use dbbd_model::diagnostic::Diagnostic;

pub(super) struct Tokens<'a> {
    pub(super) file: Text<'a>,
    tokens: Vec<(Token, Span)>,
    at: usize,
}

impl<'a> Tokens<'a> {
    pub(super) fn new(file: Text<'a>, language: Language) -> Result<Self, Diagnostic> {
        Ok(Self { file, tokens: tokens(file, language)?, at: 0 })
    }

    /// The tokens of one line of KRL; their spans are bytes of the file.
    pub(super) fn of_line(file: Text<'a>, line: &Span) -> Result<Self, Diagnostic> {
        let file = Text { text: file.text.get(..line.end).unwrap_or(file.text), ..file };
        Ok(Self { file, tokens: line_tokens(file, line.start)?, at: 0 })
    }

    /// The token after `count` others; after the end it is [`Token::End`].
    pub(super) fn ahead(&self, count: usize) -> &Token {
        self.tokens.get(self.at + count).map_or(&Token::End, |(token, _)| token)
    }

    /// The next token.
    pub(super) fn peek(&self) -> &Token {
        self.ahead(0)
    }

    /// The bytes of the next token.
    pub(super) fn span(&self) -> Span {
        self.tokens.get(self.at).map_or(self.file.text.len()..self.file.text.len(), |(_, span)| span.clone())
    }

    /// The byte after the last token that was read.
    pub(super) fn end(&self) -> usize {
        self.at.checked_sub(1).and_then(|at| self.tokens.get(at)).map_or(0, |(_, span)| span.end)
    }

    /// Whether only the end of the line follows.
    pub(super) fn is_line_end(&self) -> bool {
        matches!(self.peek(), Token::LineEnd | Token::End)
    }

    pub(super) fn advance(&mut self) {
        self.at = (self.at + 1).min(self.tokens.len());
    }

    pub(super) fn next(&mut self) -> Token {
        let token = self.peek().clone();
        self.advance();
        token
    }

    /// Number of tokens that were read: for [`Tokens::go_to`] and [`Tokens::since`].
    pub(super) fn position(&self) -> usize {
        self.at
    }

    pub(super) fn go_to(&mut self, position: usize) {
        self.at = position;
    }

    /// The bytes from a position to the end of the last token that was read.
    pub(super) fn since(&self, position: usize) -> Span {
        let start = self.tokens.get(position).map_or(0, |(_, span)| span.start);
        start..self.end().max(start)
    }

    /// Whether the last token that was read is this name or keyword.
    pub(super) fn has_read_name(&self, name: &str) -> bool {
        let last = self.at.checked_sub(1).and_then(|at| self.tokens.get(at));
        matches!(last, Some((Token::Name(last), _)) if last.eq_ignore_ascii_case(name))
    }

    /// The names of what is called between a position and the last token that was read: names after which a bracket
    /// opens. Methods of an object (`object.name(..)`) are not among them.
    pub(super) fn called_since(&self, position: usize) -> Vec<String> {
        let mut called = Vec::new();
        for at in position..self.at.saturating_sub(1) {
            let token = |at: usize| self.tokens.get(at).map(|(token, _)| token);
            if let (Some(Token::Name(name)), Some(Token::Sign("("))) = (token(at), token(at + 1))
                && (at == position || !matches!(token(at - 1), Some(Token::Sign("."))))
            {
                called.push(name.clone());
            }
        }
        called
    }

    /// Reads a sign if it is the next token.
    pub(super) fn accept(&mut self, sign: &str) -> bool {
        let is_next = matches!(self.peek(), Token::Sign(next) if *next == sign);
        self.at += usize::from(is_next);
        is_next
    }

    pub(super) fn expect(&mut self, sign: &str) -> Result<(), Diagnostic> {
        if self.accept(sign) { Ok(()) } else { Err(self.expected(&format!("`{sign}`"))) }
    }

    /// Whether the next token is this name or keyword, in any case of its letters.
    pub(super) fn is_name(&self, name: &str) -> bool {
        matches!(self.peek(), Token::Name(next) if next.eq_ignore_ascii_case(name))
    }

    /// Reads a name or keyword if it is the next token.
    pub(super) fn accept_name(&mut self, name: &str) -> bool {
        let is_next = self.is_name(name);
        self.at += usize::from(is_next);
        is_next
    }

    pub(super) fn expect_name(&mut self, name: &str) -> Result<(), Diagnostic> {
        if self.accept_name(name) { Ok(()) } else { Err(self.expected(name)) }
    }

    pub(super) fn name(&mut self) -> Result<(String, Span), Diagnostic> {
        let Token::Name(name) = self.peek() else { return Err(self.expected("a name")) };
        let name = (name.clone(), self.span());
        self.advance();
        Ok(name)
    }

    pub(super) fn wrong(&self, span: Span, finding: ProgramFinding) -> Diagnostic {
        self.file.wrong(&span, finding)
    }

    /// The finding that something else was expected than the next token.
    pub(super) fn expected(&self, what: &str) -> Diagnostic {
        let found = match self.peek() {
            Token::LineEnd => "the end of the line".into(),
            Token::End => "the end of the file".into(),
            Token::Name(_)
            | Token::Enum(_)
            | Token::Int(_)
            | Token::Real(_)
            | Token::Text(_)
            | Token::Sign(_) => format!("`{}`", self.file.text.get(self.span()).unwrap_or("")),
        };
        self.wrong(self.span(), ProgramFinding::Expected { expected: what.into(), found })
    }
}
