//! The compiled form of frames that decoder and encoder share.

use super::check::FrameCheck;
use super::fault::LineFaultKind;
use super::field::{FieldRole, MessageField, SampleBuilder, TickCounter};
use super::framing::Framing;
use dbbd_model::measurement::sample::Sample;
use serde::Deserialize;

/// A byte that distinguishes a message from others.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MatchByte {
    pub(super) at: usize,
    pub(super) eq: u8,
}

/// Format of the code after the prefix of a reject; a byte is its own code.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum RejectCodeFormat {
    Dec,
    Hex,
    Byte,
}

#[derive(Clone, Debug)]
pub(super) struct ProtocolEngine {
    pub(super) framing: Framing,
    pub(super) check: Option<FrameCheck>,
    /// The messages of the device: the decoder tries them in order, the encoder writes the first.
    pub(super) messages: Vec<MessageFormat>,
    pub(super) rejects: Vec<RejectMessage>,
    /// Prefixes of records to skip.
    pub(super) ignored: Vec<Vec<u8>>,
    /// Data bits of a byte.
    pub(super) mask: u8,
}

#[derive(Clone, Debug)]
pub(super) struct MessageFormat {
    pub(super) matches: Vec<MatchByte>,
    pub(super) fields: Vec<MessageField>,
    /// Length of the content in bytes, if it is fixed.
    pub(super) len: Option<usize>,
}

/// A message of the device that it has no reading.
#[derive(Clone, Debug)]
pub(super) struct RejectMessage {
    pub(super) text: Vec<u8>,
    /// Whether the text is the whole content, not a prefix.
    pub(super) whole: bool,
    /// Whether the message is followed by the check of the frame.
    pub(super) checked: bool,
    /// Format of the code after the text, if there is one.
    pub(super) code: Option<RejectCodeFormat>,
    pub(super) words: Vec<(u32, String)>,
}

pub(super) enum MessageMeaning {
    /// A sample, and the number of decimals of its reading if that is to stay the same.
    Sample(Sample, Option<usize>),
    /// A reading with a number of decimals that the device shows in another unit.
    OtherUnit,
    Reject(String),
    Ignored,
}

impl ProtocolEngine {
    /// The meaning of a complete frame, or the kind of its fault; `buffer` is for unpacking.
    pub(super) fn meaning(
        &self,
        frame: &[u8],
        buffer: &mut Vec<u8>,
    ) -> Result<MessageMeaning, LineFaultKind> {
        if self.framing.is_empty(frame) {
            return Ok(MessageMeaning::Ignored);
        }
        // Banners and echoes have no wrapping.
        if self.ignored.iter().any(|prefix| frame.starts_with(prefix)) {
            return Ok(MessageMeaning::Ignored);
        }
        let body = self.framing.unwrap(frame, buffer).ok_or(LineFaultKind::Framing)?;
        let word = |checked: bool, content: &[u8]| {
            let mut rejects = self.rejects.iter().filter(|reject| reject.checked == checked);
            rejects.find_map(|reject| reject.word(content))
        };
        if let Some(word) = word(false, body) {
            return Ok(MessageMeaning::Reject(word));
        }
        let content = match &self.check {
            Some(check) => check.strip(body).ok_or(LineFaultKind::Check)?,
            None => body,
        };
        if let Some(word) = word(true, content) {
            return Ok(MessageMeaning::Reject(word));
        }
        self.messages.iter().find_map(|message| message.read(content)).ok_or(LineFaultKind::Content)
    }

    /// The fields of the message that the encoder writes.
    pub(super) fn written_fields(&self) -> &[MessageField] {
        self.messages.first().map_or(&[], |message| &message.fields)
    }

    fn fields(&self) -> impl Iterator<Item = &MessageField> {
        self.messages.iter().flat_map(|message| &message.fields)
    }

    /// Resolution of the reading in the first message, mm; 0 for a float.
    pub(super) fn resolution_mm(&self) -> f64 {
        let mut step = self.written_fields().iter().filter_map(|field| match &field.role {
            Some(FieldRole::Length(scale, _)) => Some((field.form.step() * scale.slope()).abs()),
            _ => None,
        });
        step.next_back().unwrap_or(0.0)
    }

    pub(super) fn clock(&self) -> Option<TickCounter> {
        self.fields().find_map(|field| match field.role {
            Some(FieldRole::Ticks(clock)) => Some(clock),
            _ => None,
        })
    }

    pub(super) fn sequence_modulo(&self) -> Option<u32> {
        self.fields().find_map(|field| match field.role {
            Some(FieldRole::Sequence { modulo }) => Some(modulo),
            _ => None,
        })
    }

    /// Names of the flags set in a status, lowest bit first.
    pub(super) fn flags(&self, status: u32) -> Vec<&str> {
        let names = self.fields().filter_map(|field| match &field.role {
            Some(FieldRole::Status(flags) | FieldRole::StatusWord(_, flags)) => Some(&flags.names),
            _ => None,
        });
        let set = names.flatten().filter(|(bit, _)| status & (1 << bit) != 0);
        set.map(|(_, name)| name.as_str()).collect()
    }
}

impl MessageFormat {
    fn read(&self, content: &[u8]) -> Option<MessageMeaning> {
        if self.len.is_some_and(|len| len != content.len())
            || self.matches.iter().any(|byte| content.get(byte.at) != Some(&byte.eq))
        {
            return None;
        }
        let mut reading = SampleBuilder::default();
        let mut rest = content;
        for field in &self.fields {
            rest = field.read(rest, &mut reading)?;
        }
        if !rest.is_empty() {
            return None;
        }
        let SampleBuilder { mut sample, unit_mm, refused, decimals, is_other_unit } = reading;
        if is_other_unit {
            return Some(MessageMeaning::OtherUnit);
        }
        if unit_mm != 1.0 {
            sample.reading_mm *= unit_mm;
        }
        Some(refused.map_or(MessageMeaning::Sample(sample, decimals), MessageMeaning::Reject))
    }
}

impl RejectMessage {
    fn word(&self, body: &[u8]) -> Option<String> {
        let tail = body.strip_prefix(&self.text[..])?;
        if self.whole && !tail.is_empty() {
            return None;
        }
        let text = || match std::str::from_utf8(body) {
            Ok(text) if !text.chars().any(char::is_control) => text.to_owned(),
            _ => body.iter().map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(" "),
        };
        let code = match self.code {
            None => return Some(text()),
            Some(RejectCodeFormat::Byte) => u32::from(*tail.first().filter(|_| tail.len() == 1)?),
            Some(code) => {
                let base = if code == RejectCodeFormat::Hex { 16 } else { 10 };
                u32::from_str_radix(std::str::from_utf8(tail).ok()?.trim(), base).ok()?
            }
        };
        let known = self.words.iter().find(|(known, _)| *known == code);
        Some(known.map_or_else(text, |(_, word)| word.clone()))
    }

    /// The content of a frame with this message and its lowest code.
    pub(super) fn body(&self) -> Vec<u8> {
        let mut body = self.text.clone();
        let code = self.words.first().map_or(1, |(code, _)| *code);
        match self.code {
            None => {}
            Some(RejectCodeFormat::Byte) => body.push(code as u8),
            Some(RejectCodeFormat::Dec) => body.extend(code.to_string().into_bytes()),
            Some(RejectCodeFormat::Hex) => body.extend(format!("{code:X}").into_bytes()),
        }
        body
    }
}
