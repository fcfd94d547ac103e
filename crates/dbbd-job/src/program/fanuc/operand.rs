//! Operands of an instruction: numbers, positions and registers by their index, labels.

use crate::program::lexer::Token;
use crate::program::script::expression::{Expression, ExpressionKind};
use crate::program::tokens::Tokens;
use dbbd_model::diagnostic::Diagnostic;

/// Name of a label that is computed: such a jump may go to each label.
pub(super) const ANY_LABEL: &str = "";

/// A number with its sign, perhaps in brackets.
pub(super) fn number(tokens: &mut Tokens<'_>) -> Result<f64, Diagnostic> {
    let bracket = tokens.accept("(");
    let factor = if tokens.accept("-") { -1.0 } else { 1.0 };
    let Token::Real(number) = *tokens.peek() else { return Err(tokens.expected("a number")) };
    tokens.advance();
    if bracket {
        tokens.expect(")")?;
    }
    Ok(factor * number)
}

/// Parses `P[3]`, `PR[5]` or `R[1]`. The name is as written, without a comment; an operand whose index is computed has
/// no name.
pub(super) fn indexed(tokens: &mut Tokens<'_>) -> Result<Expression, Diagnostic> {
    let start = tokens.position();
    let (name, _) = tokens.name()?;
    tokens.expect("[")?;
    if let (Token::Real(number), Token::Sign("]")) = (tokens.peek().clone(), tokens.ahead(1)) {
        tokens.advance();
        tokens.advance();
        return Ok(Expression {
            span: tokens.since(start),
            kind: ExpressionKind::Name(format!("{name}[{number}]")),
        });
    }
    let mut open = 1;
    while open > 0 {
        if matches!(tokens.peek(), Token::End | Token::Sign(";")) {
            return Err(tokens.expected("`]`"));
        }
        open += usize::from(*tokens.peek() == Token::Sign("["));
        open -= usize::from(*tokens.peek() == Token::Sign("]"));
        tokens.advance();
    }
    Ok(Expression { span: tokens.since(start), kind: ExpressionKind::Computed })
}

/// A label in brackets.
pub(super) fn label(tokens: &mut Tokens<'_>) -> Result<String, Diagnostic> {
    if !tokens.is_name("LBL") {
        return Err(tokens.expected("LBL"));
    }
    let target = indexed(tokens)?;
    Ok(if let ExpressionKind::Name(label) = target.kind { label } else { ANY_LABEL.into() })
}
