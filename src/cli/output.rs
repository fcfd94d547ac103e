//! What goes to stdout (results) and stderr (progress, warnings, errors), and the exit code.

use std::error::Error;
use std::io::{self, IsTerminal, Write};
use std::process::ExitCode;

use serde::Serialize;

use super::{Common, Outcome, Verdict};
use crate::run::Note;
use crate::sync;

/// Where a verb says things.
#[derive(Clone, Copy)]
pub(crate) struct Output {
    common: Common,
}

impl Output {
    pub(super) fn new(common: Common) -> Self {
        Self { common }
    }

    /// A line of the result for people, on stdout; not said under `--json`.
    pub(crate) fn result(&self, line: impl AsRef<str>) {
        if !self.common.json {
            write_line(&mut io::stdout(), line.as_ref());
        }
    }

    /// The result as JSON on stdout, under `--json` only.
    ///
    /// # Errors
    /// When `value` cannot be written as JSON.
    pub(crate) fn document(&self, value: &impl Serialize) -> Result<(), Box<dyn Error>> {
        if self.common.json {
            write_line(&mut io::stdout(), &serde_json::to_string_pretty(value)?);
        }
        Ok(())
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

    /// What the user must see, on stderr; also under `--quiet`.
    pub(crate) fn warning(&self, line: impl AsRef<str>) {
        write_line(&mut io::stderr(), &format!("warning: {}", line.as_ref()));
    }

    /// What a run that was read has to say.
    pub(crate) fn note(&self, note: &Note) {
        match note {
            Note::Warning(text) => self.warning(text),
            Note::Remark(text) => self.progress(text),
        }
    }

    /// What the matching of lengths to poses warns of; only doubts are warnings to the user.
    pub(crate) fn matching(&self, warnings: &[sync::Warning]) {
        for warning in warnings {
            if warning.doubt { self.warning(&warning.text) } else { self.progress(&warning.text) }
        }
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

/// A reader that has gone (`dbbd info RUN | head`) is no reason to fail. One write a line: what a child and its parent say
/// on one stderr stays in lines.
fn write_line(to: &mut impl Write, line: &str) {
    let _ = to.write_all(format!("{line}\n").as_bytes());
}

/// Says the error, if there is one, and turns the verdict into the exit code.
pub(super) fn finish(out: &Output, verdict: Verdict) -> ExitCode {
    match verdict {
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::Doubt) => ExitCode::from(if out.common.strict { 1 } else { 3 }),
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
