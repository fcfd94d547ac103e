//! Parser of the motion instructions: their points, speed, termination and options.

use super::operand::{indexed, label};
use crate::program::flow::Control;
use crate::program::lexer::Token;
use crate::program::script::expression::{Argument, Expression, ExpressionKind, StatementKind};
use crate::program::tokens::Tokens;
use dbbd_model::diagnostic::Diagnostic;

/// Parses a motion after `J`, `L` or `C`. The result is a call: first the points, then an argument for each further
/// part, named by the unit of the speed, by the termination or by the option.
pub(super) fn motion(tokens: &mut Tokens<'_>, motion: &str) -> Result<Vec<StatementKind>, Diagnostic> {
    let mut arguments = Vec::new();
    let points = if motion == "C" { 2 } else { 1 };
    for _ in 0..points {
        if !tokens.is_name("P") && !tokens.is_name("PR") {
            return Err(tokens.expected("a position"));
        }
        arguments.push(Argument { name: None, value: Some(indexed(tokens)?) });
    }
    arguments.push(speed(tokens)?);
    arguments.push(termination(tokens)?);
    let mut after = Vec::new();
    while !matches!(tokens.peek(), Token::End | Token::Sign(";")) {
        if tokens.accept_name("SKIP") {
            tokens.expect(",")?;
            let label = label(tokens)?;
            let controls = [Control::If, Control::Goto(label), Control::EndChoice];
            after.extend(controls.map(|control| StatementKind::Control { word: "SKIP".into(), control }));
            if tokens.accept(",") {
                after.insert(0, taught(tokens)?);
            }
            continue;
        }
        arguments.extend(option(tokens));
    }
    let call = StatementKind::Call { name: motion.to_owned(), arguments };
    Ok([call].into_iter().chain(after).collect())
}

/// Parses the part after the label of `Skip`: the register that takes the position.
fn taught(tokens: &mut Tokens<'_>) -> Result<StatementKind, Diagnostic> {
    let register = indexed(tokens)?;
    tokens.expect("=")?;
    tokens.name()?;
    let name = if let ExpressionKind::Name(name) = register.kind { name } else { "PR[]".into() };
    let value = Some(Expression { span: register.span, kind: ExpressionKind::Computed });
    Ok(StatementKind::Call { name, arguments: vec![Argument { name: None, value }] })
}

/// Parses a speed: `50%`, `200mm/sec`, `R[1]mm/sec`, `2500msec`, or a word.
fn speed(tokens: &mut Tokens<'_>) -> Result<Argument, Diagnostic> {
    let start = tokens.position();
    let kind = if let Token::Real(number) = *tokens.peek() {
        tokens.advance();
        ExpressionKind::Number(number)
    } else if *tokens.ahead(1) == Token::Sign("[") {
        indexed(tokens)?.kind
    } else {
        let (name, _) = tokens.name()?;
        return Ok(Argument { name: Some(name), value: None });
    };
    let value = Some(Expression { span: tokens.since(start), kind });
    let mut unit = String::from("%");
    if !tokens.accept("%") {
        unit = tokens.name()?.0;
        if tokens.accept("/") {
            unit = format!("{unit}/{}", tokens.name()?.0);
        }
    }
    Ok(Argument { name: Some(unit), value })
}

/// Parses a termination: `FINE`, `CNT50` or `CNT R[9]`.
fn termination(tokens: &mut Tokens<'_>) -> Result<Argument, Diagnostic> {
    let (name, _) = tokens.name()?;
    if !["FINE", "CNT", "CR", "CD"].contains(&without_number(&name)) {
        return Err(tokens.expected("FINE or CNT"));
    }
    if *tokens.ahead(1) == Token::Sign("[") && tokens.is_name("R") {
        indexed(tokens)?;
    }
    Ok(Argument { name: Some(name), value: None })
}

/// The word of an option: `ACC` of `ACC80`.
pub(super) fn without_number(word: &str) -> &str {
    word.trim_end_matches(|c: char| c.is_ascii_digit())
}

/// The next word of the options, if it names an option. Text in brackets, after a comma, `=` or a number belongs to the option
/// before.
fn option(tokens: &mut Tokens<'_>) -> Option<Argument> {
    const REGISTERS: [&str; 5] = ["R", "AR", "PR", "SR", "VR"];
    let found = tokens.next();
    if matches!(found, Token::Sign("[")) {
        skip_brackets(tokens);
        return None;
    }
    if matches!(found, Token::Sign("," | "=") | Token::Real(_)) {
        if !matches!(found, Token::Real(_)) {
            tokens.accept_name("CALL");
        }
        if matches!(tokens.peek(), Token::Name(_)) {
            word(tokens);
        }
        return None;
    }
    let Token::Name(first) = found else { return None };
    let is_register = *tokens.peek() == Token::Sign("[") && REGISTERS.contains(&first.as_str());
    let name = joined(tokens, first);
    (!is_register).then_some(Argument { name: Some(name), value: None })
}

/// Skips the text up to the bracket that closes the one that was read.
fn skip_brackets(tokens: &mut Tokens<'_>) {
    let mut depth = 1;
    while depth > 0 && !matches!(tokens.peek(), Token::End | Token::Sign(";")) {
        if tokens.accept("[") {
            depth += 1;
        } else if tokens.accept("]") {
            depth -= 1;
        } else {
            tokens.advance();
        }
    }
}

/// Reads a word.
fn word(tokens: &mut Tokens<'_>) -> String {
    let Token::Name(first) = tokens.next() else { return String::new() };
    joined(tokens, first)
}

/// A word with its further parts: `P-SPS`, `Ind.EV`.
fn joined(tokens: &mut Tokens<'_>, first: String) -> String {
    let mut name = first;
    while let (Token::Sign(sign @ ("-" | ".")), Token::Name(next)) =
        (tokens.peek().clone(), tokens.ahead(1).clone())
    {
        tokens.advance();
        tokens.advance();
        name = format!("{name}{sign}{next}");
    }
    name
}
