//! Parsers of option values. Their errors state the valid range.

use std::fmt;
use std::path::{Path, PathBuf};

use crate::cli::CliFinding;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use dbbd_job::program::CompensationFinding;
use dbbd_job::request::plan::RepeatedRows;
use dbbd_job::robot_description::{DescriptionFinding, PendantPose};
use dbbd_model::base::date::is_moment;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::EstimationFinding;
use dbbd_model::plausibility::{POSITIVE, PlausibleRange, Quantity, ValueKey};
use dbbd_model::provenance::IdentityFinding;

fn number(text: &str, is_valid: impl Fn(f64) -> bool, refusal: CliFinding) -> Result<f64, CliFinding> {
    text.parse().ok().filter(|value: &f64| value.is_finite() && is_valid(*value)).ok_or(refusal)
}

/// A number that its quantity can have.
fn of(text: &str, quantity: Quantity) -> Result<f64, Diagnostic> {
    within(text, quantity.range())
}

fn within(text: &str, range: PlausibleRange) -> Result<f64, Diagnostic> {
    let value = text.parse().map_err(|_| CliFinding::NotANumber { range: range.to_string() })?;
    range.check(ValueKey::NONE, value)?;
    Ok(value)
}

pub(super) fn positive(text: &str) -> Result<f64, CliFinding> {
    number(text, |value| value > 0.0, CliFinding::NotPositive)
}

/// A date, or date and time.
pub(super) fn date(text: &str) -> Result<String, Diagnostic> {
    let not_a_date = || IdentityFinding::NotADate { key: "date".into(), date: text.into() };
    is_moment(text).then(|| text.to_owned()).ok_or_else(|| not_a_date().into())
}

/// A temperature, degrees Celsius.
pub(super) fn temperature(text: &str) -> Result<f64, Diagnostic> {
    of(text, Quantity::Temperature)
}

/// The standard uncertainty of a bar's length, mm.
pub(super) fn bar_u(text: &str) -> Result<f64, Diagnostic> {
    of(text, Quantity::StandardLengthUncertainty)
}

/// A tolerance of a position or of a circular deviation, mm.
pub(super) fn tolerance(text: &str) -> Result<f64, Diagnostic> {
    of(text, Quantity::PositionTolerance)
}

/// The standard deviation of a length, mm. That of simulated lengths may be smaller than any bar's.
pub(super) fn length_sd(text: &str) -> Result<f64, Diagnostic> {
    within(text, Quantity::LengthSd.range().from(POSITIVE))
}

/// The largest probability of a wrong decision.
pub(super) fn risk(text: &str) -> Result<f64, Diagnostic> {
    of(text, Quantity::DecisionRisk)
}

/// A thermal expansion, 1/K.
pub(super) fn expansion(text: &str) -> Result<f64, Diagnostic> {
    of(text, Quantity::Expansion)
}

/// The temperature of a bar's certificate, degrees Celsius.
pub(super) fn certified(text: &str) -> Result<f64, Diagnostic> {
    of(text, Quantity::CertificateTemperature)
}

/// The number of Monte Carlo draws, or 0. Fewer than 50 give no 95 % interval.
pub(super) fn draws(text: &str) -> Result<usize, CliFinding> {
    const MIN_DRAWS: usize = 50;
    const MAX_DRAWS: usize = 1_000_000;
    let refusal = CliFinding::NotDraws { least: MIN_DRAWS, most: MAX_DRAWS };
    text.parse().ok().filter(|draws| *draws == 0 || (MIN_DRAWS..=MAX_DRAWS).contains(draws)).ok_or(refusal)
}

pub(super) fn seconds(text: &str) -> Result<f64, CliFinding> {
    number(text, |s| s >= 0.0, CliFinding::NotSeconds)
}

/// The interval of --sync-every, s.
pub(super) fn sync_seconds(text: &str) -> Result<f64, Diagnostic> {
    of(text, Quantity::SyncInterval)
}

/// How long a worker of the archive may be silent, s.
pub(super) fn lease(text: &str) -> Result<f64, Diagnostic> {
    of(text, Quantity::WorkerLease)
}

/// The interval between two checks of a robot, days.
pub(super) fn interval(text: &str) -> Result<f64, Diagnostic> {
    of(text, Quantity::CheckInterval)
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
pub(super) fn tool_ball(text: &str) -> Result<[f64; 3], Diagnostic> {
    let place: [f64; 3] = numbers(text).ok_or(EstimationFinding::NotAPoint)?;
    let largest_mm = place.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
    if largest_mm > 0.0 {
        Quantity::ToolBallDistance.check(ValueKey::NONE, largest_mm)?;
    }
    Ok(place)
}

/// The place of a tool: X,Y,Z, or a whole frame, whose turn does not move it.
pub(super) fn tool(text: &str) -> Result<[f64; 3], Diagnostic> {
    match text.matches(',').count() {
        5 => frame(text).map(|[x, y, z, ..]| [x, y, z]),
        _ => tool_ball(text),
    }
}

/// Axis angles A1,..,A6 in degrees.
pub(super) fn six_angles(text: &str) -> Result<[f64; 6], Diagnostic> {
    numbers(text).ok_or_else(|| CompensationFinding::NotAxisAngles.into())
}

/// A pose A1,..,A6=X,Y,Z or A1,..,A6=X,Y,Z,A,B,C in degrees and mm.
pub(super) fn pendant_pose(text: &str) -> Result<PendantPose, Diagnostic> {
    let pose = text.split_once('=').and_then(|(axes, place)| {
        let axes_deg = numbers(axes)?;
        let of_six = || numbers(place).map(|[x, y, z, a, b, c]| ([x, y, z], Some([a, b, c])));
        let (xyz_mm, abc_deg) = numbers(place).map(|xyz_mm| (xyz_mm, None)).or_else(of_six)?;
        Some(PendantPose { axes_deg, xyz_mm, abc_deg })
    });
    pose.ok_or_else(|| DescriptionFinding::NoPendantPose.into())
}

/// A frame X,Y,Z,A,B,C in mm and degrees.
pub(super) fn frame(text: &str) -> Result<[f64; 6], Diagnostic> {
    let frame: [f64; 6] = numbers(text).ok_or(CompensationFinding::NotAFrame)?;
    let [_, _, _, a, b, c] = frame;
    [a, b, c].into_iter().try_for_each(|angle| Quantity::FrameAngle.check(ValueKey::NONE, angle))?;
    Ok(frame)
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

/// A run, and after the last colon the rows of it.
pub(super) fn run_rows(text: &str) -> Result<(PathBuf, RepeatedRows), String> {
    // A path may have a colon itself, as a drive of Windows.
    if Path::new(text).exists() {
        return Ok((text.into(), RepeatedRows::All));
    }
    match text.rsplit_once(':') {
        Some((run, rows)) => Ok((run.into(), rows.parse()?)),
        None => Ok((text.into(), RepeatedRows::All)),
    }
}
