//! A device's definition, ready for use.

use std::sync::Arc;
use std::time::Duration;

use super::decoder::Decoder;
use super::encoder::Encoder;
use super::engine::Engine;
use super::loader;
use super::table::{Flow, Parity};
use crate::diag::Diagnostic;

/// The definitions that come with dbbd: name and file.
const BUILT_IN: &[(&str, &str)] = &[
    ("dbb-cobs-1", include_str!("../../protocols/dbb-cobs-1.toml")),
    ("dbb-nmea-1", include_str!("../../protocols/dbb-nmea-1.toml")),
    ("dbb-csv-1", include_str!("../../protocols/dbb-csv-1.toml")),
];

/// A device: its line, its commands, its clock, and how its bytes are read and written.
#[derive(Clone, Debug)]
pub struct Definition {
    /// Name.
    pub id: String,
    /// What it is, in words.
    pub title: String,
    /// Where the facts come from.
    pub source: Vec<String>,
    /// How well it is known: documented, captured, own or guess.
    pub confidence: &'static str,
    /// Devices on which it was tried.
    pub tested_on: Vec<String>,
    /// The file's text, for the record.
    pub text: String,
    /// The serial line.
    pub line: Line,
    /// The device's clock, where it has one.
    pub clock: Option<Clock>,
    /// The sequence number counts from 0 to this less one, where there is one.
    pub sequence_modulo: Option<u32>,
    /// Silence that counts as a gap, where the device streams.
    pub stall: Option<Duration>,
    /// Samples in a row after which the decoder may be called in step.
    pub sync_frames: u32,
    /// Samples per second that the device sends by itself, where that is known.
    pub nominal_hz: Option<f64>,
    /// What makes it send.
    pub start: Vec<Step>,
    /// What makes it silent.
    pub stop: Vec<Step>,
    pub(super) engine: Arc<Engine>,
}

/// Settings of the serial line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Line {
    /// Symbols per second.
    pub baud: u32,
    /// Data bits: 7 or 8.
    pub data_bits: u8,
    /// Parity.
    pub parity: Parity,
    /// Stop bits: 1 or 2.
    pub stop_bits: u8,
    /// Flow control.
    pub flow: Flow,
    /// Level of DTR after opening; left alone when absent.
    pub dtr: Option<bool>,
    /// Level of RTS after opening; left alone when absent.
    pub rts: Option<bool>,
    /// How long the device needs after opening before it listens.
    pub settle: Duration,
}

/// A device's counter of time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Clock {
    /// Length of a tick, ns.
    pub tick_ns: u32,
    /// The counter starts again from 0 after 2^wrap_bits ticks.
    pub wrap_bits: u32,
}

/// A step of a command.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Step {
    /// Send these bytes.
    Send(Vec<u8>),
    /// Wait.
    Wait(Duration),
    /// Throw away what comes until the line has been quiet for this long.
    Drain(Duration),
}

impl Definition {
    /// Names and files of the definitions that are built in.
    pub fn built_in() -> &'static [(&'static str, &'static str)] {
        BUILT_IN
    }

    /// A built-in definition by its name, if there is one.
    pub fn by_name(name: &str) -> Option<Result<Self, Diagnostic>> {
        let (_, text) = BUILT_IN.iter().find(|(built_in, _)| *built_in == name)?;
        Some(Self::from_toml(name, text))
    }

    /// Reads, checks and compiles a definition; its own test vectors are run.
    ///
    /// # Errors
    /// Names the line of what is unknown, missing, contradictory or does not give what its test expects.
    pub fn from_toml(file: &str, text: &str) -> Result<Self, Diagnostic> {
        loader::load(file, text)
    }

    /// A decoder at the start of a stream.
    pub fn decoder(&self) -> Decoder {
        Decoder::new(Arc::clone(&self.engine))
    }

    /// An encoder, for a virtual device.
    pub fn encoder(&self) -> Encoder {
        Encoder::new(Arc::clone(&self.engine))
    }

    /// The names of the flags that are set in a sample's status, lowest bit first.
    pub fn flags(&self, status: u32) -> Vec<&str> {
        self.engine.flags(status)
    }
}
