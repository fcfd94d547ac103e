//! Checks a definition file and compiles it; every refusal names its line.

mod check;
mod field;
mod framing;
mod message;
mod params;
mod vectors;

use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

use toml::Spanned;

use self::params::Resolved;
use crate::base::parse::from_toml_text;
use crate::catalogue::ProtocolFinding::{
    self, BaudZero, DataBits, EmptyId, EmptyIgnore, IdentAnswer, LatchDevice, LatchRequest, NoMessage,
    NominalRate, PollCommandMissing, PollKeysMissing, PollKeysWithoutPoll, PollRate, ProbeIdent, ProbeZero,
    StepActions, StepCheck, StepExpect, StepHex, StepSendsNothing, StopBits, UnknownSchema,
};
use crate::device::protocol::check::Check;
use crate::device::protocol::definition::{Definition, Mode, Step};
use crate::device::protocol::engine::Engine;
use crate::device::protocol::line::Line;
use crate::device::protocol::table::{
    CommandTable, Confidence, File, FramingTable, Latch, ModeKind, ModeTable, StepTable, TestTable,
};
use crate::diagnostic::{Diagnostic, Finding};

/// Reads, checks and compiles a definition.
pub(super) fn load(file: &str, text: &str, params: &[(String, String)]) -> Result<Definition, Diagnostic> {
    let resolved = params::resolve(file, text, params)?;
    let source = Source { file, text, resolved: &resolved };
    let table: File =
        from_toml_text(&resolved.text).map_err(|(span, finding)| source.wrong(span, finding))?;
    if table.schema != 1 {
        return Err(source.key("", "schema", UnknownSchema { schema: table.schema }));
    }
    if table.id.is_empty() {
        return Err(source.key("", "id", EmptyId));
    }
    let engine = engine(source, &table)?;
    let (clock, sequence_modulo) = (engine.clock(), engine.sequence_modulo());
    check_timing(source, &table, clock.is_some())?;
    check_line(source, &table.line)?;
    let mode = mode(source, &table)?;
    let [ident, zero, init, poll, start, stop] = commands(source, &table, engine.check.as_ref())?;
    Ok(Definition {
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
        sequence_modulo,
        stall: table.mode.stall_ms.map(|ms| Duration::from_millis(ms.into())),
        sync_frames: table.mode.sync_frames.unwrap_or(1),
        nominal_hz: table.timing.nominal_hz,
        latch_at_request: table.timing.latch == Some(Latch::Request),
        latch_delay: table.timing.delay,
        latch_jitter: table.timing.jitter,
        mode,
        idle: match table.framing {
            FramingTable::Gap { idle_us, .. } => idle_us.map(|us| Duration::from_micros(us.into())),
            _ => None,
        },
        sim: table.sim,
        ident,
        zero,
        init,
        poll,
        start,
        stop,
        engine: Arc::new(engine),
        text: resolved.kept,
        params: resolved.values,
    })
}

/// Runs the file's own tests, which hold for its default parameters.
pub(super) fn test(file: &str, text: &str, definition: &Definition) -> Result<(), Diagnostic> {
    #[derive(serde::Deserialize)]
    struct Tests {
        #[serde(default)]
        test: Vec<Spanned<TestTable>>,
    }
    let resolved = params::resolve(file, text, &[])?;
    let source = Source { file, text, resolved: &resolved };
    let tests: Tests =
        from_toml_text(&resolved.text).map_err(|(span, finding)| source.wrong(span, finding))?;
    tests.test.iter().try_for_each(|test| vectors::run(source, definition, test))
}

fn engine(source: Source, table: &File) -> Result<Engine, Diagnostic> {
    let framing = framing::compile(&table.framing).map_err(|finding| source.table("framing", finding))?;
    let check = table.check.as_ref().map(|check| check::compile_check(source, check)).transpose()?.flatten();
    if table.message.is_empty() {
        return Err(source.table("framing", NoMessage));
    }
    let guard = check.as_ref().map_or(0, Check::len);
    let messages = table.message.iter().map(|table| message::compile(source, table, &framing, guard));
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
    Ok(Engine { framing, check, messages, rejects, ignored, mask })
}

