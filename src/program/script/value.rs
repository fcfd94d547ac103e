//! Expressions and their values. A value knows the file and the bytes of its literal, so that a point can be rewritten
//! where it is written, through any number of names.

use std::collections::HashMap;

use super::lexer::{Token, tokens};
use crate::catalogue::ProgramFinding;
use crate::diagnostic::Diagnostic;
use crate::program::Language;
use crate::program::text::{Span, Text};

/// Brackets inside each other.
const DEPTH: usize = 50;

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Expression {
    pub(crate) span: Span,
    pub(crate) kind: Kind,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Kind {
    Number(f64),
    Text(String),
    Bool(bool),
    Name(String),
    /// `[a,b]`
    List(Vec<Expression>),
    /// `p[x,y,z,rx,ry,rz]` of URScript.
    Pose(Vec<Expression>),
    /// `f(..)`: what is computed has no value here.
    Call(String),
    /// Anything else that is computed.
    Computed,
}

/// An argument: of RAPID `\Name:=value` or `\Name`, of URScript `name=value`.
#[derive(Clone, Debug)]
pub(crate) struct Argument {
    pub(crate) name: Option<String>,
    pub(crate) value: Option<Expression>,
}

/// What an expression gives.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Value {
    /// Number of the file.
    pub(crate) file: usize,
    /// The bytes of the literal there.
    pub(crate) span: Span,
    /// The name under which it is declared.
    pub(crate) name: Option<String>,
    pub(crate) of: Of,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Of {
    Number(f64),
    Text(String),
    Bool(bool),
    List(Vec<Value>),
    Pose(Vec<Value>),
}

impl Value {
    pub(crate) fn number(&self) -> Option<f64> {
        match self.of {
            Of::Number(value) => Some(value),
            _ => None,
        }
    }

    pub(crate) fn list(&self) -> Option<&[Value]> {
        match &self.of {
            Of::List(list) => Some(list),
            _ => None,
        }
    }

    /// The members of a list or a pose of so many.
    pub(crate) fn parts<const N: usize>(&self) -> Option<&[Value; N]> {
        let (Of::List(list) | Of::Pose(list)) = &self.of else { return None };
        list.as_slice().try_into().ok()
    }

    /// The numbers of a list or a pose of so many.
    pub(crate) fn numbers<const N: usize>(&self) -> Option<[f64; N]> {
        let numbers: Option<Vec<f64>> = self.parts::<N>()?.iter().map(Value::number).collect();
        numbers?.try_into().ok()
    }
}

/// Values by name.
pub(crate) type Names = HashMap<String, Value>;

/// The value of an expression in the file with this number; `None` where it is computed, or a name has none.
pub(crate) fn value(
    expression: &Expression,
    file: usize,
    lookup: &dyn Fn(&str) -> Option<Value>,
) -> Option<Value> {
    let all = |list: &[Expression]| -> Option<Vec<Value>> {
        list.iter().map(|expression| value(expression, file, lookup)).collect()
    };
    let of = match &expression.kind {
        Kind::Number(number) => Of::Number(*number),
        Kind::Text(text) => Of::Text(text.clone()),
        Kind::Bool(value) => Of::Bool(*value),
        Kind::List(list) => Of::List(all(list)?),
        Kind::Pose(list) => Of::Pose(all(list)?),
        Kind::Name(name) => return lookup(name),
        Kind::Call(_) | Kind::Computed => return None,
    };
    Some(Value { file, span: expression.span.clone(), name: None, of })
}

/// Goes through the words of a file.
pub(crate) struct Words<'a> {
    pub(crate) file: Text<'a>,
    tokens: Vec<(Token, Span)>,
    at: usize,
}

impl<'a> Words<'a> {
    pub(crate) fn new(file: Text<'a>, language: Language) -> Result<Self, Diagnostic> {
        Ok(Self { file, tokens: tokens(file, language)?, at: 0 })
    }

