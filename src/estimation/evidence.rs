//! Variances of groups of unknowns by maximum marginal likelihood, under a prior of their logarithms.
//!
//! Linearised, y = J w + noise with w_i ~ N(0, v_i): in the coordinates w = V^1/2 m the posterior has the precision
//! B = I + V^1/2 J'J V^1/2 / sigma^2 (MacKay, Neural Computation 4, 1992; Rasmussen and Williams, Gaussian Processes for
//! Machine Learning, 5.4). A group that explains nothing shrinks to nothing: no test need choose it. Free unknowns are
//! taken out of the rows before, so that they cost no prior.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::priors::{Group, HYPERS, HyperPrior};
use crate::robot::Process;

/// Steps after which the variances are taken as they are.
const MOST_STEPS: usize = 60;
/// A gain of the logarithm of the evidence below this is none.
const REST: f64 = 1e-3;
/// No step changes the logarithm of a variance's root by more.
const LONGEST_STEP: f64 = 1.0;
/// The step that begins, as a share of the gradient.
const FIRST_STEP: f64 = 0.05;
/// A gain of this share of what the gradient promises suffices.
const ARMIJO: f64 = 1e-4;

/// Logarithms of what is estimated, in the order of [`HyperPrior::ALL`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Hypers([f64; HYPERS]);

impl Hypers {
    /// The middle of the priors, with this standard deviation of the lengths, mm.
    pub(super) fn start(sigma_mm: f64) -> Self {
        let mut start = Self(HyperPrior::ALL.map(|prior| prior.median.ln()));
        start.0[HyperPrior::SIGMA] = sigma_mm.ln();
        start
    }

    /// One standard deviation of a group, in its unit; of smooth functions that of the quick part.
    pub(super) fn sd(&self, group: Group) -> f64 {
        self.0[group as usize].exp()
    }

    /// With the standard deviation that another has of a group.
    pub(super) fn with_sd_of(mut self, group: Group, other: &Self) -> Self {
        self.0[group as usize] = other.0[group as usize];
        self
    }

    /// What the smooth functions are the sum of: a quick and a slow process.
    pub(super) fn processes(&self) -> [Process; 2] {
        Self::PROCESSES
            .map(|[sd, length]| Process { sd_rad: self.0[sd].exp(), likeness_rad: self.0[length].exp() })
    }

    /// The places of their standard deviations and lengths.
    const PROCESSES: [[usize; 2]; 2] =
        [[Group::Smooth as usize, HyperPrior::LENGTH], [HyperPrior::SLOW, HyperPrior::SLOW_LENGTH]];

    pub(super) fn sigma_mm(&self) -> f64 {
        self.0[HyperPrior::SIGMA].exp()
    }
}

/// What the prior variance of an unknown follows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Variance {
    /// This standard deviation.
    Fixed(f64),
    /// That of its group times this.
    Of(Group, f64),
    /// The spectral density of the smooth functions at this angular frequency (1/rad).
    Spectral(f64),
    /// This standard deviation, which the noise gives to backlash.
    ByNoise(f64),
}

impl Variance {
    fn value(self, hypers: &Hypers) -> f64 {
        match self {
            Self::Fixed(sd) | Self::ByNoise(sd) => sd * sd,
            Self::Of(group, unit) => (unit * hypers.sd(group)).powi(2),
            Self::Spectral(frequency) => {
                hypers.processes().iter().map(|part| part.spectral_density(frequency)).sum()
            }
        }
    }

    /// The derivative of its logarithm by the logarithm of each hyper-parameter that it follows, to `each` with the place.
    fn slopes(self, hypers: &Hypers, mut each: impl FnMut(usize, f64)) {
        match self {
            Self::Fixed(_) | Self::ByNoise(_) => {}
            Self::Of(group, _) => each(group as usize, 2.0),
            Self::Spectral(frequency) => {
                let whole = self.value(hypers);
                for ([sd, length], part) in Hypers::PROCESSES.into_iter().zip(hypers.processes()) {
                    let share = part.spectral_density(frequency) / whole;
                    let a2 = 5.0 / part.likeness_rad.powi(2);
                    each(sd, 2.0 * share);
                    each(length, share * (6.0 * a2 / (a2 + frequency * frequency) - 5.0));
                }
            }
        }
    }

