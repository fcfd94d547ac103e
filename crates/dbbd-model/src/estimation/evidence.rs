//! Variances of groups of unknowns by maximum marginal likelihood, with a prior on their logarithms.
//!
//! Linearised, y = J w + noise with w_i ~ N(0, v_i): in the coordinates w = V^1/2 m the posterior has the precision
//! B = I + V^1/2 J'J V^1/2 / sigma^2 (MacKay, Neural Computation 4, 1992; Rasmussen and Williams, Gaussian Processes for
//! Machine Learning, 5.4). A group that explains nothing shrinks to zero: no test need choose it. Free unknowns are
//! eliminated from the rows before, so that they do not reduce the evidence.

use nalgebra::{Cholesky, DMatrix, DVector, SMatrix, SVector};

use super::hyper_parameters::{HYPERS, HyperPrior, Hypers, SIGMA, Variance};
use crate::math::{cholesky_with_inverse, gram, gram_of_lower, times_transposed_lower};

/// Steps after which the variances are taken as they are.
const MAX_STEPS: usize = 60;
/// The search ends where the gradient predicts a smaller gain of the logarithm of the evidence: there the hyper-parameters are
/// within a tenth of their standard deviation of the most probable ones.
const REST: f64 = 1e-2;
/// Largest change of the logarithm of a standard deviation in a step.
const LONGEST_STEP: f64 = 1.0;
/// A step is accepted if it gains at least this share of the gain that the gradient predicts (Armijo's rule).
const ARMIJO: f64 = 1e-4;
/// Rows are factored only if no unknown has more information than this, in units of its prior: the precision of the others
/// would be lost in its rounding.
const WIDE: f64 = 1e7;
/// The next step is twice as long after one that gains this share of what the gradient predicts: half is the share where the
/// second derivatives are right.
const STRAIGHT: f64 = 0.7;

/// Normal equations of whitened rows, with the free unknowns eliminated.
#[derive(Clone, Debug)]
pub(super) struct NormalEquations {
    pub(super) products: Products,
    /// Sum of the squares of the right-hand side.
    pub(super) squares: f64,
    /// Rows less free unknowns.
    pub(super) freedom: f64,
    /// The logarithm of the determinant that whitened the rows.
    pub(super) ln_whitening: f64,
}

/// What the rows J say of the unknowns.
#[derive(Clone, Debug)]
pub(super) enum Products {
    /// J'J, and J' times the right-hand side.
    OfUnknowns { gram: DMatrix<f64>, rhs: DVector<f64> },
    /// The rows and the right-hand side themselves, where the rows are fewer than the unknowns: the smaller matrix is
    /// factored.
    OfRows { rows: DMatrix<f64>, right: DVector<f64> },
}

impl Products {
    /// The rows of J'J that belong to some unknowns, and their part of the right-hand side.
    pub(super) fn of_unknowns(&self, some: &[usize]) -> (DMatrix<f64>, DVector<f64>) {
        match self {
            Self::OfUnknowns { gram, rhs } => (gram.select_rows(some), rhs.select_rows(some)),
            Self::OfRows { rows, right } => {
                let own = rows.select_columns(some).transpose();
                (&own * rows, own * right)
            }
        }
    }

    /// The same rows with these unknowns alone.
    pub(super) fn with(&self, unknowns: &[usize]) -> Self {
        match self {
            Self::OfUnknowns { gram, rhs } => Self::OfUnknowns {
                gram: gram.select_rows(unknowns).select_columns(unknowns),
                rhs: rhs.select_rows(unknowns),
            },
            Self::OfRows { rows, right } => {
                Self::OfRows { rows: rows.select_columns(unknowns), right: right.clone() }
            }
        }
    }
}

/// The posterior of the coefficients at given variances.
pub(super) struct Coefficients {
    /// Prior standard deviations.
    prior_sds: DVector<f64>,
    factor: CovarianceFactor,
    /// The mean in units of the prior standard deviations.
    scaled: DVector<f64>,
    /// Logarithm of the marginal likelihood.
    pub(super) ln_likelihood: f64,
}

