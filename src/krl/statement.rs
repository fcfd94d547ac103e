//! Reads statements and their blocks.

use super::lexer::Token;
use super::parser::{DEPTH, Parser};
use super::syntax::*;
use crate::diag::{Diagnostic, nearest};

/// Statements and what closes their blocks, for suggestions.
const KEYWORDS: &[&str] = &[
    "PTP",
    "LIN",
    "CIRC",
    "SPTP",
    "SLIN",
    "SCIRC",
    "WAIT",
    "PULSE",
    "HALT",
    "RETURN",
    "EXIT",
    "FOR",
    "ENDFOR",
    "IF",
    "ELSE",
    "ENDIF",
    "WHILE",
    "ENDWHILE",
    "LOOP",
    "ENDLOOP",
    "INTERRUPT",
    "DECL",
    "SIGNAL",
    "EXT",
    "END",
    "DEF",
];

/// What ends a block.
const CLOSING: &[&str] = &["END", "ENDFOR", "ELSE", "ENDIF", "ENDWHILE", "ENDLOOP", "DEF"];

/// Statements of KRL that are known to exist and not supported, each with what to do.
const UNSUPPORTED: &[(&str, &str)] = &[
    ("SPLINE", "write LIN or CIRC for each point"),
    ("TRIGGER", "set the output after an exact stop"),
    ("CONTINUE", "set the output after an exact stop"),
    ("ANOUT", "analogue outputs are not simulated"),
    ("GOTO", "write FOR, WHILE or LOOP"),
    ("REPEAT", "write WHILE or LOOP"),
    ("SWITCH", "write IF"),
    ("DEFFCT", "write a routine with DEF"),
    ("STRUC", "use the built-in structures"),
    ("ENUM", "use INT"),
];

