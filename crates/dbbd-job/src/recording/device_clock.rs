//! The clock of a device mapped to the clock of the host: offset and skew.
//!
//! Host stamps are late by the delay of the line, which has a minimum and a long tail. All points (device time,
//! host time) therefore lie above the true line. The lower convex hull of a window gives the true skew and is biased
//! by the least delay alone (Zhang, Liu and Xia, INFOCOM 2002); least squares are biased by the mean delay. Stamps
//! of one direction cannot show the least delay itself.
//!
//! A break of the counter shifts the least delay permanently, a stall of the line does not.

use std::collections::VecDeque;

use dbbd_device::protocol::TickCounter;
use dbbd_model::base::units::{DeviceTicks, HostNs};

/// Largest plausible skew of a quartz clock.
const MAX_CLOCK_SKEW: f64 = 1e-3;
/// Length of a window, s: long against the spread of delays, short against changes of the skew.
const WINDOW_S: f64 = 150.0;
/// Smallest lasting shift of the least delay that counts as a break, s.
const MIN_BREAK_S: f64 = 0.1;
/// The least delay is compared over this time before and after a step, s.
const NEAR_S: f64 = 10.0;
/// Step by more than which a counter that does not run at the host's pace breaks, s.
const LONGEST_STEP_S: f64 = 2.0;

/// Counter of a device, as its protocol defines it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeviceClock {
    pub seconds_per_tick: f64,
    /// Ticks after which the counter wraps to 0.
    pub wrap: Option<u64>,
}

impl From<TickCounter> for DeviceClock {
    fn from(clock: TickCounter) -> Self {
        Self { seconds_per_tick: f64::from(clock.tick_ns) * 1e-9, wrap: 1u64.checked_shl(clock.wrap_bits) }
    }
}

/// Arrival of a sample by both clocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockStamp {
    pub host: HostNs,
    /// Value of the counter as sent.
    pub ticks: DeviceTicks,
}

/// The stamps of a run, eight bytes each: an hour at 1 kHz has millions of them.
#[derive(Clone, Debug, Default)]
pub struct ClockStamps {
    /// The low halves of the host's time and of the ticks.
    low: Vec<u64>,
    /// The high halves, each with the index from which on it holds.
    high: Vec<(usize, [u64; 2])>,
}

/// The low half of a number.
const LOW: u64 = 0xffff_ffff;

impl ClockStamps {
    pub fn push(&mut self, ClockStamp { host, ticks }: ClockStamp) {
        let high = [host.0 & !LOW, ticks.0 & !LOW];
        if self.high.last().is_none_or(|(_, last)| *last != high) {
            self.high.push((self.low.len(), high));
        }
        self.low.push((host.0 & LOW) << 32 | ticks.0 & LOW);
    }

    pub fn len(&self) -> usize {
        self.low.len()
    }

    pub fn is_empty(&self) -> bool {
        self.low.is_empty()
    }

    fn get(&self, at: usize) -> Option<ClockStamp> {
        let high = self.high.partition_point(|(from, _)| *from <= at).checked_sub(1)?;
        Some(whole(self.high[high].1, *self.low.get(at)?))
    }

    /// The step from a stamp to the next one.
    fn step(&self, clock: DeviceClock, at: usize) -> Option<ClockStep> {
        Some(clock.step(self.get(at)?, self.get(at + 1)?))
    }

    fn steps(&self, clock: DeviceClock) -> impl Iterator<Item = ClockStep> {
        let mut last = None;
        self.iter().filter_map(move |stamp| Some(clock.step(last.replace(stamp)?, stamp)))
    }

    pub fn iter(&self) -> impl Iterator<Item = ClockStamp> {
        let mut high = HighHalves::new(&self.high);
        self.low.iter().enumerate().map(move |(at, low)| whole(high.at(at), *low))
    }

    /// A number for each stamp, in the memory of the stamps.
    pub(super) fn into_numbers(self, mut number: impl FnMut(ClockStamp) -> f64) -> Vec<f64> {
        let Self { low, high } = self;
        let (mut high, mut at) = (HighHalves::new(&high), 0);
        let of = |low| {
            let stamp = whole(high.at(at), low);
            at += 1;
            number(stamp)
        };
        // The standard library collects numbers of one size in place.
        low.into_iter().map(of).collect()
    }
}

