//! A compiled definition: what both the decoder and the encoder follow.

use super::check::Check;
use super::field::{Field, Role};
use super::framing::Framing;
use super::sample::{FaultKind, Sample};

/// The compiled definition.
#[derive(Clone, Debug)]
pub(super) struct Engine {
    pub(super) framing: Framing,
    pub(super) check: Option<Check>,
    /// Tried in order; the first is the one that the encoder writes.
    pub(super) messages: Vec<Message>,
    pub(super) rejects: Vec<Reject>,
    /// Beginnings of records to pass over.
    pub(super) ignored: Vec<Vec<u8>>,
}

/// One kind of message.
#[derive(Clone, Debug)]
pub(super) struct Message {
    /// Byte positions and the values that they must have.
    pub(super) matches: Vec<(usize, u8)>,
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
    /// Base of the code that follows, where one does.
    pub(super) base: Option<u32>,
    /// Words for codes.
    pub(super) words: Vec<(u32, String)>,
}

/// What a frame means.
pub(super) enum Meaning {
    Sample(Sample),
    Reject(String),
    Ignored,
}

impl Engine {
    /// What a complete frame means, or what kind of fault it is.
    pub(super) fn meaning(&self, frame: &[u8]) -> Result<Meaning, FaultKind> {
        if self.framing.empty(frame) {
            return Ok(Meaning::Ignored);
        }
        // Banners and echoes come without the wrapping of a reading.
        if self.ignored.iter().any(|prefix| frame.starts_with(prefix)) {
            return Ok(Meaning::Ignored);
        }
        let body = self.framing.unwrap(frame).ok_or(FaultKind::Framing)?;
        if let Some(word) = self.rejects.iter().find_map(|reject| reject.word(&body)) {
            return Ok(Meaning::Reject(word));
        }
        let content = match &self.check {
            Some(check) => check.strip(&body).ok_or(FaultKind::Check)?,
            None => &body,
        };
        self.messages
            .iter()
            .find_map(|message| message.read(content))
            .map(Meaning::Sample)
            .ok_or(FaultKind::Content)
    }

    /// The names of the flags that are set, lowest bit first.
    pub(super) fn flags(&self, status: u32) -> Vec<&str> {
        let fields = self.messages.iter().flat_map(|message| &message.fields);
        let flags = fields.filter_map(|field| match &field.role {
            Some(Role::Status(flags)) => Some(flags),
            _ => None,
        });
        let set = flags.flatten().filter(|(bit, _)| status & (1 << bit) != 0);
        set.map(|(_, name)| name.as_str()).collect()
    }
}

impl Message {
    fn read(&self, content: &[u8]) -> Option<Sample> {
        if self.len.is_some_and(|len| len != content.len())
            || self.matches.iter().any(|(at, value)| content.get(*at) != Some(value))
        {
            return None;
        }
        let mut sample = Sample {
            reading_mm: 0.0,
            sequence: None,
            ticks: None,
            trigger: None,
            temperature_c: None,
            valid: true,
            status: 0,
            offset: 0,
        };
        let mut rest = content;
        for field in &self.fields {
            rest = field.read(rest, &mut sample)?;
        }
        rest.is_empty().then_some(sample)
    }
}

impl Reject {
    fn word(&self, body: &[u8]) -> Option<String> {
        let tail = body.strip_prefix(&self.text[..])?;
        if self.whole && !tail.is_empty() {
            return None;
        }
        let said = String::from_utf8_lossy(body).into_owned();
        let Some(base) = self.base else { return Some(said) };
        let code = u32::from_str_radix(std::str::from_utf8(tail).ok()?.trim(), base).ok()?;
        Some(self.words.iter().find(|(known, _)| *known == code).map_or(said, |(_, word)| word.clone()))
    }
}
