//! Decimal numbers as text: signs, blanks, widths.
use serde::Deserialize;

/// Filling of a short number, between sign and digits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum DecimalFill {
    #[default]
    Zero,
    Blank,
}

/// Sign of a number that is not negative: none, plus, blank.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum DecimalSign {
    #[default]
    Minus,
    Always,
    Blank,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct DecimalFormat {
    pub(super) decimals: usize,
    /// Smallest and largest number of decimals that the device shows; a reading with others is in another unit.
    pub(super) read_decimals: Option<[usize; 2]>,
    /// The decimal mark, `.` or `,`.
    pub(super) mark: u8,
    /// Number of characters with sign and point, for reading and writing.
    pub(super) width: Option<usize>,
    /// Least number of characters for writing.
    pub(super) pad_to: usize,
    pub(super) fill: DecimalFill,
    pub(super) sign: DecimalSign,
    /// Whether blanks may precede the sign and the digits.
    pub(super) blanks: bool,
}

impl Default for DecimalFormat {
    fn default() -> Self {
        Self {
            decimals: 0,
            read_decimals: None,
            mark: b'.',
            width: None,
            pad_to: 0,
            fill: DecimalFill::default(),
            sign: DecimalSign::default(),
            blanks: false,
        }
    }
}

/// Length of an exponent such as `E-01`; 0 without one.
fn exponent_len(rest: &[u8]) -> usize {
    let ([b'E' | b'e', b'+' | b'-', digits @ ..] | [b'E' | b'e', digits @ ..]) = rest else { return 0 };
    let count = digits.iter().take(3).take_while(|byte| byte.is_ascii_digit()).count();
    if count == 0 { 0 } else { rest.len() - digits.len() + count }
}

impl DecimalFormat {
    /// The number of decimals of the number at the start of `rest`.
    pub(super) fn decimals(&self, rest: &[u8]) -> Option<usize> {
        let (_, tail) = self.read(rest)?;
        let number = rest.get(..rest.len() - tail.len())?;
        let after = number.iter().position(|byte| *byte == self.mark).map_or(number.len(), |mark| mark + 1);
        Some(number.iter().skip(after).take_while(|byte| byte.is_ascii_digit()).count())
    }

