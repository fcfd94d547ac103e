//! What a decoder gives: samples, and faults that account for every other byte.

use serde::{Deserialize, Serialize};

use crate::units::DeviceTicks;

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
    /// The status bits as sent.
    pub status: u32,
    /// Byte offset of the frame's first byte in the stream.
    pub offset: u64,
}

/// Bytes that did not become a sample, and why.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fault {
    /// What kind of fault.
    pub kind: FaultKind,
    /// Byte offset of the first byte in the stream.
    pub offset: u64,
    /// Number of bytes that it covers.
    pub bytes: u64,
}

/// Why bytes did not become a sample.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FaultKind {
    /// Not a frame of this protocol.
    Framing,
    /// A frame whose check does not match.
    Check,
    /// A frame that is longer than the protocol allows.
    TooLong,
    /// A frame with an intact check whose content has no meaning here.
    Content,
    /// The device said that it has no reading, with its own word for it.
    Reject(String),
    /// Echo, banner or another record that the definition says to pass over.
    Ignored,
}
