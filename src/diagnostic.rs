//! What a user reads when something is wrong or doubtful: a stable code, the place, the sentence, what to do, and the
//! numbers behind it.
//!
//! The sentences are in [`crate::catalogue`]; this module knows none.

use std::fmt;
use std::ops::Range;

use serde::{Serialize, Serializer};
use serde_json::Value;

/// The stable name of a finding: `E0123` an error, `W0123` a warning, `I0123` an information.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Code(pub &'static str);

/// How much a finding matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// Worth knowing; the exit code stays 0.
    Info,
    /// A loss or a doubt: exit code 3.
    Warning,
    /// Nothing was done: exit code 1.
    Error,
}

impl Code {
    /// As the first letter says.
    pub fn severity(self) -> Severity {
        match self.0.as_bytes().first() {
            Some(b'I') => Severity::Info,
            Some(b'W') => Severity::Warning,
            _ => Severity::Error,
        }
    }
}

impl fmt::Display for Code {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(self.0)
    }
}

impl Serialize for Code {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.0)
    }
}

/// One sentence of the catalogue with its numbers. [`crate::catalogue`] defines all of them.
pub trait Finding: fmt::Display {
    /// Its stable code.
    fn code(&self) -> Code;

    /// Its numbers and names by their field names; null if it has none.
    fn values(&self) -> Value {
        Value::Null
    }

    /// What to do, where one line suffices.
    fn help(&self) -> Option<String> {
        None
    }
}

/// A finding with the place in the user's file that it is about. Every error that a user reads is one.
#[derive(Clone, Debug, PartialEq)]
pub struct Diagnostic {
    pub code: Code,
    /// The file as the user named it; empty if the finding is about no file.
    pub file: String,
    /// Line from 1; 0 if the finding is about the whole file.
    pub line: usize,
    /// Column from 1, in characters; 0 if unknown.
    pub column: usize,
    /// What is wrong.
    pub message: String,
    /// What to do about it.
    pub help: Option<Box<str>>,
    /// The text of the line, to point into.
    pub excerpt: Option<Box<str>>,
    /// The numbers of the finding.
    pub values: Box<Value>,
}

impl Diagnostic {
    /// About no file.
    pub fn new(finding: impl Finding) -> Self {
        Self {
            code: finding.code(),
            file: String::new(),
            line: 0,
            column: 0,
            message: finding.to_string(),
            help: finding.help().map(Into::into),
            excerpt: None,
            values: Box::new(finding.values()),
        }
    }

    /// About the whole file.
    pub fn file(file: &str, finding: impl Finding) -> Self {
        Self { file: file.into(), ..Self::new(finding) }
    }

    /// About a line (from 1), column unknown.
    pub fn line(file: &str, line: usize, finding: impl Finding) -> Self {
        Self { line, ..Self::file(file, finding) }
    }

    /// About a position (line and column from 1) in `text`, whose line is shown.
    pub fn position(file: &str, text: &str, line: usize, column: usize, finding: impl Finding) -> Self {
        let wrong = Self::line(file, line, finding);
        match line.checked_sub(1).and_then(|at| text.lines().nth(at)) {
            Some(excerpt) => wrong.in_line(excerpt, column),
            None => Self { column, ..wrong },
        }
    }

    /// About a byte range of `text`.
    pub fn span(file: &str, text: &str, span: Range<usize>, finding: impl Finding) -> Self {
        let before = text.get(..span.start).unwrap_or(text);
        let line = before.matches('\n').count() + 1;
        let column = before.rsplit('\n').next().map_or(0, |tail| tail.chars().count()) + 1;
        Self::position(file, text, line, column, finding)
    }

    /// At a column (from 1) of the line, whose text is shown.
    #[must_use]
    pub fn in_line(mut self, text: &str, column: usize) -> Self {
        self.column = column;
        self.excerpt = Some(text.into());
        self
    }

    /// With a further line on what to do.
    #[must_use]
    pub fn help(mut self, help: impl AsRef<str>) -> Self {
        self.help = Some(help.as_ref().into());
        self
    }

    /// With the member of `known` that a mistyped `word` most likely means, if one is near.
    #[must_use]
    pub fn nearest<'a>(self, word: &str, known: impl IntoIterator<Item = &'a str>) -> Self {
        match nearest(word, known) {
            Some(near) => self.help(format!("did you mean `{near}`?")),
            None => self,
        }
    }
}

impl fmt::Display for Diagnostic {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        if !self.file.is_empty() {
            write!(out, "{}:", self.file)?;
            if self.line > 0 {
                write!(out, "{}:", self.line)?;
                if self.column > 0 {
                    write!(out, "{}:", self.column)?;
                }
            }
            write!(out, " ")?;
        }
        write!(out, "{}", self.message)?;
        if let Some(excerpt) = &self.excerpt {
            // Tabs are kept before the caret so that it stays under its column.
            let before = self.column.saturating_sub(1);
            let indent: String =
                excerpt.chars().take(before).map(|c| if c == '\t' { '\t' } else { ' ' }).collect();
            write!(out, "\n  | {excerpt}\n  | {indent}^")?;
        }
        if let Some(help) = &self.help {
            write!(out, "\n  help: {help}")?;
        }
        Ok(())
    }
}

impl std::error::Error for Diagnostic {}

impl Serialize for Diagnostic {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Fields<'a> {
            code: Code,
            severity: Severity,
            text: &'a str,
            #[serde(skip_serializing_if = "str::is_empty")]
            file: &'a str,
            #[serde(skip_serializing_if = "is_zero")]
            line: usize,
            #[serde(skip_serializing_if = "is_zero")]
            column: usize,
            #[serde(skip_serializing_if = "Option::is_none")]
            help: Option<&'a str>,
            #[serde(skip_serializing_if = "Value::is_null")]
            values: &'a Value,
        }
        let &Self { code, line, column, .. } = self;
        let severity = code.severity();
        let (text, file, help) = (self.message.as_str(), self.file.as_str(), self.help.as_deref());
        Fields { code, severity, text, file, line, column, help, values: &self.values }.serialize(serializer)
    }
}

fn is_zero(number: &usize) -> bool {
    *number == 0
}

/// The member of `known` that a mistyped `word` most likely means, if one is near.
pub fn nearest<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    // Another case is nearer than any other letter; two letters that are swapped are one mistake.
    let distance = |candidate: &str| {
        let (word, lower) = (word.to_lowercase(), candidate.to_lowercase());
        strsim::damerau_levenshtein(&word, &lower)
    };
    known
        .into_iter()
        .map(|candidate| (distance(candidate), candidate))
        .filter(|(distance, _)| *distance <= 1 + word.len() / 4)
        .min_by_key(|(distance, _)| *distance)
        .map(|(_, candidate)| candidate)
}
