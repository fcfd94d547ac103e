//! Numbers as text for readers.

/// Decimals that show a value of this size to one figure.
pub fn decimals(size: f64) -> usize {
    if size.is_finite() && size > 0.0 { (-(size.log10() + 1e-9).floor()).clamp(0.0, 9.0) as usize } else { 0 }
}

/// A number with fixed decimals, a minus sign (U+2212) and no negative zero; a dash if it is not finite.
pub fn fixed(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return "–".to_owned();
    }
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(zero) if zero.chars().all(|digit| matches!(digit, '0' | '.')) => zero.to_owned(),
        Some(digits) => format!("−{digits}"),
        None => text,
    }
}

/// A number with the decimals of `figures` significant figures; in powers of ten only if it is extreme.
pub fn significant(value: f64, figures: usize) -> String {
    let extra = figures.saturating_sub(1);
    let size = value.abs();
    if value.is_finite() && (size >= 1e7 || (size > 0.0 && size < 1e-7)) {
        return format!("{value:.extra$e}");
    }
    let scaled = size / 10f64.powi(extra as i32);
    fixed(value, decimals(scaled))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_formatted_for_readers() {
        assert_eq!(fixed(-0.0004, 2), "0.00");
        assert_eq!(fixed(f64::NAN, 2), "–");
        assert_eq!(significant(0.041234, 3), "0.0412");
        assert_eq!(significant(1234.6, 2), "1235");
    }
}
