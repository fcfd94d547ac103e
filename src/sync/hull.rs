//! The line that touches points from below: host time over device time without the mean delay.

/// A drift beyond this is no quartz.
pub(super) const MOST_DRIFT: f64 = 1e-3;

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

/// The line under `points` (device time, host time, s; in order) for the window from `from_s` to `to_s`;
/// points beyond the window hold it at its ends. `None` without a point.
pub(super) fn segment(points: &[(f64, f64)], from_s: f64, to_s: f64) -> Option<Segment> {
    let (base, host_base) = points.first().copied()?;
    let slope = slope_under(points, 0.5 * (from_s + to_s));
    let late = |point: &(f64, f64)| (point.1 - host_base) - (point.0 - base) * slope;
    let least = points.iter().map(late).fold(f64::INFINITY, f64::min);
    let mut above: Vec<f64> = points.iter().map(|point| late(point) - least).collect();
    // Stamps just above the line on both sides of the middle hold it: the gap to the next ones is
    // what it could be wrong by.
    let third = (to_s - from_s) / 3.0;
    let nearest = |low: f64, high: f64| {
        let part = points.iter().zip(&above).filter(|(point, _)| (low..=high).contains(&point.0));
        part.map(|(_, above)| *above).fold(f64::INFINITY, f64::min)
    };
    let ends = [nearest(f64::NEG_INFINITY, from_s + third), nearest(to_s - third, f64::INFINITY)];
    let bound_s = ends.into_iter().filter(|late| late.is_finite()).fold(0.0, f64::max);
    let middle = above.len() / 2;
    let (_, median_late_s, _) = above.select_nth_unstable_by(middle, f64::total_cmp);
    Some(Segment {
        from_s,
        to_s,
        host_s: host_base + least + (from_s - base) * slope,
        drift: slope - 1.0,
        median_late_s: *median_late_s,
        bound_s,
    })
}

/// Slope of the lower convex hull's edge at the abscissa `middle`; 1 where the points are too few to
/// tell a quartz's.
fn slope_under(points: &[(f64, f64)], middle: f64) -> f64 {
    let mut hull: Vec<(f64, f64)> = Vec::new();
    for point in points {
        while let [.., a, b] = hull[..] {
            let turns_left = (b.0 - a.0) * (point.1 - a.1) > (b.1 - a.1) * (point.0 - a.0);
            if turns_left {
                break;
            }
            hull.pop();
        }
        hull.push(*point);
    }
    let edges = || hull.windows(2).filter(|edge| edge[1].0 > edge[0].0);
    let edge = edges().find(|edge| edge[1].0 >= middle).or(edges().next_back());
    let slope = edge.map(|edge| (edge[1].1 - edge[0].1) / (edge[1].0 - edge[0].0));
    slope.filter(|slope| (slope - 1.0).abs() <= MOST_DRIFT).unwrap_or(1.0)
}
