//! Dates and times as instruments write them: by a format that is given, or in the usual spellings.

use crate::recording::import::ImportFinding;
use dbbd_model::base::date::days_since_1970;

/// Which number of a date is the year, the month and the day.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum DateOrder {
    YearMonthDay,
    DayMonthYear,
    MonthDayYear,
}

pub(super) const DATE_ORDERS: [DateOrder; 3] =
    [DateOrder::YearMonthDay, DateOrder::DayMonthYear, DateOrder::MonthDayYear];

/// A time that was read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct WrittenTime {
    /// Nanoseconds since 1970, or since midnight without a date.
    pub(super) ns: i128,
    pub(super) dated: bool,
}

/// Reads a time in one of the usual spellings: `2026-11-21T14:02:11.123Z`, `2026/11/21 14:02:11:123`,
/// `21.11.2026 14:02:11,123`, `21-Nov-2026 2:02:11 PM`, `14:02:11` and their mixtures, with or without a zone.
pub(super) fn read_time(text: &str, order: DateOrder) -> Option<WrittenTime> {
    let mut text = TextCursor(text.trim());
    let mut parts = TimeParts::default();
    if !text.0.trim_start_matches(|c: char| c.is_ascii_digit()).starts_with(':') {
        text.date(order, &mut parts)?;
        text.any_of("Tt_, ")?;
        text.blanks();
    }
    text.clock(&mut parts)?;
    text.0.is_empty().then(|| parts.time()).flatten()
}

/// The format of times that a mapping gives, like that of `strptime`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct TimeFormat(Vec<FormatItem>);

#[derive(Clone, Debug, PartialEq, Eq)]
enum FormatItem {
    Year,
    ShortYear,
    Month,
    MonthName,
    Day,
    WeekDay,
    Hour,
    HalfDayHour,
    HalfDay,
    Minute,
    Second,
    /// Digits after the second, with the mark before them: both may be missing.
    Fraction(Option<char>),
    Zone,
    UnixSecond,
    Blanks,
    Literal(char),
}

impl TimeFormat {
    pub(super) fn new(format: &str) -> Result<Self, ImportFinding> {
        let mut items = Vec::new();
        let format = format.trim().replace("%F", "%Y-%m-%d").replace("%D", "%m/%d/%y");
        let format = format.replace("%T", "%H:%M:%S").replace("%R", "%H:%M");
        let mut rest = format.chars().peekable();
        while let Some(character) = rest.next() {
            if character.is_whitespace() {
                items.push(FormatItem::Blanks);
                continue;
            }
            if character != '%' {
                items.push(FormatItem::Literal(character));
                continue;
            }
            // `%.f` and `%3f` are other spellings of the fraction, `%-d` one of the day.
            let mut item = String::new();
            while let Some(next) = rest.next_if(|next| next.is_ascii_digit() || matches!(next, '.' | '-')) {
                item.push(next);
            }
            item.extend(rest.next());
            let next = match item.trim_start_matches('-') {
                "Y" => FormatItem::Year,
                "y" => FormatItem::ShortYear,
                "m" => FormatItem::Month,
                "b" | "B" | "h" => FormatItem::MonthName,
                "d" | "e" => FormatItem::Day,
                "a" | "A" => FormatItem::WeekDay,
                "H" | "k" => FormatItem::Hour,
                "I" | "l" => FormatItem::HalfDayHour,
                "p" | "P" => FormatItem::HalfDay,
                "M" => FormatItem::Minute,
                "S" => FormatItem::Second,
                "z" | "Z" => FormatItem::Zone,
                "s" => FormatItem::UnixSecond,
                "%" => FormatItem::Literal('%'),
                fraction if fraction.ends_with(['f', 'L', 'N']) => {
                    let before = items.pop_if(|item| matches!(item, FormatItem::Literal('.' | ',' | ':')));
                    FormatItem::Fraction(match before {
                        Some(FormatItem::Literal(mark)) => Some(mark),
                        _ => fraction.starts_with('.').then_some('.'),
                    })
                }
                _ => return Err(ImportFinding::TimeFormatItem { item: format!("%{item}") }),
            };
            items.push(next);
        }
        let has = |wanted: &[FormatItem]| items.iter().any(|item| wanted.contains(item));
        let unix = has(&[FormatItem::UnixSecond]);
        let date = [
            has(&[FormatItem::Year, FormatItem::ShortYear]),
            has(&[FormatItem::Month, FormatItem::MonthName]),
            has(&[FormatItem::Day]),
        ];
        let lacks = if !unix && !has(&[FormatItem::Hour, FormatItem::HalfDayHour]) {
            Some("the hour, %H or %I")
        } else if has(&[FormatItem::HalfDayHour]) && !has(&[FormatItem::HalfDay]) {
            Some("AM or PM, %p")
        } else if !unix && date.contains(&true) && date.contains(&false) {
            Some("a whole date, %Y, %m and %d")
        } else {
            None
        };
        lacks.map_or(Ok(Self(items)), |what| Err(ImportFinding::TimeFormatLacks { what }))
    }

