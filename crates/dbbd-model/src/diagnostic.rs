//! Errors, warnings and information for the user: a finding with its code, sentence, help and values, and its place in
//! a file.
//!
//! A finding keeps its type: whoever decides by a finding asks [`Diagnostic::finding`] for it. The sentences are in the file
//! `catalogue.rs` of the room that owns them, made by the macro [`findings!`](crate::findings). This room knows no particular
//! finding and no way to show one.

mod code_log;

use std::any::Any;
use std::fmt;
use std::ops::Range;
use std::sync::Arc;

use serde::{Deserialize, Serialize, Serializer};
use serde_json::Value;

#[doc(hidden)]
pub use code_log::log_code;

/// The stable name of a finding: `E0123` for an error, `W0123` for a warning, `I0123` for information.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FindingCode(&'static str);

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// The exit code stays 0.
    Info,
    /// A loss or a warning: exit code 3.
    Warning,
    /// The command was refused or failed: exit code 1.
    Error,
}

impl FindingCode {
    pub const fn new(code: &'static str) -> Self {
        Self(code)
    }

    pub fn as_str(self) -> &'static str {
        self.0
    }

    /// The severity that the first letter means.
    pub fn severity(self) -> Severity {
        match self.0.as_bytes().first() {
            Some(b'I') => Severity::Info,
            Some(b'W') => Severity::Warning,
            _ => Severity::Error,
        }
    }
}

impl Severity {
    /// The word before a finding in a log or on a terminal.
    pub fn label(self) -> &'static str {
        match self {
            Self::Info => "note",
            Self::Warning => "warning",
            Self::Error => "error",
        }
    }
}

impl fmt::Display for FindingCode {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(self.0)
    }
}

impl Serialize for FindingCode {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.0)
    }
}

/// A sentence of a catalogue with its values; the macro [`findings!`](crate::findings) implements it.
pub trait Finding: Any + fmt::Debug + fmt::Display + Send + Sync {
    fn code(&self) -> FindingCode;

    /// The values by their field names; null if there are none.
    fn values(&self) -> Value;

    /// The advice what to do, if one line can say it.
    fn help(&self) -> Option<String>;

    /// The inputs of the request that the cure is about.
    fn asks(&self) -> &'static [Input];
}

/// The entry of the catalogue for a code.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    pub code: FindingCode,
    /// The event in a few words.
    pub title: &'static str,
    pub cause: &'static str,
    pub cure: &'static str,
    /// The sentences with the names of their values in braces.
    pub sentences: &'static [&'static str],
    /// The inputs of the request that the cure is about.
    pub asks: &'static [Input],
}

/// The entries of one family of findings, with its heading in docs/troubleshooting.md.
#[derive(Clone, Copy, Debug)]
pub struct Family {
    pub heading: &'static str,
    pub entries: &'static [Entry],
}

