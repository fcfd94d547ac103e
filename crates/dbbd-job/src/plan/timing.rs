//! The durations of moves, and the time code, which makes all intervals between dwells different.
//!
//! The controller ramps each motion up and down with constant acceleration: over a distance d at speed v and acceleration a
//! it takes d/v + v/a. The ball's path and the orientation have a ramp each; the slower one sets the duration. Both speeds
//! of a row are chosen for the same duration.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::path::ToolBallPath;
use super::{MotionTable, MoveTime, PlanRow, PoseKind};
use dbbd_model::robot::{AXES, Robot};

/// Acceleration of the ball along its path ($ACC.CP), mm/s^2.
pub const ACCELERATION_MM_S2: f64 = 200.0;
/// Acceleration of the orientation ($ACC.ORI1, $ACC.ORI2), degrees/s^2.
pub const ACCELERATION_DEG_S2: f64 = 100.0;
/// Share of the axis speeds in a PTP motion, percent.
pub const PTP_SPEED_PERCENT: f64 = 10.0;
/// Share of the axis accelerations in a PTP motion, percent.
pub const PTP_ACCELERATION_PERCENT: f64 = 20.0;
/// Wait after the strobe falls, s.
pub const AFTER_STROBE_S: f64 = 0.1;

/// Share of the axis speeds that a coded move may use: the axes of the true robot move differently.
const AXIS_SHARE: f64 = 0.5;
/// Shortest coded move, and the range of the durations, s.
const SHORTEST_S: f64 = 0.8;
const SPREAD_S: f64 = 2.2;
/// Least difference between the durations of the moves into a module's dwells, s.
const APART_S: f64 = 0.005;
/// A smaller motion (mm, degrees) is the rounding of printed poses.
const STILL: f64 = 0.01;
/// Speed of a sync marker, mm/s: slow enough for the stream of a slow bar.
pub(crate) const MARKER_MM_S: f64 = 1.0;

/// Duration of a motion over `distance` at `speed` with ramps of `acceleration`, s; any unit of length or angle.
pub fn ramped_s(distance: f64, speed: f64, acceleration: f64) -> f64 {
    if distance <= 0.0 {
        0.0
    } else if speed * speed >= distance * acceleration {
        2.0 * (distance / acceleration).sqrt()
    } else {
        distance / speed + speed / acceleration
    }
}

/// The speed at which `distance` takes `duration`; `None` if the ramps alone take longer.
fn speed_for(distance: f64, duration: f64, acceleration: f64) -> Option<f64> {
    let ramp = acceleration * duration;
    let root = ramp * ramp - 4.0 * acceleration * distance;
    // The smaller root, without cancellation.
    (root >= 0.0 && ramp > 0.0).then(|| 2.0 * acceleration * distance / (ramp + root.sqrt()))
}

/// A path with the derivatives of the axis angles along it, by the share of the path from 0 to 1.
pub(crate) struct PathTiming {
    pub(crate) path: ToolBallPath,
    /// Largest first derivative of an axis over its greatest speed, s.
    pub(crate) axis_s: f64,
    /// Largest first and second derivative of an axis over its greatest acceleration, s^2.
    pub(crate) slope_s2: f64,
    pub(crate) bend_s2: f64,
}

/// Speeds and durations of all rows. `paces` has the motion into each row; `None` for auxiliary points and for the first row,
/// which is reached from wherever the robot is.
pub(crate) fn move_times(
    rows: &[PlanRow],
    paces: &[Option<PathTiming>],
    motion: &MotionTable,
    robot: &Robot,
    seed: u64,
) -> Vec<MoveTime> {
    let dwells = rows.iter().filter(|row| row.dwell_s > 0.0).count();
    let mut code = code(dwells, seed).into_iter();
    let mut taken: Vec<(u32, f64)> = Vec::with_capacity(dwells);
    let mut times = Vec::with_capacity(rows.len());
    for (row, pace) in rows.iter().zip(paces) {
        let still = MoveTime {
            index: row.index,
            feed_mm_s: motion.feed_mm_s,
            turn_deg_s: motion.turn_deg_s,
            axis_percent: PTP_SPEED_PERCENT,
            duration_s: 0.0,
        };
        let Some(pace) = pace else {
            times.push(still);
            continue;
        };
        if let ToolBallPath::Axes { from, to } = &pace.path {
            times.push(MoveTime { duration_s: axes_s(robot, from, to), ..still });
            continue;
        }
        if row.kind == PoseKind::Transit {
            let feed = if is_marker(&pace.path) { MARKER_MM_S } else { motion.feed_mm_s };
            times.push(paced(still, pace, feed, motion.turn_deg_s, None));
            continue;
        }
        let fastest = paced(still, pace, motion.feed_mm_s, motion.turn_deg_s, None);
        let mut wanted = fastest.duration_s.max(SHORTEST_S) + code.next().unwrap_or(0.0);
        while taken.iter().any(|(circle, s)| *circle == row.circle && (s - wanted).abs() < APART_S) {
            wanted += APART_S;
        }
        taken.push((row.circle, wanted));
        times.push(paced(still, pace, motion.feed_mm_s, motion.turn_deg_s, Some(wanted)));
    }
    times
}

