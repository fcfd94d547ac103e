//! Samples in, bytes out: the other half of a definition, for a virtual device.

use std::sync::Arc;

use thiserror::Error;

use super::engine::Engine;
use super::sample::Sample;

/// Why a sample cannot be sent.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum EncodeError {
    /// A value is missing or does not fit.
    #[error("the sample's {0} is missing or does not fit the protocol's field")]
    Field(&'static str),
    /// The frame would be longer than allowed.
    #[error("the frame is {0} bytes long, more than the protocol's max_len")]
    TooLong(usize),
}

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
    pub fn encode(&self, sample: &Sample, out: &mut Vec<u8>) -> Result<(), EncodeError> {
        let mut body = Vec::new();
        for message in self.engine.messages.iter().take(1) {
            for field in &message.fields {
                field.write(sample, &mut body).ok_or(EncodeError::Field(field.name()))?;
            }
            for (at, value) in &message.matches {
                if let Some(byte) = body.get_mut(*at) {
                    *byte = *value;
                }
            }
        }
        if let Some(check) = &self.engine.check {
            check.append(&mut body);
        }
        let frame = self.engine.framing.wrap(&body);
        if frame.len() > self.engine.framing.max_len() {
            return Err(EncodeError::TooLong(frame.len()));
        }
        out.extend(frame);
        Ok(())
    }
}