/// The inputs of a request besides its files. A finding names by them what to give or to correct; the command line
/// knows the option of each input, a page its field.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Input {
    Archive,
    /// Whether the base balls are mounted as in the calibration.
    BallsKept,
    BarUncertainty,
    BaseBalls,
    BaseFrame,
    CertificateTemperature,
    /// The repeatability of a circular test.
    CircleRepeatability,
    Controller,
    /// The controller's $config.dat, or a module with tools and work objects.
    ControllerConfig,
    ControllerModel,
    /// Whether axis 3 is shown against the horizontal.
    Coupled,
    Dates,
    /// The parameters that are estimated.
    Estimated,
    /// Rows that are left out of a fit.
    Exclude,
    Expansion,
    /// A fault of the simulated line or bar.
    Fault,
    /// The parameters that are fixed.
    Fixed,
    Folds,
    /// The longest time that a bar may be away.
    GoneTime,
    /// Whom the files of a robot are for.
    HandBackTarget,
    Identity,
    /// Whether an interim check is planned.
    InterimCheck,
    Language,
    /// The largest correction of a point.
    Limit,
    /// The name of a simulated line.
    Link,
    /// The address of a simulated line.
    ListenAddress,
    /// Whether nothing is sent to a bar.
    ListenOnly,
    /// The .dat with the axis angles that a program logged.
    LoggedAxes,
    MachineExpansion,
    Maker,
    /// Lengths of earlier stages.
    MeasuredLengths,
    Model,
    /// The place where the result is written.
    Out,
    /// Seconds of the simulated bar per second.
    Pace,
    /// A pose as the pendant of a controller shows it.
    PendantPose,
    Plan,
    Port,
    Positions,
    Prior,
    Protocol,
    ProtocolParameter,
    /// The address of the axes that a controller publishes.
    PublishedAxes,
    Radius,
    /// Runs whose remaining poses are planned.
    Remaining,
    /// A run whose poses are measured again.
    Repeat,
    /// Whether files of an earlier result are replaced.
    Replace,
    Risk,
    Robot,
    /// The place where received data are kept.
    Save,
    Search,
    /// Whether the configuration of the service is only checked.
    ServiceCheck,
    /// Whether parts of a measurement have one set-up.
    SetUpRelation,
    /// The standard deviation of a length.
    Sigma,
    Since,
    Specimen,
    Spool,
    Stage,
    /// The axis angles before a program.
    StartAxes,
    Store,
    /// The way in which a program marks its dwells.
    Synchronisation,
    /// The server in a program that sends telegrams.
    TelegramServer,
    /// The address at which telegrams are received.
    Telegrams,
    Tolerance,
    ToolBall,
    ToolFrame,
    Until,
    /// Whether an updated robot is written.
    Update,
    Urdf,
    UrdfJoints,
    /// Lengths that only validate.
    Validation,
    World,
    /// Whether the bar's zero is set.
    Zero,
}

/// Names in a sentence, separated by commas.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Names(pub Vec<String>);

impl Names {
    pub fn of<T: ToString>(names: impl IntoIterator<Item = T>) -> Self {
        Self(names.into_iter().map(|name| name.to_string()).collect())
    }
}

impl fmt::Display for Names {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(&self.0.join(", "))
    }
}

/// Defines an enum of findings: its codes with title, cause and cure, and under each code the sentences as variants
/// whose fields are the values in the sentence. The name of the family is followed by its heading.
#[macro_export]
macro_rules! findings {
    ($(#[$doc:meta])* $name:ident $heading:literal { $(
        $code:ident $title:literal, cause: $cause:literal, cure: $cure:literal
            $(, asks: [$($input:ident),+ $(,)?])? {
            $( $variant:ident $({ $($field:ident: $type:ty),+ $(,)? })? => $sentence:literal $(, help: $help:literal)? ; )+
        }
    )+ }) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq, serde::Serialize)]
        #[serde(untagged)]
        pub enum $name { $($( $variant $({ $($field: $type),+ })?, )+)+ }

        impl $name {
            pub const FAMILY: $crate::diagnostic::Family = $crate::diagnostic::Family {
                heading: $heading,
                entries: &[$( $crate::diagnostic::Entry {
                    code: $crate::diagnostic::FindingCode::new(stringify!($code)),
                    title: $title,
                    cause: $cause,
                    cure: $cure,
                    sentences: &[$($sentence),+],
                    asks: &[$($($crate::diagnostic::Input::$input),+)?],
                } ),+],
            };
        }

        impl $crate::diagnostic::Finding for $name {
            fn code(&self) -> $crate::diagnostic::FindingCode {
                let code = match self {
                    $($( Self::$variant { .. } )|+ => $crate::diagnostic::FindingCode::new(stringify!($code)),)+
                };
                $crate::diagnostic::log_code(code);
                code
            }

            fn values(&self) -> serde_json::Value {
                serde_json::to_value(self).unwrap_or_default()
            }

            fn asks(&self) -> &'static [$crate::diagnostic::Input] {
                match self {
                    $($( Self::$variant { .. } )|+ => &[$($($crate::diagnostic::Input::$input),+)?],)+
                }
            }

            #[allow(unused_variables)] // a help need not name all values
            fn help(&self) -> Option<String> {
                match self {
                    $($( Self::$variant $({ $($field),+ })? => $crate::finding_help!($($help)?), )+)+
                }
            }
        }

        impl std::fmt::Display for $name {
            #[allow(unused_variables)] // a sentence need not name all values
            fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                match self {
                    $($( Self::$variant $({ $($field),+ })? => write!(out, $sentence), )+)+
                }
            }
        }

        impl std::error::Error for $name {}

        impl From<$name> for $crate::diagnostic::Diagnostic {
            fn from(finding: $name) -> Self {
                Self::new(finding)
            }
        }
    };
}

