//! The rows of lengths by parameters and coefficients of the joints' errors, whitened pose by pose, what is free taken out.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::evidence::{Normal, Solved, Variance};
use super::priors::Group;
use crate::robot::AXES;

/// Rows at a model.
#[derive(Clone)]
pub(super) struct System {
    /// A row a length, a column an unknown: parameters, then coefficients.
    pub(super) rows: DMatrix<f64>,
    /// Measured minus what the model without its corrections predicts, to first order.
    pub(super) right: DVector<f64>,
    /// Unit vectors along the bar, and the given standard deviations about their mean.
    pub(super) units: Vec<[f64; 3]>,
    pub(super) weights: Vec<f64>,
    /// Axis angles (rad), and what the joints move, mm/rad.
    pub(super) axes: Vec<[f64; AXES]>,
    pub(super) levers: Vec<[f64; AXES]>,
    /// Rows of equal pose.
    pub(super) poses: Vec<Vec<usize>>,
    pub(super) variances: Vec<Variance>,
    /// Places of the free and of the bound unknowns.
    pub(super) free: Vec<usize>,
    pub(super) bound: Vec<usize>,
}

/// The normal equations of a system with what is needed for what is free.
pub(super) struct Reduced {
    pub(super) normal: Normal,
    free: Option<Cholesky<f64, Dyn>>,
    /// Gram matrix of free by bound, and the right-hand side of the free.
    cross: DMatrix<f64>,
    free_right: DVector<f64>,
}

impl System {
    pub(super) fn bound_variances(&self) -> Vec<Variance> {
        self.bound.iter().map(|&k| self.variances[k]).collect()
    }

    /// The same with those groups only.
    pub(super) fn with_groups(&self, groups: &[Group]) -> Self {
        let is_kept = |k: &usize| self.variances[*k].group().is_none_or(|group| groups.contains(&group));
        Self { bound: self.bound.iter().copied().filter(is_kept).collect(), ..self.clone() }
    }

    /// Mean square of the residuals that these unknowns leave, mm^2.
    pub(super) fn mean_square(&self, unknowns: &DVector<f64>) -> f64 {
        (&self.right - &self.rows * unknowns).norm_squared() / self.rows.nrows() as f64
    }

    /// The normal equations of rows of unit noise, what is free taken out.
    pub(super) fn reduced(&self, ratio: f64) -> Option<Reduced> {
        let order: Vec<usize> = self.free.iter().chain(&self.bound).copied().collect();
        let count = order.len();
        let mut whole = DMatrix::zeros(self.rows.nrows(), count + 1);
        for (to, from) in order.iter().enumerate() {
            whole.column_mut(to).copy_from(&self.rows.column(*from));
        }
        whole.column_mut(count).copy_from(&self.right);
        let ln_whitening = self.whiten_all(&mut whole, ratio)?;
        let gram = whole.transpose() * &whole;
        let (f, b) = (self.free.len(), self.bound.len());
        let cross = gram.view((0, f), (f, b)).into_owned();
        let free_right = gram.view((0, count), (f, 1)).column(0).into_owned();
        let mut normal = Normal {
            gram: gram.view((f, f), (b, b)).into_owned(),
            rhs: gram.view((f, count), (b, 1)).column(0).into_owned(),
            squares: gram[(count, count)],
            freedom: (self.rows.nrows() - f) as f64,
            ln_whitening,
        };
        if f == 0 {
            return Some(Reduced { normal, free: None, cross, free_right });
        }
        let free = Cholesky::new(gram.view((0, 0), (f, f)).into_owned())?;
        let taken = free.l().solve_lower_triangular(&cross)?;
        let right = free.l().solve_lower_triangular(&free_right)?;
        normal.gram -= taken.transpose() * &taken;
        normal.rhs -= taken.tr_mul(&right);
        normal.squares -= right.norm_squared();
        normal.ln_whitening += free.l_dirty().diagonal().iter().map(|pivot| 2.0 * pivot.ln()).sum::<f64>();
        Some(Reduced { normal, free: Some(free), cross, free_right })
    }

    /// Brings rows to unit noise; the logarithm of the determinant of their covariance.
    pub(super) fn whiten_all(&self, whole: &mut DMatrix<f64>, ratio: f64) -> Option<f64> {
        let mut ln_determinant = 0.0;
        for rows in &self.poses {
            ln_determinant += self.whiten(whole, rows, ratio)?;
        }
        Some(ln_determinant)
    }

    /// Brings the rows of a pose to unit noise; the logarithm of the determinant of their covariance.
    fn whiten(&self, whole: &mut DMatrix<f64>, rows: &[usize], ratio: f64) -> Option<f64> {
        let covariance = DMatrix::from_fn(rows.len(), rows.len(), |i, j| {
            let [u, v] = [rows[i], rows[j]].map(|row| self.units[row]);
            let shared = u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
            let own = if i == j { (ratio * self.weights[rows[i]]).powi(2) } else { 0.0 };
            shared + own
        });
        let factor = Cholesky::new(covariance)?.l();
        for mut column in whole.column_iter_mut() {
            for i in 0..rows.len() {
                let before: f64 = (0..i).map(|j| factor[(i, j)] * column[rows[j]]).sum();
                column[rows[i]] = (column[rows[i]] - before) / factor[(i, i)];
            }
        }
        Some(factor.diagonal().iter().map(|pivot| 2.0 * pivot.ln()).sum())
    }

    /// All unknowns; of what is free the step.
    pub(super) fn all(&self, reduced: &Reduced, solved: &Solved) -> DVector<f64> {
        let bound = solved.unknowns();
        let mut all = DVector::zeros(self.rows.ncols());
        self.bound.iter().zip(&bound).for_each(|(k, value)| all[*k] = *value);
        if let Some(free) = &reduced.free {
            let step = free.solve(&(&reduced.free_right - &reduced.cross * bound));
            self.free.iter().zip(&step).for_each(|(k, value)| all[*k] = *value);
        }
        all
    }

    /// A root of the covariance of all unknowns.
    pub(super) fn root(&self, reduced: &Reduced, solved: &Solved, sigma_mm: f64) -> Option<DMatrix<f64>> {
        let bound = solved.root()?;
        let (f, b) = (self.free.len(), self.bound.len());
        let mut root = DMatrix::zeros(self.rows.ncols(), b + f);
        for (at, k) in self.bound.iter().enumerate() {
            root.view_mut((*k, 0), (1, b)).copy_from(&bound.row(at));
        }
        if let Some(free) = &reduced.free {
            let follows = -free.solve(&(&reduced.cross * &bound));
            let own = free.l().transpose().solve_upper_triangular(&DMatrix::identity(f, f))? * sigma_mm;
            for (at, k) in self.free.iter().enumerate() {
                root.view_mut((*k, 0), (1, b)).copy_from(&follows.row(at));
                root.view_mut((*k, b), (1, f)).copy_from(&own.row(at));
            }
        }
        root.iter().all(|value| value.is_finite()).then_some(root)
    }
}
