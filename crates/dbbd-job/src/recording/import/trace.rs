//! Converts the rows of a trace to samples.

use super::date::WrittenTime;
use super::format::TraceFormat;
use super::mapping::{FlagColumn, TraceMapping};
use crate::recording::import::ImportFinding;
use dbbd_model::base::FileFinding;
use dbbd_model::base::table::{TableReader, TableRow};
use dbbd_model::base::units::HostNs;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::measurement::sample::Sample;

/// With a larger share of rows without a reading, the column or its unit is wrong.
const MAX_MISSING_SHARE: f64 = 0.1;
/// Most lines without a reading between header and readings, and below them.
const MAX_LINES_ABOVE: u64 = 3;
const MAX_LINES_BELOW: u64 = 20;
const DAY_NS: i128 = 86_400_000_000_000;

/// The bar that recorded the trace.
#[derive(Clone, Copy, Debug)]
pub struct TraceBar {
    /// Distance of the ball centres at reading zero, mm.
    pub length_mm: f64,
    pub stroke_mm: [f64; 2],
}

/// Reads a trace row by row.
pub struct TraceReader<'a> {
    table: TableReader<'a>,
    state: TraceState<'a>,
    /// Lines that are no rows: they may stand above and below the readings.
    above: Option<LinesAside>,
    below: Option<LinesAside>,
}

/// Lines that are no rows of the trace, and what is wrong with the first.
struct LinesAside {
    lines: u64,
    first: Diagnostic,
}

/// State after the rows so far.
struct TraceState<'a> {
    mapping: &'a TraceMapping,
    format: &'a TraceFormat,
    bar: TraceBar,
    /// Time of the first row, ns.
    first_ns: Option<i128>,
    /// Midnights that a time without a date passed, ns.
    midnights_ns: i128,
    last: HostNs,
    last_sample: Sample,
    /// What is wrong with the first reading that is missing.
    missing: Option<Diagnostic>,
    counts: TraceCounts,
}

/// What a line of the trace is.
enum TraceLine {
    Sample(HostNs, Sample),
    /// No row of the trace, and why.
    Aside(Diagnostic),
}

#[derive(Clone, Copy, Debug, Default)]
pub struct TraceCounts {
    /// Number of readings.
    pub samples: u64,
    /// Readings beyond the stroke, or marked as invalid.
    pub invalid: u64,
    /// Rows without a reading.
    pub missing: u64,
    /// Lowest and highest reading, mm.
    pub range_mm: Option<[f64; 2]>,
    /// Number of gaps of more than a second, and the longest, s.
    pub holes: u64,
    pub longest_s: f64,
    /// Number of readings with the same time as the reading before.
    same_times: u64,
    /// Wall clock of the first row, ns since 1970, if the trace has dates.
    pub unix_ns: u64,
}

impl TraceCounts {
    fn add(&mut self, reading_mm: Option<f64>, after_s: f64) {
        const HOLE_S: f64 = 1.0;
        if let Some(reading_mm) = reading_mm {
            let [low, high] = self.range_mm.unwrap_or([reading_mm; 2]);
            self.range_mm = Some([low.min(reading_mm), high.max(reading_mm)]);
        }
        self.same_times += u64::from(self.samples > 0 && after_s == 0.0);
        self.holes += u64::from(after_s > HOLE_S);
        self.longest_s = self.longest_s.max(after_s);
    }

    /// Warnings: why the dwells of a plan may not be found in the readings of `seconds`.
    pub fn findings(&self, seconds: f64, dwell_s: f64) -> impl Iterator<Item = ImportFinding> {
        const MIN_SAMPLES_IN_DWELL: f64 = 5.0;
        const MAX_SAME_SHARE: f64 = 0.5;
        let [low, high] = self.range_mm.unwrap_or_default();
        let period_s = seconds / (self.samples.max(2) - 1) as f64;
        let same = self.same_times as f64 / self.samples.max(1) as f64;
        let slow = MIN_SAMPLES_IN_DWELL * period_s > dwell_s;
        [
            (low == high && self.samples > 1).then_some(ImportFinding::Constant { reading_mm: low }),
            slow.then_some(ImportFinding::TooSlow { period_s, dwell_s }),
            (same > MAX_SAME_SHARE).then_some(ImportFinding::SameTimes { percent: 100.0 * same }),
            (!slow && self.holes > 0)
                .then_some(ImportFinding::Holes { holes: self.holes, longest_s: self.longest_s }),
        ]
        .into_iter()
        .flatten()
    }
}

/// A row of the trace, with the text since the row before.
#[derive(Debug)]
pub struct TraceRow {
    pub text: String,
    /// The sample of the row; `None` after the last row.
    pub sample: Option<(HostNs, Sample)>,
}

