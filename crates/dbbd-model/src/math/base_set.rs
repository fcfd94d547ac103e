//! Numerical rank of a matrix, a base set of its columns, and how the other columns depend on the base set.

use nalgebra::{DMatrix, DVector};

use super::{OrthonormalBasis, svd};

/// Columns with a smaller norm count as zero (mm per mm, or mm per rad).
const ZERO_COLUMN: f64 = 1e-9;
/// Singular values of the unit-norm columns below this fraction of the largest count as zero.
const RANK_TOLERANCE: f64 = 1e-8;

#[derive(Clone, Debug)]
pub struct BaseSet {
    /// Numerical rank of the columns, each scaled to unit norm.
    pub rank: usize,
    /// The independent columns, in the order of preference.
    pub kept: Vec<usize>,
    pub zero: Vec<usize>,
    /// The linearly dependent columns with their coefficients: `column = sum x[k] * kept[k]`.
    pub dependent: Vec<(usize, DVector<f64>)>,
    /// Condition number of the kept columns, each scaled to unit norm.
    pub condition: f64,
}

/// The rank of the columns of `r`, each scaled to unit norm; `None` if an element is not finite.
pub fn rank(r: &DMatrix<f64>) -> Option<usize> {
    let norms = r.column_iter().map(|column| (column.norm(), column));
    let live = norms.filter(|(norm, _)| norm.is_nan() || *norm >= ZERO_COLUMN);
    rank_of_unit_columns(&live.map(|(norm, column)| column / norm).collect::<Vec<_>>())
}

fn rank_of_unit_columns(unit: &[DVector<f64>]) -> Option<usize> {
    if unit.is_empty() {
        return Some(0);
    }
    Some(rank_by(&svd(&DMatrix::from_columns(unit))?.values))
}

/// The rank by singular values, largest first.
fn rank_by(values: &DVector<f64>) -> usize {
    values.iter().filter(|value| **value > RANK_TOLERANCE * values[0]).count()
}

/// Chooses a base set among the columns of `r` (a triangular factor, or any matrix with the same Gram matrix). Columns
/// are tried in the `order` of preference; a column that depends on those already taken is rejected. `None` if an element
/// is not finite.
pub(crate) fn base_set(r: &DMatrix<f64>, order: &[usize]) -> Option<BaseSet> {
    let norms: Vec<f64> = r.column_iter().map(|column| column.norm()).collect();
    let (zero, live): (Vec<usize>, Vec<usize>) = order.iter().partition(|&&j| norms[j] < ZERO_COLUMN);
    let unit: Vec<DVector<f64>> = live.iter().map(|&j| r.column(j) / norms[j]).collect();
    if unit.is_empty() {
        return Some(BaseSet { rank: 0, kept: vec![], zero, dependent: vec![], condition: 1.0 });
    }
    let values = svd(&DMatrix::from_columns(&unit))?.values;
    let rank = rank_by(&values);
    // The residuals of the sequential choice are not singular values. Where the two disagree on the number of columns, the
    // singular values decide.
    let (taken, rejected) = [1.0, 10.0, 0.1, 100.0, 1e3, 1e4, 1e-2, 1e-3]
        .iter()
        .map(|factor| choose(&unit, RANK_TOLERANCE * factor))
        .find(|(taken, _)| taken.len() == rank)
        .unwrap_or_else(|| choose(&unit, RANK_TOLERANCE));
    let kept_columns = DMatrix::from_columns(&taken.iter().map(|&i| unit[i].clone()).collect::<Vec<_>>());
    // The order of columns does not change their singular values.
    let kept_values = if rejected.is_empty() { values } else { svd(&kept_columns)?.values };
    let qr = kept_columns.qr();
    let dependent = rejected
        .iter()
        .filter_map(|&i| {
            let rhs = qr.q().transpose() * &unit[i];
            let scaled = qr.r().solve_upper_triangular(&rhs)?;
            let x = DVector::from_fn(taken.len(), |k, _| scaled[k] * norms[live[i]] / norms[live[taken[k]]]);
            Some((live[i], x))
        })
        .collect();
    Some(BaseSet {
        rank,
        kept: taken.iter().map(|&i| live[i]).collect(),
        zero,
        dependent,
        condition: kept_values[0] / kept_values[kept_values.len() - 1],
    })
}

/// Goes through the columns in turn: the taken ones, and those rejected because the norm of their new part is below
/// `threshold`.
fn choose(unit: &[DVector<f64>], threshold: f64) -> (Vec<usize>, Vec<usize>) {
    let mut directions = OrthonormalBasis::default();
    (0..unit.len()).partition(|&i| directions.push(unit[i].clone(), threshold))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dependent_column_is_reported_with_its_coefficients() {
        let a = DVector::from_row_slice(&[1.0, 2.0, 3.0, 4.0]);
        let b = DVector::from_row_slice(&[1.0, 0.0, -1.0, 5.0]);
        let matrix = DMatrix::from_columns(&[a.clone(), b.clone(), &a * 2.0 - &b * 3.0, DVector::zeros(4)]);
        let set = base_set(&matrix, &[1, 0, 2, 3]).unwrap();
        assert_eq!((set.rank, set.kept, set.zero), (2, vec![1, 0], vec![3]));
        let (column, x) = &set.dependent[0];
        assert_eq!(*column, 2);
        assert!((x[0] + 3.0).abs() < 1e-12 && (x[1] - 2.0).abs() < 1e-12);
    }

    /// numpy.linalg.cond of the two columns, each divided by its norm.
    #[test]
    fn condition_is_that_of_unit_columns() {
        let columns = [1.0, 2.0, 3.0, 4.0].map(|x| 1e3 * x).into_iter().chain([1.0, 0.0, -1.0, 5.0]);
        let set = base_set(&DMatrix::from_iterator(4, 2, columns), &[0, 1]).unwrap();
        assert!((set.condition - 2.107491029663531).abs() < 1e-12, "{}", set.condition);
        assert_eq!((set.rank, set.kept, set.zero.len(), set.dependent.len()), (2, vec![0, 1], 0, 0));
    }

    #[test]
    fn coefficients_are_those_of_the_columns_as_given() {
        // The columns have norms of 1, 10, 100 and 1e-3.
        let matrix = DMatrix::from_row_slice(
            3,
            4,
            &[
                1.0, 0.0, 60.0, 0.0, //
                0.0, 10.0, 80.0, 0.0, //
                0.0, 0.0, 0.0, 1e-3,
            ],
        );
        let set = base_set(&matrix, &[3, 2, 1, 0]).unwrap();
        assert_eq!((set.rank, set.kept), (3, vec![3, 2, 1]));
        // column 0 = (column 2 - 8 column 1) / 60.
        let (column, x) = &set.dependent[0];
        assert_eq!(*column, 0);
        for (value, expected) in x.iter().zip([0.0, 1.0 / 60.0, -8.0 / 60.0]) {
            assert!((value - expected).abs() < 1e-12, "{x}");
        }
    }

    #[test]
    fn rank_ignores_columns_of_zero_and_tiny_angles() {
        let with = |angle: f64| DMatrix::from_row_slice(2, 3, &[1.0, 1.0, 1e-10, 0.0, angle, 0.0]);
        // The smaller singular value of two unit columns at an angle is about angle / sqrt(2), the larger sqrt(2).
        assert_eq!(rank(&with(1e-7)), Some(2));
        assert_eq!(rank(&with(1e-9)), Some(1));
        assert_eq!(rank(&DMatrix::zeros(2, 2)), Some(0));
        assert_eq!(rank(&DMatrix::from_element(2, 1, f64::NAN)), None);
    }
}
