//! Parser of `.src` and `.dat` files: recursive descent, statement by statement. A statement that is not supported is an
//! error with its place.

use super::syntax::*;
use super::value::Type;
use crate::program::Language;
use crate::program::ProgramFinding;
use crate::program::lexer::Token;
use crate::program::tokens::Tokens;
use dbbd_model::diagnostic::Diagnostic;

pub fn parse_source(file: &str, text: &str) -> Result<Source, Diagnostic> {
    let mut parser = Parser::new(Tokens::new(Text { file, text }, Language::Krl)?);
    let mut routines: Vec<Routine> = Vec::new();
    while !parser.is_at_end() {
        let routine = parser.routine()?;
        if routines.iter().any(|other| other.name == routine.name) {
            return Err(parser
                .tokens
                .wrong(routine.span, ProgramFinding::SecondRoutine { name: routine.name }));
        }
        routines.push(routine);
    }
    if routines.is_empty() {
        return Err(Diagnostic::file(file, ProgramFinding::NoRoutine));
    }
    Ok(Source { file: file.into(), text: text.into(), routines })
}

pub fn parse_data(file: &str, text: &str) -> Result<Data, Diagnostic> {
    let mut parser = Parser::new(Tokens::new(Text { file, text }, Language::Krl)?);
    parser.skip_empty_lines();
    parser.tokens.expect_name("DEFDAT")?;
    let (name, _) = parser.name()?;
    parser.tokens.accept_name("PUBLIC");
    parser.line_end()?;
    let mut items = Vec::new();
    while !parser.is_at_end() && !parser.tokens.is_name("ENDDAT") {
        items.push(parser.data_item()?);
    }
    parser.tokens.expect_name("ENDDAT")?;
    parser.line_end()?;
    if !parser.is_at_end() {
        return Err(parser.tokens.expected("nothing after ENDDAT"));
    }
    Ok(Data { file: file.into(), text: text.into(), name, items })
}

/// The tokens of a text, with counters that keep a damaged or hostile file from exhausting the stack or the memory.
pub(super) struct Parser<'a> {
    pub(super) tokens: Tokens<'a>,
    /// Blocks and expressions that are open.
    depth: usize,
    /// Operators of the line so far.
    operators: usize,
    /// Values in the arrays that were declared so far.
    array_values: usize,
}

/// Most blocks and expressions inside each other: the parser is recursive.
const DEPTH: usize = 60;
/// Most operators of a line: a chain of operators is a tree of the same depth.
const OPERATORS: usize = 200;
/// Most values in all arrays of a file; an E6POS has 14.
const ARRAY_VALUES: usize = 200_000;

impl<'a> Parser<'a> {
    pub(super) fn new(tokens: Tokens<'a>) -> Self {
        Self { tokens, depth: 0, operators: 0, array_values: 0 }
    }

    /// Parses a block or expression that may contain others.
    pub(super) fn nested<T>(
        &mut self,
        parse: impl FnOnce(&mut Self) -> Result<T, Diagnostic>,
    ) -> Result<T, Diagnostic> {
        self.depth += 1;
        if self.depth > DEPTH {
            let span = self.tokens.span();
            return Err(self.tokens.wrong(span, ProgramFinding::NestedTooDeeply { most: DEPTH }));
        }
        let parsed = parse(self)?;
        self.depth -= 1;
        Ok(parsed)
    }

    /// Reads an operator.
    pub(super) fn operator(&mut self) -> Result<(), Diagnostic> {
        self.operators += 1;
        if self.operators > OPERATORS {
            let span = self.tokens.span();
            return Err(self.tokens.wrong(span, ProgramFinding::TooManyOperators { most: OPERATORS }));
        }
        self.tokens.advance();
        Ok(())
    }

    /// Reads the next token and returns `parsed`, its meaning.
    pub(super) fn token_as<T>(&mut self, parsed: T) -> T {
        self.tokens.advance();
        parsed
    }

    pub(super) fn unsupported(&self, span: Span, what: impl Into<String>, instead: &str) -> Diagnostic {
        self.tokens.wrong(span, ProgramFinding::Unsupported { what: what.into(), instead: instead.into() })
    }

    pub(super) fn name(&mut self) -> Result<(String, Span), Diagnostic> {
        let (name, span) = self.tokens.name()?;
        if name.len() > 24 {
            return Err(self.tokens.wrong(span, ProgramFinding::LongName { name }));
        }
        Ok((name, span))
    }

    pub(super) fn line_end(&mut self) -> Result<(), Diagnostic> {
        self.operators = 0;
        match self.tokens.peek() {
            Token::LineEnd => self.tokens.advance(),
            Token::End => {}
            Token::Name(_)
            | Token::Enum(_)
            | Token::Int(_)
            | Token::Real(_)
            | Token::Text(_)
            | Token::Sign(_) => return Err(self.tokens.expected("the end of the line")),
        }
        Ok(())
    }

