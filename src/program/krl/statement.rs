//! Reads statements and their blocks.

use super::lexer::Token;
use super::parser::Parser;
use super::syntax::*;
use crate::catalogue::ProgramFinding;
use crate::diagnostic::{Diagnostic, nearest};
use crate::plan::Motion;

/// Statements and what closes their blocks, for suggestions.
#[rustfmt::skip]
const KEYWORDS: &[&str] = &[
    "PTP", "LIN", "CIRC", "SPTP", "SLIN", "SCIRC", "WAIT", "PULSE", "HALT", "RETURN", "EXIT", "FOR", "ENDFOR", "IF",
    "ELSE", "ENDIF", "WHILE", "ENDWHILE", "LOOP", "ENDLOOP", "INTERRUPT", "DECL", "SIGNAL", "EXT", "END", "DEF",
];

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

/// The motion that a word begins; spline motions go to the same points as the plain ones.
pub(super) fn motion_of(word: &str) -> Option<Motion> {
    match word {
        "PTP" | "SPTP" => Some(Motion::Ptp),
        "LIN" | "SLIN" | "SPL" => Some(Motion::Lin),
        "CIRC" | "SCIRC" => Some(Motion::Circ),
        _ => None,
    }
}

impl Parser<'_> {
    /// Statements up to (not including) one of the `closing` words.
    pub(super) fn block(&mut self, closing: &[&str]) -> Result<Block, Diagnostic> {
        let mut statements = Vec::new();
        self.nested(|parser| {
            while parser.in_block(closing)? {
                let at = parser.span();
                if parser.declaration()?.is_some() {
                    return Err(parser.wrong(at, ProgramFinding::LateDeclaration));
                }
                statements.push(parser.statement()?);
            }
            Ok(())
        })?;
        Ok(statements.into())
    }

    /// Whether the block goes on.
    fn in_block(&mut self, closing: &[&str]) -> Result<bool, Diagnostic> {
        self.skip_lines();
        if *self.peek() == Token::End {
            return Err(self.unexpected(closing.first().copied().unwrap_or("END")));
        }
        if closing.iter().any(|word| self.is_name(word)) {
            return Ok(false);
        }
        if CLOSING.iter().any(|word| self.is_name(word)) {
            return Err(self.unexpected(&closing.join(" or ")));
        }
        Ok(true)
    }

    /// The rest of a block statement's first line, then its block and the word that closes it.
    fn body(&mut self, closing: &str) -> Result<Block, Diagnostic> {
        self.line_end()?;
        let body = self.block(&[closing])?;
        self.keyword(closing)?;
        Ok(body)
    }

    fn statement(&mut self) -> Result<Statement, Diagnostic> {
        let start = self.span().start;
        let Token::Name(word) = self.peek().clone() else { return Err(self.unexpected("a statement")) };
        let line = self.file.text.get(start..).and_then(|rest| rest.lines().next()).unwrap_or("");
        let line = line.split(';').next().unwrap_or("").trim_end();
        let span = start..start + line.len();
        let kind = match self.ahead(1) {
            Token::Sign("=" | "[" | ".") => {
                let (target, value) = self.assignment()?;
                StatementKind::Assign { target, value }
            }
            _ => self.statement_of(&word)?,
        };
        self.line_end()?;
        Ok(Statement { span, kind })
    }

    fn statement_of(&mut self, word: &str) -> Result<StatementKind, Diagnostic> {
        Ok(match word {
            "WAIT" => self.wait()?,
            "PULSE" => self.pulse()?,
            "HALT" => self.lone(StatementKind::Halt),
            "RETURN" => self.lone(StatementKind::Return),
            "EXIT" => self.lone(StatementKind::Exit),
            "FOR" => self.counted()?,
            "IF" => self.choice()?,
            "WHILE" => {
                self.advance();
                let condition = self.expression()?;
                StatementKind::While { condition, body: self.body("ENDWHILE")? }
            }
            "LOOP" => {
                self.advance();
                StatementKind::Loop(self.body("ENDLOOP")?)
            }
            "GLOBAL" | "INTERRUPT" => self.interrupt()?,
            "PTP" | "LIN" | "CIRC" | "SPTP" | "SLIN" | "SCIRC" => {
                let mut motion = self.motion()?;
                motion.angle = self.angle()?;
                motion.approximate = self.approximate()?;
                StatementKind::Move(motion)
            }
            _ if matches!(self.ahead(1), Token::Sign("(")) => {
                let (name, _) = self.name()?;
                StatementKind::Call { name, arguments: self.arguments()? }
            }
            _ => return Err(self.statement_unknown("a statement")),
        })
    }

    /// What to say of a line that begins with a word that has no meaning there.
    pub(super) fn statement_unknown(&self, wanted: &str) -> Diagnostic {
        let Token::Name(word) = self.peek() else { return self.unexpected(wanted) };
        if let Some((_, instead)) = UNSUPPORTED.iter().find(|(name, _)| name == word) {
            return self.unsupported(self.span(), word.as_str(), instead);
        }
        let found = self.wrong(self.span(), ProgramFinding::NoStatement { word: word.clone() });
        match nearest(word, KEYWORDS.iter().copied()).filter(|near| near != word) {
            Some(near) => found.help(format!("did you mean {near}?")),
            None => found,
        }
    }

    /// A motion and its points, without what may follow these.
    pub(super) fn motion(&mut self) -> Result<Move, Diagnostic> {
        let found = match self.peek() {
            Token::Name(word) => motion_of(word),
            _ => None,
        };
        let Some(motion) = found else { return Err(self.unexpected("a motion")) };
        self.advance();
        let mut to = self.expression()?;
        let mut through = None;
        if motion == Motion::Circ {
            self.sign(",")?;
            through = Some(std::mem::replace(&mut to, self.expression()?));
        }
        Ok(Move { motion, through, to, angle: None, approximate: None })
    }

    /// `,CA angle` behind the points of an arc.
    pub(super) fn angle(&mut self) -> Result<Option<Expression>, Diagnostic> {
        if !matches!((self.peek(), self.ahead(1)), (Token::Sign(","), Token::Name(word)) if word == "CA") {
            return Ok(None);
        }
        self.advance();
        self.advance();
        self.expression().map(Some)
    }

    fn wait(&mut self) -> Result<StatementKind, Diagnostic> {
        self.advance();
        if self.accept_name("SEC") {
            Ok(StatementKind::WaitSeconds(self.expression()?))
        } else if self.accept_name("FOR") {
            Ok(StatementKind::WaitFor(self.expression()?))
        } else {
            Err(self.unexpected("SEC or FOR"))
        }
    }

    fn pulse(&mut self) -> Result<StatementKind, Diagnostic> {
        self.advance();
        self.sign("(")?;
        let output = self.place()?;
        self.sign(",")?;
        let level = self.expression()?;
        self.sign(",")?;
        let seconds = self.expression()?;
        self.sign(")")?;
        Ok(StatementKind::Pulse { output, level, seconds })
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

    fn counted(&mut self) -> Result<StatementKind, Diagnostic> {
        self.advance();
        let counter = self.place()?;
        self.sign("=")?;
        let from = self.expression()?;
        self.keyword("TO")?;
        let to = self.expression()?;
        let step = if self.accept_name("STEP") { Some(self.expression()?) } else { None };
        let body = self.body("ENDFOR")?;
        Ok(StatementKind::For { counter, from, to, step, body })
    }

    fn choice(&mut self) -> Result<StatementKind, Diagnostic> {
        self.advance();
        let condition = self.expression()?;
        self.keyword("THEN")?;
        self.line_end()?;
        let then = self.block(&["ENDIF", "ELSE"])?;
        let otherwise = if self.accept_name("ELSE") {
            self.body("ENDIF")?
        } else {
            self.keyword("ENDIF")?;
            Block::from([])
        };
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
