//! A compiled definition of a device.

use std::sync::Arc;
use std::time::Duration;

use super::check::FrameCheck;
use super::decoder::ProtocolDecoder;
use super::encoder::ProtocolEncoder;
use super::engine::ProtocolEngine;
use super::field::{STROBE, TickCounter};
use super::layout::{self, LayoutPart};
use crate::port::{LineSettings, ms};
use serde::{Deserialize, Deserializer};

/// Further behaviour of a virtual device.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulationTable {
    /// Value that the device sends at a reading of 0 of the bar, mm.
    #[serde(default)]
    pub at_mm: f64,
    #[serde(default, rename = "reply_delay_ms", deserialize_with = "ms")]
    pub reply_delay: Duration,
    /// Bytes that the device sends when it is switched on.
    #[serde(default, deserialize_with = "text")]
    pub banner: Vec<u8>,
}

fn text<'de, D: Deserializer<'de>>(value: D) -> Result<Vec<u8>, D::Error> {
    String::deserialize(value).map(String::into_bytes)
}

#[derive(Clone, Debug)]
pub struct ProtocolDefinition {
    pub id: String,
    pub title: String,
    /// Sources of the facts.
    pub source: Vec<String>,
    /// documented, captured, own or guess.
    pub confidence: &'static str,
    /// Devices on which it was tested.
    pub tested_on: Vec<String>,
    /// The file, with the parameters in force as its defaults.
    pub text: String,
    /// Names and values of the parameters in force.
    pub params: Vec<(String, String)>,
    pub line: LineSettings,
    pub clock: Option<TickCounter>,
    /// Sequence numbers wrap to 0 at this value.
    pub sequence_modulo: Option<u32>,
    /// Silence of a streaming device that counts as a gap.
    pub stall: Option<Duration>,
    /// Consecutive samples after which the decoder is synchronised.
    pub sync_frames: u32,
    /// Samples per second of a streaming device, if known.
    pub nominal_hz: Option<f64>,
    pub mode: ProtocolMode,
    /// Whether a reading is taken at its request.
    pub latch_at_request: bool,
    /// Time from the latch event (request, first byte) to the reading.
    pub latch_delay: Duration,
    /// Uncertainty of the latch delay.
    pub latch_jitter: Duration,
    /// Silence that terminates a frame, if silence does.
    pub idle: Option<Duration>,
    pub sim: SimulationTable,
    /// Identifies the device at opening; empty if it cannot be queried.
    pub ident: Vec<CommandStep>,
    /// Sets the reading to zero; empty if there is no such command.
    pub zero: Vec<CommandStep>,
    /// Configures the device after opening.
    pub init: Vec<CommandStep>,
    /// Requests a reading.
    pub poll: Vec<CommandStep>,
    /// Starts streaming.
    pub start: Vec<CommandStep>,
    /// Stops streaming.
    pub stop: Vec<CommandStep>,
    pub(super) engine: Arc<ProtocolEngine>,
}

/// The side that speaks first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ProtocolMode {
    /// The device, by itself.
    Stream,
    /// The host, at this rate; a reply after the timeout is lost.
    Poll { hz: f64, timeout: Duration },
    /// The device, when its key is pressed.
    Push,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CommandStep {
    /// Send bytes until the answer is received.
    Ask {
        send: Vec<u8>,
        expect: Vec<u8>,
        timeout: Duration,
        retries: u32,
    },
    /// Lower DTR for this time.
    DtrPulse(Duration),
    Send(Vec<u8>),
    Wait(Duration),
    /// Discard input until the line is quiet for this time.
    Drain(Duration),
}

impl ProtocolDefinition {
    /// Resolution of the reading, mm; 0 for floating-point numbers.
    pub fn resolution_mm(&self) -> f64 {
        self.engine.resolution_mm()
    }

    /// The fields of a frame.
    pub fn layout(&self) -> Vec<LayoutPart> {
        layout::parts(&self.engine)
    }

    /// The framing in words.
    pub fn framing(&self) -> String {
        layout::frame(&self.engine.framing)
    }

    /// Share of damaged frames of the right form that pass the check; 1 without a check.
    pub fn undetected(&self) -> f64 {
        self.engine.check.as_ref().map_or(1.0, FrameCheck::undetected)
    }

    pub fn decoder(&self) -> ProtocolDecoder {
        ProtocolDecoder::new(Arc::clone(&self.engine))
    }

    pub fn encoder(&self) -> ProtocolEncoder {
        ProtocolEncoder::new(Arc::clone(&self.engine))
    }

    /// Whether samples carry the strobe of the controller.
    pub fn has_strobe(&self) -> bool {
        self.flags(u32::MAX).contains(&STROBE)
    }

    /// Names of the flags set in a status, lowest bit first.
    pub fn flags(&self, status: u32) -> Vec<&str> {
        self.engine.flags(status)
    }
}
