//! The linearised lengths, whitened pose by pose, and the posterior of their unknowns: parameters, then coefficients of the
//! joints' errors.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::evidence::{Coefficients, Evidence, NormalEquations, Optimum, Products};
use super::hyper_parameters::{Group, HYPERS, HyperPrior, Hypers, Variance};
use super::noise_shape::NoiseShape;
use super::pose_rows::{PoseRows, Whitening};
use crate::math::{beside, gram};

/// Design rows at a model.
pub(super) struct System {
    pub(super) rows: PoseRows,
    /// Measured minus predicted length at a model whose unknowns are zero, to first order, mm.
    pub(super) right: DVector<f64>,
    /// The given standard deviation of each length, divided by their root mean square.
    pub(super) weights: Vec<f64>,
    /// Prior variance of each unknown; `None` for a free one.
    pub(super) variances: Vec<Option<Variance>>,
    pub(super) is_sigma_given: bool,
    /// Median of the prior of the noise, mm.
    pub(super) sigma_mm: f64,
}

/// A system whose rows are whitened.
pub(super) struct Whitened {
    pub(super) shape: NoiseShape,
    pub(super) whitening: Whitening,
    pub(super) rows: DMatrix<f64>,
    pub(super) right: DVector<f64>,
    pub(super) weights: Vec<f64>,
    pub(super) equations: Equations,
}

/// Normal equations of the bound unknowns (those with a prior), and the matrices from which the free unknowns follow.
pub(super) struct Equations {
    evidence: Evidence,
    /// Places of the bound and of the free unknowns among all.
    bound: Vec<usize>,
    free: Vec<usize>,
    /// The unit of each free unknown in the fields below.
    units: DVector<f64>,
    unknowns: usize,
    factor: Cholesky<f64, Dyn>,
    /// Gram matrix of free by bound unknowns, and the right-hand side of the free unknowns.
    across: DMatrix<f64>,
    free_right: DVector<f64>,
}

/// The posterior of all unknowns at given hyper-parameters.
pub(super) struct SystemPosterior<'a> {
    equations: &'a Equations,
    coefficients: Coefficients,
    pub(super) sigma_mm: f64,
    /// The posterior mean of all unknowns; for a free unknown the step.
    pub(super) mean: DVector<f64>,
}

impl System {
    /// Whether the residuals are larger than rounding.
    pub(super) fn is_noisy(&self) -> bool {
        const ROUNDING_MM: f64 = 1e-6;
        self.rows.residual.norm() > ROUNDING_MM * (self.right.len() as f64).sqrt()
    }

    /// Mean square of the residuals that these unknowns leave, mm^2.
    pub(super) fn mean_square(&self, unknowns: &DVector<f64>) -> f64 {
        (&self.right - &self.rows.values * unknowns).norm_squared() / self.right.len() as f64
    }

    /// Root mean square of the lengths' standard deviations, in units of sigma, the standard deviation of a pose.
    pub(super) fn rms_sd(&self, shape: NoiseShape, sigma_mm: f64) -> f64 {
        self.rows.rms_sd(&shape.of_rows(&self.rows, &self.weights, sigma_mm))
    }

    /// The system with whitened rows, whose noise has the standard deviation sigma of a pose. `None` if the noise or
    /// free unknowns are not determined.
    pub(super) fn whitened(&self, shape: NoiseShape, sigma_mm: f64) -> Option<Whitened> {
        let whitening = self.rows.whitening(&shape.of_rows(&self.rows, &self.weights, sigma_mm))?;
        let (mut rows, mut right) = (self.rows.values.clone(), self.right.clone());
        whitening.apply(&mut rows);
        whitening.apply(&mut right);
        let ln_whitening = whitening.ln_determinant();
        let equations = if rows.nrows() < rows.ncols() {
            let totals = RowTotals { squares: right.norm_squared(), rows: rows.nrows(), ln_whitening };
            let products = Products::OfRows { rows: rows.clone(), right: right.clone() };
            Equations::of(self, &products, totals)?
        } else {
            NormalSums::of(&rows, &right, ln_whitening).equations(self)?
        };
        Some(Whitened { shape, whitening, rows, right, weights: self.weights.clone(), equations })
    }