impl<'a> TraceReader<'a> {
    pub fn new(
        table: TableReader<'a>,
        mapping: &'a TraceMapping,
        format: &'a TraceFormat,
        bar: TraceBar,
    ) -> Self {
        let state = TraceState {
            mapping,
            format,
            bar,
            first_ns: None,
            midnights_ns: 0,
            last: HostNs(0),
            last_sample: Sample::of(0.0),
            missing: None,
            counts: TraceCounts::default(),
        };
        Self { table, state, above: None, below: None }
    }

    /// The next row; the last has no sample.
    pub fn row(&mut self) -> Result<TraceRow, Diagnostic> {
        loop {
            let line = match self.table.row() {
                Ok(None) => return Ok(TraceRow { text: self.table.take_text(), sample: None }),
                Ok(Some(row)) => self.state.line(&row)?,
                Err(wrong) if matches!(wrong.finding(), Some(FileFinding::CellCount { .. })) => {
                    TraceLine::Aside(wrong)
                }
                Err(wrong) => return Err(wrong),
            };
            let is_first = self.state.counts.samples == u64::from(matches!(line, TraceLine::Sample(..)));
            let (aside, max) = match is_first {
                true => (&mut self.above, MAX_LINES_ABOVE),
                false => (&mut self.below, MAX_LINES_BELOW),
            };
            match line {
                // Only the first and the last lines of a trace may be something else.
                TraceLine::Sample(host, sample) => {
                    match aside.take_if(|aside| !is_first || aside.lines > max) {
                        Some(aside) => return Err(aside.first),
                        None => {
                            return Ok(TraceRow {
                                text: self.table.take_text(),
                                sample: Some((host, sample)),
                            });
                        }
                    }
                }
                TraceLine::Aside(first) => {
                    let aside = aside.get_or_insert(LinesAside { lines: 0, first });
                    aside.lines += 1;
                }
            }
        }
    }

    /// Ends the trace: counts, and findings about it.
    pub fn finish(self) -> Result<(TraceCounts, Vec<Diagnostic>), Diagnostic> {
        let Self { table, state: TraceState { format, bar, missing, counts, .. }, above, below } = self;
        let file = table.file();
        if counts.samples == 0 {
            let wrong = above.map(|above| above.first);
            return Err(wrong.unwrap_or_else(|| Diagnostic::file(file, ImportFinding::Empty)));
        }
        if let Some(below) = below.as_ref().filter(|below| below.lines > MAX_LINES_BELOW) {
            return Err(below.first.clone());
        }
        let (rows, samples) = (counts.missing, counts.samples);
        let share = rows as f64 / samples as f64;
        if let Some(missing) = missing.as_ref().filter(|_| share > MAX_MISSING_SHARE) {
            let help = missing.help_line().map_or_else(String::new, |help| format!("{help}; "));
            let max = 100.0 * MAX_MISSING_SHARE;
            return Err(missing.clone().help(format!(
                "{help}{rows} of {samples} rows are like this one; up to {max} % pass as rows without a reading"
            )));
        }
        let at =
            |first: &Diagnostic, finding: ImportFinding| Diagnostic::line(file, first.line_number(), finding);
        let above = above.map(|LinesAside { lines, first }| at(&first, ImportFinding::LinesAbove { lines }));
        let below = below.map(|LinesAside { lines, first }| {
            let cut_off = lines == 1 && !table.ends_with_line();
            at(&first, if cut_off { ImportFinding::CutOff } else { ImportFinding::LinesBelow { lines } })
        });
        let missing = missing
            .map(|first| at(&first, ImportFinding::NoReading { rows, samples, percent: 100.0 * share }));
        let is_reading = |found: &ImportFinding| matches!(found, ImportFinding::Readings { .. });
        let range_mm = counts.range_mm.filter(|_| format.findings.iter().any(is_reading));
        let other = range_mm.and_then(|range| other_unit(range, bar.length_mm));
        let found = format.findings.iter().cloned().chain(other);
        let found = found.map(|finding| Diagnostic::file(file, finding));
        Ok((
            counts,
            table.findings().into_iter().chain(found).chain(above).chain(below).chain(missing).collect(),
        ))
    }
}

