//! Least squares over streamed rows. Householder reflections fold one block of rows at a time into a triangular factor, so
//! that memory does not grow with the number of rows.

use nalgebra::{DMatrix, DVector};

/// Rows of a block: enough for long inner loops, few enough for the cache.
const BLOCK: usize = 64;

/// A linear least-squares problem: the triangular factor of all rows `[row | rhs]` so far.
#[derive(Clone, Debug)]
pub struct Triangle {
    /// Number of unknowns.
    n: usize,
    /// Upper triangle of order n + 1, column-major; its last column is the right-hand side.
    r: Vec<f64>,
    /// Rows that are not folded yet, column-major.
    block: Vec<f64>,
    waiting: usize,
}

impl Triangle {
    /// A problem without any row.
    pub fn new(unknowns: usize) -> Self {
        let width = unknowns + 1;
        Self { n: unknowns, r: vec![0.0; width * width], block: vec![0.0; BLOCK * width], waiting: 0 }
    }

    pub(crate) fn unknowns(&self) -> usize {
        self.n
    }

    /// Adds the equation `row . x = rhs`.
    pub fn push(&mut self, row: &[f64], rhs: f64) {
        debug_assert_eq!(row.len(), self.n);
        let mut columns = self.block.chunks_exact_mut(BLOCK);
        for (value, column) in row.iter().zip(columns.by_ref()) {
            column[self.waiting] = *value;
        }
        for column in columns {
            column[self.waiting] = rhs;
        }
        self.waiting += 1;
        if self.waiting == BLOCK {
            self.fold();
        }
    }

    /// Adds the equation `scale * x[unknown] = rhs`.
    pub(crate) fn push_single(&mut self, unknown: usize, scale: f64, rhs: f64) {
        let mut row = vec![0.0; self.n];
        row[unknown] = scale;
        self.push(&row, rhs);
    }

    /// All rows of several triangles of `unknowns` unknowns.
    pub fn merged(triangles: Vec<Triangle>, unknowns: usize) -> Triangle {
        let width = unknowns + 1;
        let mut triangles = triangles.into_iter();
        let mut whole = triangles.next().unwrap_or_else(|| Triangle::new(unknowns));
        for mut other in triangles {
            other.fold();
            for i in 0..width {
                let row: Vec<f64> =
                    (0..unknowns).map(|j| if j >= i { other.r[j * width + i] } else { 0.0 }).collect();
                whole.push(&row, other.r[unknowns * width + i]);
            }
        }
        whole
    }

    /// Folds the waiting rows into the triangle.
    fn fold(&mut self) {
        let width = self.n + 1;
        let rows = self.waiting;
        for k in 0..width {
            let (head, tail) = self.block.split_at_mut((k + 1) * BLOCK);
            let pivot = &head[k * BLOCK..k * BLOCK + rows];
            let below = dot(pivot, pivot);
            // With more unknowns than rows, rounding shrinks what is left of them until its square is no normal number.
            if below < f64::MIN_POSITIVE {
                continue;
            }
            let diagonal = self.r[k * width + k];
            let norm = (diagonal * diagonal + below).sqrt();
            let reflected = if diagonal > 0.0 { -norm } else { norm };
            let first = diagonal - reflected;
            let beta = 2.0 / (first * first + below);
            self.r[k * width + k] = reflected;
            for j in k + 1..width {
                let at = (j - k - 1) * BLOCK;
                let column = &mut tail[at..at + rows];
                let top = &mut self.r[j * width + k];
                let scale = beta * (first * *top + dot(pivot, column));
                *top -= scale * first;
                for (y, x) in column.iter_mut().zip(pivot) {
                    *y -= scale * x;
                }
            }
        }
        self.waiting = 0;
    }

    /// The problem of some of the unknowns, in this order; the others are zero.
    pub(crate) fn of_unknowns(&mut self, some: &[usize]) -> Self {
        self.fold();
        let width = self.n + 1;
        let mut part = Self::new(some.len());
        for i in 0..width {
            let at = |column: usize| if column >= i { self.r[column * width + i] } else { 0.0 };
            let row: Vec<f64> = some.iter().map(|unknown| at(*unknown)).collect();
            part.push(&row, at(self.n));
        }
        part
    }

