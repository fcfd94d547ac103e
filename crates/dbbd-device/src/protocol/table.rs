//! The tables and keys of a definition file, except `[line]`. The loader checks them.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::{Deserialize, Deserializer};
use toml::Spanned;

use crate::port::{LineSettings, ms};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct DefinitionFile {
    pub(super) schema: u32,
    pub(super) id: String,
    #[serde(default)]
    pub(super) title: String,
    #[serde(default)]
    pub(super) source: Vec<String>,
    pub(super) confidence: Confidence,
    #[serde(default)]
    pub(super) tested_on: Vec<String>,
    /// Substituted before the text is parsed.
    #[serde(default, rename = "params")]
    pub(super) _params: BTreeMap<String, ProtocolParamTable>,
    pub(super) line: LineSettings,
    pub(super) framing: FramingTable,
    pub(super) check: Option<CheckTable>,
    #[serde(default)]
    pub(super) message: Vec<Spanned<MessageTable>>,
    #[serde(default)]
    pub(super) reject: Vec<Spanned<RejectTable>>,
    #[serde(default)]
    pub(super) ignore: Vec<IgnoreTable>,
    #[serde(default)]
    pub(super) mode: ModeTable,
    #[serde(default)]
    pub(super) timing: TimingTable,
    #[serde(default)]
    pub(super) cmd: CommandTable,
    #[serde(default)]
    pub(super) sim: SimulationTable,
    #[serde(default)]
    pub(super) test: Vec<Spanned<TestTable>>,
}

/// A parameter that the user sets.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ProtocolParamTable {
    pub(super) r#type: ProtocolParamKind,
    pub(super) min: Option<f64>,
    pub(super) max: Option<f64>,
    #[serde(default)]
    pub(super) of: Vec<String>,
    pub(super) default: Spanned<toml::Value>,
}

#[derive(Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum ProtocolParamKind {
    Float,
    Int,
    Enum,
}

/// Origin of the definition: the maker's documents, recorded bytes, our own device, a guess.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Confidence {
    Documented,
    Captured,
    Own,
    Guess,
}

/// Bytes of pairs of hexadecimal digits; white space is ignored.
pub(super) fn hex_bytes(hex: &str) -> Option<Vec<u8>> {
    let digits: Option<Vec<u8>> = hex
        .chars()
        .filter(|c| !c.is_whitespace())
        .map(|c| c.to_digit(16).and_then(|digit| u8::try_from(digit).ok()))
        .collect();
    let digits = digits.filter(|digits| digits.len().is_multiple_of(2))?;
    Some(digits.chunks_exact(2).map(|pair| 16 * pair[0] + pair[1]).collect())
}

fn one() -> u8 {
    1
}

fn us<'de, D: Deserializer<'de>>(value: D) -> Result<Duration, D::Error> {
    u32::deserialize(value).map(|us| Duration::from_micros(us.into()))
}

fn text<'de, D: Deserializer<'de>>(value: D) -> Result<Vec<u8>, D::Error> {
    String::deserialize(value).map(String::into_bytes)
}

#[derive(Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
pub(super) enum FramingTable {
    /// Consistent overhead byte stuffing.
    Cobs {
        #[serde(default)]
        delimiter: u8,
        max_len: usize,
    },
    /// Lines of text.
    Line { start: Option<String>, end: Vec<String>, max_len: usize },
    /// Records with a terminator.
    Delim { end: String, max_len: usize },
    /// Records of one length, which may start with synchronising bytes.
    Fixed {
        #[serde(default)]
        sync: String,
        len: usize,
    },
    /// Records with a length field.
    Length {
        #[serde(default)]
        sync: String,
        len_at: usize,
        #[serde(default = "one")]
        len_bytes: u8,
        #[serde(default)]
        len_endian: Endian,
        #[serde(default)]
        len_adds: usize,
        max_len: usize,
    },
    /// Bytes whose high bits are their position in the record.
    Tagged {
        data_bits: u32,
        #[serde(default)]
        order: TagOrder,
        tags: Vec<String>,
    },
    /// Replies identified by their length alone, or terminated by silence.
    Gap { len: Option<Vec<usize>>, idle_us: Option<u32>, max_len: Option<usize> },
}

/// Which byte of a tagged record holds the lowest bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum TagOrder {
    #[default]
    LowFirst,
    HighFirst,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Endian {
    #[default]
    Le,
    Be,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CheckTable {
    pub(super) kind: CheckKind,
    pub(super) enc: Option<CheckEncoding>,
    pub(super) after: Option<String>,
    /// Number of bytes at the start that are not covered.
    #[serde(default)]
    pub(super) over_from: usize,
    #[serde(default)]
    pub(super) optional: bool,
    pub(super) name: Option<String>,
    pub(super) width: Option<u8>,
    pub(super) poly: Option<u32>,
    pub(super) init: Option<u32>,
    pub(super) refin: Option<bool>,
    pub(super) refout: Option<bool>,
    pub(super) xorout: Option<u32>,
    pub(super) check: Option<u32>,
}

#[derive(Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum CheckKind {
    None,
    Xor8,
    Sum8,
    Crc,
}

/// Lowest byte first, highest byte first, or hexadecimal digits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum CheckEncoding {
    Le,
    Be,
    Hex,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MessageTable {
    pub(super) name: String,
    #[serde(default)]
    pub(super) r#match: Vec<Spanned<MatchByte>>,
    pub(super) fields: Vec<Spanned<FieldTable>>,
}

