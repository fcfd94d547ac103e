//! A message that names the file, the line and the column it is about, and says what to do.

use std::fmt;
use std::ops::Range;

/// What is wrong in a file that a user wrote: where, what, and what to do about it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Diagnostic {
    /// The file as the user named it.
    pub file: String,
    /// Line from 1; 0 when the message is about the whole file.
    pub line: usize,
    /// Column from 1, in characters; 0 when unknown.
    pub column: usize,
    /// What is wrong.
    pub message: String,
    /// What to do about it.
    pub help: Option<String>,
    /// The text of the line, to point into.
    pub excerpt: Option<String>,
}

impl Diagnostic {
    /// About the whole file.
    pub fn file(file: &str, message: impl Into<String>) -> Self {
        Self { file: file.into(), line: 0, column: 0, message: message.into(), help: None, excerpt: None }
    }

    /// About a line (from 1), column unknown.
    pub fn line(file: &str, line: usize, message: impl Into<String>) -> Self {
        Self { line, ..Self::file(file, message) }
    }

    /// About a position (line and column from 1) in `text`, whose line is shown.
    pub fn position(file: &str, text: &str, line: usize, column: usize, message: impl Into<String>) -> Self {
        let excerpt = text.lines().nth(line.saturating_sub(1)).map(str::to_owned);
        Self { line, column, excerpt, ..Self::file(file, message) }
    }

    /// About a byte range of `text`.
    pub fn span(file: &str, text: &str, span: Range<usize>, message: impl Into<String>) -> Self {
        let before = text.get(..span.start).unwrap_or(text);
        let line = before.matches('\n').count() + 1;
        let column = before.rsplit('\n').next().map_or(0, |tail| tail.chars().count()) + 1;
        Self::position(file, text, line, column, message)
    }

    /// From the TOML reader, which knows the span.
    pub fn toml(file: &str, text: &str, error: &toml::de::Error) -> Self {
        let message = error.message().to_owned();
        let wrong = match error.span() {
            Some(span) => Self::span(file, text, span, message),
            None => Self::file(file, message),
        };
        match file.rsplit_once('.') {
            Some((_, kind @ ("csv" | "json" | "src" | "dat"))) => {
                wrong.help(format!("a .toml file is read here: is a .{kind} meant?"))
            }
            _ => wrong,
        }
    }

    /// From the CSV reader, which knows the line.
    pub fn csv(file: &str, error: &csv::Error) -> Self {
        let line = error.position().map_or(0, |position| position.line() as usize);
        match error.kind() {
            csv::ErrorKind::Io(error) => Self::file(file, format!("cannot be read: {error}")),
            csv::ErrorKind::Utf8 { .. } => Self::line(file, line, "is not UTF-8 text"),
            _ => Self::line(file, line, error.to_string()),
        }
    }

    /// With what to do about it.
    #[must_use]
    pub fn help(mut self, help: impl Into<String>) -> Self {
        self.help = Some(help.into());
        self
    }
}

impl fmt::Display for Diagnostic {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}", self.file)?;
        if self.line > 0 {
            write!(out, ":{}", self.line)?;
            if self.column > 0 {
                write!(out, ":{}", self.column)?;
            }
        }
        write!(out, ": {}", self.message)?;
        if let Some(excerpt) = &self.excerpt {
            // Tabs are kept before the caret so that it stays under its column.
            let indent: String = excerpt
                .chars()
                .take(self.column.saturating_sub(1))
                .map(|c| if c == '\t' { '\t' } else { ' ' })
                .collect();
            write!(out, "\n  | {excerpt}\n  | {indent}^")?;
        }
        if let Some(help) = &self.help {
            write!(out, "\n  help: {help}")?;
        }
        Ok(())
    }
}

impl std::error::Error for Diagnostic {}

/// The member of `known` that a mistyped `word` most likely means, if one is near.
pub fn nearest<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    known
        .into_iter()
        .map(|candidate| (edit_distance(word, candidate), candidate))
        .filter(|(distance, _)| *distance <= 1 + word.len() / 4)
        .min_by_key(|(distance, _)| *distance)
        .map(|(_, candidate)| candidate)
}

/// Levenshtein distance in characters.
fn edit_distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, from) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, to) in b.iter().enumerate() {
            let substitution = diagonal + usize::from(from != *to);
            diagonal = row[j + 1];
            row[j + 1] = substitution.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}
