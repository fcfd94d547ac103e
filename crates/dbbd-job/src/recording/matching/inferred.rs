//! Dwells that are too faint to be detected, but whose time is known.
//!
//! If a move hardly changes the length, two dwells look like one. If the time between the certain dwells on both sides
//! is the time that the program needs, the program did not pause, and the times of the poses between them are known.

use super::alignment::{MIN_PAIR_POSTERIOR, Pairing, PoseAlignment, SLACK, interval_variance_s2};
use super::program::{AFTER_S, CommandedTimes, DwellInterval, DwellPoses, ElapsedTime, ProgramPace};
use crate::recording::dwell::{Dwell, reading_between};
use crate::recording::stream::SampleStream;

/// Largest residual of the interval between the certain dwells, and largest standard deviation of their starts, s.
const AGREES_S: f64 = 0.25;
const BEGIN_KNOWN_S: f64 = 0.15;
/// Time kept clear of the end of a dwell, s, because its start is known no better.
const MARGIN_S: f64 = 0.15;
/// Most inferred poses in a row; a longer row would be dead reckoning.
const MAX_INFERRED_IN_A_ROW: usize = 4;

#[derive(Clone, Copy)]
struct CertainDwell {
    pose: usize,
    dwell: Dwell,
    posterior: f64,
}

/// The time between two certain dwells that the program took without a pause.
struct BridgedInterval {
    interval: DwellInterval,
    residual_s: f64,
    posterior: f64,
}

/// Pairs poses without a dwell with the time at which the program was there, if the reading was still then.
pub(super) fn infer(
    poses: &DwellPoses<'_>,
    dwells: &mut Vec<Dwell>,
    alignment: &mut PoseAlignment,
    stream: &SampleStream,
    settle_s: f64,
) {
    let program = &poses.program;
    let pace = ProgramPace { stretch: 1.0 / alignment.override_factor, slack: SLACK };
    let certain: Vec<CertainDwell> = alignment
        .pairings
        .iter()
        .enumerate()
        .filter_map(|(pose, pairing)| {
            if let Pairing::Dwell { dwell, posterior } = *pairing {
                Some(CertainDwell { pose, dwell: *dwells.get(dwell)?, posterior })
            } else {
                None
            }
        })
        .filter(|certain| certain.dwell.start_sd_s < BEGIN_KNOWN_S)
        .collect();
    for pair in certain.windows(2) {
        let (from, to) = (pair[0], pair[1]);
        let Some(bridge) = bridge(program, pace, [from, to], stream) else { continue };
        for pose in from.pose + 1..to.pose {
            if matches!(alignment.pairings[pose], Pairing::Dwell { .. }) {
                continue;
            }
            // The residual is distributed in proportion to the moves.
            let move_s = program.interval(from.pose, pose, ElapsedTime::default()).move_s;
            let whole_s = bridge.interval.move_s;
            let share = if whole_s > 0.0 { move_s / whole_s } else { 0.0 };
            let start_s =
                from.dwell.start_s + program.takes_s(from.pose, pose, pace) + share * bridge.residual_s;
            let end_s = start_s + poses.commanded[pose].wait_s;
            let dwell = Dwell {
                settled_s: start_s + settle_s.max(MARGIN_S),
                until_s: end_s - MARGIN_S - AFTER_S,
                ..Dwell::whole(start_s, end_s, BEGIN_KNOWN_S)
            };
            let reading = reading_between(stream, dwell.settled_s, dwell.until_s);
            if reading.is_some_and(|reading| reading.creep_mm.is_none()) {
                dwells.push(dwell);
                let posterior = bridge.posterior;
                alignment.pairings[pose] = Pairing::Dwell { dwell: dwells.len() - 1, posterior };
            }
        }
    }
}

fn bridge(
    program: &CommandedTimes,
    pace: ProgramPace,
    [from, to]: [CertainDwell; 2],
    stream: &SampleStream,
) -> Option<BridgedInterval> {
    let elapsed = ElapsedTime {
        seen_s: to.dwell.start_s - from.dwell.start_s,
        variance_s2: interval_variance_s2([from, to].map(|certain| certain.dwell.start_sd_s)),
        clock_broke: stream.broken_between(from.dwell.start_s, to.dwell.start_s),
    };
    let interval = program.interval(from.pose, to.pose, elapsed);
    let residual_s = interval.residual_s(pace);
    // Both neighbours belong to their poses, and the program did not pause between them. An error of a detected start
    // does not change the pose if the interval agrees.
    let posterior = from.posterior * to.posterior * interval.unpaused(pace);
    let off = interval.by_hand || interval.passed > MAX_INFERRED_IN_A_ROW || residual_s.abs() > AGREES_S;
    (!off && posterior > MIN_PAIR_POSTERIOR).then_some(BridgedInterval { interval, residual_s, posterior })
}
