//! Dwells that were too faint to be seen, but whose time is known.
//!
//! Where a move hardly changes the length, two dwells look like one. If the time between the certain
//! dwells on either side is just what the program takes, it did not pause in between, and then it says
//! when the robot stood at the poses between.

use super::Candidate;
use super::align::{Alignment, KEEP, Pairing};
use super::commanded::Poses;
use super::dwell::measure;
use super::interval::{Interval, Pace, Program};
use super::lattice::SLACK;
use super::seen::{LEAST_START_SD_S, Stretch};
use super::stream::Stream;

/// The interval between the certain dwells must be commanded up to this, s; their begins to this each, s.
const AGREES_S: f64 = 0.25;
const BEGIN_KNOWN_S: f64 = 0.15;
/// Kept free at the end of a dwell whose begin is known no better, s.
const MARGIN_S: f64 = 0.15;
/// At most so many poses in one row: a short look back, not dead reckoning.
const MOST: usize = 4;

/// Pairs poses without a dwell with the time at which the program must have stood there, where the
/// reading then was still.
pub(super) fn unseen(
    poses: &Poses<'_>,
    candidates: &mut Vec<Candidate>,
    alignment: &mut Alignment,
    stream: &Stream,
    settle_s: f64,
) {
    let program = Program::new(&poses.commanded);
    let pace = Pace { stretch: 1.0 / alignment.override_factor, slack: SLACK };
    let certain: Vec<(usize, Stretch, f64)> = alignment
        .pairings
        .iter()
        .enumerate()
        .filter_map(|(pose, pairing)| match *pairing {
            Pairing::Dwell { dwell, posterior } => Some((pose, candidates.get(dwell)?.stretch, posterior)),
            _ => None,
        })
        .filter(|(_, stretch, _)| stretch.start_sd_s < BEGIN_KNOWN_S)
        .collect();
    for pair in certain.windows(2) {
        let [(from, before, p), (to, after, q)] = [pair[0], pair[1]];
        let broken = stream.broken_between(before.start_s, after.start_s);
        let seen_s = after.start_s - before.start_s;
        let variance_s2: f64 =
            [before, after].iter().map(|stretch| stretch.start_sd_s.max(LEAST_START_SD_S).powi(2)).sum();
        let whole = program.interval(from, to, seen_s, variance_s2, broken);
        let residual_s = whole.residual_s(pace);
        // Both neighbours are theirs, and the program did not pause between them. A begin that was seen
        // wrongly does not make the pose another one, so long as the interval agrees.
        let posterior = p * q * whole.unpaused(pace);
        let off = whole.by_hand || to - from - 1 > MOST || residual_s.abs() > AGREES_S;
        if off || posterior <= KEEP {
            continue;
        }
        for pose in from + 1..to {
            if matches!(alignment.pairings[pose], Pairing::Dwell { .. }) {
                continue;
            }
            let part: Interval = program.interval(from, pose, 0.0, 0.0, false);
            // What is left over is shared out in proportion to the moves.
            let share = if whole.move_s > 0.0 { part.move_s / whole.move_s } else { 0.0 };
            let start_s = before.start_s - part.residual_s(pace) + share * residual_s;
            let commanded = poses.commanded[pose];
            let stretch = Stretch { start_s, end_s: start_s + commanded.wait_s, start_sd_s: BEGIN_KNOWN_S };
            let from_s = start_s + settle_s.max(MARGIN_S);
            let to_s = stretch.end_s - MARGIN_S - super::commanded::AFTER_S;
            if measure(stream, from_s, to_s).is_some_and(|dwell| dwell.creep_mm.is_none()) {
                candidates.push(Candidate { stretch, from_s, to_s });
                alignment.pairings[pose] = Pairing::Dwell { dwell: candidates.len() - 1, posterior };
            }
        }
    }
}
