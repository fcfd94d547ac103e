//! Scales, ticks at 1-2-5 steps, display units, and numbers as text.

pub(crate) use dbbd_model::base::number::{decimals, fixed, significant};
use dbbd_model::base::text;

/// A linear map from values to pixels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scale {
    pub(crate) values: [f64; 2],
    pub(crate) pixels: [f64; 2],
}

impl Scale {
    pub(crate) fn at(&self, value: f64) -> f64 {
        let [low, high] = self.values;
        let [from, to] = self.pixels;
        from + (value - low) / (high - low) * (to - from)
    }
}

/// Ticks at steps of 1, 2 or 5 times a power of ten.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Ticks {
    pub(crate) step: f64,
    pub(crate) values: Vec<f64>,
}

impl Ticks {
    /// About `count` ticks inside `range`; none if it is empty or not finite.
    pub(crate) fn inside(range: [f64; 2], count: f64) -> Self {
        let [low, high] = range;
        Self::stepped([low, high], step(high - low, count))
    }

    /// The multiples of `step` inside `range`.
    pub(crate) fn stepped([low, high]: [f64; 2], step: f64) -> Self {
        let mut values = Vec::new();
        if low.is_finite() && high.is_finite() && step > 0.0 {
            let first = (low / step - 1e-9).ceil();
            let last = (high / step + 1e-9).floor();
            let mut at = first;
            while at <= last && values.len() < 100 {
                values.push(at * step);
                at += 1.0;
            }
        }
        Self { step, values }
    }

    /// A tick's label, with the decimals that the step needs.
    pub(crate) fn label(&self, value: f64) -> String {
        fixed(value, decimals(self.step))
    }
}

/// The 1-2-5 step that divides `span` into about `count`; 0 if there is none.
pub(crate) fn step(span: f64, count: f64) -> f64 {
    let raw = span / count;
    if !raw.is_finite() || raw <= 0.0 {
        return 0.0;
    }
    let power = 10f64.powf(raw.log10().floor());
    let factor = [1.0, 2.0, 5.0].into_iter().find(|factor| raw <= factor * power * 1.0001);
    factor.unwrap_or(10.0) * power
}

/// The range of the finite values, widened if they are equal; 0 to 1 without a value.
pub(crate) fn range(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let [low, high] = values
        .filter(|value| value.is_finite())
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| [low.min(value), high.max(value)]);
    if low > high {
        [0.0, 1.0]
    } else if high - low <= 1e-9 * high.abs().max(low.abs()).max(1e-9) {
        let half = (0.05 * high.abs()).max(1e-6);
        [low - half, high + half]
    } else {
        [low, high]
    }
}

/// The largest magnitude of the finite values; a thousandth without one.
pub(crate) fn magnitude(values: impl Iterator<Item = f64>) -> f64 {
    let largest =
        values.filter(|value| value.is_finite()).fold(0.0, |most: f64, value| most.max(value.abs()));
    if largest > 0.0 { largest } else { 1e-3 }
}

#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Unit {
    pub(crate) sign: &'static str,
    /// Display value = factor * base value.
    pub(crate) factor: f64,
}

impl Unit {
    pub(crate) const MM: Self = Self { sign: "mm", factor: 1.0 };
    /// Degrees, for an angle in rad.
    pub(crate) const DEG: Self = Self { sign: "deg", factor: 180.0 / std::f64::consts::PI };

    /// The unit for deviations up to `largest_mm`.
    pub(crate) fn length(largest_mm: f64) -> Self {
        if largest_mm < 1.0 { Self { sign: "µm", factor: 1e3 } } else { Self::MM }
    }

    /// The unit for angle errors up to `largest_rad`.
    pub(crate) fn angle(largest_rad: f64) -> Self {
        if largest_rad < 2e-4 {
            Self { sign: "µrad", factor: 1e6 }
        } else {
            Self { sign: "mrad", factor: 1e3 }
        }
    }
}

/// A text for pages: minus signs (U+2212) in place of the hyphens before its numbers, ± and µ for what a terminal has as
/// `+-` and `u`.
pub(crate) fn typeset(text: String) -> String {
    let mut set = String::with_capacity(text.len());
    let mut before = ' ';
    let mut rest = text.chars().peekable();
    while let Some(character) = rest.next() {
        let number = rest.peek().is_some_and(|next| next.is_ascii_digit() || *next == ' ');
        let minus = character == '-' && number && matches!(before, ' ' | '(' | '[' | '|');
        set.push(if minus { '−' } else { character });
        before = character;
    }
    let set = set.replace("+-", "±");
    let sign = |word: &str| match word.trim_end_matches(|end: char| !end.is_alphanumeric()) {
        "um" | "urad" => word.replacen('u', "µ", 1),
        _ => word.to_owned(),
    };
    set.split_inclusive(|end: char| !end.is_alphanumeric() && end != '_').map(sign).collect()
}

pub(crate) fn signed(value: f64, decimals: usize) -> String {
    let text = fixed(value, decimals);
    if value > 0.0 && text.chars().any(|digit| matches!(digit, '1'..='9')) {
        format!("+{text}")
    } else {
        text
    }
}

pub(crate) fn plain(value: f64, decimals: usize) -> String {
    text::without_end_zeros(&fixed(value, decimals)).to_owned()
}

/// A number rounded to `figures` significant figures, also before the decimal point.
pub(crate) fn rounded(value: f64, figures: usize) -> String {
    let place = 10f64.powf(value.abs().max(1e-300).log10().floor() + 1.0 - figures as f64);
    significant((value / place).round() * place, figures)
}

/// An index without a unit, of any size.
pub(crate) fn index(value: f64) -> String {
    if value > 0.0 && value < 1e-3 {
        format!("{value:.2e}").replace("e-", "e−")
    } else {
        significant(value, 3)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_step_by_one_two_or_five() {
        assert_eq!(Ticks::inside([0.0, 1.0], 5.0).values.len(), 6);
        assert_eq!(Ticks::inside([-0.3, 0.3], 6.0).label(-0.1), "−0.1");
        assert_eq!(step(240.0, 5.0), 50.0);
        assert_eq!(Ticks::inside([f64::NAN, 1.0], 5.0).values, Vec::<f64>::new());
        assert_eq!(Ticks::inside([1.0, 1.0], 5.0).values, Vec::<f64>::new());
    }

    #[test]
    fn numbers_are_formatted_for_readers() {
        assert_eq!(signed(0.25, 2), "+0.25");
        assert_eq!((index(4.7134e-6), index(0.041234)), ("4.71e−6".into(), "0.0412".into()));
        assert_eq!(plain(-185.0, 2), "−185");
        assert_eq!(rounded(15_556.0, 2), "16000");
        assert_eq!(rounded(f64::NAN, 2), "–");
        let texts = [
            ("at least -4.500 mm", "at least −4.500 mm"),
            ("(650, -1128, 800) mm", "(650, −1128, 800) mm"),
            ("only tool_x - 20 theta6", "only tool_x − 20 theta6"),
            ("70 um (um, 3 urad/Nm) +- 0.5 um.", "70 µm (µm, 3 µrad/Nm) ± 0.5 µm."),
            ("sigma_um, lumber, um_x", "sigma_um, lumber, um_x"),
            ("plan-2.csv, 2026-11-21, --prior, 1.0e-3", "plan-2.csv, 2026-11-21, --prior, 1.0e-3"),
        ];
        for (text, set) in texts {
            assert_eq!(typeset(text.into()), set);
        }
    }
}
