//! A line cut into fields, numbers and times in them.

use crate::catalogue::ImportFinding;

/// A field with the column at which it stands in its line, from 1, in characters.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Field {
    pub(super) text: String,
    pub(super) column: usize,
}

/// Cuts a line at its delimiter, or at blanks when that is `None`. A field in double quotes may hold the
/// delimiter; the quotes are dropped.
pub(super) fn cut(line: &str, delimiter: Option<char>) -> Vec<Field> {
    let mut fields = Vec::new();
    let mut open: Option<Field> = None;
    let mut quoted = false;
    for (at, character) in line.chars().enumerate() {
        let ends = match delimiter {
            Some(delimiter) => character == delimiter,
            None => character.is_whitespace(),
        };
        if character == '"' {
            quoted = !quoted;
            open.get_or_insert(Field { text: String::new(), column: at + 1 });
        } else if ends && !quoted {
            match open.take() {
                Some(field) => fields.push(field),
                None if delimiter.is_some() => {
                    fields.push(Field { text: String::new(), column: at + 1 });
                }
                None => {}
            }
        } else if open.is_some() || !character.is_whitespace() {
            open.get_or_insert(Field { text: String::new(), column: at + 1 }).text.push(character);
        }
    }
    match open {
        Some(field) => fields.push(field),
        // What follows the last delimiter is a field as well.
        None if delimiter.is_some() => {
            fields.push(Field { text: String::new(), column: line.chars().count() + 1 });
        }
        None => {}
    }
    for field in &mut fields {
        field.text.truncate(field.text.trim_end().len());
    }
    fields
}

/// A finite number with its decimal point.
pub(super) fn number(text: &str, decimal: char) -> Result<f64, ImportFinding> {
    let field = text.to_owned();
    let plain = if decimal == ',' {
        if text.contains('.') {
            return Err(ImportFinding::NoDecimalComma { field });
        }
        text.replace(',', ".")
    } else {
        text.to_owned()
    };
    match plain.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        Ok(_) => Err(ImportFinding::NotFinite { field }),
        Err(_) if decimal == '.' && text.replace(',', ".").parse::<f64>().is_ok() => {
            Err(ImportFinding::DecimalComma { field })
        }
        Err(_) => Err(ImportFinding::NotANumber { field }),
    }
}

/// Nanoseconds since 1970 of `2026-11-21T14:02:11.123Z`; a blank for the T, `,` for the point, an offset
/// such as `+01:00`, or no zone are taken.
pub(super) fn iso_ns(text: &str) -> Option<i128> {
    let (date, rest) = text.split_once(['T', ' '])?;
    let (clock, zone_min) = if let Some(clock) = rest.strip_suffix(['Z', 'z']) {
        (clock, 0)
    } else if let Some(at) = rest.rfind(['+', '-']) {
        let (hours, minutes) = rest[at + 1..].split_once(':').unwrap_or((&rest[at + 1..], "0"));
        let minutes = 60 * whole(hours, 0, 23)? + whole(minutes, 0, 59)?;
        (&rest[..at], if rest[at..].starts_with('-') { -minutes } else { minutes })
    } else {
        (rest, 0)
    };
    let mut date = date.split('-');
    let (year, month, day) =
        (whole(date.next()?, 1, 9999)?, whole(date.next()?, 1, 12)?, whole(date.next()?, 1, 31)?);
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

/// Days from 1970-01-01 to a date of the Gregorian calendar, counted in years that begin in March.
fn days_since_1970(year: i64, month: i64, day: i64) -> i64 {
    let (year, month) = if month > 2 { (year, month - 3) } else { (year - 1, month + 9) };
    365 * year + year / 4 - year / 100 + year / 400 + (153 * month + 2) / 5 + day - 1 - 719_468
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_cut() {
        let texts = |line: &str, delimiter| -> Vec<(String, usize)> {
            cut(line, delimiter).into_iter().map(|field| (field.text, field.column)).collect()
        };
        let field = |text: &str, column| (text.to_owned(), column);
        assert_eq!(texts("a; b ;;c", Some(';')), [field("a", 1), field("b", 4), field("", 7), field("c", 8)]);
        assert_eq!(texts("\"0,5\",1,", Some(',')), [field("0,5", 1), field("1", 7), field("", 9)]);
        assert_eq!(texts("  1.0\t 2 ", None), [field("1.0", 3), field("2", 8)]);
    }

    #[test]
    fn dates_are_those_of_the_calendar() {
        // `date -u -d @N`: 951782400 is 2000-02-29, 1795270371 is 2026-11-21 14:12:51.
        assert_eq!(iso_ns("2000-02-29T00:00:00Z"), Some(951_782_400_000_000_000));
        assert_eq!(iso_ns("2026-11-21 15:12:51,25+01:00"), Some(1_795_270_371_250_000_000));
        assert_eq!(iso_ns("1970-01-01T00:00"), Some(0));
        for wrong in
            ["2026-13-01T00:00:00Z", "2026-11-21", "12:00:00", "2026-11-21T25:00:00", "", "T", "+-T:"]
        {
            assert_eq!(iso_ns(wrong), None, "{wrong}");
        }
    }
}
