//! The counts of a run.

use serde::Serialize;

use crate::recording::axes::PacketCounts;

/// How a run is going.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Progress {
    /// Host time since the beginning, s.
    pub elapsed_s: f64,
    /// Device time since the first sample, s, where the device has a clock.
    pub device_s: Option<f64>,
    /// Bytes that came.
    pub bytes: u64,
    /// Samples decoded.
    pub samples: u64,
    /// Samples that the device does not vouch for.
    pub invalid: u64,
    /// Samples per second over the last second.
    pub rate_hz: f64,
    /// The last reading, mm.
    pub reading_mm: Option<f64>,
    /// Whether the device vouches for it.
    pub valid: bool,
    /// Faults of the stream.
    pub faults: u64,
    /// Times that the device said that it has no reading.
    pub rejected: u64,
    /// Requests that were not answered in time.
    pub unanswered: u64,
    /// Gaps that were recorded.
    pub gaps: u64,
    /// Time in which nothing came for more than a second, or the port was away, s.
    pub silent_s: f64,
    /// Samples missing by their sequence numbers.
    pub missing: u64,
    /// Bytes lost between port and recorder.
    pub lost_bytes: u64,
    /// Dwells that are over, by the strobe.
    pub dwells: u32,
    /// Modules that are over, by their end marks.
    pub modules: u32,
    /// Telegrams of the program that were recorded.
    pub telegrams: u64,
    /// Telegrams that were refused: of another plan, or of no dwell.
    pub refused: u64,
    /// The packets of a controller that publishes its axes.
    pub axes: Option<PacketCounts>,
    /// Whether the frames were ever understood one after the other.
    pub in_step: bool,
    /// Whether the port is away at this moment.
    pub gone: bool,
}
