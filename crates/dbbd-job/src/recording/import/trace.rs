//! Converts the rows of a trace to samples.

use super::date;
use super::mapping::{ColumnKey, LengthKind, TraceColumn, TraceMapping, TraceTimeUnit};
use crate::recording::import::ImportFinding;
use dbbd_model::base::table::{TableReader, TableRow};
use dbbd_model::base::units::HostNs;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::measurement::sample::Sample;

/// A value further from the bar's length than this share of it is no length of this bar.
const FAR_OFF: f64 = 0.2;

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
}

/// State after the rows so far.
struct TraceState<'a> {
    mapping: &'a TraceMapping,
    bar: TraceBar,
    places: Option<ColumnPlaces>,
    time: Option<TraceTimeUnit>,
    kind: Option<LengthKind>,
    /// Time of the first row, ns.
    first_ns: Option<i128>,
    last: HostNs,
    counts: TraceCounts,
}

#[derive(Clone, Copy, Debug, Default)]
pub struct TraceCounts {
    /// Number of readings.
    pub samples: u64,
    /// Readings beyond the stroke, or marked as invalid.
    pub invalid: u64,
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
    fn add(&mut self, reading_mm: f64, after_s: f64) {
        const HOLE_S: f64 = 1.0;
        let [low, high] = self.range_mm.unwrap_or([reading_mm; 2]);
        self.range_mm = Some([low.min(reading_mm), high.max(reading_mm)]);
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

#[derive(Clone, Copy)]
struct ColumnPlaces {
    time: Option<usize>,
    length: usize,
    strobe: Option<usize>,
    valid: Option<usize>,
    temperature: Option<usize>,
}

impl<'a> TraceReader<'a> {
    pub fn new(table: TableReader<'a>, mapping: &'a TraceMapping, bar: TraceBar) -> Self {
        let state = TraceState {
            mapping,
            bar,
            places: None,
            time: mapping.time.unit,
            kind: mapping.length.kind,
            first_ns: None,
            last: HostNs(0),
            counts: TraceCounts::default(),
        };
        Self { table, state }
    }

    /// The next row; the last has no sample.
    pub fn row(&mut self) -> Result<TraceRow, Diagnostic> {
        let places = match self.state.places {
            Some(places) => places,
            None => {
                let places = self.find();
                // An empty file has no rows: a missing column would be a misleading finding.
                if places.is_err() && self.table.names().is_empty() && self.table.row()?.is_none() {
                    return Err(Diagnostic::file(self.table.file(), ImportFinding::Empty));
                }
                *self.state.places.insert(places?)
            }
        };
        let sample = match self.table.row()? {
            Some(row) => Some(self.state.row(&row, places)?),
            None => None,
        };
        Ok(TraceRow { text: self.table.take_text(), sample })
    }

    /// Ends the trace: counts, and findings about it.
    pub fn finish(self) -> Result<(TraceCounts, Vec<Diagnostic>), Diagnostic> {
        let Self { table, state, .. } = self;
        if state.counts.samples == 0 {
            return Err(Diagnostic::file(table.file(), ImportFinding::Empty));
        }
        let dates = state.mapping.time.unit.is_none() && state.time == Some(TraceTimeUnit::Iso);
        let readings = state.mapping.length.kind.is_none() && state.kind == Some(LengthKind::Reading);
        let bar_mm = state.bar.length_mm;
        let other = state.counts.range_mm.filter(|_| readings).and_then(|range| other_unit(range, bar_mm));
        let found = [
            dates.then_some(ImportFinding::Dates),
            readings.then_some(ImportFinding::Readings { bar_mm }),
            other,
        ];
        let found = found.into_iter().flatten().map(|finding| Diagnostic::file(table.file(), finding));
        Ok((state.counts, table.findings().into_iter().chain(found).collect()))
    }

    /// Positions of the columns, by the header if there is one.
    fn find(&self) -> Result<ColumnPlaces, Diagnostic> {
        let TraceMapping { file, time, length, strobe, valid, temperature } = self.state.mapping;
        let place = |column: &TraceColumn| match column {
            TraceColumn::Number(number) => Ok(number.get() - 1),
            TraceColumn::Name(name) if file.header => self.table.required([name]).map(|[at]| at),
            TraceColumn::Name(name) => {
                Err(Diagnostic::file(self.table.file(), ImportFinding::NoHeader { column: name.clone() }))
            }
        };
        let optional = |key: &Option<ColumnKey>| key.as_ref().map(|key| place(&key.column)).transpose();
        Ok(ColumnPlaces {
            time: if time.rate_hz.is_some() { None } else { Some(place(&time.column)?) },
            length: place(&length.column)?,
            strobe: optional(strobe)?,
            valid: optional(valid)?,
            temperature: optional(temperature)?,
        })
    }
}

impl TraceState<'_> {
    fn row(&mut self, row: &TableRow<'_>, places: ColumnPlaces) -> Result<(HostNs, Sample), Diagnostic> {
        let ns = self.time_ns(row, places.time)?;
        let since = ns - self.first_ns.unwrap_or(ns);
        let host = match u64::try_from(since) {
            Ok(since) if since >= self.last.0 => HostNs(since),
            _ => return Err(row.wrong(places.time.unwrap_or(0), ImportFinding::TimeGoesBack)),
        };
        let reading_mm = self.reading_mm(row, places.length)?;
        let [low, high] = self.bar.stroke_mm;
        let sample = Sample {
            trigger: flag(row, places.strobe)?,
            temperature_c: places.temperature.map(|place| row.number(place)).transpose()?,
            valid: flag(row, places.valid)?.unwrap_or(true) && (low..=high).contains(&reading_mm),
            offset: row.offset(),
            ..Sample::of(reading_mm)
        };
        if self.first_ns.is_none() && self.time == Some(TraceTimeUnit::Iso) && places.time.is_some() {
            self.counts.unix_ns = u64::try_from(ns).unwrap_or(0);
        }
        self.first_ns.get_or_insert(ns);
        self.counts.add(reading_mm, host.seconds_since(self.last));
        self.last = host;
        self.counts.samples += 1;
        self.counts.invalid += u64::from(!sample.valid);
        Ok((host, sample))
    }

    fn time_ns(&mut self, row: &TableRow<'_>, place: Option<usize>) -> Result<i128, Diagnostic> {
        let Some(place) = place else {
            let rate_hz = self.mapping.time.rate_hz.unwrap_or(1.0);
            return Ok((self.counts.samples as f64 * 1e9 / rate_hz).round() as i128);
        };
        row.has(place)?;
        let field = row.text(place);
        let dated = date::unix_ns(field);
        let shown = if dated.is_some() { TraceTimeUnit::Iso } else { TraceTimeUnit::S };
        match *self.time.get_or_insert(shown) {
            TraceTimeUnit::Iso => {
                dated.ok_or_else(|| row.wrong(place, ImportFinding::NotADate { field: field.into() }))
            }
            unit @ (TraceTimeUnit::S | TraceTimeUnit::Ms | TraceTimeUnit::Us | TraceTimeUnit::Ns) => {
                Ok((row.number(place)? * unit.ns()).round() as i128)
            }
        }
    }

    fn reading_mm(&mut self, row: &TableRow<'_>, place: usize) -> Result<f64, Diagnostic> {
        let bar_mm = self.bar.length_mm;
        let most_mm = FAR_OFF * bar_mm;
        let value_mm = row.number(place)? * self.mapping.length.unit.mm();
        let shown = if value_mm.abs() <= most_mm { LengthKind::Reading } else { LengthKind::Distance };
        let (reading_mm, finding) = match *self.kind.get_or_insert(shown) {
            LengthKind::Distance => (value_mm - bar_mm, ImportFinding::NoLengthOfBar { value_mm, bar_mm }),
            LengthKind::Reading => (value_mm, ImportFinding::NoReadingOfBar { value_mm, bar_mm }),
        };
        if reading_mm.abs() > most_mm {
            return Err(row.wrong(place, finding));
        }
        Ok(reading_mm)
    }
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

fn flag(row: &TableRow<'_>, place: Option<usize>) -> Result<Option<bool>, Diagnostic> {
    let Some(place) = place else { return Ok(None) };
    row.has(place)?;
    match row.text(place).to_ascii_lowercase().as_str() {
        "1" | "true" | "on" => Ok(Some(true)),
        "0" | "false" | "off" => Ok(Some(false)),
        field => Err(row.wrong(place, ImportFinding::NotAFlag { field: field.into() })),
    }
}
