//! An orthonormal basis that grows column by column.

use nalgebra::{DMatrix, DVector, DVectorViewMut};

/// Orthonormal directions by modified Gram-Schmidt, done twice, which is as good as Householder's reflections.
#[derive(Clone, Debug, Default)]
pub struct Orthonormal {
    directions: Vec<DVector<f64>>,
}

impl Orthonormal {
    /// Takes in what is new of a column; whether more than `threshold` of its norm is.
    pub fn push(&mut self, mut column: DVector<f64>, threshold: f64) -> bool {
        self.remove_from(column.as_view_mut());
        self.remove_from(column.as_view_mut());
        let norm = column.norm();
        let new = norm > threshold;
        if new {
            self.directions.push(column / norm);
        }
        new
    }

    /// Takes the share along the directions out of a column.
    pub fn remove_from(&self, mut column: DVectorViewMut<'_, f64>) {
        for direction in &self.directions {
            let share = direction.dot(&column);
            column.axpy(-share, direction, 1.0);
        }
    }

    pub fn directions(&self) -> &[DVector<f64>] {
        &self.directions
    }

    pub fn columns_from(&self, first: usize) -> DMatrix<f64> {
        DMatrix::from_columns(self.directions.get(first..).unwrap_or(&[]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_depends_is_not_taken_in() {
        let column = |values: &[f64]| DVector::from_row_slice(values);
        let mut basis = Orthonormal::default();
        assert!(basis.push(column(&[1.0, 1.0, 0.0]), 1e-9));
        assert!(basis.push(column(&[1.0, 0.0, 1e-6]), 1e-9));
        assert!(!basis.push(column(&[3.0, 5.0, -2e-6]), 1e-9));
        let columns = basis.columns_from(0);
        assert!((columns.tr_mul(&columns) - DMatrix::identity(2, 2)).norm() < 1e-12);
    }
}
