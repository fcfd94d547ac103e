//! Checks a definition file and compiles it; every error names its line.

mod field;
mod message;
mod vectors;

use std::sync::Arc;
use std::time::Duration;

use toml::Spanned;

use crate::port::LineSettings;
use crate::protocol::ProtocolFinding::{
    self, BaudZero, DataBits, EmptyId, EmptyIgnore, IdentAnswer, LatchDevice, LatchRequest, NoMessage,
    NominalRate, PollCommandMissing, PollKeysMissing, PollKeysWithoutPoll, PollRate, ProbeIdent, ProbeZero,
    StepActions, StepCheck, StepExpect, StepHex, StepSendsNothing, StopBits, UnknownSchema,
};
use crate::protocol::check::CheckTable;
use crate::protocol::check::FrameCheck;
use crate::protocol::definition::SimulationTable;
use crate::protocol::definition::{CommandStep, ProtocolDefinition, ProtocolMode};
use crate::protocol::engine::ProtocolEngine;
use crate::protocol::framing::Framing;
use crate::protocol::framing::FramingTable;
use crate::protocol::source::DefinitionSource;
use crate::protocol::source::{ProtocolParamTable, hex_bytes};
use dbbd_model::diagnostic::Diagnostic;
use message::{MessageTable, RejectTable};
use serde::{Deserialize, Deserializer};
use std::collections::BTreeMap;
use vectors::TestTable;

/// The definitions that come with dbbd: name and file.
const BUILT_IN: &[(&str, &str)] = include!("../../../../../protocols/built-in.rs");

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DefinitionFile {
    schema: u32,
    id: String,
    #[serde(default)]
    title: String,
    #[serde(default)]
    source: Vec<String>,
    confidence: Confidence,
    #[serde(default)]
    tested_on: Vec<String>,
    /// Parameters, which are substituted before the text is parsed.
    #[serde(default, rename = "params")]
    _params: BTreeMap<String, ProtocolParamTable>,
    line: LineSettings,
    framing: FramingTable,
    check: Option<CheckTable>,
    #[serde(default)]
    message: Vec<Spanned<MessageTable>>,
    #[serde(default)]
    reject: Vec<Spanned<RejectTable>>,
    #[serde(default)]
    ignore: Vec<IgnoreTable>,
    #[serde(default)]
    mode: ModeTable,
    #[serde(default)]
    timing: TimingTable,
    #[serde(default)]
    cmd: CommandTable,
    #[serde(default)]
    sim: SimulationTable,
    #[serde(default)]
    test: Vec<Spanned<TestTable>>,
}

/// Origin of the definition: the maker's documents, recorded bytes, our own device, a guess.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Confidence {
    Documented,
    Captured,
    Own,
    Guess,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct IgnoreTable {
    prefix: Spanned<Vec<String>>,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct ModeTable {
    #[serde(default)]
    kind: ModeKind,
    poll_hz: Option<f64>,
    reply_timeout_ms: Option<u32>,
    stall_ms: Option<u32>,
    sync_frames: Option<u32>,
}

/// The side that speaks first.
#[derive(Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum ModeKind {
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
struct TimingTable {
    latch: Option<Latch>,
    #[serde(default, rename = "delay_us", deserialize_with = "us")]
    delay: Duration,
    #[serde(default, rename = "jitter_us", deserialize_with = "us")]
    jitter: Duration,
    nominal_hz: Option<f64>,
}

fn us<'de, D: Deserializer<'de>>(value: D) -> Result<Duration, D::Error> {
    u32::deserialize(value).map(|us| Duration::from_micros(us.into()))
}

/// The event that determines the time of a reading: the request, its first byte, or the device's clock.
#[derive(Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Latch {
    Request,
    FirstByte,
    Device,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct CommandTable {
    ident: Vec<Spanned<StepTable>>,
    zero: Vec<Spanned<StepTable>>,
    init: Vec<Spanned<StepTable>>,
    poll: Vec<Spanned<StepTable>>,
    start: Vec<Spanned<StepTable>>,
    stop: Vec<Spanned<StepTable>>,
}

/// A step of a command: exactly one of send, hex, wait_ms, drain_ms and dtr_pulse_ms.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct StepTable {
    send: Option<String>,
    hex: Option<String>,
    wait_ms: Option<u32>,
    drain_ms: Option<u32>,
    dtr_pulse_ms: Option<u32>,
    /// Appends the check of a frame to the bytes.
    #[serde(default)]
    check: bool,
    expect: Option<String>,
    timeout_ms: Option<u32>,
    retries: Option<u32>,
}