/// The covariance C = B^-1 in units of the prior standard deviations.
enum CovarianceFactor {
    /// The inverse M of the lower Cholesky factor of B: C = M'M.
    OfUnknowns(DMatrix<f64>),
    /// With S = J V^1/2 / sigma and the lower Cholesky factor L of I + S S': W = L^-1 S, and X = (I + L)^-1 S. C = I - W'W, and
    /// I - W'X is a root of it (Andrews, AIAA Journal 6, 1968).
    OfRows { whitened: DMatrix<f64>, shrinking: DMatrix<f64> },
}

impl Coefficients {
    pub(super) fn mean(&self) -> DVector<f64> {
        self.scaled.component_mul(&self.prior_sds)
    }

    /// A root of their covariance, C = root root'.
    pub(super) fn root(&self) -> DMatrix<f64> {
        let mut root = match &self.factor {
            CovarianceFactor::OfUnknowns(inverse) => inverse.transpose(),
            CovarianceFactor::OfRows { whitened, shrinking } => {
                let mut root = -(whitened.transpose() * shrinking);
                (0..root.nrows()).for_each(|k| root[(k, k)] += 1.0);
                root
            }
        };
        for (mut row, scale) in root.row_iter_mut().zip(&self.prior_sds) {
            row *= *scale;
        }
        root
    }

    /// Rows of the coefficients times [`Self::root`].
    pub(super) fn rows_by_root(&self, rows: &DMatrix<f64>) -> DMatrix<f64> {
        let mut scaled = rows.clone();
        for (mut column, sd) in scaled.column_iter_mut().zip(&self.prior_sds) {
            column *= *sd;
        }
        match &self.factor {
            CovarianceFactor::OfUnknowns(inverse) => times_transposed_lower(&scaled, inverse),
            CovarianceFactor::OfRows { whitened, shrinking } => {
                let across = &scaled * whitened.transpose();
                scaled - across * shrinking
            }
        }
    }

    /// The posterior variance of a coefficient.
    pub(super) fn variance(&self, at: usize) -> f64 {
        let determined = match &self.factor {
            CovarianceFactor::OfUnknowns(inverse) => 1.0 - inverse.column(at).norm_squared(),
            CovarianceFactor::OfRows { whitened, .. } => whitened.column(at).norm_squared(),
        };
        self.prior_sds[at].powi(2) * (1.0 - determined)
    }

    /// The fraction of each coefficient that the data determine, from 0 to 1.
    pub(super) fn determined(&self) -> Vec<f64> {
        match &self.factor {
            CovarianceFactor::OfUnknowns(inverse) => {
                inverse.column_iter().map(|column| 1.0 - column.norm_squared()).collect()
            }
            CovarianceFactor::OfRows { whitened, .. } => {
                whitened.column_iter().map(|column| column.norm_squared()).collect()
            }
        }
    }

    /// The matrix I - C, whose diagonal are these fractions.
    fn determined_matrix(&self) -> DMatrix<f64> {
        match &self.factor {
            CovarianceFactor::OfUnknowns(inverse) => {
                let mut matrix = -gram_of_lower(inverse);
                (0..matrix.nrows()).for_each(|k| matrix[(k, k)] += 1.0);
                matrix
            }
            CovarianceFactor::OfRows { whitened, .. } => gram(whitened),
        }
    }
}

/// Coefficients whose variances maximise the marginal likelihood.
#[derive(Clone)]
pub(super) struct Evidence {
    pub(super) normal: NormalEquations,
    pub(super) variances: Vec<Variance>,
    pub(super) hyper_priors: [HyperPrior; HYPERS],
    /// Whether sigma stays as it is.
    pub(super) is_sigma_given: bool,
}

/// The hyper-parameters of the largest marginal likelihood under their priors.
#[derive(Clone, Copy, Debug)]
pub(super) struct Optimum {
    pub(super) hypers: Hypers,
    /// Standard deviation of the logarithm of each hyper-parameter, from the curvature (Laplace).
    pub(super) ln_sd: [f64; HYPERS],
}

/// A point of the search.
struct Point {
    hypers: Hypers,
    coefficients: Coefficients,
    ln_evidence: f64,
}

/// Gradient by the hyper-parameters, and the negative second derivatives: expected, and those of these data.
struct Slopes {
    gradient: SVector<f64, HYPERS>,
    expected: SMatrix<f64, HYPERS, HYPERS>,
    observed: SMatrix<f64, HYPERS, HYPERS>,
}

