//! What a trace shows of its own format, where the mapping leaves it open: all rows are looked at, not only the first.

use super::date::{DATE_ORDERS, DateOrder, TimeFormat, WrittenTime, read_time};
use super::mapping::{FlagColumn, LengthKind, TraceColumn, TraceMapping, TraceTimeUnit};
use crate::recording::import::ImportFinding;
use dbbd_model::base::FileFinding;
use dbbd_model::base::table::{TableReader, TableRow};
use dbbd_model::diagnostic::Diagnostic;

/// A value further from the bar's length than this share of it is no length of this bar.
const FAR_OFF: f64 = 0.2;

/// The format of a trace: the mapping's, or detected.
#[derive(Debug)]
pub struct TraceFormat {
    pub(super) places: ColumnPlaces,
    times: TraceTimes,
    /// `None`: no length is one of this bar.
    kind: Option<LengthKind>,
    /// Millimetres per unit of the lengths, and length of the bar.
    unit_mm: f64,
    bar_mm: f64,
    /// What was detected.
    pub(super) findings: Vec<ImportFinding>,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct ColumnPlaces {
    pub(super) time: Option<usize>,
    date: Option<usize>,
    pub(super) length: usize,
    pub(super) strobe: Option<usize>,
    pub(super) valid: Option<usize>,
    pub(super) temperature: Option<usize>,
}

/// How the times are written.
#[derive(Debug)]
enum TraceTimes {
    Number(TraceTimeUnit),
    Usual(DateOrder),
    Format(TimeFormat),
}

impl TraceFormat {
    /// Reads the table, to its end if need be.
    pub fn detect(
        table: &mut TableReader<'_>,
        mapping: &TraceMapping,
        bar_mm: f64,
    ) -> Result<Self, Diagnostic> {
        let places = match ColumnPlaces::find(table, mapping) {
            // An empty file has no rows: a missing column would be a misleading finding.
            Err(_) if table.names().is_empty() && table.row()?.is_none() => {
                return Err(Diagnostic::file(table.file(), ImportFinding::Empty));
            }
            places => places?,
        };
        let mut times = TimesSeen { text_only: mapping.time.unit.is_some(), ..TimesSeen::default() };
        let mut kinds = KindsSeen::default();
        let settled = match (&mapping.time.format, mapping.time.unit, places.time) {
            (Some(format), ..) => {
                let format =
                    TimeFormat::new(format).map_err(|wrong| Diagnostic::file(table.file(), wrong))?;
                Some(TraceTimes::Format(format))
            }
            (None, None | Some(TraceTimeUnit::Iso), Some(_)) => None,
            (None, unit, _) => Some(TraceTimes::Number(unit.unwrap_or(TraceTimeUnit::S))),
        };
        loop {
            let row = match table.row() {
                Ok(None) => break,
                Ok(Some(row)) => row,
                // The reader of the rows decides about it.
                Err(wrong) if matches!(wrong.finding(), Some(FileFinding::CellCount { .. })) => continue,
                Err(wrong) => return Err(wrong),
            };
            if let (None, Some(_)) = (&settled, places.time) {
                times.add(&row, &places);
            }
            kinds.add(row.number(places.length).ok().map(|value| value * mapping.length.unit.mm()), bar_mm);
            if (settled.is_some() || times.is_settled())
                && (mapping.length.kind.is_some() || kinds.are_enough())
            {
                break;
            }
            table.take_text();
        }
        let (times, written) = match settled {
            Some(times) => (times, None),
            None => times.format()?,
        };
        let kind = mapping.length.kind.or(kinds.kind());
        let written = written.filter(|_| mapping.time.unit.is_none());
        let readings = mapping.length.kind.is_none() && kind == Some(LengthKind::Reading);
        let findings = [
            written.map(|written| ImportFinding::Times { written }),
            readings.then_some(ImportFinding::Readings { bar_mm }),
        ];
        let findings = findings.into_iter().flatten().collect();
        Ok(Self { places, times, kind, unit_mm: mapping.length.unit.mm(), bar_mm, findings })
    }

    /// The time of a row in the column `place`.
    pub(super) fn time(&self, row: &TableRow<'_>, place: usize) -> Result<WrittenTime, Diagnostic> {
        row.has(place)?;
        let field = self.places.time_text(row, place);
        let (time, wrong) = match &self.times {
            TraceTimes::Number(unit) => {
                let ns = (row.number(place)? * unit.ns()).round() as i128;
                return Ok(WrittenTime { ns, dated: false });
            }
            TraceTimes::Usual(order) => (read_time(&field, *order), ImportFinding::NotADate { field }),
            TraceTimes::Format(format) => (format.read(&field), ImportFinding::NotOfFormat { field }),
        };
        time.ok_or_else(|| row.wrong(place, wrong))
    }

    /// Whether times are of a day, and begin again at midnight.
    pub(super) fn is_of_day(&self) -> bool {
        !matches!(self.times, TraceTimes::Number(_))
    }