/// A radial marker is the only move of less than a millimetre.
fn is_marker(path: &ToolBallPath) -> bool {
    matches!(path, ToolBallPath::Line { .. }) && path.length_mm() < 1.0
}

/// What is added to the shortest duration of the move into each dwell: equally spaced values in random order, so that all
/// differ and no sequence repeats.
fn code(count: usize, seed: u64) -> Vec<f64> {
    let mut extra: Vec<f64> = (0..count).map(|i| SPREAD_S * (i as f64 + 0.5) / count as f64).collect();
    let mut rng = Pcg64::seed_from_u64(seed);
    for i in (1..count).rev() {
        extra.swap(i, rng.random_range(0..=i));
    }
    extra
}

/// The speeds of a line or arc: at most `feed` and `turn`, the axes within their share, with a duration of `wanted` seconds if
/// it is given.
fn paced(still: MoveTime, pace: &PathTiming, feed: f64, turn: f64, wanted: Option<f64>) -> MoveTime {
    let (distance, angle) = (pace.path.length_mm(), pace.path.turn_deg());
    // Shares of the path per second within the limits of feed, orientation and axes.
    let allowed = |speed: f64, whole: f64| if whole > STILL { speed / whole } else { f64::INFINITY };
    let rate = allowed(feed, distance).min(allowed(turn, angle)).min(allowed(AXIS_SHARE, pace.axis_s));
    let chosen = |limit: f64, whole: f64, acceleration: f64| {
        let fastest = if rate.is_finite() { limit.min(rate * whole) } else { limit };
        let coded = wanted.and_then(|duration| speed_for(whole, duration, acceleration)).unwrap_or(fastest);
        // As KRL prints it, and never below a hundredth; a part at rest keeps the limit.
        if whole > STILL { (coded.min(fastest) * 1e3).round().max(10.0) / 1e3 } else { limit }
    };
    let feed_mm_s = chosen(feed, distance, ACCELERATION_MM_S2);
    let turn_deg_s = chosen(turn, angle, ACCELERATION_DEG_S2);
    let duration_s = line_s(distance, angle, feed_mm_s, turn_deg_s);
    MoveTime { feed_mm_s, turn_deg_s, duration_s, ..still }
}

/// Duration of a line or arc over `distance` mm and `angle` degrees at the speeds given, s.
pub fn line_s(distance: f64, angle: f64, feed_mm_s: f64, turn_deg_s: f64) -> f64 {
    ramped_s(distance, feed_mm_s, ACCELERATION_MM_S2).max(ramped_s(angle, turn_deg_s, ACCELERATION_DEG_S2))
}

/// Duration of a PTP motion between axis angles in rad, s: that of the slowest axis.
pub fn axes_s(robot: &Robot, from: &[f64; AXES], to: &[f64; AXES]) -> f64 {
    let acceleration = robot.acceleration_deg_s2();
    (0..AXES)
        .map(|i| {
            let speed = robot.max_speed_deg_s[i] * PTP_SPEED_PERCENT / 100.0;
            let ramp = acceleration[i] * PTP_ACCELERATION_PERCENT / 100.0;
            ramped_s((to[i] - from[i]).abs().to_degrees(), speed, ramp)
        })
        .fold(0.0, f64::max)
}
