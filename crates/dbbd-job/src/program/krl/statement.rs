//! Parser of statements and blocks.

use super::parser::Parser;
use super::syntax::*;
use crate::plan::MotionKind;
use crate::program::ProgramFinding;
use crate::program::lexer::Token;
use dbbd_model::diagnostic::{Diagnostic, nearest};

/// The words that begin a line, for suggestions.
#[rustfmt::skip]
const KEYWORDS: &[&str] = &[
    "PTP", "LIN", "CIRC", "SPTP", "SLIN", "SCIRC", "WAIT", "PULSE", "HALT", "RETURN", "EXIT", "FOR", "ENDFOR", "IF",
    "ELSE", "ENDIF", "WHILE", "ENDWHILE", "LOOP", "ENDLOOP", "INTERRUPT", "DECL", "SIGNAL", "EXT", "END", "DEF",
];

const CLOSING: &[&str] = &["END", "ENDFOR", "ELSE", "ENDIF", "ENDWHILE", "ENDLOOP", "DEF"];

/// Statements of KRL that are not supported, each with a replacement.
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

/// The motion that a keyword begins. Spline motions go to the same points as the others.
pub(super) fn motion_of(word: &str) -> Option<MotionKind> {
    match word {
        "PTP" | "SPTP" => Some(MotionKind::Ptp),
        "LIN" | "SLIN" | "SPL" => Some(MotionKind::Lin),
        "CIRC" | "SCIRC" => Some(MotionKind::Circ),
        _ => None,
    }
}

