//! URScript, the language of Universal Robots' controllers.
//!
//! Every line is parsed by itself. Lines that are not supported are skipped when points are corrected, and refused when the
//! program is simulated.

mod emit;
mod instruction;
mod parser;
mod points;
mod program;

pub use emit::emit;
pub use points::read;
pub use program::open;
