//! What a decoder gives besides samples: faults, which account for every other byte.

use serde::{Deserialize, Serialize};

/// Bytes that did not become a sample, and why.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fault {
    /// What kind of fault.
    pub kind: FaultKind,
    /// Byte offset of the first byte in the stream.
    pub offset: u64,
    /// Number of bytes that it covers.
    pub bytes: u64,
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