    /// The factor R, n x n upper triangular: R'R is the Gram matrix of the rows.
    pub(crate) fn factor(&mut self) -> DMatrix<f64> {
        self.fold();
        let width = self.n + 1;
        DMatrix::from_fn(self.n, self.n, |i, j| if j >= i { self.r[j * width + i] } else { 0.0 })
    }

    /// The right-hand side that belongs to the factor: the solution x has `R x = rhs`.
    pub(crate) fn rhs(&mut self) -> DVector<f64> {
        self.fold();
        let width = self.n + 1;
        DVector::from_fn(self.n, |i, _| self.r[self.n * width + i])
    }

    /// The sum of squared residuals of the solution.
    pub(crate) fn residual_sum(&mut self) -> f64 {
        self.fold();
        let corner = self.r[self.n * (self.n + 1) + self.n];
        corner * corner
    }

    /// The solution by back substitution; `None` if a pivot is zero or not finite.
    pub fn solve(&mut self) -> Option<DVector<f64>> {
        self.fold();
        let width = self.n + 1;
        let mut x = DVector::zeros(self.n);
        for i in (0..self.n).rev() {
            let mut sum = self.r[self.n * width + i];
            for j in i + 1..self.n {
                sum -= self.r[j * width + i] * x[j];
            }
            x[i] = sum / self.r[i * width + i];
            if !x[i].is_finite() {
                return None;
            }
        }
        Some(x)
    }

    /// The solution with the further rows `sqrt(damping) * scale[k] * x[k] = 0` (Levenberg and Marquardt); `None` as in
    /// [`Self::solve`].
    pub(crate) fn solve_damped(&self, scale: &DVector<f64>, damping: f64) -> Option<DVector<f64>> {
        let mut damped = self.clone();
        for (unknown, scale) in scale.iter().enumerate() {
            damped.push_single(unknown, damping.sqrt() * scale, 0.0);
        }
        damped.solve()
    }
}