    /// The sums over the whitened rows of this system.
    pub(super) fn normal_sums(&self, shape: NoiseShape, sigma_mm: f64) -> Option<NormalSums> {
        let whitening = self.rows.whitening(&shape.of_rows(&self.rows, &self.weights, sigma_mm))?;
        let (mut rows, mut right) = (self.rows.values.clone(), self.right.clone());
        whitening.apply(&mut rows);
        whitening.apply(&mut right);
        Some(NormalSums::of(&rows, &right, whitening.ln_determinant()))
    }
}

/// Sums over whitened rows, from which the normal equations are formed.
#[derive(Clone, Debug)]
pub(super) struct NormalSums {
    gram: DMatrix<f64>,
    right: DVector<f64>,
    totals: RowTotals,
}

#[derive(Clone, Copy, Debug)]
struct RowTotals {
    /// Sum of the squared right-hand sides.
    squares: f64,
    rows: usize,
    ln_whitening: f64,
}

impl NormalSums {
    fn of(rows: &DMatrix<f64>, right: &DVector<f64>, ln_whitening: f64) -> Self {
        Self {
            gram: gram(rows),
            right: rows.tr_mul(right),
            totals: RowTotals { squares: right.norm_squared(), rows: rows.nrows(), ln_whitening },
        }
    }

    pub(super) fn and(self, other: &Self) -> Self {
        Self {
            gram: self.gram + &other.gram,
            right: self.right + &other.right,
            totals: RowTotals {
                squares: self.totals.squares + other.totals.squares,
                rows: self.totals.rows + other.totals.rows,
                ln_whitening: self.totals.ln_whitening + other.totals.ln_whitening,
            },
        }
    }

    /// The normal equations of rows that have the unknowns of the system.
    pub(super) fn equations(self, system: &System) -> Option<Equations> {
        Equations::of(system, &Products::OfUnknowns { gram: self.gram, rhs: self.right }, self.totals)
    }
}

/// Added to the squares of columns of unit norm: a direction with a smaller square is rounding.
const SINGULAR: f64 = 1e-12;

impl Equations {
    fn of(system: &System, whole: &Products, totals: RowTotals) -> Option<Self> {
        let RowTotals { squares, rows, mut ln_whitening } = totals;
        let unknowns = system.variances.len();
        let (free, bound): (Vec<usize>, Vec<usize>) =
            (0..unknowns).partition(|&k| system.variances[k].is_none());
        let (mut of_free, mut free_right) = whole.of_unknowns(&free);
        // Free unknowns in units in which their columns have unit norm: mm and rad differ by orders of magnitude.
        let unit = |(at, &k): (usize, &usize)| {
            let norm = of_free[(at, k)].sqrt();
            if norm > 0.0 { norm.recip() } else { 1.0 }
        };
        let units = DVector::from_iterator(free.len(), free.iter().enumerate().map(unit));
        for (at, (&k, unit)) in free.iter().zip(&units).enumerate() {
            of_free.row_mut(at).scale_mut(*unit);
            of_free.column_mut(k).scale_mut(*unit);
            free_right[at] *= unit;
            ln_whitening -= 2.0 * unit.ln();
        }
        let mut of_both = of_free.select_columns(&free);
        // A list of the user may have a direction that only rounding determines.
        (0..free.len()).for_each(|k| of_both[(k, k)] += SINGULAR);
        let factor = Cholesky::new(of_both)?;
        let across = of_free.select_columns(&bound);
        let explained = factor.l().solve_lower_triangular(&across)?;
        let explained_right = factor.l().solve_lower_triangular(&free_right)?;
        ln_whitening += 2.0 * factor.l_dirty().diagonal().map(f64::ln).sum();
        let products = match whole {
            Products::OfUnknowns { gram, rhs } => Products::OfUnknowns {
                gram: gram.select_rows(&bound).select_columns(&bound) - explained.transpose() * &explained,
                rhs: rhs.select_rows(&bound) - explained.tr_mul(&explained_right),
            },
            Products::OfRows { rows, right } => {
                let scaled = rows.select_columns(&free) * DMatrix::from_diagonal(&units);
                // An orthonormal basis of the columns of the free unknowns, transposed.
                let basis = factor.l().solve_lower_triangular(&scaled.transpose())?;
                Products::OfRows {
                    rows: rows.select_columns(&bound) - basis.transpose() * &explained,
                    right: right - basis.tr_mul(&explained_right),
                }
            }
        };
        let normal = NormalEquations {
            products,
            squares: squares - explained_right.norm_squared(),
            freedom: rows as f64 - free.len() as f64,
            ln_whitening,
        };
        let variances = bound.iter().filter_map(|&k| system.variances[k]).collect();
        let hyper_priors = HyperPrior::all(system.sigma_mm);
        let evidence = Evidence { normal, variances, hyper_priors, is_sigma_given: system.is_sigma_given };
        Some(Self { evidence, bound, free, units, unknowns, factor, across, free_right })
    }

