//! Errors, warnings and information as a user reads them: stable code, place in a file, sentence, help, values.
//!
//! The sentences are in [`crate::catalogue`].

use std::fmt;
use std::ops::Range;

use serde::{Serialize, Serializer};
use serde_json::Value;

/// The stable name of a finding: `E0123` for an error, `W0123` for a warning, `I0123` for information.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Code(pub &'static str);

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// The exit code stays 0.
    Info,
    /// A loss or a doubt: exit code 3.
    Warning,
    /// The command was refused or failed: exit code 1.
    Error,
}

impl Code {
    /// The severity that the first letter stands for.
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

/// A sentence of the catalogue with its values. [`crate::catalogue`] defines all of them.
pub trait Finding: fmt::Display {
    fn code(&self) -> Code;

    /// The values by their field names; null if there are none.
    fn values(&self) -> Value {
        Value::Null
    }

    /// What to do, if one line can say it.
    fn help(&self) -> Option<String> {
        None
    }
}

/// A finding with its place in the user's file. It is the error type of everything that a user reads.
#[derive(Clone, Debug, PartialEq)]
pub struct Diagnostic {
    pub code: Code,
    /// The file as the user named it; empty if the finding concerns no file.
    pub file: String,
    /// Line from 1; 0 if the finding concerns the whole file.
    pub line: usize,
    /// Column from 1, in characters; 0 if unknown.
    pub column: usize,
    pub message: String,
    pub help: Option<Box<str>>,
    /// The text of the line, printed with a caret under the column.
    pub excerpt: Option<Box<str>>,
    /// The values of the finding by name.
    pub values: Box<Value>,
}

impl Diagnostic {
    /// A finding that concerns no file.
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

    /// A finding that concerns a whole file.
    pub fn file(file: impl fmt::Display, finding: impl Finding) -> Self {
        Self { file: file.to_string(), ..Self::new(finding) }
    }

    /// A finding in a line (from 1); the column is unknown.
    pub fn line(file: &str, line: usize, finding: impl Finding) -> Self {
        Self { line, ..Self::file(file, finding) }
    }

    /// A finding at a position (line and column from 1) of `text`; the line is printed.
    pub fn position(file: &str, text: &str, line: usize, column: usize, finding: impl Finding) -> Self {
        let wrong = Self::line(file, line, finding);
        match line.checked_sub(1).and_then(|at| text.lines().nth(at)) {
            Some(excerpt) => wrong.in_line(excerpt, column),
            None => Self { column, ..wrong },
        }
    }

    /// A finding at the start of a byte range of `text`.
    pub fn span(file: &str, text: &str, span: Range<usize>, finding: impl Finding) -> Self {
        let before = text.get(..span.start).unwrap_or(text);
        let line = before.matches('\n').count() + 1;
        let column = before.rsplit('\n').next().map_or(0, |tail| tail.chars().count()) + 1;
        Self::position(file, text, line, column, finding)
    }

    /// Adds the column (from 1) and the text of the line.
    #[must_use]
    pub fn in_line(mut self, text: &str, column: usize) -> Self {
        self.column = column;
        self.excerpt = Some(text.into());
        self
    }

    /// Adds what to do, in one line.
    #[must_use]
    pub fn help(mut self, help: impl AsRef<str>) -> Self {
        self.help = Some(help.as_ref().into());
        self
    }

    /// Suggests the member of `known` that a mistyped `word` most likely means, if one is near.
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
            // Tabs are copied, so that the caret is under its column.
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
            #[serde(skip_serializing_if = "Option::is_none")]
            line: Option<usize>,
            #[serde(skip_serializing_if = "Option::is_none")]
            column: Option<usize>,
            #[serde(skip_serializing_if = "Option::is_none")]
            help: Option<&'a str>,
            #[serde(skip_serializing_if = "Value::is_null")]
            values: &'a Value,
        }
        let known = |number: usize| (number > 0).then_some(number);
        let fields = Fields {
            code: self.code,
            severity: self.code.severity(),
            text: &self.message,
            file: &self.file,
            line: known(self.line),
            column: known(self.column),
            help: self.help.as_deref(),
            values: &self.values,
        };
        fields.serialize(serializer)
    }
}

/// The member of `known` that a mistyped `word` most likely means, if one is near.
pub fn nearest<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    // Upper and lower case count as equal; two swapped letters count as one mistake.
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
