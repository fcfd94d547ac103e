//! Parser of a listing: its statements and positions.

use std::collections::HashMap;

use super::layout::ListingLayout;
use super::motion::motion;
use super::operand::{ANY_LABEL, indexed, label, number};
use super::position::positions;
use crate::program::Language;
use crate::program::flow::Control;
use crate::program::lexer::Token;
use crate::program::script::expression::{
    Argument, Expression, ExpressionKind, Routine, Statement, StatementKind,
};
use crate::program::script::value::{Content, Value};
use crate::program::text::Text;
use crate::program::tokens::Tokens;
use dbbd_model::diagnostic::Diagnostic;

#[derive(Clone, Debug)]
pub(super) struct TpProgram {
    pub(super) routine: Routine,
    /// The positions by their names: `P[3]`.
    pub(super) positions: HashMap<String, Value>,
    /// The numbers of remarks such as `!DBBLEN 300.000`, by the word before them; several numbers of one word are a
    /// list.
    pub(super) remarks: HashMap<String, Value>,
}

/// Parses the listing of the file with this index.
pub(super) fn parse(text: Text<'_>, file: usize) -> Result<TpProgram, Diagnostic> {
    let layout = ListingLayout::new(text)?;
    let mut tokens = Tokens::new(Text { text: &layout.code, ..text }, Language::Fanuc)?;
    tokens.file = text;
    let mut body = Vec::new();
    let mut is_selecting = false;
    while *tokens.peek() != Token::End && tokens.span().start < layout.positions {
        if tokens.accept(";") {
            continue;
        }
        let start = tokens.position();
        let selected = is_selecting && (*tokens.peek() == Token::Sign("=") || is_last_choice(&tokens));
        if std::mem::replace(&mut is_selecting, selected) && !selected {
            body.push(Statement { called: Vec::new(), ..Statement::new(&tokens, start, end_choice()) });
        }
        // A statement that is not supported is skipped here, and refused if the program is executed.
        let kinds = statement(&mut tokens, &mut is_selecting)
            .and_then(|kinds| tokens.expect(";").map(|()| kinds))
            .unwrap_or_else(|_| {
                tokens.go_to(start);
                let first = tokens.next();
                skip(&mut tokens);
                tokens.accept(";");
                vec![StatementKind::Other(if let Token::Name(name) = first {
                    name
                } else {
                    "this statement".into()
                })]
            });
        for kind in kinds {
            let called = called(&kind);
            body.push(Statement { called, ..Statement::new(&tokens, start, kind) });
        }
    }
    if is_selecting {
        let start = tokens.position();
        body.push(Statement { called: Vec::new(), ..Statement::new(&tokens, start, end_choice()) });
    }
    let body = with_targets(body);
    let routine = Routine {
        name: layout.name.clone(),
        file,
        is_local: false,
        is_concurrent: false,
        parameters: Vec::new(),
        body,
    };
    let positions = positions(&mut tokens, file).into_iter().collect();
    Ok(TpProgram { routine, positions, remarks: remarks(&layout, file) })
}

fn with_targets(body: Vec<Statement>) -> Vec<Statement> {
    let label = |statement: &Statement| match &statement.kind {
        StatementKind::Control { control: Control::Label(label), .. } => Some(label.clone()),
        StatementKind::Control { .. }
        | StatementKind::Call { .. }
        | StatementKind::Assign { .. }
        | StatementKind::Declare { .. }
        | StatementKind::UntilSteady
        | StatementKind::Other(_) => None,
    };
    let labels: Vec<String> = body.iter().filter_map(label).collect();
    let mut whole = Vec::with_capacity(body.len());
    for statement in body {
        let is_any = matches!(&statement.kind, StatementKind::Control { control: Control::Goto(to), .. } if to == ANY_LABEL);
        if !is_any {
            whole.push(statement);
            continue;
        }
        let ways = labels.iter().flat_map(|label| [Control::Way, Control::Goto(label.clone())]);
        let all = [Control::Cases].into_iter().chain(ways).chain([Control::EndChoice]);
        whole.extend(all.map(|control| Statement { kind: control_of("JMP", control), ..statement.clone() }));
    }
    whole
}

fn control_of(word: &str, control: Control) -> StatementKind {
    StatementKind::Control { word: word.into(), control }
}

fn end_choice() -> StatementKind {
    control_of("SELECT", Control::EndChoice)
}

/// The programs that a statement calls.
fn called(kind: &StatementKind) -> Vec<String> {
    match kind {
        StatementKind::Call { name, .. } if !is_instruction(name) => vec![name.clone()],
        StatementKind::Call { .. }
        | StatementKind::Assign { .. }
        | StatementKind::Declare { .. }
        | StatementKind::UntilSteady
        | StatementKind::Control { .. }
        | StatementKind::Other(_) => Vec::new(),
    }
}

