//! Statements and expressions of RAPID and URScript, and the parser of expressions.

use crate::program::ProgramFinding;
use crate::program::flow::{Calls, Control, Ways};
use crate::program::lexer::Token;
use crate::program::text::Span;
use crate::program::tokens::Tokens;
use dbbd_model::diagnostic::Diagnostic;

#[derive(Clone, Debug)]
pub(crate) struct Routine {
    pub(crate) name: String,
    /// Index of the file.
    pub(crate) file: usize,
    /// Whether other files cannot see the routine, or it is inside another routine.
    pub(crate) is_local: bool,
    /// Whether the routine runs beside the program: a thread of URScript, a TRAP of RAPID.
    pub(crate) is_concurrent: bool,
    pub(crate) parameters: Vec<Parameter>,
    pub(crate) body: Vec<Statement>,
}

#[derive(Clone, Debug)]
pub(crate) struct Parameter {
    pub(crate) name: String,
    pub(crate) default: Option<Expression>,
    /// Whether the parameter may be left out, and is given by name: `\Name` of RAPID.
    pub(crate) is_optional: bool,
    /// Whether the routine may change the variable that it is given: INOUT, VAR and PERS of RAPID.
    pub(crate) is_reference: bool,
}

#[derive(Clone, Debug)]
pub(crate) struct Statement {
    pub(crate) span: Span,
    pub(crate) kind: StatementKind,
    /// The routines and functions that the statement calls.
    pub(crate) called: Vec<String>,
}

impl Statement {
    /// A statement that begins at a position and ends with the last token that was read.
    pub(in crate::program) fn new(tokens: &Tokens<'_>, start: usize, kind: StatementKind) -> Self {
        let mut called = tokens.called_since(start);
        if let StatementKind::Call { name, .. } = &kind
            && !called.contains(name)
        {
            called.push(name.clone());
        }
        Self { span: tokens.since(start), kind, called }
    }
}

impl Routine {
    /// The ways through the routine.
    pub(crate) fn ways(&self) -> Ways {
        Ways::new(self.body.iter().map(|statement| {
            if let StatementKind::Control { control, .. } = &statement.kind { Some(control) } else { None }
        }))
    }
}

/// The routines that the statements of routines call. Routines that run beside the program are not called.
pub(crate) fn calls<'a>(routines: impl Iterator<Item = &'a Routine> + Clone) -> Calls {
    let index =
        |name: &String| routines.clone().position(|routine| routine.name == *name && !routine.is_concurrent);
    let called = |statement: &Statement| statement.called.iter().filter_map(index).collect();
    routines.clone().map(|routine| routine.body.iter().map(called).collect()).collect()
}

/// The statements of routines, each with the index of its routine and its own index.
pub(crate) fn statements<'a>(
    routines: impl IntoIterator<Item = &'a Routine>,
) -> impl Iterator<Item = ((usize, usize), &'a Statement)> {
    routines.into_iter().enumerate().flat_map(|(routine, of)| {
        of.body.iter().enumerate().map(move |(at, statement)| ((routine, at), statement))
    })
}

#[derive(Clone, Debug)]
pub(crate) enum StatementKind {
    /// A call of a routine or an instruction.
    Call { name: String, arguments: Vec<Argument> },
    Assign {
        name: String,
        /// The names after the dots, of the outer component first; none if the whole variable is assigned.
        components: Vec<String>,
        value: Expression,
    },
    /// A variable of the routine, with its value if the value can be parsed.
    Declare { name: String, value: Option<Expression> },
    /// `while not is_steady()` of URScript.
    UntilSteady,
    /// A statement that affects which statement runs next, with its first word.
    Control { word: String, control: Control },
    /// A statement that is not supported, with its first word.
    Other(String),
}