impl TraceState<'_> {
    fn line(&mut self, row: &TableRow<'_>) -> Result<TraceLine, Diagnostic> {
        let places = &self.format.places;
        let WrittenTime { ns, dated } = match self.time(row) {
            Ok(time) => time,
            // A number in another form is a fault of a row, a text or nothing is none of its rows.
            Err(wrong) if places.time.is_some_and(|place| is_numeral(row.text(place))) => return Err(wrong),
            Err(wrong) => return Ok(TraceLine::Aside(wrong)),
        };
        if let Err(short) = row.has(places.length) {
            return Ok(TraceLine::Aside(short));
        }
        let since = ns - self.first_ns.unwrap_or(ns);
        let host = match u64::try_from(since) {
            Ok(since) if since >= self.last.0 => HostNs(since),
            _ => return Err(row.wrong(places.time.unwrap_or(0), ImportFinding::TimeGoesBack)),
        };
        let reading = self.format.reading_mm(row);
        let sample = match &reading {
            Ok(reading_mm) => {
                let [low, high] = self.bar.stroke_mm;
                let valid = flag(row, places.valid, self.mapping.valid.as_ref())?.unwrap_or(true);
                Sample {
                    trigger: flag(row, places.strobe, self.mapping.strobe.as_ref())?,
                    temperature_c: places.temperature.map(|place| row.number(place)).transpose()?,
                    valid: valid && (low..=high).contains(reading_mm),
                    ..Sample::of(*reading_mm)
                }
            }
            Err(wrong) if is_numeral(row.text(places.length)) && !is_far(wrong) => return Err(wrong.clone()),
            // The other cells of such a row are as a rule empty too.
            Err(wrong) => {
                self.missing.get_or_insert_with(|| wrong.clone());
                self.counts.missing += 1;
                Sample { valid: false, temperature_c: None, ..self.last_sample }
            }
        };
        let sample = Sample { offset: row.offset(), ..sample };
        if self.first_ns.is_none() && dated {
            self.counts.unix_ns = u64::try_from(ns).unwrap_or(0);
        }
        self.first_ns.get_or_insert(ns);
        self.counts.add(reading.ok(), host.seconds_since(self.last));
        (self.last, self.last_sample) = (host, sample);
        self.counts.samples += 1;
        self.counts.invalid += u64::from(!sample.valid);
        Ok(TraceLine::Sample(host, sample))
    }

    /// The time of a row.
    fn time(&mut self, row: &TableRow<'_>) -> Result<WrittenTime, Diagnostic> {
        let Some(place) = self.format.places.time else {
            let rate_hz = self.mapping.time.rate_hz.unwrap_or(1.0);
            let ns = (self.counts.samples as f64 * 1e9 / rate_hz).round() as i128;
            return Ok(WrittenTime { ns, dated: false });
        };
        let time = self.format.time(row, place)?;
        if time.dated || !self.format.is_of_day() {
            return Ok(time);
        }
        // A time of the day that goes back by most of a day passed midnight.
        let since_ns = time.ns + self.midnights_ns - self.first_ns.unwrap_or(time.ns);
        if since_ns < i128::from(self.last.0) - DAY_NS / 2 {
            self.midnights_ns += DAY_NS;
        }
        Ok(WrittenTime { ns: time.ns + self.midnights_ns, ..time })
    }
}

/// Whether a text that is no number here consists of digits and marks, as a number of another form.
fn is_numeral(text: &str) -> bool {
    let is_mark = |c: char| c.is_ascii_digit() || matches!(c, '.' | ',' | '+' | '-' | '\'' | ' ');
    text.contains(|c: char| c.is_ascii_digit()) && text.chars().all(is_mark)
}

/// Whether a reading is a number that is far from every length of the bar.
fn is_far(wrong: &Diagnostic) -> bool {
    matches!(
        wrong.finding(),
        Some(ImportFinding::NoLengthOfBar { .. } | ImportFinding::NoReadingOfBar { .. })
    )
}

/// Whether readings are lengths of the bar in another unit.
fn other_unit([low, high]: [f64; 2], bar_mm: f64) -> Option<ImportFinding> {
    /// Largest stroke as a share of the bar's length.
    const STROKE: f64 = 0.1;
    let is_bar = |value: f64| (value - bar_mm).abs() < STROKE * bar_mm;
    let (_, unit) = [(1e3, "m"), (25.4, "inches")]
        .into_iter()
        .find(|(factor, _)| is_bar(factor * low) && is_bar(factor * high))?;
    Some(ImportFinding::OtherUnit { low, high, unit, bar_mm })
}

fn flag(
    row: &TableRow<'_>,
    place: Option<usize>,
    column: Option<&FlagColumn>,
) -> Result<Option<bool>, Diagnostic> {
    let Some(place) = place else { return Ok(None) };
    row.has(place)?;
    if let Some(threshold) = column.and_then(|column| column.threshold) {
        return row.number(place).map(|value| Some(value >= threshold));
    }
    match row.whole_text(place).to_ascii_lowercase().as_str() {
        "1" | "true" | "on" | "high" | "yes" => Ok(Some(true)),
        "0" | "false" | "off" | "low" | "no" => Ok(Some(false)),
        _ => Err(row.wrong(place, ImportFinding::NotAFlag { field: row.text(place).into() })),
    }
}
