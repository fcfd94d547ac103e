//! Prints results on stdout, and progress, warnings and errors on stderr. Determines the exit code.

use std::collections::BTreeSet;
use std::error::Error;
use std::fmt::Display;
use std::io::{self, IsTerminal, Write};
use std::path::Path;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use super::{CommandOutcome, CommonOptions};
use crate::cli::{CliFinding, options_of};
use dbbd_device::port::PortFinding;
use dbbd_device::sync::lock;
use dbbd_job::child_process::{PROGRESS, PROGRESS_VARIABLE, end_with_stdin};
use dbbd_job::recording::axes::PacketCounts;
use dbbd_job::request::{Answer, BusyIndicator, RequestWatch, read_table};
use dbbd_model::base::FileFinding;
use dbbd_model::base::InternalFinding;
use dbbd_model::base::serialised;
use dbbd_model::base::table::TableReader;
use dbbd_model::base::text::escape_controls;
use dbbd_model::diagnostic::{Diagnostic, Finding, FindingCode, Severity};
use dbbd_model::estimation::Observability;
use dbbd_model::provenance::DataOrigin;

/// The period of the progress indicator.
const TICK: Duration = Duration::from_millis(100);

/// The output of a command. Clones share the reported findings.
#[derive(Clone)]
pub(crate) struct CommandOutput {
    common: CommonOptions,
    /// Names of the command's long options.
    options: Arc<BTreeSet<String>>,
    results: ResultStream,
    reported: Arc<Mutex<Vec<Diagnostic>>>,
    /// Whether a command that this one started ended with a warning, which it printed itself.
    child_warned: Arc<AtomicBool>,
    /// The first error of writing to stdout.
    stdout_error: Arc<OnceLock<String>>,
}

/// Where the lines of a result go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ResultStream {
    Stdout,
    /// Stdout has the answer to a request.
    Stderr,
}

/// A progress indicator on the terminal. It is cleared when it is dropped.
struct ProgressIndicator {
    line: ProgressBar,
}

impl Drop for ProgressIndicator {
    fn drop(&mut self) {
        self.line.finish_and_clear();
    }
}

impl CommandOutput {
    /// `options` are the names of the command's long options.
    pub(super) fn new(common: CommonOptions, options: BTreeSet<String>) -> Self {
        Self {
            common,
            options: options.into(),
            results: ResultStream::Stdout,
            reported: Arc::default(),
            child_warned: Arc::default(),
            stdout_error: Arc::default(),
        }
    }

    /// The output of `dbbd request`: stdout has the answer alone.
    pub(super) fn of_request(self) -> Self {
        let common = CommonOptions { json: false, strict: false, ..self.common };
        Self { results: ResultStream::Stderr, common, ..self }
    }

    /// Ends this process when its standard input closes, if it is a child process that was asked to.
    pub(super) fn end_with_stdin(&self) -> Result<(), Diagnostic> {
        if !self.common.until_stdin_closes {
            return Ok(());
        }
        end_with_stdin().map_err(|error| InternalFinding::NoSystem { why: error.to_string() }.into())
    }

    /// Prints the answer to a request as JSON on stdout.
    pub(super) fn answer(&self, answer: &Answer) -> Result<(), Diagnostic> {
        self.print(&escape_controls(&answer.to_json()?));
        Ok(())
    }

    /// Prints a line of the result on stdout, unless `--json` is given.
    pub(crate) fn result(&self, line: impl AsRef<str>) {
        match self.results {
            _ if self.common.json => {}
            ResultStream::Stdout => self.print(&escape_controls(line.as_ref())),
            ResultStream::Stderr => write_line(&mut io::stderr(), line.as_ref()),
        }
    }

    /// Prints a named value of the result on stdout, in one line.
    pub(crate) fn field(&self, name: &str, value: impl Display) {
        self.result(format!("{name:16} {}", value.to_string().replace('\n', "\\n")));
    }

