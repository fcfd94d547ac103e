//! The lines of a trace become samples.

use super::fields::{self, Field};
use super::mapping::{Column, LengthKind, Mapping, TimeUnit};
use crate::diag::Diagnostic;
use crate::sample::Sample;
use crate::units::HostNs;

/// A length further from the bar's than this share of it is no length of this bar.
const FAR_OFF: f64 = 0.2;

/// Reads the lines of a trace one after the other.
pub struct Trace<'a> {
    file: &'a str,
    mapping: &'a Mapping,
    bar_mm: f64,
    stroke_mm: [f64; 2],
    delimiter: Option<char>,
    places: Option<Places>,
    lines: usize,
    bytes: u64,
    /// Time of the first row, ns, and of the last.
    first_ns: Option<i128>,
    last: HostNs,
    counts: Counts,
}

/// What came of it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Counts {
    /// Readings.
    pub samples: u64,
    /// Those that the device, or the stroke, does not vouch for.
    pub invalid: u64,
    /// Wall clock of the first row, ns since 1970, where the trace tells it.
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
    /// Of the bar with this length between its ball centres at reading zero and this stroke, mm.
    pub fn new(file: &'a str, mapping: &'a Mapping, bar_mm: f64, stroke_mm: [f64; 2]) -> Self {
        let delimiter = match mapping.file.delimiter.as_str() {
            "space" => None,
            other => other.chars().next(),
        };
        Self {
            file,
            mapping,
            bar_mm,
            stroke_mm,
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
        let places = match self.places {
            Some(places) => places,
            None => {
                let names = self.mapping.file.header.then_some(&fields[..]);
                let places = self.find(names, text)?;
                self.places = Some(places);
                if names.is_some() {
                    return Ok(None);
                }
                places
            }
        };
        self.row(&fields, text, places, offset).map(Some)
    }

    /// Ends the trace.
    ///
    /// # Errors
    /// When it holds no row.
    pub fn finish(self) -> Result<Counts, Diagnostic> {
        if self.counts.samples == 0 {
            return Err(Diagnostic::file(self.file, "holds no reading: only a header, or nothing"));
        }
        Ok(self.counts)
    }

    fn wrong(&self, text: &str, column: usize, message: impl Into<String>) -> Diagnostic {
        let excerpt = Some(text.to_owned());
        Diagnostic { excerpt, column, ..Diagnostic::line(self.file, self.lines, message) }
    }

    fn find(&self, names: Option<&[Field]>, text: &str) -> Result<Places, Diagnostic> {
        let place = |column: &Column| match (column, names) {
            (Column::Number(number), _) => Ok(number - 1),
            (Column::Name(name), Some(names)) => {
                names.iter().position(|field| field.text == *name).ok_or_else(|| {
                    let there: Vec<&str> = names.iter().map(|field| field.text.as_str()).collect();
                    self.wrong(
                        text,
                        1,
                        format!("the column `{name}` is missing; there are: {}", there.join(", ")),
                    )
                    .help("tell the layout with --mapping MAP.toml, or the delimiter in it")
                })
            }
            (Column::Name(name), None) => Err(Diagnostic::file(
                self.file,
                format!("has no header by its mapping, so the column `{name}` must be a number from 1"),
            )),
        };
        let optional = |plain: &Option<super::mapping::Plain>| {
            plain.as_ref().map(|plain| place(&plain.column)).transpose()
        };
        let Mapping { time, length, strobe, valid, temperature, .. } = self.mapping;
        Ok(Places {
            time: if time.rate_hz.is_some() { None } else { Some(place(&time.column)?) },
            length: place(&length.column)?,
            strobe: optional(strobe)?,
            valid: optional(valid)?,
            temperature: optional(temperature)?,
        })
    }

    fn row(
        &mut self,
        fields: &[Field],
        text: &str,
        places: Places,
        offset: u64,
    ) -> Result<(HostNs, Sample), Diagnostic> {
        let field = |place: usize| {
            fields.get(place).ok_or_else(|| {
                let end = text.chars().count() + 1;
                self.wrong(text, end, format!("the line ends before its column {}", place + 1))
            })
        };
        let number = |place: usize| -> Result<f64, Diagnostic> {
            let field = field(place)?;
            fields::number(&field.text, self.mapping.file.decimal)
                .map_err(|why| self.wrong(text, field.column, format!("`{}` {why}", field.text)))
        };
        let flag = |place: Option<usize>| -> Result<Option<bool>, Diagnostic> {
            let Some(field) = place.map(field).transpose()? else { return Ok(None) };
            match field.text.to_ascii_lowercase().as_str() {
                "1" | "true" | "on" => Ok(Some(true)),
                "0" | "false" | "off" => Ok(Some(false)),
                other => Err(self.wrong(text, field.column, format!("`{other}` must be 0 or 1"))),
            }
        };
        let unit = self.mapping.time.unit;
        let ns = match (places.time, self.mapping.time.rate_hz) {
            (Some(place), _) if unit == TimeUnit::Iso => {
                let field = field(place)?;
                fields::iso_ns(&field.text).ok_or_else(|| {
                    let message = format!("`{}` is no date and time as 2026-11-21T14:02:11.123", field.text);
                    self.wrong(text, field.column, message)
                })?
            }
            (Some(place), _) => (number(place)? * unit.ns()).round() as i128,
            (None, rate_hz) => (self.counts.samples as f64 * 1e9 / rate_hz.unwrap_or(1.0)).round() as i128,
        };
        let time_column = places.time.and_then(|place| fields.get(place)).map_or(1, |field| field.column);
        let since = ns - self.first_ns.unwrap_or(ns);
        let host = match u64::try_from(since) {
            Ok(since) if since >= self.last.0 => HostNs(since),
            _ => {
                return Err(self
                    .wrong(text, time_column, "the time goes back")
                    .help("a counter that begins again must be unwrapped; or is the unit wrong?"));
            }
        };
        let value_mm = number(places.length)? * self.mapping.length.unit.mm();
        let reading_mm = match self.mapping.length.kind {
            LengthKind::Distance => value_mm - self.bar_mm,
            LengthKind::Reading => value_mm,
        };
        if reading_mm.abs() > FAR_OFF * self.bar_mm {
            let message = format!(
                "{value_mm} mm is no {} of a bar of {} mm",
                if self.mapping.length.kind == LengthKind::Distance { "length" } else { "reading" },
                self.bar_mm
            );
            let column = field(places.length)?.column;
            return Err(self.wrong(text, column, message).help(
                "is the unit right, and is it the distance between the ball centres or the reading? ([length] unit, kind)",
            ));
        }
        let within = (self.stroke_mm[0]..=self.stroke_mm[1]).contains(&reading_mm);
        let sample = Sample {
            reading_mm,
            sequence: None,
            ticks: None,
            trigger: flag(places.strobe)?,
            temperature_c: places.temperature.map(number).transpose()?,
            valid: flag(places.valid)?.unwrap_or(true) && within,
            status: 0,
            offset,
        };
        if self.first_ns.is_none() && unit == TimeUnit::Iso && places.time.is_some() {
            self.counts.unix_ns = u64::try_from(ns).unwrap_or(0);
        }
        self.first_ns.get_or_insert(ns);
        self.last = host;
        self.counts.samples += 1;
        self.counts.invalid += u64::from(!sample.valid);
        Ok((host, sample))
    }
}
