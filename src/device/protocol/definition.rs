//! A device's definition, ready for use.

use std::sync::Arc;
use std::time::Duration;

use super::check::Check;
use super::decoder::Decoder;
use super::encoder::Encoder;
use super::engine::Engine;
use super::field::STROBE;
use super::layout::{self, Part};
use super::line::Line;
use super::table::Sim;

/// A device: its line, its commands, its clock, and how its bytes are read and written.
#[derive(Clone, Debug)]
pub struct Definition {
    pub id: String,
    pub title: String,
    /// Where the facts come from.
    pub source: Vec<String>,
    /// How well it is known: documented, captured, own or guess.
    pub confidence: &'static str,
    /// Devices on which it was tried.
    pub tested_on: Vec<String>,
    /// The file's text, for the record; its defaults are the parameters in force.
    pub text: String,
    /// The parameters in force: names and values.
    pub params: Vec<(String, String)>,
    pub line: Line,
    pub clock: Option<Clock>,
    /// The sequence number counts from 0 to this less one, where there is one.
    pub sequence_modulo: Option<u32>,
    /// Silence that counts as a gap, where the device streams.
    pub stall: Option<Duration>,
    /// Samples in a row after which the decoder may be called in step.
    pub sync_frames: u32,
    /// Samples per second that the device sends by itself, where that is known.
    pub nominal_hz: Option<f64>,
    pub mode: Mode,
    /// Whether a reading is that of the moment of its request.
    pub latch_at_request: bool,
    /// How long after its latch event (request, first byte) the reading was taken.
    pub latch_delay: Duration,
    /// How uncertain that is.
    pub latch_jitter: Duration,
    /// Silence that ends a frame, where silence does.
    pub idle: Option<Duration>,
    pub sim: Sim,
    /// What it must answer to at opening; empty where it cannot be asked.
    pub ident: Vec<Step>,
    /// What sets its reading to zero; empty where nothing does.
    pub zero: Vec<Step>,
    /// What sets it up after opening.
    pub init: Vec<Step>,
    /// What asks for a reading.
    pub poll: Vec<Step>,
    /// What makes it send.
    pub start: Vec<Step>,
    /// What makes it silent.
    pub stop: Vec<Step>,
    pub(super) engine: Arc<Engine>,
}

/// A device's counter of time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Clock {
    pub tick_ns: u32,
    /// The counter starts again from 0 after 2^wrap_bits ticks.
    pub wrap_bits: u32,
}

/// Who speaks first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mode {
    /// The device, by itself.
    Stream,
    /// The host, so many times a second; a reply that does not come in time is a loss.
    Poll { hz: f64, timeout: Duration },
    /// The device, when its key is pressed.
    Push,
}

/// A step of a command.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Step {
    /// Send these bytes until the answer has come.
    Ask {
        send: Vec<u8>,
        expect: Vec<u8>,
        timeout: Duration,
        /// How often it is sent again.
        retries: u32,
    },
    /// Lower DTR for so long.
    DtrPulse(Duration),
    Send(Vec<u8>),
    Wait(Duration),
    /// Throw away what comes until the line has been quiet for this long.
    Drain(Duration),
}

impl Definition {
    /// The step between two readings that it can tell apart, mm; 0 for floating-point numbers.
    pub fn resolution_mm(&self) -> f64 {
        self.engine.resolution_mm()
    }

    /// The content of a frame, field by field.
    pub fn layout(&self) -> Vec<Part> {
        layout::parts(&self.engine)
    }

    /// What is around the content of a frame, in words.
    pub fn framing(&self) -> String {
        layout::frame(&self.engine.framing)
    }

    /// The share of damaged frames of the right form that pass for good ones; 1 without a check.
    pub fn undetected(&self) -> f64 {
        self.engine.check.as_ref().map_or(1.0, Check::undetected)
    }

    pub fn decoder(&self) -> Decoder {
        Decoder::new(Arc::clone(&self.engine))
    }

    pub fn encoder(&self) -> Encoder {
        Encoder::new(Arc::clone(&self.engine))
    }

    /// Whether its samples carry the controller's strobe.
    pub fn has_strobe(&self) -> bool {
        self.flags(u32::MAX).contains(&STROBE)
    }

    /// The names of the flags that are set in a sample's status, lowest bit first.
    pub fn flags(&self, status: u32) -> Vec<&str> {
        self.engine.flags(status)
    }
}