impl Evidence {
    /// The coefficients at these variances; `None` when a number is not finite.
    pub(super) fn coefficients(&self, hypers: &Hypers) -> Option<Coefficients> {
        let sds = self.variances.iter().map(|variance| variance.sd(hypers));
        let prior_sds = DVector::from_iterator(self.variances.len(), sds);
        let sigma_mm = hypers.sigma_mm();
        let (factor, scaled, ln_determinant, chi) = match &self.normal.products {
            Products::OfUnknowns { gram, rhs } => self.by_unknowns(gram, rhs, &prior_sds, sigma_mm)?,
            Products::OfRows { rows, right } => {
                let mut scaled = rows / sigma_mm;
                for (mut column, sd) in scaled.column_iter_mut().zip(&prior_sds) {
                    column *= *sd;
                }
                if scaled.column_iter().all(|column| column.norm_squared() < WIDE) {
                    by_rows(&scaled, &(right / sigma_mm))?
                } else {
                    self.by_unknowns(&gram(rows), &rows.tr_mul(right), &prior_sds, sigma_mm)?
                }
            }
        };
        let ln_noise = self.normal.freedom * (2.0 * std::f64::consts::PI * sigma_mm * sigma_mm).ln();
        let ln_likelihood = -0.5 * (ln_noise + self.normal.ln_whitening + ln_determinant + chi);
        ln_likelihood.is_finite().then_some(Coefficients { prior_sds, factor, scaled, ln_likelihood })
    }

    /// The factor of the covariance, the scaled mean, ln |B|, and the squares that are left, from J'J and J'y.
    fn by_unknowns(
        &self,
        gram: &DMatrix<f64>,
        rhs: &DVector<f64>,
        prior_sds: &DVector<f64>,
        sigma_mm: f64,
    ) -> Option<(CovarianceFactor, DVector<f64>, f64, f64)> {
        let precision = sigma_mm.powi(-2);
        let mut b = gram.clone();
        for (column, mut values) in b.column_iter_mut().enumerate() {
            let scale = precision * prior_sds[column];
            values.zip_apply(prior_sds, |value, sd| *value *= sd * scale);
            values[column] += 1.0;
        }
        let right = rhs.component_mul(prior_sds) * precision;
        let [lower, inverse] = cholesky_with_inverse(&b)?;
        let scaled = inverse.tr_mul(&(&inverse * &right));
        let chi = self.normal.squares * precision - right.dot(&scaled);
        Some((CovarianceFactor::OfUnknowns(inverse), scaled, ln_determinant(&lower), chi))
    }

    /// The optimum near `start`, by Newton's method. Where the second derivatives are not those of a maximum, their expected
    /// values take their place: Fisher's scoring.
    pub(super) fn maximise(&self, start: Hypers) -> Option<Optimum> {
        let mut here = self.at(start)?;
        let (mut expected, mut first) = (SMatrix::identity(), 1.0);
        for _ in 0..MAX_STEPS {
            let slopes = self.slopes(&here);
            expected = slopes.expected;
            let (gradient, mut step) = self.step(&here, &slopes)?;
            let longest = step.amax();
            if longest > LONGEST_STEP {
                step *= LONGEST_STEP / longest;
            }
            let promised = gradient.dot(&step);
            if promised < REST {
                break;
            }
            let Some((there, share)) = self.better(&here, &step, promised, first) else { break };
            let gain = there.ln_evidence - here.ln_evidence;
            // Where the evidence hardly bends, as far above the most probable variances, a step is too short.
            first = if gain > STRAIGHT * share * promised { 2.0 * share } else { 1.0 };
            here = there;
        }
        let variances = Cholesky::new(expected)?.inverse().diagonal();
        let ln_sd = std::array::from_fn(|at| variances[at].sqrt());
        Some(Optimum { hypers: here.hypers, ln_sd })
    }

