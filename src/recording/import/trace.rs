//! The lines of a trace become samples.

use super::fields::{self, Field};
use super::mapping::{Column, LengthKind, Mapping, Plain, TimeUnit};
use crate::base::units::HostNs;
use crate::catalogue::ImportFinding;
use crate::diagnostic::Diagnostic;
use crate::measurement::sample::Sample;

/// A length further from the bar's than this share of it is no length of this bar.
const FAR_OFF: f64 = 0.2;

/// The bar that read the trace.
#[derive(Clone, Copy, Debug)]
pub struct Bar {
    /// Between its ball centres at reading zero.
    pub length_mm: f64,
    pub stroke_mm: [f64; 2],
}

/// Reads the lines of a trace one after the other.
pub struct Trace<'a> {
    file: &'a str,
    mapping: &'a Mapping,
    bar: Bar,
    delimiter: Option<char>,
    places: Option<Places>,
    lines: usize,
    bytes: u64,
    /// Time of the first row, ns, and of the last.
    first_ns: Option<i128>,
    last: HostNs,
    counts: Counts,
}

/// What a trace held.
#[derive(Clone, Copy, Debug, Default)]
pub struct Counts {
    /// Readings.
    pub samples: u64,
    /// Those beyond the stroke, or marked as not valid.
    pub invalid: u64,
    /// Wall clock of the first row, ns since 1970, where the trace gives it.
    pub unix_ns: u64,
}

/// The places of the columns, from 0.
#[derive(Clone, Copy)]
struct Places {
    time: Option<usize>,
    length: usize,
    strobe: Option<usize>,
    valid: Option<usize>,
    temperature: Option<usize>,
}

impl<'a> Trace<'a> {
    pub fn new(file: &'a str, mapping: &'a Mapping, bar: Bar) -> Self {
        let delimiter = match mapping.file.delimiter.as_str() {
            "space" => None,
            other => other.chars().next(),
        };
        Self {
            file,
            mapping,
            bar,
            delimiter,
            places: None,
            lines: 0,
            bytes: 0,
            first_ns: None,
            last: HostNs(0),
            counts: Counts::default(),
        }
    }

    /// The sample of the next line, if it is a row, at its time since the first.
    ///
    /// # Errors
    /// What is wrong, with line and column.
    pub fn line(&mut self, bytes: &[u8]) -> Result<Option<(HostNs, Sample)>, Diagnostic> {
        let offset = self.bytes;
        self.bytes += bytes.len() as u64;
        self.lines += 1;
        let text = String::from_utf8_lossy(bytes);
        let text = text.trim_start_matches('\u{feff}').trim_end_matches(['\n', '\r']);
        let comment = self.mapping.file.comment.as_deref().is_some_and(|begin| text.starts_with(begin));
        if self.lines <= self.mapping.file.skip_lines || text.trim().is_empty() || comment {
            return Ok(None);
        }
        let fields = fields::cut(text, self.delimiter);
        let line = Line { file: self.file, number: self.lines, text, fields: &fields };
        let places = match self.places {
            Some(places) => places,
            None => {
                let places = self.find(&line)?;
                self.places = Some(places);
                if self.mapping.file.header {
                    return Ok(None);
                }
                places
            }
        };
        self.row(&line, places, offset).map(Some)
    }

    /// Ends the trace.
    ///
    /// # Errors
    /// When it holds no row.
    pub fn finish(self) -> Result<Counts, Diagnostic> {
        if self.counts.samples == 0 {
            return Err(Diagnostic::file(self.file, ImportFinding::Empty));
        }
        Ok(self.counts)
    }

    /// The places of the columns, by the header where there is one.
    fn find(&self, line: &Line<'_>) -> Result<Places, Diagnostic> {
        let place = |column: &Column| match column {
            Column::Number(number) => Ok(number - 1),
            Column::Name(name) if self.mapping.file.header => line.place(name),
            Column::Name(name) => {
                Err(Diagnostic::file(self.file, ImportFinding::NoHeader { column: name.clone() }))
            }
        };
        let optional = |plain: &Option<Plain>| plain.as_ref().map(|plain| place(&plain.column)).transpose();
        let Mapping { time, length, strobe, valid, temperature, .. } = self.mapping;
        Ok(Places {
            time: if time.rate_hz.is_some() { None } else { Some(place(&time.column)?) },
            length: place(&length.column)?,
            strobe: optional(strobe)?,
            valid: optional(valid)?,
            temperature: optional(temperature)?,
        })
    }