/// The help of one sentence in [`findings!`](crate::findings).
#[doc(hidden)]
#[macro_export]
macro_rules! finding_help {
    () => {
        None
    };
    ($help:literal) => {
        Some(format!($help))
    };
}

/// A finding with its place in the user's file. It is the error type of everything that a user reads. The sentence is
/// formed when it is shown.
#[derive(Clone, Debug)]
pub struct Diagnostic {
    finding: Arc<dyn Finding>,
    file: String,
    line: usize,
    column: usize,
    /// Replaces the help of the finding.
    help: Option<Box<str>>,
    excerpt: Option<Box<str>>,
}

impl Diagnostic {
    /// A finding that concerns no file.
    pub fn new(finding: impl Finding) -> Self {
        Self {
            finding: Arc::new(finding),
            file: String::new(),
            line: 0,
            column: 0,
            help: None,
            excerpt: None,
        }
    }

    /// A finding that concerns a whole file.
    pub fn file(file: impl fmt::Display, finding: impl Finding) -> Self {
        Self::new(finding).in_file(file)
    }

    /// A finding in a line (from 1); the column is unknown.
    pub fn line(file: &str, line: usize, finding: impl Finding) -> Self {
        Self { line, ..Self::file(file, finding) }
    }

    /// A finding at a position (line and column from 1) of `text`; the line is printed.
    pub fn position(file: &str, text: &str, line: usize, column: usize, finding: impl Finding) -> Self {
        Self::new(finding).at(file, text, line, column)
    }

    /// A finding at the start of a byte range of `text`.
    pub fn span(file: &str, text: &str, span: Range<usize>, finding: impl Finding) -> Self {
        Self::new(finding).at_span(file, text, span)
    }

    /// The finding, if it is one of the family `F`.
    pub fn finding<F: Finding>(&self) -> Option<&F> {
        let finding: &dyn Any = self.finding.as_ref();
        finding.downcast_ref()
    }

    pub fn code(&self) -> FindingCode {
        self.finding.code()
    }

    pub fn severity(&self) -> Severity {
        self.code().severity()
    }

    /// The sentence, without place and help.
    pub fn message(&self) -> String {
        self.finding.to_string()
    }

    /// The values of the finding by name; null if it has none.
    pub fn values(&self) -> Value {
        self.finding.values()
    }

    /// The file as the user named it; empty if the finding concerns no file.
    pub fn file_name(&self) -> &str {
        &self.file
    }

    /// The line from 1; 0 if the finding concerns the whole file.
    pub fn line_number(&self) -> usize {
        self.line
    }

    /// The column from 1, in characters; 0 if unknown.
    pub fn column_number(&self) -> usize {
        self.column
    }

    /// The text of the line.
    pub fn excerpt(&self) -> Option<&str> {
        self.excerpt.as_deref()
    }

    /// The finding with its severity and its code: `warning[W0123]: FILE:LINE: ..`.
    pub fn labelled(&self) -> String {
        format!("{}[{}]: {self}", self.severity().label(), self.code())
    }

