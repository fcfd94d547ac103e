//! The routines of a script.

use crate::catalogue::{CompensationFinding, ProgramFinding};
use crate::diagnostic::Diagnostic;
use crate::program::Language;
use crate::program::script::lexer::Token;
use crate::program::script::statement::{Kind, Routine, Statement};
use crate::program::script::value::Words;
use crate::program::text::Text;

/// What an `end` ends.
enum Block {
    Routine(Routine),
    Other,
}

/// Reads the routines of a script, those inside others after them; lines outside of any are those of the last, without a
/// name.
pub(super) fn parse(text: Text<'_>) -> Result<Vec<Routine>, Diagnostic> {
    let mut words = Words::new(text, Language::Urscript)?;
    let mut open = vec![Block::Routine(routine(String::new(), Vec::new()))];
    let mut routines = Vec::new();
    while *words.peek() != Token::End {
        if *words.peek() == Token::LineEnd {
            words.next();
            continue;
        }
        let place = words.place();
        if words.take_word("def") {
            open.push(Block::Routine(head(&mut words)?));
            continue;
        }
        if words.take_word("end") {
            match open.pop() {
                Some(Block::Routine(routine)) if !open.is_empty() => routines.push(routine),
                Some(Block::Other) => {
                    add(&mut open, Statement { span: words.since(place), kind: other("end") })
                }
                _ => return Err(text.wrong(&words.since(place), ProgramFinding::NoBlock)),
            }
            continue;
        }
        let kind = line(&mut words);
        let kind = kind.unwrap_or_else(|_| {
            words.go_to(place);
            let first = words.next();
            while !matches!(words.peek(), Token::LineEnd | Token::End) {
                words.next();
            }
            match first {
                Token::Name(name) => Kind::Other(name),
                _ => other("this line"),
            }
        });
        if let Kind::Other(word) = &kind
            && ["if", "while", "thread"].contains(&word.as_str())
        {
            open.push(Block::Other);
        }
        add(&mut open, Statement { span: words.since(place), kind });
    }
    match (open.pop(), open.is_empty()) {
        (Some(Block::Routine(routine)), true) => routines.push(routine),
        _ => return Err(words.expected("end")),
    }
    let is_script = routines.len() > 1 || routines.iter().any(|routine| routine.body.iter().any(is_call));
    if is_script {
        return Ok(routines);
    }
    let begins = text.text.lines().map(str::trim).find(|line| !line.is_empty()).unwrap_or("");
    let begins = begins.chars().take(40).collect();
    Err(text.wrong(&(0..0), CompensationFinding::NotUrscript { begins }))
}

fn routine(name: String, parameters: Vec<String>) -> Routine {
    Routine { name, file: 0, parameters, body: Vec::new() }
}

/// The routine that a line behind `def` begins; what a parameter is unless given is passed over.
fn head(words: &mut Words<'_>) -> Result<Routine, Diagnostic> {
    let name = words.name()?;
    words.expect("(")?;
    let mut parameters = Vec::new();
    while !words.take(")") {
        parameters.push(words.name()?);
        while !matches!(words.peek(), Token::Sign("," | ")") | Token::LineEnd | Token::End) {
            words.next();
        }
        words.take(",");
        if matches!(words.peek(), Token::LineEnd | Token::End) {
            return Err(words.expected("`)`"));
        }
    }
    words.expect(":")?;
    Ok(routine(name, parameters))
}

fn is_call(statement: &Statement) -> bool {
    matches!(statement.kind, Kind::Call { .. })
}

fn other(word: &str) -> Kind {
    Kind::Other(word.into())
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

/// A line that begins no routine and ends no block.
fn line(words: &mut Words<'_>) -> Result<Kind, Diagnostic> {
    if words.is_word("while") {
        return until_steady(words);
    }
    let scoped = words.take_word("global") || words.take_word("local");
    let name = words.name()?;
    if words.take("=") {
        let value = words.expression()?;
        ended(words)?;
        return Ok(Kind::Assign { name, value });
    }
    if scoped {
        return Err(words.expected("`=`"));
    }
    words.expect("(")?;
    let arguments = words.arguments(")", 0)?;
    ended(words)?;
    Ok(Kind::Call { name, arguments })
}

fn ended(words: &Words<'_>) -> Result<(), Diagnostic> {
    let ended = matches!(words.peek(), Token::LineEnd | Token::End);
    if ended { Ok(()) } else { Err(words.expected("the end of the line")) }
}

/// `while not is_steady(): sync() end`, over three lines: a wait for standstill. Another condition is an error.
fn until_steady(words: &mut Words<'_>) -> Result<Kind, Diagnostic> {
    words.next();
    let bracket = words.take("(");
    if !(words.take_word("not") && words.take_word("is_steady")) {
        return Err(words.expected("not is_steady()"));
    }
    words.expect("(")?;
    words.expect(")")?;
    if bracket {
        words.expect(")")?;
    }
    words.expect(":")?;
    loop {
        while *words.peek() == Token::LineEnd {
            words.next();
        }
        if words.take_word("end") {
            return Ok(Kind::UntilSteady);
        }
        if !(words.take_word("sync") && words.take("(") && words.take(")")) {
            return Err(words.expected("sync()"));
        }
    }
}
