//! The times of samples on one clock: the device's as it lies on the host's, else the host's.

use super::device_clock::{ClockMap, DeviceClock, Stamp};
use crate::base::units::HostNs;

/// Times in the order of the samples; `t_s` never decreases.
#[derive(Clone, Debug, Default)]
pub struct Timeline {
    /// The device's clock, where it has one; its `device_s` have gone into `t_s`.
    clock: Option<ClockMap>,
    begin: HostNs,
    /// Time since the first sample, s.
    pub t_s: Vec<f64>,
    /// Samples at which the clock restarted or jumped: the time across them is a guess.
    pub breaks: Vec<usize>,
}

impl Timeline {
    /// Lays stamps on one clock; without a `clock` that of the host counts.
    pub fn new(stamps: &[Stamp], clock: Option<DeviceClock>) -> Self {
        let begin = stamps.first().map_or(HostNs(0), |stamp| stamp.host);
        let mut line = Self { begin, ..Self::default() };
        let mut latest_s = 0.0f64;
        // Neighbouring windows differ by their bounds, and a polled reading is stamped at its request.
        let mut forward = |t_s: f64| {
            latest_s = latest_s.max(t_s);
            latest_s
        };
        if let Some(clock) = clock {
            let mut map = ClockMap::new(stamps, clock);
            let first_s = map.host_s(0.0).unwrap_or(0.0);
            let on_host = |device_s: f64| map.host_s(device_s).map_or(device_s, |host_s| host_s - first_s);
            line.t_s = map.device_s.iter().map(|device_s| forward(on_host(*device_s))).collect();
            line.breaks = map.breaks.iter().map(|broken| broken.at).collect();
            map.device_s = Vec::new();
            line.clock = Some(map);
        } else {
            line.t_s = stamps.iter().map(|stamp| forward(stamp.host.seconds_since(begin))).collect();
        }
        line
    }

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

    /// What is added to a time of this line for the time of `other` at the same moment, s; `None` as for
    /// [`Self::time_of`].
    pub fn shift_to(&self, other: &Self) -> Option<f64> {
        Some(other.time_of(self.begin)? - self.time_of(self.begin)?)
    }
}