    /// Prints bytes on stdout as they are.
    pub(crate) fn text(&self, text: &[u8]) {
        let mut stdout = io::stdout();
        match stdout.write_all(text).and_then(|()| stdout.flush()) {
            // `dbbd info RUN | head` closes the pipe: that is not an error.
            Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
                self.stdout_error.get_or_init(|| error.to_string());
            }
            _ => {}
        }
    }

    fn print(&self, text: &str) {
        self.text(format!("{text}\n").as_bytes());
    }

    /// With `--json`, prints a struct or a map as JSON on stdout, with the findings reported so far as `findings`, before
    /// those that it has itself.
    pub(crate) fn document(&self, result: &impl Serialize) -> Result<(), Diagnostic> {
        if !self.common.json {
            return Ok(());
        }
        let not_json = |error: serde_json::Error| InternalFinding::NotJson { why: error.to_string() };
        let mut findings = Vec::new();
        for finding in lock(&self.reported).iter() {
            findings.push(serde_json::to_value(finding).map_err(not_json)?);
        }
        let mut document = serde_json::to_value(result).map_err(not_json)?;
        if let Some(own) = document.get_mut("findings").and_then(serde_json::Value::as_array_mut) {
            findings.append(own);
        }
        if let Some(fields) = document.as_object_mut().filter(|_| !findings.is_empty()) {
            fields.insert("findings".into(), findings.into());
        }
        self.json(&document)
    }

    /// With `--json`, prints a list as JSON on stdout.
    pub(crate) fn list(&self, list: &[impl Serialize]) -> Result<(), Diagnostic> {
        self.json(&list)
    }

    fn json(&self, value: &impl Serialize) -> Result<(), Diagnostic> {
        if self.common.json {
            self.print(&escape_controls(&serialised::json(value)?));
        }
        Ok(())
    }

    /// Prints a line on stderr, unless `--quiet` is given.
    pub(crate) fn progress(&self, line: impl AsRef<str>) {
        if !self.common.quiet {
            write_line(&mut io::stderr(), line.as_ref());
        }
    }

    /// Prints a line on stderr with `--verbose`.
    pub(crate) fn detail(&self, line: impl AsRef<str>) {
        if self.common.verbose {
            write_line(&mut io::stderr(), line.as_ref());
        }
    }

    /// Reports a finding on stderr; information not with `--quiet`. A warning makes the exit code 3.
    pub(crate) fn finding(&self, finding: impl Into<Diagnostic>) {
        let finding = finding.into();
        if finding.severity() > Severity::Info || !self.common.quiet {
            write_line(&mut io::stderr(), &self.labelled(&finding));
        }
        lock(&self.reported).push(finding);
    }

    /// A finding as a line `warning[W0123]: FILE:LINE: ..`, with the options of this command that its cure is about.
    fn labelled(&self, finding: &Diagnostic) -> String {
        let options = options_of(finding.asks(), |name| self.options.contains(name));
        let options = options.map_or_else(String::new, |options| format!("\n  options: {options}"));
        format!("{}{options}", finding.labelled())
    }

    pub(crate) fn findings<F: Into<Diagnostic>>(&self, findings: impl IntoIterator<Item = F>) {
        findings.into_iter().for_each(|finding| self.finding(finding));
    }

    /// Reports findings that concern a file.
    pub(crate) fn findings_in<F: Finding>(&self, file: impl Display, findings: impl IntoIterator<Item = F>) {
        findings.into_iter().for_each(|finding| self.finding(Diagnostic::file(&file, finding)));
    }

    /// A command that this one started printed a warning: the exit code is 3, as after a warning of our own.
    pub(crate) fn warned_by_child(&self) {
        self.child_warned.store(true, Ordering::Relaxed);
    }

    /// Prints a line on stderr even with `--quiet`.
    pub(crate) fn always(&self, line: impl AsRef<str>) {
        write_line(&mut io::stderr(), line.as_ref());
    }

    /// Reads a table of the user with a progress indicator, and reports its format if it is unusual.
    pub(crate) fn table<T>(
        &self,
        path: &Path,
        read: impl FnOnce(&mut TableReader<'_>) -> Result<T, Diagnostic>,
    ) -> Result<T, Diagnostic> {
        let (content, unusual) = read_table(path, self, read)?;
        self.findings(unusual);
        Ok(content)
    }

    pub(crate) fn is_quiet(&self) -> bool {
        self.common.quiet
    }

    /// Whether stderr is a terminal that may show progress indicators and colour.
    pub(crate) fn decorated(&self) -> bool {
        !self.common.quiet && io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none()
    }
}

impl RequestWatch for CommandOutput {
    fn finding(&self, finding: &Diagnostic) {
        CommandOutput::finding(self, finding.clone());
    }

    /// Reports the progress to the service, if that started this process.
    fn done(&self, percent: u8) {
        if std::env::var_os(PROGRESS_VARIABLE).is_some() {
            write_line(&mut io::stderr(), &format!("{PROGRESS} {percent}"));
        }
    }

