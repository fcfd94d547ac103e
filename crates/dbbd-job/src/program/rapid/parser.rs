//! Parser of a RAPID module: its data and routines.

use crate::program::CompensationFinding;
use crate::program::Language;
use crate::program::ProgramFinding;
use crate::program::lexer::Token;
use crate::program::script::expression::{Expression, Routine, Statement, StatementKind};
use crate::program::text::Text;
use crate::program::tokens::Tokens;
use dbbd_model::diagnostic::Diagnostic;

/// A declaration with its value.
#[derive(Clone, Debug)]
pub(super) struct Declared {
    /// In capitals.
    pub(super) name: String,
    pub(super) value: Expression,
    /// Whether it is invisible in other modules.
    pub(super) is_local: bool,
}

#[derive(Clone, Debug)]
pub(super) struct Module {
    pub(super) data: Vec<Declared>,
    pub(super) routines: Vec<Routine>,
}

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
    let mut module = Module { data: Vec::new(), routines: Vec::new() };
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
        if let Some((name, value)) = declaration(tokens)? {
            module.data.push(Declared { name, value, is_local });
        }
        return Ok(());
    }
    if tokens.accept_name("PROC") || tokens.accept_name("TRAP") {
        module.routines.push(routine(tokens, file, is_local)?);
    } else if tokens.accept_name("FUNC") {
        tokens.name()?;
        routine(tokens, file, is_local)?;
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

/// After CONST, PERS or VAR: the name with its value, if it has one that can be parsed.
fn declaration(tokens: &mut Tokens<'_>) -> Result<Option<(String, Expression)>, Diagnostic> {
    tokens.name()?;
    let (name, _) = tokens.name()?;
    let is_array = tokens.accept("{");
    let value = (!is_array && tokens.accept(":=")).then(|| tokens.expression()).transpose();
    let value = value.ok().flatten();
    skip(tokens);
    Ok(value.map(|value| (name, value)))
}

/// Skips everything up to the next semicolon and the semicolon.
fn skip(tokens: &mut Tokens<'_>) {
    while *tokens.peek() != Token::End && !tokens.accept(";") {
        tokens.advance();
    }
}

/// After PROC, TRAP or the type of a FUNC.
fn routine(tokens: &mut Tokens<'_>, file: usize, is_local: bool) -> Result<Routine, Diagnostic> {
    let (name, _) = tokens.name()?;
    let mut parameters = Vec::new();
    if tokens.accept("(") {
        let mut last = None;
        while !tokens.accept(")") {
            match tokens.next() {
                Token::Name(name) => last = Some(name),
                Token::End => return Err(tokens.expected("`)`")),
                Token::Sign(",") => parameters.extend(last.take()),
                Token::Enum(_)
                | Token::Int(_)
                | Token::Real(_)
                | Token::Text(_)
                | Token::Sign(_)
                | Token::LineEnd => {}
            }
        }
        parameters.extend(last);
    }
    let mut body = Vec::new();
    loop {
        if ENDS.into_iter().any(|end| tokens.accept_name(end)) {
            return Ok(Routine { name, file, is_local, parameters, body });
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
            } else {
                "this statement".into()
            }))
        });
        body.extend(kind.map(|kind| Statement { span: tokens.since(start), kind }));
    }
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
    match name.as_str() {
        // Without THEN the condition is that of one statement, which follows and is parsed by itself.
        "IF" => {
            tokens.expression()?;
            tokens.accept_name("THEN");
        }
        "ELSEIF" => head(tokens, "THEN")?,
        "FOR" | "WHILE" => head(tokens, "DO")?,
        "TEST" => _ = tokens.expression()?,
        "CASE" => while !tokens.accept(":") && !matches!(tokens.next(), Token::End) {},
        "DEFAULT" => _ = tokens.accept(":"),
        "ELSE" | "ENDIF" | "ENDFOR" | "ENDWHILE" | "ENDTEST" | "ERROR" | "BACKWARD" | "UNDO" => {}
        "GOTO" | "RETURN" | "CONNECT" | "RAISE" => skip(tokens),
        "CONST" | "PERS" | "VAR" => {
            return Ok(declaration(tokens)?.map(|(name, value)| StatementKind::Assign { name, value }));
        }
        _ if tokens.accept(":=") => {
            let value = tokens.expression()?;
            tokens.expect(";")?;
            return Ok(Some(StatementKind::Assign { name, value }));
        }
        _ if tokens.accept(":") => {}
        _ => {
            let arguments = tokens.arguments(";", 0)?;
            return Ok(Some(StatementKind::Call { name, arguments }));
        }
    }
    Ok(Some(StatementKind::Other(name)))
}
