//! Dates of the Gregorian calendar.

/// Days of a month in the mean of the Julian years of science.
const DAYS_OF_MONTH: f64 = 365.25 / 12.0;
const NS_OF_DAY: u64 = 86_400_000_000_000;

/// Days from 1970-01-01 to a date `YYYY-MM-DD`; `None` if the text is not a date.
pub fn day_number(date: &str) -> Option<f64> {
    let number = |part: &str, digits: usize| {
        let is_number = part.len() == digits && part.bytes().all(|byte| byte.is_ascii_digit());
        is_number.then(|| part.parse::<i64>().ok()).flatten()
    };
    let mut parts = date.splitn(3, '-');
    let (year, month, day) =
        (number(parts.next()?, 4)?, number(parts.next()?, 2)?, number(parts.next()?, 2)?);
    let days = |month: i64, day: i64| days_since_1970(year, month, day);
    let is_month = (1..=9999).contains(&year) && (1..=12).contains(&month);
    let is_date = is_month && (1..=days(month + 1, 1) - days(month, 1)).contains(&day);
    is_date.then(|| days(month, day) as f64)
}

/// Months of mean length from one date to another, with or without a time; `None` if one is not a date.
pub fn months_between(from: &str, to: &str) -> Option<f64> {
    let day = |moment: &str| day_number(moment.split('T').next()?);
    Some((day(to)? - day(from)?) / DAYS_OF_MONTH)
}

/// The date this number of months after another date; `None` if that is not a date.
pub fn after_months(date: &str, months: f64) -> Option<String> {
    let day = day_number(date.split('T').next()?)? + (months * DAYS_OF_MONTH).floor();
    let ns = (day >= 0.0).then_some(day as u64 * NS_OF_DAY)?;
    utc(ns).split('T').next().map(str::to_owned)
}

/// Whether a date is later than a time (nanoseconds since the Unix epoch) in every time zone.
pub fn is_after(date: &str, unix_ns: u64) -> bool {
    let day = (unix_ns / NS_OF_DAY) as f64;
    day_number(date).is_some_and(|date| date > day + 1.0)
}

/// Whether a text is a time `hh:mm` or `hh:mm:ss`, with or without a `Z` at the end.
fn is_time(text: &str) -> bool {
    let parts: Vec<&str> = text.strip_suffix('Z').unwrap_or(text).split(':').collect();
    let below = |(part, most): (&&str, u8)| {
        part.len() == 2
            && part.bytes().all(|byte| byte.is_ascii_digit())
            && part.parse::<u8>().is_ok_and(|n| n < most)
    };
    (2..=3).contains(&parts.len()) && parts.iter().zip([24, 60, 60]).all(below)
}

/// Whether a text is a date `YYYY-MM-DD`, optionally with `T` and a time. Such texts sort in the order of time.
pub fn is_moment(text: &str) -> bool {
    let (date, time) = text.split_once('T').map_or((text, None), |(date, time)| (date, Some(time)));
    day_number(date).is_some() && time.is_none_or(is_time)
}

/// UTC date and time `YYYY-MM-DDThh:mm:ssZ` of nanoseconds since the Unix epoch.
pub fn utc(unix_ns: u64) -> String {
    let seconds = (unix_ns / 1_000_000_000) as i64;
    let (days, time) = (seconds / 86_400, seconds % 86_400);
    let has_begun = |year: i64, month: i64| days_since_1970(year, month, 1) <= days;
    let year = (1970..).take_while(|year| has_begun(*year, 1)).last().unwrap_or(1970);
    let month = (1..=12).take_while(|month| has_begun(year, *month)).last().unwrap_or(1);
    let day = days - days_since_1970(year, month, 1) + 1;
    let [hour, minute, second] = [time / 3600, time / 60 % 60, time % 60];
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}Z")
}

/// Days from 1970-01-01 to a date of the Gregorian calendar; month 13 is the next January. The years of the computation
/// begin in March, so that a leap day is the last day of its year.
pub fn days_since_1970(year: i64, month: i64, day: i64) -> i64 {
    let (year, month) = if month > 2 { (year, month - 3) } else { (year - 1, month + 9) };
    365 * year + year / 4 - year / 100 + year / 400 + (153 * month + 2) / 5 + day - 1 - 719_468
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_and_times_match_gnu_date() {
        // `date -u -d @SECONDS` of GNU coreutils.
        for (seconds, text) in [
            (0, "1970-01-01T00:00:00Z"),
            (951_782_400, "2000-02-29T00:00:00Z"),
            (1_709_251_199, "2024-02-29T23:59:59Z"),
            (4_107_542_400, "2100-03-01T00:00:00Z"),
        ] {
            assert_eq!(utc(seconds * 1_000_000_000), text);
        }
        assert_eq!(day_number("2024-03-01").unwrap() - day_number("2024-02-28").unwrap(), 2.0);
        assert!(
            ["2100-02-29", "2024-3-1", "+024-03-01", "01.03.2024"]
                .into_iter()
                .all(|text| day_number(text).is_none())
        );
        assert!(["2024-03-01", "2024-03-01T10:00Z"].into_iter().all(is_moment));
        assert!(!["2024-03-01T", "2024-03-01Tnoon", "2024-03-01 10:00"].into_iter().any(is_moment));
        assert!(["23:59", "00:00:59Z"].into_iter().all(is_time));
        assert!(!["24:00", "10:60", "10", "10:00:00+01:00", "+1:00", ""].into_iter().any(is_time));
    }

    /// 2024 has 366 days, 12 mean months 365.25: the day before the anniversary.
    #[test]
    fn months_are_twelfths_of_a_year() {
        let months = months_between("2024-01-31T10:00:00Z", "2028-01-31").unwrap();
        assert!((months - 48.0).abs() < 1e-12, "{months}");
        assert_eq!(after_months("2024-01-31", 12.0).as_deref(), Some("2025-01-30"));
        assert_eq!(after_months("2024-01-31T10:00:00Z", 1.0).as_deref(), Some("2024-03-01"));
        assert_eq!((after_months("2024-13-01", 1.0), months_between("", "2024-01-01")), (None, None));
    }

    #[test]
    fn a_date_is_after_a_time_if_it_is_so_in_every_zone() {
        // 2024-03-01 is day 19783. A zone may be up to a day ahead.
        let noon = (19_783 * 24 + 12) * 3_600_000_000_000;
        assert_eq!(day_number("2024-03-01"), Some(19_783.0));
        assert!(
            !is_after("2024-03-01", noon) && !is_after("2024-03-02", noon) && is_after("2024-03-03", noon)
        );
    }
}