    pub(crate) fn peek(&self) -> &Token {
        self.tokens.get(self.at).map_or(&Token::End, |(token, _)| token)
    }

    /// The word after the next.
    pub(crate) fn second(&self) -> &Token {
        self.tokens.get(self.at + 1).map_or(&Token::End, |(token, _)| token)
    }

    pub(crate) fn span(&self) -> Span {
        let end = self.file.text.len();
        self.tokens.get(self.at).map_or(end..end, |(_, span)| span.clone())
    }

    pub(crate) fn span_at(&self, place: usize) -> Span {
        self.tokens.get(place).map_or(0..0, |(_, span)| span.clone())
    }

    pub(crate) fn next(&mut self) -> Token {
        let token = self.peek().clone();
        self.at = (self.at + 1).min(self.tokens.len());
        token
    }

    pub(crate) fn take(&mut self, sign: &str) -> bool {
        let found = matches!(self.peek(), Token::Sign(here) if *here == sign);
        self.at += usize::from(found);
        found
    }

    pub(crate) fn expect(&mut self, sign: &'static str) -> Result<(), Diagnostic> {
        if self.take(sign) { Ok(()) } else { Err(self.expected(&format!("`{sign}`"))) }
    }

    pub(crate) fn name(&mut self) -> Result<String, Diagnostic> {
        match self.peek() {
            Token::Name(name) => {
                let name = name.clone();
                self.at += 1;
                Ok(name)
            }
            _ => Err(self.expected("a name")),
        }
    }

    /// Whether the next word is this one, in any case of its letters.
    pub(crate) fn is_word(&self, word: &str) -> bool {
        matches!(self.peek(), Token::Name(name) if name.eq_ignore_ascii_case(word))
    }

    /// Takes the next word if it is this one.
    pub(crate) fn take_word(&mut self, word: &str) -> bool {
        let found = self.is_word(word);
        self.at += usize::from(found);
        found
    }

    /// Where the words are, to come back to.
    pub(crate) fn place(&self) -> usize {
        self.at
    }

    pub(crate) fn go_to(&mut self, place: usize) {
        self.at = place;
    }

    /// From a place to before the next word.
    pub(crate) fn since(&self, place: usize) -> Span {
        let start = self.tokens.get(place).map_or(0, |(_, span)| span.start);
        let end =
            self.at.checked_sub(1).and_then(|at| self.tokens.get(at)).map_or(start, |(_, span)| span.end);
        start..end.max(start)
    }

    pub(crate) fn expected(&self, what: &str) -> Diagnostic {
        let found = match self.peek() {
            Token::Name(name) => format!("`{name}`"),
            Token::Number(number) => number.to_string(),
            Token::Text(_) => "a text".into(),
            Token::Sign(sign) => format!("`{sign}`"),
            Token::LineEnd => "the end of the line".into(),
            Token::End => "the end of the file".into(),
        };
        self.file.wrong(&self.span(), ProgramFinding::Expected { expected: what.into(), found })
    }

    /// An expression. What is computed is read over: operators, calls, elements of arrays.
    pub(crate) fn expression(&mut self) -> Result<Expression, Diagnostic> {
        self.nested(0)
    }

    fn nested(&mut self, depth: usize) -> Result<Expression, Diagnostic> {
        let place = self.at;
        let mut kind = self.operand(depth)?;
        while self.operator() {
            self.operand(depth)?;
            kind = Kind::Computed;
        }
        Ok(Expression { span: self.since(place), kind })
    }

    /// Takes an operator between two operands.
    fn operator(&mut self) -> bool {
        const SIGNS: [&str; 13] = ["+", "-", "*", "/", "%", "<", ">", "<=", ">=", "==", "<>", "!=", "="];
        let word = ["AND", "OR", "XOR", "DIV", "MOD"].into_iter().any(|word| self.is_word(word));
        let found = word || matches!(self.peek(), Token::Sign(sign) if SIGNS.contains(sign));
        self.at += usize::from(found);
        found
    }

