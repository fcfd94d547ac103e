//! A compiled definition: what both the decoder and the encoder follow.

use super::check::Check;
use super::definition::Clock;
use super::fault::FaultKind;
use super::field::{Field, Reading, Role};
use super::framing::Framing;
use super::table::{Code, Match};
use crate::measurement::sample::Sample;

#[derive(Clone, Debug)]
pub(super) struct Engine {
    pub(super) framing: Framing,
    pub(super) check: Option<Check>,
    /// Tried in order; the first is the one that the encoder writes.
    pub(super) messages: Vec<Message>,
    pub(super) rejects: Vec<Reject>,
    /// Beginnings of records to pass over.
    pub(super) ignored: Vec<Vec<u8>>,
    /// The bits of a byte that are data.
    pub(super) mask: u8,
}

#[derive(Clone, Debug)]
pub(super) struct Message {
    pub(super) matches: Vec<Match>,
    pub(super) fields: Vec<Field>,
    /// Length of the content in bytes, where it is fixed.
    pub(super) len: Option<usize>,
}

/// The device's word for having no reading.
#[derive(Clone, Debug)]
pub(super) struct Reject {
    pub(super) text: Vec<u8>,
    /// Whether the text is all, not just the beginning.
    pub(super) whole: bool,
    /// Whether the frame's check guards it.
    pub(super) checked: bool,
    /// How the code that follows is written, where one does.
    pub(super) code: Option<Code>,
    pub(super) words: Vec<(u32, String)>,
}

pub(super) enum Meaning {
    Sample(Sample),
    Reject(String),
    Ignored,
}

impl Engine {
    /// What a complete frame means, or what kind of fault it is; it is unpacked into `room`.
    pub(super) fn meaning(&self, frame: &[u8], room: &mut Vec<u8>) -> Result<Meaning, FaultKind> {
        if self.framing.empty(frame) {
            return Ok(Meaning::Ignored);
        }
        // Banners and echoes come without the wrapping of a reading.
        if self.ignored.iter().any(|prefix| frame.starts_with(prefix)) {
            return Ok(Meaning::Ignored);
        }
        let body = self.framing.unwrap(frame, room).ok_or(FaultKind::Framing)?;
        let word = |checked: bool, content: &[u8]| {
            let mut rejects = self.rejects.iter().filter(|reject| reject.checked == checked);
            rejects.find_map(|reject| reject.word(content))
        };
        if let Some(word) = word(false, body) {
            return Ok(Meaning::Reject(word));
        }
        let content = match &self.check {
            Some(check) => check.strip(body).ok_or(FaultKind::Check)?,
            None => body,
        };
        if let Some(word) = word(true, content) {
            return Ok(Meaning::Reject(word));
        }
        self.messages.iter().find_map(|message| message.read(content)).ok_or(FaultKind::Content)
    }

    fn fields(&self) -> impl Iterator<Item = &Field> {
        self.messages.iter().flat_map(|message| &message.fields)
    }

    /// The step between two readings that the first message can tell apart, mm; 0 for a float.
    pub(super) fn resolution_mm(&self) -> f64 {
        let fields = self.messages.first().into_iter().flat_map(|message| &message.fields);
        let mut step = fields.filter_map(|field| match &field.role {
            Some(Role::Length(scale, _)) => Some((field.form.step() * scale.slope()).abs()),
            _ => None,
        });
        step.next_back().unwrap_or(0.0)
    }

    pub(super) fn clock(&self) -> Option<Clock> {
        self.fields().find_map(|field| match field.role {
            Some(Role::Ticks(clock)) => Some(clock),
            _ => None,
        })
    }

    pub(super) fn sequence_modulo(&self) -> Option<u32> {
        self.fields().find_map(|field| match field.role {
            Some(Role::Sequence { modulo }) => Some(modulo),
            _ => None,
        })
    }

    /// The names of the flags that are set, lowest bit first.
    pub(super) fn flags(&self, status: u32) -> Vec<&str> {
        let names = self.fields().filter_map(|field| match &field.role {
            Some(Role::Status(flags) | Role::StatusWord(_, flags)) => Some(&flags.names),
            _ => None,
        });
        let set = names.flatten().filter(|(bit, _)| status & (1 << bit) != 0);
        set.map(|(_, name)| name.as_str()).collect()
    }
}

impl Message {
    fn read(&self, content: &[u8]) -> Option<Meaning> {
        if self.len.is_some_and(|len| len != content.len())
            || self.matches.iter().any(|byte| content.get(byte.at) != Some(&byte.eq))
        {
            return None;
        }
        let mut reading = Reading { sample: Sample::of(0.0), unit_mm: 1.0, refused: None };
        let mut rest = content;
        for field in &self.fields {
            rest = field.read(rest, &mut reading)?;
        }
        if !rest.is_empty() {
            return None;
        }
        let Reading { mut sample, unit_mm, refused } = reading;
        if unit_mm != 1.0 {
            sample.reading_mm *= unit_mm;
        }
        Some(refused.map_or(Meaning::Sample(sample), Meaning::Reject))
    }

    /// Whether the message can say that its reading is not to be trusted.
    pub(super) fn doubts(&self) -> bool {
        self.fields.iter().any(Field::doubts)
    }
}

impl Reject {
    fn word(&self, body: &[u8]) -> Option<String> {
        let tail = body.strip_prefix(&self.text[..])?;
        if self.whole && !tail.is_empty() {
            return None;
        }
        let said = || match std::str::from_utf8(body) {
            Ok(text) if !text.chars().any(char::is_control) => text.to_owned(),
            _ => body.iter().map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(" "),
        };
        let code = match self.code {
            None => return Some(said()),
            Some(Code::Byte) => u32::from(*tail.first().filter(|_| tail.len() == 1)?),
            Some(code) => {
                let base = if code == Code::Hex { 16 } else { 10 };
                u32::from_str_radix(std::str::from_utf8(tail).ok()?.trim(), base).ok()?
            }
        };
        let known = self.words.iter().find(|(known, _)| *known == code);
        Some(known.map_or_else(said, |(_, word)| word.clone()))
    }

    /// The content of a frame that says this, with the lowest code.
    pub(super) fn body(&self) -> Vec<u8> {
        let mut body = self.text.clone();
        let code = self.words.first().map_or(1, |(code, _)| *code);
        match self.code {
            None => {}
            Some(Code::Byte) => body.push(code as u8),
            Some(Code::Dec) => body.extend(code.to_string().into_bytes()),
            Some(Code::Hex) => body.extend(format!("{code:X}").into_bytes()),
        }
        body
    }
}
