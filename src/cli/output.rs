//! What goes to stdout (results) and stderr (progress, warnings, errors), and the exit code.

use std::borrow::Cow;
use std::error::Error;
use std::fs::File;
use std::io::{self, BufRead, BufReader, IsTerminal, Write};
use std::path::Path;
use std::process::ExitCode;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use super::{Common, Outcome};
use crate::base::files;
use crate::base::program::{PROGRESS, PROGRESS_VARIABLE};
use crate::base::serialised;
use crate::base::sync::lock;
use crate::base::table::{Layout, Table};
use crate::catalogue::{CliFinding, CompensationFinding, EstimationFinding, FileFinding, PortFinding};
use crate::diagnostic::{Code, Diagnostic, Finding, Severity};
use crate::recording::axes::PacketCounts;

/// How often a line on the terminal moves.
const TICK: Duration = Duration::from_millis(100);

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

/// A line on the terminal that moves; it is cleared when this is dropped.
pub(crate) struct Busy {
    line: ProgressBar,
}

impl Drop for Busy {
    fn drop(&mut self) {
        self.line.finish_and_clear();
    }
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
            self.print(&plain(&serialised::json(value)?));
        }
        Ok(())
    }

    fn findings(&self) -> MutexGuard<'_, Vec<Diagnostic>> {
        lock(&self.findings)
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

    /// Reads a table of the user's, says how far it is, and once how it is written where that is not the usual way.
    ///
    /// # Errors
    /// When it cannot be opened, and what `read` refuses.
    pub(crate) fn table<T>(
        &self,
        path: &Path,
        read: impl FnOnce(&mut Table<'_>) -> Result<T, Diagnostic>,
    ) -> Result<T, Diagnostic> {
        let (source, busy) = self.source(path)?;
        let mut table = Table::new(&path.display().to_string(), source, Layout::default())?;
        let found = read(&mut table)?;
        drop(busy);
        table.findings().into_iter().for_each(|finding| self.finding(finding));
        Ok(found)
    }

    /// A file to read, and the line on the terminal that says how far it is read.
    ///
    /// # Errors
    /// When it cannot be opened.
    pub(crate) fn source(&self, path: &Path) -> Result<(impl BufRead + use<>, Busy), Diagnostic> {
        let name = path.display().to_string();
        let unreadable = files::unreadable(&name);
        let file = File::open(path).map_err(&unreadable)?;
        let bytes = file.metadata().map_err(&unreadable)?.len();
        let busy = self.busy(&format!("reading {name}"), Some(bytes));
        Ok((BufReader::new(busy.line.wrap_read(file)), busy))
    }

    /// How much of the command is done, per cent, by its steps; for the service that started it.
    pub(crate) fn done(&self, percent: u8) {
        if std::env::var_os(PROGRESS_VARIABLE).is_some() {
            write_line(&mut io::stderr(), &format!("{PROGRESS} {percent}"));
        }
    }

    /// A line on the terminal that moves until it is dropped, with the share of `of` where that is known.
    pub(crate) fn busy(&self, what: &str, of: Option<u64>) -> Busy {
        let line = if self.decorated() { ProgressBar::no_length() } else { ProgressBar::hidden() };
        let template = match of {
            Some(length) => {
                line.set_length(length);
                "{spinner} {msg} {percent} %"
            }
            None => "{spinner} {msg} {elapsed}",
        };
        line.set_style(style(template));
        line.set_message(what.to_owned());
        line.enable_steady_tick(TICK);
        Busy { line }
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

/// How a line on the terminal looks.
pub(crate) fn style(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_spinner())
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

/// Reports what is wrong with the command line, with the code of a value that is refused; the exit code.
pub(super) fn wrong_usage(usage: &clap::Error) -> ExitCode {
    match usage.source().and_then(code) {
        Some(code) => {
            let text = usage.render().to_string().replacen("error:", &format!("error[{code}]:"), 1);
            write_line(&mut io::stderr(), text.trim_end());
        }
        // A reader that has gone is no reason to fail.
        None if usage.print().is_err_and(|error| error.kind() != io::ErrorKind::BrokenPipe) => {
            return ExitCode::FAILURE;
        }
        None => {}
    }
    ExitCode::from(u8::try_from(usage.exit_code()).unwrap_or(2))
}

/// The code of what a parser of a value says.
fn code(why: &(dyn Error + 'static)) -> Option<Code> {
    fn of<F: Finding + Error + 'static>(why: &(dyn Error + 'static)) -> Option<Code> {
        why.downcast_ref::<F>().map(Finding::code)
    }
    of::<CliFinding>(why)
        .or_else(|| of::<EstimationFinding>(why))
        .or_else(|| of::<CompensationFinding>(why))
        .or_else(|| of::<PortFinding>(why))
}

/// Reports the error, if there is one; the exit code. A warning that was reported is a doubt, whatever the verb.
pub(super) fn finish(out: &Output, ended: Result<Outcome, Diagnostic>) -> ExitCode {
    let ended = match out.refused.get() {
        Some(why) => ended.and(Err(Diagnostic::file("stdout", FileFinding::Unwritable { why: why.clone() }))),
        None => ended,
    };
    let warned = out.findings().iter().any(|finding| finding.code.severity() == Severity::Warning);
    match ended {
        Ok(Outcome::Done) if !warned => ExitCode::SUCCESS,
        Ok(Outcome::Failed) => ExitCode::from(4),
        Ok(_) => ExitCode::from(if out.common.strict { 1 } else { 3 }),
        Err(error) => {
            write_line(&mut io::stderr(), &labelled(&error));
            if out.common.json {
                let document = serde_json::json!({ "error": error });
                out.print(&plain(&format!("{document:#}")));
            }
            ExitCode::FAILURE
        }
    }
}

/// The packets of a controller's axes on one line; what there is none of is left out.
pub(super) fn packets(counts: &PacketCounts) -> String {
    let rate = match counts.cycle_us {
        0 => String::new(),
        us => format!(" every {} ms", us as f64 * 1e-3),
    };
    let others = [
        (counts.lost, "lost"),
        (counts.late, "late"),
        (counts.doubled, "twice"),
        (counts.stray, "astray"),
        (counts.malformed, "malformed"),
        (counts.restarts, "restarts of the clock"),
        (u64::from(counts.late_answers), "answers late"),
    ];
    let others = others.into_iter().filter(|(count, _)| *count > 0);
    let others: String = others.map(|(count, what)| format!(", {count} {what}")).collect();
    format!("{} packets{rate}{others}", counts.packets)
}
