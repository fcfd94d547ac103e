//! The samples of a run as columns on one time axis: the device clock mapped to the host's, else the host's.

use std::collections::HashMap;
use std::ops::{Deref, Index};

use super::device_clock::{ClockMap, ClockStamp, ClockStamps, DeviceClock};
use dbbd_model::base::units::{DeviceTicks, HostNs};
use dbbd_model::math::robust;
use dbbd_model::measurement::sample::Sample;

/// Times of samples in order; `t_s` never decreases.
#[derive(Clone, Debug, Default)]
pub struct SampleTimeline {
    /// The fit of the device clock, if there is one.
    clock: Option<ClockMap>,
    begin: HostNs,
    /// Time since the first sample, s.
    pub t_s: Vec<f64>,
    /// Samples at which the clock restarted or jumped: the time before them is a guess.
    pub breaks: Vec<usize>,
}

impl SampleTimeline {
    /// Puts stamps on one time axis; without a `clock`, on the time axis of the host.
    pub fn new(stamps: ClockStamps, clock: Option<DeviceClock>) -> Self {
        let begin = stamps.iter().next().map_or(HostNs(0), |stamp| stamp.host);
        let mut latest_s = 0.0f64;
        // Adjacent windows differ within their bounds, and a polled reading is stamped at its request.
        let mut forward = |t_s: f64| {
            latest_s = latest_s.max(t_s);
            latest_s
        };
        let Some(clock) = clock else {
            let t_s = stamps.into_numbers(|stamp| forward(stamp.host.seconds_since(begin)));
            return Self { begin, t_s, ..Self::default() };
        };
        let map = ClockMap::new(&stamps, clock);
        let first_s = map.host_s(0.0).unwrap_or(0.0);
        let on_host = |device_s: f64| map.host_s(device_s).map_or(device_s, |host_s| host_s - first_s);
        let mut device_time = map.device_time(clock);
        let t_s = stamps.into_numbers(|stamp| forward(on_host(device_time(stamp))));
        drop(device_time);
        let breaks = map.breaks.iter().map(|broken| broken.at).collect();
        Self { begin, t_s, breaks, clock: Some(map) }
    }

    /// The fit of the device clock; `None` if the protocol has no clock.
    pub fn clock(&self) -> Option<&ClockMap> {
        self.clock.as_ref()
    }

    pub fn len(&self) -> usize {
        self.t_s.len()
    }

    pub fn is_empty(&self) -> bool {
        self.t_s.is_empty()
    }

    /// Index of the first sample at or after `t_s`.
    pub fn at(&self, t_s: f64) -> usize {
        self.t_s.partition_point(|&t| t < t_s)
    }

    /// Whether the clock broke in (`from_s`, `to_s`].
    pub fn broken_between(&self, from_s: f64, to_s: f64) -> bool {
        let first = self.breaks.partition_point(|&at| self.t_s[at] <= from_s);
        self.breaks.get(first).is_some_and(|&at| self.t_s[at] <= to_s)
    }

    /// Mean sample period, s, robust against gaps and against stamps that come in batches.
    pub fn period_s(&self) -> f64 {
        const RUN: usize = 50;
        let run = RUN.min(self.len().saturating_sub(1)).max(1);
        let stride = (self.len() / 4000).max(1);
        let mut spans: Vec<f64> = (run..self.len())
            .step_by(stride)
            .map(|at| (self.t_s[at] - self.t_s[at - run]) / run as f64)
            .collect();
        robust::median(&mut spans).unwrap_or(0.0)
    }

    /// Time of a host stamp on this axis; `None` if the device clock does not run at the host's pace (a run faster than
    /// real time).
    pub fn time_of(&self, host: HostNs) -> Option<f64> {
        let first_s = match &self.clock {
            Some(map) => map.host_s(0.0)?,
            None => 0.0,
        };
        Some(host.seconds_since(self.begin) - first_s)
    }

