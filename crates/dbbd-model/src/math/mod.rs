//! Least squares by streamed QR factorisation, singular values, rank and linear dependence, distributions.
//!
//! nalgebra provides the matrices. Its `svd()` is not used: on clustered singular values it can lose half of the digits,
//! and on a NaN it does not return.

mod alignment;
mod base_set;
pub mod distributions;
mod orthonormal;
mod parallel;
mod products;
pub mod robust;
pub mod straight_line;
mod svd;
mod triangle;

pub use alignment::{RigidAlignment, aligned_differences, aligned_distances};
pub use base_set::rank;
pub(crate) use base_set::{BaseSet, base_set};
pub(crate) use orthonormal::OrthonormalBasis;
pub use parallel::{map_items, map_pieces};
pub(crate) use products::{cholesky_with_inverse, gram, gram_of_lower, times_transposed_lower};
pub use svd::{Svd, svd};
pub(crate) use triangle::Triangle;

/// `right` to the right of `left`; both have as many rows.
pub(crate) fn beside(left: nalgebra::DMatrix<f64>, right: &nalgebra::DMatrix<f64>) -> nalgebra::DMatrix<f64> {
    let own = left.ncols();
    let mut both = left.resize_horizontally(own + right.ncols(), 0.0);
    both.columns_mut(own, right.ncols()).copy_from(right);
    both
}

/// `upper` on top of `lower`; both have as many columns.
pub(crate) fn stacked(
    upper: &nalgebra::DMatrix<f64>,
    lower: &nalgebra::DMatrix<f64>,
) -> nalgebra::DMatrix<f64> {
    let mut stacked = upper.clone().resize_vertically(upper.nrows() + lower.nrows(), 0.0);
    stacked.rows_mut(upper.nrows(), lower.nrows()).copy_from(lower);
    stacked
}
