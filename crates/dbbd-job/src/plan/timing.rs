//! The durations of moves, and the time code, which makes all intervals between dwells different.
//!
//! The controller ramps each motion up and down with constant acceleration: over a distance d at speed v and acceleration a
//! it takes d/v + v/a. The ball's path and the orientation have a ramp each; the slower one sets the duration. Both speeds
//! of a row are chosen for the same duration.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use super::path::ToolBallPath;
use super::{MotionTable, PathTiming, PlanRow, PoseKind};
use dbbd_model::robot::{AXES, Robot};

/// Acceleration of the ball along its path ($ACC.CP), mm/s^2.
pub const ACCELERATION_MM_S2: f64 = 200.0;
/// Acceleration of the orientation ($ACC.ORI1, $ACC.ORI2), degrees/s^2.
pub const ACCELERATION_DEG_S2: f64 = 100.0;
/// Share of the axis speeds in a PTP motion, percent.
const PTP_SPEED_PERCENT: f64 = 10.0;
/// Share of the axis accelerations in a PTP motion, percent.
pub const PTP_ACCELERATION_PERCENT: f64 = 20.0;
/// Wait after the strobe falls, s.
pub const AFTER_STROBE_S: f64 = 0.1;

/// Share of the axis speeds that a coded move may use: the axes of the true robot move at other speeds.
const AXIS_SHARE: f64 = 0.5;
/// Shortest coded move, and the range of the durations, s.
const SHORTEST_S: f64 = 0.8;
pub(crate) const SPREAD_S: f64 = 2.2;
/// Minimum number of dwells of a plan whose time code distinguishes its program from any other program: each of the eleven
/// intervals makes the right code some eight times as likely as another one, which gives odds of 10^9 (`cargo test
/// few_dwells_show`).
pub(crate) const MIN_CODED_DWELLS: usize = 12;
/// Least difference between the durations of the moves to the dwells of a module, s.
const APART_S: f64 = 0.005;
/// A smaller motion (mm, degrees) is only the rounding of printed poses.
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

/// The speed at which `distance` takes the time `duration`; `None` if the ramps alone take longer.
fn speed_for(distance: f64, duration: f64, acceleration: f64) -> Option<f64> {
    let ramp = acceleration * duration;
    let root = ramp * ramp - 4.0 * acceleration * distance;
    // The smaller root, computed without cancellation.
    (root >= 0.0 && ramp > 0.0).then(|| 2.0 * acceleration * distance / (ramp + root.sqrt()))
}

/// The time code: speeds and duration of a row's move, chosen so that all intervals between dwells differ.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MoveTime {
    pub index: u32,
    /// Speed of the ball along its path, mm/s (LIN, CIRC).
    pub feed_mm_s: f64,
    /// Speed of the orientation, degrees/s (LIN, CIRC).
    pub turn_deg_s: f64,
    /// Share of the greatest axis speeds, percent (PTP).
    pub axis_percent: f64,
    /// Duration of the move from the last pose to this one at full override, s.
    pub duration_s: f64,
}