    pub(super) fn skip_empty_lines(&mut self) {
        while *self.tokens.peek() == Token::LineEnd {
            self.tokens.advance();
        }
    }

    /// Whether nothing but empty lines follows; they are skipped.
    fn is_at_end(&mut self) -> bool {
        self.skip_empty_lines();
        *self.tokens.peek() == Token::End
    }

    /// `DEF NAME (A :IN,B :IN)` to `END`.
    fn routine(&mut self) -> Result<Routine, Diagnostic> {
        self.tokens.accept_name("GLOBAL");
        if !self.tokens.accept_name("DEF") {
            return Err(self.unknown_statement("DEF NAME ( )"));
        }
        let (name, span) = self.name()?;
        let parameters = self.parameters()?;
        self.line_end()?;
        let mut declarations = Vec::new();
        self.skip_empty_lines();
        while let Some(declaration) = self.declaration()? {
            declarations.push(declaration);
            self.skip_empty_lines();
        }
        let body = self.block(&["END"])?;
        self.tokens.expect_name("END")?;
        self.line_end()?;
        Ok(Routine { name, span, parameters, declarations, body })
    }

    /// `(A :IN,B :IN)`
    fn parameters(&mut self) -> Result<Vec<String>, Diagnostic> {
        self.tokens.expect("(")?;
        let mut parameters = Vec::new();
        while !self.tokens.accept(")") {
            if !parameters.is_empty() {
                self.tokens.expect(",")?;
            }
            parameters.push(self.name()?.0);
            self.tokens.expect(":")?;
            if !self.tokens.accept_name("IN") {
                let instead = "only parameters by value (:IN) are supported";
                return Err(self.unsupported(self.tokens.span(), "a parameter by reference", instead));
            }
        }
        Ok(parameters)
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
        let start = self.tokens.position();
        let mut has_decl = false;
        while ["DECL", "GLOBAL", "CONST"].iter().any(|word| self.tokens.is_name(word)) {
            has_decl |= self.tokens.is_name("DECL");
            self.tokens.advance();
        }
        let kind = if self.tokens.accept_name("EXT") {
            let (name, _) = self.name()?;
            while !self.tokens.is_line_end() {
                self.tokens.advance();
            }
            Declaration::External { name }
        } else if self.tokens.accept_name("SIGNAL") {
            let (name, _) = self.name()?;
            let first = self.place()?;
            let last = if self.tokens.accept_name("TO") { Some(self.place()?) } else { None };
            Declaration::Signal { name, first, last }
        } else if self.is_variable_declaration(has_decl) {
            let (type_name, _) = self.name()?;
            let values = Type::named(&type_name).map_or(1, Type::values);
            let mut variables = vec![self.declared(values)?];
            while self.tokens.accept(",") {
                variables.push(self.declared(values)?);
            }
            Declaration::Variables { type_name, variables }
        } else if has_decl {
            return Err(self.tokens.expected("a type and a name"));
        } else {
            self.tokens.go_to(start);
            return Ok(None);
        };
        self.line_end()?;
        Ok(Some(kind))
    }

    /// Whether the line goes on with a type and a name.
    fn is_variable_declaration(&self, has_decl: bool) -> bool {
        matches!(self.tokens.peek(), Token::Name(name) if has_decl || declares_without_decl(name))
            && matches!(self.tokens.ahead(1), Token::Name(_))
    }

    /// The name of a variable with its number of elements, each of which holds this number of `values`.
    fn declared(&mut self, values: usize) -> Result<Declared, Diagnostic> {
        let (name, span) = self.name()?;
        let mut elements = None;
        if self.tokens.accept("[") {
            let Token::Int(count) = *self.tokens.peek() else {
                return Err(self.tokens.expected("a number of elements"));
            };
            elements = usize::try_from(count).ok().filter(|count| (1..=ARRAY_VALUES).contains(count));
            self.array_values += elements.unwrap_or(0) * values;
            if elements.is_none() || self.array_values > ARRAY_VALUES {
                let finding = ProgramFinding::ArraySize { elements: count, most: ARRAY_VALUES };
                return Err(self.tokens.wrong(self.tokens.span(), finding));
            }
            self.tokens.advance();
            self.one_dimension()?;
            self.tokens.expect("]")?;
        }
        let value = if self.tokens.accept("=") { Some(self.expression()?) } else { None };
        Ok(Declared { name, elements, value, span })
    }

    /// Refuses a second index.
    pub(super) fn one_dimension(&self) -> Result<(), Diagnostic> {
        if !matches!(self.tokens.peek(), Token::Sign(",")) {
            return Ok(());
        }
        let what = "an array of more than one dimension";
        Err(self.unsupported(self.tokens.span(), what, "use arrays of one dimension"))
    }
}
