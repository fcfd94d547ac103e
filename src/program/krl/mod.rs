//! KRL, the language of KUKA's controllers: programs written from a plan, read, rewritten.
//!
//! A controller accepts more than is read here: the reader of whole programs knows the statements that the writer uses
//! and those of plain point programs, and refuses anything else with its place. [`read`] looks for motions only.

mod data;
pub mod emit;
pub(crate) mod evaluate;
mod expression;
mod lexer;
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
pub use points::{Files, Given, Leg, PointProgram, TaughtPoint, read};
pub use program::{Module, Program};
pub use rewrite::{Compensated, compensate};
pub use syntax::Text;