impl ProtocolDefinition {
    pub fn built_in() -> &'static [(&'static str, &'static str)] {
        BUILT_IN
    }

    /// A built-in definition with the defaults of its parameters.
    pub fn by_name(name: &str) -> Option<Result<Self, Diagnostic>> {
        Self::by_name_with(name, &[])
    }

    /// A built-in definition with some parameters chosen.
    pub fn by_name_with(name: &str, params: &[(String, String)]) -> Option<Result<Self, Diagnostic>> {
        let (_, text) = BUILT_IN.iter().find(|(built_in, _)| *built_in == name)?;
        Some(Self::from_toml_with(name, text, params))
    }

    /// Reads, checks and compiles a definition, and runs its test vectors.
    pub fn from_toml(file: &str, text: &str) -> Result<Self, Diagnostic> {
        Self::from_toml_with(file, text, &[])
    }

    /// The same as [`Self::from_toml`] with some parameters chosen; the test vectors run with the defaults.
    pub fn from_toml_with(file: &str, text: &str, params: &[(String, String)]) -> Result<Self, Diagnostic> {
        let defaults = load(file, text, &[]);
        let chosen =
            if params.is_empty() { defaults } else { defaults.and_then(|_| load(file, text, params)) };
        chosen.map_err(|wrong| match wrong.help_line() {
            Some(_) => wrong,
            None => wrong.help(
                "docs/reference/protocols.md has every key; `dbbd protocols show dbb-cobs-1` prints a complete definition",
            ),
        })
    }
}

fn load(file: &str, text: &str, params: &[(String, String)]) -> Result<ProtocolDefinition, Diagnostic> {
    let source = DefinitionSource::new(file, text, params)?;
    let table: DefinitionFile = source.parse()?;
    if table.schema != 1 {
        return Err(source.key("", "schema", UnknownSchema { schema: table.schema }));
    }
    if table.id.is_empty() {
        return Err(source.key("", "id", EmptyId));
    }
    let engine = engine(&source, &table)?;
    let clock = engine.clock();
    check_timing(&source, &table, clock.is_some())?;
    check_line(&source, &table.line)?;
    let mode = mode(&source, &table)?;
    let steps = |steps: &[Spanned<StepTable>]| -> Result<Vec<CommandStep>, Diagnostic> {
        let compiled = steps.iter().map(|step| {
            compile_step(step.get_ref(), engine.check.as_ref())
                .map_err(|finding| source.wrong(step.span(), finding))
        });
        compiled.collect()
    };
    let ident = steps(&table.cmd.ident)?;
    check_ident(&source, &table, &ident)?;
    let definition = ProtocolDefinition {
        id: table.id,
        title: table.title,
        source: table.source,
        confidence: match table.confidence {
            Confidence::Documented => "documented",
            Confidence::Captured => "captured",
            Confidence::Own => "own",
            Confidence::Guess => "guess",
        },
        tested_on: table.tested_on,
        line: table.line,
        clock,
        sequence_modulo: engine.sequence_modulo(),
        stall: table.mode.stall_ms.map(|ms| Duration::from_millis(ms.into())),
        sync_frames: table.mode.sync_frames.unwrap_or(1),
        nominal_hz: table.timing.nominal_hz,
        latch_at_request: table.timing.latch == Some(Latch::Request),
        latch_delay: table.timing.delay,
        latch_jitter: table.timing.jitter,
        mode,
        idle: if let FramingTable::Gap { idle_us, .. } = table.framing {
            idle_us.map(|us| Duration::from_micros(us.into()))
        } else {
            None
        },
        sim: table.sim,
        ident,
        zero: steps(&table.cmd.zero)?,
        init: steps(&table.cmd.init)?,
        poll: steps(&table.cmd.poll)?,
        start: steps(&table.cmd.start)?,
        stop: steps(&table.cmd.stop)?,
        text: source.with_chosen_defaults.clone(),
        params: source.params.clone().into_iter().collect(),
        engine: Arc::new(engine),
    };
    if params.is_empty() {
        table.test.iter().try_for_each(|test| vectors::run(&source, &definition, test))?;
    }
    Ok(definition)
}

fn engine(source: &DefinitionSource, table: &DefinitionFile) -> Result<ProtocolEngine, Diagnostic> {
    let framing = Framing::new(&table.framing).map_err(|finding| source.table("framing", finding))?;
    let check = table.check.as_ref().map(|check| FrameCheck::new(source, check)).transpose()?.flatten();
    if table.message.is_empty() {
        return Err(source.table("framing", NoMessage));
    }
    let check_len = check.as_ref().map_or(0, FrameCheck::len);
    let messages = table.message.iter().map(|table| message::compile(source, table, &framing, check_len));
    let messages = messages.collect::<Result<_, _>>()?;
    let rejects = table
        .reject
        .iter()
        .map(|table| message::reject(table.get_ref()).map_err(|finding| source.wrong(table.span(), finding)));
    let rejects = rejects.collect::<Result<_, _>>()?;
    let mut ignored = Vec::new();
    for prefixes in table.ignore.iter().map(|ignore| &ignore.prefix) {
        if prefixes.get_ref().iter().any(String::is_empty) {
            return Err(source.wrong(prefixes.span(), EmptyIgnore));
        }
        ignored.extend(prefixes.get_ref().iter().map(|prefix| prefix.clone().into_bytes()));
    }
    let mask = if table.line.strip_bit7 { 0x7f } else { 0xff };
    Ok(ProtocolEngine { framing, check, messages, rejects, ignored, mask })
}

