//! `[line]` of a definition: how the serial line is set.

use std::time::Duration;

use serde::{Deserialize, Deserializer};

#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Line {
    /// Symbols per second.
    pub baud: u32,
    /// Further rates that the device may be set to; tried where it does not answer.
    #[serde(default)]
    pub baud_probe: Vec<u32>,
    #[serde(default = "eight", rename = "bits")]
    pub data_bits: u8,
    #[serde(default)]
    pub parity: Parity,
    #[serde(default = "one", rename = "stop")]
    pub stop_bits: u8,
    #[serde(default)]
    pub flow: Flow,
    /// Level after opening; left alone when absent.
    #[serde(default, deserialize_with = "level")]
    pub dtr: Option<bool>,
    /// Level after opening; left alone when absent.
    #[serde(default, deserialize_with = "level")]
    pub rts: Option<bool>,
    /// How long the device needs after opening before it listens.
    #[serde(default, rename = "settle_ms", deserialize_with = "ms")]
    pub settle: Duration,
    /// The eighth bit is no data: adapters that cannot do 7 bits pass the parity on in it.
    #[serde(default)]
    pub(super) strip_bit7: bool,
}

fn eight() -> u8 {
    8
}

fn one() -> u8 {
    1
}

/// A time in whole milliseconds.
pub(super) fn ms<'de, D: Deserializer<'de>>(value: D) -> Result<Duration, D::Error> {
    u32::deserialize(value).map(|ms| Duration::from_millis(ms.into()))
}

/// Of a modem wire.
fn level<'de, D: Deserializer<'de>>(value: D) -> Result<Option<bool>, D::Error> {
    #[derive(Deserialize)]
    #[serde(rename_all = "lowercase")]
    enum Wire {
        Keep,
        On,
        Off,
    }
    Ok(match Wire::deserialize(value)? {
        Wire::Keep => None,
        Wire::On => Some(true),
        Wire::Off => Some(false),
    })
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Parity {
    #[default]
    None,
    Even,
    Odd,
}

/// By the characters XON and XOFF, or by the wires RTS and CTS.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Flow {
    #[default]
    None,
    XonXoff,
    RtsCts,
}