    /// The step within the bounds, and the gradient of the hyper-parameters that it moves. A hyper-parameter that would
    /// move beyond its bound stays there.
    fn step(&self, here: &Point, slopes: &Slopes) -> Option<(SVector<f64, HYPERS>, SVector<f64, HYPERS>)> {
        let Slopes { mut gradient, mut expected, mut observed } = *slopes;
        loop {
            let step = Cholesky::new(observed).or_else(|| Cholesky::new(expected))?.solve(&gradient);
            let is_blocked = |at: &usize| {
                let [low, high] = self.hyper_priors[*at].bounds.map(f64::ln);
                let value = here.hypers.0[*at];
                value <= low && step[*at] < 0.0 || value >= high && step[*at] > 0.0
            };
            let blocked: Vec<usize> = (0..HYPERS).filter(is_blocked).collect();
            if blocked.is_empty() {
                return Some((gradient, step));
            }
            for at in blocked {
                for information in [&mut expected, &mut observed] {
                    information.row_mut(at).fill(0.0);
                    information.column_mut(at).fill(0.0);
                    information[(at, at)] = 1.0;
                }
                gradient[at] = 0.0;
            }
        }
    }

    /// The end of a share of the step where the evidence is higher, with the share; `first` is tried before shorter ones.
    fn better(
        &self,
        here: &Point,
        step: &SVector<f64, HYPERS>,
        promised: f64,
        first: f64,
    ) -> Option<(Point, f64)> {
        let mut share = first;
        for _ in 0..8 {
            let mut hypers = here.hypers;
            for (at, value) in hypers.0.iter_mut().enumerate() {
                *value = self.hyper_priors[at].clamp(*value + share * step[at]);
            }
            if let Some(there) = self.at(hypers)
                && there.ln_evidence > here.ln_evidence + ARMIJO * share * promised
            {
                return Some((there, share));
            }
            share *= 0.4;
        }
        None
    }

    fn at(&self, hypers: Hypers) -> Option<Point> {
        let coefficients = self.coefficients(&hypers)?;
        let ln_evidence = coefficients.ln_likelihood + self.ln_prior(&hypers);
        Some(Point { hypers, coefficients, ln_evidence })
    }

    /// Logarithm of the prior density of the hyper-parameters, relative to its largest value.
    pub(super) fn ln_prior(&self, hypers: &Hypers) -> f64 {
        let deviates = self.hyper_priors.iter().zip(hypers.0).map(|(prior, ln)| prior.off(ln));
        -0.5 * deviates.map(|deviate| deviate * deviate).sum::<f64>()
    }

    /// Gradient and second derivatives. With D = I - C and the mean m, d ln Z / d ln v_i = (m_i^2 - D_ii) / 2 = g_i, and the
    /// negative second derivative by ln v_i and ln v_j is m_i m_j D_ij - D_ij^2 / 2, less g_i if i = j; the expected one is
    /// D_ij^2 / 2. By ln sigma, with n rows and the residuals r in units of sigma, the gradient is r'r - n + tr D, the second
    /// derivative 2 (n - tr D) - 2 t - 2 r'r + 4 (r'r - m'Cm) with t = n - 2 tr D + tr D^2, the expected one 2 t. By ln sigma
    /// and ln v_i they are 2 m_i (C m)_i - e_i and e_i = (D - D^2)_ii.
    fn slopes(&self, here: &Point) -> Slopes {
        let Point { hypers, coefficients, .. } = here;
        let (count, mean) = (self.variances.len(), &coefficients.scaled);
        let determined = coefficients.determined_matrix();
        let mut by_hyper = DMatrix::zeros(count, HYPERS);
        let mut gradient = SVector::zeros();
        let mut curved = SMatrix::<f64, HYPERS, HYPERS>::zeros();
        for (at, variance) in self.variances.iter().enumerate() {
            let by_variance = 0.5 * (mean[at].powi(2) - determined[(at, at)]);
            let mut slopes = SVector::<f64, HYPERS>::zeros();
            variance.slopes(hypers, |place, slope| slopes[place] = slope);
            by_hyper.set_row(at, &slopes.transpose());
            gradient += by_variance * slopes;
            curved.ger(by_variance, &slopes, &slopes, 1.0);
            variance
                .curvatures(hypers, |one, other, curvature| curved[(one, other)] += by_variance * curvature);
        }
        let squared = determined.map(|value| value * value);
        let halved = 0.5 * by_hyper.transpose() * (squared * &by_hyper);
        let mut expected = SMatrix::from_fn(|i, j| halved[(i, j)]);
        let mut weighted = by_hyper.clone();
        weighted.column_iter_mut().for_each(|mut column| column.component_mul_assign(mean));
        let across = weighted.transpose() * (&determined * &weighted);
        let mut observed = SMatrix::from_fn(|i, j| across[(i, j)]) - expected - curved;
        if self.is_sigma_given {
            (expected[(SIGMA, SIGMA)], observed[(SIGMA, SIGMA)]) = (f64::MAX.sqrt(), f64::MAX.sqrt());
        } else {
            let (rows, trace) = (self.normal.freedom, determined.trace());
            let residual = self.residual_squares(&coefficients.mean()) / hypers.sigma_mm().powi(2);
            let left = mean - &determined * mean;
            gradient[SIGMA] = residual - rows + trace;
            let own =
                DVector::from_fn(count, |at, _| determined[(at, at)] - determined.column(at).norm_squared());
            let of_expected = by_hyper.tr_mul(&own);
            let of_observed = 2.0 * by_hyper.tr_mul(&mean.component_mul(&left)) - &of_expected;
            for place in 0..HYPERS {
                for (information, by_both) in [(&mut expected, &of_expected), (&mut observed, &of_observed)] {
                    information[(SIGMA, place)] = by_both[place];
                    information[(place, SIGMA)] = by_both[place];
                }
            }
            let twice = 2.0 * (rows - 2.0 * trace + determined.norm_squared());
            expected[(SIGMA, SIGMA)] = twice;
            observed[(SIGMA, SIGMA)] =
                2.0 * (rows - trace) - twice - 2.0 * residual + 4.0 * (residual - mean.dot(&left));
        }
        for (at, prior) in self.hyper_priors.iter().enumerate() {
            gradient[at] -= prior.off(hypers.0[at]) / prior.ln_sd;
            expected[(at, at)] += prior.ln_sd.powi(-2);
            observed[(at, at)] += prior.ln_sd.powi(-2);
        }
        Slopes { gradient, expected, observed }
    }

