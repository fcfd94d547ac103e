//! Decimal numbers as text: signs, blanks, widths.

use super::table::{DecimalFill, DecimalSign};

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct DecimalFormat {
    pub(super) decimals: usize,
    /// Number of characters with sign and point, for reading and writing.
    pub(super) width: Option<usize>,
    /// Least number of characters for writing.
    pub(super) pad_to: usize,
    pub(super) fill: DecimalFill,
    pub(super) sign: DecimalSign,
    /// Whether blanks may precede the sign and the digits.
    pub(super) blanks: bool,
}

impl DecimalFormat {
    /// The number at the start of `rest`, and the bytes after it.
    pub(super) fn read<'a>(&self, rest: &'a [u8]) -> Option<(f64, &'a [u8])> {
        let blanks = |bytes: &[u8]| bytes.iter().take_while(|byte| **byte == b' ').count();
        let (field, tail) = match self.width {
            Some(width) => rest.split_at_checked(width)?,
            None => {
                let lead = if self.blanks { blanks(rest) } else { usize::from(rest.starts_with(b" ")) };
                let sign = usize::from(matches!(rest.get(lead), Some(b'+' | b'-')));
                let inner = if self.blanks { blanks(&rest[lead + sign..]) } else { 0 };
                let start = lead + sign + inner;
                let number = |byte: &&u8| byte.is_ascii_digit() || **byte == b'.';
                rest.split_at(start + rest[start..].iter().take_while(number).count())
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
        if !digits.bytes().all(|byte| byte.is_ascii_digit() || byte == b'.') {
            return None;
        }
        let value: f64 = digits.parse().ok().filter(|value: &f64| value.is_finite())?;
        Some((if negative { -value } else { value }, tail))
    }

    /// Appends a number; `None` if it does not fit.
    pub(super) fn write(&self, value: f64, body: &mut Vec<u8>) -> Option<()> {
        if !value.is_finite() {
            return None;
        }
        let digits = format!("{:.*}", self.decimals, value.abs());
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
