//! Definitions of devices, compiled into decoders and encoders. No I/O: bytes in, samples AND typed
//! faults out. Decoders never fail: a fault is data.
//!
//! A definition is a TOML file (`table`), checked and compiled once (`load`) into an engine:
//! `framing` cuts the stream, `check` guards a frame, `field` reads and writes its content. A new
//! kind of device is a file; a new kind of framing, check or field is a match arm here.

mod built_in;
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
mod line;
mod load;
mod table;
mod tagged;

pub use decoder::{Decoded, Decoder};
pub use definition::{Clock, Definition, Mode, Step};
pub use encoder::Encoder;
pub use evidence::Evidence;
pub use fault::{Fault, FaultKind};
pub use layout::Part;
pub use line::{Flow, Line, Parity};
pub use table::Sim;
