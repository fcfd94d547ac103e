//! Continuous circles: each pass is one motion, measured without stops.
//!
//! The rows of a pass are: two auxiliary points at a third and two thirds of a turn (transit, `circ`), the measured points
//! (measure, `circ`, no dwell), and the end of the overshoot, where the robot stops (transit, `circ`). A pass begins where
//! the row before it ends. Feed-in and overshoot are equally long, so that the pass back is on the same circle; at the
//! points the speed is the feed.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::job::Job;
use super::path::ToolBallPath;
use super::timing::{ACCELERATION_MM_S2, MoveTime, ramped_s};
use super::{MotionKind, PlanRow, PoseKind, RowsOfPass, UngroupedRow};
use crate::plan::PlanFinding;
use dbbd_model::robot::Pose;

/// A pass, as in `plan.json`: the indices of its rows, and its motion.
///
/// Times refer to the commanded motion from its beginning, at full override: constant acceleration, the feed, constant
/// deceleration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlannedPass {
    pub circle: u32,
    /// Whether the pass goes against growing angles.
    pub clockwise: bool,
    pub through: [u32; 2],
    /// The first and the last measured row.
    pub points: [u32; 2],
    /// The row at which the pass stops.
    pub end: u32,
    /// Angle of the whole motion with feed-in and overshoot, degrees, above 0.
    pub sweep_deg: f64,
    pub length_mm: f64,
    pub feed_mm_s: f64,
    pub acceleration_mm_s2: f64,
    pub duration_s: f64,
}

impl PlannedPass {
    /// The greatest speed, mm/s, and the time until it is reached, s.
    fn ramp(&self) -> (f64, f64) {
        let speed = self.feed_mm_s.min((self.length_mm * self.acceleration_mm_s2).sqrt());
        (speed, speed / self.acceleration_mm_s2)
    }

    /// The share (0..=1) of the arc that is travelled `t_s` seconds after the motion began.
    pub fn share(&self, t_s: f64) -> f64 {
        let (speed, ramp_s) = self.ramp();
        let left_s = self.duration_s - t_s;
        let done_mm = if t_s <= 0.0 {
            0.0
        } else if left_s <= 0.0 {
            self.length_mm
        } else if t_s < ramp_s {
            0.5 * self.acceleration_mm_s2 * t_s * t_s
        } else if left_s < ramp_s {
            self.length_mm - 0.5 * self.acceleration_mm_s2 * left_s * left_s
        } else {
            speed * (t_s - 0.5 * ramp_s)
        };
        done_mm / self.length_mm
    }

    /// The time from the beginning of the motion at which a share (0..=1) of the arc is travelled, s.
    pub fn time_s(&self, share: f64) -> f64 {
        let (speed, ramp_s) = self.ramp();
        let done_mm = share.clamp(0.0, 1.0) * self.length_mm;
        let left_mm = self.length_mm - done_mm;
        let ramp_mm = 0.5 * speed * ramp_s;
        if done_mm < ramp_mm {
            (2.0 * done_mm / self.acceleration_mm_s2).sqrt()
        } else if left_mm < ramp_mm {
            self.duration_s - (2.0 * left_mm / self.acceleration_mm_s2).sqrt()
        } else {
            done_mm / speed + 0.5 * ramp_s
        }
    }
}

impl PlanRow {
    /// Whether the row is measured without a stop.
    pub fn is_passed(&self) -> bool {
        self.kind != PoseKind::Transit && self.dwell_s == 0.0
    }
}

/// The arc from a row through two points to `end`.
pub(super) fn arc(from: &PlanRow, through: [&PlanRow; 2], end: &PlanRow, sweep_deg: f64) -> ToolBallPath {
    let pose = |row: &PlanRow| Pose::from_kuka(row.xyz_mm, row.abc_deg);
    match ToolBallPath::arc(pose(from), &through[0].xyz_mm.into(), pose(through[1])) {
        ToolBallPath::Arc { from, centre, axis, .. } => {
            ToolBallPath::Arc { from, to: pose(end), centre, axis, angle: sweep_deg.to_radians() }
        }
        other @ (ToolBallPath::Axes { .. } | ToolBallPath::Line { .. }) => other,
    }
}

impl From<UngroupedRow> for PlanFinding {
    fn from(ungrouped: UngroupedRow) -> Self {
        ungrouped.finding
    }
}

impl RowsOfPass {
    pub(super) fn holds(&self, at: usize) -> bool {
        (self.through[0]..=self.end).contains(&at)
    }

    /// The arc of the pass; `None` without a row before it.
    pub(super) fn path(&self, job: &Job, from: Option<&PlanRow>, rows: &[PlanRow]) -> Option<ToolBallPath> {
        let [a, b, end] = [self.through[0], self.through[1], self.end].map(|at| rows.get(at));
        let table = job.circles.get((end?.circle as usize).checked_sub(1)?)?;
        Some(arc(from?, [a?, b?], end?, table.sweep_deg()))
    }
}

