//! The lines of a file, and the words of those that matter.

use super::Text;
use crate::diag::Diagnostic;
use crate::krl::parser::Parser;
use crate::krl::syntax::Span;

/// A line that holds more than a comment: its bytes without the line's end.
#[derive(Clone, Debug)]
pub(super) struct Line<'a> {
    pub(super) span: Span,
    /// Its first word in capitals: a name, or empty.
    pub(super) word: String,
    pub(super) text: &'a str,
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

impl Line<'_> {
    /// A reader of the line's words; spans are those of the file.
    pub(super) fn parser<'a>(&self, file: Text<'a>) -> Result<Parser<'a>, Diagnostic> {
        Parser::line(file.file, file.text, self.span.clone())
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
}