    pub(super) fn read(&self, text: &str) -> Option<WrittenTime> {
        let mut text = TextCursor(text.trim());
        let mut parts = TimeParts::default();
        for item in &self.0 {
            text.item(item, &mut parts)?;
        }
        text.blanks();
        text.0.is_empty().then(|| parts.time()).flatten()
    }
}

/// The numbers of a time.
#[derive(Default)]
struct TimeParts {
    year: Option<i64>,
    month: Option<i64>,
    day: Option<i64>,
    hour: i64,
    minute: i64,
    second: i64,
    ns: i128,
    /// Whether PM or AM was written.
    afternoon: Option<bool>,
    zone_min: i64,
    unix_s: Option<i64>,
}

impl TimeParts {
    fn time(&self) -> Option<WrittenTime> {
        let hour = match self.afternoon {
            None => within(self.hour, 0, 23)?,
            Some(afternoon) => within(self.hour, 1, 12)? % 12 + if afternoon { 12 } else { 0 },
        };
        let (minute, second) = (within(self.minute, 0, 59)?, within(self.second, 0, 60)?);
        let date = match (self.year, self.month, self.day) {
            (None, None, None) => None,
            (year, month, day) => {
                let (year, month) = (within(year?, 1000, 9999)?, within(month?, 1, 12)?);
                let first = days_since_1970(year, month, 1);
                let length = days_since_1970(year, month + 1, 1) - first;
                Some(first + within(day?, 1, length)? - 1)
            }
        };
        let clock_s = 3600 * hour + 60 * (minute - self.zone_min) + second;
        let seconds = self.unix_s.unwrap_or(86_400 * date.unwrap_or(0) + clock_s);
        let ns = 1_000_000_000 * i128::from(seconds) + self.ns;
        Some(WrittenTime { ns, dated: date.is_some() || self.unix_s.is_some() })
    }
}

fn within(value: i64, min: i64, max: i64) -> Option<i64> {
    (min..=max).contains(&value).then_some(value)
}

/// A text that is read from its start.
struct TextCursor<'a>(&'a str);