    /// One standard deviation.
    pub(super) fn sd(self, hypers: &Hypers) -> f64 {
        self.value(hypers).sqrt()
    }

    /// The group that it belongs to.
    pub(super) fn group(self) -> Option<Group> {
        match self {
            Self::Fixed(_) => None,
            Self::Of(group, _) => Some(group),
            Self::Spectral(_) => Some(Group::Smooth),
            Self::ByNoise(_) => Some(Group::Backlash),
        }
    }
}

/// Rows of unit noise, what is free taken out: their normal equations.
#[derive(Clone, Debug)]
pub(super) struct Normal {
    pub(super) gram: DMatrix<f64>,
    pub(super) rhs: DVector<f64>,
    /// Sum of the squares of the right-hand side.
    pub(super) squares: f64,
    /// Rows less free unknowns.
    pub(super) freedom: f64,
    /// The logarithm of the determinant that whitened the rows.
    pub(super) ln_whitening: f64,
}

/// The unknowns at given variances.
pub(super) struct Solved {
    /// Square roots of the prior variances.
    pub(super) roots: DVector<f64>,
    cholesky: Cholesky<f64, Dyn>,
    /// The unknowns in units of their prior standard deviations.
    scaled: DVector<f64>,
    /// Logarithm of the marginal likelihood.
    pub(super) ln_likelihood: f64,
}

impl Solved {
    /// The likeliest unknowns.
    pub(super) fn unknowns(&self) -> DVector<f64> {
        self.scaled.component_mul(&self.roots)
    }

    /// A root of their covariance, C = root root'.
    pub(super) fn root(&self) -> Option<DMatrix<f64>> {
        let mut root = self.inverse()?.transpose();
        for (mut row, scale) in root.row_iter_mut().zip(&self.roots) {
            row *= *scale;
        }
        Some(root)
    }

    /// The inverse of the lower factor of B.
    fn inverse(&self) -> Option<DMatrix<f64>> {
        let (count, factor) = (self.roots.len(), self.cholesky.l_dirty());
        let mut inverse = DMatrix::identity(count, count);
        // Above its diagonal a column is zero.
        for at in 0..count {
            let left = count - at;
            let mut column = inverse.view_mut((at, at), (left, 1));
            if !factor.view((at, at), (left, left)).solve_lower_triangular_mut(&mut column) {
                return None;
            }
        }
        Some(inverse)
    }

    /// How much of each unknown the data determine, from 0 to 1.
    pub(super) fn determined(&self) -> Option<Vec<f64>> {
        Some(self.inverse()?.column_iter().map(|column| 1.0 - column.norm_squared()).collect())
    }
}

/// A problem of evidence.
pub(super) struct Evidence<'a> {
    pub(super) normal: &'a Normal,
    pub(super) variances: &'a [Variance],
    /// Whether sigma stays as it is.
    pub(super) sigma_is_given: bool,
}

/// The likeliest variances with the logarithm of likelihood and hyper-priors.
#[derive(Clone, Copy, Debug)]
pub(super) struct Found {
    pub(super) hypers: Hypers,
    pub(super) value: f64,
}

/// Where the search is.
struct Here {
    hypers: Hypers,
    solved: Solved,
    /// The logarithm of likelihood and hyper-priors.
    value: f64,
}

