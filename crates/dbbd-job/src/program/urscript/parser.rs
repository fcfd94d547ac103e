//! Parser of the routines of a script.

use crate::program::CompensationFinding;
use crate::program::Language;
use crate::program::ProgramFinding;
use crate::program::lexer::Token;
use crate::program::script::expression::{Routine, Statement, StatementKind};
use crate::program::text::Text;
use crate::program::tokens::Tokens;
use dbbd_model::diagnostic::Diagnostic;

/// A block that is open: what the next `end` ends.
enum Block {
    Routine(Routine),
    Other,
}

/// Parses the routines of a script. A routine follows those inside it; the last one, without a name, has the lines
/// outside of any.
pub(super) fn parse(text: Text<'_>) -> Result<Vec<Routine>, Diagnostic> {
    let mut tokens = Tokens::new(text, Language::Urscript)?;
    let mut open = vec![Block::Routine(routine(String::new(), Vec::new()))];
    let mut routines = Vec::new();
    while *tokens.peek() != Token::End {
        if *tokens.peek() == Token::LineEnd {
            tokens.advance();
            continue;
        }
        let start = tokens.position();
        if tokens.accept_name("def") {
            open.push(Block::Routine(head(&mut tokens)?));
            continue;
        }
        if tokens.accept_name("end") {
            match open.pop() {
                Some(Block::Routine(routine)) if !open.is_empty() => routines.push(routine),
                Some(Block::Other) => {
                    add(&mut open, Statement { span: tokens.since(start), kind: other("end") })
                }
                _ => return Err(text.wrong(&tokens.since(start), ProgramFinding::NoBlock)),
            }
            continue;
        }
        // A line that is not supported is skipped here, and refused if the program is executed.
        let kind = line(&mut tokens).unwrap_or_else(|_| {
            tokens.go_to(start);
            let first = tokens.next();
            while !tokens.is_line_end() {
                tokens.advance();
            }
            if let Token::Name(name) = first { StatementKind::Other(name) } else { other("this line") }
        });
        if let StatementKind::Other(word) = &kind
            && ["if", "while", "thread"].contains(&word.as_str())
        {
            open.push(Block::Other);
        }
        add(&mut open, Statement { span: tokens.since(start), kind });
    }
    match (open.pop(), open.is_empty()) {
        (Some(Block::Routine(routine)), true) => routines.push(routine),
        _ => return Err(tokens.expected("end")),
    }
    let is_script = routines.len() > 1 || routines.iter().any(|routine| routine.body.iter().any(is_call));
    if is_script {
        return Ok(routines);
    }
    Err(text.wrong(&(0..0), CompensationFinding::NotUrscript { begins: text.beginning() }))
}

fn routine(name: String, parameters: Vec<String>) -> Routine {
    Routine { name, file: 0, is_local: false, parameters, body: Vec::new() }
}

/// After `def`: the head of a routine. Default values of parameters are skipped.
fn head(tokens: &mut Tokens<'_>) -> Result<Routine, Diagnostic> {
    let (name, _) = tokens.name()?;
    tokens.expect("(")?;
    let mut parameters = Vec::new();
    while !tokens.accept(")") {
        parameters.push(tokens.name()?.0);
        while !matches!(tokens.peek(), Token::Sign("," | ")") | Token::LineEnd | Token::End) {
            tokens.advance();
        }
        tokens.accept(",");
        if tokens.is_line_end() {
            return Err(tokens.expected("`)`"));
        }
    }
    tokens.expect(":")?;
    Ok(routine(name, parameters))
}

fn is_call(statement: &Statement) -> bool {
    matches!(statement.kind, StatementKind::Call { .. })
}

fn other(word: &str) -> StatementKind {
    StatementKind::Other(word.into())
}

/// Adds a statement to the innermost routine.
fn add(open: &mut [Block], statement: Statement) {
    let routine = open.iter_mut().rev().find_map(|block| match block {
        Block::Routine(routine) => Some(routine),
        Block::Other => None,
    });
    if let Some(routine) = routine {
        routine.body.push(statement);
    }
}

/// A line that neither begins a routine nor ends a block.
fn line(tokens: &mut Tokens<'_>) -> Result<StatementKind, Diagnostic> {
    if tokens.is_name("while") {
        return until_steady(tokens);
    }
    let scoped = tokens.accept_name("global") || tokens.accept_name("local");
    let (name, _) = tokens.name()?;
    if tokens.accept("=") {
        let value = tokens.expression()?;
        line_end(tokens)?;
        return Ok(StatementKind::Assign { name, value });
    }
    if scoped {
        return Err(tokens.expected("`=`"));
    }
    tokens.expect("(")?;
    let arguments = tokens.arguments(")", 0)?;
    line_end(tokens)?;
    Ok(StatementKind::Call { name, arguments })
}

fn line_end(tokens: &Tokens<'_>) -> Result<(), Diagnostic> {
    if tokens.is_line_end() { Ok(()) } else { Err(tokens.expected("the end of the line")) }
}

/// `while not is_steady(): sync() end`, a wait for standstill. Any other loop is an error.
fn until_steady(tokens: &mut Tokens<'_>) -> Result<StatementKind, Diagnostic> {
    tokens.advance();
    let bracket = tokens.accept("(");
    if !(tokens.accept_name("not") && tokens.accept_name("is_steady")) {
        return Err(tokens.expected("not is_steady()"));
    }
    tokens.expect("(")?;
    tokens.expect(")")?;
    if bracket {
        tokens.expect(")")?;
    }
    tokens.expect(":")?;
    loop {
        while *tokens.peek() == Token::LineEnd {
            tokens.advance();
        }
        if tokens.accept_name("end") {
            return Ok(StatementKind::UntilSteady);
        }
        if !(tokens.accept_name("sync") && tokens.accept("(") && tokens.accept(")")) {
            return Err(tokens.expected("sync()"));
        }
    }
}
