//! Reads `.src` and `.dat` files: recursive descent over lines. What it does not know it refuses, with the statement
//! and its place.

use super::lexer::{Token, line_tokens, tokens};
use super::syntax::*;
use super::value::Type;
use crate::catalogue::ProgramFinding;
use crate::diagnostic::Diagnostic;

pub fn parse_source(file: &str, text: &str) -> Result<Source, Diagnostic> {
    let mut parser = Parser::new(Text { file, text })?;
    let mut routines: Vec<Routine> = Vec::new();
    parser.skip_lines();
    while *parser.peek() != Token::End {
        let routine = parser.routine()?;
        if routines.iter().any(|other| other.name == routine.name) {
            return Err(parser.wrong(routine.span, ProgramFinding::SecondRoutine { name: routine.name }));
        }
        routines.push(routine);
        parser.skip_lines();
    }
    if routines.is_empty() {
        return Err(Diagnostic::file(file, ProgramFinding::NoRoutine));
    }
    Ok(Source { file: file.into(), text: text.into(), routines })
}

pub fn parse_data(file: &str, text: &str) -> Result<Data, Diagnostic> {
    let mut parser = Parser::new(Text { file, text })?;
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
        items.push(parser.data_item()?);
    }
    parser.line_end()?;
    parser.skip_lines();
    if *parser.peek() != Token::End {
        return Err(parser.unexpected("nothing after ENDDAT"));
    }
    Ok(Data { file: file.into(), text: text.into(), name, items })
}

/// The words of a text, and the place of the reader in them.
pub(super) struct Parser<'a> {
    pub(super) file: Text<'a>,
    tokens: Vec<(Token, Span)>,
    at: usize,
    /// Blocks and expressions that are open around the place.
    depth: usize,
    /// Of the line so far.
    operators: usize,
    /// Numbers in the arrays that were declared so far.
    numbers: usize,
}

/// Deeper nesting than any program needs: the reader recurses.
const DEPTH: usize = 60;
/// Of one line: a chain of them is a tree that is as deep.
const OPERATORS: usize = 200;
/// In all arrays of a file; an E6POS has 14.
const NUMBERS: usize = 200_000;

impl<'a> Parser<'a> {
    fn new(file: Text<'a>) -> Result<Self, Diagnostic> {
        Ok(Self { file, tokens: tokens(file)?, at: 0, depth: 0, operators: 0, numbers: 0 })
    }

    /// A reader of one line, at the bytes `line` of the text.
    pub(super) fn line(file: Text<'a>, line: &Span) -> Result<Self, Diagnostic> {
        let file = Text { text: file.text.get(..line.end).unwrap_or(file.text), ..file };
        Ok(Self { file, tokens: line_tokens(file, line.start)?, at: 0, depth: 0, operators: 0, numbers: 0 })
    }

    pub(super) fn wrong(&self, span: Span, finding: ProgramFinding) -> Diagnostic {
        self.file.wrong(&span, finding)
    }

    /// Reads something that may hold others of its kind.
    pub(super) fn nested<T>(
        &mut self,
        read: impl FnOnce(&mut Self) -> Result<T, Diagnostic>,
    ) -> Result<T, Diagnostic> {
        self.depth += 1;
        if self.depth > DEPTH {
            return Err(self.wrong(self.span(), ProgramFinding::NestedTooDeeply { most: DEPTH }));
        }
        let found = read(self)?;
        self.depth -= 1;
        Ok(found)
    }

    /// Counts an operator.
    pub(super) fn operator(&mut self) -> Result<(), Diagnostic> {
        self.operators += 1;
        if self.operators > OPERATORS {
            return Err(self.wrong(self.span(), ProgramFinding::TooManyOperators { most: OPERATORS }));
        }
        self.advance();
        Ok(())
    }

    /// The word `ahead` places on; the last word is repeated after the end.
    pub(super) fn ahead(&self, ahead: usize) -> &Token {
        self.tokens.get(self.at + ahead).or(self.tokens.last()).map_or(&Token::End, |(token, _)| token)
    }

