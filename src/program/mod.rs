//! Programs for robot controllers: emitted from a plan, parsed, rewritten.
//!
//! What a program does is here; how a controller's language writes it is in the language's module.

pub mod compensate;
pub mod krl;
pub mod sequence;
mod target;

pub use crate::plan::Motion;
pub use target::{Frames, Target};
