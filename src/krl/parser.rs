//! Reads `.src` and `.dat` files: recursive descent over lines. What it does not know it rejects,
//! with the statement and its place.

use super::lexer::{Token, line_tokens, tokens};
use super::syntax::*;
use crate::diag::Diagnostic;

/// Reads a `.src` file.
///
/// # Errors
/// The first thing that is not understood, with its line and column and what to do.
pub fn parse_source(file: &str, text: &str) -> Result<Source, Diagnostic> {
    let mut parser = Parser::new(file, text)?;
    let mut routines: Vec<Routine> = Vec::new();
    parser.skip_lines();
    while *parser.peek() != Token::End {
        let routine = parser.routine()?;
        if routines.iter().any(|other| other.name == routine.name) {
            return Err(parser.wrong(routine.span, format!("a second routine {}", routine.name)));
        }
        routines.push(routine);
        parser.skip_lines();
    }
    if routines.is_empty() {
        return Err(Diagnostic::file(file, "holds no routine").help("a .src file begins with DEF NAME ( )"));
    }
    Ok(Source { file: file.into(), text: text.into(), routines })
}

/// Reads a `.dat` file.
///
/// # Errors
/// As [`parse_source`].
pub fn parse_data(file: &str, text: &str) -> Result<Data, Diagnostic> {
    let mut parser = Parser::new(file, text)?;
    parser.skip_lines();
    parser.keyword("DEFDAT")?;
    let (name, _) = parser.name()?;
    parser.accept_name("PUBLIC");
    parser.line_end()?;
    let mut items = Vec::new();
    loop {
        parser.skip_lines();
        if parser.accept_name("ENDDAT") {
            break;
        }
        if *parser.peek() == Token::End {
            return Err(parser.unexpected("ENDDAT"));
        }
        if let Some(declaration) = parser.declaration()? {
            items.push(DataItem::Declaration(declaration));
            continue;
        }
        let target = parser.place()?;
        parser.sign("=")?;
        let value = parser.expression()?;
        parser.line_end()?;
        items.push(DataItem::Value { target, value });
    }
    parser.line_end()?;
    parser.skip_lines();
    if *parser.peek() != Token::End {
        return Err(parser.unexpected("nothing after ENDDAT"));
    }
    Ok(Data { file: file.into(), text: text.into(), name, items })
}

/// The words and where the reader stands in them.
pub(super) struct Parser<'a> {
    file: &'a str,
    pub(super) text: &'a str,
    tokens: Vec<(Token, Span)>,
    at: usize,
    /// Blocks and expressions that are open around the place.
    pub(super) depth: usize,
}

/// Deeper nesting than any program needs; the reader itself recurses.
pub(super) const DEPTH: usize = 60;

impl<'a> Parser<'a> {
    fn new(file: &'a str, text: &'a str) -> Result<Self, Diagnostic> {
        Ok(Self { file, text, tokens: tokens(file, text)?, at: 0, depth: 0 })
    }

    /// A reader of one line, at the bytes `line` of the text.
    pub(super) fn line(file: &'a str, text: &'a str, line: Span) -> Result<Self, Diagnostic> {
        let text = text.get(..line.end).unwrap_or(text);
        Ok(Self { file, text, tokens: line_tokens(file, text, line.start)?, at: 0, depth: 0 })
    }

    pub(super) fn wrong(&self, span: Span, message: impl Into<String>) -> Diagnostic {
        Diagnostic::span(self.file, self.text, span, message)
    }

    /// The word `ahead` places on; the last word stands for all after it.
    pub(super) fn ahead(&self, ahead: usize) -> &Token {
        self.tokens.get(self.at + ahead).or(self.tokens.last()).map_or(&Token::End, |(token, _)| token)
    }

    pub(super) fn peek(&self) -> &Token {
        self.ahead(0)
    }

    pub(super) fn span(&self) -> Span {
        self.tokens.get(self.at).map_or(self.text.len()..self.text.len(), |(_, span)| span.clone())
    }

    /// The end of the word read last.
    pub(super) fn end(&self) -> usize {
        self.at.checked_sub(1).and_then(|at| self.tokens.get(at)).map_or(0, |(_, span)| span.end)
    }

    pub(super) fn advance(&mut self) {
        self.at += 1;
    }

    pub(super) fn unexpected(&self, wanted: &str) -> Diagnostic {
        let found = match self.peek() {
            Token::LineEnd => "the end of the line".into(),
            Token::End => "the end of the file".into(),
            _ => format!("`{}`", self.text.get(self.span()).unwrap_or("")),
        };
        self.wrong(self.span(), format!("expected {wanted}, found {found}"))
    }

    pub(super) fn accept_sign(&mut self, sign: &str) -> bool {
        let found = matches!(self.peek(), Token::Sign(s) if *s == sign);
        if found {
            self.advance();
        }
        found
    }