/// Speeds and durations of all rows. `paces` has the motion into each row; `None` for auxiliary points and for the
/// first row, which is reached from any pose. The code is drawn from `pose_hash`, so that a program with other poses
/// has another code.
pub(super) fn move_times(
    rows: &[PlanRow],
    paces: &[Option<PathTiming>],
    motion: &MotionTable,
    robot: &Robot,
    pose_hash: u64,
) -> Vec<MoveTime> {
    let dwells = rows.iter().filter(|row| row.dwell_s > 0.0).count();
    let mut code = code(dwells, pose_hash).into_iter();
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

/// Whether the path is a radial marker, the only move of less than a millimetre.
fn is_marker(path: &ToolBallPath) -> bool {
    matches!(path, ToolBallPath::Line { .. }) && path.length_mm() < 1.0
}

/// The times that are added to the shortest duration of the move to each dwell: equally spaced values in random order,
/// so that all differ and no sequence repeats.
fn code(count: usize, seed: u64) -> Vec<f64> {
    let mut extra: Vec<f64> = (0..count).map(|i| SPREAD_S * (i as f64 + 0.5) / count as f64).collect();
    let mut rng = Pcg64::seed_from_u64(seed);
    for i in (1..count).rev() {
        extra.swap(i, rng.random_range(0..=i));
    }
    extra
}

/// The speeds of a line or arc: at most `feed` and `turn`, the axes within their share. If `wanted` is given, the
/// motion takes this time, s.
fn paced(still: MoveTime, pace: &PathTiming, feed: f64, turn: f64, wanted: Option<f64>) -> MoveTime {
    let (distance, angle) = (pace.path.length_mm(), pace.path.turn_deg());
    // Greatest share of the path per second within the limits of feed, orientation and axes.
    let allowed = |speed: f64, whole: f64| if whole > STILL { speed / whole } else { f64::INFINITY };
    let rate = allowed(feed, distance).min(allowed(turn, angle)).min(allowed(AXIS_SHARE, pace.axis_s));
    let chosen = |limit: f64, whole: f64, acceleration: f64| {
        let fastest = if rate.is_finite() { limit.min(rate * whole) } else { limit };
        let coded = wanted.and_then(|duration| speed_for(whole, duration, acceleration)).unwrap_or(fastest);
        // The speed as KRL prints it, and never below a hundredth; a part at rest keeps the limit.
        if whole > STILL { (coded.min(fastest) * 1e3).round().max(10.0) / 1e3 } else { limit }
    };
    let feed_mm_s = chosen(feed, distance, ACCELERATION_MM_S2);
    let turn_deg_s = chosen(turn, angle, ACCELERATION_DEG_S2);
    let duration_s = line_s(distance, angle, feed_mm_s, turn_deg_s);
    MoveTime { feed_mm_s, turn_deg_s, duration_s, ..still }
}

/// Duration of a line or arc over `distance` mm and `angle` degrees at the speeds given, s.
fn line_s(distance: f64, angle: f64, feed_mm_s: f64, turn_deg_s: f64) -> f64 {
    ramped_s(distance, feed_mm_s, ACCELERATION_MM_S2).max(ramped_s(angle, turn_deg_s, ACCELERATION_DEG_S2))
}

/// Duration of a PTP motion between axis angles in rad, s: the duration of the slowest axis.
fn axes_s(robot: &Robot, from: &[f64; AXES], to: &[f64; AXES]) -> f64 {
    let acceleration = robot.acceleration_deg_s2();
    (0..AXES)
        .map(|i| {
            let speed = robot.max_speed_deg_s[i] * PTP_SPEED_PERCENT / 100.0;
            let ramp = acceleration[i] * PTP_ACCELERATION_PERCENT / 100.0;
            ramped_s((to[i] - from[i]).abs().to_degrees(), speed, ramp)
        })
        .fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::MotionKind;
    use crate::plan::example::{robot, row};
    use dbbd_model::robot::Pose;

    fn assert_near(found: f64, expected: f64) {
        assert!((found - expected).abs() < 1e-9 * expected.abs().max(1.0), "{found}, not {expected}");
    }

    /// A line along X of this length with a turn about Z, whose axes set no limit.
    fn line(length_mm: f64, turn_deg: f64) -> PathTiming {
        let from = Pose::from_kuka([0.0; 3], [0.0; 3]);
        let to = Pose::from_kuka([length_mm, 0.0, 0.0], [turn_deg, 0.0, 0.0]);
        PathTiming { path: ToolBallPath::Line { from, to }, axis_s: 0.0, slope_s2: 0.0, bend_s2: 0.0 }
    }

    /// d = v^2 / a is lost and won in the ramps: d / v + v / a, or 2 sqrt(d / a) where full speed is not reached.
    #[test]
    fn motion_has_two_ramps() {
        for (distance, speed, acceleration, duration) in [
            (100.0, 20.0, 10.0, 7.0),
            (40.0, 20.0, 10.0, 4.0),
            (10.0, 20.0, 10.0, 2.0),
            (90.0, 40.0, 100.0, 2.65),
            (0.0, 20.0, 10.0, 0.0),
        ] {
            assert_near(ramped_s(distance, speed, acceleration), duration);
        }
    }

    #[test]
    fn speed_gives_the_duration_that_was_wanted() {
        assert_near(speed_for(100.0, 7.0, 10.0).expect("there is time"), 20.0);
        assert_near(speed_for(40.0, 4.0, 10.0).expect("there is just time"), 20.0);
        assert_eq!(speed_for(40.0, 3.99, 10.0), None);
        let speed = speed_for(80.0, 3.1, ACCELERATION_MM_S2).expect("there is time");
        assert_near(ramped_s(80.0, speed, ACCELERATION_MM_S2), 3.1);
    }

    /// The accelerations are 200 mm/s^2 and 100 degrees/s^2.
    #[test]
    fn slower_one_of_path_and_orientation_sets_the_duration() {
        assert_near(line_s(100.0, 10.0, 40.0, 40.0), 100.0 / 40.0 + 40.0 / 200.0);
        assert_near(line_s(10.0, 90.0, 40.0, 40.0), 90.0 / 40.0 + 40.0 / 100.0);
    }

    /// The KR 60: axis 1 has 128 degrees/s, of which 10 % are 12.8, and no acceleration in its file: the full speed in 0.4 s,
    /// 320 degrees/s^2, of which 20 % are 64. Axis 3 has the same, axis 2 102 degrees/s.
    #[test]
    fn slowest_axis_sets_the_duration_of_a_motion_of_the_axes() {
        let turned = |deg: [f64; AXES]| axes_s(&robot(), &[0.1; AXES], &deg.map(|d| 0.1 + d.to_radians()));
        assert_near(turned([30.0, 0.0, 0.0, 0.0, 0.0, 0.0]), 30.0 / 12.8 + 12.8 / 64.0);
        assert_near(turned([-30.0, 30.0, 29.0, 0.0, 0.0, 0.0]), 30.0 / 10.2 + 10.2 / 51.0);
        let mut quick = robot();
        quick.max_acceleration_deg_s2[0] = Some(32.0);
        assert_near(axes_s(&quick, &[0.0; AXES], &[0.5, 0.0, 0.0, 0.0, 0.0, 0.0]), {
            let half_rad_deg = 0.5_f64.to_degrees();
            half_rad_deg / 12.8 + 12.8 / 6.4
        });
    }

    /// 2.2 s are divided into four parts, whose middles are 0.275, 0.825, 1.375 and 1.925 s.
    #[test]
    fn time_code_is_equally_spaced_and_shuffled() {
        let mut sorted = code(4, 7);
        sorted.sort_by(f64::total_cmp);
        for (found, expected) in sorted.iter().zip([0.275, 0.825, 1.375, 1.925]) {
            assert_near(*found, expected);
        }
        assert_eq!(code(50, 7), code(50, 7));
        assert_ne!(code(50, 7), code(50, 8));
        let ascending = code(50, 7).windows(2).filter(|pair| pair[0] < pair[1]).count();
        assert!((15..=35).contains(&ascending), "{ascending} of 49 are ascending");
        assert!(code(0, 1).is_empty());
    }

    #[test]
    fn axes_slow_a_line_down() {
        let still = MoveTime {
            index: 1,
            feed_mm_s: 40.0,
            turn_deg_s: 40.0,
            axis_percent: PTP_SPEED_PERCENT,
            duration_s: 0.0,
        };
        let free = paced(still, &line(80.0, 0.0), 40.0, 30.0, None);
        assert_eq!((free.feed_mm_s, free.turn_deg_s), (40.0, 30.0));
        assert_near(free.duration_s, 80.0 / 40.0 + 40.0 / 200.0);
        // An axis that needs 10 s at its greatest speed may use half of it: a twentieth of the path per second.
        let slowed = paced(still, &PathTiming { axis_s: 10.0, ..line(80.0, 60.0) }, 40.0, 30.0, None);
        assert_eq!((slowed.feed_mm_s, slowed.turn_deg_s), (4.0, 3.0));
        // The orientation needs 60 / 20 s: the path has no more than a third per second.
        let turned = paced(still, &line(80.0, 60.0), 40.0, 20.0, None);
        assert_eq!((turned.feed_mm_s, turned.turn_deg_s), (26.667, 20.0));
        // A wanted time is kept to the rounding of the speed as it is printed.
        let coded = paced(still, &line(80.0, 60.0), 40.0, 40.0, Some(4.5));
        assert!((coded.duration_s - 4.5).abs() < 1e-3, "{}", coded.duration_s);
        let longest = paced(still, &line(0.5, 0.0), 40.0, 40.0, Some(900.0));
        assert_eq!(longest.feed_mm_s, 0.01);
    }

    #[test]
    fn no_two_moves_into_the_dwells_of_a_circle_take_as_long() {
        let rows: Vec<PlanRow> = (1..=60)
            .map(|index| PlanRow {
                index,
                circle: 1 + (index - 1) / 30,
                motion: MotionKind::Lin,
                dwell_s: 1.0,
                ..row(PoseKind::Measure)
            })
            .collect();
        let paces: Vec<Option<PathTiming>> = rows.iter().map(|_| Some(line(30.0, 5.0))).collect();
        let times = move_times(&rows, &paces, &MotionTable::default(), &robot(), 3);
        // 30 mm at 40 mm/s take 0.95 s; the code adds up to 2.2 s.
        assert!(times.iter().all(|time| (0.95..0.95 + 2.2).contains(&time.duration_s)));
        for circle in times.chunks(30) {
            let mut durations: Vec<f64> = circle.iter().map(|time| time.duration_s).collect();
            durations.sort_by(f64::total_cmp);
            let nearest = durations.windows(2).map(|pair| pair[1] - pair[0]).fold(f64::INFINITY, f64::min);
            assert!(nearest > 0.004, "{nearest}");
        }
    }

    #[test]
    fn marker_is_slow_and_a_first_row_takes_no_time() {
        let transit = PlanRow { motion: MotionKind::Lin, ..row(PoseKind::Transit) };
        let rows = vec![transit.clone(), transit.clone(), transit];
        let paces = [None, Some(line(0.3, 0.0)), Some(line(30.0, 0.0))];
        let times = move_times(&rows, &paces, &MotionTable::default(), &robot(), 1);
        assert_eq!(times[0].duration_s, 0.0);
        assert_eq!(times[1].feed_mm_s, 1.0);
        assert_near(times[1].duration_s, 0.3 + 1.0 / 200.0);
        assert_eq!(times[2].feed_mm_s, 40.0);
    }
}
