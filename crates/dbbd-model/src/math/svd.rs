//! Singular values and right singular vectors by one-sided Jacobi rotations (Hestenes; Demmel and
//! Veselic, "Jacobi's method is more accurate than QR", SIAM J. Matrix Anal. Appl. 13, 1992).

use nalgebra::{DMatrix, DVector};

#[derive(Clone, Debug)]
pub struct Svd {
    /// Singular values, largest first.
    pub values: DVector<f64>,
    /// Right singular vectors: column k belongs to value k.
    pub v: DMatrix<f64>,
}

/// Decomposes a matrix; `None` if an element is not finite. For a tall matrix pass its triangular factor, which has the
/// same singular values and right singular vectors.
pub fn svd(matrix: &DMatrix<f64>) -> Option<Svd> {
    if matrix.iter().any(|x| !x.is_finite()) {
        return None;
    }
    let n = matrix.ncols();
    let mut a = matrix.clone();
    let mut v = DMatrix::identity(n, n);
    // A dozen sweeps suffice in practice.
    for _ in 0..60 {
        let mut rotated = false;
        for p in 0..n {
            for q in p + 1..n {
                rotated |= orthogonalise(&mut a, &mut v, p, q);
            }
        }
        if !rotated {
            break;
        }
    }
    let norms: Vec<f64> = (0..n).map(|k| a.column(k).norm()).collect();
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|&i, &j| norms[j].total_cmp(&norms[i]));
    Some(Svd {
        values: DVector::from_iterator(n, order.iter().map(|&k| norms[k])),
        v: DMatrix::from_fn(n, n, |row, at| v[(row, order[at])]),
    })
}

/// Rotates columns p and q until they are orthogonal. Returns false if they already were.
fn orthogonalise(a: &mut DMatrix<f64>, v: &mut DMatrix<f64>, p: usize, q: usize) -> bool {
    let (x, y) = (a.column(p), a.column(q));
    let (xx, yy, xy) = (x.norm_squared(), y.norm_squared(), x.dot(&y));
    if xy.abs() <= 1e-15 * (xx * yy).sqrt() || xy == 0.0 {
        return false;
    }
    let zeta = (yy - xx) / (2.0 * xy);
    let t = zeta.signum() / (zeta.abs() + (1.0 + zeta * zeta).sqrt());
    let cos = 1.0 / (1.0 + t * t).sqrt();
    let sin = cos * t;
    for matrix in [a, v] {
        for row in 0..matrix.nrows() {
            let (left, right) = (matrix[(row, p)], matrix[(row, q)]);
            matrix[(row, p)] = cos * left - sin * right;
            matrix[(row, q)] = sin * left + cos * right;
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_singular_values_are_found() {
        // 4 x 3 with singular values 3, 2, 1e-9: U from a Hadamard matrix, V from a rotation.
        let u = DMatrix::from_row_slice(4, 3, &[1., 1., 1., 1., -1., 1., 1., 1., -1., 1., -1., -1.]) * 0.5;
        let (s, c) = 0.7f64.sin_cos();
        let v = DMatrix::from_row_slice(3, 3, &[c, -s, 0., s, c, 0., 0., 0., 1.]);
        let a = u * DMatrix::from_diagonal(&DVector::from_row_slice(&[2.0, 3.0, 1e-9])) * v.transpose();
        let found = svd(&a).unwrap();
        for (value, expected) in found.values.iter().zip([3.0, 2.0, 1e-9]) {
            assert!((value - expected).abs() < 1e-15 * 3.0, "{value} for {expected}");
        }
        assert!((a * found.v.column(2)).norm() < 1.1e-9);
    }

    #[test]
    fn a_matrix_with_nan_has_no_svd() {
        assert!(svd(&DMatrix::from_element(2, 2, f64::NAN)).is_none());
    }

    /// numpy.linalg.svd([[1,2,3],[4,5,6],[7,8,10],[2,-1,.5]]).
    #[test]
    fn singular_values_match_numpy_and_vectors_belong_to_them() {
        let a = DMatrix::from_row_slice(4, 3, &[1., 2., 3., 4., 5., 6., 7., 8., 10., 2., -1., 0.5]);
        let Svd { values, v } = svd(&a).unwrap();
        for (value, expected) in
            values.iter().zip([17.427664980049162, 2.2559927511871614, 0.6610522292215533])
        {
            assert!((value - expected).abs() < 1e-13, "{value} for {expected}");
        }
        assert!((v.transpose() * &v - DMatrix::identity(3, 3)).norm() < 1e-14);
        for k in 0..3 {
            // A'A v = s^2 v.
            let column = v.column(k);
            let rest = a.transpose() * &a * column - column * values[k].powi(2);
            assert!(rest.norm() < 1e-11, "{k}: {rest}");
        }
    }

    /// The eigenvalues of [[3, 0], [4, 5]]' [[3, 0], [4, 5]] = [[25, 20], [20, 25]] are 45 and 5.
    #[test]
    fn values_of_a_square_matrix_are_roots_of_the_eigenvalues_of_its_gram_matrix() {
        let found = svd(&DMatrix::from_row_slice(2, 2, &[3.0, 0.0, 4.0, 5.0])).unwrap();
        assert!((found.values[0].powi(2) - 45.0).abs() < 1e-12);
        assert!((found.values[1].powi(2) - 5.0).abs() < 1e-12);
        let half = 0.5f64.sqrt();
        assert!((found.v.column(0).dot(&DVector::from_row_slice(&[half, half])).abs() - 1.0).abs() < 1e-14);
    }

    #[test]
    fn columns_that_are_orthogonal_already_are_only_sorted() {
        let found = svd(&DMatrix::from_diagonal(&DVector::from_row_slice(&[2.0, -7.0, 0.0]))).unwrap();
        assert_eq!(found.values.as_slice(), [7.0, 2.0, 0.0]);
        assert_eq!(found.v.column(0).as_slice(), [0.0, 1.0, 0.0]);
    }
}
