//! Checks a definition file and compiles it; every refusal names its line.

use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

use toml::Spanned;

use super::check::{self, Check, Crc, Sum};
use super::decoder::LONGEST_END;
use super::definition::{Clock, Definition, Line, Step};
use super::engine::{Engine, Message, Reject};
use super::field::{Field, Form};
use super::framing::Framing;
use super::load_field;
use super::table::{
    CheckEncoding, CheckKind, CheckTable, Code, Confidence, FieldTable, File, FramingTable, Latch, LineTable,
    MessageTable, RejectTable, StepTable, Wire,
};
use super::vectors;
use crate::diag::{Diagnostic, nearest};

/// Longest frame that a definition may ask for, bytes.
pub(super) const LONGEST_FRAME: usize = 4096;

/// Where messages point to.
#[derive(Clone, Copy)]
pub(super) struct Source<'a> {
    file: &'a str,
    text: &'a str,
}

impl Source<'_> {
    /// What is wrong at a place of the file.
    pub(super) fn wrong(&self, span: Range<usize>, message: impl Into<String>) -> Diagnostic {
        Diagnostic::span(self.file, self.text, span, message)
    }
}

/// Reads, checks, compiles and tests a definition.
pub(super) fn load(file: &str, text: &str) -> Result<Definition, Diagnostic> {
    let source = Source { file, text };
    let table: File = toml::from_str(text).map_err(|error| {
        Diagnostic::toml(file, text, &error)
            .help("`dbbd protocols show dbb-cobs-1` prints a complete definition")
    })?;
    if *table.schema.get_ref() != 1 {
        return Err(source
            .wrong(table.schema.span(), format!("schema {} is not known", table.schema.get_ref()))
            .help("this dbbd reads schema 1"));
    }
    if table.id.get_ref().is_empty() {
        return Err(source.wrong(table.id.span(), "the id is empty"));
    }
    let framing = framing(source, &table.framing)?;
    let check = table.check.as_ref().map(|check| compile_check(source, check)).transpose()?.flatten();
    if table.message.is_empty() {
        return Err(Diagnostic::file(file, "no [[message]]: nothing would be decoded"));
    }
    let guard = check.as_ref().map_or(0, Check::len);
    let room = framing.max_len().saturating_sub(guard + 1);
    let messages = table.message.iter().map(|message| compile_message(source, message, room));
    let engine = Engine {
        messages: messages.collect::<Result<_, _>>()?,
        rejects: table
            .reject
            .iter()
            .map(|reject| compile_reject(source, reject))
            .collect::<Result<_, _>>()?,
        ignored: table
            .ignore
            .iter()
            .flat_map(|ignore| &ignore.prefix)
            .map(|p| p.clone().into_bytes())
            .collect(),
        framing,
        check,
    };
    if engine.ignored.iter().any(Vec::is_empty) {
        return Err(Diagnostic::file(file, "an [[ignore]] prefix is empty: it would pass over everything"));
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
    let nominal_hz = table.timing.nominal_hz.as_ref();
    if let Some(hz) = nominal_hz.filter(|hz| !(*hz.get_ref() > 0.0 && *hz.get_ref() <= 1e6)) {
        return Err(source.wrong(hz.span(), "nominal_hz must be above 0 and at most 1e6"));
    }
    let steps = |steps: &[Spanned<StepTable>]| -> Result<Vec<Step>, Diagnostic> {
        steps.iter().map(|step| compile_step(source, step)).collect()
    };
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
        text: text.to_owned(),
        line: line(source, &table.line)?,
        clock: clock.map(|(tick_ns, wrap_bits)| Clock { tick_ns, wrap_bits }),
        sequence_modulo: fields.iter().find_map(|field| field.modulo),
        stall: table.mode.stall_ms.map(|ms| Duration::from_millis(ms.into())),
        sync_frames: table.mode.sync_frames.unwrap_or(1),
        nominal_hz: nominal_hz.map(|hz| *hz.get_ref()),
        start: steps(&table.cmd.start)?,
        stop: steps(&table.cmd.stop)?,
        engine: Arc::new(engine),
    };
    for test in &table.test {
        vectors::run(source, &definition, test)?;
    }
    Ok(definition)
}