    /// The inputs of the request that the cure is about.
    pub fn asks(&self) -> &'static [Input] {
        self.finding.asks()
    }

    /// The advice what to do, in one line.
    pub fn help_line(&self) -> Option<String> {
        self.help.as_deref().map(str::to_owned).or_else(|| self.finding.help())
    }

    /// The same finding in another file.
    #[must_use]
    pub fn in_file(self, file: impl fmt::Display) -> Self {
        Self { file: file.to_string(), ..self }
    }

    /// The same finding in a line (from 1) of another file; the column is unknown.
    #[must_use]
    pub fn in_line_of(self, file: impl fmt::Display, line: usize) -> Self {
        Self { line, ..self.in_file(file) }
    }

    /// The same finding at a position (line and column from 1) of `text`; the line is printed.
    #[must_use]
    pub fn at(self, file: &str, text: &str, line: usize, column: usize) -> Self {
        let placed = Self { line, column, ..self.in_file(file) };
        match line.checked_sub(1).and_then(|at| text.lines().nth(at)) {
            Some(excerpt) => placed.in_line(excerpt, column),
            None => placed,
        }
    }

    /// The same finding at the start of a byte range of `text`.
    #[must_use]
    pub fn at_span(self, file: &str, text: &str, span: Range<usize>) -> Self {
        let before = text.get(..span.start).unwrap_or(text);
        let line = before.bytes().filter(|byte| *byte == b'\n').count() + 1;
        let start = before.rfind('\n').map_or(0, |end| end + 1);
        let column = before.get(start..).map_or(0, |tail| tail.chars().count()) + 1;
        let placed = Self { line, column, ..self.in_file(file) };
        match text.get(start..).and_then(|rest| rest.lines().next()) {
            Some(excerpt) => placed.in_line(excerpt, column),
            None => placed,
        }
    }

    /// Another finding at the same place.
    #[must_use]
    pub fn replaced_by(self, finding: impl Finding) -> Self {
        Self { finding: Arc::new(finding), help: None, ..self }
    }

    /// Adds the column (from 1) and the text of the line, printed with a caret under the column.
    #[must_use]
    pub fn in_line(mut self, text: &str, column: usize) -> Self {
        self.column = column;
        self.excerpt = Some(text.into());
        self
    }

    /// Adds the advice what to do, in one line.
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

impl PartialEq for Diagnostic {
    fn eq(&self, other: &Self) -> bool {
        let place = |one: &Self| (one.code(), one.line, one.column);
        place(self) == place(other)
            && (&self.file, &self.excerpt) == (&other.file, &other.excerpt)
            && self.help_line() == other.help_line()
            && self.message() == other.message()
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
        write!(out, "{}", self.finding)?;
        if let Some(excerpt) = &self.excerpt {
            // Tabs are copied, so that the caret is under its column.
            let before = self.column.saturating_sub(1);
            let indent: String =
                excerpt.chars().take(before).map(|c| if c == '\t' { '\t' } else { ' ' }).collect();
            write!(out, "\n  | {excerpt}\n  | {indent}^")?;
        }
        if let Some(help) = self.help_line() {
            write!(out, "\n  help: {help}")?;
        }
        Ok(())
    }
}

impl std::error::Error for Diagnostic {}

impl Serialize for Diagnostic {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        FindingRecord::from(self).serialize(serializer)
    }
}

/// A finding as files and other processes have it: its type is lost, its code and its values remain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FindingRecord {
    pub code: String,
    pub severity: Severity,
    /// The sentence, without place and help.
    pub text: String,
    /// The file as the user named it; empty if the finding concerns no file.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub file: String,
    /// The line from 1; `None` if the finding concerns the whole file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub line: Option<usize>,
    /// The column from 1, in characters; `None` if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub column: Option<usize>,
    /// The advice what to do, in one line.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub help: Option<String>,
    /// The values of the finding by name; null if it has none.
    #[serde(default, skip_serializing_if = "Value::is_null")]
    pub values: Value,
}

impl FindingRecord {
    /// The finding with its severity and its code in one line: `warning[W0123]: FILE:LINE: ..`.
    pub fn labelled(&self) -> String {
        format!("{}[{}]: {self}", self.severity.label(), self.code)
    }
}

impl fmt::Display for FindingRecord {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        if !self.file.is_empty() {
            write!(out, "{}:", self.file)?;
            for number in self.line.into_iter().chain(self.column) {
                write!(out, "{number}:")?;
            }
            write!(out, " ")?;
        }
        write!(out, "{}", self.text)
    }
}

impl From<&Diagnostic> for FindingRecord {
    fn from(diagnostic: &Diagnostic) -> Self {
        let known = |number: usize| (number > 0).then_some(number);
        Self {
            code: diagnostic.code().as_str().into(),
            severity: diagnostic.severity(),
            text: diagnostic.message(),
            file: diagnostic.file.clone(),
            line: known(diagnostic.line),
            column: known(diagnostic.column),
            help: diagnostic.help_line(),
            values: diagnostic.values(),
        }
    }
}

/// A finding of a result: typed while the result is in memory, a record once it was read from a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(into = "FindingRecord", from = "FindingRecord")]
pub enum RecordedFinding {
    Made(Diagnostic),
    Read(FindingRecord),
}

impl RecordedFinding {
    /// The finding as it was made; `None` if it was read.
    pub fn made(&self) -> Option<&Diagnostic> {
        match self {
            Self::Made(finding) => Some(finding),
            Self::Read(_) => None,
        }
    }