impl<'a> TextCursor<'a> {
    fn take(&mut self, len: usize) -> Option<&'a str> {
        let (head, tail) = self.0.split_at_checked(len)?;
        self.0 = tail;
        Some(head)
    }

    fn digits(&mut self, min: usize, max: usize) -> Option<&'a str> {
        let count = self.0.bytes().take(max).take_while(u8::is_ascii_digit).count();
        (count >= min).then(|| self.take(count)).flatten()
    }

    fn number(&mut self, min: usize, max: usize) -> Option<i64> {
        self.digits(min, max)?.parse().ok()
    }

    fn word(&mut self) -> Option<&'a str> {
        let len = self.0.find(|c: char| !c.is_alphabetic()).unwrap_or(self.0.len());
        (len > 0).then(|| self.take(len)).flatten()
    }

    fn blanks(&mut self) {
        self.0 = self.0.trim_start();
    }

    fn any_of(&mut self, marks: &str) -> Option<char> {
        let mark = self.0.chars().next().filter(|mark| marks.contains(*mark))?;
        self.take(mark.len_utf8())?;
        Some(mark)
    }

    fn month_name(&mut self) -> Option<i64> {
        const MONTHS: [&str; 12] =
            ["jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"];
        let word = self.word()?.to_ascii_lowercase();
        let month = MONTHS.iter().position(|month| word.starts_with(month))?;
        Some(month as i64 + 1)
    }

    /// Whether the text goes on with PM or, for false, AM.
    fn half_day(&mut self) -> Option<bool> {
        let lower = self.0.to_ascii_lowercase();
        let words = [("a.m.", false), ("p.m.", true), ("am", false), ("pm", true)];
        let (word, afternoon) = words.into_iter().find(|(word, _)| lower.starts_with(word))?;
        self.take(word.len())?;
        Some(afternoon)
    }

    /// Minutes that the zone is ahead of Greenwich.
    fn zone(&mut self) -> Option<i64> {
        if let Some(name) = ["UTC", "GMT", "Z", "z"].into_iter().find(|name| self.0.starts_with(name)) {
            self.take(name.len())?;
            return Some(0);
        }
        let sign = if self.any_of("+-")? == '-' { -1 } else { 1 };
        let hours = within(self.number(1, 2)?, 0, 23)?;
        let colon = self.any_of(":").is_some();
        let minutes = if colon || !self.0.is_empty() { self.number(2, 2)? } else { 0 };
        Some(sign * (60 * hours + within(minutes, 0, 59)?))
    }

    /// Digits of a second after a mark. After a colon they count milliseconds, or microseconds if there are more of them.
    fn fraction(&mut self, mark: Option<char>, parts: &mut TimeParts) -> Option<()> {
        if let Some(mark) = mark {
            let Some(rest) = self.0.strip_prefix(mark) else { return Some(()) };
            self.0 = rest;
        }
        let digits = self.digits(usize::from(mark == Some(':')), 13).filter(|digits| digits.len() < 13)?;
        let digits = match (mark, digits.len()) {
            (Some(':'), 1..=3) => format!("{digits:0>3}"),
            (Some(':'), 4..=6) => format!("{digits:0>6}"),
            _ => digits.to_owned(),
        };
        parts.ns = format!("{digits:0<9}").get(..9)?.parse().ok()?;
        Some(())
    }

    fn item(&mut self, item: &FormatItem, parts: &mut TimeParts) -> Option<()> {
        match item {
            FormatItem::Year => parts.year = Some(self.number(4, 4)?),
            FormatItem::ShortYear => {
                let year = self.number(2, 2)?;
                // As POSIX has it.
                parts.year = Some(if year < 69 { 2000 + year } else { 1900 + year });
            }
            FormatItem::Month => parts.month = Some(self.number(1, 2)?),
            FormatItem::MonthName => parts.month = Some(self.month_name()?),
            FormatItem::Day => {
                self.blanks();
                parts.day = Some(self.number(1, 2)?);
            }
            FormatItem::WeekDay => drop(self.word()?),
            FormatItem::Hour | FormatItem::HalfDayHour => {
                self.blanks();
                parts.hour = self.number(1, 2)?;
            }
            FormatItem::HalfDay => parts.afternoon = Some(self.half_day()?),
            FormatItem::Minute => parts.minute = self.number(1, 2)?,
            FormatItem::Second => parts.second = self.number(1, 2)?,
            FormatItem::Fraction(mark) => self.fraction(*mark, parts)?,
            FormatItem::Zone => parts.zone_min = self.zone()?,
            FormatItem::UnixSecond => parts.unix_s = Some(self.number(1, 12)?),
            FormatItem::Blanks => self.blanks(),
            FormatItem::Literal(mark) => self.0 = self.0.strip_prefix(*mark)?,
        }
        Some(())
    }

    fn date(&mut self, order: DateOrder, parts: &mut TimeParts) -> Option<()> {
        const MARKS: &str = "-/., ";
        let items = match order {
            DateOrder::YearMonthDay => [FormatItem::Year, FormatItem::Month, FormatItem::Day],
            DateOrder::DayMonthYear => [FormatItem::Day, FormatItem::Month, FormatItem::Year],
            DateOrder::MonthDayYear => [FormatItem::Month, FormatItem::Day, FormatItem::Year],
        };
        for (place, item) in items.iter().enumerate() {
            if place > 0 {
                let mark = self.any_of(MARKS)?;
                // In a date with points the day comes first.
                if mark == '.' && order == DateOrder::MonthDayYear {
                    return None;
                }
                self.blanks();
            }
            let named = *item == FormatItem::Month && self.0.starts_with(char::is_alphabetic);
            self.item(if named { &FormatItem::MonthName } else { item }, parts)?;
        }
        parts.time().map(|_| ())
    }

    fn clock(&mut self, parts: &mut TimeParts) -> Option<()> {
        parts.hour = self.number(1, 2)?;
        self.any_of(":")?;
        parts.minute = self.number(1, 2)?;
        if self.any_of(":").is_some() {
            parts.second = self.number(1, 2)?;
            let mark = self.0.chars().next().filter(|mark| ".,:".contains(*mark));
            if mark.is_some() {
                self.fraction(mark, parts)?;
            }
        }
        self.blanks();
        parts.afternoon = self.half_day();
        self.blanks();
        if !self.0.is_empty() {
            parts.zone_min = self.zone()?;
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The time by the first order that can read it.
    fn unix_ns(text: &str) -> Option<i128> {
        DATE_ORDERS.into_iter().find_map(|order| read_time(text, order)).map(|time| time.ns)
    }

    fn orders(text: &str) -> Vec<DateOrder> {
        DATE_ORDERS.into_iter().filter(|order| read_time(text, *order).is_some()).collect()
    }

    #[test]
    fn dates_are_parsed() {
        // `date -u -d @N`: 951782400 is 2000-02-29, 1795270371 is 2026-11-21 14:12:51.
        assert_eq!(unix_ns("2000-02-29T00:00:00Z"), Some(951_782_400_000_000_000));
        let same = Some(1_795_270_371_250_000_000);
        for text in [
            "2026-11-21 15:12:51,25+01:00",
            "21.11.2026  14:12:51,25",
            "21. 11. 2026 14:12:51.250",
            "2026/11/21 14:12:51:250",
            "2026/11/21T14:12:51:250000 UTC",
            "11/21/2026 2:12:51.25 PM",
            "21/11/2026 02:12:51.25 p.m.",
            "21-Nov-2026 14:12:51.25",
            "Nov 21, 2026 02:12:51.250 pm",
            "11/21/2026, 2:12:51.25PM",
            "2026.11.21_14:12:51.25",
        ] {
            assert_eq!(unix_ns(text), same, "{text}");
        }
        assert_eq!(unix_ns("1970-01-01T00:00"), Some(0));
        for wrong in [
            "2026-13-01T00:00:00Z",
            "2026-11-21",
            "2026-11-21T25:00:00",
            "",
            "T",
            "+-T:",
            "26.11.21 14:12:51",
            "11.21.2026 14:12:51",
            "31/04/2026 14:12",
            "13:12:51 PM",
            "0:12:51 AM",
            "21-Foo-2026 14:12",
            "14:12:51.2x",
            "ä14:12:51",
        ] {
            assert_eq!(unix_ns(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn a_day_above_twelve_shows_the_order() {
        use DateOrder::{DayMonthYear, MonthDayYear, YearMonthDay};
        assert_eq!(orders("2024/09/14 02:16:47"), [YearMonthDay]);
        assert_eq!(orders("14/09/2024 02:16:47"), [DayMonthYear]);
        assert_eq!(orders("09/14/2024 02:16:47"), [MonthDayYear]);
        assert_eq!(orders("09/12/2024 02:16:47"), [DayMonthYear, MonthDayYear]);
        assert_eq!(orders("09.12.2024 02:16:47"), [DayMonthYear]);
        assert_eq!(orders("9-Dec-2024 02:16:47"), [DayMonthYear]);
        assert_eq!(orders("02:16:47"), DATE_ORDERS);
    }

    /// Midnight is 12 AM, noon is 12 PM.
    #[test]
    fn hours_of_half_days_begin_at_twelve() {
        for (text, hour) in [("12:00 AM", 0), ("1:00 am", 1), ("12:00 PM", 12), ("11:00pm", 23)] {
            let time = read_time(text, DateOrder::YearMonthDay);
            assert_eq!(time, Some(WrittenTime { ns: hour * 3_600_000_000_000, dated: false }), "{text}");
        }
    }

    #[test]
    fn formats_read_what_they_say() {
        for (format, text, ns) in [
            ("%d/%m/%y %H:%M:%S.%f", "02/01/70 00:00:01.5", 86_401_500_000_000),
            ("%m/%d/%Y %I:%M:%S.%f %p", "1/2/1970 12:00:01.5 AM", 86_401_500_000_000),
            ("%Y%m%dT%H%M%S%f", "19700102T000001500", 86_401_500_000_000),
            ("%Y%m%d %H%M%S%.3f", "19700102 000001.500", 86_401_500_000_000),
            ("%F %T,%L", "1970-01-02 00:00:01", 86_401_000_000_000),
            ("%T:%f", "00:00:01:5", 1_005_000_000),
            ("%a %d-%b-%Y %R %z", "Fri 02-Jan-1970 01:00 +0100", 86_400_000_000_000),
            ("%s.%f", "86401.5", 86_401_500_000_000),
        ] {
            let read = TimeFormat::new(format).unwrap().read(text);
            assert_eq!(read.map(|time| time.ns), Some(ns), "{format} {text}");
        }
        let format = TimeFormat::new("%d/%m/%Y %H:%M").unwrap();
        for wrong in ["", "1/13/2024 10:00", "1/12/2024 10:00:00", "1-12-2024 10:00", "1/12/2024 24:00"] {
            assert_eq!(format.read(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn formats_that_give_no_time_are_refused() {
        let fault = |format: &str| TimeFormat::new(format).err();
        assert_eq!(fault("%H:%Q"), Some(ImportFinding::TimeFormatItem { item: "%Q".into() }));
        assert_eq!(fault("%H:%"), Some(ImportFinding::TimeFormatItem { item: "%".into() }));
        for lacks in ["", "%Y-%m-%d", "%I:%M", "%m/%d %H:%M"] {
            assert!(matches!(fault(lacks), Some(ImportFinding::TimeFormatLacks { .. })), "{lacks}");
        }
    }

    /// The day of 1970-01-02 has 86 400 s before it; an offset is ahead of the zone of Greenwich.
    #[test]
    fn zones_are_subtracted() {
        let day = Some(86_400_000_000_000);
        for text in [
            "1970-01-02T00:00:00z",
            "1970-01-02T05:30:00+05:30",
            "1970-01-02T05:30:00+0530",
            "1970-01-01T18:30:00-05:30",
            "1970-01-02 01:00:00+01",
            "02.01.1970 00:00",
        ] {
            assert_eq!(unix_ns(text), day, "{text}");
        }
    }

    #[test]
    fn fractions_have_up_to_twelve_digits() {
        assert_eq!(unix_ns("1970-01-01T00:00:01.5"), Some(1_500_000_000));
        assert_eq!(unix_ns("1970-01-01T00:00:01.000000001"), Some(1_000_000_001));
        assert_eq!(unix_ns("1970-01-01T00:00:01.000000001999"), Some(1_000_000_001));
        assert_eq!(unix_ns("1970-01-01T00:00:01.0000000019990"), None);
        // Milliseconds after a colon.
        assert_eq!(unix_ns("1970-01-01T00:00:01:5"), Some(1_005_000_000));
        assert_eq!(unix_ns("1970-01-01T00:00:01:005000"), Some(1_005_000_000));
        // A leap second.
        assert_eq!(unix_ns("1970-01-01T00:00:60"), Some(60_000_000_000));
        for wrong in [
            "1970-01-01T00:00:61",
            "1970-01-01T00:60",
            "1970-01-01T24:00",
            "1970-01-32T00:00",
            "1970-00-01T00:00",
        ] {
            assert_eq!(unix_ns(wrong), None, "{wrong}");
        }
    }
}
