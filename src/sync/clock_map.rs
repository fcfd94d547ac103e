//! A device's counter on the host's clock.
//!
//! A stamp of the host is late by the delay of the line: at least by its least delay, often by much
//! more. So all points (device time, host time) lie above the true line, and the line that touches
//! them from below, the lower convex hull of a window, has the true drift and the least delay as its
//! only bias (Zhang, Liu and Xia, INFOCOM 2002). A line by least squares is biased by the mean delay.
//! What stays unknown one way is the least delay itself.

use crate::units::HostNs;

/// Length of a window, s: long against the spread of delays, short against the change of drift.
const WINDOW_S: f64 = 150.0;
/// A drift beyond this is no quartz: the counter was reset or jumped.
const MOST_DRIFT: f64 = 1e-3;
/// Lateness that a line may have without a break, s.
const MOST_LATE_S: f64 = 5.0;

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
    /// Half of the stamps lie nearer to the line than this, s: the error is hardly larger.
    pub median_late_s: f64,
    /// How far the line could be moved without a stamp before its event, s: the bound on the error
    /// beyond the least delay.
    pub bound_s: f64,
}

/// A place where the counter and the host's clock do not go together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Break {
    /// Index of the first sample behind it.
    pub at: usize,
    /// How far the counter went against the host, s.
    pub jump_s: f64,
}

/// The map of a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ClockMap {
    /// The first stamp.
    pub begin: HostNs,
    /// Windows in order.
    pub segments: Vec<Segment>,
    /// Breaks of the counter.
    pub breaks: Vec<Break>,
    /// Device time of each sample since the first, s, unwrapped; it goes on with the host over breaks.
    pub device_s: Vec<f64>,
}

impl ClockMap {
    /// From the stamps of samples in order, the counter as sent, the length of its tick in seconds
    /// and the number of ticks after which it begins again.
    pub fn new(stamps: &[(HostNs, u64)], tick_s: f64, wrap: Option<u64>) -> Self {
        let Some((begin, _)) = stamps.first().copied() else { return Self::default() };
        let mut map = Self { begin, ..Self::default() };
        let mut first = 0;
        for (at, pair) in stamps.windows(2).enumerate() {
            let [(host, from), (next_host, to)] = [pair[0], pair[1]];
            let host_s = next_host.seconds_since(host);
            let step = to as f64 - from as f64;
            let step = match wrap {
                // Whole turns that went by while nothing came are the host's to tell.
                Some(wrap) => {
                    let turn = wrap as f64;
                    let least = step.rem_euclid(turn);
                    least + turn * ((host_s / tick_s - least) / turn).round().max(0.0)
                }
                None => step,
            };
            let step_s = step * tick_s;
            let before = map.device_s.last().copied().unwrap_or(0.0);
            if map.device_s.is_empty() {
                map.device_s.push(0.0);
            }
            let off = step_s - host_s;
            if step_s < 0.0 || off.abs() > MOST_LATE_S + MOST_DRIFT * host_s {
                map.breaks.push(Break { at: at + 1, jump_s: off });
                map.lines(stamps, first..at + 1);
                first = at + 1;
                map.device_s.push(before + host_s.max(0.0));
            } else {
                map.device_s.push(before + step_s);
            }
        }
        if map.device_s.is_empty() {
            map.device_s.push(0.0);
        }
        map.lines(stamps, first..stamps.len());
        map
    }

    /// Host time of a device time, s since the first stamp; none when there is no sample.
    pub fn host_s(&self, device_s: f64) -> Option<f64> {
        let segment = self.segments.iter().rev().find(|segment| segment.from_s <= device_s);
        let segment = segment.or(self.segments.first())?;
        Some(segment.host_s + (device_s - segment.from_s) * (1.0 + segment.drift))
    }

    /// The windows of a stretch without a break.
    fn lines(&mut self, stamps: &[(HostNs, u64)], stretch: std::ops::Range<usize>) {
        let (Some(device), Some(stamps)) = (self.device_s.get(stretch.clone()), stamps.get(stretch)) else {
            return;
        };
        let (Some(start), Some(end)) = (device.first().copied(), device.last().copied()) else { return };
        let points: Vec<(f64, f64)> =
            device.iter().zip(stamps).map(|(t, (host, _))| (*t, host.seconds_since(self.begin))).collect();
        let count = ((end - start) / WINDOW_S).floor().max(1.0);
        let width = (end - start) / count;
        for window in 0..count as usize {
            let (from, to) = (start + window as f64 * width, start + (window + 1) as f64 * width);
            // Half a window beyond both ends: the hull is weakest at its own.
            let low = points.partition_point(|(t, _)| *t < from - width / 2.0);
            let high = points.partition_point(|(t, _)| *t <= to + width / 2.0);
            if let Some(line) = points.get(low..high).and_then(|points| under(points, (from + to) / 2.0)) {
                self.segments.push(segment(&points[low..high], line, from, to));
            }
        }
    }
}

/// A line by a point of it and its slope.
type Line = (f64, f64, f64);

/// The edge of the lower convex hull at the abscissa `middle`.
fn under(points: &[(f64, f64)], middle: f64) -> Option<Line> {
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
    match edge {
        Some(edge) => {
            let slope = (edge[1].1 - edge[0].1) / (edge[1].0 - edge[0].0);
            Some((edge[0].0, edge[0].1, slope))
        }
        None => points.iter().min_by(|a, b| a.1.total_cmp(&b.1)).map(|point| (point.0, point.1, 1.0)),
    }
}

fn segment(points: &[(f64, f64)], (t, host, slope): Line, from_s: f64, to_s: f64) -> Segment {
    let mut late: Vec<f64> = points.iter().map(|point| point.1 - (host + (point.0 - t) * slope)).collect();
    late.sort_by(f64::total_cmp);
    let quantile = |share: f64| late.get((share * late.len() as f64) as usize).copied().unwrap_or(0.0);
    // Stamps just above the line on both sides of the middle hold it: the gap to the next ones is
    // what it could be wrong by.
    let third = (to_s - from_s) / 3.0;
    let nearest = |low: f64, high: f64| {
        let part = points.iter().filter(|point| (low..=high).contains(&point.0));
        part.map(|point| point.1 - (host + (point.0 - t) * slope)).fold(f64::INFINITY, f64::min)
    };
    let ends = [nearest(f64::NEG_INFINITY, from_s + third), nearest(to_s - third, f64::INFINITY)];
    Segment {
        from_s,
        to_s,
        host_s: host + (from_s - t) * slope,
        drift: slope - 1.0,
        median_late_s: quantile(0.5),
        bound_s: ends.into_iter().filter(|late| late.is_finite()).fold(0.0, f64::max),
    }
}