    /// The reading of a row, mm.
    pub(super) fn reading_mm(&self, row: &TableRow<'_>) -> Result<f64, Diagnostic> {
        let (place, bar_mm) = (self.places.length, self.bar_mm);
        let value_mm = row.number(place)? * self.unit_mm;
        let (reading_mm, finding) = match self.kind {
            Some(LengthKind::Reading) => (value_mm, ImportFinding::NoReadingOfBar { value_mm, bar_mm }),
            Some(LengthKind::Distance) | None => {
                (value_mm - bar_mm, ImportFinding::NoLengthOfBar { value_mm, bar_mm })
            }
        };
        if reading_mm.abs() > FAR_OFF * bar_mm {
            return Err(row.wrong(place, finding));
        }
        Ok(reading_mm)
    }
}

impl ColumnPlaces {
    /// Positions of the columns, by the header if there is one.
    fn find(table: &TableReader<'_>, mapping: &TraceMapping) -> Result<Self, Diagnostic> {
        let TraceMapping { file, time, length, strobe, valid, temperature } = mapping;
        let place = |column: &TraceColumn| match column {
            TraceColumn::Number(number) => Ok(number.get() - 1),
            TraceColumn::Name(name) if file.header => table.required([name]).map(|[at]| at),
            TraceColumn::Name(name) => {
                Err(Diagnostic::file(table.file(), ImportFinding::NoHeader { column: name.clone() }))
            }
        };
        let flag = |key: &Option<FlagColumn>| key.as_ref().map(|key| place(&key.column)).transpose();
        Ok(Self {
            time: if time.rate_hz.is_some() { None } else { Some(place(&time.column)?) },
            date: time.date_column.as_ref().map(place).transpose()?,
            length: place(&length.column)?,
            strobe: flag(strobe)?,
            valid: flag(valid)?,
            temperature: temperature.as_ref().map(|key| place(&key.column)).transpose()?,
        })
    }

    /// Date and time of a row, as they are written.
    fn time_text(&self, row: &TableRow<'_>, time: usize) -> String {
        match self.date {
            Some(date) => format!("{} {}", row.text(date), row.text(time)),
            None => row.text(time).to_owned(),
        }
    }
}

/// The spellings that the times of all rows so far allow.
#[derive(Default)]
struct TimesSeen {
    /// Whether the mapping says that the times are no numbers.
    text_only: bool,
    /// Whether the first time that can be read is a number; `None` if no time can be read.
    numbers: Option<bool>,
    /// Whether a text that cannot be read looks like a time.
    like_times: bool,
    orders: Option<Vec<DateOrder>>,
    dated: bool,
    /// The place of the first date that may be read in two ways.
    ambiguous: Option<Diagnostic>,
}

impl TimesSeen {
    fn add(&mut self, row: &TableRow<'_>, places: &ColumnPlaces) {
        let Some(place) = places.time else { return };
        let text = places.time_text(row, place);
        let can_be_number = !self.text_only && places.date.is_none() && self.numbers != Some(false);
        if can_be_number && row.number(place).is_ok() {
            self.numbers = Some(true);
            return;
        }
        self.like_times |= text.contains([':', '/']) && text.contains(|c: char| c.is_ascii_digit());
        let known = self.orders.as_deref().unwrap_or(&DATE_ORDERS);
        let read = |order: &DateOrder| read_time(&text, *order);
        let Some(time) = known.iter().find_map(read) else { return };
        let orders: Vec<DateOrder> = known.iter().copied().filter(|order| read(order).is_some()).collect();
        self.numbers.get_or_insert(false);
        self.dated |= time.dated;
        if time.dated && orders.len() > 1 && self.ambiguous.is_none() {
            self.ambiguous = Some(row.wrong(place, ImportFinding::DayOrMonth { field: text }));
        }
        self.orders = Some(orders);
    }

    fn is_settled(&self) -> bool {
        self.numbers == Some(true) || self.orders.as_ref().is_some_and(|orders| orders.len() == 1)
    }

    fn format(self) -> Result<(TraceTimes, Option<&'static str>), Diagnostic> {
        if self.numbers.unwrap_or(!self.text_only && !self.like_times) {
            return Ok((TraceTimes::Number(TraceTimeUnit::S), None));
        }
        let orders = self.orders.unwrap_or_default();
        if let (true, [_, _, ..], Some(ambiguous)) = (self.dated, orders.as_slice(), self.ambiguous) {
            return Err(ambiguous);
        }
        let order = orders.first().copied().unwrap_or(DateOrder::YearMonthDay);
        if !self.dated {
            return Ok((TraceTimes::Usual(order), Some("times of a day")));
        }
        let written = match order {
            DateOrder::YearMonthDay => "dates",
            DateOrder::DayMonthYear => "dates with the day first",
            DateOrder::MonthDayYear => "dates with the month first",
        };
        Ok((TraceTimes::Usual(order), Some(written)))
    }
}

/// How many lengths can be readings, and how many distances.
#[derive(Default)]
struct KindsSeen {
    first: Option<LengthKind>,
    readings: u32,
    distances: u32,
}

impl KindsSeen {
    fn add(&mut self, value_mm: Option<f64>, bar_mm: f64) {
        let Some(value_mm) = value_mm else { return };
        let max_mm = FAR_OFF * bar_mm;
        if value_mm.abs() <= max_mm {
            self.readings += 1;
            self.first.get_or_insert(LengthKind::Reading);
        } else if (value_mm - bar_mm).abs() <= max_mm {
            self.distances += 1;
            self.first.get_or_insert(LengthKind::Distance);
        }
    }

    fn are_enough(&self) -> bool {
        const ENOUGH: u32 = 1000;
        self.readings.max(self.distances) >= ENOUGH
    }

    /// The kind of most lengths; of equally many that of the first.
    fn kind(&self) -> Option<LengthKind> {
        match self.readings.cmp(&self.distances) {
            std::cmp::Ordering::Less => Some(LengthKind::Distance),
            std::cmp::Ordering::Equal => self.first,
            std::cmp::Ordering::Greater => Some(LengthKind::Reading),
        }
    }
}
