//! Parsers of option values. Their errors state the valid range.

use std::fmt;

use crate::cli::CliFinding;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use dbbd_job::program::CompensationFinding;
use dbbd_model::estimation::EstimationFinding;
use dbbd_model::provenance::CERTIFIED_C;
use dbbd_model::robot::Pose;
use dbbd_model::robot::pose::is_part_of_turn;

fn number(text: &str, is_valid: impl Fn(f64) -> bool, refusal: CliFinding) -> Result<f64, CliFinding> {
    text.parse().ok().filter(|value: &f64| value.is_finite() && is_valid(*value)).ok_or(refusal)
}

fn within(text: &str, [least, most]: [f64; 2], unit: &'static str) -> Result<f64, CliFinding> {
    number(text, |value| (least..=most).contains(&value), CliFinding::Outside { least, most, unit })
}

/// A small length in mm. A larger number is one in micrometres.
fn fine(text: &str, most_mm: f64) -> Result<f64, CliFinding> {
    number(text, |mm| mm > 0.0 && mm <= most_mm, CliFinding::NotFine { most_mm })
}

pub(super) fn positive(text: &str) -> Result<f64, CliFinding> {
    number(text, |value| value > 0.0, CliFinding::NotPositive)
}

/// The standard uncertainty of a bar's length, mm. A smaller number is one in metres.
pub(super) fn bar_u(text: &str) -> Result<f64, CliFinding> {
    within(text, [5e-5, 0.5], "mm")
}

/// A tolerance of a position or of a circular deviation, mm.
pub(super) fn tolerance(text: &str) -> Result<f64, CliFinding> {
    fine(text, 20.0)
}

/// The standard deviation of a length, mm.
pub(super) fn length_sd(text: &str) -> Result<f64, CliFinding> {
    fine(text, 1.0)
}

/// The largest probability of a wrong decision.
pub(super) fn risk(text: &str) -> Result<f64, CliFinding> {
    number(text, |risk| risk > 0.0 && risk < 0.5, CliFinding::NotARisk)
}

/// A thermal expansion, 1/K.
pub(super) fn expansion(text: &str) -> Result<f64, CliFinding> {
    number(text, |per_k| per_k > 0.0 && per_k < 1e-3, CliFinding::NotAnExpansion)
}

/// The temperature of a bar's certificate, degrees Celsius.
pub(super) fn certified(text: &str) -> Result<f64, CliFinding> {
    let [least, most] = CERTIFIED_C;
    let refusal = CliFinding::NotACertifiedTemperature { least, most };
    number(text, |celsius| (least..=most).contains(&celsius), refusal)
}

/// The number of Monte Carlo draws, or 0. Fewer than 50 give no 95 % interval.
pub(super) fn draws(text: &str) -> Result<usize, CliFinding> {
    const MIN_DRAWS: usize = 50;
    const MAX_DRAWS: usize = 1_000_000;
    let refusal =
        CliFinding::Outside { least: MIN_DRAWS as f64, most: MAX_DRAWS as f64, unit: "draws, or 0" };
    text.parse().ok().filter(|draws| *draws == 0 || (MIN_DRAWS..=MAX_DRAWS).contains(draws)).ok_or(refusal)
}

pub(super) fn seconds(text: &str) -> Result<f64, CliFinding> {
    number(text, |s| s >= 0.0, CliFinding::NotSeconds)
}

/// The interval of --sync-every, s: a loss of power costs at most an hour.
pub(super) fn sync_seconds(text: &str) -> Result<f64, CliFinding> {
    within(text, [0.0, 3600.0], "s")
}

/// How long a worker of the archive may be silent, s.
pub(super) fn lease(text: &str) -> Result<f64, CliFinding> {
    within(text, [1.0, 86_400.0], "s")
}

/// The interval between two checks of a robot, days.
pub(super) fn interval(text: &str) -> Result<f64, CliFinding> {
    within(text, [1.0, 3650.0], "days")
}

/// NAME=VALUE.
pub(super) fn name_value(text: &str) -> Result<(String, String), CliFinding> {
    match text.split_once('=') {
        Some((name, value)) if !name.is_empty() => Ok((name.to_owned(), value.to_owned())),
        _ => Err(CliFinding::NotNameAndValue),
    }
}

/// N finite numbers between commas.
fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let number = |part: &str| part.trim().parse().ok().filter(|value: &f64| value.is_finite());
    text.split(',').map(number).collect::<Option<Vec<_>>>()?.try_into().ok()
}

/// The place of the tool ball in the flange frame, mm.
pub(super) fn tool_ball(text: &str) -> Result<[f64; 3], EstimationFinding> {
    /// No tool ball is nearer to the centre of the flange: a smaller number is one in metres.
    const MIN_TOOL_MM: f64 = 3.0;
    let place: [f64; 3] = numbers(text).ok_or(EstimationFinding::NotAPoint)?;
    let largest = place.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
    let in_metres = largest > 0.0 && largest < MIN_TOOL_MM;
    if in_metres { Err(EstimationFinding::PointInMetres) } else { Ok(place) }
}

/// A frame X,Y,Z,A,B,C in mm and degrees.
pub(super) fn frame(text: &str) -> Result<Pose, CompensationFinding> {
    let [x, y, z, a, b, c] = numbers(text).ok_or(CompensationFinding::NotAFrame)?;
    let in_radians = [a, b, c].into_iter().any(is_part_of_turn);
    if in_radians {
        Err(CompensationFinding::FrameInRadians)
    } else {
        Ok(Pose::from_kuka([x, y, z], [a, b, c]))
    }
}

/// The parser of an option that takes the name of one of `all`.
pub(crate) fn one_of<T: Copy + Send + Sync + 'static>(
    all: &'static [T],
    name: fn(T) -> &'static str,
) -> impl TypedValueParser<Value = T> {
    let names = PossibleValuesParser::new(all.iter().map(|one| name(*one)));
    // Cannot fail: the text is one of the names.
    names.try_map(move |text| all.iter().copied().find(|one| name(*one) == text).ok_or(fmt::Error))
}