/// A byte that distinguishes a message from others.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MatchByte {
    pub(super) at: usize,
    pub(super) eq: u8,
}

/// The further keys depend on kind and role.
#[derive(Clone, Deserialize)]
pub(super) struct FieldTable {
    pub(super) kind: FieldKind,
    pub(super) role: Option<RoleName>,
    #[serde(flatten)]
    pub(super) keys: toml::Table,
}

#[derive(Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum FieldKind {
    /// Bytes without meaning.
    Skip,
    Uint,
    /// Two's complement integer.
    Int,
    /// Fixed text.
    Lit,
    /// Decimal number as text.
    Dec,
    /// Hexadecimal number as text.
    Hex,
    /// Of 4 or 8 bytes.
    Float,
    /// Bits of a group of bytes, from the lowest.
    Bits,
    /// One of some words.
    Map,
    /// A column of separated values that is skipped, with its separator.
    Column,
}

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

/// Filling of a short number, between sign and digits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum DecimalFill {
    #[default]
    Zero,
    Blank,
}

/// Sign of a number that is not negative: none, plus, blank.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum DecimalSign {
    #[default]
    Minus,
    Always,
    Blank,
}

#[derive(Clone, Copy, PartialEq, Eq, Deserialize)]
pub(super) enum FieldUnit {
    #[serde(rename = "um")]
    Micrometre,
    #[serde(rename = "mm")]
    Millimetre,
    #[serde(rename = "inch")]
    Inch,
    /// Counts of a scale, of which `per` make a millimetre.
    #[serde(rename = "count")]
    Count,
    /// As in the field with role `unit`.
    #[serde(rename = "device")]
    Device,
    #[serde(rename = "C")]
    Celsius,
}

/// A message of the device that it has no reading.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RejectTable {
    pub(super) prefix: Option<String>,
    pub(super) eq: Option<String>,
    pub(super) hex: Option<String>,
    /// It is followed by the check of the frame.
    #[serde(default)]
    pub(super) checked: bool,
    pub(super) code: Option<RejectCodeFormat>,
    #[serde(default)]
    pub(super) map: BTreeMap<String, String>,
    /// The only action; it makes files readable.
    #[serde(default, rename = "action")]
    pub(super) _action: RejectAction,
}

/// Format of the code after the prefix of a reject; a byte is its own code.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum RejectCodeFormat {
    Dec,
    Hex,
    Byte,
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum RejectAction {
    #[default]
    DropSample,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct IgnoreTable {
    pub(super) prefix: Spanned<Vec<String>>,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ModeTable {
    #[serde(default)]
    pub(super) kind: ModeKind,
    pub(super) poll_hz: Option<f64>,
    pub(super) reply_timeout_ms: Option<u32>,
    pub(super) stall_ms: Option<u32>,
    pub(super) sync_frames: Option<u32>,
}

/// Who speaks first.
#[derive(Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum ModeKind {
    /// The device, by itself.
    #[default]
    Stream,
    /// The host requests every reading.
    Poll,
    /// The device, when a key is pressed.
    Push,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TimingTable {
    pub(super) latch: Option<Latch>,
    #[serde(default, rename = "delay_us", deserialize_with = "us")]
    pub(super) delay: Duration,
    #[serde(default, rename = "jitter_us", deserialize_with = "us")]
    pub(super) jitter: Duration,
    pub(super) nominal_hz: Option<f64>,
}

/// What determines the time of a reading: the request, its first byte, or the device's clock.
#[derive(Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Latch {
    Request,
    FirstByte,
    Device,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct CommandTable {
    pub(super) ident: Vec<Spanned<StepTable>>,
    pub(super) zero: Vec<Spanned<StepTable>>,
    pub(super) init: Vec<Spanned<StepTable>>,
    pub(super) poll: Vec<Spanned<StepTable>>,
    pub(super) start: Vec<Spanned<StepTable>>,
    pub(super) stop: Vec<Spanned<StepTable>>,
}

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

/// A step of a command: exactly one of send, hex, wait_ms, drain_ms and dtr_pulse_ms.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StepTable {
    pub(super) send: Option<String>,
    pub(super) hex: Option<String>,
    pub(super) wait_ms: Option<u32>,
    pub(super) drain_ms: Option<u32>,
    pub(super) dtr_pulse_ms: Option<u32>,
    /// Appends the check of a frame to the bytes.
    #[serde(default)]
    pub(super) check: bool,
    pub(super) expect: Option<String>,
    pub(super) timeout_ms: Option<u32>,
    pub(super) retries: Option<u32>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TestTable {
    pub(super) rx: Spanned<String>,
    pub(super) expect: Vec<Spanned<Expectation>>,
}

/// Expected result of test bytes: a sample, a reject, or skipped bytes.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Expectation {
    pub(super) seq: Option<u32>,
    pub(super) t_dev_us: Option<u64>,
    pub(super) length_mm: Option<f64>,
    pub(super) tol: Option<f64>,
    pub(super) temp_c: Option<f64>,
    pub(super) flags: Option<Vec<String>>,
    pub(super) reject: Option<String>,
    pub(super) resync: Option<u64>,
    pub(super) ignored: Option<u64>,
}
