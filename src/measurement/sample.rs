//! A reading of the bar, as it goes from the decoder into the capture and out of it to those who join and show.

use serde::{Deserialize, Serialize};

use crate::base::units::DeviceTicks;

/// One reading of the bar, as the device sent it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sample {
    /// Reading, mm; longer is positive. The distance of the balls is the bar's length plus this.
    pub reading_mm: f64,
    /// Sequence number as sent, where the protocol has one.
    pub sequence: Option<u32>,
    /// The device's own clock as sent, where it has one.
    pub ticks: Option<DeviceTicks>,
    /// Whether the controller's strobe is high, where the protocol carries it.
    pub trigger: Option<bool>,
    /// Temperature of the bar, degrees Celsius.
    pub temperature_c: Option<f64>,
    /// Whether the device itself vouches for the reading (not over, under, too fast, ..).
    pub valid: bool,
    pub status: u32,
    /// Byte offset of the frame's first byte in the stream.
    pub offset: u64,
}

impl Sample {
    /// A valid reading, mm, of a device that sends nothing else.
    pub const fn of(reading_mm: f64) -> Self {
        Self {
            reading_mm,
            sequence: None,
            ticks: None,
            trigger: None,
            temperature_c: None,
            valid: true,
            status: 0,
            offset: 0,
        }
    }
}
