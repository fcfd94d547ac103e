//! A device's counter on the host's clock.
//!
//! A stamp of the host is late by the delay of the line: at least by its least delay, often by much
//! more. So all points (device time, host time) lie above the true line, and the line that touches
//! them from below, the lower convex hull of a window, has the true drift and the least delay as its
//! only bias (Zhang, Liu and Xia, INFOCOM 2002). A line by least squares is biased by the mean delay.
//! What stays unknown one way is the least delay itself.
//!
//! A counter that breaks shifts the least delay for good; a stall of the line does not.

use std::ops::Range;

use super::lower_hull::{self, MOST_DRIFT, Point, Segment};
use crate::base::units::{DeviceTicks, HostNs};
use crate::device::protocol::Clock;

/// Length of a window, s: long against the spread of delays, short against the change of drift.
const WINDOW_S: f64 = 150.0;
/// A lasting shift of the least delay by less than this is not distinguished from delays, s.
const LEAST_BREAK_S: f64 = 0.1;
/// How far before and behind a step its least delays are looked for, s.
const NEAR_S: f64 = 10.0;
/// A counter that does not run at the host's pace breaks where it steps by more than this, s.
const LONGEST_STEP_S: f64 = 2.0;

/// The device's counter, as the protocol defines it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeviceClock {
    pub seconds_per_tick: f64,
    /// Number of ticks after which the counter begins again at 0, if it does.
    pub wrap: Option<u64>,
}

impl From<Clock> for DeviceClock {
    fn from(clock: Clock) -> Self {
        Self { seconds_per_tick: f64::from(clock.tick_ns) * 1e-9, wrap: 1u64.checked_shl(clock.wrap_bits) }
    }
}

/// When a sample came, by both clocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stamp {
    pub host: HostNs,
    /// The counter as sent.
    pub ticks: DeviceTicks,
}

/// Device time while samples come: seconds since the first, unwrapped. Where the counter breaks it goes on with the host.
#[derive(Clone, Debug)]
pub struct DeviceTime {
    clock: DeviceClock,
    last: Option<Stamp>,
    seconds: f64,
}

impl DeviceTime {
    pub fn new(clock: DeviceClock) -> Self {
        Self { clock, last: None, seconds: 0.0 }
    }

    /// The time of the next sample, s.
    pub fn seconds(&mut self, stamp: Stamp) -> f64 {
        if let Some(last) = self.last.replace(stamp) {
            let step = self.clock.step(last, stamp);
            self.seconds += if step.is_gross() { step.host_s.max(0.0) } else { step.device_s };
        }
        self.seconds
    }
}

/// A place where the counter and the host's clock do not go together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Break {
    /// Index of the first sample behind it.
    pub at: usize,
    /// Whether the counter went back, as after a restart of the device; else it jumped ahead.
    pub reset: bool,
    /// How far the counter went, s, as sent.
    pub jump_s: f64,
    /// How long that took by the host, s.
    pub host_s: f64,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct ClockMap {
    /// The first stamp.
    pub begin: HostNs,
    /// Windows in order; empty where the counter does not run at the host's pace (a simulation faster
    /// than real time), so that the two cannot be laid on each other.
    pub segments: Vec<Segment>,
    pub breaks: Vec<Break>,
    /// How often the counter began again from 0 as it should.
    pub wraps: u64,
    /// Device time of each sample since the first, s, unwrapped; it goes on with the host over breaks.
    pub device_s: Vec<f64>,
}

impl ClockMap {
    /// From the stamps of samples in order and the counter as sent.
    pub fn new(stamps: &[Stamp], clock: DeviceClock) -> Self {
        let Some(first) = stamps.first() else { return Self::default() };
        let mut map = Self { begin: first.host, device_s: vec![0.0], ..Self::default() };
        let steps: Vec<Step> = stamps.windows(2).map(|pair| clock.step(pair[0], pair[1])).collect();
        let paced = paced(&steps);
        let late = lateness(&steps);
        let (mut first, mut device_s) = (0, 0.0);
        let mut stretches = Vec::new();
        for (at, step) in (1..).zip(&steps) {
            let broken = if paced { shifts(&late, &steps, first, at) } else { step.is_gross() };
            if broken {
                let sent = stamps[at].ticks.0 as f64 - stamps[at - 1].ticks.0 as f64;
                let sent_s = sent * clock.seconds_per_tick;
                map.breaks.push(Break { at, reset: sent_s < 0.0, jump_s: sent_s, host_s: step.host_s });
                stretches.push(first..at);
                first = at;
            } else {
                map.wraps += step.turns;
            }
            device_s += if broken { step.host_s.max(0.0) } else { step.device_s };
            map.device_s.push(device_s);
        }
        stretches.push(first..stamps.len());
        if paced {
            stretches.into_iter().for_each(|stretch| map.lines(stamps, stretch));
        }
        map
    }

    /// Host time of a device time, s since the first stamp; `None` when the two do not go together.
    pub fn host_s(&self, device_s: f64) -> Option<f64> {
        let before = self.segments.partition_point(|segment| segment.from_s <= device_s);
        let segment = self.segments.get(before.saturating_sub(1))?;
        Some(segment.host_s + (device_s - segment.from_s) * (1.0 + segment.drift))
    }

    /// Drift over the whole run, host seconds per device second less 1: the mean of the windows'; `None`
    /// when the two do not go together.
    pub fn drift(&self) -> Option<f64> {
        let weigh = |of: fn(&Segment) -> f64| -> f64 {
            self.segments.iter().map(|segment| of(segment) * (segment.to_s - segment.from_s)).sum()
        };
        let whole_s = weigh(|_| 1.0);
        (whole_s > 0.0).then(|| weigh(|segment| segment.drift) / whole_s)
    }

