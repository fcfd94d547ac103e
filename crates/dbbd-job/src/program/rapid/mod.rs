//! RAPID, the language of ABB's controllers.
//!
//! Every statement is parsed by itself. Motions, waits, outputs and calls are supported; other statements are skipped when
//! points are corrected, and refused when the program is simulated.

mod emit;
mod instruction;
mod literal;
mod parser;
mod points;
mod program;

pub use emit::emit;
pub use points::read;
pub use program::open;
