//! The samples of a run as columns, on one clock: the device's as it lies on the host's, else the host's.

use std::ops::Deref;

use super::device_clock::{DeviceClock, Stamp};
use super::timeline::Timeline;
use crate::base::units::{DeviceTicks, HostNs};
use crate::measurement::sample::Sample;

/// Samples in the order of arrival: their times, with what was read at each.
#[derive(Clone, Debug, Default)]
pub struct Stream {
    time: Timeline,
    pub reading_mm: Vec<f64>,
    flags: Vec<u8>,
}

impl Deref for Stream {
    type Target = Timeline;

    fn deref(&self) -> &Timeline {
        &self.time
    }
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
        stream.time = Timeline::new(&stamps, clock);
        stream
    }
}

impl Stream {
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
