//! Definitions of devices, compiled into decoders and encoders. No I/O: bytes in, samples AND typed
//! faults out. Decoders never fail: a fault is data.

pub mod sample;

pub use sample::{Fault, FaultKind, Sample};
