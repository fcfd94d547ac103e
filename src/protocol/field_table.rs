//! The keys of one field in a definition file.

use std::collections::BTreeMap;

use serde::Deserialize;

/// One field; which keys it may have depends on its kind and role.
#[derive(Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FieldTable {
    pub(super) kind: FieldKind,
    pub(super) role: Option<RoleName>,
    pub(super) bytes: Option<usize>,
    pub(super) bits: Option<usize>,
    pub(super) endian: Option<Endian>,
    pub(super) text: Option<String>,
    pub(super) decimals: Option<usize>,
    pub(super) digits: Option<usize>,
    pub(super) modulo: Option<u32>,
    pub(super) tick_ns: Option<u32>,
    pub(super) wrap_bits: Option<u32>,
    pub(super) unit: Option<Unit>,
    pub(super) scale_num: Option<u32>,
    pub(super) scale_den: Option<u32>,
    pub(super) offset: Option<f64>,
    pub(super) times: Option<f64>,
    pub(super) per: Option<f64>,
    pub(super) invert: Option<bool>,
    pub(super) valid: Option<[f64; 2]>,
    pub(super) error_above: Option<f64>,
    pub(super) sentinels: Option<BTreeMap<String, String>>,
    pub(super) flags: Option<BTreeMap<String, String>>,
    pub(super) signed: Option<bool>,
    pub(super) width: Option<usize>,
    pub(super) pad_to: Option<usize>,
    pub(super) fill: Option<Fill>,
    pub(super) sign: Option<Sign>,
    pub(super) blanks: Option<bool>,
    pub(super) any_case: Option<bool>,
    pub(super) map: Option<BTreeMap<String, String>>,
    pub(super) default: Option<String>,
    pub(super) optional: Option<bool>,
    pub(super) sep: Option<String>,
}

/// What stands between sign and digits where a number is short.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Fill {
    #[default]
    Zero,
    Blank,
}

/// The sign of a number that is not negative.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Sign {
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
pub(super) enum FieldKind {
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
pub(super) enum Endian {
    #[default]
    Le,
    Be,
}

/// What a field says.
#[derive(Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum RoleName {
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
pub(super) enum Unit {
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
