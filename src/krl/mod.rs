//! KRL, the language of KUKA's controllers: programs written from a plan, programs read.
//!
//! What a controller accepts is wider than what is read here: the reader knows the statements that
//! the writer uses, and those of plain point programs; anything else it rejects with its place.

pub mod compensate;
pub mod emit;
mod expression;
mod lexer;
mod number;
mod parser;
pub mod points;
pub mod production;
pub mod program;
mod statement;
pub mod syntax;

pub use emit::{Controller, EmitError, Options, Sync, emit};
pub use parser::{parse_data, parse_source};
pub use points::{Point, Setup, Target, logged_axes, own_accuracy, plan_hash, read_points, read_setup};
pub use program::{Module, Program};