impl FromIterator<ClockStamp> for ClockStamps {
    fn from_iter<I: IntoIterator<Item = ClockStamp>>(stamps: I) -> Self {
        let mut all = Self::default();
        stamps.into_iter().for_each(|stamp| all.push(stamp));
        all
    }
}

fn whole([host, ticks]: [u64; 2], low: u64) -> ClockStamp {
    ClockStamp { host: HostNs(host | low >> 32), ticks: DeviceTicks(ticks | low & LOW) }
}

/// The high halves of stamps that are read in order.
struct HighHalves<'a> {
    rest: &'a [(usize, [u64; 2])],
    now: [u64; 2],
}

impl<'a> HighHalves<'a> {
    fn new(rest: &'a [(usize, [u64; 2])]) -> Self {
        Self { rest, now: [0; 2] }
    }

    fn at(&mut self, at: usize) -> [u64; 2] {
        if let Some(((from, high), rest)) = self.rest.split_first()
            && *from == at
        {
            (self.now, self.rest) = (*high, rest);
        }
        self.now
    }
}

/// Device time of a stream: seconds since the first sample, unwrapped. Across a break it advances with the host.
#[derive(Clone, Debug)]
pub struct DeviceTime {
    clock: DeviceClock,
    last: Option<ClockStamp>,
    seconds: f64,
    step_s: Option<f64>,
}

impl DeviceTime {
    pub fn new(clock: DeviceClock) -> Self {
        Self { clock, last: None, seconds: 0.0, step_s: None }
    }

    /// The last step of the counter as it was sent, s, also if it is a break.
    pub fn step_s(&self) -> Option<f64> {
        self.step_s
    }

    /// The time of the next stamp of a live stream.
    pub fn seconds(&mut self, stamp: ClockStamp) -> f64 {
        self.advance(stamp, ClockStep::is_gross)
    }

    fn advance(&mut self, stamp: ClockStamp, is_break: impl FnOnce(&ClockStep) -> bool) -> f64 {
        if let Some(last) = self.last.replace(stamp) {
            let step = self.clock.step(last, stamp);
            self.seconds += if is_break(&step) { step.host_s.max(0.0) } else { step.device_s };
            self.step_s = Some(step.device_s);
        }
        self.seconds
    }
}

/// A sample at which the counter does not agree with the host's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockBreak {
    /// Index of the first sample after the break.
    pub at: usize,
    /// Whether the counter stepped back (a restart of the device); else it jumped ahead.
    pub reset: bool,
    /// Step of the counter as sent, s.
    pub jump_s: f64,
    /// Time that passed on the host, s.
    pub host_s: f64,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct ClockMap {
    /// Host time of the first sample.
    pub begin: HostNs,
    /// Windows in order; empty if the counter does not run at the host's pace (a simulation faster than real time).
    pub segments: Vec<ClockSegment>,
    pub breaks: Vec<ClockBreak>,
    /// Number of regular wraps of the counter.
    pub wraps: u64,
}

/// Stamps without a break, and the device times of the first and the last one, s.
struct UnbrokenStamps {
    count: usize,
    start_s: f64,
    end_s: f64,
}

impl ClockMap {
    pub fn new(stamps: &ClockStamps, clock: DeviceClock) -> Self {
        let Some(first) = stamps.get(0) else { return Self::default() };
        let mut map = Self { begin: first.host, ..Self::default() };
        let paced = paced(stamps.steps(clock));
        let mut time = DeviceTime::new(clock);
        let mut stretches = vec![UnbrokenStamps { count: 0, start_s: 0.0, end_s: 0.0 }];
        let (mut first, mut last) = (0, first);
        for (at, stamp) in stamps.iter().enumerate() {
            let mut broken = None;
            let device_s = time.advance(stamp, |step| {
                let is_break = if paced { shifts(stamps, clock, first, at) } else { step.is_gross() };
                if is_break {
                    broken = Some(step.host_s);
                } else {
                    map.wraps += step.turns;
                }
                is_break
            });
            if let Some(host_s) = broken {
                let jump_s = (stamp.ticks.0 as f64 - last.ticks.0 as f64) * clock.seconds_per_tick;
                map.breaks.push(ClockBreak { at, reset: jump_s < 0.0, jump_s, host_s });
                stretches.push(UnbrokenStamps { count: 0, start_s: device_s, end_s: device_s });
                first = at;
            }
            if let Some(stretch) = stretches.last_mut() {
                stretch.count += 1;
                stretch.end_s = device_s;
            }
            last = stamp;
        }
        if paced {
            map.segments = map.lines(stamps, clock, &stretches);
        }
        map
    }

