//! Products that are symmetric or have a triangular factor, in half of the multiplications and less: block by block, so that
//! dense products do the work.

use nalgebra::{Cholesky, DMatrix, DMatrixView, DMatrixViewMut};

/// Columns that are multiplied together: wide enough for the dense product, narrow enough to leave out the zeros.
const BLOCK: usize = 64;

/// The Gram matrix A'A of the columns of A.
pub(crate) fn gram(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    let transposed = matrix.transpose();
    let mut gram = DMatrix::zeros(matrix.ncols(), matrix.ncols());
    add_product(1.0, transposed.as_view(), matrix.as_view(), gram.as_view_mut());
    gram.fill_upper_triangle_with_lower_triangle();
    gram
}

/// The Gram matrix M'M of a lower triangular matrix M.
pub(crate) fn gram_of_lower(lower: &DMatrix<f64>) -> DMatrix<f64> {
    let transposed = lower.transpose();
    let mut gram = DMatrix::zeros(lower.ncols(), lower.ncols());
    // Only the rows from the first of a block of columns on differ from zero.
    for first in (0..lower.ncols()).step_by(BLOCK) {
        let (count, rows) = ((lower.ncols() - first).min(BLOCK), lower.nrows() - first);
        let mut block = gram.view_mut((first, first), (rows, count));
        let [left, right] = [&transposed, lower].map(|of| of.view((first, first), (rows, rows)));
        block.gemm(1.0, &left, &right.columns(0, count), 0.0);
    }
    gram.fill_upper_triangle_with_lower_triangle();
    gram
}

/// The product A M' of a matrix and the transpose of a lower triangular one.
pub(crate) fn times_transposed_lower(matrix: &DMatrix<f64>, lower: &DMatrix<f64>) -> DMatrix<f64> {
    let transposed = lower.transpose();
    let mut product = DMatrix::zeros(matrix.nrows(), lower.nrows());
    for first in (0..lower.nrows()).step_by(BLOCK) {
        let count = (lower.nrows() - first).min(BLOCK);
        let last = (first + count).min(lower.ncols());
        let block = transposed.view((0, first), (last, count));
        product.columns_mut(first, count).gemm(1.0, &matrix.columns(0, last), &block, 0.0);
    }
    product
}

/// The lower Cholesky factor of a symmetric matrix, and its inverse; `None` if the matrix is not positive definite.
pub(crate) fn cholesky_with_inverse(matrix: &DMatrix<f64>) -> Option<[DMatrix<f64>; 2]> {
    let count = matrix.nrows();
    let (mut lower, mut inverse) = (matrix.lower_triangle(), DMatrix::zeros(count, count));
    for first in (0..count).step_by(BLOCK) {
        let size = (count - first).min(BLOCK);
        let (next, rest) = (first + size, count - first - size);
        let (before, mut own) = lower.columns_range_pair_mut(..first, first..next);
        let across = before.rows(first, size).transpose();
        own.rows_mut(first, count - first).gemm(-1.0, &before.rows(first, count - first), &across, 1.0);
        let factor = Cholesky::new(own.rows(first, size).into_owned())?.unpack();
        let of_factor = factor.solve_lower_triangular(&DMatrix::identity(size, size))?;
        let below = own.rows(next, rest) * of_factor.transpose();
        own.rows_mut(first, size).copy_from(&factor);
        own.rows_mut(next, rest).copy_from(&below);
        for column in (0..first).step_by(BLOCK) {
            let width = (first - column).min(BLOCK);
            let product = lower.view((first, column), (size, first - column))
                * inverse.view((column, column), (first - column, width));
            inverse.view_mut((first, column), (size, width)).gemm(-1.0, &of_factor, &product, 0.0);
        }
        inverse.view_mut((first, first), (size, size)).copy_from(&of_factor);
    }
    Some([lower, inverse])
}

/// Adds a multiple of a product that is symmetric to the lower triangle of a matrix; above the diagonal it adds a part.
fn add_product(
    factor: f64,
    left: DMatrixView<'_, f64>,
    right: DMatrixView<'_, f64>,
    mut to: DMatrixViewMut<'_, f64>,
) {
    for first in (0..to.ncols()).step_by(BLOCK) {
        let (count, rows) = ((to.ncols() - first).min(BLOCK), to.nrows() - first);
        let mut block = to.view_mut((first, first), (rows, count));
        block.gemm(factor, &left.rows(first, rows), &right.columns(first, count), 1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn waves(rows: usize, columns: usize) -> DMatrix<f64> {
        DMatrix::from_fn(rows, columns, |i, j| ((3 * i + 5 * j) as f64 + 0.01 * (i * j) as f64).sin())
    }

    #[test]
    fn products_are_the_dense_ones() {
        for count in [0, 1, 24, 61, 150] {
            let lower = waves(count, count).lower_triangle();
            let rows = waves(count + 7, count);
            let near = |found: DMatrix<f64>, expected: DMatrix<f64>| {
                let off = (&found - expected).amax();
                assert!(off < 1e-11, "{count}: {off}");
            };
            near(gram(&rows), rows.transpose() * &rows);
            near(gram_of_lower(&lower), lower.transpose() * &lower);
            near(times_transposed_lower(&rows, &lower), &rows * lower.transpose());
        }
    }

    #[test]
    fn a_factor_by_blocks_is_that_of_the_matrix() {
        for count in [0, 1, 24, 61, 150] {
            let matrix = DMatrix::identity(count, count) + gram(&waves(count + 5, count));
            let [factor, inverse] = cholesky_with_inverse(&matrix).unwrap();
            assert_eq!(factor.upper_triangle(), DMatrix::from_diagonal(&factor.diagonal()));
            assert!((&factor * factor.transpose() - &matrix).amax() < 1e-12 * (1.0 + matrix.amax()));
            assert!((factor * inverse - DMatrix::identity(count, count)).amax() < 1e-11);
        }
        let mut indefinite = DMatrix::identity(60, 60);
        indefinite[(50, 50)] = -1.0;
        assert!(cholesky_with_inverse(&indefinite).is_none());
    }
}