    pub(super) fn sign(&mut self, sign: &str) -> Result<(), Diagnostic> {
        if self.accept_sign(sign) { Ok(()) } else { Err(self.unexpected(&format!("`{sign}`"))) }
    }

    pub(super) fn is_name(&self, name: &str) -> bool {
        matches!(self.peek(), Token::Name(n) if n == name)
    }

    pub(super) fn accept_name(&mut self, name: &str) -> bool {
        let found = self.is_name(name);
        if found {
            self.advance();
        }
        found
    }

    pub(super) fn keyword(&mut self, name: &str) -> Result<(), Diagnostic> {
        if self.accept_name(name) { Ok(()) } else { Err(self.unexpected(name)) }
    }

    pub(super) fn name(&mut self) -> Result<(String, Span), Diagnostic> {
        let Token::Name(name) = self.peek() else { return Err(self.unexpected("a name")) };
        let found = (name.clone(), self.span());
        if name.len() > 24 {
            return Err(self
                .wrong(found.1, format!("the name {name} is longer than 24 characters"))
                .help("controllers cut or refuse longer names"));
        }
        self.advance();
        Ok(found)
    }

    pub(super) fn line_end(&mut self) -> Result<(), Diagnostic> {
        match self.peek() {
            Token::LineEnd => self.advance(),
            Token::End => {}
            _ => return Err(self.unexpected("the end of the line")),
        }
        Ok(())
    }

    pub(super) fn skip_lines(&mut self) {
        while *self.peek() == Token::LineEnd {
            self.advance();
        }
    }

    /// `DEF NAME (A :IN,B :IN)` to `END`.
    fn routine(&mut self) -> Result<Routine, Diagnostic> {
        self.accept_name("GLOBAL");
        if !self.is_name("DEF") {
            return Err(self.statement_unknown("DEF NAME ( )"));
        }
        self.advance();
        let (name, span) = self.name()?;
        self.sign("(")?;
        let mut parameters = Vec::new();
        while !self.accept_sign(")") {
            if !parameters.is_empty() {
                self.sign(",")?;
            }
            parameters.push(self.name()?.0);
            self.sign(":")?;
            if !self.accept_name("IN") {
                return Err(self.unexpected("IN").help("only parameters by value (:IN) are supported"));
            }
        }
        self.line_end()?;
        let mut declarations = Vec::new();
        self.skip_lines();
        while let Some(declaration) = self.declaration()? {
            declarations.push(declaration);
            self.skip_lines();
        }
        let body = self.block(&["END"])?;
        self.keyword("END")?;
        self.line_end()?;
        Ok(Routine { name, span, parameters, declarations, body })
    }

    /// The declaration on this line, if it is one.
    pub(super) fn declaration(&mut self) -> Result<Option<Declaration>, Diagnostic> {
        let start = self.span().start;
        let before = self.at;
        self.accept_name("GLOBAL");
        let kind = if self.accept_name("EXT") {
            let (name, _) = self.name()?;
            while !matches!(self.peek(), Token::LineEnd | Token::End) {
                self.advance();
            }
            DeclarationKind::External { name }
        } else if self.accept_name("SIGNAL") {
            let (name, _) = self.name()?;
            let first = self.place()?;
            let last = if self.accept_name("TO") { Some(self.place()?) } else { None };
            DeclarationKind::Signal { name, first, last }
        } else {
            let declares = self.accept_name("DECL");
            if declares {
                self.accept_name("GLOBAL");
                self.accept_name("CONST");
            }
            let typed = matches!(self.peek(), Token::Name(name) if declares || type_of_declaration(name))
                && matches!(self.ahead(1), Token::Name(_));
            if !typed {
                if declares {
                    return Err(self.unexpected("a type and a name"));
                }
                self.at = before;
                return Ok(None);
            }
            let (type_name, _) = self.name()?;
            let mut names = vec![self.declared()?];
            while self.accept_sign(",") {
                names.push(self.declared()?);
            }
            DeclarationKind::Variables { type_name, names }
        };
        let span = start..self.end();
        self.line_end()?;
        Ok(Some(Declaration { span, kind }))
    }

    fn declared(&mut self) -> Result<Declared, Diagnostic> {
        let (name, span) = self.name()?;
        let mut elements = None;
        if self.accept_sign("[") {
            let Token::Int(count) = *self.peek() else { return Err(self.unexpected("a number of elements")) };
            elements = usize::try_from(count).ok().filter(|count| (1..=100_000).contains(count));
            if elements.is_none() {
                return Err(self.wrong(self.span(), format!("an array cannot have {count} elements")));
            }
            self.advance();
            if self.accept_sign(",") {
                return Err(self.wrong(span, "arrays of more than one dimension are not supported"));
            }
            self.sign("]")?;
        }
        let value = if self.accept_sign("=") { Some(self.expression()?) } else { None };
        Ok(Declared { name, elements, value, span })
    }
}
