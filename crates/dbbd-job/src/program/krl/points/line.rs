//! The lines of a KRL file.

use crate::program::flow::Control;
use crate::program::krl::parser::Parser;
use crate::program::krl::syntax::{Span, Text, declares_without_decl};
use crate::program::tokens::Tokens;
use dbbd_model::diagnostic::Diagnostic;

/// A line with code.
#[derive(Clone, Debug)]
pub(super) struct Line<'a> {
    /// The bytes of the line, without indent and line end.
    pub(super) span: Span,
    /// The first name of the line, in capitals; empty if the line begins with something else.
    pub(super) word: String,
    text: &'a str,
}

/// The lines of a file that are not empty and not comments only.
pub(super) fn lines<'a>(file: Text<'a>) -> impl Iterator<Item = Line<'a>> {
    let mut start = 0;
    file.text.split_inclusive('\n').filter_map(move |line| {
        let from = start;
        start += line.len();
        let text = line.trim_end_matches(['\n', '\r', '\u{1a}']);
        let indent = text.len() - text.trim_start_matches([' ', '\t']).len();
        let text = text.get(indent..)?;
        if text.is_empty() || text.starts_with([';', '&']) {
            return None;
        }
        let length = text.find(|c| !is_in_name(c)).unwrap_or(text.len());
        let word = text.get(..length).unwrap_or("").to_ascii_uppercase();
        Some(Line { span: from + indent..from + indent + text.len(), word, text })
    })
}

fn is_in_name(c: char) -> bool {
    c.is_ascii_alphanumeric() || c == '_' || c == '$'
}

/// Types whose values are points or frames.
const TYPES: &[&str] = &["E6POS", "POS", "FRAME", "E6AXIS", "AXIS", "FDAT"];

impl Line<'_> {
    /// A parser of the line; its spans are bytes of the file.
    pub(super) fn parser<'a>(&self, file: Text<'a>) -> Result<Parser<'a>, Diagnostic> {
        Ok(Parser::new(Tokens::of_line(file, &self.span)?))
    }

    /// The line without its comment.
    pub(super) fn code(&self) -> &str {
        let mut quoted = false;
        let end = self.text.find(|c| {
            quoted ^= c == '"';
            c == ';' && !quoted
        });
        self.text.get(..end.unwrap_or(self.text.len())).unwrap_or("").trim_end()
    }

    /// The names on the line, in capitals, with their bytes.
    pub(super) fn words(&self) -> impl Iterator<Item = (String, Span)> {
        let mut quoted = false;
        let mut start = self.span.start;
        self.code().split_inclusive(|c| !is_in_name(c)).filter_map(move |piece| {
            let (from, outside) = (start, !quoted);
            start += piece.len();
            quoted ^= piece.ends_with('"');
            let word = piece.trim_end_matches(|c| !is_in_name(c));
            (outside && !word.is_empty()).then(|| (word.to_ascii_uppercase(), from..from + word.len()))
        })
    }

    /// Whether the line of a `.dat` file assigns a structure that may be a point or a frame.
    pub(super) fn holds_structure(&self) -> bool {
        let Some((left, right)) = self.code().split_once('=') else { return false };
        if left.contains(',') || !right.trim_start().starts_with('{') {
            return false; // an array of several dimensions, or no structure
        }
        let declares =
            matches!(self.word.as_str(), "DECL" | "GLOBAL" | "CONST") || declares_without_decl(&self.word);
        let is_point_type = |word: &str| TYPES.iter().any(|name| word.eq_ignore_ascii_case(name));
        !declares || left.split_ascii_whitespace().any(is_point_type)
    }

    /// Whether the line assigns to a variable of the program.
    pub(super) fn is_assignment(&self) -> bool {
        let rest = self.code().get(self.word.len()..).unwrap_or("").trim_start();
        !self.word.is_empty() && !self.word.starts_with('$') && rest.starts_with(['=', '[', '.'])
    }

    /// Whether the line calls a routine: a name with arguments.
    pub(super) fn is_call(&self) -> bool {
        let rest = self.code().get(self.word.len()..).unwrap_or("").trim_start();
        const OTHERS: [&str; 7] = ["EXT", "EXTFCT", "DEF", "DEFFCT", "DECL", "SIGNAL", "WAIT"];
        rest.starts_with('(')
            && !self.word.is_empty()
            && !self.word.starts_with('$')
            && self.control().is_none()
            && !OTHERS.contains(&self.word.as_str())
    }

    /// The names on the line after which a bracket opens, in capitals: the called routines.
    pub(super) fn called(&self) -> impl Iterator<Item = String> {
        let code = self.code();
        self.words().filter_map(move |(word, span)| {
            let rest = code.get(span.end - self.span.start..).unwrap_or("").trim_start();
            rest.starts_with('(').then_some(word)
        })
    }

    /// The effect of the line on which line runs next.
    pub(super) fn control(&self) -> Option<Control> {
        Some(match self.word.as_str() {
            "IF" => Control::If,
            "SWITCH" => Control::Cases,
            "CASE" => Control::Way,
            "ELSE" | "DEFAULT" => Control::LastWay,
            "ENDIF" | "ENDSWITCH" => Control::EndChoice,
            "FOR" | "WHILE" => Control::While,
            "LOOP" | "REPEAT" => Control::Loop,
            "ENDFOR" | "ENDWHILE" | "ENDLOOP" => Control::EndLoop,
            "UNTIL" => Control::Until,
            "EXIT" => Control::Break,
            "RETURN" | "RESUME" => Control::Return,
            "GOTO" => Control::Goto(self.words().nth(1)?.0),
            "" => return None,
            word => {
                let is_label = self.code().get(word.len()..)?.trim() == ":";
                return is_label.then(|| Control::Label(word.to_owned()));
            }
        })
    }

    /// Whether the line names a routine that runs beside the program: an interrupt, or an action on the path.
    pub(super) fn runs_beside(&self) -> bool {
        let mut words = self.words().map(|(word, _)| word);
        match self.word.as_str() {
            "TRIGGER" => true,
            "INTERRUPT" | "GLOBAL" => {
                words.any(|word| word == "INTERRUPT") && words.next().as_deref() == Some("DECL")
            }
            _ => false,
        }
    }

    /// The name of the routine that this line begins, in capitals.
    pub(super) fn routine(&self) -> Option<String> {
        let code = self.code().to_ascii_uppercase();
        let head = code.split('(').next().unwrap_or("");
        let words: Vec<&str> = head.split_ascii_whitespace().collect();
        match words[..] {
            ["GLOBAL", "DEF" | "DEFFCT", .., name] | ["DEF" | "DEFFCT", .., name] => Some(name.to_owned()),
            _ => None,
        }
    }

    /// Whether the line is a motion relative to the current position.
    pub(super) fn is_relative_motion(&self) -> bool {
        let motion = self.word.strip_suffix("_REL").unwrap_or("");
        matches!(motion, "PTP" | "LIN" | "CIRC" | "SPTP" | "SLIN" | "SCIRC" | "SPL")
    }
}