    fn operand(&mut self, depth: usize) -> Result<Kind, Diagnostic> {
        if depth > DEPTH {
            return Err(self.file.wrong(&self.span(), ProgramFinding::NestedTooDeeply { most: DEPTH }));
        }
        if self.take_word("NOT") {
            self.nested(depth + 1)?;
            return Ok(Kind::Computed);
        }
        if self.take("-") || self.take("+") {
            let minus = matches!(self.tokens.get(self.at - 1), Some((Token::Sign("-"), _)));
            let kind = self.operand(depth + 1)?;
            return Ok(match kind {
                Kind::Number(number) => Kind::Number(if minus { -number } else { number }),
                _ => Kind::Computed,
            });
        }
        match self.next() {
            Token::Number(number) => Ok(Kind::Number(number)),
            Token::Text(text) => Ok(Kind::Text(text)),
            Token::Sign("[") => Ok(Kind::List(self.list(depth, "]")?)),
            Token::Sign("(") => {
                let inside = self.nested(depth + 1)?;
                self.expect(")")?;
                Ok(inside.kind)
            }
            Token::Name(name) => self.named(name, depth),
            _ => {
                self.at = self.at.saturating_sub(1);
                Err(self.expected("a value"))
            }
        }
    }

    fn named(&mut self, name: String, depth: usize) -> Result<Kind, Diagnostic> {
        let mut kind = match name.as_str() {
            "p" if self.take("[") => return Ok(Kind::Pose(self.list(depth, "]")?)),
            _ if name.eq_ignore_ascii_case("TRUE") => Kind::Bool(true),
            _ if name.eq_ignore_ascii_case("FALSE") => Kind::Bool(false),
            _ => Kind::Name(name.clone()),
        };
        loop {
            if self.take("(") {
                self.arguments(")", depth)?;
                kind = Kind::Call(name.clone());
            } else if self.take("{") {
                self.list(depth, "}")?;
                kind = Kind::Computed;
            } else if self.take("[") {
                self.list(depth, "]")?;
                kind = Kind::Computed;
            } else if self.take(".") {
                self.name()?;
                kind = Kind::Computed;
            } else {
                return Ok(kind);
            }
        }
    }

    fn list(&mut self, depth: usize, end: &'static str) -> Result<Vec<Expression>, Diagnostic> {
        let mut list = Vec::new();
        while !self.take(end) {
            if !list.is_empty() {
                self.expect(",")?;
            }
            list.push(self.nested(depth + 1)?);
        }
        Ok(list)
    }

    /// Arguments up to the sign that ends them, which is taken; RAPID's optional ones may follow without a comma.
    pub(crate) fn arguments(&mut self, end: &'static str, depth: usize) -> Result<Vec<Argument>, Diagnostic> {
        if depth > DEPTH {
            return Err(self.file.wrong(&self.span(), ProgramFinding::NestedTooDeeply { most: DEPTH }));
        }
        let mut arguments: Vec<Argument> = Vec::new();
        while !self.take(end) {
            if !arguments.is_empty() && !matches!(self.peek(), Token::Sign("\\")) {
                self.expect(",")?;
            }
            arguments.push(self.argument(depth)?);
        }
        Ok(arguments)
    }

    fn argument(&mut self, depth: usize) -> Result<Argument, Diagnostic> {
        if self.take("\\") {
            let name = Some(self.name()?);
            let value = if self.take(":=") { Some(self.nested(depth + 1)?) } else { None };
            return Ok(Argument { name, value });
        }
        if let (Token::Name(name), Token::Sign("=")) = (self.peek().clone(), self.second()) {
            self.at += 2;
            return Ok(Argument { name: Some(name), value: Some(self.nested(depth + 1)?) });
        }
        Ok(Argument { name: None, value: Some(self.nested(depth + 1)?) })
    }
}
