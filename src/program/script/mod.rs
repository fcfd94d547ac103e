//! What the readers of RAPID and of URScript share: words, expressions, values that know where they are written,
//! statements, points.

pub(super) mod lexer;
pub(super) mod points;
pub(super) mod statement;
pub(super) mod value;
