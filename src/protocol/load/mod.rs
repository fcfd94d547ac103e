//! Checks a definition file and compiles it; every refusal names its line.

mod check;
mod command;
mod field;
mod framing;
mod params;
mod source;
mod vectors;

use std::sync::Arc;
use std::time::Duration;

use toml::Spanned;

use self::check::compile_check;
use self::source::Source;
use crate::diag::Diagnostic;
use crate::protocol::check::Check;
use crate::protocol::definition::{Clock, Definition, Line, Mode, Sim, Step};
use crate::protocol::engine::{Engine, Message, Reject};
use crate::protocol::field::{Field, Form};
use crate::protocol::framing::Framing;
use crate::protocol::table::field::FieldTable;
use crate::protocol::table::{
    Code, Confidence, File, FramingTable, IgnoreTable, Latch, LineTable, MessageTable, ModeKind, ModeTable,
    RejectTable, StepTable, TestTable, Wire,
};

/// Reads, checks, compiles and tests a definition.
pub(super) fn load(file: &str, text: &str, params: &[(String, String)]) -> Result<Definition, Diagnostic> {
    let resolved = params::resolve(file, text, params)?;
    let source = Source { file, text, resolved: &resolved };
    let table: File = toml::from_str(&resolved.text).map_err(|error| {
        Diagnostic::span(file, text, resolved.original(error.span().unwrap_or_default()), error.message())
    })?;
    if *table.schema.get_ref() != 1 {
        return Err(source
            .wrong(table.schema.span(), format!("schema {} is not known", table.schema.get_ref()))
            .help("this dbbd reads schema 1"));
    }
    if table.id.get_ref().is_empty() {
        return Err(source.wrong(table.id.span(), "the id is empty"));
    }
    let framing = framing::compile(source, &table.framing)?;
    let check = table.check.as_ref().map(|check| compile_check(source, check)).transpose()?.flatten();
    if table.message.is_empty() {
        return Err(source.wrong(table.framing.span(), "no [[message]]: nothing would be decoded"));
    }
    let guard = check.as_ref().map_or(0, Check::len);
    let (room, exact) = framing.room();
    let room = (room.saturating_sub(guard), exact);
    let messages = table.message.iter().map(|message| compile_message(source, message, room, &framing));
    let messages = messages.collect::<Result<_, _>>()?;
    let engine = Engine {
        messages,
        rejects: table
            .reject
            .iter()
            .map(|reject| compile_reject(source, reject))
            .collect::<Result<_, _>>()?,
        ignored: table
            .ignore
            .iter()
            .flat_map(|ignore| ignore.prefix.get_ref())
            .map(|p| p.clone().into_bytes())
            .collect(),
        mask: if table.line.strip_bit7 { 0x7f } else { 0xff },
        framing,
        check,
    };
    let empty = |ignore: &&IgnoreTable| ignore.prefix.get_ref().iter().any(String::is_empty);
    if let Some(ignore) = table.ignore.iter().find(empty) {
        return Err(source.wrong(ignore.prefix.span(), "an empty prefix would pass over everything"));
    }
    let fields: Vec<&FieldTable> =
        table.message.iter().flat_map(|m| &m.get_ref().fields).map(Spanned::get_ref).collect();
    let clock = fields.iter().find_map(|field| Some((field.tick_ns?, field.wrap_bits?)));
    if let Some(latch) = &table.timing.latch
        && *latch.get_ref() == Latch::Device
        && clock.is_none()
    {
        return Err(source.wrong(latch.span(), "latch = \"device\" needs a field with role = \"t_dev\""));
    }
    if let Some(latch) = &table.timing.latch
        && *latch.get_ref() == Latch::Request
        && table.mode.kind != ModeKind::Poll
    {
        return Err(source.wrong(latch.span(), "latch = \"request\" needs [mode] kind = \"poll\""));
    }
    let mode = mode(source, &table)?;
    let nominal_hz = table.timing.nominal_hz.as_ref();
    if let Some(hz) = nominal_hz.filter(|hz| !(*hz.get_ref() > 0.0 && *hz.get_ref() <= 1e6)) {
        return Err(source.wrong(hz.span(), "nominal_hz must be above 0 and at most 1e6"));
    }
    let steps = |steps: &[Spanned<StepTable>]| -> Result<Vec<Step>, Diagnostic> {
        steps.iter().map(|step| command::compile(source, step, engine.check.as_ref())).collect()
    };
    let (init, start) = (steps(&table.cmd.init)?, steps(&table.cmd.start)?);
    let (stop, poll) = (steps(&table.cmd.stop)?, steps(&table.cmd.poll)?);
    let (ident, zero) = (steps(&table.cmd.ident)?, steps(&table.cmd.zero)?);
    if let Some(step) = table.cmd.ident.first()
        && !ident.iter().any(|step| matches!(step, Step::Ask { .. }))
    {
        return Err(source.wrong(step.span(), "ident needs a step with `expect`: what the device answers"));
    }
    if let Some(probe) = table.line.baud_probe.as_ref().filter(|_| ident.is_empty()) {
        return Err(source.wrong(probe.span(), "baud_probe needs [cmd] ident: what tells the right rate"));
    }
    let definition = Definition {
        id: table.id.get_ref().clone(),
        title: table.title,
        source: table.source,
        confidence: match table.confidence {
            Confidence::Documented => "documented",
            Confidence::Captured => "captured",
            Confidence::Own => "own",
            Confidence::Guess => "guess",
        },
        tested_on: table.tested_on,
        text: resolved.kept.clone(),
        params: resolved.values.clone(),
        line: line(source, &table.line)?,
        line_probe: table.line.baud_probe.map(Spanned::into_inner).unwrap_or_default(),
        clock: clock.map(|(tick_ns, wrap_bits)| Clock { tick_ns, wrap_bits }),
        sequence_modulo: fields.iter().find_map(|field| field.modulo),
        stall: table.mode.stall_ms.map(|ms| Duration::from_millis(ms.into())),
        sync_frames: table.mode.sync_frames.unwrap_or(1),
        nominal_hz: nominal_hz.map(|hz| *hz.get_ref()),
        latch_at_request: table.timing.latch.as_ref().is_some_and(|latch| *latch.get_ref() == Latch::Request),
        latch_delay: Duration::from_micros(table.timing.delay_us.into()),
        latch_jitter: Duration::from_micros(table.timing.jitter_us.into()),
        mode,
        idle: match table.framing.get_ref() {
            FramingTable::Gap { idle_us, .. } => idle_us.map(|us| Duration::from_micros(us.into())),
            _ => None,
        },
        sim: Sim {
            at_mm: table.sim.at_mm,
            reply_delay: Duration::from_millis(table.sim.reply_delay_ms.into()),
            banner: table.sim.banner.unwrap_or_default().into_bytes(),
        },
        ident,
        zero,
        init,
        start,
        stop,
        poll,
        engine: Arc::new(engine),
    };
    Ok(definition)
}

