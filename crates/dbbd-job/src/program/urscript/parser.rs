//! Parser of the routines of a script.

use crate::program::CompensationFinding;
use crate::program::Language;
use crate::program::ProgramFinding;
use crate::program::flow::Control;
use crate::program::lexer::Token;
use crate::program::script::expression::{Parameter, Routine, Statement, StatementKind};
use crate::program::text::Text;
use crate::program::tokens::Tokens;
use dbbd_model::diagnostic::Diagnostic;

/// An open block, which the next `end` closes.
enum Block {
    Routine(Routine),
    /// Any other block, with the control statement of its end.
    Other(Control),
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
    let mut open = vec![Block::Routine(outside)];
    let mut routines = Vec::new();
    while *tokens.peek() != Token::End {
        if *tokens.peek() == Token::LineEnd {
            tokens.advance();
            continue;
        }
        let start = tokens.position();
        if let Some(word) = ["def", "thread", "sec"].into_iter().find(|word| tokens.accept_name(word)) {
            let (name, parameters) = head(&mut tokens)?;
            let (is_local, is_concurrent) = (open.len() > 1, word == "thread");
            let body = Vec::new();
            open.push(Block::Routine(Routine { name, file: 0, is_local, is_concurrent, parameters, body }));
            continue;
        }
        if tokens.accept_name("end") {
            match open.pop() {
                Some(Block::Routine(routine)) if !open.is_empty() => routines.push(routine),
                Some(Block::Other(control)) => {
                    let kind = StatementKind::Control { word: "end".into(), control };
                    add(&mut open, Statement::new(&tokens, start, kind));
                }
                _ => return Err(text.wrong(&tokens.since(start), ProgramFinding::NoBlock)),
            }
            continue;
        }
        // A line that is not supported is skipped here, and refused if the program is executed.
        let kind = line(&mut tokens).unwrap_or_else(|_| {
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
        add(&mut open, Statement::new(&tokens, start, kind));
        open.extend(end.map(Block::Other));
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

/// Adds a statement to the innermost routine.
fn add(open: &mut [Block], statement: Statement) {
    let routine = open.iter_mut().rev().find_map(|block| match block {
        Block::Routine(routine) => Some(routine),
        Block::Other(_) => None,
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
    if matches!(tokens.peek(), Token::Name(word) if control(word).is_some()) {
        return Err(tokens.expected("a statement"));
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
