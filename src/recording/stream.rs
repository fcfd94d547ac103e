//! The samples of a run as columns, on one clock: the device's as it lies on the host's, else the host's.

use super::device_clock::{ClockMap, DeviceClock, Stamp};
use crate::base::units::{DeviceTicks, HostNs};
use crate::measurement::sample::Sample;

/// Samples in the order of arrival; `t_s` never decreases.
#[derive(Clone, Debug, Default)]
pub struct Stream {
    /// The device's clock, where it has one; its `device_s` have gone into `t_s`.
    clock: Option<ClockMap>,
    begin: HostNs,
    /// Time since the first sample, s.
    pub t_s: Vec<f64>,
    pub reading_mm: Vec<f64>,
    flags: Vec<u8>,
    /// Samples at which the clock restarted or jumped: the time across them is a guess.
    pub breaks: Vec<usize>,
}

/// A stream whose samples are still coming: only all of them together give the device's time.
#[derive(Clone, Debug)]
pub struct StreamBuilder {
    clock: Option<DeviceClock>,
    sequence_modulo: Option<u32>,
    stamps: Vec<Stamp>,
    last_sequence: Option<u32>,
    stream: Stream,
}

const VALID: u8 = 1;
const STROBE_KNOWN: u8 = 2;
const STROBE_HIGH: u8 = 4;
const GAP_BEFORE: u8 = 8;

impl StreamBuilder {
    /// An empty stream; without a `clock`, or where a sample has no ticks, the host's stamps count.
    pub fn new(clock: Option<DeviceClock>) -> Self {
        let stream = Stream::default();
        Self { clock, sequence_modulo: None, stamps: Vec::new(), last_sequence: None, stream }
    }

    /// With the modulo of the sequence numbers: missing samples are then known.
    #[must_use]
    pub fn sequence(self, modulo: Option<u32>) -> Self {
        Self { sequence_modulo: modulo, ..self }
    }

    /// Appends the sample that arrived at `host`.
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
        self.stream.reading_mm.push(sample.reading_mm);
        self.stream.flags.push(flags);
        if sample.ticks.is_none() {
            self.clock = None;
        }
        self.stamps.push(Stamp { host, ticks: sample.ticks.unwrap_or(DeviceTicks(0)) });
    }

    /// Lays all samples on one clock.
    pub fn build(self) -> Stream {
        let Self { clock, stamps, mut stream, .. } = self;
        stream.begin = stamps.first().map_or(HostNs(0), |stamp| stamp.host);
        let mut latest_s = 0.0f64;
        // Neighbouring windows differ by their bounds, and a polled reading is stamped at its request.
        let mut forward = |t_s: f64| {
            latest_s = latest_s.max(t_s);
            latest_s
        };
        if let Some(clock) = clock {
            let mut map = ClockMap::new(&stamps, clock);
            let first_s = map.host_s(0.0).unwrap_or(0.0);
            let on_host = |device_s: f64| map.host_s(device_s).map_or(device_s, |host_s| host_s - first_s);
            stream.t_s = map.device_s.iter().map(|device_s| forward(on_host(*device_s))).collect();
            stream.breaks = map.breaks.iter().map(|broken| broken.at).collect();
            map.device_s = Vec::new();
            stream.clock = Some(map);
        } else {
            stream.t_s = stamps.iter().map(|stamp| forward(stamp.host.seconds_since(stream.begin))).collect();
        }
        stream
    }
}

impl Stream {
    /// The device's clock against the host's, where the protocol carries one; without `device_s`.
    pub fn clock(&self) -> Option<&ClockMap> {
        self.clock.as_ref()
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.t_s.len()
    }

    /// Whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.t_s.is_empty()
    }

    /// Whether the device vouches for the reading of sample `at`.
    pub fn valid(&self, at: usize) -> bool {
        self.flags.get(at).is_some_and(|flags| flags & VALID != 0)
    }

    /// Whether the strobe is high at sample `at`; `None` where the protocol does not carry it.
    pub fn strobe(&self, at: usize) -> Option<bool> {
        let flags = self.flags.get(at)?;
        (flags & STROBE_KNOWN != 0).then_some(flags & STROBE_HIGH != 0)
    }

    /// Whether the sequence numbers say that samples are missing before sample `at`.
    pub fn gap_before(&self, at: usize) -> bool {
        self.flags.get(at).is_some_and(|flags| flags & GAP_BEFORE != 0)
    }

    /// The first sample at or after `t_s`.
    pub fn at(&self, t_s: f64) -> usize {
        self.t_s.partition_point(|&t| t < t_s)
    }

    /// Whether the clock broke in (`from_s`, `to_s`].
    pub fn broken_between(&self, from_s: f64, to_s: f64) -> bool {
        let first = self.breaks.partition_point(|&at| self.t_s[at] <= from_s);
        self.breaks.get(first).is_some_and(|&at| self.t_s[at] <= to_s)
    }

    /// Mean time between samples, robust against gaps and against stamps in batches, s.
    pub fn period_s(&self) -> f64 {
        const RUN: usize = 50;
        let run = RUN.min(self.len().saturating_sub(1)).max(1);
        let stride = (self.len() / 4000).max(1);
        let mut spans: Vec<f64> = (run..self.len())
            .step_by(stride)
            .map(|at| (self.t_s[at] - self.t_s[at - run]) / run as f64)
            .collect();
        crate::math::robust::median(&mut spans).unwrap_or(0.0)
    }

    /// The stream's time of a host stamp; `None` when the device's clock does not run at the host's pace
    /// (a run faster than real time), so that the two cannot be compared.
    pub fn time_of(&self, host: HostNs) -> Option<f64> {
        let first_s = match &self.clock {
            Some(map) => map.host_s(0.0)?,
            None => 0.0,
        };
        Some(host.seconds_since(self.begin) - first_s)
    }
}

/// From one sequence number to the next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SequenceStep {
    Next,
    /// So many samples are missing between the two.
    Missing(u64),
    /// More than half of the range ahead is a step back: the device began again.
    Back,
}

/// Compares sequence numbers, which begin again from 0 at `modulo`.
pub fn sequence_step(modulo: u32, before: u32, now: u32) -> SequenceStep {
    let modulo = u64::from(modulo).max(1);
    let missing = (u64::from(now) + 2 * modulo - u64::from(before).min(modulo) - 1) % modulo;
    match missing {
        0 => SequenceStep::Next,
        many if many > modulo / 2 => SequenceStep::Back,
        few => SequenceStep::Missing(few),
    }
}
