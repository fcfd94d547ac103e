//! The layout of a frame in words.

use super::engine::Engine;
use super::field::{Field, Form, Role, Scale};
use super::framing::Framing;
use super::table::Endian;

/// A field of a frame's content.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Part {
    /// Position of its first byte in the content, if it is fixed.
    pub at: Option<usize>,
    /// Length in bytes, if it is fixed.
    pub bytes: Option<usize>,
    pub encoding: String,
    pub meaning: String,
}

/// The fields of the first message, with the check.
pub(super) fn parts(engine: &Engine) -> Vec<Part> {
    let mut parts = Vec::new();
    let mut at = Some(0);
    for field in engine.written_fields() {
        let bytes = field.form.len();
        parts.push(Part { at, bytes, encoding: encoding(&field.form), meaning: meaning(field) });
        at = at.zip(bytes).map(|(at, bytes)| at + bytes);
    }
    if let Some(check) = &engine.check {
        let (encoding, meaning) = (check.to_string(), "check".to_owned());
        parts.push(Part { at, bytes: Some(check.len()), encoding, meaning });
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

fn encoding(form: &Form) -> String {
    let order = |bytes: usize, endian: Endian| match (bytes, endian) {
        (1, _) => "",
        (_, Endian::Be) => ", highest byte first",
        (_, Endian::Le) => ", lowest byte first",
    };
    let sense = |signed: bool| if signed { "int" } else { "uint" };
    match form {
        Form::Skip(_) => "any".into(),
        Form::Integer { bytes, signed, endian } => {
            format!("{}{}{}", sense(*signed), 8 * bytes, order(*bytes, *endian))
        }
        Form::Float { bytes, endian } => format!("float{}{}", 8 * bytes, order(*bytes, *endian)),
        Form::Bits { bits, shift, signed, .. } => format!("{}{bits} from bit {shift}", sense(*signed)),
        Form::Literal { text, .. } => format!("\"{}\"", text.escape_ascii()),
        Form::Decimal(decimal) => format!("decimal, {} decimals", decimal.decimals),
        Form::Hex { digits, signed } => format!("{}{} in hexadecimal digits", sense(*signed), 4 * digits),
        Form::Word { words, .. } => {
            let words: Vec<String> =
                words.iter().map(|word| format!("\"{}\"", word.escape_ascii())).collect();
            words.join(" ")
        }
        Form::Column { sep } => format!("text up to \"{}\"", char::from(*sep)),
    }
}

fn meaning(field: &Field) -> String {
    let flags = |flags: &[(u32, String)]| {
        let flags: Vec<String> = flags.iter().map(|(bit, name)| format!("{bit} {name}")).collect();
        flags.join(", ")
    };
    let step = |scale: &Scale| field.form.step() * scale.slope();
    match &field.role {
        None => String::new(),
        Some(Role::Length(scale, _)) => format!("length, {} mm a step", step(scale)),
        Some(Role::Temperature(scale)) => format!("temperature, {} C a step", step(scale)),
        Some(Role::Status(known) | Role::StatusWord(_, known)) => format!("status: {}", flags(&known.names)),
        Some(Role::Sequence { .. }) => "sequence number".into(),
        Some(Role::Ticks(_)) => "device's clock".into(),
        Some(Role::Unit(_) | Role::Quality(..)) => field.name().to_owned(),
    }
}
