//! Variances of groups of unknowns by maximum marginal likelihood, with a prior on their logarithms.
//!
//! Linearised, y = J w + noise with w_i ~ N(0, v_i): in the coordinates w = V^1/2 m the posterior has the precision
//! B = I + V^1/2 J'J V^1/2 / sigma^2 (MacKay, Neural Computation 4, 1992; Rasmussen and Williams, Gaussian Processes for
//! Machine Learning, 5.4). A group that explains nothing shrinks to zero: no test need choose it. Free unknowns are
//! eliminated from the rows before, so that they do not reduce the evidence.

use nalgebra::{Cholesky, DMatrix, DVector, SMatrix, SVector};

use super::hyper_parameters::{HYPERS, HyperPrior, Hypers, SIGMA, Variance};

/// Steps after which the variances are taken as they are.
const MAX_STEPS: usize = 60;
/// The search ends at a smaller gain of the logarithm of the evidence.
const REST: f64 = 1e-3;
/// Largest change of the logarithm of a standard deviation in a step.
const LONGEST_STEP: f64 = 1.0;
/// A step is accepted if it gains at least this share of the gain that the gradient predicts (Armijo's rule).
const ARMIJO: f64 = 1e-4;

/// Normal equations of whitened rows, with the free unknowns eliminated.
#[derive(Clone, Debug)]
pub(super) struct NormalEquations {
    pub(super) gram: DMatrix<f64>,
    pub(super) rhs: DVector<f64>,
    /// Sum of the squares of the right-hand side.
    pub(super) squares: f64,
    /// Rows less free unknowns.
    pub(super) freedom: f64,
    /// The logarithm of the determinant that whitened the rows.
    pub(super) ln_whitening: f64,
}

/// The posterior of the coefficients at given variances.
pub(super) struct Coefficients {
    /// Prior standard deviations.
    prior_sds: DVector<f64>,
    /// The inverse of the lower Cholesky factor of B.
    inverse_factor: DMatrix<f64>,
    /// The mean in units of the prior standard deviations.
    scaled: DVector<f64>,
    /// Logarithm of the marginal likelihood.
    pub(super) ln_likelihood: f64,
}

impl Coefficients {
    pub(super) fn mean(&self) -> DVector<f64> {
        self.scaled.component_mul(&self.prior_sds)
    }

    /// A root of their covariance, C = root root'.
    pub(super) fn root(&self) -> DMatrix<f64> {
        let mut root = self.inverse_factor.transpose();
        for (mut row, scale) in root.row_iter_mut().zip(&self.prior_sds) {
            row *= *scale;
        }
        root
    }

