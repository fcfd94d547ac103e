//! The measured axes that a controller publishes every cycle: KUKA RSI (UDP, XML) and UR RTDE (TCP, binary).
//!
//! Decoding is pure and never fails: a packet that is not understood is a fault with its reason, and every byte belongs
//! to a packet, to a fault, or is pending.

mod address;
pub mod rsi;
pub mod rtde;

pub use address::{Answer, AxesAddress};

use serde::{Deserialize, Serialize};

use crate::base::units::DeviceTicks;
use crate::robot::AXES;

/// The protocol over which axes come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AxesProtocol {
    /// KUKA Robot Sensor Interface: one UDP datagram each cycle of 4 or 12 ms.
    Rsi,
    /// Universal Robots Real-Time Data Exchange: packages in a TCP stream, up to 500 a second.
    Rtde,
}

/// The axes of one cycle of the controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxesSample {
    /// The controller's own clock; the tick is [`AxesProtocol::tick_ns`].
    pub ticks: DeviceTicks,
    /// As the encoders have them, degrees.
    pub measured_deg: [f64; AXES],
    /// As the controller commands them, degrees, where it sends them.
    pub commanded_deg: Option<[f64; AXES]>,
    /// How many answers came late by the controller's count (RSI `Delay`).
    pub late: Option<u32>,
}

/// What was heard.
#[derive(Clone, Debug, PartialEq)]
pub enum Heard {
    Sample(AxesSample),
    /// A package of the protocol that holds no axes, by its type.
    Control(Control),
    Fault(AxesFault),
}

/// What RTDE says besides data.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Control {
    /// Whether the controller speaks the version that was asked for.
    Version { accepted: bool },
    /// The recipe of the data that it will send; false where it does not have what was asked for.
    Recipe { accepted: bool },
    /// Whether it begins to send.
    Started { accepted: bool },
    /// Anything else, by its type.
    Other(u8),
}

/// Why a packet is not understood.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AxesFault {
    /// It is longer than any packet of the protocol.
    TooLong,
    /// It is no XML text, or another root than `Rob`.
    NotXml,
    /// An element or attribute is missing.
    Incomplete,
    /// A value is no number, or none that an axis or a clock can have.
    NotANumber,
    /// The length of a package is less than its head.
    Framing,
    /// Data of a recipe that was not agreed on, or of another length.
    OtherRecipe,
}

/// A packet, and how many bytes it took.
#[derive(Clone, Debug, PartialEq)]
pub struct Packet {
    pub heard: Heard,
    pub bytes: u64,
}

/// No axis turns further, degrees.
const MOST_DEG: f64 = 3600.0;

impl AxesProtocol {
    /// How long a tick of the controller's clock is, ns: IPOC counts milliseconds; RTDE's seconds are taken in microseconds.
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

/// Takes packets out of what came: a datagram at a time, or a stream however it is cut.
#[derive(Clone, Debug)]
pub enum AxesDecoder {
    Rsi,
    Rtde(rtde::Decoder),
}

impl AxesDecoder {
    /// Of a new connection.
    pub fn new(protocol: AxesProtocol) -> Self {
        match protocol {
            AxesProtocol::Rsi => Self::Rsi,
            AxesProtocol::Rtde => Self::Rtde(rtde::Decoder::default()),
        }
    }

    /// Takes a datagram, or the next bytes of the stream.
    pub fn push(&mut self, bytes: &[u8], mut out: impl FnMut(Packet)) {
        match self {
            Self::Rsi => {
                let heard = rsi::read(bytes).map_or_else(Heard::Fault, Heard::Sample);
                out(Packet { heard, bytes: bytes.len() as u64 });
            }
            Self::Rtde(decoder) => decoder.push(bytes, out),
        }
    }

    /// Bytes of a package that has not ended.
    pub fn pending(&self) -> u64 {
        match self {
            Self::Rsi => 0,
            Self::Rtde(decoder) => decoder.pending(),
        }
    }
}

/// Angles that an axis can have.
fn possible(angles_deg: &[f64; AXES]) -> bool {
    angles_deg.iter().all(|deg| deg.abs() <= MOST_DEG)
}
