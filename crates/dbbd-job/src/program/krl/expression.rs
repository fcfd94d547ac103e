//! Parser of expressions (by precedence climbing) and places.

use super::parser::Parser;
use super::syntax::*;
use crate::program::ProgramFinding;
use crate::program::lexer::Token;
use dbbd_model::diagnostic::Diagnostic;

/// Most components of an aggregate: more than any structure of the controller has.
const FIELDS: usize = 100;

/// The binary operator of a token, and its precedence.
fn binary(token: &Token) -> Option<(Binary, u8)> {
    let word = if let Token::Name(name) = token {
        name.as_str()
    } else if let Token::Sign(sign) = token {
        sign
    } else {
        return None;
    };
    Some(match word {
        "OR" => (Binary::Or, 1),
        "AND" => (Binary::And, 2),
        "==" => (Binary::Equal, 3),
        "<>" => (Binary::Unequal, 3),
        "<" => (Binary::Less, 3),
        "<=" => (Binary::LessOrEqual, 3),
        ">" => (Binary::Greater, 3),
        ">=" => (Binary::GreaterOrEqual, 3),
        "+" => (Binary::Add, 4),
        "-" => (Binary::Subtract, 4),
        "*" => (Binary::Multiply, 5),
        "/" => (Binary::Divide, 5),
        _ => return None,
    })
}

impl Parser<'_> {
    pub(super) fn expression(&mut self) -> Result<Expression, Diagnostic> {
        self.nested(|parser| parser.operation(1))
    }

    /// An expression of operators with at least the precedence `least`.
    fn operation(&mut self, least: u8) -> Result<Expression, Diagnostic> {
        let mut left = self.operand()?;
        while let Some((operator, precedence)) = binary(self.tokens.peek())
            && precedence >= least
        {
            self.operator()?;
            let right = self.operation(precedence + 1)?;
            let span = left.span.start..right.span.end;
            left =
                Expression { span, kind: ExpressionKind::Binary(operator, Box::new(left), Box::new(right)) };
        }
        Ok(left)
    }

    fn operand(&mut self) -> Result<Expression, Diagnostic> {
        let start = self.tokens.position();
        let kind = match self.tokens.peek().clone() {
            Token::Int(value) => self.token_as(ExpressionKind::Int(value)),
            Token::Real(value) => self.token_as(ExpressionKind::Real(value)),
            Token::Text(text) => self.token_as(ExpressionKind::Text(text)),
            Token::Enum(name) => self.token_as(ExpressionKind::Enum(name)),
            Token::Name(name) if name == "TRUE" || name == "FALSE" => {
                self.token_as(ExpressionKind::Bool(name == "TRUE"))
            }
            Token::Name(name) if name == "NOT" => self.unary(Unary::Not)?,
            Token::Sign("-") => self.unary(Unary::Minus)?,
            Token::Sign("+") => {
                self.operator()?;
                return self.nested(Self::operand);
            }
            Token::Sign("(") => {
                self.tokens.advance();
                let inner = self.expression()?;
                self.tokens.expect(")")?;
                inner.kind
            }
            Token::Sign("{") => self.aggregate()?,
            Token::Name(_) => {
                let place = self.place()?;
                if !matches!(self.tokens.peek(), Token::Sign("(")) {
                    ExpressionKind::Place(place)
                } else if place.name.starts_with("EKI_") && place.parts.is_empty() {
                    ExpressionKind::Call { name: place.name, arguments: self.arguments()? }
                } else {
                    let what = format!("the function {}", place.name);
                    return Err(self.unsupported(place.span, what, "compute the value beforehand"));
                }
            }
            Token::Sign(_) | Token::LineEnd | Token::End => return Err(self.tokens.expected("a value")),
        };
        Ok(Expression { span: self.tokens.since(start), kind })
    }

    fn unary(&mut self, operator: Unary) -> Result<ExpressionKind, Diagnostic> {
        self.operator()?;
        let operand = self.nested(Self::operand)?;
        // A number and its sign are one literal, so that their bytes can be replaced as one.
        Ok(match (operator, operand.kind) {
            (Unary::Minus, ExpressionKind::Real(value)) => ExpressionKind::Real(-value),
            (Unary::Minus, ExpressionKind::Int(value)) => ExpressionKind::Int(-value),
            (_, kind) => ExpressionKind::Unary(operator, Box::new(Expression { span: operand.span, kind })),
        })
    }

    /// `{X 1.0,Y 2.0}` or `{E6POS: X 1.0,Y 2.0}`
    fn aggregate(&mut self) -> Result<ExpressionKind, Diagnostic> {
        self.tokens.expect("{")?;
        let mut fields: Vec<Field> = Vec::new();
        loop {
            let (mut name, mut span) = self.name()?;
            if fields.is_empty() && self.tokens.accept(":") {
                (name, span) = self.name()?;
            }
            if self.tokens.accept("[") {
                self.tokens.expect("]")?; // a text: `POINT2[] "P1"`
            }
            if fields.iter().any(|field| field.name == name) {
                return Err(self.tokens.wrong(span, ProgramFinding::GivenTwice { name }));
            }
            if fields.len() >= FIELDS {
                return Err(self.tokens.wrong(span, ProgramFinding::TooManyFields { most: FIELDS }));
            }
            let value = self.expression()?;
            fields.push(Field { name, value });
            if !self.tokens.accept(",") {
                break;
            }
        }
        self.tokens.expect("}")?;
        Ok(ExpressionKind::Aggregate(fields))
    }

    /// `A=B`
    pub(super) fn assignment(&mut self) -> Result<(Place, Expression), Diagnostic> {
        let target = self.place()?;
        self.tokens.expect("=")?;
        Ok((target, self.expression()?))
    }

    pub(super) fn place(&mut self) -> Result<Place, Diagnostic> {
        let (name, span) = self.name()?;
        let mut parts = Vec::new();
        loop {
            if self.tokens.accept("[") {
                if self.tokens.accept("]") {
                    parts.push(Part::Whole);
                    continue;
                }
                parts.push(Part::Element(Box::new(self.expression()?)));
                self.one_dimension()?;
                self.tokens.expect("]")?;
            } else if self.tokens.accept(".") {
                parts.push(Part::Component(self.name()?.0));
            } else {
                return Ok(Place { name, parts, span: span.start..self.tokens.end() });
            }
        }
    }
}