/// Whether the name of a call is the name of an instruction or of a setting, not of a program.
pub(super) fn is_instruction(name: &str) -> bool {
    const WORDS: [&str; 9] =
        ["J", "L", "C", "WAIT", "PAUSE", "MESSAGE", "UFRAME_NUM", "UTOOL_NUM", "OVERRIDE"];
    WORDS.contains(&name) || name.contains(['[', '$'])
}

fn remarks(layout: &ListingLayout, file: usize) -> HashMap<String, Value> {
    let mut remarks: HashMap<String, Value> = HashMap::new();
    let value = |content| Value { file, span: 0..0, name: None, content };
    for remark in &layout.remarks {
        let mut words = remark.split_whitespace();
        let (Some(word), Some(Ok(number)), None) = (words.next(), words.next().map(str::parse), words.next())
        else {
            continue;
        };
        let number = value(Content::Number(number));
        match remarks.remove(word) {
            None => _ = remarks.insert(word.to_owned(), number),
            Some(before) => {
                let mut list = before.list().map_or_else(|| vec![before.clone()], <[Value]>::to_vec);
                list.push(number);
                remarks.insert(word.to_owned(), value(Content::List(list)));
            }
        }
    }
    remarks
}

/// Skips everything up to the next semicolon.
fn skip(tokens: &mut Tokens<'_>) {
    while !matches!(tokens.peek(), Token::End | Token::Sign(";")) {
        tokens.advance();
    }
}

fn is_last_choice(tokens: &Tokens<'_>) -> bool {
    tokens.is_name("ELSE") && *tokens.ahead(1) == Token::Sign(",")
}

/// The right side of an assignment; anything but a number, a register or a position is read as computed.
fn value(tokens: &mut Tokens<'_>) -> Expression {
    let start = tokens.position();
    let simple = if matches!(tokens.peek(), Token::Name(_)) && *tokens.ahead(1) == Token::Sign("[") {
        indexed(tokens).map(|expression| expression.kind)
    } else if matches!(tokens.peek(), Token::Name(_)) {
        tokens.name().map(|(name, _)| ExpressionKind::Name(name))
    } else {
        number(tokens).map(ExpressionKind::Number)
    };
    let ends = |tokens: &Tokens<'_>| matches!(tokens.peek(), Token::End | Token::Sign(";" | ","));
    let kind = simple.ok().filter(|_| ends(tokens)).unwrap_or_else(|| {
        while !ends(tokens) {
            tokens.advance();
        }
        ExpressionKind::Computed
    });
    Expression { span: tokens.since(start), kind }
}

fn given(value: Expression) -> Argument {
    Argument { name: None, value: Some(value) }
}

/// Parses a statement up to its semicolon.
fn statement(tokens: &mut Tokens<'_>, is_selecting: &mut bool) -> Result<Vec<StatementKind>, Diagnostic> {
    let start = tokens.position();
    if *is_selecting {
        let control = if tokens.accept("=") {
            value(tokens);
            Control::Way
        } else {
            tokens.advance();
            Control::LastWay
        };
        tokens.expect(",")?;
        return chosen(tokens, [control_of("SELECT", control)], []);
    }
    let (name, _) = tokens.name()?;
    let control = |control| Ok(vec![control_of(&name, control)]);
    match name.as_str() {
        "J" | "L" | "C" => motion(tokens, &name),
        "CALL" => {
            let (name, _) = tokens.name()?;
            let arguments = if tokens.accept("(") { tokens.arguments(")", 0)? } else { Vec::new() };
            Ok(vec![StatementKind::Call { name, arguments }])
        }
        "LBL" => {
            tokens.go_to(start);
            let label = label(tokens)?;
            control(Control::Label(label))
        }
        "JMP" => {
            let label = label(tokens)?;
            control(Control::Goto(label))
        }
        "IF" => condition(tokens),
        "ELSE" => control(Control::LastWay),
        "ENDIF" => control(Control::EndChoice),
        "SELECT" => {
            while !tokens.accept(",") {
                if matches!(tokens.next(), Token::End | Token::Sign(";")) {
                    return Err(tokens.expected("`,`"));
                }
            }
            *is_selecting = true;
            chosen(tokens, [control_of("SELECT", Control::Cases), control_of("SELECT", Control::Way)], [])
        }
        "FOR" => {
            skip(tokens);
            control(Control::While)
        }
        "ENDFOR" => control(Control::EndLoop),
        "END" | "ABORT" => control(Control::Return),
        "WAIT" => wait(tokens),
        "PAUSE" => Ok(vec![StatementKind::Call { name, arguments: Vec::new() }]),
        "MESSAGE" => {
            skip(tokens);
            Ok(vec![StatementKind::Call { name, arguments: Vec::new() }])
        }
        _ => {
            tokens.go_to(start);
            assignment(tokens)
        }
    }
}

