//! Definitions of devices, compiled into decoders and encoders. No I/O: bytes in, samples AND typed
//! faults out. Decoders never fail: a fault is data.
//!
//! A definition is a TOML file (`table`), checked and compiled once (`loader`) into an engine:
//! `framing` cuts the stream, `check` guards a frame, `field` reads and writes its content. A new
//! kind of device is a file; a new kind of framing, check or field is a match arm here.

mod built_in;
mod check;
mod decimal;
mod decoder;
mod definition;
mod encoder;
mod engine;
mod field;
mod field_table;
mod framing;
mod layout;
mod load_check;
mod load_command;
mod load_field;
mod load_framing;
mod loader;
mod params;
pub mod sample;
mod source;
mod table;
mod tagged;
mod vectors;

pub use decoder::{Decoded, Decoder};
pub use definition::{Clock, Definition, Line, Mode, Sim, Step};
pub use encoder::{EncodeError, Encoder};
pub use layout::Part;
pub use sample::{Fault, FaultKind, Sample};
pub use table::{Flow, Parity};
