//! The line that touches points from below: host time over device time without the mean delay.

/// A drift beyond this is no quartz.
pub(super) const MOST_DRIFT: f64 = 1e-3;

/// A sample on both clocks, s.
#[derive(Clone, Copy)]
pub(super) struct Point {
    pub(super) device_s: f64,
    pub(super) host_s: f64,
}

/// Host time as a line over device time, within a window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// Device time of its beginning, s.
    pub from_s: f64,
    /// Device time at which the next one takes over, s.
    pub to_s: f64,
    /// Host time at `from_s`, s since the first stamp.
    pub host_s: f64,
    /// Host seconds per device second, less 1.
    pub drift: f64,
    /// Half of the stamps lie nearer to the line than this, s.
    pub median_late_s: f64,
    /// How far the line could be moved without a stamp before its event, s: the bound on the error
    /// beyond the least delay.
    pub bound_s: f64,
}

/// The line under `points` (in order) for the window from `from_s` to `to_s`;
/// points beyond the window hold it at its ends. `None` without a point.
pub(super) fn segment(points: &[Point], from_s: f64, to_s: f64) -> Option<Segment> {
    let base = points.first().copied()?;
    let slope = slope_under(points, 0.5 * (from_s + to_s));
    let late = |point: &Point| (point.host_s - base.host_s) - (point.device_s - base.device_s) * slope;
    let least = points.iter().map(late).fold(f64::INFINITY, f64::min);
    let mut above: Vec<f64> = points.iter().map(|point| late(point) - least).collect();
    // Stamps just above the line on both sides of the middle hold it: the gap to the next ones is
    // what it could be wrong by.
    let third = (to_s - from_s) / 3.0;
    let nearest = |low: f64, high: f64| {
        let part = points.iter().zip(&above).filter(|(point, _)| (low..=high).contains(&point.device_s));
        part.map(|(_, above)| *above).fold(f64::INFINITY, f64::min)
    };
    let ends = [nearest(f64::NEG_INFINITY, from_s + third), nearest(to_s - third, f64::INFINITY)];
    let bound_s = ends.into_iter().filter(|late| late.is_finite()).fold(0.0, f64::max);
    let middle = above.len() / 2;
    let (_, median_late_s, _) = above.select_nth_unstable_by(middle, f64::total_cmp);
    Some(Segment {
        from_s,
        to_s,
        host_s: base.host_s + least + (from_s - base.device_s) * slope,
        drift: slope - 1.0,
        median_late_s: *median_late_s,
        bound_s,
    })
}

/// Slope of the lower convex hull's edge at the abscissa `middle_s`; 1 where the points are too few to show a
/// quartz's.
fn slope_under(points: &[Point], middle_s: f64) -> f64 {
    let mut hull: Vec<Point> = Vec::new();
    for point in points {
        while let [.., a, b] = hull[..] {
            let turns_left = (b.device_s - a.device_s) * (point.host_s - a.host_s)
                > (b.host_s - a.host_s) * (point.device_s - a.device_s);
            if turns_left {
                break;
            }
            hull.pop();
        }
        hull.push(*point);
    }
    let edges = || hull.windows(2).filter(|edge| edge[1].device_s > edge[0].device_s);
    let edge = edges().find(|edge| edge[1].device_s >= middle_s).or(edges().next_back());
    let slope = edge.map(|edge| (edge[1].host_s - edge[0].host_s) / (edge[1].device_s - edge[0].device_s));
    slope.filter(|slope| (slope - 1.0).abs() <= MOST_DRIFT).unwrap_or(1.0)
}
