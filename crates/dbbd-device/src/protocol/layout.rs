//! The layout of a frame in words.

use super::engine::ProtocolEngine;
use super::field::Endian;
use super::field::{FieldForm, FieldRole, FieldScale, MessageField, SampleBuilder};
use super::framing::Framing;

/// A field of a frame's content.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LayoutPart {
    /// Position of its first byte in the content, if it is fixed.
    pub at: Option<usize>,
    /// Length in bytes, if it is fixed.
    pub bytes: Option<usize>,
    pub encoding: String,
    pub meaning: String,
}

/// The fields of the first message, with the check.
pub(super) fn parts(engine: &ProtocolEngine) -> Vec<LayoutPart> {
    let mut parts = Vec::new();
    let mut at = Some(0);
    for field in engine.written_fields() {
        let bytes = field.form.len();
        parts.push(LayoutPart { at, bytes, encoding: encoding(&field.form), meaning: meaning(field) });
        at = at.zip(bytes).map(|(at, bytes)| at + bytes);
    }
    if let Some(check) = &engine.check {
        let (encoding, meaning) = (check.to_string(), "check".to_owned());
        parts.push(LayoutPart { at, bytes: Some(check.len()), encoding, meaning });
    }
    parts
}

pub(super) fn frame(framing: &Framing) -> String {
    let hex = |bytes: &[u8]| bytes.iter().map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(" ");
    match framing {
        Framing::Cobs { delimiter, max_len } => {
            format!("COBS, ended by {delimiter:02x}, at most {max_len} bytes")
        }
        Framing::Line { start, ends, max_len } => {
            let begin = start.map_or(String::new(), |start| format!("begun by {start:02x}, "));
            let ends: Vec<String> = ends.iter().map(|end| hex(end)).collect();
            format!("{begin}ended by {}, at most {max_len} bytes", ends.join(" or "))
        }
        Framing::Fixed { sync, len } if sync.is_empty() => format!("{len} bytes"),
        Framing::Fixed { sync, len } => format!("{len} bytes, begun by {}", hex(sync)),
        Framing::Length { at, max_len, .. } => {
            format!("length in byte {at}, at most {max_len} bytes")
        }
        Framing::Tagged(tagged) => format!("{} bytes with their places in the high bits", tagged.len()),
        Framing::Lengths(lens) => {
            let lens: Vec<String> = lens.iter().map(usize::to_string).collect();
            format!("{} bytes", lens.join(" or "))
        }
        Framing::Idle { max_len } => format!("ended by silence, at most {max_len} bytes"),
    }
}

/// The first field that does not match an intact frame, of the message that matches furthest, and the bytes from there on.
pub(super) fn mismatch(engine: &ProtocolEngine, frame: &[u8]) -> Option<String> {
    let mut buffer = Vec::new();
    let body = engine.framing.unwrap(frame, &mut buffer)?;
    let content = match &engine.check {
        Some(check) => check.strip(body)?,
        None => body,
    };
    let stops = engine.messages.iter().map(|message| {
        let mut reading = SampleBuilder::default();
        let mut rest = content;
        for (field, number) in message.fields.iter().zip(1..) {
            match field.read(rest, &mut reading) {
                Some(tail) => rest = tail,
                None => {
                    let name = if field.role.is_some() { field.name() } else { "no role" };
                    return (rest, format!("its field {number} ({name}, {})", encoding(&field.form)));
                }
            }
        }
        (rest, "the end of its fields".to_owned())
    });
    let (rest, stop) = stops.min_by_key(|(rest, _)| rest.len())?;
    Some(format!("{stop} does not match `{}`", rest.escape_ascii()))
}

fn encoding(form: &FieldForm) -> String {
    let order = |bytes: usize, endian: Endian| match (bytes, endian) {
        (1, _) => "",
        (_, Endian::Be) => ", highest byte first",
        (_, Endian::Le) => ", lowest byte first",
        (_, Endian::Cdab) => ", lowest word first, in it the highest byte",
        (_, Endian::Badc) => ", highest word first, in it the lowest byte",
    };
    let sense = |signed: bool| if signed { "int" } else { "uint" };
    match form {
        FieldForm::Skip(_) => "any".into(),
        FieldForm::Integer { bytes, signed, endian } => {
            format!("{}{}{}", sense(*signed), 8 * bytes, order(*bytes, *endian))
        }
        FieldForm::Float { bytes, endian } => format!("float{}{}", 8 * bytes, order(*bytes, *endian)),
        FieldForm::Bits { bits, shift, signed, .. } => format!("{}{bits} from bit {shift}", sense(*signed)),
        FieldForm::Literal { text, .. } => format!("\"{}\"", text.escape_ascii()),
        FieldForm::Decimal(decimal) => format!("decimal, {} decimals", decimal.decimals),
        FieldForm::Hex { digits, signed } => {
            format!("{}{} in hexadecimal digits", sense(*signed), 4 * digits)
        }
        FieldForm::Word { words, .. } => {
            let words: Vec<String> =
                words.iter().map(|word| format!("\"{}\"", word.escape_ascii())).collect();
            words.join(" ")
        }
        FieldForm::Column { sep } => format!("text up to \"{}\"", char::from(*sep)),
    }
}

fn meaning(field: &MessageField) -> String {
    let flags = |flags: &[(u32, String)]| {
        let flags: Vec<String> = flags.iter().map(|(bit, name)| format!("{bit} {name}")).collect();
        flags.join(", ")
    };
    let step = |scale: &FieldScale| field.form.step() * scale.slope();
    match &field.role {
        None => String::new(),
        Some(FieldRole::Length(scale, _)) => format!("length, {} mm a step", step(scale)),
        Some(FieldRole::Temperature(scale)) => format!("temperature, {} C a step", step(scale)),
        Some(FieldRole::Status(known) | FieldRole::StatusWord(_, known)) => {
            format!("status: {}", flags(&known.names))
        }
        Some(FieldRole::Sequence { .. }) => "sequence number".into(),
        Some(FieldRole::Ticks(_)) => "device's clock".into(),
        Some(FieldRole::Unit(_) | FieldRole::Quality(..)) => field.name().to_owned(),
    }
}
