//! The definition file as it stands: its tables and keys. What they mean is checked by the loader.

pub(super) mod field;

use std::collections::BTreeMap;

use serde::Deserialize;
use toml::Spanned;

use self::field::{Endian, FieldTable};

/// The whole file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct File {
    pub(super) schema: Spanned<u32>,
    pub(super) id: Spanned<String>,
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
    pub(super) line: LineTable,
    pub(super) framing: Spanned<FramingTable>,
    pub(super) check: Option<Spanned<CheckTable>>,
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
    pub(super) sim: SimTable,
    #[serde(default)]
    #[serde(rename = "test")]
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

/// What a user's value is.
#[derive(Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum ParamKind {
    Float,
    Int,
    Enum,
}

/// How well the definition is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Confidence {
    /// From the maker's documents.
    Documented,
    /// From recorded bytes.
    Captured,
    /// Our own device.
    Own,
    /// A guess.
    Guess,
}

/// `[line]`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LineTable {
    pub(super) baud: u32,
    /// Further rates that the device may be set to.
    pub(super) baud_probe: Option<Spanned<Vec<u32>>>,
    #[serde(default = "eight")]
    pub(super) bits: u8,
    #[serde(default)]
    pub(super) parity: Parity,
    #[serde(default = "one")]
    pub(super) stop: u8,
    #[serde(default)]
    pub(super) flow: Flow,
    #[serde(default)]
    pub(super) dtr: Wire,
    #[serde(default)]
    pub(super) rts: Wire,
    #[serde(default)]
    pub(super) settle_ms: u32,
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

/// Parity of the serial line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Parity {
    /// None.
    #[default]
    None,
    /// Even.
    Even,
    /// Odd.
    Odd,
}

/// Flow control of the serial line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Flow {
    /// None.
    #[default]
    None,
    /// By the characters XON and XOFF.
    XonXoff,
    /// By the wires RTS and CTS.
    RtsCts,
}

/// What to do with a modem wire at opening.
#[derive(Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Wire {
    /// Leave it to the system.
    #[default]
    Keep,
    /// Raise it.
    On,
    /// Lower it.
    Off,
}

/// `[framing]`.
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
    /// Records that tell their length.
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
    /// Bytes whose high bits tell their place in the record.
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
#[derive(Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Order {
    #[default]
    LowFirst,
    HighFirst,
}

/// `[check]`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CheckTable {
    pub(super) kind: CheckKind,
    pub(super) enc: Option<CheckEncoding>,
    pub(super) after: Option<Spanned<String>>,
    /// So many bytes at the beginning are not covered.
    #[serde(default)]
    pub(super) over_from: usize,
    #[serde(default)]
    pub(super) optional: bool,
    pub(super) name: Option<Spanned<String>>,
    pub(super) width: Option<u8>,
    pub(super) poly: Option<u32>,
    pub(super) init: Option<u32>,
    pub(super) refin: Option<bool>,
    pub(super) refout: Option<bool>,
    pub(super) xorout: Option<u32>,
    pub(super) check: Option<Spanned<u32>>,
}

/// What guards a frame.
#[derive(Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum CheckKind {
    None,
    Xor8,
    Sum8,
    Crc,
}

/// How the check value is sent.
#[derive(Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum CheckEncoding {
    /// Lowest byte first.
    Le,
    /// Highest byte first.
    Be,
    /// Hexadecimal digits.
    Hex,
}

/// `[[message]]`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MessageTable {
    pub(super) name: String,
    #[serde(default)]
    pub(super) r#match: Vec<Spanned<MatchTable>>,
    pub(super) fields: Vec<Spanned<FieldTable>>,
}

/// A byte that tells a message from others.
#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MatchTable {
    pub(super) at: usize,
    pub(super) eq: u8,
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

/// How the code after a reject's prefix is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Code {
    Dec,
    Hex,
    /// One byte.
    Byte,
}

/// What follows from a reject.
#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Action {
    #[default]
    DropSample,
}

/// `[[ignore]]`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct IgnoreTable {
    pub(super) prefix: Spanned<Vec<String>>,
}

/// `[mode]`.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ModeTable {
    #[serde(default)]
    pub(super) kind: ModeKind,
    pub(super) poll_hz: Option<Spanned<f64>>,
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

/// `[timing]`.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TimingTable {
    pub(super) latch: Option<Spanned<Latch>>,
    #[serde(default)]
    pub(super) delay_us: u32,
    #[serde(default)]
    pub(super) jitter_us: u32,
    pub(super) nominal_hz: Option<Spanned<f64>>,
}

/// What fixes the moment of a reading.
#[derive(Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Latch {
    /// The request for it.
    Request,
    /// Its first byte.
    FirstByte,
    /// The device's own clock.
    Device,
}

/// `[cmd]`.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CommandTable {
    #[serde(default)]
    pub(super) ident: Vec<Spanned<StepTable>>,
    #[serde(default)]
    pub(super) zero: Vec<Spanned<StepTable>>,
    #[serde(default)]
    pub(super) init: Vec<Spanned<StepTable>>,
    #[serde(default)]
    pub(super) poll: Vec<Spanned<StepTable>>,
    #[serde(default)]
    pub(super) start: Vec<Spanned<StepTable>>,
    #[serde(default)]
    pub(super) stop: Vec<Spanned<StepTable>>,
}

/// `[sim]`: what the virtual device does beside the protocol.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SimTable {
    /// What the device says at a reading of 0 of the bar, mm.
    #[serde(default)]
    pub(super) at_mm: f64,
    #[serde(default)]
    pub(super) reply_delay_ms: u32,
    /// What the device says when it is switched on.
    pub(super) banner: Option<String>,
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

/// `[[test]]`.
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
