//! RAPID, the language of ABB's controllers: what of it programs here need, written, read, rewritten.
//!
//! A controller accepts more than is read here. The reader takes every statement by itself: motions, waits and outputs
//! are known, others are passed over where points are looked for, and refused where the program is to be executed.

mod emit;
mod instruction;
mod literal;
mod parser;
mod points;
mod program;

pub use emit::emit;
pub use points::read;
pub use program::open;
