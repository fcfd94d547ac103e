//! What goes to stdout (results) and stderr (progress, warnings, errors), and the exit code.

use std::borrow::Cow;
use std::io::{self, IsTerminal, Write};
use std::process::ExitCode;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use serde::Serialize;

use super::{Common, Outcome, Verdict};
use crate::catalogue::{CliFinding, FileFinding};
use crate::diagnostic::{Diagnostic, Finding, Severity};

/// Where a verb reports; its copies share the findings.
#[derive(Clone)]
pub(crate) struct Output {
    common: Common,
    findings: Arc<Mutex<Vec<Diagnostic>>>,
    /// Why stdout does not take the result.
    refused: Arc<OnceLock<String>>,
}

/// A result with what was found on the way to it.
#[derive(Serialize)]
struct Document<'a, T> {
    #[serde(flatten)]
    result: &'a T,
    #[serde(skip_serializing_if = "<[Diagnostic]>::is_empty")]
    findings: &'a [Diagnostic],
}

impl Output {
    pub(super) fn new(common: Common) -> Self {
        Self { common, findings: Arc::default(), refused: Arc::default() }
    }

    /// A line of the result for people, on stdout; not said under `--json`.
    pub(crate) fn result(&self, line: impl AsRef<str>) {
        if !self.common.json {
            self.print(&plain(line.as_ref()));
        }
    }

    /// A text for another program on stdout, as it is.
    pub(crate) fn text(&self, text: &[u8]) {
        let mut stdout = io::stdout();
        match stdout.write_all(text).and_then(|()| stdout.flush()) {
            // A reader that has gone (`dbbd info RUN | head`) is no reason to fail.
            Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
                self.refused.get_or_init(|| error.to_string());
            }
            _ => {}
        }
    }

    fn print(&self, text: &str) {
        self.text(format!("{text}\n").as_bytes());
    }

    /// The result, a struct or a map, as JSON on stdout, under `--json` only. The findings that were reported before
    /// are its `findings`.
    ///
    /// # Errors
    /// When it cannot be written as JSON.
    pub(crate) fn document(&self, result: &impl Serialize) -> Result<(), Diagnostic> {
        self.json(&Document { result, findings: &self.findings() })
    }

    /// A result that is a list, as JSON on stdout, under `--json` only.
    ///
    /// # Errors
    /// When it cannot be written as JSON.
    pub(crate) fn list(&self, list: &[impl Serialize]) -> Result<(), Diagnostic> {
        self.json(&list)
    }

    fn json(&self, value: &impl Serialize) -> Result<(), Diagnostic> {
        if self.common.json {
            let text = serde_json::to_string_pretty(value)
                .map_err(|error| CliFinding::NoJson { why: error.to_string() })?;
            self.print(&plain(&text));
        }
        Ok(())
    }

    fn findings(&self) -> MutexGuard<'_, Vec<Diagnostic>> {
        self.findings.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What goes on, on stderr; not said under `--quiet`.
    pub(crate) fn progress(&self, line: impl AsRef<str>) {
        if !self.common.quiet {
            write_line(&mut io::stderr(), line.as_ref());
        }
    }

    /// What only `-v` wants to know, on stderr.
    pub(crate) fn detail(&self, line: impl AsRef<str>) {
        if self.common.verbose {
            write_line(&mut io::stderr(), line.as_ref());
        }
    }

    /// A finding on stderr; an information is not reported under `--quiet`. A warning makes the exit code 3.
    pub(crate) fn finding(&self, finding: impl Into<Diagnostic>) {
        let finding = finding.into();
        if finding.code.severity() > Severity::Info || !self.common.quiet {
            write_line(&mut io::stderr(), &labelled(&finding));
        }
        self.findings().push(finding);
    }

    /// Findings about a result.
    pub(crate) fn about<F: Finding + Clone>(&self, findings: &[F]) {
        findings.iter().for_each(|finding| self.finding(Diagnostic::new(finding.clone())));
    }

    /// A line on stderr, as it is; also under `--quiet`.
    pub(crate) fn always(&self, line: impl AsRef<str>) {
        write_line(&mut io::stderr(), line.as_ref());
    }

    /// Whether nothing but errors is wanted on stderr.
    pub(crate) fn is_quiet(&self) -> bool {
        self.common.quiet
    }

    /// Whether stderr is a terminal on which bars and colour are wanted.
    pub(crate) fn decorated(&self) -> bool {
        !self.common.quiet && io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none()
    }
}

/// One write a line: what a child and its parent say on one stderr stays in lines. Who closed it does not listen.
fn write_line(to: &mut impl Write, line: &str) {
    let _ = to.write_all(format!("{}\n", plain(line)).as_bytes());
}

/// A text without what would steer a terminal: files and devices speak here as well. The escapes are those of JSON.
fn plain(text: &str) -> Cow<'_, str> {
    let steers = |c: char| c.is_control() && c != '\n' && c != '\t';
    if !text.contains(steers) {
        return text.into();
    }
    let shown = |c: char| if steers(c) { format!("\\u{:04x}", u32::from(c)) } else { c.into() };
    text.chars().map(shown).collect::<String>().into()
}

/// A finding as a line, such as `warning[W0123]: FILE:LINE: ..`.
fn labelled(finding: &Diagnostic) -> String {
    let label = match finding.code.severity() {
        Severity::Info => "note",
        Severity::Warning => "warning",
        Severity::Error => "error",
    };
    format!("{label}[{}]: {finding}", finding.code)
}

/// Reports the error, if there is one; the exit code. A warning that was reported is a doubt, whatever the verb.
pub(super) fn finish(out: &Output, verdict: Verdict) -> ExitCode {
    let verdict = match out.refused.get() {
        Some(why) => {
            verdict.and(Err(Diagnostic::file("stdout", FileFinding::Unwritable { why: why.clone() }).into()))
        }
        None => verdict,
    };
    let warned = out.findings().iter().any(|finding| finding.code.severity() == Severity::Warning);
    match verdict {
        Ok(Outcome::Done) if !warned => ExitCode::SUCCESS,
        Ok(Outcome::Failed) => ExitCode::from(4),
        Ok(_) => ExitCode::from(if out.common.strict { 1 } else { 3 }),
        Err(error) if error.is::<Diagnostic>() => {
            if let Some(diagnostic) = error.downcast_ref::<Diagnostic>() {
                write_line(&mut io::stderr(), &labelled(diagnostic));
                if out.common.json {
                    let document = serde_json::json!({ "error": diagnostic });
                    out.print(&plain(&format!("{document:#}")));
                }
            }
            ExitCode::FAILURE
        }
        Err(error) => {
            let mut message = format!("error: {error}");
            let mut cause = error.source();
            while let Some(inner) = cause {
                message.push_str(&format!("\n  because: {inner}"));
                cause = inner.source();
            }
            write_line(&mut io::stderr(), &message);
            ExitCode::FAILURE
        }
    }
}
