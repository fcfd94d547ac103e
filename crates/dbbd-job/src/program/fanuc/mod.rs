//! Listings of TP programs, the language of FANUC's controllers.
//!
//! Every statement is parsed by itself. Motions, waits, outputs, frames and calls are supported; other statements are skipped
//! when points are corrected, and refused when the program is simulated. A position is written once, after the statements,
//! with the numbers of its frames; the values of the frames are on the controller.

mod controller_frames;
mod emit;
mod instruction;
mod layout;
mod motion;
mod operand;
mod parser;
mod points;
mod position;
mod program;

pub use emit::emit;
pub(super) use layout::{remark_of, renumbered};
pub use points::{GivenFrames, read};
pub use program::open;
