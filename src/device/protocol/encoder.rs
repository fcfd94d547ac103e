//! Samples in, bytes out: the other half of a definition, for a virtual device.

use std::sync::Arc;

use super::check::Check;
use super::engine::{Engine, Message};
use super::field::Field;
use crate::catalogue::ProtocolFinding::{self, FieldDoesNotFit, FrameTooLong};
use crate::measurement::sample::Sample;

/// Writes samples as the device would.
#[derive(Clone, Debug)]
pub struct Encoder {
    engine: Arc<Engine>,
}

impl Encoder {
    pub(super) fn new(engine: Arc<Engine>) -> Self {
        Self { engine }
    }

    /// Appends the sample's frame to `out`. The flags `trigger` and `valid` follow the sample's
    /// fields of that name, the other status bits its status.
    ///
    /// # Errors
    /// When the sample lacks a value that the protocol sends or a value does not fit; `out` is then
    /// left as it was.
    pub fn encode(&self, sample: &Sample, out: &mut Vec<u8>) -> Result<(), ProtocolFinding> {
        let frame = self.message(|field, body| field.write(sample, body))?;
        out.extend(frame);
        Ok(())
    }

    /// The frame of the first message, its fields written by `write`.
    fn message(
        &self,
        write: impl Fn(&Field, &mut Vec<u8>) -> Option<()>,
    ) -> Result<Vec<u8>, ProtocolFinding> {
        let mut body = Vec::new();
        for message in self.engine.messages.iter().take(1) {
            for field in &message.fields {
                write(field, &mut body).ok_or(FieldDoesNotFit { field: field.name() })?;
            }
            for matched in &message.matches {
                if let Some(byte) = body.get_mut(matched.at) {
                    *byte = matched.eq;
                }
            }
        }
        let frame = self.frame(body, true);
        if frame.len() > self.engine.framing.max_len() {
            return Err(FrameTooLong { bytes: frame.len() });
        }
        Ok(frame)
    }

    /// Whether a frame can say that its reading is not to be trusted.
    pub fn doubts(&self) -> bool {
        self.engine.messages.iter().take(1).any(Message::doubts)
    }

    /// Appends the device's word for having no reading, or the value in the place of `sample`'s reading
    /// that represents it; false where it has neither.
    pub fn refuse(&self, sample: &Sample, out: &mut Vec<u8>) -> bool {
        if let Some(reject) = self.engine.rejects.first() {
            out.extend(self.frame(reject.body(), reject.checked));
            return true;
        }
        if !self
            .engine
            .messages
            .iter()
            .take(1)
            .flat_map(|message| &message.fields)
            .any(|field| field.sentinel().is_some())
        {
            return false;
        }
        let frame = self.message(|field, body| match field.sentinel() {
            Some(value) => field.form.write(value, body),
            None => field.write(sample, body),
        });
        frame.map(|frame| out.extend(frame)).is_ok()
    }

    fn frame(&self, mut body: Vec<u8>, checked: bool) -> Vec<u8> {
        let check = self.engine.check.as_ref().filter(|_| checked);
        self.engine.framing.prepare(&mut body, check.map_or(0, Check::len));
        if let Some(check) = check {
            check.append(&mut body);
        }
        self.engine.framing.wrap(&body)
    }
}
