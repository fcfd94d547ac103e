//! KRL, the language of KUKA's controllers.
//!
//! There are two readers. [`parse_source`] parses whole programs for the simulated controller; it supports the statements
//! that dbbd emits and the statements of plain point programs, and refuses any other. [`read`] finds the motions of any
//! program, to correct their points.

mod data;
pub mod emit;
pub(crate) mod evaluate;
mod expression;
mod parser;
mod points;
pub mod program;
mod rewrite;
mod statement;
pub mod syntax;
pub(crate) mod value;

pub use data::{Origin, absolute_accuracy, logged_axes, plan_hash, read_setup};
pub use emit::{Controller, Options, Sync, emit, run_number};
pub use parser::{parse_data, parse_source};
pub use points::{Files, Given, PointProgram, ProgramMotion, TaughtPoint, read};
pub use program::{Module, Program};
pub use rewrite::{Compensated, compensate};
pub use syntax::Text;
