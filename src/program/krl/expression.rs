//! Reads expressions and places: precedence climbing.

use super::lexer::Token;
use super::parser::Parser;
use super::syntax::*;
use crate::catalogue::ProgramFinding;
use crate::diagnostic::Diagnostic;

/// Of one structure: more than any of the controller's has.
const FIELDS: usize = 100;

/// The operator that a word is, and how tightly it binds.
fn binary(token: &Token) -> Option<(Binary, u8)> {
    Some(match token {
        Token::Name(name) if name == "OR" => (Binary::Or, 1),
        Token::Name(name) if name == "AND" => (Binary::And, 2),
        Token::Sign("==") => (Binary::Equal, 3),
        Token::Sign("<>") => (Binary::Unequal, 3),
        Token::Sign("<") => (Binary::Less, 3),
        Token::Sign("<=") => (Binary::LessOrEqual, 3),
        Token::Sign(">") => (Binary::Greater, 3),
        Token::Sign(">=") => (Binary::GreaterOrEqual, 3),
        Token::Sign("+") => (Binary::Add, 4),
        Token::Sign("-") => (Binary::Subtract, 4),
        Token::Sign("*") => (Binary::Multiply, 5),
        Token::Sign("/") => (Binary::Divide, 5),
        _ => return None,
    })
}

impl Parser<'_> {
    pub(super) fn expression(&mut self) -> Result<Expression, Diagnostic> {
        self.nested(|parser| parser.operation(1))
    }

    /// An expression of operators that bind at least as tightly as `floor`.
    fn operation(&mut self, floor: u8) -> Result<Expression, Diagnostic> {
        let mut left = self.operand()?;
        while let Some((operator, binds)) = binary(self.peek()).filter(|(_, binds)| *binds >= floor) {
            self.operator()?;
            let right = self.operation(binds + 1)?;
            let span = left.span.start..right.span.end;
            left =
                Expression { span, kind: ExpressionKind::Binary(operator, Box::new(left), Box::new(right)) };
        }
        Ok(left)
    }

    fn operand(&mut self) -> Result<Expression, Diagnostic> {
        let start = self.span().start;
        let kind = match self.peek().clone() {
            Token::Int(value) => self.literal(ExpressionKind::Int(value)),
            Token::Real(value) => self.literal(ExpressionKind::Real(value)),
            Token::Text(text) => self.literal(ExpressionKind::Text(text)),
            Token::Enum(name) => self.literal(ExpressionKind::Enum(name)),
            Token::Name(name) if name == "TRUE" || name == "FALSE" => {
                self.literal(ExpressionKind::Bool(name == "TRUE"))
            }
            Token::Name(name) if name == "NOT" => self.unary(Unary::Not)?,
            Token::Sign("-") => self.unary(Unary::Minus)?,
            Token::Sign("+") => {
                self.operator()?;
                return self.nested(Self::operand);
            }
            Token::Sign("(") => {
                self.advance();
                let inside = self.expression()?;
                self.sign(")")?;
                inside.kind
            }
            Token::Sign("{") => self.aggregate()?,
            Token::Name(_) => {
                let place = self.place()?;
                if matches!(self.peek(), Token::Sign("(")) {
                    if place.name.starts_with("EKI_") && place.parts.is_empty() {
                        let kind = ExpressionKind::Call { name: place.name, arguments: self.arguments()? };
                        return Ok(Expression { span: start..self.end(), kind });
                    }
                    let what = format!("the function {}", place.name);
                    return Err(self.unsupported(place.span, what, "compute the value beforehand"));
                }
                ExpressionKind::Place(place)
            }
            _ => return Err(self.unexpected("a value")),
        };
        Ok(Expression { span: start..self.end(), kind })
    }

    fn literal(&mut self, kind: ExpressionKind) -> ExpressionKind {
        self.advance();
        kind
    }

    fn unary(&mut self, operator: Unary) -> Result<ExpressionKind, Diagnostic> {
        self.operator()?;
        let operand = self.nested(Self::operand)?;
        // A signed literal is one number, so that its bytes can be replaced as one.
        Ok(match (operator, operand.kind) {
            (Unary::Minus, ExpressionKind::Real(value)) => ExpressionKind::Real(-value),
            (Unary::Minus, ExpressionKind::Int(value)) => ExpressionKind::Int(-value),
            (_, kind) => ExpressionKind::Unary(operator, Box::new(Expression { span: operand.span, kind })),
        })
    }

    /// `{X 1.0,Y 2.0}` with or without a type before a colon.
    fn aggregate(&mut self) -> Result<ExpressionKind, Diagnostic> {
        self.sign("{")?;
        let mut fields: Vec<Field> = Vec::new();
        loop {
            let (mut name, mut span) = self.name()?;
            if fields.is_empty() && self.accept_sign(":") {
                (name, span) = self.name()?;
            }
            if self.accept_sign("[") {
                self.sign("]")?; // a text, as in POINT2[] "P1"
            }
            if fields.iter().any(|field| field.name == name) {
                return Err(self.wrong(span, ProgramFinding::GivenTwice { name }));
            }
            if fields.len() >= FIELDS {
                return Err(self.wrong(span, ProgramFinding::TooManyFields { most: FIELDS }));
            }
            let value = self.expression()?;
            fields.push(Field { name, value });
            if !self.accept_sign(",") {
                break;
            }
        }
        self.sign("}")?;
        Ok(ExpressionKind::Aggregate(fields))
    }

    /// `A=B`
    pub(super) fn assignment(&mut self) -> Result<(Place, Expression), Diagnostic> {
        let target = self.place()?;
        self.sign("=")?;
        Ok((target, self.expression()?))
    }

    pub(super) fn place(&mut self) -> Result<Place, Diagnostic> {
        let (name, span) = self.name()?;
        let mut parts = Vec::new();
        loop {
            if self.accept_sign("[") {
                if self.accept_sign("]") {
                    parts.push(Part::Whole);
                    continue;
                }
                parts.push(Part::Element(Box::new(self.expression()?)));
                self.one_dimension()?;
                self.sign("]")?;
            } else if self.accept_sign(".") {
                parts.push(Part::Member(self.name()?.0));
            } else {
                return Ok(Place { name, parts, span: span.start..self.end() });
            }
        }
    }
}