    /// The host's time at a time of this axis. For a run faster than real time it is counted from the first stamp by
    /// the device's clock.
    pub fn host_at(&self, t_s: f64) -> HostNs {
        let at_ns = self.begin.0 as f64 + 1e9 * (t_s - self.time_of(self.begin).unwrap_or(0.0));
        HostNs(at_ns.max(0.0).round() as u64)
    }

    /// Offset from a time on this axis to the same moment on `other`, s; `None` as for [`Self::time_of`].
    pub fn shift_to(&self, other: &Self) -> Option<f64> {
        Some(other.time_of(self.begin)? - self.time_of(self.begin)?)
    }
}

/// Readings in the order of arrival, mm. They are multiples of the resolution of the bar, so that there are few
/// different values: each value is stored once, and an hour at 1 kHz takes half of the memory.
#[derive(Clone, Debug, Default)]
pub struct Readings {
    different_mm: Vec<f64>,
    which: Vec<u32>,
}

/// Finds readings whose value came before, by their bits.
#[derive(Clone, Debug, Default)]
struct KnownReadings(HashMap<u64, u32>);

/// Most different readings that are searched. A bar with floating-point numbers may have more: further values are each
/// stored.
const MAX_KNOWN: usize = 1 << 18;

impl KnownReadings {
    fn push(&mut self, reading_mm: f64, to: &mut Readings) {
        // More than 2^32 different readings are 32 GB.
        let new = u32::try_from(to.different_mm.len()).unwrap_or(u32::MAX);
        let known = match self.0.len() {
            ..MAX_KNOWN => *self.0.entry(reading_mm.to_bits()).or_insert(new),
            MAX_KNOWN.. => self.0.get(&reading_mm.to_bits()).copied().unwrap_or(new),
        };
        if known == new {
            to.different_mm.push(reading_mm);
        }
        to.which.push(known);
    }
}

impl Readings {
    pub fn len(&self) -> usize {
        self.which.len()
    }

    pub fn is_empty(&self) -> bool {
        self.which.is_empty()
    }

    pub fn iter(&self) -> impl Iterator<Item = f64> {
        self.which.iter().map(|which| self.different_mm[*which as usize])
    }
}

impl Index<usize> for Readings {
    type Output = f64;

    fn index(&self, at: usize) -> &f64 {
        &self.different_mm[self.which[at] as usize]
    }
}

/// Samples in the order of arrival.
#[derive(Clone, Debug, Default)]
pub struct SampleStream {
    time: SampleTimeline,
    pub reading_mm: Readings,
    flags: Vec<u8>,
}

impl Deref for SampleStream {
    type Target = SampleTimeline;

    fn deref(&self) -> &SampleTimeline {
        &self.time
    }
}

/// Collects samples. The device clock is fitted when all of them are known.
#[derive(Clone, Debug)]
pub struct StreamBuilder {
    clock: Option<DeviceClock>,
    sequence_modulo: Option<u32>,
    stamps: ClockStamps,
    known: KnownReadings,
    last_sequence: Option<u32>,
    stream: SampleStream,
}

const VALID: u8 = 1;
const STROBE_KNOWN: u8 = 2;
const STROBE_HIGH: u8 = 4;
const GAP_BEFORE: u8 = 8;

impl StreamBuilder {
    /// A builder; without a `clock`, or if a sample has no ticks, the host's stamps are the times.
    pub fn new(clock: Option<DeviceClock>) -> Self {
        let stream = SampleStream::default();
        let (stamps, known) = (ClockStamps::default(), KnownReadings::default());
        Self { clock, sequence_modulo: None, stamps, known, last_sequence: None, stream }
    }

    /// Sets the modulo of the sequence numbers, which show missing samples.
    #[must_use]
    pub fn sequence(self, modulo: Option<u32>) -> Self {
        Self { sequence_modulo: modulo, ..self }
    }

