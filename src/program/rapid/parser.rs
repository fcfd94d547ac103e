//! The module of a file: its data and its routines.

use crate::catalogue::{CompensationFinding, ProgramFinding};
use crate::diagnostic::Diagnostic;
use crate::program::Language;
use crate::program::script::lexer::Token;
use crate::program::script::statement::{Kind, Routine, Statement};
use crate::program::script::value::{Expression, Words};
use crate::program::text::Text;

/// A declaration with its value.
#[derive(Clone, Debug)]
pub(super) struct Declared {
    /// In capitals.
    pub(super) name: String,
    pub(super) value: Expression,
    /// Whether other modules see it.
    pub(super) is_local: bool,
}

#[derive(Clone, Debug)]
pub(super) struct Module {
    pub(super) data: Vec<Declared>,
    /// With whether other modules cannot call it.
    pub(super) routines: Vec<(Routine, bool)>,
}

/// Words that end a routine.
const ENDS: [&str; 4] = ["ENDPROC", "ENDFUNC", "ENDTRAP", "ENDMODULE"];

/// Reads the module of the file with this number.
pub(super) fn parse(text: Text<'_>, file: usize) -> Result<Module, Diagnostic> {
    let mut words = Words::new(text, Language::Rapid)?;
    while !words.is_word("MODULE") {
        if *words.peek() == Token::End {
            let begins = text.text.lines().map(str::trim).find(|line| !line.is_empty()).unwrap_or("");
            let begins = begins.chars().take(40).collect();
            return Err(text.wrong(&(0..0), CompensationFinding::NotRapid { begins }));
        }
        words.next();
    }
    words.next();
    let place = words.place();
    let name = words.name()?;
    if words.take("(") {
        words.arguments(")", 0)?;
    }
    let mut module = Module { data: Vec::new(), routines: Vec::new() };
    while !words.take_word("ENDMODULE") {
        if *words.peek() == Token::End {
            return Err(words.expected("ENDMODULE"));
        }
        item(&mut words, &mut module, file)?;
    }
    let same = module.routines.iter().any(|(routine, _)| routine.name == name);
    if same {
        return Err(text.wrong(&words.span_at(place), ProgramFinding::ModuleNamedAsRoutine { name }));
    }
    Ok(module)
}

/// A declaration or a routine.
fn item(words: &mut Words<'_>, module: &mut Module, file: usize) -> Result<(), Diagnostic> {
    let is_local = words.take_word("LOCAL");
    words.take_word("TASK");
    if ["CONST", "PERS", "VAR"].into_iter().any(|word| words.take_word(word)) {
        if let Some((name, value)) = declaration(words)? {
            module.data.push(Declared { name, value, is_local });
        }
        return Ok(());
    }
    if words.take_word("PROC") || words.take_word("TRAP") {
        module.routines.push((routine(words, file)?, is_local));
    } else if words.take_word("FUNC") {
        words.name()?;
        routine(words, file)?;
    } else if words.take_word("RECORD") {
        while !words.take_word("ENDRECORD") && *words.peek() != Token::End {
            words.next();
        }
    } else if words.take_word("ALIAS") {
        skip(words);
    } else {
        return Err(words.expected("a declaration, PROC, FUNC, TRAP or ENDMODULE"));
    }
    Ok(())
}

/// After CONST, PERS or VAR: the name and its value, where it has one that can be read.
fn declaration(words: &mut Words<'_>) -> Result<Option<(String, Expression)>, Diagnostic> {
    words.name()?;
    let name = words.name()?;
    let is_array = words.take("{");
    let value = (!is_array && words.take(":=")).then(|| words.expression()).transpose();
    let value = value.ok().flatten();
    skip(words);
    Ok(value.map(|value| (name, value)))
}

/// Up to the next semicolon, which is taken.
fn skip(words: &mut Words<'_>) {
    while *words.peek() != Token::End && !words.take(";") {
        words.next();
    }
}

/// After PROC, TRAP or the type of a FUNC.
fn routine(words: &mut Words<'_>, file: usize) -> Result<Routine, Diagnostic> {
    let name = words.name()?;
    let mut parameters = Vec::new();
    if words.take("(") {
        let mut last = None;
        while !words.take(")") {
            match words.next() {
                Token::Name(name) => last = Some(name),
                Token::End => return Err(words.expected("`)`")),
                Token::Sign(",") => parameters.extend(last.take()),
                _ => {}
            }
        }
        parameters.extend(last);
    }
    let mut body = Vec::new();
    loop {
        if let Some(end) = ENDS.into_iter().find(|end| words.is_word(end)) {
            if end != "ENDMODULE" {
                words.next();
                return Ok(Routine { name, file, parameters, body });
            }
            return Err(words.expected("ENDPROC"));
        }
        if *words.peek() == Token::End {
            return Err(words.expected("ENDPROC"));
        }
        let place = words.place();
        let kind = statement(words);
        let kind = kind.unwrap_or_else(|_| {
            words.go_to(place);
            let first = words.next();
            skip(words);
            Some(Kind::Other(match first {
                Token::Name(name) => name,
                _ => "this statement".into(),
            }))
        });
        body.extend(kind.map(|kind| Statement { span: words.since(place), kind }));
    }
}

/// A statement, or the head of one that holds others.
fn statement(words: &mut Words<'_>) -> Result<Option<Kind>, Diagnostic> {
    if words.take(";") {
        return Ok(None);
    }
    let name = words.name()?;
    let head = |words: &mut Words<'_>, end: &str| -> Result<(), Diagnostic> {
        while !words.take_word(end) {
            if matches!(words.peek(), Token::End | Token::Sign(";")) {
                return Err(words.expected(end));
            }
            words.next();
        }
        Ok(())
    };
    match name.as_str() {
        // A condition without THEN is one of the statement that follows, which is read by itself.
        "IF" => {
            words.expression()?;
            words.take_word("THEN");
        }
        "ELSEIF" => head(words, "THEN")?,
        "FOR" | "WHILE" => head(words, "DO")?,
        "TEST" => _ = words.expression()?,
        "CASE" => while !words.take(":") && !matches!(words.next(), Token::End) {},
        "DEFAULT" => _ = words.take(":"),
        "ELSE" | "ENDIF" | "ENDFOR" | "ENDWHILE" | "ENDTEST" | "ERROR" | "BACKWARD" | "UNDO" => {}
        "GOTO" | "RETURN" | "CONNECT" | "RAISE" => skip(words),
        "CONST" | "PERS" | "VAR" => {
            return Ok(declaration(words)?.map(|(name, value)| Kind::Assign { name, value }));
        }
        _ if words.take(":=") => {
            let value = words.expression()?;
            words.expect(";")?;
            return Ok(Some(Kind::Assign { name, value }));
        }
        _ if words.take(":") => {}
        _ => {
            let arguments = words.arguments(";", 0)?;
            return Ok(Some(Kind::Call { name, arguments }));
        }
    }
    Ok(Some(Kind::Other(name)))
}