impl Evidence<'_> {
    /// The unknowns at these variances; `None` when a number is not finite.
    pub(super) fn solve(&self, hypers: &Hypers) -> Option<Solved> {
        let roots = DVector::from_iterator(
            self.variances.len(),
            self.variances.iter().map(|variance| variance.sd(hypers)),
        );
        let precision = hypers.sigma_mm().powi(-2);
        let count = roots.len();
        let mut b = DMatrix::zeros(count, count);
        for column in 0..count {
            let scale = precision * roots[column];
            for row in column..count {
                b[(row, column)] = self.normal.gram[(row, column)] * roots[row] * scale;
            }
            b[(column, column)] += 1.0;
        }
        let right = self.normal.rhs.component_mul(&roots) * precision;
        let cholesky = Cholesky::new(b)?;
        let scaled = cholesky.solve(&right);
        let ln_determinant: f64 = cholesky.l_dirty().diagonal().iter().map(|pivot| 2.0 * pivot.ln()).sum();
        let chi = self.normal.squares * precision - right.dot(&scaled);
        let ln_noise = self.normal.freedom * (2.0 * std::f64::consts::PI / precision).ln();
        let ln_likelihood = -0.5 * (ln_noise + self.normal.ln_whitening + ln_determinant + chi);
        ln_likelihood.is_finite().then_some(Solved { roots, cholesky, scaled, ln_likelihood })
    }

    /// The likeliest variances, from `start`.
    pub(super) fn maximise(&self, start: Hypers) -> Option<Found> {
        let mut here = self.at(start)?;
        let mut gradient = self.gradient(&here)?;
        let mut inverse = DMatrix::<f64>::identity(HYPERS, HYPERS) * FIRST_STEP;
        for _ in 0..MOST_STEPS {
            let mut step = &inverse * &gradient;
            let longest = step.amax();
            if longest > LONGEST_STEP {
                step *= LONGEST_STEP / longest;
            }
            let promised = gradient.dot(&step);
            let Some(there) = self.better(&here, &step, promised) else { break };
            let gain = there.value - here.value;
            let moved = DVector::from_fn(HYPERS, |at, _| there.hypers.0[at] - here.hypers.0[at]);
            here = there;
            if gain < REST && promised < 10.0 * REST {
                break;
            }
            let before = std::mem::replace(&mut gradient, self.gradient(&here)?);
            update(&mut inverse, &moved, &(before - &gradient));
        }
        Some(Found { hypers: here.hypers, value: here.value })
    }

    /// The end of the step, or of a shorter one, where the evidence is higher.
    fn better(&self, here: &Here, step: &DVector<f64>, promised: f64) -> Option<Here> {
        let mut share = 1.0;
        for _ in 0..8 {
            let mut hypers = here.hypers;
            for (at, value) in hypers.0.iter_mut().enumerate() {
                let [low, high] = HyperPrior::ALL[at].bounds;
                *value = (*value + share * step[at]).clamp(low.ln(), high.ln());
            }
            if let Some(there) = self.at(hypers)
                && there.value > here.value + ARMIJO * share * promised
            {
                return Some(there);
            }
            share *= 0.4;
        }
        None
    }

    fn at(&self, hypers: Hypers) -> Option<Here> {
        let solved = self.solve(&hypers)?;
        let mut value = solved.ln_likelihood;
        for (at, prior) in HyperPrior::ALL.into_iter().enumerate() {
            value -= 0.5 * prior.off(hypers.0[at]).powi(2);
        }
        Some(Here { hypers, solved, value })
    }

    fn gradient(&self, here: &Here) -> Option<DVector<f64>> {
        let Here { hypers, solved, .. } = here;
        let mut gradient = DVector::zeros(HYPERS);
        let inverse = solved.inverse()?;
        let mut trace = 0.0;
        for (at, (variance, scaled)) in self.variances.iter().zip(&solved.scaled).enumerate() {
            let left = inverse.view((at, at), (inverse.nrows() - at, 1)).norm_squared();
            trace += left;
            // By the logarithm of the variance.
            let slope = 0.5 * (scaled * scaled + left - 1.0);
            variance.slopes(hypers, |place, by| gradient[place] += slope * by);
        }
        let unknowns = solved.unknowns();
        let residual = self.normal.squares - 2.0 * self.normal.rhs.dot(&unknowns)
            + unknowns.dot(&(&self.normal.gram * &unknowns));
        if !self.sigma_is_given {
            gradient[HyperPrior::SIGMA] = residual / hypers.sigma_mm().powi(2) + solved.roots.len() as f64
                - trace
                - self.normal.freedom;
        }
        for (at, prior) in HyperPrior::ALL.into_iter().enumerate() {
            if let Some(ln_sd) = prior.ln_sd {
                gradient[at] -= prior.off(hypers.0[at]) / ln_sd;
            }
        }
        Some(gradient)
    }
}

