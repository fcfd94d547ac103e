//! Dependent directions in plain words.

use crate::model::ParamId;

/// Whether a coefficient of `other` in the combination of `kept` is more than rounding: what a
/// plausible error of `other` (1 mm, 1 mrad) moves is compared with that of `kept`.
pub(super) fn matters(kept: ParamId, other: ParamId, coefficient: f64) -> bool {
    coefficient.abs() * plausible(other) > 1e-6 * plausible(kept)
}

/// An error that nobody would be surprised by: 1 mm, 1 mrad.
fn plausible(id: ParamId) -> f64 {
    if id.unit() == "mm" { 1.0 } else { 1e-3 }
}

/// The combination as a sentence; the first member is the one that is kept.
pub(super) fn combination(members: &[(ParamId, f64)]) -> String {
    let mut sum = String::new();
    for (at, (id, coefficient)) in members.iter().enumerate() {
        let sign = match (at, *coefficient < 0.0) {
            (0, _) => "",
            (_, true) => " - ",
            (_, false) => " + ",
        };
        sum.push_str(sign);
        let size = coefficient.abs();
        if (size - 1.0).abs() > 1e-6 {
            sum.push_str(&format!("{} ", significant(size)));
        }
        sum.push_str(&id.to_string());
    }
    let mut text = format!("only {sum} can be told");
    let others = || members[1..].iter().map(|(id, _)| *id);
    if members[0].0 == ParamId::BarOffset || others().any(|id| id == ParamId::BarOffset) {
        text.push_str(
            ": bar_offset cannot be told from a uniform scale; calibrate the bar or add a second length",
        );
    } else if matches!(members[0].0, ParamId::Centre(..)) {
        text.push_str(": lengths do not tell where the robot's base stands, only where the ball is from it");
    } else if matches!(members[0].0, ParamId::Tool(_)) {
        text.push_str(": the flange is only known by the ball on it");
    }
    text
}

/// Four significant digits, without an exponent where it reads well.
fn significant(value: f64) -> String {
    if !(1e-3..1e5).contains(&value) {
        return format!("{value:.3e}");
    }
    let digits = (3 - value.log10().floor() as i32).clamp(0, 6) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}
