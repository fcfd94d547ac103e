//! An orthonormal basis that grows column by column.

use nalgebra::{DVector, DVectorViewMut};

/// Orthonormal vectors by modified Gram-Schmidt with reorthogonalisation, which is as accurate as Householder reflections.
#[derive(Clone, Debug, Default)]
pub(crate) struct OrthonormalBasis {
    directions: Vec<DVector<f64>>,
}

impl OrthonormalBasis {
    /// Adds the part of a column that is orthogonal to the basis, if its norm exceeds `threshold`. Returns whether it did.
    pub(crate) fn push(&mut self, mut column: DVector<f64>, threshold: f64) -> bool {
        self.remove_from(column.as_view_mut());
        self.remove_from(column.as_view_mut());
        let norm = column.norm();
        let new = norm > threshold;
        if new {
            self.directions.push(column / norm);
        }
        new
    }

    /// Subtracts the projection onto the basis from a column.
    pub(crate) fn remove_from(&self, mut column: DVectorViewMut<'_, f64>) {
        for direction in &self.directions {
            let share = direction.dot(&column);
            column.axpy(-share, direction, 1.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::DMatrix;

    use super::*;

    fn columns(basis: &OrthonormalBasis) -> DMatrix<f64> {
        DMatrix::from_columns(&basis.directions)
    }

    #[test]
    fn dependent_vectors_are_rejected() {
        let column = |values: &[f64]| DVector::from_row_slice(values);
        let mut basis = OrthonormalBasis::default();
        assert!(basis.push(column(&[1.0, 1.0, 0.0]), 1e-9));
        assert!(basis.push(column(&[1.0, 0.0, 1e-6]), 1e-9));
        assert!(!basis.push(column(&[3.0, 5.0, -2e-6]), 1e-9));
        let columns = columns(&basis);
        assert!((columns.tr_mul(&columns) - DMatrix::identity(2, 2)).norm() < 1e-12);
    }

    #[test]
    fn projection_onto_the_basis_is_removed() {
        let mut basis = OrthonormalBasis::default();
        assert!(basis.push(DVector::from_row_slice(&[3.0, 4.0, 0.0]), 0.0));
        assert!(basis.push(DVector::from_row_slice(&[0.0, 0.0, -2.0]), 0.0));
        // (7, 1, 5) has 25 / 5 along (0.6, 0.8, 0): (7, 1) - 5 (0.6, 0.8) = (4, -3) is left.
        let mut column = DVector::from_row_slice(&[7.0, 1.0, 5.0]);
        basis.remove_from(column.as_view_mut());
        assert!((column - DVector::from_row_slice(&[4.0, -3.0, 0.0])).norm() < 1e-14);
        assert_eq!(basis.directions[1], DVector::from_row_slice(&[0.0, 0.0, -1.0]));
        assert_eq!(basis.directions.len(), 2);
        // The threshold is that of the part that is new: here 1.
        assert!(!basis.push(DVector::from_row_slice(&[0.8, -0.6, 9.0]), 1.0 + 1e-12));
        assert!(basis.push(DVector::from_row_slice(&[0.8, -0.6, 9.0]), 1.0 - 1e-12));
    }
}