/// Runs the file's own tests, which hold for its default parameters.
pub(super) fn test(file: &str, text: &str, definition: &Definition) -> Result<(), Diagnostic> {
    #[derive(serde::Deserialize)]
    struct Tests {
        #[serde(default)]
        test: Vec<Spanned<TestTable>>,
    }
    let resolved = params::resolve(file, text, &[])?;
    let tests: Tests =
        toml::from_str(&resolved.text).map_err(|error| Diagnostic::toml(file, text, &error))?;
    let source = Source { file, text, resolved: &resolved };
    tests.test.iter().try_for_each(|test| vectors::run(source, definition, test))
}

fn mode(source: Source, table: &File) -> Result<Mode, Diagnostic> {
    let whole = |message: &str| {
        let start = source.resolved.text.find("[mode]").unwrap_or(0);
        Err(source.wrong(start..start, format!("[mode]: {message}")))
    };
    let ModeTable { kind, poll_hz, reply_timeout_ms, .. } = &table.mode;
    match (kind, poll_hz, reply_timeout_ms) {
        (ModeKind::Stream, None, None) => Ok(Mode::Stream),
        (ModeKind::Push, None, None) => Ok(Mode::Push),
        (ModeKind::Stream | ModeKind::Push, ..) => {
            whole("poll_hz and reply_timeout_ms belong to kind = \"poll\"")
        }
        (ModeKind::Poll, Some(hz), Some(timeout @ 1..)) => {
            if !(*hz.get_ref() > 0.0 && *hz.get_ref() <= 10_000.0) {
                return Err(source.wrong(hz.span(), "poll_hz must be above 0 and at most 10000"));
            }
            if table.cmd.poll.is_empty() {
                return whole("kind = \"poll\" needs [cmd] poll: what asks for a reading");
            }
            Ok(Mode::Poll { hz: *hz.get_ref(), timeout: Duration::from_millis((*timeout).into()) })
        }
        (ModeKind::Poll, ..) => whole("kind = \"poll\" needs poll_hz and reply_timeout_ms"),
    }
}

