//! Checks of single values of a job, and the place in the file of a value that fails.

use crate::plan::job::JobFinding;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::plausibility::Quantity;

/// A table of the job: its header, and the number of the table among those with this header, from 0.
#[derive(Clone, Copy, Debug)]
pub(crate) struct JobTable {
    header: &'static str,
    at: usize,
}

/// A finding about a key of a table; it concerns the table itself if the key is empty.
#[derive(Debug)]
pub(crate) struct MisplacedFinding {
    pub(crate) finding: Box<Diagnostic>,
    table: JobTable,
    key: &'static str,
}

type ValueCheck = Result<(), MisplacedFinding>;

impl JobTable {
    pub(crate) const fn new(header: &'static str) -> Self {
        Self { header, at: 0 }
    }

    pub(crate) const fn nth(header: &'static str, at: usize) -> Self {
        Self { header, at }
    }

    pub(crate) fn wrong(self, key: &'static str, finding: impl Into<Diagnostic>) -> MisplacedFinding {
        MisplacedFinding { finding: Box::new(finding.into()), table: self, key }
    }

    /// An error with this finding unless the condition holds.
    pub(super) fn ensure(
        self,
        key: &'static str,
        holds: bool,
        finding: impl FnOnce() -> JobFinding,
    ) -> ValueCheck {
        if holds { Ok(()) } else { Err(self.wrong(key, finding())) }
    }

    pub(super) fn check(self, key: &'static str, value: f64, quantity: Quantity) -> ValueCheck {
        quantity.check(key, value).map_err(|finding| self.wrong(key, finding))
    }

    pub(super) fn finite<'a>(
        self,
        key: &'static str,
        values: impl IntoIterator<Item = &'a f64>,
    ) -> ValueCheck {
        values.into_iter().try_for_each(|value| self.check(key, *value, Quantity::Coordinate))
    }

    pub(super) fn direction(self, key: &'static str, [x, y, z]: [f64; 3]) -> ValueCheck {
        self.check(key, x.hypot(y).hypot(z), Quantity::DirectionLength)
    }

    /// Checks a box given by two corners; `key` is the key of one corner or of both.
    pub(super) fn corners(self, key: &'static str, low: [f64; 3], high: [f64; 3]) -> ValueCheck {
        self.finite(key, low.iter().chain(&high))?;
        let ordered = low.iter().zip(&high).all(|(low, high)| low < high);
        self.ensure(key, ordered, || JobFinding::CornersSwapped { key: key.into() })
    }

    /// Checks the size of an obstacle or a workspace, mm: a tiny one was given in metres.
    pub(super) fn large(self, key: &'static str, size: [f64; 3]) -> ValueCheck {
        self.check(key, size.into_iter().map(f64::abs).fold(0.0, f64::max), Quantity::BodySize)
    }

    /// Checks the axis of a cup and its limit: both or none must be given.
    pub(super) fn cup(self, axis: Option<[f64; 3]>, limit_deg: Option<f64>) -> ValueCheck {
        const AXIS: &str = "cup_axis";
        const LIMIT: &str = "cup_limit_deg";
        let alone = |key: &'static str, needed: &str| {
            Err(self.wrong(key, JobFinding::CupAlone { key: key.into(), needed: needed.into() }))
        };
        match (axis, limit_deg) {
            (Some(axis), Some(limit)) => {
                self.direction(AXIS, axis)?;
                self.check(LIMIT, limit, Quantity::HalfTurn)
            }
            (None, None) => Ok(()),
            (Some(_), None) => alone(AXIS, LIMIT),
            (None, Some(_)) => alone(LIMIT, AXIS),
        }
    }
}

impl MisplacedFinding {
    /// The finding in the line of its value. A finding in a file that the value names stays there, and its help names the
    /// line.
    pub(crate) fn in_text(self, file: &str, text: &str) -> Diagnostic {
        let Some(line) = self.line(text) else { return self.finding.in_file(file) };
        if !self.finding.file_name().is_empty() {
            let names =
                || format!("`{}` in {file}:{line} names this file, from the working directory", self.key);
            let help = self.finding.help_line().unwrap_or_else(names);
            return self.finding.help(help);
        }
        let column = text.lines().nth(line - 1).map_or(0, |l| l.len() - l.trim_start().len()) + 1;
        self.finding.at(file, text, line, column)
    }

    /// The line (from 1) of the key, else of the table's header. An empty header is the part before the first table; a
    /// header without bracket is an inline table of `[motion]`.
    fn line(&self, text: &str) -> Option<usize> {
        let &Self { table: JobTable { header, at }, key, .. } = self;
        let starts = |line: &str, key: &str| {
            let rest = line.trim_start().strip_prefix(key);
            rest.is_some_and(|rest| rest.trim_start().starts_with(['=', '.']))
        };
        let mut lines = (1..).zip(text.lines());
        let is_other = |line: &str| line.trim_start().starts_with('[');
        if header.is_empty() {
            let mut before = lines.take_while(|(_, line)| !is_other(line));
            return before.find(|(_, line)| starts(line, key)).map(|(n, _)| n);
        }
        if !header.starts_with('[') {
            let table = format!("[motion.{header}]");
            return lines.find(|(_, line)| starts(line, header) || line.trim() == table).map(|(n, _)| n);
        }
        let is_header = |line: &str| line.split('#').next().unwrap_or("").trim() == header;
        let (found, _) = lines.by_ref().filter(|(_, line)| is_header(line)).nth(at)?;
        let mut within = lines.take_while(|(_, line)| !is_other(line));
        Some(within.find(|(_, line)| starts(line, key)).map_or(found, |(n, _)| n))
    }
}
