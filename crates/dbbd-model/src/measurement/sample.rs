use serde::{Deserialize, Serialize};

use crate::base::units::DeviceTicks;

/// One sample of the bar, as the device sent it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sample {
    /// Measured length minus the bar's nominal length, mm.
    pub reading_mm: f64,
    /// Sequence number, if the protocol has one.
    pub sequence: Option<u32>,
    /// The device's clock, if it has one.
    pub ticks: Option<DeviceTicks>,
    /// Whether the controller's strobe is high, if the protocol carries it.
    pub trigger: Option<bool>,
    /// Temperature of the bar, degrees Celsius.
    pub temperature_c: Option<f64>,
    /// Whether the device itself reports the reading as valid (not over range, too fast, ..).
    pub valid: bool,
    pub status: u32,
    /// Offset of the frame's first byte in the stream.
    pub offset: u64,
}

impl Sample {
    /// A valid sample of a device that sends nothing but the reading.
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
