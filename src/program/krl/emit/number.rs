//! Numbers and texts as KRL takes them: a point, no exponent, no minus before zero, ASCII.

/// A length: three decimals.
pub(in crate::program::krl) fn millimetre(value: f64) -> String {
    fixed(value, 3)
}

/// An angle, or an angular speed: four decimals.
pub(in crate::program::krl) fn degrees(value: f64) -> String {
    fixed(value, 4)
}

/// A speed or an acceleration in metres: six decimals.
pub(in crate::program::krl) fn metre_per_second(value: f64) -> String {
    fixed(value, 6)
}

/// A share of the axis speeds: whole percents, since the controller rounds; never more than asked.
pub(in crate::program::krl) fn percent(value: f64) -> String {
    fixed(value.floor(), 0)
}

/// A time: three decimals.
pub(in crate::program::krl) fn seconds(value: f64) -> String {
    fixed(value, 3)
}

/// A number with so many decimals, without a minus before zero.
pub(in crate::program::krl) fn fixed(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(positive) if positive.chars().all(|c| c == '0' || c == '.') => positive.to_owned(),
        _ => text,
    }
}

/// A text for a CHAR array or a comment: printable ASCII without quotes, at most `length` characters.
pub(in crate::program::krl) fn character_text(text: &str, length: usize) -> String {
    let plain = |c: char| if c == ' ' || (c.is_ascii_graphic() && c != '"' && c != ';') { c } else { '_' };
    text.chars().map(plain).take(length).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_zero_has_no_sign_and_no_number_an_exponent() {
        assert_eq!(millimetre(-0.0), "0.000");
        assert_eq!(millimetre(-0.000_4), "0.000");
        assert_eq!(millimetre(-0.000_6), "-0.001");
        assert_eq!(degrees(1e-9), "0.0000");
        assert_eq!(degrees(-123_456.789_01), "-123456.7890");
    }
}
