//! The definition file: its tables and keys, but for the line. What they mean is checked by the loader.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::{Deserialize, Deserializer};
use toml::Spanned;

use super::line::{Line, ms};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct File {
    pub(super) schema: u32,
    pub(super) id: String,
    #[serde(default)]
    pub(super) title: String,
    #[serde(default)]
    pub(super) source: Vec<String>,
    pub(super) confidence: Confidence,
    #[serde(default)]
    pub(super) tested_on: Vec<String>,
    /// Values that the user sets; they are put into the text before it is read.
    #[serde(default, rename = "params")]
    pub(super) _params: BTreeMap<String, ParamTable>,
    pub(super) line: Line,
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
    pub(super) sim: Sim,
    #[serde(default, rename = "test")]
    pub(super) _test: Vec<Spanned<TestTable>>,
}

/// A value that the user sets.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ParamTable {
    pub(super) r#type: ParamKind,
    pub(super) min: Option<f64>,
    pub(super) max: Option<f64>,
    #[serde(default)]
    pub(super) of: Vec<String>,
    pub(super) default: Spanned<toml::Value>,
}

#[derive(Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum ParamKind {
    Float,
    Int,
    Enum,
}

/// How well the definition is known: from the maker's documents, from recorded bytes, our own device, a guess.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Confidence {
    Documented,
    Captured,
    Own,
    Guess,
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
    /// Records that end with certain bytes.
    Delim { end: String, max_len: usize },
    /// Records of one length, which may begin with certain bytes.
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
    /// Bytes whose high bits give their place in the record.
    Tagged {
        data_bits: u32,
        #[serde(default)]
        order: Order,
        tags: Vec<String>,
    },
    /// Replies that are known by their length alone, or that end with silence.
    Gap { len: Option<Vec<usize>>, idle_us: Option<u32>, max_len: Option<usize> },
}

/// Which byte of a tagged record holds the lowest bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Order {
    #[default]
    LowFirst,
    HighFirst,
}

/// Order of the bytes of a number.
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
    /// So many bytes at the beginning are not covered.
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

/// How the check value is sent: lowest byte first, highest byte first, or as hexadecimal digits.
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
    pub(super) r#match: Vec<Spanned<Match>>,
    pub(super) fields: Vec<Spanned<FieldTable>>,
}

/// A byte that distinguishes a message from others.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Match {
    pub(super) at: usize,
    pub(super) eq: u8,
}

/// One field; which further keys it may have depends on its kind and role.
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
    /// Some bits of a group of bytes, from the lowest.
    Bits,
    /// One of some words.
    Map,
    /// A column of separated values whose content is passed over, with its separator.
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

/// What is between sign and digits where a number is short.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Fill {
    #[default]
    Zero,
    Blank,
}

/// The sign of a number that is not negative: none, a plus, a blank.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Sign {
    #[default]
    Minus,
    Always,
    Blank,
}

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

/// `[[reject]]`: the device's words for having no reading.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RejectTable {
    pub(super) prefix: Option<String>,
    pub(super) eq: Option<String>,
    pub(super) hex: Option<String>,
    /// The frame's check guards it, as it does a reading.
    #[serde(default)]
    pub(super) checked: bool,
    pub(super) code: Option<Code>,
    #[serde(default)]
    pub(super) map: BTreeMap<String, String>,
    /// There is one action so far; it is named so that files stay readable.
    #[serde(default, rename = "action")]
    pub(super) _action: Action,
}

/// How the code after a reject's prefix is written; a byte is its own code.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Code {
    Dec,
    Hex,
    Byte,
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Action {
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
    /// The host: every reading is asked for.
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

/// What fixes the moment of a reading: the request for it, its first byte, or the device's own clock.
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

/// What a virtual device does beside its protocol.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sim {
    /// What the device says at a reading of 0 of the bar, mm.
    #[serde(default)]
    pub at_mm: f64,
    #[serde(default, rename = "reply_delay_ms", deserialize_with = "ms")]
    pub reply_delay: Duration,
    /// What the device says when it is switched on.
    #[serde(default, deserialize_with = "text")]
    pub banner: Vec<u8>,
}

/// One step of a command; one key of send, hex, wait_ms, drain_ms and dtr_pulse_ms.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StepTable {
    pub(super) send: Option<String>,
    pub(super) hex: Option<String>,
    pub(super) wait_ms: Option<u32>,
    pub(super) drain_ms: Option<u32>,
    pub(super) dtr_pulse_ms: Option<u32>,
    /// Appends the frame's check to what is sent.
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

/// What a test's bytes give: a sample, a reject, or bytes that are passed over.
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