    pub fn code(&self) -> &str {
        match self {
            Self::Made(finding) => finding.code().as_str(),
            Self::Read(finding) => &finding.code,
        }
    }

    pub fn severity(&self) -> Severity {
        match self {
            Self::Made(finding) => finding.severity(),
            Self::Read(finding) => finding.severity,
        }
    }

    pub fn text(&self) -> String {
        match self {
            Self::Made(finding) => finding.message(),
            Self::Read(finding) => finding.text.clone(),
        }
    }

    /// The values by name; null if there are none.
    pub fn values(&self) -> Value {
        match self {
            Self::Made(finding) => finding.values(),
            Self::Read(finding) => finding.values.clone(),
        }
    }
}

impl From<Diagnostic> for RecordedFinding {
    fn from(finding: Diagnostic) -> Self {
        Self::Made(finding)
    }
}

impl From<FindingRecord> for RecordedFinding {
    fn from(finding: FindingRecord) -> Self {
        Self::Read(finding)
    }
}

impl From<RecordedFinding> for FindingRecord {
    /// The record has no place in the user's file, so that equal inputs give equal results wherever they are.
    fn from(finding: RecordedFinding) -> Self {
        match finding {
            RecordedFinding::Made(finding) => {
                Self { file: String::new(), line: None, column: None, help: None, ..(&finding).into() }
            }
            RecordedFinding::Read(record) => record,
        }
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
        .filter(|(distance, _)| *distance <= ((word.len() + 2) / 4).max(1))
        .min_by_key(|(distance, _)| *distance)
        .map(|(_, candidate)| candidate)
}

#[cfg(test)]
mod tests {
    use super::*;

    findings! {
        /// Findings of these tests.
        ExampleFinding "Examples" {
            E9999 "an example", cause: "It is needed.", cure: "None." {
                NoColumn { column: String } => "there is no column {column}", help: "add {column}";
                Empty => "is empty";
            }
        }
    }

    findings! {
        /// Findings of another room.
        OtherFinding "Others" {
            W9998 "another example", cause: "It is needed.", cure: "None." {
                Empty => "is empty";
            }
        }
    }

    #[test]
    fn a_finding_has_code_sentence_help_and_values() {
        let diagnostic = Diagnostic::line("obs.csv", 1, ExampleFinding::NoColumn { column: "index".into() });
        assert_eq!((diagnostic.code().as_str(), diagnostic.severity()), ("E9999", Severity::Error));
        let json = serde_json::to_value(&diagnostic).unwrap();
        assert_eq!((&json["line"], &json["values"]["column"]), (&1.into(), &"index".into()));
        let read: FindingRecord = serde_json::from_value(json).unwrap();
        assert_eq!(read, FindingRecord::from(&diagnostic));
        assert_eq!(diagnostic.help_line().as_deref(), Some("add index"));
    }

    #[test]
    fn a_finding_keeps_its_type() {
        let diagnostic = Diagnostic::new(ExampleFinding::Empty).in_file("a.csv");
        assert_eq!(diagnostic.finding(), Some(&ExampleFinding::Empty));
        assert!(diagnostic.finding::<OtherFinding>().is_none());
        let replaced = diagnostic.replaced_by(OtherFinding::Empty);
        assert_eq!((replaced.finding(), replaced.file_name()), (Some(&OtherFinding::Empty), "a.csv"));
    }

    /// One mistake in five letters, two in six.
    #[test]
    fn a_mistyped_word_means_the_nearest_one() {
        let known = ["ur10", "length", "kr60ha"];
        for (word, meant) in [
            ("lenght", Some("length")),
            ("kr6ah", None),
            ("KR60AH", Some("kr60ha")),
            ("kr210", None),
            ("u10", Some("ur10")),
        ] {
            assert_eq!(nearest(word, known), meant, "{word}");
        }
    }

    #[test]
    fn a_place_shows_the_line_with_a_caret_under_the_column() {
        let diagnostic = Diagnostic::span("a.toml", "one\n\ttwo\n", 5..6, ExampleFinding::Empty);
        assert_eq!(diagnostic.to_string(), "a.toml:2:2: is empty\n  | \ttwo\n  | \t^");
    }
}