    /// The same equations with only these groups and the unknowns without a group; the other coefficients are zero.
    pub(super) fn with_groups(&self, groups: &[Group]) -> Self {
        let Evidence { normal, variances, .. } = &self.evidence;
        let is_kept = |at: &usize| variances[*at].group().is_none_or(|group| groups.contains(&group));
        let kept: Vec<usize> = (0..variances.len()).filter(is_kept).collect();
        let normal = NormalEquations { products: normal.products.with(&kept), ..*normal };
        let variances = kept.iter().map(|&at| variances[at]).collect();
        Self {
            evidence: Evidence { normal, variances, ..self.evidence },
            bound: kept.iter().map(|&at| self.bound[at]).collect(),
            across: self.across.select_columns(&kept),
            free: self.free.clone(),
            units: self.units.clone(),
            factor: self.factor.clone(),
            free_right: self.free_right.clone(),
            ..*self
        }
    }

    pub(super) fn hyper_priors(&self) -> &[HyperPrior; HYPERS] {
        &self.evidence.hyper_priors
    }

    /// The optimum of the hyper-parameters near `start`.
    pub(super) fn maximise(&self, start: Hypers) -> Option<Optimum> {
        self.evidence.maximise(start)
    }

    pub(super) fn posterior(&self, hypers: &Hypers) -> Option<SystemPosterior<'_>> {
        let coefficients = self.evidence.coefficients(hypers)?;
        let of_bound = coefficients.mean();
        let of_free = self.factor.solve(&(&self.free_right - &self.across * &of_bound));
        let mut mean = DVector::zeros(self.unknowns);
        self.bound.iter().zip(&of_bound).for_each(|(k, value)| mean[*k] = *value);
        let of_free = of_free.component_mul(&self.units);
        self.free.iter().zip(&of_free).for_each(|(k, value)| mean[*k] = *value);
        Some(SystemPosterior { equations: self, coefficients, sigma_mm: hypers.sigma_mm(), mean })
    }
}