    /// Computes the device time of each stamp, s since the first one; the stamps must be given in order.
    pub fn device_time(&self, clock: DeviceClock) -> impl FnMut(ClockStamp) -> f64 {
        let mut time = DeviceTime::new(clock);
        let (mut breaks, mut at) = (self.breaks.iter().map(|broken| broken.at).peekable(), 0);
        move |stamp| {
            let is_break = breaks.next_if_eq(&at).is_some();
            at += 1;
            time.advance(stamp, |_| is_break)
        }
    }

    /// Host time of a device time, s since the first stamp; `None` without segments.
    pub fn host_s(&self, device_s: f64) -> Option<f64> {
        let before = self.segments.partition_point(|segment| segment.from_s <= device_s);
        let segment = self.segments.get(before.saturating_sub(1))?;
        Some(segment.host_s + (device_s - segment.from_s) * (1.0 + segment.drift))
    }

    /// Mean skew over the run, host seconds per device second less 1; `None` without segments.
    pub fn drift(&self) -> Option<f64> {
        let weigh = |of: fn(&ClockSegment) -> f64| -> f64 {
            self.segments.iter().map(|segment| of(segment) * (segment.to_s - segment.from_s)).sum()
        };
        let whole_s = weigh(|_| 1.0);
        (whole_s > 0.0).then(|| weigh(|segment| segment.drift) / whole_s)
    }

    /// Largest bound on the offset error beyond the least delay, s; `None` without segments.
    pub fn bound_s(&self) -> Option<f64> {
        self.segments.iter().map(|segment| segment.bound_s).max_by(f64::total_cmp)
    }

    /// Fits the windows of each stretch without a break, in one pass over the stamps.
    fn lines(
        &self,
        stamps: &ClockStamps,
        clock: DeviceClock,
        stretches: &[UnbrokenStamps],
    ) -> Vec<ClockSegment> {
        let mut segments = Vec::new();
        let mut device_time = self.device_time(clock);
        let mut points = stamps.iter().map(|stamp| ClockPoint {
            device_s: device_time(stamp),
            host_s: stamp.host.seconds_since(self.begin),
        });
        for UnbrokenStamps { count, start_s, end_s } in stretches {
            let windows = ((end_s - start_s) / WINDOW_S).floor().max(1.0);
            let width = (end_s - start_s) / windows;
            let mut windows = (0..windows as usize)
                .map(|window| (start_s + window as f64 * width, start_s + (window + 1) as f64 * width))
                .peekable();
            // Points up to half a window beyond both ends are used, because the hull is weakest there.
            let mut near: VecDeque<ClockPoint> = VecDeque::new();
            for point in points.by_ref().take(*count) {
                while let Some((from_s, to_s)) =
                    windows.next_if(|(_, to_s)| point.device_s > to_s + width / 2.0)
                {
                    segments.extend(segment(near.make_contiguous(), from_s, to_s));
                    while near.front().is_some_and(|old| old.device_s < to_s - width / 2.0) {
                        near.pop_front();
                    }
                }
                near.push_back(point);
            }
            for (from_s, to_s) in windows {
                segments.extend(segment(near.make_contiguous(), from_s, to_s));
                while near.front().is_some_and(|old| old.device_s < to_s - width / 2.0) {
                    near.pop_front();
                }
            }
        }
        segments
    }
}

/// Difference of consecutive samples.
#[derive(Clone, Copy)]
struct ClockStep {
    /// Step of the unwrapped counter, s.
    device_s: f64,
    /// Step of the stamps of the host, s.
    host_s: f64,
    /// Number of wraps of the counter.
    turns: u64,
}

impl ClockStep {
    /// Whether late reads by the host cannot explain the step.
    fn is_gross(&self) -> bool {
        self.device_s < 0.0 || self.device_s > LONGEST_STEP_S + 2.0 * self.host_s.max(0.0)
    }
}

impl DeviceClock {
    pub(super) fn is_gross(self, from: ClockStamp, to: ClockStamp) -> bool {
        self.step(from, to).is_gross()
    }

