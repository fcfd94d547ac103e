//! Products that are symmetric or have a triangular factor, in half of the multiplications and less: block by block, so that
//! dense products do the work.

use nalgebra::{Cholesky, DMatrix};

use super::map_items;

/// Columns that are multiplied together: wide enough for the dense product, narrow enough to leave out the zeros.
const BLOCK: usize = 64;

/// With fewer multiplications than this, starting threads takes longer than they save.
const ON_CORES: usize = 20_000_000;

/// The Gram matrix A'A of the columns of A.
pub(crate) fn gram(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    let (count, transposed) = (matrix.ncols(), matrix.transpose());
    // From the diagonal on downwards.
    let block = |first: usize, width: usize| {
        ((first, first), transposed.rows(first, count - first) * matrix.columns(first, width))
    };
    let mut gram = of_blocks((count, count), matrix.nrows() * count * count / 2, block);
    gram.fill_upper_triangle_with_lower_triangle();
    gram
}

/// The Gram matrix M'M of a lower triangular matrix M.
pub(crate) fn gram_of_lower(lower: &DMatrix<f64>) -> DMatrix<f64> {
    let (count, transposed) = (lower.ncols(), lower.transpose());
    // Only the rows from the first of a block of columns on differ from zero.
    let block = |first: usize, width: usize| {
        let rows = count - first;
        let right = lower.view((first, first), (rows, width));
        ((first, first), transposed.view((first, first), (rows, rows)) * right)
    };
    let mut gram = of_blocks((count, count), count.pow(3) / 3, block);
    gram.fill_upper_triangle_with_lower_triangle();
    gram
}

/// The product A M' of a matrix and the transpose of a lower triangular one.
pub(crate) fn times_transposed_lower(matrix: &DMatrix<f64>, lower: &DMatrix<f64>) -> DMatrix<f64> {
    let (count, transposed) = (lower.nrows(), lower.transpose());
    let block = |first: usize, width: usize| {
        let last = first + width;
        ((0, first), matrix.columns(0, last) * transposed.view((0, first), (last, width)))
    };
    of_blocks((matrix.nrows(), count), matrix.nrows() * count * count / 2, block)
}

/// A matrix from its blocks of columns; `block` gives each with its place, from its first column and its width. The rest is zero.
fn of_blocks(
    (rows, columns): (usize, usize),
    multiplications: usize,
    block: impl Fn(usize, usize) -> ((usize, usize), DMatrix<f64>) + Sync,
) -> DMatrix<f64> {
    let made = |first: &usize| block(*first, (columns - first).min(BLOCK));
    let firsts: Vec<usize> = (0..columns).step_by(BLOCK).collect();
    let blocks: Vec<_> = match multiplications < ON_CORES {
        true => firsts.iter().map(made).collect(),
        false => map_items(&firsts, made),
    };
    let mut whole = DMatrix::zeros(rows, columns);
    for (place, block) in blocks {
        whole.view_mut(place, block.shape()).copy_from(&block);
    }
    whole
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

#[cfg(test)]
mod tests {
    use super::*;

    fn waves(rows: usize, columns: usize) -> DMatrix<f64> {
        DMatrix::from_fn(rows, columns, |i, j| ((3 * i + 5 * j) as f64 + 0.01 * (i * j) as f64).sin())
    }

    #[test]
    fn products_are_the_dense_ones() {
        for count in [0, 1, 24, 61, 150, 400] {
            let lower = waves(count, count).lower_triangle();
            let rows = waves(count + 7, count);
            let near = |found: DMatrix<f64>, expected: DMatrix<f64>| {
                let off = (&found - expected).amax();
                assert!(off < 1e-10, "{count}: {off}");
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
