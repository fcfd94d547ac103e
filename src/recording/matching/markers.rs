//! Sync markers: short moves out and back, whose change of the length is commanded. The robot's errors hardly change over them, so
//! they show the sign and the scale of the readings.

use super::outcome::PoseOutcome;
use super::program::AFTER_S;
use crate::catalogue::MatchingFinding;
use crate::math::robust::median;
use crate::plan::{Motion, Plan, PlanRow};
use crate::recording::dwell::DwellReading;
use crate::recording::stream::Stream;

/// Shorter ones are not judged, mm.
const LEAST_MM: f64 = 0.1;
/// Fewer show no scale.
const FEWEST: usize = 2;
/// What a slow bar, a peak in its noise and the robot's errors leave of measured over commanded,
const SOUND: f64 = 0.05;
/// and four standard deviations of what the robot does not repeat, of one marker.
const UNREPEATED: f64 = 0.28;
/// Where the ratios differ by more, something else moves the bar.
const ALIKE: f64 = 0.25;
/// Of the farthest readings the first so many may be noise.
const SPIKES: usize = 3;
/// Longest period of samples that follow a marker, s.
const SLOWEST_S: f64 = 0.05;

/// That the reading changes otherwise than commanded at the markers behind the last dwells of the modules.
pub(super) fn scale(
    plan: &Plan,
    stream: &Stream,
    outcomes: &[PoseOutcome],
    override_factor: f64,
) -> Option<MatchingFinding> {
    if !(stream.period_s() > 0.0 && stream.period_s() < SLOWEST_S) {
        return None;
    }
    let behind = |pose: &PoseOutcome| {
        let (at, dwell) = ((pose.index as usize).checked_sub(1)?, pose.reading()?);
        let Markers { out_mm, rows } = markers(plan, at)?;
        let moves = plan.header.moves.get(at + 1..at + 1 + rows)?;
        let takes_s = AFTER_S + moves.iter().map(|time| time.duration_s).sum::<f64>() / override_factor;
        Some((out_mm, farthest(stream, dwell, takes_s)?))
    };
    let found: Vec<(f64, f64)> = outcomes.iter().filter_map(behind).collect();
    let mut ratios: Vec<f64> = found.iter().map(|(out_mm, measured_mm)| measured_mm / out_mm).collect();
    if ratios.len() < FEWEST {
        return None;
    }
    let ratio = median(&mut ratios)?;
    let apart = median(&mut ratios.iter().map(|one| (one - ratio).abs()).collect::<Vec<_>>())?;
    let is_sound = (ratio - 1.0).abs() < SOUND + UNREPEATED / (ratios.len() as f64).sqrt();
    let commanded_mm = found[0].0;
    (!is_sound && apart < ALIKE * ratio.abs().max(ALIKE)).then_some(MatchingFinding::MarkerScale {
        markers: found.len(),
        commanded_mm,
        measured_mm: ratio * commanded_mm,
    })
}

/// Markers behind a row.
struct Markers {
    /// By how much the length grows, mm.
    out_mm: f64,
    rows: usize,
}

/// The moves out and back behind the row at a place.
fn markers(plan: &Plan, at: usize) -> Option<Markers> {
    let (row, next) = (plan.rows.get(at)?, plan.rows.get(at + 1)?);
    let out_mm = next.length_mm - row.length_mm;
    let is_marker = |next: &&PlanRow| {
        let off_mm = (next.length_mm - row.length_mm) / out_mm;
        next.motion == Motion::Lin
            && next.dwell_s == 0.0
            && (off_mm.abs() < 0.1 || (off_mm - 1.0).abs() < 0.1)
    };
    let rows = plan.rows[at + 1..].iter().take_while(is_marker).count();
    (out_mm.abs() >= LEAST_MM && rows >= 2).then_some(Markers { out_mm, rows })
}

/// The reading farthest from that of a dwell in so many seconds after it, from there, mm.
fn farthest(stream: &Stream, dwell: &DwellReading, takes_s: f64) -> Option<f64> {
    let range = stream.at(dwell.to_s)..stream.at(dwell.to_s + takes_s);
    let valid = range.filter(|&at| stream.valid(at));
    let mut off: Vec<f64> = valid.map(|at| stream.reading_mm[at] - dwell.reading_mm).collect();
    off.sort_by(|a, b| b.abs().total_cmp(&a.abs()));
    off.get(SPIKES).copied()
}