impl Parser<'_> {
    /// Statements up to one of the `closing` words, which is not read.
    pub(super) fn block(&mut self, closing: &[&str]) -> Result<Block, Diagnostic> {
        let mut statements = Vec::new();
        self.nested(|parser| {
            while parser.in_block(closing)? {
                let at = parser.tokens.span();
                if parser.declaration()?.is_some() {
                    return Err(parser.tokens.wrong(at, ProgramFinding::LateDeclaration));
                }
                statements.push(parser.statement()?);
            }
            Ok(())
        })?;
        Ok(statements.into())
    }

    /// Whether another statement of the block follows.
    fn in_block(&mut self, closing: &[&str]) -> Result<bool, Diagnostic> {
        self.skip_empty_lines();
        if *self.tokens.peek() == Token::End {
            return Err(self.tokens.expected(closing.first().copied().unwrap_or("END")));
        }
        if closing.iter().any(|word| self.tokens.is_name(word)) {
            return Ok(false);
        }
        if CLOSING.iter().any(|word| self.tokens.is_name(word)) {
            return Err(self.tokens.expected(&closing.join(" or ")));
        }
        Ok(true)
    }

    /// Reads the rest of a statement with one block after its head: the end of the line, the block and the word that
    /// closes it.
    fn body(&mut self, closing: &str) -> Result<Block, Diagnostic> {
        self.line_end()?;
        let body = self.block(&[closing])?;
        self.tokens.expect_name(closing)?;
        Ok(body)
    }

    fn statement(&mut self) -> Result<Statement, Diagnostic> {
        let start = self.tokens.span().start;
        let Token::Name(word) = self.tokens.peek().clone() else {
            return Err(self.tokens.expected("a statement"));
        };
        let line = self.tokens.file.text.get(start..).and_then(|rest| rest.lines().next()).unwrap_or("");
        let line = line.split(';').next().unwrap_or("").trim_end();
        let span = start..start + line.len();
        let kind = if let Token::Sign("=" | "[" | ".") = self.tokens.ahead(1) {
            let (target, value) = self.assignment()?;
            StatementKind::Assign { target, value }
        } else {
            self.keyword_statement(&word)?
        };
        self.line_end()?;
        Ok(Statement { span, kind })
    }

    /// A statement that begins with a keyword or is a call.
    fn keyword_statement(&mut self, word: &str) -> Result<StatementKind, Diagnostic> {
        Ok(match word {
            "WAIT" => self.wait()?,
            "PULSE" => self.pulse()?,
            "HALT" => self.token_as(StatementKind::Halt),
            "RETURN" => self.token_as(StatementKind::Return),
            "EXIT" => self.token_as(StatementKind::Exit),
            "FOR" => self.for_loop()?,
            "IF" => self.if_statement()?,
            "WHILE" => {
                self.tokens.advance();
                let condition = self.expression()?;
                StatementKind::While { condition, body: self.body("ENDWHILE")? }
            }
            "LOOP" => {
                self.tokens.advance();
                StatementKind::Loop(self.body("ENDLOOP")?)
            }
            "GLOBAL" | "INTERRUPT" => self.interrupt()?,
            "PTP" | "LIN" | "CIRC" | "SPTP" | "SLIN" | "SCIRC" => {
                let mut motion = self.motion()?;
                motion.angle = self.angle()?;
                motion.approximate = self.approximate()?;
                StatementKind::Move(motion)
            }
            _ if matches!(self.tokens.ahead(1), Token::Sign("(")) => {
                let (name, _) = self.name()?;
                StatementKind::Call { name, arguments: self.arguments()? }
            }
            _ => return Err(self.unknown_statement("a statement")),
        })
    }

    /// The finding that a line begins with a word which begins no statement.
    pub(super) fn unknown_statement(&self, wanted: &str) -> Diagnostic {
        let Token::Name(word) = self.tokens.peek() else { return self.tokens.expected(wanted) };
        if let Some((_, instead)) = UNSUPPORTED.iter().find(|(name, _)| name == word) {
            return self.unsupported(self.tokens.span(), word.as_str(), instead);
        }
        let wrong = self.tokens.wrong(self.tokens.span(), ProgramFinding::NoStatement { word: word.clone() });
        match nearest(word, KEYWORDS.iter().copied()).filter(|near| near != word) {
            Some(near) => wrong.help(format!("did you mean {near}?")),
            None => wrong,
        }
    }

    /// A motion and its points, without the options that may follow.
    pub(super) fn motion(&mut self) -> Result<Move, Diagnostic> {
        let motion = if let Token::Name(word) = self.tokens.peek() { motion_of(word) } else { None };
        let Some(motion) = motion else { return Err(self.tokens.expected("a motion")) };
        self.tokens.advance();
        let mut to = self.expression()?;
        let mut through = None;
        if motion == MotionKind::Circ {
            self.tokens.expect(",")?;
            through = Some(std::mem::replace(&mut to, self.expression()?));
        }
        Ok(Move { motion, through, to, angle: None, approximate: None })
    }

    /// `,CA angle` after the points of an arc.
    pub(super) fn angle(&mut self) -> Result<Option<Expression>, Diagnostic> {
        if !matches!((self.tokens.peek(), self.tokens.ahead(1)), (Token::Sign(","), Token::Name(word)) if word == "CA")
        {
            return Ok(None);
        }
        self.tokens.advance();
        self.tokens.advance();
        self.expression().map(Some)
    }

    fn wait(&mut self) -> Result<StatementKind, Diagnostic> {
        self.tokens.advance();
        if self.tokens.accept_name("SEC") {
            Ok(StatementKind::WaitSeconds(self.expression()?))
        } else if self.tokens.accept_name("FOR") {
            Ok(StatementKind::WaitFor(self.expression()?))
        } else {
            Err(self.tokens.expected("SEC or FOR"))
        }
    }

    fn pulse(&mut self) -> Result<StatementKind, Diagnostic> {
        self.tokens.advance();
        self.tokens.expect("(")?;
        let output = self.place()?;
        self.tokens.expect(",")?;
        let level = self.expression()?;
        self.tokens.expect(",")?;
        let seconds = self.expression()?;
        self.tokens.expect(")")?;
        Ok(StatementKind::Pulse { output, level, seconds })
    }

    /// `C_PTP`, `C_DIS` .. at the end of a motion.
    fn approximate(&mut self) -> Result<Option<String>, Diagnostic> {
        let mut words: Option<String> = None;
        while let Token::Name(word) = self.tokens.peek().clone() {
            if !matches!(word.as_str(), "C_PTP" | "C_DIS" | "C_ORI" | "C_VEL" | "C_SPL") {
                return Err(self.tokens.expected("C_PTP, C_DIS, C_ORI, C_VEL, C_SPL or the end of the line"));
            }
            self.tokens.advance();
            words = Some(words.map_or(word.clone(), |before| format!("{before} {word}")));
        }
        Ok(words)
    }

    fn for_loop(&mut self) -> Result<StatementKind, Diagnostic> {
        self.tokens.advance();
        let counter = self.place()?;
        self.tokens.expect("=")?;
        let from = self.expression()?;
        self.tokens.expect_name("TO")?;
        let to = self.expression()?;
        let step = if self.tokens.accept_name("STEP") { Some(self.expression()?) } else { None };
        let body = self.body("ENDFOR")?;
        Ok(StatementKind::For { counter, from, to, step, body })
    }

    fn if_statement(&mut self) -> Result<StatementKind, Diagnostic> {
        self.tokens.advance();
        let condition = self.expression()?;
        self.tokens.expect_name("THEN")?;
        self.line_end()?;
        let then = self.block(&["ENDIF", "ELSE"])?;
        let otherwise = if self.tokens.accept_name("ELSE") {
            self.body("ENDIF")?
        } else {
            self.tokens.expect_name("ENDIF")?;
            Block::from([])
        };
        Ok(StatementKind::If { condition, then, otherwise })
    }

    /// `GLOBAL INTERRUPT DECL 3 WHEN c DO CALL ( )`, `INTERRUPT ON 3`.
    fn interrupt(&mut self) -> Result<StatementKind, Diagnostic> {
        self.tokens.accept_name("GLOBAL");
        self.tokens.expect_name("INTERRUPT")?;
        if self.tokens.accept_name("ON") || self.tokens.accept_name("OFF") {
            if *self.tokens.peek() != Token::LineEnd {
                self.expression()?;
            }
            return Ok(StatementKind::InterruptSwitch);
        }
        self.tokens.expect_name("DECL")?;
        self.expression()?;
        self.tokens.expect_name("WHEN")?;
        let condition = self.expression()?;
        self.tokens.expect_name("DO")?;
        self.name()?;
        self.arguments()?;
        Ok(StatementKind::InterruptDeclaration { condition })
    }

    /// `(a,b)`
    pub(super) fn arguments(&mut self) -> Result<Vec<Expression>, Diagnostic> {
        self.tokens.expect("(")?;
        let mut arguments = Vec::new();
        while !self.tokens.accept(")") {
            if !arguments.is_empty() {
                self.tokens.expect(",")?;
            }
            arguments.push(self.expression()?);
        }
        Ok(arguments)
    }
}
