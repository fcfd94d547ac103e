//! What a single value of a job may be, what some are where the job gives none, and its place in the file.

use crate::catalogue::JobFinding;

pub(super) fn default_radius() -> f64 {
    15.0
}

/// Standard deviation of a length where the job gives none, micrometres.
pub const SIGMA_UM: f64 = 2.0;

pub(super) fn default_sigma() -> f64 {
    SIGMA_UM
}

/// The protocol of a bar where nothing names one.
pub const DEFAULT_PROTOCOL: &str = "dbb-cobs-1";

pub(super) fn default_protocol() -> String {
    DEFAULT_PROTOCOL.into()
}

/// The place of a value: the table's header, which of them (from 0), the key.
#[derive(Clone, Copy)]
pub(super) struct Place {
    header: &'static str,
    at: usize,
    key: &'static str,
}

/// A finding about the value at a place.
pub(crate) struct Misplaced {
    pub(crate) finding: JobFinding,
    place: Place,
}

/// No length (mm), angle (degrees), speed or time of a job is larger.
pub(super) const MOST: f64 = 1e5;

/// A table of the job, of which values are checked.
#[derive(Clone, Copy)]
pub(super) struct Table {
    header: &'static str,
    at: usize,
}

impl Table {
    pub(super) const fn new(header: &'static str) -> Self {
        Self { header, at: 0 }
    }

    /// The one at a position (from 0) among those of its header.
    pub(super) const fn nth(header: &'static str, at: usize) -> Self {
        Self { header, at }
    }

    /// A finding about a key; about the table itself where the key is empty.
    pub(super) fn wrong(self, key: &'static str, finding: JobFinding) -> Misplaced {
        Misplaced { finding, place: Place { header: self.header, at: self.at, key } }
    }

    pub(super) fn positive(self, key: &'static str, value: f64) -> Result<(), Misplaced> {
        self.positive_to(key, value, MOST)
    }

    pub(super) fn positive_to(self, key: &'static str, value: f64, most: f64) -> Result<(), Misplaced> {
        if value > 0.0 && value <= most {
            Ok(())
        } else {
            Err(self.wrong(key, JobFinding::NotPositive { key: key.into(), value, most }))
        }
    }

    pub(super) fn finite<'a>(
        self,
        key: &'static str,
        values: impl IntoIterator<Item = &'a f64>,
    ) -> Result<(), Misplaced> {
        values.into_iter().try_for_each(|value| self.within(key, *value, [-MOST, MOST]))
    }

    /// Within a range, which NaN is not.
    pub(super) fn within(
        self,
        key: &'static str,
        value: f64,
        [least, most]: [f64; 2],
    ) -> Result<(), Misplaced> {
        if (least..=most).contains(&value) {
            Ok(())
        } else {
            Err(self.wrong(key, JobFinding::OutOfRange { key: key.into(), value, least, most }))
        }
    }

    pub(super) fn direction(self, key: &'static str, [x, y, z]: [f64; 3]) -> Result<(), Misplaced> {
        if (1e-6..=MOST).contains(&x.hypot(y).hypot(z)) {
            Ok(())
        } else {
            Err(self.wrong(key, JobFinding::NoDirection { key: key.into(), x, y, z }))
        }
    }

    /// A box by two corners, of which `key` is one or both.
    pub(super) fn corners(self, key: &'static str, low: [f64; 3], high: [f64; 3]) -> Result<(), Misplaced> {
        self.finite(key, low.iter().chain(&high))?;
        if low.iter().zip(&high).all(|(low, high)| low < high) {
            Ok(())
        } else {
            Err(self.wrong(key, JobFinding::CornersSwapped { key: key.into() }))
        }
    }

    /// An axis of a cup and its limit, which stand together.
    pub(super) fn cup(self, axis: Option<[f64; 3]>, limit_deg: Option<f64>) -> Result<(), Misplaced> {
        const AXIS: &str = "cup_axis";
        const LIMIT: &str = "cup_limit_deg";
        let alone =
            |key: &'static str, needed: &str| JobFinding::CupAlone { key: key.into(), needed: needed.into() };
        match (axis, limit_deg) {
            (Some(axis), Some(limit)) => {
                self.direction(AXIS, axis)?;
                self.positive_to(LIMIT, limit, 180.0)
            }
            (None, None) => Ok(()),
            (Some(_), None) => Err(self.wrong(AXIS, alone(AXIS, LIMIT))),
            (None, Some(_)) => Err(self.wrong(LIMIT, alone(LIMIT, AXIS))),
        }
    }
}

impl Misplaced {
    /// The line (from 1) of the key, else of the table's header; a table whose header has no bracket is an inline
    /// table of `[motion]`.
    pub(super) fn line(&self, text: &str) -> Option<usize> {
        let Place { header, at, key } = self.place;
        let starts = |line: &str, key: &str| {
            let rest = line.trim_start().strip_prefix(key);
            rest.is_some_and(|rest| rest.trim_start().starts_with(['=', '.']))
        };
        let mut lines = (1..).zip(text.lines());
        if !header.starts_with('[') {
            let table = format!("[motion.{header}]");
            return lines.find(|(_, line)| starts(line, header) || line.trim() == table).map(|(n, _)| n);
        }
        let is_header = |line: &str| line.split('#').next().unwrap_or("").trim() == header;
        let (found, _) = lines.by_ref().filter(|(_, line)| is_header(line)).nth(at)?;
        let mut within = lines.take_while(|(_, line)| !line.trim_start().starts_with('['));
        Some(within.find(|(_, line)| starts(line, key)).map_or(found, |(n, _)| n))
    }
}