/// The passes among the rows; refuses a `circ` row that belongs to no arc.
pub(super) fn groups(rows: &[PlanRow]) -> Result<Vec<RowsOfPass>, UngroupedRow> {
    let arc = |at| Err(UngroupedRow { at, finding: PlanFinding::ArcRows });
    let pass = |at| Err(UngroupedRow { at, finding: PlanFinding::PassPattern });
    let mut found = Vec::new();
    let mut auxiliary: Vec<usize> = Vec::new();
    let mut points: Option<Range<usize>> = None;
    for (at, row) in rows.iter().enumerate() {
        let circ = row.motion == MotionKind::Circ;
        match (auxiliary.as_slice(), &mut points) {
            (_, None) if row.is_passed() && auxiliary.len() != 2 => return pass(at),
            ([], None) if circ && row.kind == PoseKind::Transit => auxiliary.push(at),
            ([], None) if circ => return arc(at),
            ([], None) => {}
            ([_], None) if circ && row.kind == PoseKind::Transit => auxiliary.push(at),
            ([_], None) if circ => auxiliary.clear(),
            ([_], None) => return arc(at),
            ([_, _], None) if circ && row.is_passed() => points = Some(at..at + 1),
            (_, Some(points)) if circ && row.is_passed() => points.end = at + 1,
            (&[a, b], Some(points)) if circ && row.kind == PoseKind::Transit => {
                found.push(RowsOfPass { through: [a, b], points: points.clone(), end: at });
            }
            _ => return pass(at),
        }
        if found.last().is_some_and(|group: &RowsOfPass| group.end == at) {
            auxiliary.clear();
            points = None;
        }
    }
    if auxiliary.is_empty() { Ok(found) } else { arc(rows.len().saturating_sub(1)) }
}

/// The passes of planned rows. Sets the times of their points in `moves`; before the call, `moves` has the time of the
/// whole motion at the end of each pass.
pub(super) fn passes(
    job: &Job,
    rows: &[PlanRow],
    moves: &mut [MoveTime],
) -> Result<Vec<PlannedPass>, PlanFinding> {
    let mut passes = Vec::new();
    let mut backward: Option<u32> = None;
    for group in groups(rows)? {
        let from = group.through[0].checked_sub(1).and_then(|at| rows.get(at));
        let (Some(end), Some(time), Some(path)) =
            (rows.get(group.end), moves.get(group.end).copied(), group.path(job, from, rows))
        else {
            return Err(PlanFinding::PassPattern);
        };
        let table = job.circle(end.circle).ok_or(PlanFinding::PassPattern)?;
        let length_mm = path.length_mm();
        let second = backward == Some(end.circle);
        backward = Some(end.circle);
        let index = |at: usize| rows.get(at).map_or(0, |row| row.index);
        let pass = PlannedPass {
            circle: end.circle,
            clockwise: table.is_clockwise(second),
            through: group.through.map(index),
            points: [index(group.points.start), index(group.points.end - 1)],
            end: end.index,
            sweep_deg: table.sweep_deg(),
            length_mm,
            feed_mm_s: time.feed_mm_s,
            acceleration_mm_s2: ACCELERATION_MM_S2,
            duration_s: ramped_s(length_mm, time.feed_mm_s, ACCELERATION_MM_S2),
        };
        let step = table.step().to_degrees() / table.sweep_deg();
        let first = table.overshoot_deg / table.sweep_deg();
        // On a closed circle the pass back begins at the first point as well.
        let mut before_s = 0.0;
        for (count, at) in group.points.clone().enumerate() {
            let t_s = pass.time_s(first + step * count as f64);
            if let Some(time) = moves.get_mut(at) {
                time.duration_s = t_s - before_s;
                time.feed_mm_s = pass.feed_mm_s;
            }
            before_s = t_s;
        }
        if let Some(time) = moves.get_mut(group.end) {
            time.duration_s = pass.duration_s - before_s;
        }
        passes.push(pass);
    }
    Ok(passes)
}