    /// How far a time may be off at most beyond the line's least delay, s; `None` as for [`Self::drift`].
    pub fn bound_s(&self) -> Option<f64> {
        self.segments.iter().map(|segment| segment.bound_s).max_by(f64::total_cmp)
    }

    /// The windows of a stretch without a break.
    fn lines(&mut self, stamps: &[Stamp], stretch: Range<usize>) {
        let (Some(device), Some(stamps)) = (self.device_s.get(stretch.clone()), stamps.get(stretch)) else {
            return;
        };
        let (Some(start), Some(end)) = (device.first().copied(), device.last().copied()) else { return };
        let point =
            |(t, stamp): (&f64, &Stamp)| Point { device_s: *t, host_s: stamp.host.seconds_since(self.begin) };
        let points: Vec<Point> = device.iter().zip(stamps).map(point).collect();
        let count = ((end - start) / WINDOW_S).floor().max(1.0);
        let width = (end - start) / count;
        for window in 0..count as usize {
            let (from, to) = (start + window as f64 * width, start + (window + 1) as f64 * width);
            // Half a window beyond both ends: the hull is weakest at its own.
            let low = points.partition_point(|point| point.device_s < from - width / 2.0);
            let high = points.partition_point(|point| point.device_s <= to + width / 2.0);
            self.segments.extend(points.get(low..high).and_then(|near| lower_hull::segment(near, from, to)));
        }
    }
}

/// From one sample to the next.
#[derive(Clone, Copy)]
struct Step {
    /// By the counter, unwrapped, s.
    device_s: f64,
    /// By the host's stamps, s.
    host_s: f64,
    /// How often the counter began again on the way.
    turns: u64,
}

impl Step {
    /// Whether the counter went further than a host that reads late can explain.
    fn is_gross(&self) -> bool {
        self.device_s < 0.0 || self.device_s > LONGEST_STEP_S + 2.0 * self.host_s.max(0.0)
    }
}

impl DeviceClock {
    /// Whether the counter went further than a host that reads late can explain, or back.
    pub(super) fn is_gross(self, from: Stamp, to: Stamp) -> bool {
        self.step(from, to).is_gross()
    }

    /// The one unwrapping of the counter.
    fn step(self, from: Stamp, to: Stamp) -> Step {
        let host_s = to.host.seconds_since(from.host);
        let (from, to) = (from.ticks.0, to.ticks.0);
        let ticks = to as f64 - from as f64;
        let (ticks, turns) = match self.wrap.map(|wrap| wrap as f64) {
            Some(wrap) => {
                let least = ticks.rem_euclid(wrap);
                // Only the host knows of whole turns that went by while nothing came.
                let unseen = ((host_s / self.seconds_per_tick - least) / wrap).round().max(0.0);
                (least + wrap * unseen, unseen as u64 + u64::from(to < from))
            }
            None => (ticks, 0),
        };
        Step { device_s: ticks * self.seconds_per_tick, host_s, turns }
    }
}

/// Whether the counter runs at the host's pace, leaving its breaks aside.
fn paced(steps: &[Step]) -> bool {
    let whole = |of: fn(&Step) -> f64| -> f64 { steps.iter().filter(|step| !step.is_gross()).map(of).sum() };
    let (device_s, host_s) = (whole(|step| step.device_s), whole(|step| step.host_s));
    device_s > 0.0 && (0.8..1.25).contains(&(host_s / device_s))
}

/// How late each sample's stamp is against the first one's, by the counter as it is.
fn lateness(steps: &[Step]) -> Vec<f64> {
    let mut late_s = vec![0.0];
    let mut sum = 0.0;
    for step in steps {
        sum += step.host_s - step.device_s;
        late_s.push(sum);
    }
    late_s
}

/// Whether the least delay is another one from sample `at` on; `first` begins the stretch before.
fn shifts(late_s: &[f64], steps: &[Step], first: usize, at: usize) -> bool {
    if (late_s[at] - late_s[at - 1]).abs() < LEAST_BREAK_S {
        return false;
    }
    let least = |ways: &mut dyn Iterator<Item = usize>| {
        let (mut least, mut passed_s) = (f64::INFINITY, 0.0);
        for sample in ways {
            least = least.min(late_s[sample]);
            passed_s += steps.get(sample).map_or(0.0, |step| step.host_s.abs());
            if passed_s > NEAR_S {
                break;
            }
        }
        least
    };
    let before_s = least(&mut (first..at).rev());
    let behind_s = least(&mut (at..late_s.len()));
    (behind_s - before_s).abs() > LEAST_BREAK_S + MOST_DRIFT * 2.0 * NEAR_S
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_counter_is_unwrapped_and_goes_on_with_the_host_over_a_restart() {
        let mut time = DeviceTime::new(Clock { tick_ns: 1000, wrap_bits: 32 }.into());
        let mut at = |host_s: f64, ticks: u64| {
            time.seconds(Stamp { host: HostNs((host_s * 1e9) as u64), ticks: DeviceTicks(ticks) })
        };
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} {b}");
        near(at(5.0, u64::from(u32::MAX) - 499_999), 0.0);
        near(at(6.0, 500_000), 1.0);
        near(at(6.5, 0), 1.5);
        near(at(7.5, 1_000_000), 2.5);
    }
}