    fn row(&mut self, line: &Line<'_>, places: Places, offset: u64) -> Result<(HostNs, Sample), Diagnostic> {
        let ns = self.time_ns(line, places)?;
        let since = ns - self.first_ns.unwrap_or(ns);
        let host = match u64::try_from(since) {
            Ok(since) if since >= self.last.0 => HostNs(since),
            _ => {
                let field = places.time.and_then(|place| line.fields.get(place));
                return Err(line.wrong(field.map_or(1, |field| field.column), ImportFinding::TimeGoesBack));
            }
        };
        let reading_mm = self.reading_mm(line, places.length)?;
        let [low, high] = self.bar.stroke_mm;
        let decimal = self.mapping.file.decimal;
        let sample = Sample {
            reading_mm,
            sequence: None,
            ticks: None,
            trigger: line.flag(places.strobe)?,
            temperature_c: places.temperature.map(|place| line.number(place, decimal)).transpose()?,
            valid: line.flag(places.valid)?.unwrap_or(true) && (low..=high).contains(&reading_mm),
            status: 0,
            offset,
        };
        if self.first_ns.is_none() && self.mapping.time.unit == TimeUnit::Iso && places.time.is_some() {
            self.counts.unix_ns = u64::try_from(ns).unwrap_or(0);
        }
        self.first_ns.get_or_insert(ns);
        self.last = host;
        self.counts.samples += 1;
        self.counts.invalid += u64::from(!sample.valid);
        Ok((host, sample))
    }

    fn time_ns(&self, line: &Line<'_>, places: Places) -> Result<i128, Diagnostic> {
        let unit = self.mapping.time.unit;
        match places.time {
            Some(place) if unit == TimeUnit::Iso => {
                let field = line.field(place)?;
                let finding = || ImportFinding::NotADate { field: field.text.clone() };
                fields::iso_ns(&field.text).ok_or_else(|| line.wrong(field.column, finding()))
            }
            Some(place) => Ok((line.number(place, self.mapping.file.decimal)? * unit.ns()).round() as i128),
            None => {
                let rate_hz = self.mapping.time.rate_hz.unwrap_or(1.0);
                Ok((self.counts.samples as f64 * 1e9 / rate_hz).round() as i128)
            }
        }
    }

    fn reading_mm(&self, line: &Line<'_>, place: usize) -> Result<f64, Diagnostic> {
        let bar_mm = self.bar.length_mm;
        let value_mm = line.number(place, self.mapping.file.decimal)? * self.mapping.length.unit.mm();
        let (reading_mm, finding) = match self.mapping.length.kind {
            LengthKind::Distance => (value_mm - bar_mm, ImportFinding::NoLengthOfBar { value_mm, bar_mm }),
            LengthKind::Reading => (value_mm, ImportFinding::NoReadingOfBar { value_mm, bar_mm }),
        };
        if reading_mm.abs() > FAR_OFF * bar_mm {
            return Err(line.wrong(line.field(place)?.column, finding));
        }
        Ok(reading_mm)
    }
}

/// A line of the trace, cut.
struct Line<'a> {
    file: &'a str,
    number: usize,
    text: &'a str,
    fields: &'a [Field],
}

impl Line<'_> {
    fn wrong(&self, column: usize, finding: ImportFinding) -> Diagnostic {
        Diagnostic::line(self.file, self.number, finding).in_line(self.text, column)
    }

    /// The place of a column by its name in the header.
    fn place(&self, name: &str) -> Result<usize, Diagnostic> {
        self.fields.iter().position(|field| field.text == *name).ok_or_else(|| {
            let header: Vec<&str> = self.fields.iter().map(|field| field.text.as_str()).collect();
            self.wrong(1, ImportFinding::NoColumn { column: name.into(), header: header.join(", ") })
        })
    }

    fn field(&self, place: usize) -> Result<&Field, Diagnostic> {
        let end = || self.text.chars().count() + 1;
        let short = || self.wrong(end(), ImportFinding::LineEnds { column: place + 1 });
        self.fields.get(place).ok_or_else(short)
    }

    fn number(&self, place: usize, decimal: char) -> Result<f64, Diagnostic> {
        let field = self.field(place)?;
        fields::number(&field.text, decimal).map_err(|finding| self.wrong(field.column, finding))
    }

    fn flag(&self, place: Option<usize>) -> Result<Option<bool>, Diagnostic> {
        let Some(field) = place.map(|place| self.field(place)).transpose()? else { return Ok(None) };
        match field.text.to_ascii_lowercase().as_str() {
            "1" | "true" | "on" => Ok(Some(true)),
            "0" | "false" | "off" => Ok(Some(false)),
            _ => Err(self.wrong(field.column, ImportFinding::NotAFlag { field: field.text.clone() })),
        }
    }
}
