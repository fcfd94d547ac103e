//! The rows of lengths by parameters and coefficients of the joints' errors, whitened pose by pose, what is free taken out.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::evidence::{Normal, Solved, Variance};
use super::noise_shape::NoiseShape;
use super::pose_rows::PoseRows;
use super::priors::Group;

/// Rows at a model.
#[derive(Clone)]
pub(super) struct System {
    pub(super) lines: PoseRows,
    /// Measured minus what the model without its corrections predicts, to first order.
    pub(super) right: DVector<f64>,
    /// The given standard deviations about their mean.
    pub(super) weights: Vec<f64>,
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

    /// What these unknowns leave, mm.
    pub(super) fn residual(&self, unknowns: &DVector<f64>) -> DMatrix<f64> {
        let left = &self.right - &self.lines.values * unknowns;
        DMatrix::from_column_slice(left.len(), 1, left.as_slice())
    }

    /// Mean square of the residuals that these unknowns leave, mm^2.
    pub(super) fn mean_square(&self, unknowns: &DVector<f64>) -> f64 {
        self.residual(unknowns).norm_squared() / self.lines.values.nrows() as f64
    }

    /// The normal equations of rows of unit noise, what is free taken out.
    pub(super) fn reduced(&self, shape: NoiseShape) -> Option<Reduced> {
        let order: Vec<usize> = self.free.iter().chain(&self.bound).copied().collect();
        let count = order.len();
        let mut whole = DMatrix::zeros(self.lines.values.nrows(), count + 1);
        for (to, from) in order.iter().enumerate() {
            whole.column_mut(to).copy_from(&self.lines.values.column(*from));
        }
        whole.column_mut(count).copy_from(&self.right);
        let ln_whitening = self.whiten_all(&mut whole, shape)?;
        let gram = whole.transpose() * &whole;
        let (f, b) = (self.free.len(), self.bound.len());
        let cross = gram.view((0, f), (f, b)).into_owned();
        let free_right = gram.view((0, count), (f, 1)).column(0).into_owned();
        let mut normal = Normal {
            gram: gram.view((f, f), (b, b)).into_owned(),
            rhs: gram.view((f, count), (b, 1)).column(0).into_owned(),
            squares: gram[(count, count)],
            freedom: (self.lines.values.nrows() - f) as f64,
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

    /// Brings rows to unit noise of the pose; the logarithm of the determinant of their covariance.
    pub(super) fn whiten_all(&self, whole: &mut DMatrix<f64>, shape: NoiseShape) -> Option<f64> {
        self.lines.whiten(whole, &shape.of_rows(&self.lines, &self.weights))
    }

    /// Root of the mean variance of the lengths, in units of that of a pose.
    pub(super) fn rms_sd(&self, shape: NoiseShape) -> f64 {
        self.lines.rms_sd(&shape.of_rows(&self.lines, &self.weights))
    }

    /// All unknowns; of what is free the step.
    pub(super) fn all(&self, reduced: &Reduced, solved: &Solved) -> DVector<f64> {
        let bound = solved.unknowns();
        let mut all = DVector::zeros(self.lines.values.ncols());
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
        let mut root = DMatrix::zeros(self.lines.values.ncols(), b + f);
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
