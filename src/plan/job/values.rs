//! What a single value of a job may be, and where it stands in the file.

/// Where a value stands: the table's header, which of them (from 0), the key.
pub(super) type Place = (&'static str, usize, &'static str);

/// A place and what is wrong there.
pub(super) type Wrong = (Place, String);

/// No length (mm), angle (degrees), speed or time of a job is larger.
const MOST: f64 = 1e5;

/// Whether `low` is below `high` in every axis.
pub(super) fn corners(low: [f64; 3], high: [f64; 3]) -> bool {
    let sane = |value: &f64| (-MOST..=MOST).contains(value);
    low.iter().zip(&high).all(|(low, high)| sane(low) && sane(high) && low < high)
}

pub(super) fn positive(place: Place, value: f64) -> Result<(), Wrong> {
    if value > 0.0 && value <= MOST {
        Ok(())
    } else {
        Err((place, format!("{} = {value} must be a positive number, at most {MOST}", place.2)))
    }
}

pub(super) fn finite(place: Place, value: f64) -> Result<(), Wrong> {
    within(place, value, [-MOST, MOST])
}

/// Whether a value lies within a range, which NaN does not.
pub(super) fn within(place: Place, value: f64, [low, high]: [f64; 2]) -> Result<(), Wrong> {
    if (low..=high).contains(&value) {
        Ok(())
    } else {
        Err((place, format!("{} = {value} is not a number from {low} to {high}", place.2)))
    }
}

pub(super) fn direction_vector(place: Place, key: &str, [x, y, z]: [f64; 3]) -> Result<(), Wrong> {
    let length = x.hypot(y).hypot(z);
    if (1e-6..=MOST).contains(&length) {
        Ok(())
    } else {
        Err((place, format!("{key} = [{x}, {y}, {z}] is no direction")))
    }
}

/// The line (from 1) of a key in the `at`-th table of that header, else of the header; a place whose
/// header has no bracket is a key of its own.
pub(super) fn line_of(text: &str, (header, at, key): Place) -> Option<usize> {
    let starts = |line: &str, key: &str| {
        line.trim_start().strip_prefix(key).is_some_and(|rest| rest.trim_start().starts_with(['=', '.']))
    };
    let mut lines = text.lines().enumerate().map(|(number, line)| (number + 1, line));
    if !header.starts_with('[') {
        let table = format!("[motion.{header}]");
        return lines.find(|(_, line)| starts(line, header) || line.trim() == table).map(|(n, _)| n);
    }
    let (found, _) =
        lines.by_ref().filter(|(_, line)| line.split('#').next().unwrap_or("").trim() == header).nth(at)?;
    let within = lines.take_while(|(_, line)| !line.trim_start().starts_with('['));
    Some(within.filter(|(_, line)| starts(line, key)).map(|(n, _)| n).next().unwrap_or(found))
}
