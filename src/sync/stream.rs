//! The samples of a run as columns, on one clock: the device's where it has one, else the host's.

use crate::protocol::Sample;
use crate::units::HostNs;

/// The device's counter, as the protocol defines it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeviceClock {
    /// Length of a tick, s.
    pub seconds_per_tick: f64,
    /// Number of ticks after which the counter begins again at 0, if it does.
    pub wrap: Option<u64>,
}

/// Samples in the order of arrival; `t_s` never decreases.
#[derive(Clone, Debug, Default)]
pub struct Stream {
    clock: Option<DeviceClock>,
    last: Option<Last>,
    begin: HostNs,
    /// Time since the first sample, s.
    pub t_s: Vec<f64>,
    /// Readings, mm.
    pub reading_mm: Vec<f64>,
    flags: Vec<u8>,
    /// Samples at which the clock restarted or jumped: the time across them is a guess.
    pub breaks: Vec<usize>,
    delays: Vec<Delay>,
}

#[derive(Clone, Copy, Debug)]
struct Last {
    host: HostNs,
    ticks: Option<u64>,
    sequence: Option<u32>,
}

/// The least delay of the host's stamps against the stream's time within a window.
#[derive(Clone, Copy, Debug)]
struct Delay {
    window: f64,
    t_s: f64,
    delay_s: f64,
}

const VALID: u8 = 1;
const TRIGGER_KNOWN: u8 = 2;
const TRIGGER_HIGH: u8 = 4;
const GAP_BEFORE: u8 = 8;

/// A step that the host's clock did not see and that is longer than this is no step of time, s.
const JUMP_S: f64 = 2.0;
/// Width of the windows of least delay, s: wide enough to hold an undelayed sample, short against drift.
const DELAY_WINDOW_S: f64 = 10.0;

impl Stream {
    /// An empty stream; without a `clock`, or for samples without ticks, the host's stamps count.
    pub fn new(clock: Option<DeviceClock>) -> Self {
        Self { clock, ..Self::default() }
    }

    /// Appends the sample that arrived at `host`.
    pub fn push(&mut self, host: HostNs, sample: &Sample) {
        let ticks = sample.ticks.map(|ticks| ticks.0);
        let mut flags = u8::from(sample.valid && sample.reading_mm.is_finite()) * VALID;
        match sample.trigger {
            Some(true) => flags |= TRIGGER_KNOWN | TRIGGER_HIGH,
            Some(false) => flags |= TRIGGER_KNOWN,
            None => {}
        }
        let mut t_s = 0.0;
        if let Some(last) = self.last {
            let host_s = host.seconds_since(last.host).max(0.0);
            let (step_s, broken) = match (self.clock, last.ticks, ticks) {
                (Some(clock), Some(from), Some(to)) => clock.step(from, to, host_s),
                _ => (host_s, false),
            };
            t_s = self.t_s.last().copied().unwrap_or(0.0) + step_s;
            if broken {
                self.breaks.push(self.t_s.len());
            }
            if let (Some(before), Some(now)) = (last.sequence, sample.sequence)
                && !follows(before, now)
            {
                flags |= GAP_BEFORE;
            }
        } else {
            self.begin = host;
        }
        // A batch that the host read at once has one stamp; its last sample must not set the clock back.
        let host_last = self.last.map_or(host, |last| last.host.max(host));
        self.last = Some(Last { host: host_last, ticks, sequence: sample.sequence });
        self.t_s.push(t_s);
        self.reading_mm.push(sample.reading_mm);
        self.flags.push(flags);
        self.note_delay(t_s, host.seconds_since(self.begin) - t_s);
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
    pub fn trigger(&self, at: usize) -> Option<bool> {
        let flags = self.flags.get(at)?;
        (flags & TRIGGER_KNOWN != 0).then_some(flags & TRIGGER_HIGH != 0)
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
        super::robust::median(&mut spans).unwrap_or(0.0)
    }

    /// The stream's time of a host stamp; `None` when the device's clock does not run at the host's pace
    /// (a run faster than real time), so that the two cannot be compared.
    ///
    /// A stamp is late by the transport's delay, so the least delay nearby is nearest to the truth.
    pub fn time_of(&self, host: HostNs) -> Option<f64> {
        const NEAR_S: f64 = 30.0;
        const PACE: f64 = 0.01;
        let host_s = host.seconds_since(self.begin);
        let from = self.delays.partition_point(|delay| delay.t_s + delay.delay_s < host_s - NEAR_S);
        let near =
            self.delays[from..].iter().take_while(|delay| delay.t_s + delay.delay_s <= host_s + NEAR_S);
        let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
        for delay in near {
            least = least.min(delay.delay_s);
            most = most.max(delay.delay_s);
        }
        (least.is_finite() && most - least < PACE * 2.0 * NEAR_S).then_some(host_s - least)
    }

    fn note_delay(&mut self, t_s: f64, delay_s: f64) {
        let window = (t_s / DELAY_WINDOW_S).floor();
        match self.delays.last_mut() {
            Some(delay) if delay.window == window => {
                if delay_s < delay.delay_s {
                    *delay = Delay { window, t_s, delay_s };
                }
            }
            _ => self.delays.push(Delay { window, t_s, delay_s }),
        }
    }
}

impl DeviceClock {
    /// Seconds from tick `from` to tick `to`, with the host's elapsed time as witness, and whether the
    /// counter broke. Samples arrive in batches and late, so only a gross contradiction counts.
    fn step(self, from: u64, to: u64, host_s: f64) -> (f64, bool) {
        let seconds = |ticks: u64| ticks as f64 * self.seconds_per_tick;
        let wrapped = self.wrap.filter(|wrap| from < *wrap && to < *wrap);
        let step_s = match wrapped {
            _ if to >= from => seconds(to - from),
            Some(wrap) => seconds(wrap - from + to),
            None => return (host_s, true),
        };
        if to < from && step_s > JUMP_S + 2.0 * host_s {
            return (host_s, true);
        }
        if let Some(wrap) = wrapped {
            let unseen = ((host_s - step_s) / seconds(wrap)).round();
            if unseen >= 1.0 {
                return (step_s + unseen * seconds(wrap), false);
            }
        }
        (step_s, step_s > JUMP_S + 2.0 * host_s)
    }
}

/// Whether `now` is the number after `before`, in a counter of 8, 16 or 32 bits.
fn follows(before: u32, now: u32) -> bool {
    before.checked_add(1) == Some(now) || (now == 0 && [0xff, 0xffff, u32::MAX].contains(&before))
}
