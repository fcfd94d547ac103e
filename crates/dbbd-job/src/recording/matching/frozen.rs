//! A frozen bar: its reading stays equal to the last digit although the robot moves.

use std::ops::Range;

use super::outcome::PoseOutcome;
use crate::recording::dwell::DwellReading;
use crate::recording::matching::MatchingFinding;
use crate::recording::stream::SampleStream;
use dbbd_model::math::robust::median;

/// Least number of dwells that show whether the reading changes at rest, and between dwells.
const MIN_DWELLS: usize = 5;
/// Share of other dwells, or of moves between them, within which the reading changes if the bar does not freeze.
const ALIVE: f64 = 0.95;
/// Longest constant reading of a bar whose reading changes at rest, in dwells,
const DWELLS: f64 = 5.0;
/// and of a coarse bar, in poses.
const MAX_CONSTANT_POSES: usize = 3;

/// The longest interval of constant reading that holds the motion between two poses, unless the scale of the bar
/// is so coarse that such intervals are usual.
pub(super) fn detect_frozen_reading(
    stream: &SampleStream,
    outcomes: &[PoseOutcome],
) -> Option<MatchingFinding> {
    let longest = longest(stream)?;
    let (from_s, to_s) = (stream.t_s[longest.start], stream.t_s[longest.end - 1]);
    let is_within = |pose: &&PoseOutcome| {
        pose.reading().is_some_and(|reading| reading.to_s > from_s && reading.from_s < to_s)
    };
    let read = outcomes.iter().filter(is_within).count();
    // Poses without a reading count between neighbours with one; before the first and after the last the bar is off.
    let before =
        outcomes.iter().rposition(|pose| pose.reading().is_some_and(|reading| reading.to_s <= from_s));
    let after = outcomes.iter().position(|pose| pose.reading().is_some_and(|reading| reading.from_s >= to_s));
    let between = before.zip(after).and_then(|(before, after)| outcomes.get(before + 1..after));
    let poses = between.map_or(read, <[PoseOutcome]>::len);
    let others: Vec<&DwellReading> =
        outcomes.iter().filter(|pose| !is_within(pose)).filter_map(PoseOutcome::reading).collect();
    if others.len() < MIN_DWELLS {
        return None;
    }
    let changes = |from_s: f64, to_s: f64| !is_constant(stream, stream.at(from_s)..stream.at(to_s));
    let at_rest = others.iter().filter(|dwell| changes(dwell.from_s, dwell.to_s)).count();
    let moved = others.windows(2).filter(|pair| changes(pair[0].from_s, pair[1].to_s)).count();
    let dwell_s = median(&mut others.iter().map(|dwell| dwell.to_s - dwell.from_s).collect::<Vec<_>>())?;
    let is_alive = |count: usize, of: usize| count as f64 >= ALIVE * of as f64;
    let is_frozen = if is_alive(at_rest, others.len()) {
        poses >= 2 && to_s - from_s > DWELLS * dwell_s
    } else {
        read >= MAX_CONSTANT_POSES && is_alive(moved, others.len() - 1)
    };
    is_frozen.then(|| MatchingFinding::Frozen {
        from_s,
        to_s,
        poses,
        reading_mm: stream.reading_mm[longest.start],
    })
}

/// The longest run of equal valid samples.
fn longest(stream: &SampleStream) -> Option<Range<usize>> {
    let count = stream.reading_mm.len();
    let equal = |at: usize| stream.valid(at) && stream.reading_mm[at] == stream.reading_mm[at - 1];
    let (mut start, mut longest) = (0, 0..0);
    let lasts_s = |range: &Range<usize>| stream.t_s[range.end - 1] - stream.t_s[range.start];
    for end in 1..=count {
        if end < count && equal(end) {
            continue;
        }
        if stream.valid(start) && (longest.is_empty() || lasts_s(&(start..end)) > lasts_s(&longest)) {
            longest = start..end;
        }
        start = end;
    }
    (longest.len() > 2).then_some(longest)
}

fn is_constant(stream: &SampleStream, samples: Range<usize>) -> bool {
    let readings = stream.reading_mm.get(samples).unwrap_or_default();
    readings.windows(2).all(|pair| pair[0] == pair[1])
}