fn line(source: Source, table: &LineTable) -> Result<Line, Diagnostic> {
    let wrong = |message: &str| {
        let start = source.text.find("[line]").unwrap_or(0);
        Err(source.wrong(start..start, format!("[line]: {message}")))
    };
    match table {
        LineTable { baud: 0, .. } => return wrong("baud must not be 0"),
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

fn framing(source: Source, table: &Spanned<FramingTable>) -> Result<Framing, Diagnostic> {
    let wrong = |message: &str| Err(source.wrong(table.span(), format!("[framing]: {message}")));
    let framing = match table.get_ref() {
        FramingTable::Cobs { delimiter, max_len } => {
            Framing::Cobs { delimiter: *delimiter, max_len: *max_len }
        }
        FramingTable::Line { start, end, max_len } => {
            let start = match start.as_deref().map(str::as_bytes) {
                None => None,
                Some([start]) => Some(*start),
                Some(_) => return wrong("start must be one ASCII character"),
            };
            let mut ends: Vec<Vec<u8>> = end.iter().map(|end| end.clone().into_bytes()).collect();
            if ends.is_empty() || ends.iter().any(|end| end.is_empty() || end.len() > LONGEST_END) {
                return wrong("end must list one or more line ends of 1 to 4 bytes");
            }
            ends.sort_by_key(|end| std::cmp::Reverse(end.len()));
            Framing::Line { start, ends, max_len: *max_len }
        }
    };
    if !(8..=LONGEST_FRAME).contains(&framing.max_len()) {
        return wrong("max_len must be 8 to 4096 bytes");
    }
    Ok(framing)
}

fn compile_check(source: Source, table: &Spanned<CheckTable>) -> Result<Option<Check>, Diagnostic> {
    let check = table.get_ref();
    let wrong = |message: &str| Err(source.wrong(table.span(), format!("[check]: {message}")));
    let parameters = [
        check.width.is_some(),
        check.poly.is_some(),
        check.init.is_some(),
        check.refin.is_some(),
        check.refout.is_some(),
        check.xorout.is_some(),
        check.check.is_some(),
    ];
    if check.kind != CheckKind::Crc && (check.name.is_some() || parameters.contains(&true)) {
        return wrong("only a crc has a name or parameters");
    }
    let after = match check.after.as_ref().map(|after| (after.get_ref().as_bytes(), after.span())) {
        None => None,
        Some(([after], _)) => Some(*after),
        Some((_, span)) => return Err(source.wrong(span, "after must be one ASCII character")),
    };
    if check.optional && after.is_none() {
        return wrong("optional needs `after`: the character that tells whether there is a check");
    }
    let sum = match check.kind {
        CheckKind::None => return Ok(None),
        CheckKind::Xor8 => Sum::Xor8,
        CheckKind::Sum8 => Sum::Sum8,
        CheckKind::Crc => Sum::Crc(match &check.name {
            Some(_) if parameters.contains(&true) => {
                return wrong("give a crc by name or by parameters, not both");
            }
            Some(name) => named_crc(source, name)?,
            None => crc_by_parameters(source, table)?,
        }),
    };
    let Some(enc) = check.enc else {
        return wrong("enc is missing: le, be or hex");
    };
    if enc == CheckEncoding::Hex && check.kind == CheckKind::None {
        return wrong("kind none has no encoding");
    }
    Ok(Some(Check::new(sum, enc, after, check.optional)))
}

fn named_crc(source: Source, name: &Spanned<String>) -> Result<Crc, Diagnostic> {
    check::named(name.get_ref()).map(|(crc, _)| crc).ok_or_else(|| {
        let wrong = source.wrong(name.span(), format!("no CRC `{}` in the catalogue", name.get_ref()));
        let known = check::NAMES.join(", ");
        match nearest(name.get_ref(), check::NAMES.iter().copied()) {
            Some(near) => wrong.help(format!("did you mean `{near}`? Known are: {known}")),
            None => {
                wrong.help(format!("known are: {known}; others are given by width, poly, init, .. and check"))
            }
        }
    })
}

fn crc_by_parameters(source: Source, table: &Spanned<CheckTable>) -> Result<Crc, Diagnostic> {
    let t = table.get_ref();
    let (Some(width), Some(poly), Some(init), Some(refin), Some(refout), Some(xorout), Some(expected)) =
        (t.width, t.poly, t.init, t.refin, t.refout, t.xorout, &t.check)
    else {
        return Err(source.wrong(table.span(), "a crc needs a name, or all of its parameters").help(
            "width, poly, init, refin, refout, xorout, and check: the CRC over \"123456789\", which is verified",
        ));
    };
    if !matches!(width, 8 | 16 | 24 | 32) {
        return Err(source.wrong(table.span(), "[check]: width must be 8, 16, 24 or 32"));
    }
    let crc = Crc { width, poly, init, refin, refout, xorout };
    let check = crc.compute(b"123456789");
    if check != *expected.get_ref() {
        return Err(source
            .wrong(expected.span(), format!("these CRC parameters give check {check:#x}"))
            .help(
                "check is the CRC over the nine characters 123456789: a parameter or this value is wrong",
            ));
    }
    Ok(crc)
}

fn compile_message(
    source: Source,
    table: &Spanned<MessageTable>,
    room: usize,
) -> Result<Message, Diagnostic> {
    let message = table.get_ref();
    let wrong = |text: String| Err(source.wrong(table.span(), format!("message `{}`: {text}", message.name)));
    let fields = message.fields.iter().map(|field| load_field::compile(source, field));
    let fields: Vec<Field> = fields.collect::<Result<_, _>>()?;
    for role in ["length", "seq", "t_dev", "temp", "status"] {
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
    for at in &message.r#match {
        let position = at.get_ref().at;
        let mut start = 0;
        let skipped = fields.iter().any(|field| {
            let end = start + field.form.len().unwrap_or(usize::MAX - start);
            let inside = (start..end).contains(&position) && matches!(field.form, Form::Skip(_));
            start = end;
            inside
        });
        if !skipped {
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
    let (text, whole) = match (&reject.prefix, &reject.eq) {
        (Some(prefix), None) if !prefix.is_empty() => (prefix, false),
        (None, Some(eq)) if !eq.is_empty() => (eq, true),
        _ => return Err(wrong("needs `prefix` or `eq`, one of them and not empty")),
    };
    if reject.code.is_some() && whole || reject.code.is_none() && !reject.map.is_empty() {
        return Err(wrong("a `code` follows a prefix, and `map` needs a code"));
    }
    let base = reject.code.map(|code| if code == Code::Hex { 16 } else { 10 });
    let mut words = Vec::new();
    for (code, word) in &reject.map {
        let number = u32::from_str_radix(code, base.unwrap_or(10));
        words.push((number.map_err(|_| wrong(&format!("`{code}` is not a code")))?, word.clone()));
    }
    Ok(Reject { text: text.clone().into_bytes(), whole, base, words })
}

fn compile_step(source: Source, table: &Spanned<StepTable>) -> Result<Step, Diagnostic> {
    let duration = |ms: u32| Duration::from_millis(ms.into());
    match table.get_ref() {
        StepTable { send: Some(text), hex: None, wait_ms: None, drain_ms: None } => {
            Ok(Step::Send(text.clone().into_bytes()))
        }
        StepTable { send: None, hex: Some(hex), wait_ms: None, drain_ms: None } => vectors::bytes(hex)
            .map(Step::Send)
            .ok_or_else(|| source.wrong(table.span(), "hex is not pairs of hexadecimal digits")),
        StepTable { send: None, hex: None, wait_ms: Some(ms), drain_ms: None } => {
            Ok(Step::Wait(duration(*ms)))
        }
        StepTable { send: None, hex: None, wait_ms: None, drain_ms: Some(ms) } => {
            Ok(Step::Drain(duration(*ms)))
        }
        _ => Err(source.wrong(table.span(), "a step has exactly one of send, hex, wait_ms, drain_ms")),
    }
}
