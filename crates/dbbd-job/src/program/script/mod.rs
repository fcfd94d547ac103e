//! Shared by RAPID and URScript: expressions, values, the unrolling of a program into its actions, points.

pub(super) mod expression;
pub(super) mod points;
pub(super) mod scope;
pub(super) mod unroll;
pub(super) mod value;
