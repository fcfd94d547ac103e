//! Settings of a serial line: `[line]` of a definition.

use std::time::Duration;

use serde::{Deserialize, Deserializer};

#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LineSettings {
    /// Symbols per second.
    pub baud: u32,
    /// Further rates that are tried if the device does not answer.
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
    /// Level after opening; unchanged if absent.
    #[serde(default, deserialize_with = "level")]
    pub dtr: Option<bool>,
    /// Level after opening; unchanged if absent.
    #[serde(default, deserialize_with = "level")]
    pub rts: Option<bool>,
    /// Time after opening until the device listens.
    #[serde(default, rename = "settle_ms", deserialize_with = "ms")]
    pub settle: Duration,
    /// The eighth bit is parity, from adapters without 7-bit mode.
    #[serde(default)]
    pub(crate) strip_bit7: bool,
}

fn eight() -> u8 {
    8
}

fn one() -> u8 {
    1
}

pub(crate) fn ms<'de, D: Deserializer<'de>>(value: D) -> Result<Duration, D::Error> {
    u32::deserialize(value).map(|ms| Duration::from_millis(ms.into()))
}

/// Level of a modem line.
fn level<'de, D: Deserializer<'de>>(value: D) -> Result<Option<bool>, D::Error> {
    #[derive(Deserialize)]
    #[serde(rename_all = "lowercase")]
    enum ModemLineLevel {
        Keep,
        On,
        Off,
    }
    Ok(match ModemLineLevel::deserialize(value)? {
        ModemLineLevel::Keep => None,
        ModemLineLevel::On => Some(true),
        ModemLineLevel::Off => Some(false),
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

/// Flow control: by the characters XON and XOFF, or by the wires RTS and CTS.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Flow {
    #[default]
    None,
    XonXoff,
    RtsCts,
}