    /// Sum of the squared residuals.
    fn residual_squares(&self, mean: &DVector<f64>) -> f64 {
        match &self.normal.products {
            Products::OfUnknowns { gram, rhs } => {
                self.normal.squares - 2.0 * rhs.dot(mean) + mean.dot(&(gram * mean))
            }
            Products::OfRows { rows, right } => (right - rows * mean).norm_squared(),
        }
    }
}

/// As [`Evidence::by_unknowns`], from the rows S = J V^1/2 / sigma and y / sigma: |I + S S'| = |B|.
fn by_rows(rows: &DMatrix<f64>, right: &DVector<f64>) -> Option<(CovarianceFactor, DVector<f64>, f64, f64)> {
    let mut wide = gram(&rows.transpose());
    (0..wide.nrows()).for_each(|k| wide[(k, k)] += 1.0);
    let [lower, inverse] = cholesky_with_inverse(&wide)?;
    let (whitened, right) = (&inverse * rows, inverse * right);
    let scaled = whitened.tr_mul(&right);
    let (chi, ln_determinant) = (right.norm_squared(), ln_determinant(&lower));
    let mut widened = lower;
    (0..widened.nrows()).for_each(|k| widened[(k, k)] += 1.0);
    let shrinking = widened.solve_lower_triangular(rows)?;
    Some((CovarianceFactor::OfRows { whitened, shrinking }, scaled, ln_determinant, chi))
}