fn line(source: Source, table: &LineTable) -> Result<Line, Diagnostic> {
    let wrong = |message: &str| {
        let start = source.resolved.text.find("[line]").unwrap_or(0);
        Err(source.wrong(start..start, format!("[line]: {message}")))
    };
    match table {
        LineTable { baud: 0, .. } => return wrong("baud must not be 0"),
        LineTable { baud_probe: Some(probe), .. } if probe.get_ref().contains(&0) => {
            return wrong("baud_probe must not have a 0");
        }
        LineTable { bits, .. } if !matches!(bits, 7 | 8) => return wrong("bits must be 7 or 8"),
        LineTable { stop, .. } if !matches!(stop, 1 | 2) => return wrong("stop must be 1 or 2"),
        _ => {}
    }
    let level = |wire: Wire| match wire {
        Wire::Keep => None,
        Wire::On => Some(true),
        Wire::Off => Some(false),
    };
    Ok(Line {
        baud: table.baud,
        data_bits: table.bits,
        parity: table.parity,
        stop_bits: table.stop,
        flow: table.flow,
        dtr: level(table.dtr),
        rts: level(table.rts),
        settle: Duration::from_millis(table.settle_ms.into()),
    })
}

fn compile_message(
    source: Source,
    table: &Spanned<MessageTable>,
    (room, exact): (usize, bool),
    framing: &Framing,
) -> Result<Message, Diagnostic> {
    let message = table.get_ref();
    let wrong = |text: String| Err(source.wrong(table.span(), format!("message `{}`: {text}", message.name)));
    let fields = message.fields.iter().map(|field| field::compile(source, field));
    let mut fields: Vec<Field> = fields.collect::<Result<_, _>>()?;
    if let Err(why) = field::group_bits(&mut fields) {
        return wrong(why);
    }
    for role in ["length", "seq", "t_dev", "temp", "status", "unit", "quality"] {
        let count = fields.iter().filter(|field| field.role.is_some() && field.name() == role).count();
        if count > 1 || (role == "length" && count == 0) {
            return wrong(format!(
                "{count} fields have role `{role}`; a message has exactly one length and at most one of the others"
            ));
        }
    }
    let len = fields.iter().map(|field| field.form.len()).sum::<Option<usize>>();
    if len.is_some_and(|len| len > room) {
        return wrong(format!("its fields need {} bytes, the frame has room for {room}", len.unwrap_or(0)));
    }
    if exact && len != Some(room) {
        let has = len.map_or("no fixed number of".into(), |len| len.to_string());
        return wrong(format!("its fields have {has} bytes, the frame has {room}"));
    }
    let skipped = |position: usize| {
        let mut start = 0;
        fields.iter().any(|field| {
            let end = start + field.form.len().unwrap_or(usize::MAX - start);
            let inside = (start..end).contains(&position) && matches!(field.form, Form::Skip(_));
            start = end;
            inside
        })
    };
    if let Some(position) = framing.own().find(|position| !skipped(*position)) {
        return wrong(format!(
            "byte {position} belongs to the framing: it must be in a field of kind `skip`"
        ));
    }
    for at in &message.r#match {
        let position = at.get_ref().at;
        if !skipped(position) {
            return Err(source
                .wrong(at.span(), format!("byte {position} is not in a field of kind `skip`"))
                .help("a byte that is matched belongs to no other field; positions count from 0"));
        }
    }
    let matches = message.r#match.iter().map(|at| (at.get_ref().at, at.get_ref().eq)).collect();
    Ok(Message { matches, fields, len })
}

fn compile_reject(source: Source, table: &Spanned<RejectTable>) -> Result<Reject, Diagnostic> {
    let wrong = |message: &str| source.wrong(table.span(), format!("[[reject]]: {message}"));
    let reject = table.get_ref();
    let (text, whole) = match (&reject.prefix, &reject.eq, &reject.hex) {
        (Some(prefix), None, None) => (prefix.clone().into_bytes(), false),
        (None, Some(eq), None) => (eq.clone().into_bytes(), true),
        (None, None, Some(hex)) => (vectors::bytes(hex).unwrap_or_default(), false),
        _ => (Vec::new(), false),
    };
    if text.is_empty() {
        return Err(wrong("needs one of `prefix`, `eq` and `hex`, not empty"));
    }
    if reject.code.is_some() && whole || reject.code.is_none() && !reject.map.is_empty() {
        return Err(wrong("a `code` follows a prefix, and `map` needs a code"));
    }
    let base = if reject.code == Some(Code::Hex) { 16 } else { 10 };
    let mut words = Vec::new();
    for (code, word) in &reject.map {
        let number = u32::from_str_radix(code, base);
        words.push((number.map_err(|_| wrong(&format!("`{code}` is not a code")))?, word.clone()));
    }
    Ok(Reject { text, whole, checked: reject.checked, code: reject.code, words })
}