/// An argument: of RAPID `value`, `\Name:=value` or `\Name`; of URScript `value` or `name=value`.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Argument {
    pub(crate) name: Option<String>,
    pub(crate) value: Option<Expression>,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Expression {
    pub(crate) span: Span,
    pub(crate) kind: ExpressionKind,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum ExpressionKind {
    Number(f64),
    Text(String),
    Bool(bool),
    Name(String),
    /// `[a,b]`
    List(Vec<Expression>),
    /// `p[x,y,z,rx,ry,rz]` of URScript.
    Pose(Vec<Expression>),
    /// `f(..)`, which is not evaluated.
    Call {
        name: String,
        arguments: Vec<Argument>,
    },
    /// Any other computation, which is not evaluated.
    Computed,
}

/// Most brackets inside each other: the parser is recursive.
const DEPTH: usize = 50;

impl Tokens<'_> {
    /// Parses an expression. Operators, calls and elements of arrays are skipped: their result is not evaluated.
    pub(crate) fn expression(&mut self) -> Result<Expression, Diagnostic> {
        self.nested(0)
    }

    /// An expression inside `depth` brackets.
    fn nested(&mut self, depth: usize) -> Result<Expression, Diagnostic> {
        let start = self.position();
        let mut kind = self.operand(depth)?;
        while self.accept_operator() {
            self.operand(depth)?;
            kind = ExpressionKind::Computed;
        }
        Ok(Expression { span: self.since(start), kind })
    }

    /// Reads a binary operator if it is the next token.
    fn accept_operator(&mut self) -> bool {
        const WORDS: [&str; 5] = ["AND", "OR", "XOR", "DIV", "MOD"];
        const SIGNS: [&str; 13] = ["+", "-", "*", "/", "%", "<", ">", "<=", ">=", "==", "<>", "!=", "="];
        WORDS.into_iter().any(|word| self.accept_name(word))
            || SIGNS.into_iter().any(|sign| self.accept(sign))
    }

    fn operand(&mut self, depth: usize) -> Result<ExpressionKind, Diagnostic> {
        self.check_depth(depth)?;
        if self.accept_name("NOT") {
            self.nested(depth + 1)?;
            return Ok(ExpressionKind::Computed);
        }
        for (sign, factor) in [("-", -1.0), ("+", 1.0)] {
            if self.accept(sign) {
                return Ok(if let ExpressionKind::Number(number) = self.operand(depth + 1)? {
                    ExpressionKind::Number(factor * number)
                } else {
                    ExpressionKind::Computed
                });
            }
        }
        if self.accept("[") {
            return Ok(ExpressionKind::List(self.list(depth, "]")?));
        }
        if self.accept("(") {
            let inner = self.nested(depth + 1)?;
            self.expect(")")?;
            return Ok(inner.kind);
        }
        let kind = match self.peek().clone() {
            Token::Real(number) => ExpressionKind::Number(number),
            Token::Text(text) => ExpressionKind::Text(text),
            Token::Name(name) => {
                self.advance();
                return self.named(name, depth);
            }
            Token::Enum(_) | Token::Int(_) | Token::Sign(_) | Token::LineEnd | Token::End => {
                return Err(self.expected("a value"));
            }
        };
        self.advance();
        Ok(kind)
    }

    fn check_depth(&self, depth: usize) -> Result<(), Diagnostic> {
        if depth <= DEPTH {
            return Ok(());
        }
        Err(self.wrong(self.span(), ProgramFinding::NestedTooDeeply { most: DEPTH }))
    }

    /// Parses the rest after a name: the name is a variable, a constant or a pose, or calls and elements follow.
    fn named(&mut self, name: String, depth: usize) -> Result<ExpressionKind, Diagnostic> {
        if name == "p" && self.accept("[") {
            return Ok(ExpressionKind::Pose(self.list(depth, "]")?));
        }
        let mut kind = match name.to_ascii_uppercase().as_str() {
            "TRUE" => ExpressionKind::Bool(true),
            "FALSE" => ExpressionKind::Bool(false),
            _ => ExpressionKind::Name(name.clone()),
        };
        loop {
            if self.accept("(") {
                let arguments = self.arguments(")", depth)?;
                let is_function = matches!(kind, ExpressionKind::Name(_));
                kind = ExpressionKind::Computed;
                if is_function {
                    kind = ExpressionKind::Call { name: name.clone(), arguments };
                }
                continue;
            } else if self.accept("{") {
                self.list(depth, "}")?;
            } else if self.accept("[") {
                self.list(depth, "]")?;
            } else if self.accept(".") {
                self.name()?;
            } else {
                return Ok(kind);
            }
            kind = ExpressionKind::Computed;
        }
    }

    /// The elements of a list up to its closing bracket, which is read.
    fn list(&mut self, depth: usize, end: &str) -> Result<Vec<Expression>, Diagnostic> {
        let mut list = Vec::new();
        while !self.accept(end) {
            if !list.is_empty() {
                self.expect(",")?;
            }
            list.push(self.nested(depth + 1)?);
        }
        Ok(list)
    }

    /// Arguments up to the sign that ends them, which is read. An optional argument of RAPID needs no comma before it.
    pub(crate) fn arguments(&mut self, end: &str, depth: usize) -> Result<Vec<Argument>, Diagnostic> {
        self.check_depth(depth)?;
        let mut arguments: Vec<Argument> = Vec::new();
        while !self.accept(end) {
            if !arguments.is_empty() && !matches!(self.peek(), Token::Sign("\\")) {
                self.expect(",")?;
            }
            arguments.push(self.argument(depth)?);
        }
        Ok(arguments)
    }

    fn argument(&mut self, depth: usize) -> Result<Argument, Diagnostic> {
        let mut name = None;
        if self.accept("\\") {
            name = Some(self.name()?.0);
            if !self.accept(":=") {
                return Ok(Argument { name, value: None });
            }
        } else if matches!((self.peek(), self.ahead(1)), (Token::Name(_), Token::Sign("="))) {
            name = Some(self.name()?.0);
            self.advance();
        }
        Ok(Argument { name, value: Some(self.nested(depth + 1)?) })
    }
}
