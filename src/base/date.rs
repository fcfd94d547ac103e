//! Dates of the Gregorian calendar.

/// Days of a date `YYYY-MM-DD` from a fixed one; `None` of what is no date.
pub fn day_number(date: &str) -> Option<f64> {
    let mut parts = date.splitn(3, '-').map(|part| part.parse::<u32>().ok());
    let (year, month, day) = (parts.next()??, parts.next()??, parts.next()??);
    let lengths = month_lengths(year);
    let most = *lengths.get(month.checked_sub(1)? as usize)?;
    if !(1..=9999).contains(&year) || !(1..=most).contains(&day) {
        return None;
    }
    let months: u32 = lengths.iter().take(month as usize - 1).sum();
    Some(f64::from(days_before(year) + months + day))
}

/// Date and time `YYYY-MM-DDThh:mm:ssZ`, UTC, of nanoseconds since the Unix epoch.
pub fn utc(unix_ns: u64) -> String {
    let seconds = unix_ns / 1_000_000_000;
    let (mut days, time) = (u32::try_from(seconds / 86_400).unwrap_or(u32::MAX), seconds % 86_400);
    let mut year = 1970;
    while days >= days_before(year + 1) - days_before(year) {
        days -= days_before(year + 1) - days_before(year);
        year += 1;
    }
    let mut month = 1;
    for length in month_lengths(year) {
        if days < length {
            break;
        }
        days -= length;
        month += 1;
    }
    let [hour, minute, second] = [time / 3600, time / 60 % 60, time % 60];
    format!("{year:04}-{month:02}-{:02}T{hour:02}:{minute:02}:{second:02}Z", days + 1)
}

fn month_lengths(year: u32) -> [u32; 12] {
    let leap = year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400));
    let february = if leap { 29 } else { 28 };
    [31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31]
}

/// Days from the first of year 1 to that of `year`.
fn days_before(year: u32) -> u32 {
    let before = year.saturating_sub(1);
    365 * before + before / 4 - before / 100 + before / 400
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_those_of_the_calendar() {
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
        assert_eq!(day_number("2100-02-29"), None);
    }
}