/// The inverse of the Hessian after a step (Broyden, Fletcher, Goldfarb and Shanno); `change` is that of the negative
/// gradient.
fn update(inverse: &mut DMatrix<f64>, moved: &DVector<f64>, change: &DVector<f64>) {
    let curvature = moved.dot(change);
    if curvature <= 1e-12 * moved.norm() * change.norm() {
        return;
    }
    let turned = &*inverse * change;
    let scale = (curvature + change.dot(&turned)) / (curvature * curvature);
    *inverse += moved * moved.transpose() * scale
        - (&turned * moved.transpose() + moved * turned.transpose()) / curvature;
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows of 40 unknowns of one group and 10 of another that explains nothing.
    fn problem() -> (Normal, Vec<Variance>) {
        let wave = |at: usize| (12.9898 * at as f64).sin() * 43758.5453;
        let random = |at: usize| 2.0 * (wave(at) - wave(at).floor()) - 1.0;
        let rows = DMatrix::from_fn(300, 50, |i, j| random(i * 50 + j) * 1e3);
        let truth = DVector::from_fn(50, |j, _| if j < 40 { 1e-4 * random(90_000 + j) } else { 0.0 });
        let y = &rows * truth + DVector::from_fn(300, |i, _| 0.02 * random(95_000 + i));
        let (gram, rhs) = (rows.tr_mul(&rows), rows.tr_mul(&y));
        let normal = Normal { gram, rhs, squares: y.norm_squared(), freedom: 300.0, ln_whitening: 0.0 };
        let of = |j: usize| Variance::Of(if j < 40 { Group::Harmonic } else { Group::Backlash }, 1.0);
        (normal, (0..50).map(of).collect())
    }

    #[test]
    fn a_group_that_explains_nothing_shrinks() {
        let (normal, variances) = problem();
        let evidence = Evidence { normal: &normal, variances: &variances, sigma_is_given: false };
        let hypers = evidence.maximise(Hypers::start(0.05)).unwrap().hypers;
        // Uniform numbers have a standard deviation of 1/sqrt(3).
        assert!((hypers.sd(Group::Harmonic) / 0.577e-4 - 1.0).abs() < 0.25, "{hypers:?}");
        assert!((hypers.sigma_mm() / 0.01155 - 1.0).abs() < 0.15, "{hypers:?}");
        assert!(hypers.sd(Group::Backlash) < 1e-5);
        let determined = evidence.solve(&hypers).unwrap().determined().unwrap();
        assert!(determined[..40].iter().all(|share| *share > 0.95));
    }

    #[test]
    fn the_gradient_is_that_of_the_evidence() {
        let (normal, mut variances) = problem();
        for (at, variance) in variances.iter_mut().enumerate().skip(20).take(20) {
            *variance = Variance::Spectral(at as f64 * 0.4);
        }
        let evidence = Evidence { normal: &normal, variances: &variances, sigma_is_given: false };
        let here = evidence.at(Hypers::start(0.03)).unwrap();
        let gradient = evidence.gradient(&here).unwrap();
        for at in 0..HYPERS {
            let moved = |step: f64| {
                let mut hypers = here.hypers;
                hypers.0[at] += step;
                evidence.at(hypers).unwrap().value
            };
            let numeric = (moved(1e-5) - moved(-1e-5)) / 2e-5;
            let size = numeric.abs().max(1.0);
            assert!((gradient[at] - numeric).abs() < 1e-4 * size, "{at}: {} {numeric}", gradient[at]);
        }
    }
}
