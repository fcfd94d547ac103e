//! The lines of a file, and the words of those that matter.

use crate::diagnostic::Diagnostic;
use crate::program::krl::parser::Parser;
use crate::program::krl::syntax::{Span, Text, type_of_declaration};

/// A line that holds more than a comment: its bytes without the line's end.
#[derive(Clone, Debug)]
pub(super) struct Line<'a> {
    pub(super) span: Span,
    /// Its first word in capitals: a name, or empty.
    pub(super) word: String,
    text: &'a str,
}

/// The lines that hold code.
pub(super) fn lines<'a>(file: Text<'a>) -> impl Iterator<Item = Line<'a>> {
    let mut start = 0;
    file.text.split_inclusive('\n').filter_map(move |whole| {
        let from = start;
        start += whole.len();
        let text = whole.trim_end_matches(['\n', '\r', '\u{1a}']);
        let indent = text.len() - text.trim_start_matches([' ', '\t']).len();
        let text = text.get(indent..)?;
        if text.is_empty() || text.starts_with([';', '&']) {
            return None;
        }
        let named = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '$';
        let length = text.find(|c| !named(c)).unwrap_or(text.len());
        let word = text.get(..length).unwrap_or("").to_ascii_uppercase();
        Some(Line { span: from + indent..from + indent + text.len(), word, text })
    })
}

/// Types of a declaration whose value is a point or a frame.
const TYPES: &[&str] = &["E6POS", "POS", "FRAME", "E6AXIS", "AXIS", "FDAT"];

impl Line<'_> {
    /// A reader of the line's words; spans are those of the file.
    pub(super) fn parser<'a>(&self, file: Text<'a>) -> Result<Parser<'a>, Diagnostic> {
        Parser::line(file, &self.span)
    }

    /// The line without the comment that follows.
    pub(super) fn code(&self) -> &str {
        let mut quoted = false;
        let end = self.text.find(|c| {
            quoted ^= c == '"';
            c == ';' && !quoted
        });
        self.text.get(..end.unwrap_or(self.text.len())).unwrap_or("").trim_end()
    }

    /// The names in it, in capitals, with their bytes.
    pub(super) fn words(&self) -> impl Iterator<Item = (String, Span)> {
        let mut quoted = false;
        let mut start = self.span.start;
        let named = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '$';
        self.code().split_inclusive(move |c| !named(c)).filter_map(move |piece| {
            let (from, outside) = (start, !quoted);
            start += piece.len();
            quoted ^= piece.ends_with('"');
            let word = piece.trim_end_matches(|c| !named(c));
            (outside && !word.is_empty()).then(|| (word.to_ascii_uppercase(), from..from + word.len()))
        })
    }

    /// Whether a `.dat` file gives a point or a frame here.
    pub(super) fn holds_structure(&self) -> bool {
        let Some((left, right)) = self.code().split_once('=') else { return false };
        if left.contains(',') || !right.trim_start().starts_with('{') {
            return false; // more dimensions than a point has, or no structure
        }
        let declares =
            matches!(self.word.as_str(), "DECL" | "GLOBAL" | "CONST") || type_of_declaration(&self.word);
        let known = |word: &str| TYPES.iter().any(|name| word.eq_ignore_ascii_case(name));
        !declares || left.split_ascii_whitespace().any(known)
    }

    /// Whether it assigns to a variable of the program.
    pub(super) fn assigns(&self) -> bool {
        let rest = self.code().get(self.word.len()..).unwrap_or("").trim_start();
        !self.word.is_empty() && !self.word.starts_with('$') && rest.starts_with(['=', '[', '.'])
    }

    /// The name of the routine that begins here, in capitals.
    pub(super) fn routine(&self) -> Option<String> {
        let code = self.code().to_ascii_uppercase();
        let head = code.split('(').next().unwrap_or("");
        let words: Vec<&str> = head.split_ascii_whitespace().collect();
        match words[..] {
            ["GLOBAL", "DEF" | "DEFFCT", .., name] | ["DEF" | "DEFFCT", .., name] => Some(name.to_owned()),
            _ => None,
        }
    }

    /// What a motion of the language begins with that goes on from where the robot is.
    pub(super) fn is_relative(&self) -> bool {
        let motion = self.word.strip_suffix("_REL").unwrap_or("");
        matches!(motion, "PTP" | "LIN" | "CIRC" | "SPTP" | "SLIN" | "SCIRC" | "SPL")
    }
}