impl Parser<'_> {
    /// Statements up to (not including) one of the `closing` words.
    pub(super) fn block(&mut self, closing: &[&str]) -> Result<Block, Diagnostic> {
        self.depth += 1;
        if self.depth > DEPTH {
            return Err(self.wrong(self.span(), "blocks are nested too deeply"));
        }
        let mut statements = Vec::new();
        loop {
            self.skip_lines();
            if *self.peek() == Token::End {
                return Err(self.unexpected(closing.first().copied().unwrap_or("END")));
            }
            if closing.iter().any(|word| self.is_name(word)) {
                break;
            }
            if CLOSING.iter().any(|word| self.is_name(word)) {
                return Err(self.unexpected(&closing.join(" or ")));
            }
            let at = self.span();
            if self.declaration()?.is_some() {
                return Err(self
                    .wrong(at, "a declaration after the first statement")
                    .help("move it above the first statement of the routine, or into the .dat file"));
            }
            statements.push(self.statement()?);
        }
        self.depth -= 1;
        Ok(statements.into())
    }

    /// The rest of a block statement's first line, then its block.
    fn body(&mut self, closing: &[&str]) -> Result<Block, Diagnostic> {
        self.line_end()?;
        self.block(closing)
    }

    fn statement(&mut self) -> Result<Statement, Diagnostic> {
        let start = self.span().start;
        let Token::Name(word) = self.peek().clone() else { return Err(self.unexpected("a statement")) };
        let next_is = |sign: &str| matches!(self.ahead(1), Token::Sign(s) if *s == sign);
        let assigns = next_is("=") || next_is("[") || next_is(".");
        let calls = next_is("(");
        let line = self.text.get(start..).and_then(|rest| rest.lines().next()).unwrap_or("");
        let line = line.split(';').next().unwrap_or("").trim_end();
        let span = start..start + line.len();
        let kind = match word.as_str() {
            _ if assigns => {
                let target = self.place()?;
                self.sign("=")?;
                StatementKind::Assign { target, value: self.expression()? }
            }
            "PTP" | "SPTP" => {
                self.advance();
                StatementKind::Ptp { to: self.expression()?, approximate: self.approximate()? }
            }
            "LIN" | "SLIN" => {
                self.advance();
                StatementKind::Lin { to: self.expression()?, approximate: self.approximate()? }
            }
            "CIRC" | "SCIRC" => self.circ()?,
            "WAIT" => {
                self.advance();
                if self.accept_name("SEC") {
                    StatementKind::WaitSeconds(self.expression()?)
                } else if self.accept_name("FOR") {
                    StatementKind::WaitFor(self.expression()?)
                } else {
                    return Err(self.unexpected("SEC or FOR"));
                }
            }
            "PULSE" => {
                self.advance();
                self.sign("(")?;
                let output = self.place()?;
                self.sign(",")?;
                let level = self.expression()?;
                self.sign(",")?;
                let seconds = self.expression()?;
                self.sign(")")?;
                StatementKind::Pulse { output, level, seconds }
            }
            "HALT" => self.lone(StatementKind::Halt),
            "RETURN" => self.lone(StatementKind::Return),
            "EXIT" => self.lone(StatementKind::Exit),
            "FOR" => self.counted()?,
            "IF" => self.choice()?,
            "WHILE" => {
                self.advance();
                let condition = self.expression()?;
                let body = self.body(&["ENDWHILE"])?;
                self.keyword("ENDWHILE")?;
                StatementKind::While { condition, body }
            }
            "LOOP" => {
                self.advance();
                let body = self.body(&["ENDLOOP"])?;
                self.keyword("ENDLOOP")?;
                StatementKind::Loop(body)
            }
            "GLOBAL" | "INTERRUPT" => self.interrupt()?,
            _ if calls => {
                let (name, _) = self.name()?;
                StatementKind::Call { name, arguments: self.arguments()? }
            }
            _ => return Err(self.statement_unknown("a statement")),
        };
        self.line_end()?;
        Ok(Statement { span, kind })
    }

    /// What to say of a line that begins with a word that has no meaning there.
    pub(super) fn statement_unknown(&self, wanted: &str) -> Diagnostic {
        let Token::Name(word) = self.peek() else { return self.unexpected(wanted) };
        if let Some((_, instead)) = UNSUPPORTED.iter().find(|(name, _)| name == word) {
            return self.wrong(self.span(), format!("{word} is not supported")).help(*instead);
        }
        let message = format!("expected {wanted}, found `{word}`");
        let found = self.wrong(self.span(), message);
        match nearest(word, KEYWORDS.iter().copied()).filter(|near| near != word) {
            Some(near) => found.help(format!("did you mean {near}?")),
            None => found.help(
                "supported are assignments, calls, PTP, LIN, CIRC, WAIT, PULSE, HALT, FOR, IF, WHILE, LOOP",
            ),
        }
    }

    fn lone(&mut self, kind: StatementKind) -> StatementKind {
        self.advance();
        kind
    }

    /// `C_PTP`, `C_DIS` .. at the end of a motion.
    fn approximate(&mut self) -> Result<Option<String>, Diagnostic> {
        let mut found: Option<String> = None;
        while let Token::Name(word) = self.peek().clone() {
            if !matches!(word.as_str(), "C_PTP" | "C_DIS" | "C_ORI" | "C_VEL" | "C_SPL") {
                return Err(self.unexpected("C_PTP, C_DIS, C_ORI, C_VEL, C_SPL or the end of the line"));
            }
            self.advance();
            found = Some(found.map_or(word.clone(), |before| format!("{before} {word}")));
        }
        Ok(found)
    }

    fn circ(&mut self) -> Result<StatementKind, Diagnostic> {
        self.advance();
        let through = self.expression()?;
        self.sign(",")?;
        let to = self.expression()?;
        let mut angle = None;
        if self.accept_sign(",") {
            self.keyword("CA")?;
            angle = Some(self.expression()?);
        }
        Ok(StatementKind::Circ { through, to, angle, approximate: self.approximate()? })
    }

    fn counted(&mut self) -> Result<StatementKind, Diagnostic> {
        self.advance();
        let counter = self.place()?;
        self.sign("=")?;
        let from = self.expression()?;
        self.keyword("TO")?;
        let to = self.expression()?;
        let step = if self.accept_name("STEP") { Some(self.expression()?) } else { None };
        let body = self.body(&["ENDFOR"])?;
        self.keyword("ENDFOR")?;
        Ok(StatementKind::For { counter, from, to, step, body })
    }

    fn choice(&mut self) -> Result<StatementKind, Diagnostic> {
        self.advance();
        let condition = self.expression()?;
        self.keyword("THEN")?;
        let then = self.body(&["ENDIF", "ELSE"])?;
        let otherwise = if self.accept_name("ELSE") { self.body(&["ENDIF"])? } else { Block::from([]) };
        self.keyword("ENDIF")?;
        Ok(StatementKind::If { condition, then, otherwise })
    }

    /// `GLOBAL INTERRUPT DECL 3 WHEN c DO CALL ( )`, `INTERRUPT ON 3`.
    fn interrupt(&mut self) -> Result<StatementKind, Diagnostic> {
        self.accept_name("GLOBAL");
        self.keyword("INTERRUPT")?;
        if self.accept_name("ON") || self.accept_name("OFF") {
            if *self.peek() != Token::LineEnd {
                self.expression()?;
            }
            return Ok(StatementKind::InterruptSwitch);
        }
        self.keyword("DECL")?;
        self.expression()?;
        self.keyword("WHEN")?;
        let condition = self.expression()?;
        self.keyword("DO")?;
        self.name()?;
        self.arguments()?;
        Ok(StatementKind::InterruptDeclaration { condition })
    }

    /// `(a,b)`
    pub(super) fn arguments(&mut self) -> Result<Vec<Expression>, Diagnostic> {
        self.sign("(")?;
        let mut arguments = Vec::new();
        while !self.accept_sign(")") {
            if !arguments.is_empty() {
                self.sign(",")?;
            }
            arguments.push(self.expression()?);
        }
        Ok(arguments)
    }
}