/// Checks that `plan.json` has the passes of its rows.
pub(super) fn check_passes(rows: &[PlanRow], passes: &[PlannedPass]) -> Result<(), PlanFinding> {
    let groups = groups(rows)?;
    if groups.len() != passes.len() {
        return Err(PlanFinding::PassCount { passes: passes.len(), found: groups.len() });
    }
    let index = |at: usize| at as u32 + 1;
    for (entry, (group, pass)) in (1..).zip(groups.iter().zip(passes)) {
        let points = [index(group.points.start), group.points.end as u32];
        let found = (group.through.map(index), points, index(group.end));
        if found != (pass.through, pass.points, pass.end) {
            return Err(PlanFinding::PassRows { entry });
        }
        let numbers =
            [pass.sweep_deg, pass.length_mm, pass.feed_mm_s, pass.acceleration_mm_s2, pass.duration_s];
        let positive = numbers.iter().all(|value| value.is_finite() && *value > 0.0);
        if !positive || pass.sweep_deg > 1080.0 {
            return Err(PlanFinding::PassNumbers { entry });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::example::row;

    /// 100 mm at 20 mm/s with ramps of 2 s, in each of which it goes 20 mm: 2 + 3 + 2 s.
    fn pass() -> PlannedPass {
        PlannedPass {
            circle: 1,
            clockwise: false,
            through: [2, 3],
            points: [4, 6],
            end: 7,
            sweep_deg: 400.0,
            length_mm: 100.0,
            feed_mm_s: 20.0,
            acceleration_mm_s2: 10.0,
            duration_s: 7.0,
        }
    }

    #[test]
    fn pass_speeds_up_and_slows_down() {
        for (t_s, share) in
            [(1.0, 0.05), (2.0, 0.2), (3.5, 0.5), (5.0, 0.8), (6.0, 0.95), (0.0, 0.0), (7.0, 1.0)]
        {
            assert!((pass().share(t_s) - share).abs() < 1e-12, "{t_s}");
            assert!((pass().time_s(share) - t_s).abs() < 1e-9, "{share}");
        }
        assert_eq!([pass().share(-1.0), pass().share(8.0)], [0.0, 1.0]);
        assert_eq!([pass().time_s(-0.1), pass().time_s(1.1)], [0.0, 7.0]);
    }

    /// 10 mm with ramps of 10 mm/s^2: the speed reaches 10 mm/s after 1 s.
    #[test]
    fn short_pass_does_not_reach_its_feed() {
        let short = PlannedPass { length_mm: 10.0, duration_s: 2.0, ..pass() };
        for (t_s, share) in [(0.5, 0.125), (1.0, 0.5), (1.5, 0.875)] {
            assert!((short.share(t_s) - share).abs() < 1e-12, "{t_s}");
            assert!((short.time_s(share) - t_s).abs() < 1e-12, "{share}");
        }
    }

    fn rows(kinds: &str) -> Vec<PlanRow> {
        let motion = |sign: char| if "apd".contains(sign) { MotionKind::Circ } else { MotionKind::Lin };
        let kind = |sign: char| if "pd".contains(sign) { PoseKind::Measure } else { PoseKind::Transit };
        let one = |(index, sign): (u32, char)| PlanRow {
            index,
            motion: motion(sign),
            dwell_s: if sign == 'd' { 1.0 } else { 0.0 },
            ..row(kind(sign))
        };
        (1..).zip(kinds.chars()).map(one).collect()
    }

    /// l: a line; a: an auxiliary point or the end of a pass; d: a dwell on an arc; p: a point that is passed.
    #[test]
    fn rows_are_grouped_into_arcs_and_passes() {
        let found = groups(&rows("ladlaapppaladaappa")).expect("the rows are possible");
        let pass = |through, points, end| RowsOfPass { through, points, end };
        assert_eq!(found, [pass([4, 5], 6..9, 9), pass([13, 14], 15..17, 17)]);
        assert!(found[0].holds(4) && found[0].holds(9) && !found[0].holds(3) && !found[0].holds(10));
        for (kinds, at) in [("ld", 1), ("lal", 2), ("lpa", 1), ("laapp", 4), ("laad", 3), ("laapl", 4)] {
            assert_eq!(groups(&rows(kinds)).map_err(|wrong| wrong.at), Err(at), "{kinds}");
        }
    }

    #[test]
    fn passes_of_a_file_are_those_of_its_rows() {
        let rows = rows("laapppa");
        assert!(check_passes(&rows, &[pass()]).is_ok());
        assert!(matches!(check_passes(&rows, &[]), Err(PlanFinding::PassCount { passes: 0, found: 1 })));
        for other in [
            PlannedPass { through: [2, 4], ..pass() },
            PlannedPass { points: [4, 7], ..pass() },
            PlannedPass { end: 6, ..pass() },
        ] {
            assert!(matches!(check_passes(&rows, &[other]), Err(PlanFinding::PassRows { entry: 1 })));
        }
        for other in [
            PlannedPass { sweep_deg: 1080.5, ..pass() },
            PlannedPass { feed_mm_s: 0.0, ..pass() },
            PlannedPass { duration_s: f64::NAN, ..pass() },
        ] {
            assert!(matches!(check_passes(&rows, &[other]), Err(PlanFinding::PassNumbers { entry: 1 })));
        }
    }
}
