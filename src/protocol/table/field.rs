//! The keys of one field in a definition file.

use std::collections::BTreeMap;

use serde::Deserialize;

/// One field; which keys it may have depends on its kind and role.
#[derive(Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::protocol) struct FieldTable {
    pub(in crate::protocol) kind: FieldKind,
    pub(in crate::protocol) role: Option<RoleName>,
    pub(in crate::protocol) bytes: Option<usize>,
    pub(in crate::protocol) bits: Option<usize>,
    pub(in crate::protocol) endian: Option<Endian>,
    pub(in crate::protocol) text: Option<String>,
    pub(in crate::protocol) decimals: Option<usize>,
    pub(in crate::protocol) digits: Option<usize>,
    pub(in crate::protocol) modulo: Option<u32>,
    pub(in crate::protocol) tick_ns: Option<u32>,
    pub(in crate::protocol) wrap_bits: Option<u32>,
    pub(in crate::protocol) unit: Option<Unit>,
    pub(in crate::protocol) scale_num: Option<u32>,
    pub(in crate::protocol) scale_den: Option<u32>,
    pub(in crate::protocol) offset: Option<f64>,
    pub(in crate::protocol) times: Option<f64>,
    pub(in crate::protocol) per: Option<f64>,
    pub(in crate::protocol) invert: Option<bool>,
    pub(in crate::protocol) valid: Option<[f64; 2]>,
    pub(in crate::protocol) error_above: Option<f64>,
    pub(in crate::protocol) sentinels: Option<BTreeMap<String, String>>,
    pub(in crate::protocol) flags: Option<BTreeMap<String, String>>,
    pub(in crate::protocol) signed: Option<bool>,
    pub(in crate::protocol) width: Option<usize>,
    pub(in crate::protocol) pad_to: Option<usize>,
    pub(in crate::protocol) fill: Option<Fill>,
    pub(in crate::protocol) sign: Option<Sign>,
    pub(in crate::protocol) blanks: Option<bool>,
    pub(in crate::protocol) any_case: Option<bool>,
    pub(in crate::protocol) map: Option<BTreeMap<String, String>>,
    pub(in crate::protocol) default: Option<String>,
    pub(in crate::protocol) optional: Option<bool>,
    pub(in crate::protocol) sep: Option<String>,
}

/// What stands between sign and digits where a number is short.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(in crate::protocol) enum Fill {
    #[default]
    Zero,
    Blank,
}

/// The sign of a number that is not negative.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(in crate::protocol) enum Sign {
    /// None.
    #[default]
    Minus,
    /// A plus.
    Always,
    /// A blank.
    Blank,
}

/// How a field is written.
#[derive(Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(in crate::protocol) enum FieldKind {
    /// Bytes without meaning.
    Skip,
    /// Unsigned integer.
    Uint,
    /// Two's complement integer.
    Int,
    /// Fixed text.
    Lit,
    /// Decimal number as text.
    Dec,
    /// Hexadecimal number as text.
    Hex,
    /// Floating-point number of 4 or 8 bytes.
    Float,
    /// Some bits of a group of bytes, from the lowest.
    Bits,
    /// One of some words.
    Map,
    /// A column of separated values whose content is passed over, with its separator.
    Column,
}

/// Order of the bytes of an integer.
#[derive(Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(in crate::protocol) enum Endian {
    #[default]
    Le,
    Be,
}

/// What a field says.
#[derive(Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(in crate::protocol) enum RoleName {
    Length,
    Seq,
    TDev,
    Temp,
    Status,
    Unit,
    Quality,
}

/// Unit of a field.
#[derive(Clone, Copy, PartialEq, Eq, Deserialize)]
pub(in crate::protocol) enum Unit {
    #[serde(rename = "um")]
    Micrometre,
    #[serde(rename = "mm")]
    Millimetre,
    #[serde(rename = "inch")]
    Inch,
    /// Counts of a scale; `per` says how many make a millimetre.
    #[serde(rename = "count")]
    Count,
    /// What the field with role `unit` says.
    #[serde(rename = "device")]
    Device,
    #[serde(rename = "C")]
    Celsius,
}
