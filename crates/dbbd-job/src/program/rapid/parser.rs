//! Parser of a RAPID module: its data and routines.

use crate::program::CompensationFinding;
use crate::program::Language;
use crate::program::ProgramFinding;
use crate::program::flow::Control;
use crate::program::lexer::Token;
use crate::program::script::expression::{Expression, Parameter, Routine, Statement, StatementKind};
use crate::program::text::Text;
use crate::program::tokens::Tokens;
use dbbd_model::diagnostic::Diagnostic;

/// A declaration with its value.
#[derive(Clone, Debug)]
pub(super) struct Declared {
    /// Name of the data, in capitals.
    pub(super) name: String,
    pub(super) value: Expression,
    /// Whether other modules cannot see the data.
    pub(super) is_local: bool,
}

#[derive(Clone, Debug)]
pub(super) struct Module {
    pub(super) data: Vec<Declared>,
    /// The procedures and TRAPs.
    pub(super) routines: Vec<Routine>,
    pub(super) functions: Vec<Routine>,
}

/// A call of a routine whose name is computed: `%"name"%`.
const CALL_BY_NAME: &str = "a call by name";
/// The calls of routines whose names are computed.
pub(super) const LATE_BOUND: [&str; 2] = [CALL_BY_NAME, "CALLBYVAR"];

/// The keywords that end a routine.
const ENDS: [&str; 3] = ["ENDPROC", "ENDFUNC", "ENDTRAP"];

/// Parses the module of the file with this index.
pub(super) fn parse(text: Text<'_>, file: usize) -> Result<Module, Diagnostic> {
    let mut tokens = Tokens::new(text, Language::Rapid)?;
    while !tokens.is_name("MODULE") {
        if *tokens.peek() == Token::End {
            let not_rapid = CompensationFinding::NotRapid { begins: text.beginning() };
            return Err(text.wrong(&(0..0), not_rapid));
        }
        tokens.advance();
    }
    tokens.advance();
    let (name, span) = tokens.name()?;
    if tokens.accept("(") {
        tokens.arguments(")", 0)?;
    }
    let mut module = Module { data: Vec::new(), routines: Vec::new(), functions: Vec::new() };
    while !tokens.accept_name("ENDMODULE") {
        if *tokens.peek() == Token::End {
            return Err(tokens.expected("ENDMODULE"));
        }
        item(&mut tokens, &mut module, file)?;
    }
    if module.routines.iter().any(|routine| routine.name == name) {
        return Err(text.wrong(&span, ProgramFinding::ModuleNamedAsRoutine { name }));
    }
    Ok(module)
}

/// A declaration or a routine.
fn item(tokens: &mut Tokens<'_>, module: &mut Module, file: usize) -> Result<(), Diagnostic> {
    let is_local = tokens.accept_name("LOCAL");
    tokens.accept_name("TASK");
    if ["CONST", "PERS", "VAR"].into_iter().any(|word| tokens.accept_name(word)) {
        if let (name, Some(value)) = declaration(tokens)? {
            module.data.push(Declared { name, value, is_local });
        }
        return Ok(());
    }
    let is_trap = tokens.is_name("TRAP");
    if is_trap || tokens.is_name("PROC") {
        tokens.advance();
        let is_concurrent = is_trap;
        module.routines.push(Routine { is_concurrent, ..routine(tokens, file, is_local)? });
    } else if tokens.accept_name("FUNC") {
        tokens.name()?;
        module.functions.push(routine(tokens, file, is_local)?);
    } else if tokens.accept_name("RECORD") {
        while !tokens.accept_name("ENDRECORD") && *tokens.peek() != Token::End {
            tokens.advance();
        }
    } else if tokens.accept_name("ALIAS") {
        skip(tokens);
    } else {
        return Err(tokens.expected("a declaration, PROC, FUNC, TRAP or ENDMODULE"));
    }
    Ok(())
}

/// Parses a declaration after CONST, PERS or VAR: the name with its value, if it has one that can be parsed.
fn declaration(tokens: &mut Tokens<'_>) -> Result<(String, Option<Expression>), Diagnostic> {
    tokens.name()?;
    let (name, _) = tokens.name()?;
    let is_array = tokens.accept("{");
    let value = (!is_array && tokens.accept(":=")).then(|| tokens.expression()).transpose();
    let value = value.ok().flatten();
    skip(tokens);
    Ok((name, value))
}

/// Skips everything up to the next semicolon and the semicolon.
fn skip(tokens: &mut Tokens<'_>) {
    while *tokens.peek() != Token::End && !tokens.accept(";") {
        tokens.advance();
    }
}

