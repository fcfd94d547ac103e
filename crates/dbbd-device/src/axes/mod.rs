//! The measured axes that a controller publishes every cycle: KUKA RSI (UDP, XML) and UR RTDE (TCP, binary).
//!
//! Decoding is pure and never fails: an invalid packet is a fault with its reason, and every byte belongs to a
//! packet, to a fault, or is pending.

mod catalogue;
pub use catalogue::AxesFinding;

mod address;
pub mod rsi;
pub mod rtde;

pub use address::{AxesAddress, RsiAnswer};

use serde::{Deserialize, Serialize};

use dbbd_model::base::units::DeviceTicks;
use dbbd_model::robot::AXES;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AxesProtocol {
    /// KUKA Robot Sensor Interface: a UDP datagram per cycle of 4 or 12 ms.
    Rsi,
    /// Universal Robots Real-Time Data Exchange: packages in a TCP stream, up to 500 per second.
    Rtde,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxesSample {
    /// Clock of the controller; its tick is [`AxesProtocol::tick_ns`].
    pub ticks: DeviceTicks,
    /// Axis angles measured by the encoders, degrees.
    pub measured_deg: [f64; AXES],
    /// Axis angles commanded by the controller, degrees, if it sends them.
    pub commanded_deg: Option<[f64; AXES]>,
    /// Measured positions of the external axes E1 to E6, mm or degrees, if the controller sends them; 0 for one that is not there.
    pub external: Option<[f64; EXTERNAL_AXES]>,
    /// Number of late answers as counted by the controller (RSI `Delay`).
    pub late: Option<u32>,
}

/// The rails and tables that a controller moves beside the robot, at most.
pub const EXTERNAL_AXES: usize = 6;

#[derive(Clone, Debug, PartialEq)]
pub enum PacketContent {
    Sample(AxesSample),
    /// The answer to a request of RTDE.
    Answer {
        accepted: bool,
    },
    /// A package without axes.
    Other,
    Fault(AxesFault),
}

/// Why a packet is invalid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AxesFault {
    /// Longer than any packet of the protocol.
    TooLong,
    /// Not XML, or another root than `Rob`.
    NotXml,
    /// An element or attribute is missing.
    Incomplete,
    /// A value is not a number, or impossible for an axis or a clock.
    NotANumber,
    /// A package is shorter than its head.
    Framing,
    /// Data of another recipe or length.
    OtherRecipe,
}

#[derive(Clone, Debug, PartialEq)]
pub struct AxesPacket {
    pub content: PacketContent,
    pub bytes: u64,
}

/// Limit of axis angles, degrees.
pub const MAX_AXIS_DEG: f64 = 3600.0;

impl AxesProtocol {
    /// Tick of the controller's clock, ns: IPOC counts milliseconds; seconds of RTDE are converted to microseconds.
    pub const fn tick_ns(self) -> u32 {
        match self {
            Self::Rsi => 1_000_000,
            Self::Rtde => 1_000,
        }
    }

    pub const fn name(self) -> &'static str {
        match self {
            Self::Rsi => "rsi",
            Self::Rtde => "rtde",
        }
    }
}

/// Extracts packets from datagrams, or from a stream however it is split.
#[derive(Clone, Debug)]
pub enum AxesDecoder {
    Rsi,
    Rtde(rtde::RtdeDecoder),
}

impl AxesDecoder {
    pub fn new(protocol: AxesProtocol) -> Self {
        match protocol {
            AxesProtocol::Rsi => Self::Rsi,
            AxesProtocol::Rtde => Self::Rtde(rtde::RtdeDecoder::default()),
        }
    }

    /// Decodes a datagram, or the next bytes of the stream.
    pub fn push(&mut self, bytes: &[u8], mut out: impl FnMut(AxesPacket)) {
        match self {
            Self::Rsi => {
                let content =
                    rsi::read_datagram(bytes).map_or_else(PacketContent::Fault, PacketContent::Sample);
                out(AxesPacket { content, bytes: bytes.len() as u64 });
            }
            Self::Rtde(decoder) => decoder.push(bytes, out),
        }
    }

    /// Number of bytes of an incomplete package.
    pub fn pending(&self) -> u64 {
        match self {
            Self::Rsi => 0,
            Self::Rtde(decoder) => decoder.pending(),
        }
    }
}

fn possible(angles_deg: &[f64; AXES]) -> bool {
    angles_deg.iter().all(|deg| deg.abs() <= MAX_AXIS_DEG)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_milliseconds_and_microseconds() {
        assert_eq!(AxesProtocol::Rsi.tick_ns(), 1_000_000);
        assert_eq!(AxesProtocol::Rtde.tick_ns(), 1_000);
    }

    #[test]
    fn datagram_is_decoded_whole() {
        let mut decoder = AxesDecoder::new(AxesProtocol::Rsi);
        let mut packets = Vec::new();
        decoder.push(b"<Rob/>", |packet| packets.push(packet));
        assert_eq!(packets, [AxesPacket { content: PacketContent::Fault(AxesFault::Incomplete), bytes: 6 }]);
        assert_eq!(decoder.pending(), 0);
        let mut decoder = AxesDecoder::new(AxesProtocol::Rtde);
        decoder.push(&[0, 9, 85], |_| ());
        assert_eq!(decoder.pending(), 3);
    }
}