    /// Unwraps the counter.
    fn step(self, from: ClockStamp, to: ClockStamp) -> ClockStep {
        let host_s = to.host.seconds_since(from.host);
        let (from, to) = (from.ticks.0, to.ticks.0);
        let ticks = to as f64 - from as f64;
        let (ticks, turns) = match self.wrap.map(|wrap| wrap as f64) {
            Some(wrap) => {
                let least = ticks.rem_euclid(wrap);
                // Only the host's clock shows whole turns during which nothing came.
                let unseen = ((host_s / self.seconds_per_tick - least) / wrap).round().max(0.0);
                (least + wrap * unseen, unseen as u64 + u64::from(to < from))
            }
            None => (ticks, 0),
        };
        ClockStep { device_s: ticks * self.seconds_per_tick, host_s, turns }
    }
}

/// Whether the counter runs at the host's pace, apart from breaks.
fn paced(steps: impl Iterator<Item = ClockStep>) -> bool {
    let even = steps.filter(|step| !step.is_gross());
    let (device_s, host_s) =
        even.fold((0.0, 0.0), |(device_s, host_s), step| (device_s + step.device_s, host_s + step.host_s));
    device_s > 0.0 && (0.8..1.25).contains(&(host_s / device_s))
}

/// Whether the least delay changes at sample `at`; `first` begins the stretch before.
fn shifts(stamps: &ClockStamps, clock: DeviceClock, first: usize, at: usize) -> bool {
    let step = |sample: usize| stamps.step(clock, sample);
    // Delay of a step: how much longer it is by the host's stamps than by the counter.
    let late = |step: ClockStep| step.host_s - step.device_s;
    let Some(shift_s) = step(at - 1).map(late).filter(|shift_s| shift_s.abs() >= MIN_BREAK_S) else {
        return false;
    };
    // Delays are counted from the delay of the sample before.
    let (mut before_s, mut delay_s, mut passed_s) = (f64::INFINITY, 0.0, 0.0);
    for sample in (first..at).rev() {
        before_s = f64::min(before_s, delay_s);
        passed_s += step(sample).map_or(0.0, |step| step.host_s.abs());
        if passed_s > NEAR_S {
            break;
        }
        delay_s -= sample.checked_sub(1).and_then(step).map_or(0.0, late);
    }
    let (mut behind_s, mut delay_s, mut passed_s) = (f64::INFINITY, shift_s, 0.0);
    for sample in at..stamps.len() {
        behind_s = f64::min(behind_s, delay_s);
        let Some(step) = step(sample) else { break };
        passed_s += step.host_s.abs();
        if passed_s > NEAR_S {
            break;
        }
        delay_s += late(step);
    }
    (behind_s - before_s).abs() > MIN_BREAK_S + MAX_CLOCK_SKEW * 2.0 * NEAR_S
}

/// Arrival of a sample by both clocks, s.
#[derive(Clone, Copy)]
struct ClockPoint {
    device_s: f64,
    host_s: f64,
}

/// Host time as a linear function of device time within a window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockSegment {
    /// Device time of the start of the window, s.
    pub from_s: f64,
    /// Device time of the end of the window, s.
    pub to_s: f64,
    /// Host time at `from_s`, s since the first stamp.
    pub host_s: f64,
    /// Clock skew: host seconds per device second, less 1.
    pub drift: f64,
    /// Median delay of the stamps over the line, s.
    median_late_s: f64,
    /// Bound on the offset error beyond the least delay, s: if the line moved further, a stamp would be earlier than
    /// its event.
    pub bound_s: f64,
}