fn check_timing(source: Source, table: &File, has_clock: bool) -> Result<(), Diagnostic> {
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

fn mode(source: Source, table: &File) -> Result<Mode, Diagnostic> {
    let ModeTable { kind, poll_hz, reply_timeout_ms, .. } = table.mode;
    let wrong = match (kind, poll_hz, reply_timeout_ms) {
        (ModeKind::Stream, None, None) => return Ok(Mode::Stream),
        (ModeKind::Push, None, None) => return Ok(Mode::Push),
        (ModeKind::Stream | ModeKind::Push, ..) => PollKeysWithoutPoll,
        (ModeKind::Poll, Some(hz), Some(timeout @ 1..)) => {
            if !(hz > 0.0 && hz <= 10_000.0) {
                return Err(source.key("mode", "poll_hz", PollRate));
            }
            if !table.cmd.poll.is_empty() {
                return Ok(Mode::Poll { hz, timeout: Duration::from_millis(timeout.into()) });
            }
            PollCommandMissing
        }
        (ModeKind::Poll, ..) => PollKeysMissing,
    };
    Err(source.table("mode", wrong))
}

fn check_line(source: Source, line: &Line) -> Result<(), Diagnostic> {
    let wrong = match line {
        Line { baud: 0, .. } => BaudZero,
        Line { baud_probe, .. } if baud_probe.contains(&0) => ProbeZero,
        Line { data_bits, .. } if !matches!(data_bits, 7 | 8) => DataBits,
        Line { stop_bits, .. } if !matches!(stop_bits, 1 | 2) => StopBits,
        _ => return Ok(()),
    };
    Err(source.table("line", wrong))
}

/// The commands ident, zero, init, poll, start and stop.
fn commands(source: Source, table: &File, check: Option<&Check>) -> Result<[Vec<Step>; 6], Diagnostic> {
    let steps = |steps: &[Spanned<StepTable>]| -> Result<Vec<Step>, Diagnostic> {
        let compiled = steps.iter().map(|step| {
            compile_step(step.get_ref(), check).map_err(|finding| source.wrong(step.span(), finding))
        });
        compiled.collect()
    };
    let CommandTable { ident, zero, init, poll, start, stop } = &table.cmd;
    let commands = [steps(ident)?, steps(zero)?, steps(init)?, steps(poll)?, steps(start)?, steps(stop)?];
    let answers = commands[0].iter().any(|step| matches!(step, Step::Ask { .. }));
    if let Some(step) = ident.first().filter(|_| !answers) {
        return Err(source.wrong(step.span(), IdentAnswer));
    }
    if ident.is_empty() && !table.line.baud_probe.is_empty() {
        return Err(source.key("line", "baud_probe", ProbeIdent));
    }
    Ok(commands)
}

/// Checks a step of a command and compiles it.
fn compile_step(step: &StepTable, check: Option<&Check>) -> Result<Step, ProtocolFinding> {
    let duration = |ms: u32| Duration::from_millis(ms.into());
    let mut bytes = match step {
        StepTable {
            send: Some(text), hex: None, wait_ms: None, drain_ms: None, dtr_pulse_ms: None, ..
        } => text.clone().into_bytes(),
        StepTable {
            send: None, hex: Some(hex), wait_ms: None, drain_ms: None, dtr_pulse_ms: None, ..
        } => vectors::bytes(hex).ok_or(StepHex)?,
        StepTable { send: None, hex: None, wait_ms, drain_ms, dtr_pulse_ms, .. } => {
            let action = match (wait_ms, drain_ms, dtr_pulse_ms) {
                (Some(ms), None, None) => Step::Wait(duration(*ms)),
                (None, Some(ms), None) => Step::Drain(duration(*ms)),
                (None, None, Some(ms)) => Step::DtrPulse(duration(*ms)),
                _ => return Err(StepActions),
            };
            return match (step.check || step.expect.is_some(), step.timeout_ms, step.retries) {
                (true, ..) => Err(StepSendsNothing),
                (false, None, None) => Ok(action),
                _ => Err(StepExpect),
            };
        }
        _ => return Err(StepActions),
    };
    if bytes.is_empty() && (step.check || step.expect.is_some()) {
        return Err(StepSendsNothing);
    }
    if step.check {
        check.ok_or(StepCheck)?.append(&mut bytes);
    }
    match (&step.expect, step.timeout_ms, step.retries) {
        (Some(expect), Some(timeout @ 1..), retries) if !expect.is_empty() => Ok(Step::Ask {
            send: bytes,
            expect: expect.clone().into_bytes(),
            timeout: duration(timeout),
            retries: retries.unwrap_or(0),
        }),
        (None, None, None) => Ok(Step::Send(bytes)),
        _ => Err(StepExpect),
    }
}

/// Where messages point to.
#[derive(Clone, Copy)]
struct Source<'a> {
    file: &'a str,
    text: &'a str,
    resolved: &'a Resolved,
}

impl Source<'_> {
    /// What is wrong at a place of the file.
    fn wrong(&self, span: Range<usize>, finding: impl Finding) -> Diagnostic {
        Diagnostic::span(self.file, self.text, self.resolved.original(span), finding)
    }

    /// What is wrong with a table, at its head.
    fn table(&self, table: &str, finding: impl Finding) -> Diagnostic {
        let start = self.resolved.text.find(&format!("[{table}]")).unwrap_or(0);
        self.wrong(start..start, finding)
    }

    /// What is wrong with the value of a key, at its first place behind the head of its table (empty: that of the file).
    fn key(&self, table: &str, key: &str, finding: impl Finding) -> Diagnostic {
        let text = &self.resolved.text;
        let head = if table.is_empty() { Some(0) } else { text.find(&format!("[{table}]")) };
        let head = head.unwrap_or(0);
        let behind = text.get(head..).unwrap_or_default();
        let value = behind.match_indices(key).find_map(|(at, _)| {
            let (before, after) = (&behind[..at], &behind[at + key.len()..]);
            let value =
                after.trim_start_matches([' ', '\t']).strip_prefix('=')?.trim_start_matches([' ', '\t']);
            let whole = !before.ends_with(|c: char| c.is_alphanumeric() || c == '_');
            whole.then(|| behind.len() - value.len())
        });
        let start = head + value.unwrap_or(0);
        self.wrong(start..start, finding)
    }
}