fn check_timing(
    source: &DefinitionSource,
    table: &DefinitionFile,
    has_clock: bool,
) -> Result<(), Diagnostic> {
    match table.timing.latch {
        Some(Latch::Device) if !has_clock => return Err(source.key("timing", "latch", LatchDevice)),
        Some(Latch::Request) if table.mode.kind != ModeKind::Poll => {
            return Err(source.key("timing", "latch", LatchRequest));
        }
        _ => {}
    }
    match table.timing.nominal_hz {
        Some(hz) if !(hz > 0.0 && hz <= 1e6) => Err(source.key("timing", "nominal_hz", NominalRate)),
        _ => Ok(()),
    }
}

fn mode(source: &DefinitionSource, table: &DefinitionFile) -> Result<ProtocolMode, Diagnostic> {
    let ModeTable { kind, poll_hz, reply_timeout_ms, .. } = table.mode;
    let wrong = match (kind, poll_hz, reply_timeout_ms) {
        (ModeKind::Stream, None, None) => return Ok(ProtocolMode::Stream),
        (ModeKind::Push, None, None) => return Ok(ProtocolMode::Push),
        (ModeKind::Stream | ModeKind::Push, ..) => PollKeysWithoutPoll,
        (ModeKind::Poll, Some(hz), Some(timeout @ 1..)) => {
            if !(hz > 0.0 && hz <= 10_000.0) {
                return Err(source.key("mode", "poll_hz", PollRate));
            }
            if !table.cmd.poll.is_empty() {
                return Ok(ProtocolMode::Poll { hz, timeout: Duration::from_millis(timeout.into()) });
            }
            PollCommandMissing
        }
        (ModeKind::Poll, ..) => PollKeysMissing,
    };
    Err(source.table("mode", wrong))
}

fn check_line(source: &DefinitionSource, line: &LineSettings) -> Result<(), Diagnostic> {
    let wrong = match line {
        LineSettings { baud: 0, .. } => BaudZero,
        LineSettings { baud_probe, .. } if baud_probe.contains(&0) => ProbeZero,
        LineSettings { data_bits, .. } if !matches!(data_bits, 7 | 8) => DataBits,
        LineSettings { stop_bits, .. } if !matches!(stop_bits, 1 | 2) => StopBits,
        _ => return Ok(()),
    };
    Err(source.table("line", wrong))
}

/// Probing rates needs an answer of the device.
fn check_ident(
    source: &DefinitionSource,
    table: &DefinitionFile,
    ident: &[CommandStep],
) -> Result<(), Diagnostic> {
    let answers = ident.iter().any(|step| matches!(step, CommandStep::Ask { .. }));
    match table.cmd.ident.first() {
        Some(step) if !answers => Err(source.wrong(step.span(), IdentAnswer)),
        None if !table.line.baud_probe.is_empty() => Err(source.key("line", "baud_probe", ProbeIdent)),
        _ => Ok(()),
    }
}

fn compile_step(table: &StepTable, check: Option<&FrameCheck>) -> Result<CommandStep, ProtocolFinding> {
    let duration = |ms: u32| Duration::from_millis(ms.into());
    let StepTable { send, hex, wait_ms, drain_ms, dtr_pulse_ms, expect, timeout_ms, retries, .. } = table;
    let mut step = match (send, hex, *wait_ms, *drain_ms, *dtr_pulse_ms) {
        (Some(text), None, None, None, None) => CommandStep::Send(text.clone().into_bytes()),
        (None, Some(hex), None, None, None) => CommandStep::Send(hex_bytes(hex).ok_or(StepHex)?),
        (None, None, Some(ms), None, None) => CommandStep::Wait(duration(ms)),
        (None, None, None, Some(ms), None) => CommandStep::Drain(duration(ms)),
        (None, None, None, None, Some(ms)) => CommandStep::DtrPulse(duration(ms)),
        _ => return Err(StepActions),
    };
    let sends = matches!(&step, CommandStep::Send(bytes) if !bytes.is_empty());
    if !sends && (table.check || expect.is_some()) {
        return Err(StepSendsNothing);
    }
    if let CommandStep::Send(bytes) = &mut step
        && table.check
    {
        check.ok_or(StepCheck)?.append(bytes);
    }
    match (step, expect.as_deref(), *timeout_ms, *retries) {
        (CommandStep::Send(send), Some(expect), Some(timeout @ 1..), retries) if !expect.is_empty() => {
            let (expect, timeout) = (expect.as_bytes().to_vec(), duration(timeout));
            Ok(CommandStep::Ask { send, expect, timeout, retries: retries.unwrap_or(0) })
        }
        (step, None, None, None) => Ok(step),
        _ => Err(StepExpect),
    }
}