/// The action of a choice, between the statements that open and close the choice.
fn chosen<const N: usize, const M: usize>(
    tokens: &mut Tokens<'_>,
    before: [StatementKind; N],
    after: [StatementKind; M],
) -> Result<Vec<StatementKind>, Diagnostic> {
    let action = statement(tokens, &mut false)?;
    Ok(before.into_iter().chain(action).chain(after).collect())
}

/// Parses the part after `IF`: `(..) THEN`, or a condition with the action that follows its comma.
fn condition(tokens: &mut Tokens<'_>) -> Result<Vec<StatementKind>, Diagnostic> {
    let mut depth = 0;
    loop {
        match tokens.next() {
            Token::Sign("(" | "[") => depth += 1,
            Token::Sign(")" | "]") => depth -= 1,
            Token::Sign(",") if depth == 0 => {
                return chosen(
                    tokens,
                    [control_of("IF", Control::If)],
                    [control_of("IF", Control::EndChoice)],
                );
            }
            Token::Name(name) if depth == 0 && name == "THEN" => {
                return Ok(vec![control_of("IF", Control::If)]);
            }
            Token::Sign(";") | Token::End => return Err(tokens.expected("THEN or an action")),
            Token::Name(_)
            | Token::Enum(_)
            | Token::Int(_)
            | Token::Real(_)
            | Token::Text(_)
            | Token::Sign(_)
            | Token::LineEnd => {}
        }
    }
}

/// Parses the part after `WAIT`: a time, or a condition that may jump after a time.
fn wait(tokens: &mut Tokens<'_>) -> Result<Vec<StatementKind>, Diagnostic> {
    let start = tokens.position();
    let time = value(tokens);
    let is_time = matches!(time.kind, ExpressionKind::Name(_)) && *tokens.peek() == Token::Sign(";");
    if is_time {
        return Ok(vec![StatementKind::Call { name: "WAIT".into(), arguments: vec![given(time)] }]);
    }
    tokens.go_to(start);
    if let Ok(seconds) = number(tokens)
        && tokens.accept("(")
        && tokens.accept_name("SEC")
        && tokens.accept(")")
    {
        let seconds = Expression { span: tokens.since(start), kind: ExpressionKind::Number(seconds) };
        return Ok(vec![StatementKind::Call { name: "WAIT".into(), arguments: vec![given(seconds)] }]);
    }
    let mut kinds = vec![StatementKind::Other("WAIT".into())];
    while !matches!(tokens.peek(), Token::End | Token::Sign(";")) {
        if tokens.accept_name("TIMEOUT") {
            tokens.accept(",");
            let label = label(tokens)?;
            let controls = [Control::If, Control::Goto(label), Control::EndChoice];
            kinds.extend(controls.map(|control| control_of("WAIT", control)));
        } else {
            tokens.advance();
        }
    }
    Ok(kinds)
}

/// Parses a setting of the controller or of a register: a call with the name of the setting. If only an element is set,
/// the whole setting is computed.
fn assignment(tokens: &mut Tokens<'_>) -> Result<Vec<StatementKind>, Diagnostic> {
    let start = tokens.position();
    let (mut name, _) = tokens.name()?;
    let mut is_whole = true;
    if name.starts_with('$') {
        while !matches!(tokens.peek(), Token::End | Token::Sign(";" | "=")) {
            tokens.advance();
        }
        is_whole = false;
    } else if *tokens.peek() == Token::Sign("[") {
        is_whole = *tokens.ahead(2) == Token::Sign("]");
        let index =
            if let Token::Real(number) = tokens.ahead(1) { number.to_string() } else { String::new() };
        name = format!("{name}[{index}]");
        tokens.go_to(start);
        indexed(tokens)?;
    }
    if !tokens.accept("=") {
        if name.starts_with("PAYLOAD[") {
            return Ok(vec![StatementKind::Call { name, arguments: Vec::new() }]);
        }
        return Err(tokens.expected("`=`"));
    }
    let start = tokens.position();
    let mut argument = given(value(tokens));
    if let Some(Expression { kind: ExpressionKind::Name(word), .. }) = &argument.value
        && word == "PULSE"
    {
        argument.name = Some(word.clone());
        argument.value = None;
        if tokens.accept(",") {
            let seconds = number(tokens)?;
            tokens.expect_name("SEC")?;
            argument.value =
                Some(Expression { span: tokens.since(start), kind: ExpressionKind::Number(seconds) });
        }
    }
    if !is_whole && let Some(value) = &mut argument.value {
        value.kind = ExpressionKind::Computed;
    }
    Ok(vec![StatementKind::Call { name, arguments: vec![argument] }])
}
