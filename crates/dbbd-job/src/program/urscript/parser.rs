//! Parser of the routines of a script.

use std::mem;

use crate::program::CompensationFinding;
use crate::program::Language;
use crate::program::ProgramFinding;
use crate::program::flow::Control;
use crate::program::lexer::Token;
use crate::program::script::expression::{Parameter, Routine, Statement, StatementKind};
use crate::program::text::Text;
use crate::program::tokens::Tokens;
use dbbd_model::diagnostic::Diagnostic;

/// A routine whose `end` has not come.
struct OpenRoutine {
    routine: Routine,
    /// Its open blocks, by the control statement of their end; the next `end` closes the last one.
    blocks: Vec<Control>,
}

/// Parses the routines of a script. A routine comes after the routines inside it; the last routine, without a name, has
/// the lines outside of any routine.
pub(super) fn parse(text: Text<'_>) -> Result<Vec<Routine>, Diagnostic> {
    let mut tokens = Tokens::new(text, Language::Urscript)?;
    let outside = Routine {
        name: String::new(),
        file: 0,
        is_local: false,
        is_concurrent: false,
        parameters: Vec::new(),
        body: Vec::new(),
    };
    let mut innermost = OpenRoutine { routine: outside, blocks: Vec::new() };
    let (mut around, mut routines) = (Vec::new(), Vec::new());
    while *tokens.peek() != Token::End {
        if *tokens.peek() == Token::LineEnd {
            tokens.advance();
            continue;
        }
        let start = tokens.position();
        if let Some(word) = ["def", "thread", "sec"].into_iter().find(|word| tokens.accept_name(word)) {
            let (name, parameters) = head(&mut tokens)?;
            let (is_local, is_concurrent) = (!around.is_empty(), word == "thread");
            let body = Vec::new();
            let routine = Routine { name, file: 0, is_local, is_concurrent, parameters, body };
            around.push(mem::replace(&mut innermost, OpenRoutine { routine, blocks: Vec::new() }));
            continue;
        }
        if tokens.accept_name("end") {
            if let Some(control) = innermost.blocks.pop() {
                let kind = StatementKind::Control { word: "end".into(), control };
                innermost.routine.body.push(Statement::new(&tokens, start, kind));
            } else if let Some(outer) = around.pop() {
                routines.push(mem::replace(&mut innermost, outer).routine);
            } else {
                return Err(text.wrong(&tokens.since(start), ProgramFinding::NoBlock));
            }
            continue;
        }
        // A line that is not supported is skipped here, and refused if the program is executed.
        let kind = line(&mut tokens).unwrap_or_else(|| {
            tokens.go_to(start);
            let mut first = tokens.next();
            if matches!(&first, Token::Name(word) if word == "global" || word == "local") {
                first = tokens.next();
            }
            let is_endless = is_true(&mut tokens);
            while !tokens.is_line_end() {
                tokens.advance();
            }
            let Token::Name(word) = first else { return StatementKind::Other("this line".into()) };
            match control(&word) {
                Some(Control::While) if is_endless => StatementKind::Control { word, control: Control::Loop },
                Some(control) => StatementKind::Control { word, control },
                None => StatementKind::Other(word),
            }
        });
        let end = if let StatementKind::Control { control, .. } = &kind {
            let is_choice = matches!(control, Control::If | Control::Cases);
            let is_loop = matches!(control, Control::While | Control::Loop);
            is_choice.then_some(Control::EndChoice).or(is_loop.then_some(Control::EndLoop))
        } else {
            None
        };
        innermost.routine.body.push(Statement::new(&tokens, start, kind));
        innermost.blocks.extend(end);
    }
    if !around.is_empty() || !innermost.blocks.is_empty() {
        return Err(tokens.expected("end"));
    }
    routines.push(innermost.routine);
    let is_script = routines.len() > 1 || routines.iter().any(|routine| routine.body.iter().any(is_call));
    if is_script {
        return Ok(routines);
    }
    Err(text.wrong(&(0..0), CompensationFinding::NotUrscript { begins: text.beginning() }))
}

/// Parses the name and the parameters of a routine after `def` or `thread`.
fn head(tokens: &mut Tokens<'_>) -> Result<(String, Vec<Parameter>), Diagnostic> {
    let (routine, _) = tokens.name()?;
    tokens.expect("(")?;
    let mut parameters = Vec::new();
    while !tokens.accept(")") {
        if !parameters.is_empty() {
            tokens.expect(",")?;
        }
        let (name, _) = tokens.name()?;
        let default = tokens.accept("=").then(|| tokens.expression()).transpose()?;
        parameters.push(Parameter { name, default, is_optional: false, is_reference: false });
    }
    tokens.expect(":")?;
    Ok((routine, parameters))
}

/// Reads the condition of an endless loop, `True`, if it is next.
fn is_true(tokens: &mut Tokens<'_>) -> bool {
    let bracket = tokens.accept("(");
    tokens.accept_name("True") && (!bracket || tokens.accept(")")) && tokens.accept(":")
}

/// The effect of a line that begins with this word on which line runs next.
fn control(word: &str) -> Option<Control> {
    Some(match word {
        "if" => Control::If,
        "elif" | "case" => Control::Way,
        "else" | "default" => Control::LastWay,
        "switch" => Control::Cases,
        "while" => Control::While,
        "break" => Control::Break,
        "continue" => Control::Continue,
        "return" | "halt" => Control::Return,
        _ => return None,
    })
}

fn is_call(statement: &Statement) -> bool {
    matches!(statement.kind, StatementKind::Call { .. })
}

/// A line that neither begins a routine nor ends a block, if it is supported.
fn line(tokens: &mut Tokens<'_>) -> Option<StatementKind> {
    if tokens.is_name("while") {
        return until_steady(tokens);
    }
    if matches!(tokens.peek(), Token::Name(word) if control(word).is_some()) {
        return None;
    }
    let scoped = tokens.accept_name("global") || tokens.accept_name("local");
    let (name, _) = tokens.name().ok()?;
    if tokens.accept("=") {
        let value = tokens.expression().ok()?;
        return tokens.is_line_end().then_some(StatementKind::Assign { name, components: Vec::new(), value });
    }
    if scoped || !tokens.accept("(") {
        return None;
    }
    let arguments = tokens.arguments(")", 0).ok()?;
    tokens.is_line_end().then_some(StatementKind::Call { name, arguments })
}

/// `while not is_steady(): sync() end`, a wait for standstill; `None` for any other loop.
fn until_steady(tokens: &mut Tokens<'_>) -> Option<StatementKind> {
    tokens.advance();
    let bracket = tokens.accept("(");
    let is_wait = tokens.accept_name("not")
        && tokens.accept_name("is_steady")
        && tokens.accept("(")
        && tokens.accept(")")
        && (!bracket || tokens.accept(")"))
        && tokens.accept(":");
    if !is_wait {
        return None;
    }
    loop {
        while *tokens.peek() == Token::LineEnd {
            tokens.advance();
        }
        if tokens.accept_name("end") {
            return Some(StatementKind::UntilSteady);
        }
        if !(tokens.accept_name("sync") && tokens.accept("(") && tokens.accept(")")) {
            return None;
        }
    }
}