/// Dot product in eight partial sums, so that the processor need not wait for each addition.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (a, b) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest: f64 = a.remainder().iter().zip(b.remainder()).map(|(x, y)| x * y).sum();
    let mut sums = [0.0; 8];
    for (x, y) in a.zip(b) {
        for lane in 0..8 {
            sums[lane] += x[lane] * y[lane];
        }
    }
    sums.iter().sum::<f64>() + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_rounding_errors_stay_finite() {
        let mut triangle = Triangle::new(2);
        triangle.push(&[1e-161, 1.0], 2.0);
        assert!(triangle.factor().iter().chain(triangle.rhs().iter()).all(|x| x.is_finite()));
        assert_eq!(triangle.rhs()[1].abs(), 2.0);
    }

    /// A straight line through points.
    #[test]
    fn streamed_rows_agree_with_the_normal_equations() {
        let points: Vec<(f64, f64)> = (0..200).map(|i| (f64::from(i) * 0.1, f64::from(i % 7))).collect();
        let mut triangle = Triangle::new(2);
        for (x, y) in &points {
            triangle.push(&[1.0, *x], *y);
        }
        let n = points.len() as f64;
        let sum = |f: fn(&(f64, f64)) -> f64| points.iter().map(f).sum::<f64>();
        let (sx, sy, sxx, sxy) = (sum(|p| p.0), sum(|p| p.1), sum(|p| p.0 * p.0), sum(|p| p.0 * p.1));
        let slope = (n * sxy - sx * sy) / (n * sxx - sx * sx);
        let offset = (sy - slope * sx) / n;
        let x = triangle.solve().unwrap();
        assert!((x[0] - offset).abs() < 1e-12 && (x[1] - slope).abs() < 1e-12);
        let rss: f64 = points.iter().map(|(x, y)| (y - offset - slope * x).powi(2)).sum();
        assert!((triangle.residual_sum() - rss).abs() < 1e-9 * rss);
    }

    #[test]
    fn merged_halves_equal_the_whole() {
        let rows: Vec<[f64; 3]> =
            (0..150).map(|i| [(i % 5) as f64, (i % 11) as f64, (i % 3) as f64]).collect();
        let (mut whole, mut left, mut right) = (Triangle::new(2), Triangle::new(2), Triangle::new(2));
        for (i, row) in rows.iter().enumerate() {
            whole.push(&row[..2], row[2]);
            if i < 70 { left.push(&row[..2], row[2]) } else { right.push(&row[..2], row[2]) }
        }
        let mut merged = Triangle::merged(vec![left, right], 2);
        assert!((whole.solve().unwrap() - merged.solve().unwrap()).norm() < 1e-12);
    }

    /// Five rows of three unknowns.
    const ROWS: [([f64; 3], f64); 5] = [
        ([1.0, 2.0, 0.0], 1.0),
        ([0.0, 1.0, -1.0], 2.0),
        ([3.0, 0.5, 2.0], -1.0),
        ([1.0, -1.0, 4.0], 0.5),
        ([2.0, 2.0, 1.0], 3.0),
    ];

    fn filled() -> Triangle {
        let mut triangle = Triangle::new(3);
        ROWS.iter().for_each(|(row, rhs)| triangle.push(row, *rhs));
        triangle
    }

    /// numpy.linalg.lstsq of [`ROWS`].
    #[test]
    fn solution_and_residual_match_numpy() {
        let mut triangle = filled();
        let expected = [-1.061570247933885, 1.7033057851239686, 0.779338842975207];
        for (value, expected) in triangle.solve().unwrap().iter().zip(expected) {
            assert!((value - expected).abs() < 1e-13, "{value} for {expected}");
        }
        assert!((triangle.residual_sum() - 3.9179752066115694).abs() < 1e-13);
        assert_eq!(triangle.unknowns(), 3);
    }

    /// numpy.linalg.solve(X'X + 0.3 diag([1, 2, .5])^2, X'y) of [`ROWS`].
    #[test]
    fn damping_adds_its_multiple_of_the_squared_scale() {
        let scale = DVector::from_row_slice(&[1.0, 2.0, 0.5]);
        let expected = [-0.589972002600982, 1.2039292518781028, 0.47508595854894653];
        for (value, expected) in filled().solve_damped(&scale, 0.3).unwrap().iter().zip(expected) {
            assert!((value - expected).abs() < 1e-13, "{value} for {expected}");
        }
    }

    #[test]
    fn factor_has_the_gram_matrix_of_the_rows_and_its_right_hand_side() {
        let mut triangle = filled();
        let x = DMatrix::from_fn(5, 3, |i, j| ROWS[i].0[j]);
        let y = DVector::from_fn(5, |i, _| ROWS[i].1);
        let (r, rhs) = (triangle.factor(), triangle.rhs());
        assert!((r.transpose() * &r - x.transpose() * &x).norm() < 1e-13);
        assert!((r.transpose() * rhs - x.transpose() * y).norm() < 1e-13);
        assert_eq!((r[(1, 0)], r[(2, 0)], r[(2, 1)]), (0.0, 0.0, 0.0));
    }

    #[test]
    fn a_single_row_is_its_unknown_times_its_scale() {
        let mut triangle = Triangle::new(2);
        triangle.push_single(1, 4.0, 6.0);
        assert!(triangle.solve().is_none(), "nothing determines the first unknown");
        triangle.push_single(0, 2.0, -1.0);
        assert_eq!(triangle.solve().unwrap().as_slice(), [-0.5, 1.5]);
    }

    #[test]
    fn merged_triangles_keep_the_residuals() {
        let (mut left, mut right) = (Triangle::new(3), Triangle::new(3));
        for (at, (row, rhs)) in ROWS.iter().enumerate() {
            if at == 1 { left.push(row, *rhs) } else { right.push(row, *rhs) }
        }
        let mut merged = Triangle::merged(vec![left, right], 3);
        assert!((merged.residual_sum() - 3.9179752066115694).abs() < 1e-12);
        assert_eq!(Triangle::merged(Vec::new(), 3).factor(), DMatrix::zeros(3, 3));
    }

    #[test]
    fn dot_product_has_all_terms() {
        // sum k (20 - k) for k = 0..20 is 20 * 190 - 2470.
        let a: Vec<f64> = (0..20).map(f64::from).collect();
        let b: Vec<f64> = (0..20).map(|k| f64::from(20 - k)).collect();
        assert_eq!(dot(&a, &b), 1330.0);
    }
}