impl SystemPosterior<'_> {
    /// A root of the covariance of all unknowns.
    pub(super) fn root(&self) -> Option<DMatrix<f64>> {
        let Equations { bound, free, units, factor, across, unknowns, .. } = self.equations;
        let of_bound = self.coefficients.root();
        let (b, f) = (bound.len(), free.len());
        let mut follows = -factor.solve(&(across * &of_bound));
        let mut own =
            factor.l().transpose().solve_upper_triangular(&DMatrix::identity(f, f))? * self.sigma_mm;
        for (at, unit) in units.iter().enumerate() {
            follows.row_mut(at).scale_mut(*unit);
            own.row_mut(at).scale_mut(*unit);
        }
        let mut root = DMatrix::zeros(*unknowns, b + f);
        for (at, k) in bound.iter().enumerate() {
            root.view_mut((*k, 0), (1, b)).copy_from(&of_bound.row(at));
        }
        for (at, k) in free.iter().enumerate() {
            root.view_mut((*k, 0), (1, b)).copy_from(&follows.row(at));
            root.view_mut((*k, b), (1, f)).copy_from(&own.row(at));
        }
        root.iter().all(|value| value.is_finite()).then_some(root)
    }

    /// Whitened rows A of the system times a root of the covariance of all unknowns, in units of sigma: K K' is the covariance
    /// that the unknowns give to the rows.
    pub(super) fn rows_by_root(&self, rows: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        let Equations { bound, free, units, factor, across, .. } = self.equations;
        let scaled = rows.select_columns(free) * DMatrix::from_diagonal(units);
        let basis = factor.l().solve_lower_triangular(&scaled.transpose())?.transpose();
        let explained = factor.l().solve_lower_triangular(across)?;
        let left = rows.select_columns(bound) - &basis * explained;
        Some(beside(self.coefficients.rows_by_root(&left) / self.sigma_mm, &basis))
    }

    /// The posterior variance of an unknown that has a prior.
    pub(super) fn variance(&self, place: usize) -> Option<f64> {
        let at = self.equations.bound.binary_search(&place).ok()?;
        Some(self.coefficients.variance(at))
    }

    /// Logarithm of the marginal likelihood under the priors of the hyper-parameters.
    pub(super) fn ln_evidence(&self, hypers: &Hypers) -> f64 {
        self.coefficients.ln_likelihood + self.equations.evidence.ln_prior(hypers)
    }

    /// The fraction of each unknown that the data determine, from 0 to 1.
    pub(super) fn determined(&self) -> Vec<f64> {
        let mut determined = vec![1.0; self.equations.unknowns];
        let of_bound = self.coefficients.determined();
        self.equations.bound.iter().zip(of_bound).for_each(|(k, share)| determined[*k] = share);
        determined
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::noise_shape::{JointNoise, OwnNoise};
    use super::super::tests::cell_of_poses::{hypers, model, normals, readings};
    use super::*;
    use crate::measurement::PreparedMeasurement;
    use crate::robot::{BallId, BarId, Coordinate, Joint, ParamId};

    pub(in crate::estimation) const SIGMA_MM: f64 = 0.03;
    pub(in crate::estimation) const SHAPE: NoiseShape =
        NoiseShape { own: OwnNoise::Stated(0.01), joints: JointNoise::NONE };

    /// Two bound parameters of the robot, a bar, and two free balls.
    fn ids() -> Vec<ParamId> {
        let balls = (0..2).flat_map(|ball| Coordinate::ALL.map(|axis| ParamId::Ball(BallId::at(ball), axis)));
        let mut ids =
            vec![ParamId::Theta(Joint::J2), ParamId::A(Joint::J3), ParamId::BarOffset(BarId::FIRST)];
        ids.extend(balls);
        ids.sort();
        ids
    }

    pub(in crate::estimation) fn system(readings: &[PreparedMeasurement]) -> System {
        let unit = vec![1.0; readings.len()];
        let rows = PoseRows::at(&model(2), &(readings, unit.as_slice()), &ids(), |_| None);
        let variance = |id: &ParamId| match id {
            ParamId::Ball(..) => None,
            ParamId::Theta(_) => Some(Variance::Of(Group::Harmonic, 1.0)),
            ParamId::BarOffset(_) => Some(Variance::Fixed(0.05)),
            _ => Some(Variance::Of(Group::Tolerance, 0.5)),
        };
        let right = normals(readings.len(), 3) * 0.1;
        System {
            right,
            weights: vec![1.0; readings.len()],
            rows,
            variances: ids().iter().map(variance).collect(),
            is_sigma_given: false,
            sigma_mm: SIGMA_MM,
        }
    }

    /// The covariance of the noise: sigma^2 u'v of the lengths of a pose, and the independent noise of each.
    pub(in crate::estimation) fn noise(system: &System) -> DMatrix<f64> {
        let rows = &system.rows;
        let mut noise = DMatrix::zeros(rows.lengths.len(), rows.lengths.len());
        for pose in &rows.poses {
            for (i, j) in pose.iter().flat_map(|i| pose.iter().map(move |j| (*i, *j))) {
                let cosine: f64 = (0..3).map(|k| rows.lengths[i].unit[k] * rows.lengths[j].unit[k]).sum();
                noise[(i, j)] = SIGMA_MM * SIGMA_MM * cosine + if i == j { 0.01 * 0.01 } else { 0.0 };
            }
        }
        noise
    }

    /// Mean and covariance of A'S^-1 A + P by dense normal equations, columns in units of their norm.
    pub(in crate::estimation) fn dense(system: &System, hypers: &Hypers) -> (DVector<f64>, DMatrix<f64>) {
        let a = &system.rows.values;
        let units = DVector::from_iterator(a.ncols(), a.column_iter().map(|column| column.norm().recip()));
        let scaled = a * DMatrix::from_diagonal(&units);
        let inverse_noise = noise(system).try_inverse().unwrap();
        let mut precision = scaled.transpose() * &inverse_noise * &scaled;
        for (k, variance) in system.variances.iter().enumerate() {
            precision[(k, k)] +=
                variance.map_or(0.0, |variance| units[k] * units[k] / variance.value(hypers));
        }
        let covariance = precision.try_inverse().unwrap();
        let mean = &covariance * (scaled.transpose() * inverse_noise * &system.right);
        let units = DMatrix::from_diagonal(&units);
        (&units * mean, &units * covariance * &units)
    }

    fn assert_alike(mean: &DVector<f64>, root: &DMatrix<f64>, expected: &(DVector<f64>, DMatrix<f64>)) {
        let covariance = root * root.transpose();
        for i in 0..mean.len() {
            let sd = expected.1[(i, i)].sqrt();
            assert!((mean[i] - expected.0[i]).abs() < 1e-9 * sd.max(expected.0[i].abs()), "mean of {i}");
            for j in 0..mean.len() {
                let size = sd * expected.1[(j, j)].sqrt();
                assert!((covariance[(i, j)] - expected.1[(i, j)]).abs() < 1e-9 * size, "{i} {j}");
            }
        }
    }

    #[test]
    fn posterior_with_free_unknowns_taken_out_is_that_of_the_dense_equations() {
        let system = system(&readings(&model(2), 30, 1));
        let hypers = hypers(SIGMA_MM);
        let whitened = system.whitened(SHAPE, SIGMA_MM).unwrap();
        let posterior = whitened.equations.posterior(&hypers).unwrap();
        assert_alike(&posterior.mean, &posterior.root().unwrap(), &dense(&system, &hypers));
    }

    /// With F the free columns, V the covariance of noise and bound unknowns, and e what generalised least squares of F leave,
    /// the likelihood of what F does not explain is |V|^-1/2 |F'V^-1 F|^-1/2 exp(-e'V^-1 e / 2) up to factors of 2 pi
    /// (Harville 1974).
    #[test]
    fn evidence_is_the_restricted_likelihood() {
        let system = system(&readings(&model(2), 30, 1));
        let hypers = hypers(SIGMA_MM);
        let free: Vec<usize> =
            (0..system.variances.len()).filter(|k| system.variances[*k].is_none()).collect();
        let mut covariance = noise(&system);
        for (k, variance) in system.variances.iter().enumerate() {
            let Some(variance) = variance else { continue };
            let column = system.rows.values.column(k);
            covariance += column * column.transpose() * variance.value(&hypers);
        }
        let ln = |matrix: &DMatrix<f64>| {
            2.0 * Cholesky::new(matrix.clone()).unwrap().l_dirty().diagonal().map(f64::ln).sum()
        };
        let inverse = covariance.clone().try_inverse().unwrap();
        let own = system.rows.values.select_columns(&free);
        let normal = own.transpose() * &inverse * &own;
        let step = normal.clone().try_inverse().unwrap() * (own.transpose() * &inverse * &system.right);
        let left = &system.right - &own * step;
        let freedom = (system.right.len() - free.len()) as f64;
        let chi = (left.transpose() * &inverse * &left)[(0, 0)];
        let expected =
            -0.5 * (freedom * (2.0 * std::f64::consts::PI).ln() + ln(&covariance) + ln(&normal) + chi);
        let whitened = system.whitened(SHAPE, SIGMA_MM).unwrap();
        let posterior = whitened.equations.posterior(&hypers).unwrap();
        let found = posterior.ln_evidence(&hypers) - whitened.equations.evidence.ln_prior(&hypers);
        assert!((found - expected).abs() < 1e-6, "{found} {expected}");
    }

    #[test]
    fn sums_of_two_pieces_are_those_of_the_whole() {
        let all = readings(&model(2), 30, 1);
        let whole = system(&all);
        let piece = |from: usize, count: usize| {
            let mut piece = system(&all[from..from + count]);
            piece.right = whole.right.rows(from, count).into_owned();
            piece.normal_sums(SHAPE, SIGMA_MM).unwrap()
        };
        let sums = piece(0, 24).and(&piece(24, 36));
        let equations = sums.equations(&whole).unwrap();
        let hypers = hypers(SIGMA_MM);
        let posterior = equations.posterior(&hypers).unwrap();
        assert_alike(&posterior.mean, &posterior.root().unwrap(), &dense(&whole, &hypers));
        let once = whole.whitened(SHAPE, SIGMA_MM).unwrap();
        let once = once.equations.posterior(&hypers).unwrap().ln_evidence(&hypers);
        assert!((posterior.ln_evidence(&hypers) - once).abs() < 1e-7);
    }
}
