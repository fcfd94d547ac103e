//! URScript, the language of Universal Robots' controllers: what of it programs here need, written, read, rewritten.
//!
//! The reader takes every line by itself, as that of RAPID takes statements: what it does not know is passed over where
//! points are looked for, and refused where the program is to be executed.

mod emit;
mod instruction;
mod parser;
mod points;
mod program;

pub use emit::emit;
pub use points::read;
pub use program::open;
