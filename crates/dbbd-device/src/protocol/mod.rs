//! Definitions of devices, compiled into decoders and encoders without I/O. A decoder turns bytes into samples and
//! typed faults, and never fails.
//!
//! A definition is a TOML file: `source` is its text with parameters. `load` has the form of its tables, checks it and
//! compiles it into an `engine`: `framing` cuts the stream, `check` verifies a frame, `field` reads and writes its
//! content. A table that only one of these modules reads is defined there. A new device is a new file; a new kind of
//! framing, check or field is a match arm.

mod catalogue;
pub use catalogue::ProtocolFinding;

mod check;
mod decimal;
mod decoder;
mod definition;
mod encoder;
mod engine;
mod evidence;
mod fault;
mod field;
mod framing;
mod layout;
mod load;
mod source;
mod tagged;

pub use decoder::{DecodedItem, ProtocolDecoder};
pub use definition::{CommandStep, ProtocolDefinition, ProtocolMode, SimulationTable};
pub use encoder::ProtocolEncoder;
pub use evidence::ProtocolEvidence;
pub use fault::{LineFault, LineFaultKind};
pub use field::TickCounter;
pub use layout::LayoutPart;

#[cfg(test)]
mod tests;