    pub fn push(&mut self, host: HostNs, sample: &Sample) {
        let mut flags = u8::from(sample.valid && sample.reading_mm.is_finite()) * VALID;
        match sample.trigger {
            Some(true) => flags |= STROBE_KNOWN | STROBE_HIGH,
            Some(false) => flags |= STROBE_KNOWN,
            None => {}
        }
        let before = std::mem::replace(&mut self.last_sequence, sample.sequence);
        if let (Some(modulo), Some(before), Some(now)) = (self.sequence_modulo, before, sample.sequence)
            && sequence_step(modulo, before, now) != SequenceStep::Next
        {
            flags |= GAP_BEFORE;
        }
        self.known.push(sample.reading_mm, &mut self.stream.reading_mm);
        self.stream.flags.push(flags);
        if sample.ticks.is_none() {
            self.clock = None;
        }
        self.stamps.push(ClockStamp { host, ticks: sample.ticks.unwrap_or(DeviceTicks(0)) });
    }

    /// Fits the clock and puts all samples on one time axis.
    pub fn build(self) -> SampleStream {
        let Self { clock, stamps, known, mut stream, .. } = self;
        drop(known);
        stream.time = SampleTimeline::new(stamps, clock);
        stream
    }
}

impl SampleStream {
    /// Readings beyond these ends of a stroke (mm) are not valid either, whatever the device marks.
    pub(super) fn limit_to(&mut self, [low_mm, high_mm]: [f64; 2]) {
        for at in 0..self.flags.len() {
            if !(low_mm..=high_mm).contains(&self.reading_mm[at]) {
                self.flags[at] &= !VALID;
            }
        }
    }

    /// Whether the device marked the reading of sample `at` as valid, and the bar was in its stroke.
    pub fn valid(&self, at: usize) -> bool {
        self.flags.get(at).is_some_and(|flags| flags & VALID != 0)
    }

    /// The strobe at sample `at`; `None` if the protocol does not carry it.
    pub fn strobe(&self, at: usize) -> Option<bool> {
        let flags = self.flags.get(at)?;
        (flags & STROBE_KNOWN != 0).then_some(flags & STROBE_HIGH != 0)
    }

    /// Whether samples are missing before sample `at`, by the sequence numbers.
    pub fn gap_before(&self, at: usize) -> bool {
        self.flags.get(at).is_some_and(|flags| flags & GAP_BEFORE != 0)
    }
}

/// Difference of two sequence numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SequenceStep {
    Next,
    /// Number of samples missing between the two.
    Missing(u64),
    /// A step of more than half the range counts as a step back: the device restarted.
    Back,
}