/// The logarithm of the determinant of a matrix with this lower Cholesky factor.
fn ln_determinant(lower: &DMatrix<f64>) -> f64 {
    2.0 * lower.diagonal().map(f64::ln).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::Group;
    use crate::robot::Joint;

    /// Rows of 40 unknowns that explain a right-hand side, and of 10 that explain nothing of it; then the right-hand side.
    fn rows_of_problem() -> [DMatrix<f64>; 2] {
        let wave = |at: usize| (12.9898 * at as f64).sin() * 43758.5453;
        let random = |at: usize| 2.0 * (wave(at) - wave(at).floor()) - 1.0;
        let rows = DMatrix::from_fn(300, 50, |i, j| random(i * 50 + j) * 1e3);
        let truth = DVector::from_fn(50, |j, _| if j < 40 { 1e-4 * random(90_000 + j) } else { 0.0 });
        let y = &rows * truth + DVector::from_fn(300, |i, _| 0.02 * random(95_000 + i));
        [rows, DMatrix::from_columns(&[y])]
    }

    /// The 40 unknowns are of one group, the others of another.
    fn problem() -> Evidence {
        let [rows, y] = rows_of_problem();
        let (gram, rhs) = (rows.tr_mul(&rows), rows.tr_mul(&y).column(0).into_owned());
        let squares = y.norm_squared();
        let products = Products::OfUnknowns { gram, rhs };
        let normal = NormalEquations { products, squares, freedom: 300.0, ln_whitening: 0.0 };
        let of = |j: usize| Variance::Of(if j < 40 { Group::Harmonic } else { Group::Backlash }, 1.0);
        let hyper_priors = HyperPrior::all(0.03);
        Evidence { normal, variances: (0..50).map(of).collect(), hyper_priors, is_sigma_given: false }
    }

    #[test]
    fn a_group_that_explains_nothing_shrinks() {
        let evidence = problem();
        let hypers = evidence.maximise(Hypers::start(&HyperPrior::all(0.03), 0.05)).unwrap().hypers;
        // Uniform numbers have a standard deviation of 1/sqrt(3).
        assert!((hypers.sd(Group::Harmonic) / 0.577e-4 - 1.0).abs() < 0.25, "{hypers:?}");
        assert!((hypers.sigma_mm() / 0.01155 - 1.0).abs() < 0.15, "{hypers:?}");
        assert!(hypers.sd(Group::Backlash) < 1e-5);
        let determined = evidence.coefficients(&hypers).unwrap().determined();
        assert!(determined[..40].iter().all(|share| *share > 0.95));
    }

    /// The same rows, once by their sums and once themselves. (They are more than the unknowns.)
    #[test]
    fn rows_say_what_their_sums_say() {
        let [rows, y] = rows_of_problem();
        let of_sums = problem();
        let mut of_rows = problem();
        of_rows.normal.products = Products::OfRows { rows, right: y.column(0).into_owned() };
        let hypers = Hypers::start(&HyperPrior::all(0.03), 0.03);
        let [a, b] = [&of_sums, &of_rows].map(|evidence| evidence.coefficients(&hypers).unwrap());
        assert!((a.ln_likelihood - b.ln_likelihood).abs() < 1e-7 * a.ln_likelihood.abs());
        assert!((a.mean() - b.mean()).amax() < 1e-9 * a.mean().amax());
        let covariance = |of: &Coefficients| of.root() * of.root().transpose();
        assert!((covariance(&a) - covariance(&b)).amax() < 1e-9 * covariance(&a).amax());
        let determined = a.determined().into_iter().zip(b.determined());
        assert!(determined.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) < 1e-9);
        let [a, b] = [&of_sums, &of_rows].map(|evidence| evidence.slopes(&evidence.at(hypers).unwrap()));
        assert!((a.observed - b.observed).amax() < 1e-6 * a.observed.amax());
    }

    #[test]
    fn slopes_are_the_derivatives_of_the_evidence() {
        let mut evidence = problem();
        for (at, variance) in evidence.variances.iter_mut().enumerate().skip(20).take(20) {
            *variance = Variance::Spectral(Joint::J2, at as f64 * 0.4);
        }
        let here = evidence.at(Hypers::start(&HyperPrior::all(0.03), 0.03)).unwrap();
        let slopes = evidence.slopes(&here);
        for at in 0..HYPERS {
            let moved = |step: f64| {
                let mut hypers = here.hypers;
                hypers.0[at] += step;
                evidence.at(hypers).unwrap()
            };
            let numeric = (moved(1e-5).ln_evidence - moved(-1e-5).ln_evidence) / 2e-5;
            let size = numeric.abs().max(1.0);
            assert!((slopes.gradient[at] - numeric).abs() < 1e-4 * size, "{at}: {numeric}");
            let [low, high] = [-1e-5, 1e-5].map(|step| evidence.slopes(&moved(step)).gradient);
            let numeric = (low - high) / 2e-5;
            let off = (slopes.observed.column(at) - numeric).amax();
            assert!(off < 1e-5 * slopes.observed.amax(), "{at}: {off}");
        }
    }
}