    /// Shows a progress indicator on the terminal, with the share of the bytes that is read if they are known.
    fn busy(&self, what: &str, bytes: Option<u64>) -> Box<dyn BusyIndicator> {
        let line = if self.decorated() { ProgressBar::no_length() } else { ProgressBar::hidden() };
        let template = match bytes {
            Some(length) => {
                line.set_length(length);
                "{spinner} {msg} {percent} %"
            }
            None => "{spinner} {msg} {elapsed}",
        };
        line.set_style(style(template));
        line.set_message(escape_controls(what).into_owned());
        line.enable_steady_tick(TICK);
        Box::new(ProgressIndicator { line })
    }
}

impl BusyIndicator for ProgressIndicator {
    fn advance(&self, bytes: u64) {
        self.line.inc(bytes);
    }
}

pub(crate) fn style(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_spinner())
}

/// Writes a line with one system call, so that the lines of child and parent on one stderr do not mix. Ignores that the
/// reader may be gone.
fn write_line(to: &mut impl Write, line: &str) {
    let _ = to.write_all(format!("{}\n", escape_controls(line)).as_bytes());
}

/// Reports a wrong command line, with the code of the finding if a value was refused. Returns the exit code.
pub(super) fn wrong_usage(usage: &clap::Error) -> ExitCode {
    match usage.source().and_then(code) {
        Some(code) => {
            let text = usage.render().to_string().replacen("error:", &format!("error[{code}]:"), 1);
            write_line(&mut io::stderr(), text.trim_end());
        }
        None if usage.print().is_err_and(|error| error.kind() != io::ErrorKind::BrokenPipe) => {
            return ExitCode::FAILURE;
        }
        None => {}
    }
    ExitCode::from(u8::try_from(usage.exit_code()).unwrap_or(2))
}

/// The code of the finding with which a parser of `value.rs` refused a value.
fn code(why: &(dyn Error + 'static)) -> Option<FindingCode> {
    fn of<F: Finding + Error + 'static>(why: &(dyn Error + 'static)) -> Option<FindingCode> {
        why.downcast_ref::<F>().map(Finding::code)
    }
    of::<CliFinding>(why)
        .or_else(|| of::<PortFinding>(why))
        .or_else(|| why.downcast_ref::<Diagnostic>().map(Diagnostic::code))
}

/// Reports the error, if there is one, and returns the exit code. A command that reported a warning ends with exit code 3.
pub(super) fn finish(out: &CommandOutput, result: Result<CommandOutcome, Diagnostic>) -> ExitCode {
    let result = match out.stdout_error.get() {
        Some(why) => {
            result.and(Err(Diagnostic::file("stdout", FileFinding::Unwritable { why: why.clone() })))
        }
        None => result,
    };
    let warned = out.child_warned.load(Ordering::Relaxed)
        || lock(&out.reported).iter().any(|finding| finding.severity() == Severity::Warning);
    match result {
        Ok(CommandOutcome::Done) if !warned => ExitCode::SUCCESS,
        Ok(CommandOutcome::Failed) => ExitCode::from(4),
        Ok(_) => ExitCode::from(if out.common.strict { 1 } else { 3 }),
        Err(error) => {
            write_line(&mut io::stderr(), &out.labelled(&error));
            if out.common.json {
                let document = serde_json::json!({ "error": error });
                out.print(&escape_controls(&format!("{document:#}")));
            }
            ExitCode::FAILURE
        }
    }
}

/// Where readings come from, in a word.
pub(super) fn origin(origin: Option<DataOrigin>) -> &'static str {
    match origin {
        Some(DataOrigin::Measured) => "measured",
        Some(DataOrigin::Simulated) => "simulated: of no real bar",
        None => "not stated whether measured or simulated",
    }
}

/// The counts of axis packets in one line, without those that are 0.
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
    format!("{} packets{rate}{}", counts.packets, nonzero(others))
}

pub(super) fn observability(index: &Observability) -> String {
    let Observability { o1, o2, o3, o4, o5 } = index;
    format!("observability O1 {o1:.3e}, O2 {o2:.3e}, O3 {o3:.3e}, O4 {o4:.3e}, O5 {o5:.3e}")
}

/// Counts with their names, such as `, 3 gaps, 1 faults`, without those that are 0.
pub(super) fn nonzero<const N: usize>(counts: [(u64, &str); N]) -> String {
    let nonzero = counts.into_iter().filter(|(count, _)| *count > 0);
    nonzero.map(|(count, what)| format!(", {count} {what}")).collect()
}