    /// The number at the start of `rest`, which may have an exponent, and the bytes after it.
    pub(super) fn read<'a>(&self, rest: &'a [u8]) -> Option<(f64, &'a [u8])> {
        let blanks = |bytes: &[u8]| bytes.iter().take_while(|byte| **byte == b' ').count();
        let (field, tail) = match self.width {
            Some(width) => rest.split_at_checked(width)?,
            None => {
                let lead = if self.blanks { blanks(rest) } else { usize::from(rest.starts_with(b" ")) };
                let sign = usize::from(matches!(rest.get(lead), Some(b'+' | b'-')));
                let inner = if self.blanks { blanks(&rest[lead + sign..]) } else { 0 };
                let start = lead + sign + inner;
                let number = |byte: &&u8| byte.is_ascii_digit() || **byte == self.mark;
                let end = start + rest[start..].iter().take_while(number).count();
                rest.split_at(end + exponent_len(&rest[end..]))
            }
        };
        let text = std::str::from_utf8(field).ok()?;
        let text =
            if self.blanks || self.sign == DecimalSign::Blank { text.trim_start_matches(' ') } else { text };
        let (negative, digits) = match text.strip_prefix('-') {
            Some(digits) => (true, digits),
            None => (false, text.strip_prefix('+').unwrap_or(text)),
        };
        let digits = if self.blanks { digits.trim_start_matches(' ') } else { digits };
        let is_mantissa = |byte: u8| byte.is_ascii_digit() || byte == self.mark;
        let mantissa = digits.bytes().take_while(|byte| is_mantissa(*byte)).count();
        let exponent = &digits.as_bytes()[mantissa..];
        if exponent_len(exponent) != exponent.len() {
            return None;
        }
        let value: f64 = match self.mark {
            b'.' => digits.parse(),
            mark => digits.replace(char::from(mark), ".").parse(),
        }
        .ok()
        .filter(|value: &f64| value.is_finite())?;
        Some((if negative { -value } else { value }, tail))
    }

    /// Appends a number; `None` if it does not fit.
    pub(super) fn write(&self, value: f64, body: &mut Vec<u8>) -> Option<()> {
        if !value.is_finite() {
            return None;
        }
        let mut digits = format!("{:.*}", self.decimals, value.abs());
        if self.mark != b'.' {
            digits = digits.replace('.', char::from(self.mark).encode_utf8(&mut [0; 4]));
        }
        let sign = match (value.is_sign_negative(), self.sign) {
            (true, _) => "-",
            (false, DecimalSign::Minus) => "",
            (false, DecimalSign::Always) => "+",
            (false, DecimalSign::Blank) => " ",
        };
        let len = sign.len() + digits.len();
        if self.width.is_some_and(|width| len > width) {
            return None;
        }
        body.extend_from_slice(sign.as_bytes());
        let fill = if self.fill == DecimalFill::Zero { b'0' } else { b' ' };
        body.extend(std::iter::repeat_n(fill, self.width.unwrap_or(self.pad_to).saturating_sub(len)));
        body.extend(digits.into_bytes());
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLAIN: DecimalFormat = DecimalFormat {
        decimals: 3,
        read_decimals: None,
        mark: b'.',
        width: None,
        pad_to: 0,
        fill: DecimalFill::Zero,
        sign: DecimalSign::Minus,
        blanks: false,
    };

    fn written(format: DecimalFormat, value: f64) -> Option<String> {
        let mut body = Vec::new();
        format.write(value, &mut body)?;
        String::from_utf8(body).ok()
    }

    fn read(format: DecimalFormat, text: &str) -> Option<(f64, &str)> {
        let (value, tail) = format.read(text.as_bytes())?;
        Some((value, std::str::from_utf8(tail).ok()?))
    }

    #[test]
    fn numbers_are_written_with_sign_and_fill() {
        let signed = |sign| DecimalFormat { sign, ..PLAIN };
        assert_eq!(written(PLAIN, -1.25).as_deref(), Some("-1.250"));
        assert_eq!(written(PLAIN, 1.25).as_deref(), Some("1.250"));
        assert_eq!(written(signed(DecimalSign::Always), 1.25).as_deref(), Some("+1.250"));
        assert_eq!(written(signed(DecimalSign::Blank), 1.25).as_deref(), Some(" 1.250"));
        let wide = DecimalFormat { width: Some(8), ..PLAIN };
        assert_eq!(written(wide, -1.25).as_deref(), Some("-001.250"));
        assert_eq!(
            written(DecimalFormat { fill: DecimalFill::Blank, ..wide }, -1.25).as_deref(),
            Some("-  1.250")
        );
        assert_eq!(written(DecimalFormat { pad_to: 7, ..PLAIN }, 1.25).as_deref(), Some("001.250"));
    }

    #[test]
    fn numbers_that_do_not_fit_are_not_written() {
        let narrow = DecimalFormat { width: Some(5), ..PLAIN };
        assert_eq!(written(narrow, 1.25).as_deref(), Some("1.250"));
        assert_eq!(written(narrow, -1.25), None);
        assert_eq!(written(PLAIN, f64::NAN), None);
        assert_eq!(written(DecimalFormat { pad_to: 3, ..PLAIN }, 12.5).as_deref(), Some("12.500"));
    }

    #[test]
    fn numbers_are_read_up_to_what_follows() {
        assert_eq!(read(PLAIN, "+1.5,x"), Some((1.5, ",x")));
        assert_eq!(read(PLAIN, "-0.25"), Some((-0.25, "")));
        assert_eq!(read(DecimalFormat { width: Some(5), ..PLAIN }, "001.57"), Some((1.5, "7")));
        assert_eq!(read(DecimalFormat { width: Some(5), ..PLAIN }, "1.5"), None);
        for wrong in ["", "-", "x", "1.2.3", "--1"] {
            assert_eq!(read(PLAIN, wrong), None, "{wrong}");
        }
    }

    #[test]
    fn exponents_and_decimal_commas_are_read() {
        for (text, value, tail) in [
            ("+1.25000000E-01", 0.125, ""),
            ("-2.5e+1;", -25.0, ";"),
            ("1E3", 1000.0, ""),
            ("1.5E", 1.5, "E"),
            ("1.5E+x", 1.5, "E+x"),
        ] {
            assert_eq!(read(PLAIN, text), Some((value, tail)), "{text}");
        }
        assert_eq!(read(DecimalFormat { width: Some(7), ..PLAIN }, "1.25E-1"), Some((0.125, "")));
        assert_eq!(read(DecimalFormat { width: Some(7), ..PLAIN }, "1.25E-x"), None);
        assert_eq!(read(PLAIN, "1E999"), None);
        let comma = DecimalFormat { mark: b',', ..PLAIN };
        assert_eq!(read(comma, "+0012,345 mm"), Some((12.345, " mm")));
        assert_eq!((read(comma, "1,2,3"), read(comma, "1.5")), (None, Some((1.0, ".5"))));
        assert_eq!(written(comma, -1.25).as_deref(), Some("-1,250"));
    }

    #[test]
    fn decimals_of_a_number_are_counted() {
        for (text, decimals) in [("+012.700", 3), ("+0.50000", 5), ("12", 0), ("12.", 0), ("1.25E-01", 2)] {
            assert_eq!(PLAIN.decimals(text.as_bytes()), Some(decimals), "{text}");
        }
    }

    #[test]
    fn blanks_are_skipped_where_they_may_be() {
        let blanks = DecimalFormat { blanks: true, ..PLAIN };
        assert_eq!(read(blanks, "  -  1.5 mm"), Some((-1.5, " mm")));
        assert_eq!(read(PLAIN, " 1.5"), None);
        assert_eq!(read(PLAIN, "- 1.5"), None);
        assert_eq!(read(DecimalFormat { sign: DecimalSign::Blank, ..PLAIN }, " 1.5;"), Some((1.5, ";")));
    }
}