/// Compares sequence numbers, which wrap to 0 at `modulo`.
pub fn sequence_step(modulo: u32, before: u32, now: u32) -> SequenceStep {
    let modulo = u64::from(modulo).max(1);
    let missing = (u64::from(now) + 2 * modulo - u64::from(before).min(modulo) - 1) % modulo;
    match missing {
        0 => SequenceStep::Next,
        many if many > modulo / 2 => SequenceStep::Back,
        few => SequenceStep::Missing(few),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stream(samples: &[(u64, Sample)], modulo: Option<u32>) -> SampleStream {
        let mut builder = StreamBuilder::new(None).sequence(modulo);
        samples.iter().for_each(|(host_ms, sample)| builder.push(HostNs(host_ms * 1_000_000), sample));
        builder.build()
    }

    fn at_ms(hosts_ms: &[u64]) -> SampleStream {
        stream(&hosts_ms.iter().map(|host_ms| (*host_ms, Sample::of(1.0))).collect::<Vec<_>>(), None)
    }

    #[test]
    fn sequence_numbers_show_missing_samples() {
        for (before, now, expected) in [
            (3, 4, SequenceStep::Next),
            (255, 0, SequenceStep::Next),
            (3, 6, SequenceStep::Missing(2)),
            (254, 1, SequenceStep::Missing(2)),
            (0, 129, SequenceStep::Missing(128)),
            (0, 130, SequenceStep::Back),
            (3, 3, SequenceStep::Back),
            (4, 3, SequenceStep::Back),
        ] {
            assert_eq!(sequence_step(256, before, now), expected, "{before} {now}");
        }
    }

    #[test]
    fn readings_return_bit_for_bit() {
        let sent = [1.25, -0.0, 0.0, 1.25, f64::NAN, 1.25 + f64::EPSILON, -0.0];
        let stream = stream(&sent.map(|reading_mm| (0, Sample::of(reading_mm))), None);
        assert!(stream.reading_mm.iter().map(f64::to_bits).eq(sent.map(f64::to_bits)));
        assert_eq!((stream.reading_mm.len(), stream.reading_mm.different_mm.len()), (7, 5));
        assert_eq!(stream.reading_mm[5], 1.25 + f64::EPSILON);
    }

    #[test]
    fn more_different_readings_than_are_looked_for_are_kept() {
        let (mut known, mut readings) = (KnownReadings::default(), Readings::default());
        let many = (0..MAX_KNOWN + 10).map(|at| at as f64);
        many.clone().chain([3.0, MAX_KNOWN as f64]).for_each(|mm| known.push(mm, &mut readings));
        assert!(readings.iter().eq(many.chain([3.0, MAX_KNOWN as f64])));
        assert_eq!((known.0.len(), readings.different_mm.len()), (MAX_KNOWN, MAX_KNOWN + 11));
    }

    #[test]
    fn flags_of_a_sample_are_kept() {
        let sample =
            |sequence, trigger, valid| Sample { sequence: Some(sequence), trigger, valid, ..Sample::of(1.0) };
        let stream = stream(
            &[
                (0, sample(7, None, true)),
                (1, sample(8, Some(true), false)),
                (2, sample(10, Some(false), true)),
                (3, Sample { reading_mm: f64::NAN, ..sample(11, None, true) }),
            ],
            Some(16),
        );
        assert_eq!([0, 1, 2, 3, 4].map(|at| stream.valid(at)), [true, false, true, false, false]);
        assert_eq!([0, 1, 2, 4].map(|at| stream.strobe(at)), [None, Some(true), Some(false), None]);
        assert_eq!([0, 1, 2, 3].map(|at| stream.gap_before(at)), [false, false, true, false]);
    }

    #[test]
    fn times_count_from_the_first_sample_and_never_decrease() {
        let stream = at_ms(&[5_000, 5_100, 5_050, 5_200]);
        assert_eq!(stream.t_s, [0.0, 0.1, 0.1, 0.2]);
        assert_eq!([0.0, 0.05, 0.1, 0.15, 0.3].map(|t_s| stream.at(t_s)), [0, 1, 1, 3, 4]);
        assert_eq!(stream.time_of(HostNs(4_500_000_000)), Some(-0.5));
        assert_eq!(stream.host_at(-0.5), HostNs(4_500_000_000));
    }

    #[test]
    fn shift_leads_from_one_axis_to_the_other() {
        let (one, other) = (at_ms(&[5_000, 5_100]), at_ms(&[3_000, 3_100]));
        assert_eq!((one.shift_to(&other), other.shift_to(&one)), (Some(2.0), Some(-2.0)));
    }

    #[test]
    fn period_ignores_gaps() {
        let mut hosts_ms: Vec<u64> = (0..200).map(|at| 10 * at).collect();
        hosts_ms[150..].iter_mut().for_each(|host_ms| *host_ms += 5_000);
        assert!((at_ms(&hosts_ms).period_s() - 0.01).abs() < 1e-12);
        assert!((at_ms(&[0, 20, 40]).period_s() - 0.02).abs() < 1e-12);
        assert_eq!(at_ms(&[7]).period_s(), 0.0);
    }

    #[test]
    fn break_lies_after_the_start_and_up_to_the_end() {
        let mut line = at_ms(&[0, 100, 200, 300]).time;
        line.breaks = vec![2];
        let broken = |from_s, to_s| line.broken_between(from_s, to_s);
        assert!(broken(0.1, 0.2) && broken(0.0, 0.3));
        assert!(!broken(0.2, 0.3) && !broken(0.0, 0.15));
    }
}
