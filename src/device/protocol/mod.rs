//! Definitions of devices, compiled into decoders and encoders without I/O. A decoder turns bytes into samples and
//! typed faults, and never fails.
//!
//! A definition is a TOML file: `table` is its form, `source` its text with parameters. `load` checks it and
//! compiles it into an `engine`: `framing` cuts the stream, `check` verifies a frame, `field` reads and writes its
//! content. A new device is a new file; a new kind of framing, check or field is a match arm.

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
mod table;
mod tagged;

pub use decoder::{Decoded, Decoder};
pub use definition::{Definition, Mode, Step};
pub use encoder::Encoder;
pub use evidence::Evidence;
pub use fault::{Fault, FaultKind};
pub use field::Clock;
pub use layout::Part;
pub use table::Sim;
