//! Encodes samples, for a virtual device.

use std::sync::Arc;

use super::check::FrameCheck;
use super::engine::ProtocolEngine;
use super::field::MessageField;
use crate::protocol::ProtocolFinding::{self, FieldDoesNotFit, FrameTooLong};
use dbbd_model::measurement::sample::Sample;

#[derive(Clone, Debug)]
pub struct ProtocolEncoder {
    engine: Arc<ProtocolEngine>,
}

impl ProtocolEncoder {
    pub(super) fn new(engine: Arc<ProtocolEngine>) -> Self {
        Self { engine }
    }

    /// Appends the sample's frame to `out`. The flags `trigger` and `valid` follow the fields of that name, the
    /// other status bits the status.
    ///
    /// # Errors
    /// A value that the protocol sends is missing or does not fit; `out` is unchanged.
    pub fn encode(&self, sample: &Sample, out: &mut Vec<u8>) -> Result<(), ProtocolFinding> {
        let frame = self.message(|field, body| field.write(sample, body))?;
        out.extend(frame);
        Ok(())
    }

    /// The frame of the first message.
    fn message(
        &self,
        write: impl Fn(&MessageField, &mut Vec<u8>) -> Option<()>,
    ) -> Result<Vec<u8>, ProtocolFinding> {
        let mut body = Vec::new();
        for field in self.engine.written_fields() {
            write(field, &mut body).ok_or(FieldDoesNotFit { field: field.name() })?;
        }
        for matched in self.engine.messages.first().into_iter().flat_map(|message| &message.matches) {
            if let Some(byte) = body.get_mut(matched.at) {
                *byte = matched.eq;
            }
        }
        let frame = self.frame(body, true);
        if frame.len() > self.engine.framing.max_len() {
            return Err(FrameTooLong { bytes: frame.len() });
        }
        Ok(frame)
    }

    /// Whether a frame can mark its reading as invalid.
    pub fn has_validity(&self) -> bool {
        self.engine.written_fields().iter().any(MessageField::has_validity)
    }

    /// Appends the device's message that it has no reading, or a frame of `sample` with the value for no reading;
    /// `false` if the protocol has neither.
    pub fn refuse(&self, sample: &Sample, out: &mut Vec<u8>) -> bool {
        if let Some(reject) = self.engine.rejects.first() {
            out.extend(self.frame(reject.body(), reject.checked));
            return true;
        }
        if self.engine.written_fields().iter().all(|field| field.sentinel().is_none()) {
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
        self.engine.framing.prepare(&mut body, check.map_or(0, FrameCheck::len));
        if let Some(check) = check {
            check.append(&mut body);
        }
        self.engine.framing.wrap(&body)
    }
}