    pub(super) fn peek(&self) -> &Token {
        self.ahead(0)
    }

    pub(super) fn span(&self) -> Span {
        self.tokens.get(self.at).map_or(self.file.text.len()..self.file.text.len(), |(_, span)| span.clone())
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
            _ => format!("`{}`", self.file.text.get(self.span()).unwrap_or("")),
        };
        self.wrong(self.span(), ProgramFinding::Expected { expected: wanted.into(), found })
    }

    pub(super) fn unsupported(&self, span: Span, what: impl Into<String>, instead: &str) -> Diagnostic {
        self.wrong(span, ProgramFinding::Unsupported { what: what.into(), instead: instead.into() })
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
            return Err(self.wrong(found.1, ProgramFinding::LongName { name: found.0 }));
        }
        self.advance();
        Ok(found)
    }

    pub(super) fn line_end(&mut self) -> Result<(), Diagnostic> {
        self.operators = 0;
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
                let instead = "only parameters by value (:IN) are supported";
                return Err(self.unsupported(self.span(), "a parameter by reference", instead));
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

    /// A line of a `.dat` file.
    pub(super) fn data_item(&mut self) -> Result<DataItem, Diagnostic> {
        if let Some(declaration) = self.declaration()? {
            return Ok(DataItem::Declaration(declaration));
        }
        let (target, value) = self.assignment()?;
        self.line_end()?;
        Ok(DataItem::Value { target, value })
    }

    /// The declaration on this line, if it is one.
    pub(super) fn declaration(&mut self) -> Result<Option<Declaration>, Diagnostic> {
        let start = self.span().start;
        let before = self.at;
        let mut declares = false;
        while ["DECL", "GLOBAL", "CONST"].iter().any(|word| self.is_name(word)) {
            declares |= self.is_name("DECL");
            self.advance();
        }
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
        } else if self.declares_variables(declares) {
            let (type_name, _) = self.name()?;
            let each = Type::named(&type_name).map_or(1, Type::numbers);
            let mut names = vec![self.declared(each)?];
            while self.accept_sign(",") {
                names.push(self.declared(each)?);
            }
            DeclarationKind::Variables { type_name, names }
        } else if declares {
            return Err(self.unexpected("a type and a name"));
        } else {
            self.at = before;
            return Ok(None);
        };
        let span = start..self.end();
        self.line_end()?;
        Ok(Some(Declaration { span, kind }))
    }

    /// Whether a type and a name follow.
    fn declares_variables(&self, declares: bool) -> bool {
        matches!(self.peek(), Token::Name(name) if declares || type_of_declaration(name))
            && matches!(self.ahead(1), Token::Name(_))
    }

    /// A name with the number of its elements, which are of so many numbers `each`.
    fn declared(&mut self, each: usize) -> Result<Declared, Diagnostic> {
        let (name, span) = self.name()?;
        let mut elements = None;
        if self.accept_sign("[") {
            let Token::Int(count) = *self.peek() else { return Err(self.unexpected("a number of elements")) };
            elements = usize::try_from(count).ok().filter(|count| (1..=NUMBERS).contains(count));
            self.numbers += elements.unwrap_or(0) * each;
            if elements.is_none() || self.numbers > NUMBERS {
                let finding = ProgramFinding::ArraySize { elements: count, most: NUMBERS };
                return Err(self.wrong(self.span(), finding));
            }
            self.advance();
            self.one_dimension()?;
            self.sign("]")?;
        }
        let value = if self.accept_sign("=") { Some(self.expression()?) } else { None };
        Ok(Declared { name, elements, value, span })
    }

    /// Refuses a second index.
    pub(super) fn one_dimension(&self) -> Result<(), Diagnostic> {
        match self.peek() {
            Token::Sign(",") => {
                let what = "an array of more than one dimension";
                Err(self.unsupported(self.span(), what, "use arrays of one dimension"))
            }
            _ => Ok(()),
        }
    }
}
