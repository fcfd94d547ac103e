//! The position error that is kept after a run against the time that the run takes.

use super::frame::{Area, Frame, Labels, NARROW};
use super::{Key, Legend, Series};
use crate::plan::goal::outcome::GoalOutcome;

const SIZE: [f64; 2] = [NARROW, 250.0];

/// The curve of a goal, with the goal as a line and the planned run as a dot.
pub(crate) fn error_after_minutes(goal: &GoalOutcome) -> String {
    let times = goal.curve.iter().map(|point| point.minutes).chain([goal.minutes]);
    let errors = goal.curve.iter().map(|point| point.position_mm).chain([goal.reached_mm, goal.position_mm]);
    let longest = times.fold(0.0, f64::max);
    // The first minutes leave so much that they would hide the rest.
    let highest = errors.fold(0.0, f64::max).min(5.0 * goal.position_mm);
    let labels = Labels {
        title: "What more time brings",
        description: "Position error that 90 % of the robots keep, against the minutes of the run",
        x: "minutes",
        y: "position error (mm)",
    };
    let mut frame = Frame::new(Area::of(SIZE), &labels, [0.0, 1.05 * longest], [0.0, 1.1 * highest]);
    frame.axes();
    frame.level("limit", goal.position_mm);
    let shown = goal.curve.iter().filter(|point| point.position_mm <= 1.1 * highest);
    let points: Vec<[f64; 2]> =
        shown.clone().map(|point| frame.at(point.minutes, point.position_mm)).collect();
    frame.svg.path(Series::First.line(), &points, false);
    for (point, at) in shown.zip(points) {
        let tip = format!("{} poses, {} balls, bar {} mm", point.poses, point.balls, point.bar_mm);
        frame.svg.circle(Series::First.dot(), at, 3.5, &tip);
    }
    let planned = frame.at(goal.minutes, goal.reached_mm);
    frame.svg.circle(Series::Second.dot(), planned, 5.0, "");
    let mut legend = Legend::new(34.0);
    legend.add(&mut frame.svg, Key::Dot(Series::First), "best runs");
    legend.add(&mut frame.svg, Key::Dot(Series::Second), "this plan");
    frame.svg.finish()
}