    /// The fraction of each coefficient that the data determine, from 0 to 1.
    pub(super) fn determined(&self) -> Vec<f64> {
        self.inverse_factor.column_iter().map(|column| 1.0 - column.norm_squared()).collect()
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

/// Gradient and expected information by the hyper-parameters.
struct Slopes {
    gradient: SVector<f64, HYPERS>,
    information: SMatrix<f64, HYPERS, HYPERS>,
}

impl Evidence {
    /// The coefficients at these variances; `None` when a number is not finite.
    pub(super) fn coefficients(&self, hypers: &Hypers) -> Option<Coefficients> {
        let sds = self.variances.iter().map(|variance| variance.sd(hypers));
        let prior_sds = DVector::from_iterator(self.variances.len(), sds);
        let precision = hypers.sigma_mm().powi(-2);
        let mut b = self.normal.gram.clone();
        for (column, mut values) in b.column_iter_mut().enumerate() {
            let scale = precision * prior_sds[column];
            values.zip_apply(&prior_sds, |value, sd| *value *= sd * scale);
            values[column] += 1.0;
        }
        let right = self.normal.rhs.component_mul(&prior_sds) * precision;
        let [factor, inverse_factor] = cholesky_with_inverse(&b)?;
        let scaled = inverse_factor.tr_mul(&(&inverse_factor * &right));
        let ln_determinant = 2.0 * factor.diagonal().map(f64::ln).sum();
        let chi = self.normal.squares * precision - right.dot(&scaled);
        let ln_noise = self.normal.freedom * (2.0 * std::f64::consts::PI / precision).ln();
        let ln_likelihood = -0.5 * (ln_noise + self.normal.ln_whitening + ln_determinant + chi);
        ln_likelihood.is_finite().then_some(Coefficients { prior_sds, inverse_factor, scaled, ln_likelihood })
    }

    /// The optimum near `start`, by Fisher's scoring.
    pub(super) fn maximise(&self, start: Hypers) -> Option<Optimum> {
        let mut here = self.at(start)?;
        let mut information = SMatrix::identity();
        for _ in 0..MAX_STEPS {
            let slopes = self.slopes(&here);
            information = slopes.information;
            let (gradient, mut step) = self.step(&here, slopes)?;
            let longest = step.amax();
            if longest > LONGEST_STEP {
                step *= LONGEST_STEP / longest;
            }
            let promised = gradient.dot(&step);
            let Some(there) = self.better(&here, &step, promised) else { break };
            let gain = there.ln_evidence - here.ln_evidence;
            here = there;
            if gain < REST && promised < 10.0 * REST {
                break;
            }
        }
        let variances = Cholesky::new(information)?.inverse().diagonal();
        let ln_sd = std::array::from_fn(|at| variances[at].sqrt());
        Some(Optimum { hypers: here.hypers, ln_sd })
    }

    /// Newton's step within the bounds, and the gradient of the hyper-parameters that it moves. A hyper-parameter that
    /// would move beyond its bound stays there.
    fn step(&self, here: &Point, slopes: Slopes) -> Option<(SVector<f64, HYPERS>, SVector<f64, HYPERS>)> {
        let Slopes { mut gradient, mut information } = slopes;
        loop {
            let step = Cholesky::new(information)?.solve(&gradient);
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
                information.row_mut(at).fill(0.0);
                information.column_mut(at).fill(0.0);
                (information[(at, at)], gradient[at]) = (1.0, 0.0);
            }
        }
    }

    /// The end of the step, or of a shorter one, where the evidence is higher.
    fn better(&self, here: &Point, step: &SVector<f64, HYPERS>, promised: f64) -> Option<Point> {
        let mut share = 1.0;
        for _ in 0..8 {
            let mut hypers = here.hypers;
            for (at, value) in hypers.0.iter_mut().enumerate() {
                *value = self.hyper_priors[at].clamp(*value + share * step[at]);
            }
            if let Some(there) = self.at(hypers)
                && there.ln_evidence > here.ln_evidence + ARMIJO * share * promised
            {
                return Some(there);
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

    /// Gradient and information. With C = B^-1, d ln Z / d ln v_i = (m_i^2 + C_ii - 1) / 2, and the information is
    /// (I - C)_ij^2 / 2. By ln sigma the gradient is r'r / sigma^2 + p - tr C - n, the information is
    /// 2 (n - p + tr C^2), and the information of ln sigma with ln v_i is (C - C^2)_ii.
    fn slopes(&self, here: &Point) -> Slopes {
        let Point { hypers, coefficients, .. } = here;
        let count = self.variances.len();
        let covariance = coefficients.inverse_factor.transpose() * &coefficients.inverse_factor;
        let mut by_hyper = DMatrix::zeros(count, HYPERS);
        let mut by_sigma = DVector::zeros(count);
        let mut gradient = SVector::zeros();
        for (at, variance) in self.variances.iter().enumerate() {
            let (mean, left) = (coefficients.scaled[at], covariance[(at, at)]);
            variance.slopes(hypers, |place, slope| {
                by_hyper[(at, place)] = slope;
                gradient[place] += 0.5 * (mean * mean + left - 1.0) * slope;
            });
            by_sigma[at] = left - covariance.column(at).norm_squared();
        }
        let mut squared = covariance.map(|value| value * value);
        for at in 0..count {
            squared[(at, at)] = (1.0 - covariance[(at, at)]).powi(2);
        }
        let halved = 0.5 * by_hyper.transpose() * (squared * &by_hyper);
        let mut information = SMatrix::from_fn(|i, j| halved[(i, j)]);
        if self.is_sigma_given {
            information[(SIGMA, SIGMA)] = f64::MAX.sqrt();
        } else {
            let mean = coefficients.mean();
            let residual = self.normal.squares - 2.0 * self.normal.rhs.dot(&mean)
                + mean.dot(&(&self.normal.gram * &mean));
            let further = self.normal.freedom - count as f64;
            gradient[SIGMA] = residual / hypers.sigma_mm().powi(2) - covariance.trace() - further;
            let across = by_hyper.tr_mul(&by_sigma);
            for place in 0..HYPERS {
                information[(SIGMA, place)] = across[place];
                information[(place, SIGMA)] = across[place];
            }
            information[(SIGMA, SIGMA)] = 2.0 * (further + covariance.norm_squared());
        }
        for (at, prior) in self.hyper_priors.iter().enumerate() {
            gradient[at] -= prior.off(hypers.0[at]) / prior.ln_sd;
            information[(at, at)] += prior.ln_sd.powi(-2);
        }
        Slopes { gradient, information }
    }
}

/// The lower Cholesky factor of a symmetric matrix, and its inverse. The matrix is halved again and again, so that
/// products do most of the work; `None` if the matrix is not positive definite.
fn cholesky_with_inverse(matrix: &DMatrix<f64>) -> Option<[DMatrix<f64>; 2]> {
    /// Smaller matrices are not halved.
    const LEAF: usize = 24;
    let count = matrix.nrows();
    if count <= LEAF {
        let factor = Cholesky::new(matrix.clone())?.unpack();
        let inverse = factor.solve_lower_triangular(&DMatrix::identity(count, count))?;
        return Some([factor, inverse]);
    }
    let half = count / 2;
    let rest = count - half;
    let [first, first_inverse] = cholesky_with_inverse(&matrix.view((0, 0), (half, half)).into_owned())?;
    let across = matrix.view((half, 0), (rest, half)) * first_inverse.transpose();
    let left = matrix.view((half, half), (rest, rest)) - &across * across.transpose();
    let [last, last_inverse] = cholesky_with_inverse(&left)?;
    let across_inverse = -(&last_inverse * (&across * &first_inverse));
    let joined = |first: &DMatrix<f64>, across: &DMatrix<f64>, last: &DMatrix<f64>| {
        let mut all = DMatrix::zeros(count, count);
        all.view_mut((0, 0), (half, half)).copy_from(first);
        all.view_mut((half, 0), (rest, half)).copy_from(across);
        all.view_mut((half, half), (rest, rest)).copy_from(last);
        all
    };
    Some([joined(&first, &across, &last), joined(&first_inverse, &across_inverse, &last_inverse)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::Group;
    use crate::robot::Joint;

    /// Rows of 40 unknowns of one group and 10 of another that explains nothing.
    fn problem() -> Evidence {
        let wave = |at: usize| (12.9898 * at as f64).sin() * 43758.5453;
        let random = |at: usize| 2.0 * (wave(at) - wave(at).floor()) - 1.0;
        let rows = DMatrix::from_fn(300, 50, |i, j| random(i * 50 + j) * 1e3);
        let truth = DVector::from_fn(50, |j, _| if j < 40 { 1e-4 * random(90_000 + j) } else { 0.0 });
        let y = &rows * truth + DVector::from_fn(300, |i, _| 0.02 * random(95_000 + i));
        let (gram, rhs) = (rows.tr_mul(&rows), rows.tr_mul(&y));
        let squares = y.norm_squared();
        let normal = NormalEquations { gram, rhs, squares, freedom: 300.0, ln_whitening: 0.0 };
        let of = |j: usize| Variance::Of(if j < 40 { Group::Harmonic } else { Group::Backlash }, 1.0);
        let hyper_priors = HyperPrior::all(0.03);
        Evidence { normal, variances: (0..50).map(of).collect(), hyper_priors, is_sigma_given: false }
    }

    #[test]
    fn a_factor_by_halves_is_that_of_the_matrix() {
        for count in [0, 1, 24, 61] {
            let rows = DMatrix::from_fn(count + 5, count, |i, j| ((3 * i + 5 * j) as f64).sin());
            let matrix = DMatrix::identity(count, count) + rows.tr_mul(&rows);
            let [factor, inverse] = cholesky_with_inverse(&matrix).unwrap();
            assert!((&factor * factor.transpose() - &matrix).amax() < 1e-12 * (1.0 + matrix.amax()));
            assert!((factor * inverse - DMatrix::identity(count, count)).amax() < 1e-12);
        }
        let mut indefinite = DMatrix::identity(60, 60);
        indefinite[(50, 50)] = -1.0;
        assert!(cholesky_with_inverse(&indefinite).is_none());
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

    #[test]
    fn the_gradient_is_that_of_the_evidence() {
        let mut evidence = problem();
        for (at, variance) in evidence.variances.iter_mut().enumerate().skip(20).take(20) {
            *variance = Variance::Spectral(Joint::J2, at as f64 * 0.4);
        }
        let here = evidence.at(Hypers::start(&HyperPrior::all(0.03), 0.03)).unwrap();
        let gradient = evidence.slopes(&here).gradient;
        for at in 0..HYPERS {
            let moved = |step: f64| {
                let mut hypers = here.hypers;
                hypers.0[at] += step;
                evidence.at(hypers).unwrap().ln_evidence
            };
            let numeric = (moved(1e-5) - moved(-1e-5)) / 2e-5;
            let size = numeric.abs().max(1.0);
            assert!((gradient[at] - numeric).abs() < 1e-4 * size, "{at}: {} {numeric}", gradient[at]);
        }
    }
}
