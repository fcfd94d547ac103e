//! The layout of a trace, described by a small TOML file.

use std::num::NonZeroUsize;

use serde::Deserialize;

use super::date::TimeFormat;
use crate::recording::import::ImportFinding;
use dbbd_model::base::parse::from_toml;
use dbbd_model::base::table::{Delimiter, TableLayout};
use dbbd_model::diagnostic::Diagnostic;

/// The layout of a trace. Without any key the trace has the columns `t_s` and `length_mm`.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TraceMapping {
    pub(super) file: TraceFileTable,
    pub(super) time: TraceTimeTable,
    pub(super) length: TraceLengthTable,
    pub(super) strobe: Option<FlagColumn>,
    pub(super) valid: Option<FlagColumn>,
    pub(super) temperature: Option<ColumnKey>,
}

/// The layout of lines and cells; values that are absent are detected.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct TraceFileTable {
    /// One character between cells, or `space` for any number of blanks.
    delimiter: Option<String>,
    /// The decimal point, `.` or `,`.
    decimal: Option<char>,
    /// Lines before the header, or before the first row without one.
    skip_lines: usize,
    /// Whether a line names the columns.
    pub(super) header: bool,
    /// Lines with this prefix are skipped.
    comment: Option<String>,
}

impl Default for TraceFileTable {
    fn default() -> Self {
        Self { delimiter: None, decimal: None, skip_lines: 0, header: true, comment: None }
    }
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct TraceTimeTable {
    pub(super) column: TraceColumn,
    /// Column of the dates, if they have one of their own.
    pub(super) date_column: Option<TraceColumn>,
    /// How date and time are written, as for `strptime`; if it is absent, detected.
    pub(super) format: Option<String>,
    /// Unit of the times; if it is absent, seconds, or dates if the first row has a date.
    pub(super) unit: Option<TraceTimeUnit>,
    /// Readings per second, instead of a column.
    pub(super) rate_hz: Option<f64>,
}

impl Default for TraceTimeTable {
    fn default() -> Self {
        let column = TraceColumn::Name("t_s".into());
        Self { column, date_column: None, format: None, unit: None, rate_hz: None }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum TraceTimeUnit {
    S,
    Ms,
    Us,
    Ns,
    /// Date and time as text.
    Iso,
}

impl TraceTimeUnit {
    /// Nanoseconds per unit; dates are parsed instead.
    pub(super) fn ns(self) -> f64 {
        match self {
            Self::S | Self::Iso => 1e9,
            Self::Ms => 1e6,
            Self::Us => 1e3,
            Self::Ns => 1.0,
        }
    }
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct TraceLengthTable {
    pub(super) column: TraceColumn,
    pub(super) unit: LengthUnit,
    /// Kind of the lengths; if it is absent, detected from the first row and the length of the bar.
    pub(super) kind: Option<LengthKind>,
}

impl Default for TraceLengthTable {
    fn default() -> Self {
        Self { column: TraceColumn::Name("length_mm".into()), unit: LengthUnit::Mm, kind: None }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum LengthUnit {
    M,
    Mm,
    Um,
    Inch,
}

impl LengthUnit {
    pub(super) fn mm(self) -> f64 {
        match self {
            Self::M => 1e3,
            Self::Mm => 1.0,
            Self::Um => 1e-3,
            Self::Inch => 25.4,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum LengthKind {
    /// Distance between the ball centres.
    Distance,
    /// Deviation from the length of the bar, positive when it is longer.
    Reading,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ColumnKey {
    pub(super) column: TraceColumn,
}

/// A column of zeros and ones, or of words for them.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FlagColumn {
    pub(super) column: TraceColumn,
    /// Numbers from this one on mean 1: the column is a voltage.
    pub(super) threshold: Option<f64>,
}

/// A column by name, or by number from 1.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(untagged, expecting = "a column's name, or its number from 1")]
pub(super) enum TraceColumn {
    Name(String),
    Number(NonZeroUsize),
}

impl TraceMapping {
    pub fn from_toml(file: &str, text: &str) -> Result<Self, Diagnostic> {
        let mapping: Self = from_toml(file, text)?;
        let at = |word: &str, finding: ImportFinding| {
            let from = text.find(word).unwrap_or(0);
            Diagnostic::span(file, text, from..from + word.len(), finding)
        };
        let TraceFileTable { delimiter, decimal, .. } = &mapping.file;
        let delimiter = delimiter.as_deref();
        if delimiter.is_some_and(|delimiter| delimiter != "space" && delimiter.chars().count() != 1) {
            return Err(at("delimiter", ImportFinding::Delimiter));
        }
        if decimal.is_some_and(|decimal| !matches!(decimal, '.' | ',')) {
            return Err(at("decimal", ImportFinding::Decimal));
        }
        if decimal.is_some_and(|decimal| delimiter.is_some_and(|delimiter| delimiter.starts_with(decimal))) {
            return Err(at("decimal", ImportFinding::DecimalIsDelimiter));
        }
        let TraceTimeTable { column, date_column, format, unit, rate_hz } = &mapping.time;
        let as_text = date_column.is_some() || format.is_some();
        let named = *column != TraceTimeTable::default().column || unit.is_some() || as_text;
        if rate_hz.is_some() && named {
            return Err(at("rate_hz", ImportFinding::RateAndColumn));
        }
        if as_text && unit.is_some_and(|unit| unit != TraceTimeUnit::Iso) {
            return Err(at("unit", ImportFinding::UnitOfText));
        }
        if let Some(format) = format {
            TimeFormat::new(format).map_err(|finding| at("format", finding))?;
        }
        let flags = [&mapping.strobe, &mapping.valid].into_iter().flatten();
        if flags.filter_map(|flag| flag.threshold).any(|threshold| !threshold.is_finite()) {
            return Err(at("threshold", ImportFinding::Threshold));
        }
        if rate_hz.is_some_and(|hz| !(hz.is_finite() && hz > 0.0)) {
            return Err(at("rate_hz", ImportFinding::Rate));
        }
        Ok(mapping)
    }

    pub fn layout(&self) -> TableLayout {
        let TraceFileTable { delimiter, decimal, skip_lines, header, comment } = self.file.clone();
        let delimiter = delimiter.and_then(|delimiter| match delimiter.as_str() {
            "space" => Some(Delimiter::Blanks),
            other => other.chars().next().map(Delimiter::Character),
        });
        TableLayout { delimiter, decimal, skip_lines, header, comment }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_in_nanoseconds_and_millimetres() {
        let ns = [TraceTimeUnit::S, TraceTimeUnit::Ms, TraceTimeUnit::Us, TraceTimeUnit::Ns]
            .map(TraceTimeUnit::ns);
        assert_eq!(ns, [1e9, 1e6, 1e3, 1.0]);
        let mm = [LengthUnit::M, LengthUnit::Mm, LengthUnit::Um, LengthUnit::Inch].map(LengthUnit::mm);
        assert_eq!(mm, [1000.0, 1.0, 0.001, 25.4]);
    }

    #[test]
    fn columns_have_defaults() {
        let mapping = TraceMapping::from_toml("m.toml", "").unwrap();
        assert_eq!(mapping.time.column, TraceColumn::Name("t_s".into()));
        assert_eq!(mapping.length.column, TraceColumn::Name("length_mm".into()));
        assert_eq!(mapping.length.unit, LengthUnit::Mm);
        assert!(mapping.layout().header && mapping.layout().delimiter.is_none());
    }

    #[test]
    fn contradictory_mappings_are_refused() {
        let finding = |text: &str| {
            let diagnostic = TraceMapping::from_toml("m.toml", text).err()?;
            diagnostic.finding::<ImportFinding>().cloned()
        };
        for (text, expected) in [
            ("[file]\ndelimiter = ';;'", Some(ImportFinding::Delimiter)),
            ("[file]\ndelimiter = 'space'", None),
            ("[file]\ndecimal = ';'", Some(ImportFinding::Decimal)),
            ("[file]\ndecimal = ','\ndelimiter = ';'", None),
            ("[file]\ndecimal = ','\ndelimiter = ','", Some(ImportFinding::DecimalIsDelimiter)),
            ("[time]\nrate_hz = 100", None),
            ("[time]\nrate_hz = 0", Some(ImportFinding::Rate)),
            ("[time]\nrate_hz = inf", Some(ImportFinding::Rate)),
            ("[time]\nrate_hz = 100\ncolumn = 't'", Some(ImportFinding::RateAndColumn)),
            ("[time]\nrate_hz = 100\nunit = 'ms'", Some(ImportFinding::RateAndColumn)),
            ("[time]\nrate_hz = 100\ndate_column = 'd'", Some(ImportFinding::RateAndColumn)),
            ("[time]\nunit = 'ms'\nformat = '%H:%M'", Some(ImportFinding::UnitOfText)),
            ("[time]\nunit = 'iso'\nformat = '%H:%M'", None),
            ("[time]\nformat = '%H:%Q'", Some(ImportFinding::TimeFormatItem { item: "%Q".into() })),
            ("[time]\nformat = '%I:%M'", Some(ImportFinding::TimeFormatLacks { what: "AM or PM, %p" })),
            ("[strobe]\ncolumn = 1\nthreshold = nan", Some(ImportFinding::Threshold)),
        ] {
            assert_eq!(finding(text), expected, "{text}");
        }
    }
}