/// The line under `points` (in order) for the window from `from_s` to `to_s`; points beyond the window support its
/// ends. `None` without a point.
fn segment(points: &[ClockPoint], from_s: f64, to_s: f64) -> Option<ClockSegment> {
    let base = points.first().copied()?;
    let slope = slope_under(points, 0.5 * (from_s + to_s));
    let late = |point: &ClockPoint| (point.host_s - base.host_s) - (point.device_s - base.device_s) * slope;
    let least = points.iter().map(late).fold(f64::INFINITY, f64::min);
    let mut above: Vec<f64> = points.iter().map(|point| late(point) - least).collect();
    // The line rests on stamps in both outer thirds: the gap to the nearest ones bounds its error.
    let third = (to_s - from_s) / 3.0;
    let nearest = |low: f64, high: f64| {
        let part = points.iter().zip(&above).filter(|(point, _)| (low..=high).contains(&point.device_s));
        part.map(|(_, above)| *above).fold(f64::INFINITY, f64::min)
    };
    let ends = [nearest(f64::NEG_INFINITY, from_s + third), nearest(to_s - third, f64::INFINITY)];
    let bound_s = ends.into_iter().filter(|late| late.is_finite()).fold(0.0, f64::max);
    let middle = above.len() / 2;
    let (_, median_late_s, _) = above.select_nth_unstable_by(middle, f64::total_cmp);
    Some(ClockSegment {
        from_s,
        to_s,
        host_s: base.host_s + least + (from_s - base.device_s) * slope,
        drift: slope - 1.0,
        median_late_s: *median_late_s,
        bound_s,
    })
}

