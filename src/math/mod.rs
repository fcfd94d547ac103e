//! Least squares by streamed orthogonal factors, singular values, rank and dependent directions.
//!
//! nalgebra holds the matrices. Its own `svd()` is not used: on clustered singular values it can
//! lose half of the digits, and on a NaN it does not return.

mod alignment;
mod base_set;
pub mod distributions;
mod orthonormal;
mod parallel;
pub mod robust;
pub mod straight_line;
mod svd;
mod triangle;

pub use alignment::{Alignment, aligned_distances};
pub use base_set::{BaseSet, base_set};
pub use orthonormal::Orthonormal;
pub use parallel::{map_items, map_pieces};
pub use svd::{Svd, svd};
pub use triangle::Triangle;