/// Parses a routine after PROC, TRAP or the type of a FUNC.
fn routine(tokens: &mut Tokens<'_>, file: usize, is_local: bool) -> Result<Routine, Diagnostic> {
    let (name, _) = tokens.name()?;
    let parameters = if tokens.accept("(") { parameters(tokens)? } else { Vec::new() };
    let mut body = Vec::new();
    // The number of IFs without THEN that end after the next statement.
    let mut compact = 0;
    loop {
        if ENDS.into_iter().any(|end| tokens.accept_name(end)) {
            return Ok(Routine { name, file, is_local, is_concurrent: false, parameters, body });
        }
        if tokens.is_name("ENDMODULE") || *tokens.peek() == Token::End {
            return Err(tokens.expected("ENDPROC"));
        }
        let start = tokens.position();
        // A statement that is not supported is skipped here, and refused if the program is executed.
        let kind = statement(tokens).unwrap_or_else(|_| {
            tokens.go_to(start);
            let first = tokens.next();
            skip(tokens);
            Some(StatementKind::Other(if let Token::Name(name) = first {
                name
            } else if first == Token::Sign("%") {
                CALL_BY_NAME.into()
            } else {
                "this statement".into()
            }))
        });
        let is_if = matches!(&kind, Some(StatementKind::Control { control: Control::If, .. }));
        let is_compact = is_if && !tokens.has_read_name("THEN");
        body.extend(kind.map(|kind| Statement::new(tokens, start, kind)));
        if is_compact {
            compact += 1;
            continue;
        }
        for _ in 0..std::mem::take(&mut compact) {
            let end = StatementKind::Control { word: "IF".into(), control: Control::EndChoice };
            body.push(Statement::new(tokens, tokens.position(), end));
        }
    }
}

/// Parses the parameters of a routine after the opening bracket.
fn parameters(tokens: &mut Tokens<'_>) -> Result<Vec<Parameter>, Diagnostic> {
    let mut parameters = Vec::new();
    let (mut last, mut is_optional, mut is_reference) = (None, false, false);
    let mut add = |last: &mut Option<String>, is_optional: bool, is_reference: bool| {
        let named = last.take();
        parameters.extend(named.map(|name| Parameter { name, default: None, is_optional, is_reference }));
    };
    loop {
        match tokens.next() {
            Token::Name(name) if ["INOUT", "VAR", "PERS"].contains(&name.as_str()) => is_reference = true,
            Token::Name(name) => last = Some(name),
            Token::Sign("\\") => {
                add(&mut last, is_optional, is_reference);
                (is_optional, is_reference) = (true, false);
            }
            Token::Sign("|") => {
                add(&mut last, is_optional, is_reference);
                is_reference = false;
            }
            Token::Sign(",") => {
                add(&mut last, is_optional, is_reference);
                (is_optional, is_reference) = (false, false);
            }
            Token::Sign(")") => break,
            Token::End => return Err(tokens.expected("`)`")),
            Token::Enum(_)
            | Token::Int(_)
            | Token::Real(_)
            | Token::Text(_)
            | Token::Sign(_)
            | Token::LineEnd => {}
        }
    }
    add(&mut last, is_optional, is_reference);
    Ok(parameters)
}

/// A statement, or the head of a compound one.
fn statement(tokens: &mut Tokens<'_>) -> Result<Option<StatementKind>, Diagnostic> {
    if tokens.accept(";") {
        return Ok(None);
    }
    let (name, _) = tokens.name()?;
    let head = |tokens: &mut Tokens<'_>, end: &str| -> Result<(), Diagnostic> {
        while !tokens.accept_name(end) {
            if matches!(tokens.peek(), Token::End | Token::Sign(";")) {
                return Err(tokens.expected(end));
            }
            tokens.advance();
        }
        Ok(())
    };
    let control = match name.as_str() {
        "IF" => {
            let condition = tokens.position();
            // Without THEN the condition applies to one statement, which follows and is parsed by itself.
            if head(tokens, "THEN").is_err() {
                tokens.go_to(condition);
                tokens.expression()?;
            }
            Control::If
        }
        "ELSEIF" => {
            head(tokens, "THEN")?;
            Control::Way
        }
        "FOR" | "WHILE" => {
            head(tokens, "DO")?;
            Control::While
        }
        "TEST" => {
            tokens.expression()?;
            Control::Cases
        }
        "CASE" => {
            while !tokens.accept(":") && !matches!(tokens.next(), Token::End) {}
            Control::Way
        }
        "DEFAULT" => {
            tokens.accept(":");
            Control::LastWay
        }
        "ELSE" => Control::LastWay,
        "ENDIF" | "ENDTEST" => Control::EndChoice,
        "ENDFOR" | "ENDWHILE" => Control::EndLoop,
        "ERROR" | "BACKWARD" | "UNDO" => Control::Handler,
        "RETRY" | "TRYNEXT" => {
            skip(tokens);
            Control::Resume
        }
        "GOTO" => {
            let (label, _) = tokens.name()?;
            skip(tokens);
            Control::Goto(label)
        }
        "RETURN" | "RAISE" | "EXIT" | "EXITCYCLE" => {
            skip(tokens);
            Control::Return
        }
        "CONNECT" => {
            skip(tokens);
            return Ok(Some(StatementKind::Other(name)));
        }
        "CONST" | "PERS" | "VAR" => {
            let (name, value) = declaration(tokens)?;
            return Ok(Some(StatementKind::Declare { name, value }));
        }
        _ if matches!(tokens.peek(), Token::Sign(":=" | ".")) => {
            let mut components = Vec::new();
            while tokens.accept(".") {
                components.push(tokens.name()?.0);
            }
            tokens.expect(":=")?;
            let value = tokens.expression()?;
            tokens.expect(";")?;
            return Ok(Some(StatementKind::Assign { name, components, value }));
        }
        _ if tokens.accept(":") => Control::Label(name.clone()),
        _ => {
            let arguments = tokens.arguments(";", 0)?;
            return Ok(Some(StatementKind::Call { name, arguments }));
        }
    };
    Ok(Some(StatementKind::Control { word: name, control }))
}