/// Slope of the edge of the lower convex hull at `middle_s`; 1 if the points show no plausible skew.
fn slope_under(points: &[ClockPoint], middle_s: f64) -> f64 {
    let mut hull: Vec<ClockPoint> = Vec::new();
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
    slope.filter(|slope| (slope - 1.0).abs() <= MAX_CLOCK_SKEW).unwrap_or(1.0)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;

    #[test]
    fn counter_is_unwrapped_and_follows_the_host_across_a_restart() {
        let mut time = DeviceTime::new(TickCounter { tick_ns: 1000, wrap_bits: 32 }.into());
        let mut at = |host_s: f64, ticks: u64| {
            time.seconds(ClockStamp { host: HostNs((host_s * 1e9) as u64), ticks: DeviceTicks(ticks) })
        };
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} {b}");
        near(at(5.0, u64::from(u32::MAX) - 499_999), 0.0);
        near(at(6.0, 500_000), 1.0);
        near(at(6.5, 0), 1.5);
        near(at(7.5, 1_000_000), 2.5);
    }

    /// A counter of milliseconds that wraps after a second.
    const CLOCK: DeviceClock = DeviceClock { seconds_per_tick: 1e-3, wrap: Some(1000) };

    fn stamp(host_ms: u64, ticks: u64) -> ClockStamp {
        ClockStamp { host: HostNs(host_ms * 1_000_000), ticks: DeviceTicks(ticks) }
    }

    /// Between 900 and 0 the counter counts 100 ms, or whole seconds more by the host's clock; each second is a turn.
    #[test]
    fn turns_after_silence_are_counted_by_the_host() {
        for (host_ms, ticks, device_s, turns) in [
            (50, 950, 0.05, 0),
            (100, 0, 0.1, 1),
            (3_100, 0, 3.1, 4),
            (2_050, 950, 2.05, 2),
            (1_450, 950, 1.05, 1),
            (1_650, 950, 2.05, 2),
            (0, 899, 0.999, 1),
        ] {
            let step = CLOCK.step(stamp(0, 900), stamp(host_ms, ticks));
            assert!((step.device_s - device_s).abs() < 1e-12, "{host_ms} {ticks}: {}", step.device_s);
            assert_eq!(step.turns, turns, "{host_ms} {ticks}");
        }
        let endless = DeviceClock { wrap: None, ..CLOCK };
        assert!(endless.is_gross(stamp(0, 900), stamp(10, 899)));
        // 2 s more than the host's time are not a late read: 2.2 s in 0.1 s.
        assert!(!endless.is_gross(stamp(0, 0), stamp(100, 2_200)));
        assert!(endless.is_gross(stamp(0, 0), stamp(100, 2_201)));
    }

    #[test]
    fn counter_of_a_protocol_wraps_at_a_power_of_two() {
        let clock = DeviceClock::from(TickCounter { tick_ns: 250, wrap_bits: 16 });
        assert!((clock.seconds_per_tick - 2.5e-7).abs() < 1e-20);
        assert_eq!(clock.wrap, Some(65_536));
        assert_eq!(DeviceClock::from(TickCounter { tick_ns: 250, wrap_bits: 64 }).wrap, None);
    }

    /// A sample each 0.1 s of the device; the host's clock is 50 ppm faster, and its stamps are up to 6 ms late.
    fn drifting(count: u64) -> Vec<ClockStamp> {
        let host = |at: u64| HostNs(at * 100_005_000 + at % 7 * 1_000_000);
        (0..count).map(|at| ClockStamp { host: host(at), ticks: DeviceTicks(100 * at) }).collect()
    }

    /// The map, and the device times of the stamps.
    fn map_of(stamps: &[ClockStamp], clock: DeviceClock) -> (ClockMap, Vec<f64>) {
        let map = ClockMap::new(&stamps.iter().copied().collect(), clock);
        let device_s = stamps.iter().copied().map(map.device_time(clock)).collect();
        (map, device_s)
    }

    #[test]
    fn stamps_return_as_they_were() {
        let hosts = [5, LOW - 1, LOW + 7, LOW - 3, u64::MAX, 1 << 40, 1 << 40];
        let ticks = [LOW, 0, LOW + 1, u64::MAX, 3, 4, LOW + 1];
        let stamps: Vec<ClockStamp> = hosts
            .into_iter()
            .zip(ticks)
            .map(|(host, ticks)| ClockStamp { host: HostNs(host), ticks: DeviceTicks(ticks) })
            .collect();
        let packed: ClockStamps = stamps.iter().copied().collect();
        assert!(packed.iter().eq(stamps.iter().copied()));
        assert!((0..stamps.len()).all(|at| packed.get(at) == Some(stamps[at])));
        assert_eq!((packed.len(), packed.get(stamps.len())), (stamps.len(), None));
        let numbers = packed.into_numbers(|stamp| stamp.ticks.0 as f64);
        assert_eq!(numbers, ticks.map(|ticks| ticks as f64));
    }

    #[test]
    fn line_lies_under_all_stamps() {
        let clock = DeviceClock { wrap: None, ..CLOCK };
        let map = map_of(&drifting(4001), clock).0;
        // 400 s are two windows of 200 s.
        assert_eq!(map.segments.len(), 2);
        assert!((map.segments[1].from_s - 200.0).abs() < 1e-9 && (map.segments[1].to_s - 400.0).abs() < 1e-9);
        assert!((map.drift().unwrap() - 5e-5).abs() < 1e-8);
        for device_s in [0.0, 100.0, 399.0] {
            assert!((map.host_s(device_s).unwrap() - device_s * 1.000_05).abs() < 1e-7, "{device_s}");
        }
        // Delays of 0 to 6 ms, each as often: the median is 3 ms, and some stamps are not late.
        assert!((map.segments[0].median_late_s - 0.003).abs() < 1e-6);
        assert!(map.bound_s().unwrap() < 1e-6);
        assert!(map.breaks.is_empty() && map.wraps == 0);
    }

    #[test]
    fn wraps_are_counted() {
        let wrapped: Vec<ClockStamp> = drifting(101)
            .into_iter()
            .map(|stamp| ClockStamp { ticks: DeviceTicks(stamp.ticks.0 % 1000), ..stamp })
            .collect();
        let (map, device_s) = map_of(&wrapped, CLOCK);
        assert_eq!((map.wraps, map.breaks.len()), (10, 0));
        assert!((device_s[100] - 10.0).abs() < 1e-9);
    }

    /// At sample 200 the counter jumps ahead by 5 s, or starts again.
    #[test]
    fn clock_that_jumps_or_restarts_advances_with_the_host() {
        let clock = DeviceClock { wrap: None, ..CLOCK };
        for (reset, jump_s) in [(false, 5.1), (true, -19.9)] {
            let mut stamps = drifting(400);
            for (at, stamp) in (0..).zip(&mut stamps).skip(200) {
                stamp.ticks = DeviceTicks(if reset { 100 * (at - 200) } else { 100 * at + 5_000 });
            }
            let (map, device_s) = map_of(&stamps, clock);
            let [broken] = map.breaks[..] else { panic!("{:?}", map.breaks) };
            assert_eq!((broken.at, broken.reset), (200, reset));
            assert!((broken.jump_s - jump_s).abs() < 1e-9);
            // The delays of samples 199 and 200 are 3 and 4 ms.
            assert!((broken.host_s - 0.101_005).abs() < 1e-9, "{}", broken.host_s);
            assert!((device_s[200] - device_s[199] - broken.host_s).abs() < 1e-9);
            assert!((device_s[399] - device_s[200] - 19.9).abs() < 1e-9);
        }
    }

    #[test]
    fn line_that_stalls_is_no_break() {
        let mut stamps = drifting(400);
        let late = stamps[230].host;
        stamps[200..230].iter_mut().for_each(|stamp| stamp.host = late);
        let (map, _) = map_of(&stamps, DeviceClock { wrap: None, ..CLOCK });
        assert!(map.breaks.is_empty());
        assert!((map.drift().unwrap() - 5e-5).abs() < 1e-7);
    }

    /// The delays of all stamps, summed from the first one, show the same shifts as the few that are summed near a step.
    #[test]
    fn shift_of_the_least_delay_is_found_near_the_step() {
        let clock = DeviceClock { wrap: None, ..CLOCK };
        let mut dice = Pcg64::seed_from_u64(3);
        let (mut ready_ns, mut ticks, mut arrived_ns) = (0u64, 10_000u64, 0u64);
        let stamps: Vec<ClockStamp> = (0..2000)
            .map(|_| {
                ready_ns += 70_000_000;
                // The counter jumps, or the line stalls and then delivers all at once.
                ticks += 70 + if dice.random_bool(0.01) { dice.random_range(0..800) } else { 0 };
                let stall_ns = if dice.random_bool(0.02) { dice.random_range(0..3_000_000_000) } else { 0 };
                arrived_ns = arrived_ns.max(ready_ns + stall_ns + dice.random_range(0..3_000_000));
                ClockStamp { host: HostNs(arrived_ns), ticks: DeviceTicks(ticks) }
            })
            .collect();
        let steps: Vec<ClockStep> = stamps.windows(2).map(|pair| clock.step(pair[0], pair[1])).collect();
        let mut late_s = vec![0.0];
        steps.iter().for_each(|step| late_s.push(late_s[late_s.len() - 1] + step.host_s - step.device_s));
        let least = |samples: &mut dyn Iterator<Item = usize>| {
            let (mut min_s, mut passed_s) = (f64::INFINITY, 0.0);
            for sample in samples {
                min_s = f64::min(min_s, late_s[sample]);
                passed_s += steps.get(sample).map_or(0.0, |step| step.host_s);
                if passed_s > 10.0 {
                    break;
                }
            }
            min_s
        };
        let packed: ClockStamps = stamps.iter().copied().collect();
        let mut found = 0;
        for at in 1..stamps.len() {
            let shift_s = least(&mut (at..stamps.len())) - least(&mut (0..at).rev());
            let shifted = (late_s[at] - late_s[at - 1]).abs() >= 0.1 && shift_s.abs() > 0.12;
            assert_eq!(shifts(&packed, clock, 0, at), shifted, "{at}: {shift_s}");
            found += u32::from(shifted);
        }
        assert!(found > 5, "{found}");
    }

    #[test]
    fn counter_faster_than_the_host_has_no_line() {
        let stamps: Vec<ClockStamp> = (0..100).map(|at| stamp(at, 100 * at)).collect();
        let (map, device_s) = map_of(&stamps, DeviceClock { wrap: None, ..CLOCK });
        assert!(map.segments.is_empty());
        assert_eq!((map.host_s(0.0), map.drift(), map.bound_s()), (None, None, None));
        assert!((device_s[99] - 9.9).abs() < 1e-9);
    }

    /// The hull of (0, 0), (1, 2), (2, 1.0002), (3, 3.0003) is without the second point; its edges rise by 0.5001
    /// and 2.0001, which is no quartz.
    #[test]
    fn slope_is_that_of_the_lower_hull() {
        let points = |hosts: &[f64]| -> Vec<ClockPoint> {
            let point = |(at, host_s): (usize, &f64)| ClockPoint { device_s: at as f64, host_s: *host_s };
            hosts.iter().enumerate().map(point).collect()
        };
        assert_eq!(slope_under(&points(&[0.0, 2.0, 1.0002, 3.0003]), 1.0), 1.0);
        assert!((slope_under(&points(&[0.0, 1.5, 2.0002, 3.0005]), 1.5) - 1.0001).abs() < 1e-12);
        assert!((slope_under(&points(&[0.0, 1.5, 2.0002, 3.0005]), 2.5) - 1.0003).abs() < 1e-12);
        assert!((slope_under(&points(&[0.0, 1.5, 2.0002, 3.0005]), 9.0) - 1.0003).abs() < 1e-12);
        assert_eq!(slope_under(&points(&[0.0]), 0.0), 1.0);
    }
}
