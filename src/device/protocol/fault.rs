//! What a decoder gives besides samples: faults, which account for every other byte.

use serde::{Deserialize, Serialize};

/// Bytes that did not become a sample, and why.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fault {
    pub kind: FaultKind,
    /// Byte offset of the first byte in the stream.
    pub offset: u64,
    pub bytes: u64,
    /// How many faults of this kind it is, one directly after the other.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub count: u64,
}

fn one() -> u64 {
    1
}

fn is_one(count: &u64) -> bool {
    *count == 1
}

impl Fault {
    /// Takes the next fault in, if it is of the same kind and begins where this one ends; else gives it back.
    pub fn join(&mut self, next: Fault) -> Option<Fault> {
        if next.kind != self.kind || next.offset != self.offset + self.bytes {
            return Some(next);
        }
        self.bytes += next.bytes;
        self.count += next.count;
        None
    }
}

/// Why bytes did not become a sample.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FaultKind {
    /// Not a frame of this protocol.
    Framing,
    /// A frame whose check does not match.
    Check,
    /// A frame that is longer than the protocol allows.
    TooLong,
    /// A frame with an intact check whose content has no meaning here.
    Content,
    /// The device said that it has no reading, with its own word for it.
    Reject(String),
    /// Echo, banner or another record that the definition says to pass over.
    Ignored,
}
