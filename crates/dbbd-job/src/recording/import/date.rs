//! Dates with times as instruments write them.

use dbbd_model::base::date::days_since_1970;

/// Nanoseconds since 1970 of `2026-11-21T14:02:11.123Z` or `21.11.2026 14:02:11,123`. Accepts a blank for the T,
/// `,` for the point, an offset such as `+01:00`, and no zone.
pub(super) fn unix_ns(text: &str) -> Option<i128> {
    let (date, rest) = text.split_once(['T', ' '])?;
    let rest = rest.trim_start();
    let (clock, zone_min) = if let Some(clock) = rest.strip_suffix(['Z', 'z']) {
        (clock, 0)
    } else if let Some(at) = rest.rfind(['+', '-']) {
        let (hours, minutes) = rest[at + 1..].split_once(':').unwrap_or((&rest[at + 1..], "0"));
        let minutes = 60 * whole(hours, 0, 23)? + whole(minutes, 0, 59)?;
        (&rest[..at], if rest[at..].starts_with('-') { -minutes } else { minutes })
    } else {
        (rest, 0)
    };
    let mut parts: Vec<&str> = date.split('-').collect();
    if parts.len() == 1 {
        // In a date with points the day comes first.
        parts = date.rsplit('.').collect();
    }
    let &[year, month, day] = parts.as_slice() else { return None };
    let (year, month, day) = (whole(year, 1000, 9999)?, whole(month, 1, 12)?, whole(day, 1, 31)?);
    let mut clock = clock.splitn(3, ':');
    let (hour, minute) = (whole(clock.next()?, 0, 23)?, whole(clock.next()?, 0, 59)?);
    let seconds = clock.next().unwrap_or("0");
    let (second, fraction) = seconds.split_once(['.', ',']).unwrap_or((seconds, ""));
    let second = whole(second, 0, 60)?;
    if !fraction.bytes().all(|byte| byte.is_ascii_digit()) || fraction.len() > 12 {
        return None;
    }
    let ns: i128 = format!("{fraction:0<9}").get(..9)?.parse().ok()?;
    let days = days_since_1970(year, month, day);
    let seconds = 86_400 * days + 3600 * hour + 60 * (minute - zone_min) + second;
    Some(1_000_000_000 * i128::from(seconds) + ns)
}

fn whole(text: &str, least: i64, most: i64) -> Option<i64> {
    let digits = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    text.parse().ok().filter(|value| digits && (least..=most).contains(value))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_parsed() {
        // `date -u -d @N`: 951782400 is 2000-02-29, 1795270371 is 2026-11-21 14:12:51.
        assert_eq!(unix_ns("2000-02-29T00:00:00Z"), Some(951_782_400_000_000_000));
        assert_eq!(unix_ns("2026-11-21 15:12:51,25+01:00"), Some(1_795_270_371_250_000_000));
        assert_eq!(unix_ns("21.11.2026  14:12:51,25"), Some(1_795_270_371_250_000_000));
        assert_eq!(unix_ns("1970-01-01T00:00"), Some(0));
        for wrong in [
            "2026-13-01T00:00:00Z",
            "2026-11-21",
            "12:00:00",
            "2026-11-21T25:00:00",
            "",
            "T",
            "+-T:",
            "26.11.21 14:12:51",
            "11/21/2026 14:12",
        ] {
            assert_eq!(unix_ns(wrong), None, "{wrong}");
        }
    }

    /// The day of 1970-01-02 has 86 400 s before it; an offset is ahead of the zone of Greenwich.
    #[test]
    fn zones_are_subtracted() {
        let day = Some(86_400_000_000_000);
        for text in [
            "1970-01-02T00:00:00z",
            "1970-01-02T05:30:00+05:30",
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
