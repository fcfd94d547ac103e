//! Dependent directions in plain words.

use crate::model::ParamId;

/// Whether a coefficient of `other` in the combination of `kept` is more than rounding: what a
/// plausible error of `other` (1 mm, 1 mrad) moves is compared with that of `kept`.
pub(super) fn matters(kept: ParamId, other: ParamId, coefficient: f64) -> bool {
    coefficient.abs() * plausible(other) > 1e-6 * plausible(kept)
}

/// An error that nobody would be surprised by: 1 mm, 1 mrad, 1 mrad at 1000 N m.
fn plausible(id: ParamId) -> f64 {
    match id.unit() {
        "mm" => 1.0,
        "rad" => 1e-3,
        _ => 1e-6,
    }
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
    let bars =
        members.iter().filter_map(|(id, _)| if let ParamId::BarOffset(k) = id { Some(*k) } else { None });
    match bars.max() {
        Some(1) => text
            .push_str(": bar_offset cannot be told from a uniform scale; calibrate the bar or add a second length"),
        Some(bar) => text.push_str(&format!(
            ": bar_offset{bar} cannot be told from a uniform scale while each bar has an offset of its own; calibrate \
             one of the bars, or set one to a second length"
        )),
        None => text.push_str(standing(members[0].0)),
    }
    text
}

/// What a combination with the set-up means; empty for the robot's own parameters.
fn standing(kept: ParamId) -> &'static str {
    if matches!(kept, ParamId::Centre(..)) {
        ": lengths do not tell where the robot's base stands, only where the ball is from it"
    } else if matches!(kept, ParamId::Tool(_)) {
        ": the flange is only known by the ball on it"
    } else {
        ""
    }
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
