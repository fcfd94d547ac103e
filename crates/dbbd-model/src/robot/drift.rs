//! How fast a robot drifts between measurements, and the conditions of a measurement.

use nalgebra::{DMatrix, DVector, SMatrix, SVector};
use serde::{Deserialize, Serialize};

use super::AXES;

/// Date and temperature of the measurement of a robot.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeasurementConditions {
    /// `YYYY-MM-DD`, with or without a time; `None` if it is not known.
    pub date: Option<String>,
    /// Mean temperature, degrees Celsius; `None` if it was not measured.
    pub temperature_c: Option<f64>,
}

/// How fast the zeros of a robot's joints wander. The rate has a log-normal distribution.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drift {
    /// Median of the standard deviation of a zero's step in a month, rad; a step in t months is t^(1/2) times as large.
    pub zero_rad: f64,
    /// Standard deviation of the logarithm of the rate.
    pub ln_sd: f64,
    /// Number of intervals between measurements of this robot from which the rate was learnt; 0: it is a hyper-prior.
    pub intervals: u32,
    /// Months since the last measurement of this robot; its posterior was widened for them.
    #[serde(skip)]
    pub(super) since_months: f64,
}

/// A hyper-prior that is reasoned, not measured: belts, couplings and gears of a sound arm settle by 20 urad in a year.
/// At 2 m this is 0.04 mm, as much as the arm's repeatability. Robots differ by a factor of e.
impl Default for Drift {
    fn default() -> Self {
        Self { zero_rad: 20e-6 / 12f64.sqrt(), ln_sd: 1.0, intervals: 0, since_months: 0.0 }
    }
}

/// The information of new lengths about the steps of the zeros since the last measurement, for which the posterior was
/// widened: gradient of the log likelihood by the steps, and its precision, with all other unknowns eliminated.
pub struct ZeroSteps {
    gradient: SVector<f64, AXES>,
    precision: SMatrix<f64, AXES, AXES>,
}

/// Probability that a zero jumped in an interval, as in a crash, and the size of a jump, rad. A jump says nothing about
/// the rate.
const JUMP: f64 = 0.01;
const JUMP_RAD: f64 = 1e-3;
/// Rates are tried to this distance on each side of the median, in standard deviations of the logarithm of the rate,
/// and in this number of steps.
const RATE_SDS: f64 = 4.0;
const RATE_STEPS: i32 = 40;
/// Least number of intervals of a rate that is the robot's own, and the largest ratio of its standard deviation to that
/// of the hyper-prior: a second measurement on one day says nothing about the rate.
const HISTORY: u32 = 2;
const LEARNT: f64 = 0.5;

impl Drift {
    /// Nothing is stated beyond this number of months.
    pub const MAX_MONTHS: f64 = 120.0;

    /// Whether the numbers are possible.
    pub(super) fn is_sound(&self) -> bool {
        self.zero_rad > 0.0 && self.zero_rad <= 0.01 && (0.0..=2.0).contains(&self.ln_sd)
    }

    /// Root mean square of the rate, rad for a month. Rates count with their squares, so that it is above the median.
    pub fn rms_zero_rad(&self) -> f64 {
        self.zero_rad * (self.ln_sd * self.ln_sd).exp()
    }

    /// Whether the rate was learnt from this robot's own history of three measurements or more.
    pub fn has_history(&self) -> bool {
        self.intervals >= HISTORY && self.ln_sd <= LEARNT * Self::default().ln_sd
    }

    /// Whether the drift differs from the hyper-prior.
    pub(super) fn is_learnt(&self) -> bool {
        Self { since_months: 0.0, ..*self } != Self::default()
    }

    /// Whether months went by since the last measurement.
    pub fn has_waited(&self) -> bool {
        self.since_months > 0.0
    }

    /// The drift after a new measurement, learnt from the steps since the last one: mean and standard deviation of the
    /// logarithm of the rate over its posterior.
    #[must_use]
    pub fn after(&self, steps: &ZeroSteps) -> Self {
        let unit = self.ln_sd * RATE_SDS / f64::from(RATE_STEPS);
        let rates = (-RATE_STEPS..=RATE_STEPS).map(|step| f64::from(step) * unit);
        let weighed: Vec<(f64, f64)> = rates
            .filter_map(|off| {
                let ln_prior = -0.5 * (off / self.ln_sd).powi(2);
                Some((off, ln_prior + self.ln_evidence(self.zero_rad * off.exp(), steps)?))
            })
            .collect();
        let most = weighed.iter().map(|(_, ln)| *ln).fold(f64::NEG_INFINITY, f64::max);
        let mean_of = |of: &dyn Fn(f64) -> f64| {
            let weights = weighed.iter().map(|(off, ln)| (of(*off), (ln - most).exp()));
            let (sum, all) =
                weights.fold((0.0, 0.0), |(sum, all), (x, weight)| (sum + x * weight, all + weight));
            sum / all
        };
        let off = mean_of(&|off| off);
        let variance = mean_of(&|other| (other - off).powi(2));
        let is_known = off.is_finite() && variance > 0.0;
        let (off, ln_sd) = if is_known { (off, variance.sqrt()) } else { (0.0, self.ln_sd) };
        Self {
            zero_rad: self.zero_rad * off.exp(),
            ln_sd,
            intervals: self.intervals + u32::from(is_known),
            since_months: 0.0,
        }
    }

    /// The logarithm of the evidence of a rate (rad for a month), relative to the rate for which the posterior was
    /// widened. Either all zeros wandered, or one of them also jumped.
    fn ln_evidence(&self, zero_rad: f64, steps: &ZeroSteps) -> Option<f64> {
        let wandered = self.since_months * (zero_rad.powi(2) - self.rms_zero_rad().powi(2));
        let without = steps.ln_evidence(SVector::repeat(wandered))? + (1.0 - JUMP).ln();
        let with = (0..AXES).filter_map(|joint| {
            let mut variances = SVector::repeat(wandered);
            variances[joint] += JUMP_RAD * JUMP_RAD;
            Some(steps.ln_evidence(variances)? + (JUMP / AXES as f64).ln())
        });
        let all: Vec<f64> = with.chain([without]).collect();
        let most = all.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        Some(most + all.iter().map(|ln| (ln - most).exp()).sum::<f64>().ln())
    }
}

impl ZeroSteps {
    /// The logarithm of the evidence of variances V (rad^2) that are added to the variances for which the posterior was
    /// widened: g'V(I + D V)^-1 g / 2 - ln|I + V D| / 2. V may be negative, but the sums must not be.
    fn ln_evidence(&self, variances: SVector<f64, AXES>) -> Option<f64> {
        let inner = SMatrix::<f64, AXES, AXES>::identity()
            + self.precision * SMatrix::<f64, AXES, AXES>::from_diagonal(&variances);
        let determinant = inner.determinant();
        let solved = inner.lu().solve(&self.gradient)?;
        let along = self.gradient.dot(&variances.component_mul(&solved));
        (determinant > 0.0).then(|| 0.5 * (along - determinant.ln()))
    }

    /// The information in the change from a prior to its posterior: `prior` is the root R of the prior's covariance
    /// (square, lower triangular), `zeros` are the rows of the zeros in it, `new` is the root R_new of the covariance
    /// of the same parameters after the lengths, and `moved` is the change dx of their values. w = R^-1 dx, B = R^-1
    /// R_new and F = R^-1 E for the columns E of the zeros give g = F'w and D = F'(I - B B')F. `None` if the prior's
    /// covariance is singular.
    pub fn of(
        prior: &DMatrix<f64>,
        zeros: [Option<usize>; AXES],
        new: &DMatrix<f64>,
        moved: &DVector<f64>,
    ) -> Option<Self> {
        let mut of_zeros = DMatrix::zeros(prior.nrows(), AXES);
        for (joint, row) in zeros.into_iter().enumerate() {
            row.into_iter().for_each(|row| of_zeros[(row, joint)] = 1.0);
        }
        let [moved, new, of_zeros] = [&DMatrix::from_columns(std::slice::from_ref(moved)), new, &of_zeros]
            .map(|part| prior.solve_lower_triangular(part));
        let (moved, new, of_zeros) = (moved?, new?, of_zeros?);
        let known = new.tr_mul(&of_zeros);
        let gradient = of_zeros.tr_mul(&moved);
        let precision = of_zeros.tr_mul(&of_zeros) - known.tr_mul(&known);
        Some(Self {
            gradient: SVector::from_column_slice(gradient.as_slice()),
            precision: SMatrix::from_column_slice(precision.as_slice()),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;
    use rand_pcg::Pcg64;

    fn ln_density(y: &DVector<f64>, covariance: &DMatrix<f64>) -> f64 {
        let factor = covariance.clone().cholesky().unwrap();
        -0.5 * y.dot(&factor.solve(y)) - factor.l_dirty().diagonal().map(f64::ln).sum()
    }

    /// Eight unknowns with a prior C and lengths y = A x + e of unit noise: ln N(y; 0, A (C + E V E') A' + I) less the
    /// same without V, where only the posterior after the lengths is known.
    #[test]
    fn evidence_of_steps_is_that_of_the_dense_covariances() {
        let mut random = Pcg64::seed_from_u64(3);
        let mut normals =
            |rows, columns| DMatrix::<f64>::from_fn(rows, columns, |_, _| random.sample(StandardNormal));
        let root = normals(8, 8).qr().r().transpose();
        let (lengths, y) = (normals(12, 8), normals(12, 1).column(0).into_owned());
        let prior = &root * root.transpose();
        let noise = DMatrix::identity(12, 12);
        let of = |prior: &DMatrix<f64>| &lengths * prior * lengths.transpose() + &noise;
        let gain = &prior * lengths.transpose() * of(&prior).try_inverse().unwrap();
        let covariance = &prior - &gain * &lengths * &prior;
        let new = covariance.cholesky().unwrap().l();
        let zeros = [1, 2, 3, 5, 6, 7];
        let steps = ZeroSteps::of(&root, zeros.map(Some), &new, &(gain * &y)).unwrap();
        for variances in [[0.7; AXES], [0.0, 2.0, 0.1, 0.0, 5.0, 0.3], [-1e-3; AXES]] {
            let mut wider = prior.clone();
            zeros.iter().zip(variances).for_each(|(at, variance)| wider[(*at, *at)] += variance);
            let expected = ln_density(&y, &of(&wider)) - ln_density(&y, &of(&prior));
            let found = steps.ln_evidence(variances.into()).unwrap();
            assert!((found - expected).abs() < 1e-6 * expected.abs().max(1.0), "{found} {expected}");
        }
        // A zero that the posterior lacks gives no information.
        let some =
            ZeroSteps::of(&root, [None, Some(2), None, None, None, None], &new, &DVector::zeros(8)).unwrap();
        assert!(some.precision[(1, 1)] > 0.0 && some.precision[(0, 0)] == 0.0);
    }

    /// The drift learnt from a number of intervals of three months, with zeros measured to 3 urad.
    fn learnt(rad_in_month: f64, intervals: u32, seed: u64, jump: Option<u32>) -> Drift {
        const SD: f64 = 3e-6;
        let mut random = Pcg64::seed_from_u64(seed);
        (0..intervals).fold(Drift::default(), |drift, at| {
            let waited = Drift { since_months: 3.0, ..drift };
            let step = 3f64.sqrt() * waited.rms_zero_rad();
            // Known to SD before; prior variance p, and what lengths of the same SD leave of it.
            let prior = SD * SD + step * step;
            let part = prior / (prior + SD * SD);
            let gradient = SVector::from_fn(|joint, _| {
                let mut moved = rad_in_month * 3f64.sqrt() * random.sample::<f64, _>(StandardNormal);
                moved += if jump == Some(at) && joint == 2 { 2e-3 } else { 0.0 };
                let errors = SD * 2f64.sqrt() * random.sample::<f64, _>(StandardNormal);
                part * (moved + errors) / prior
            });
            waited.after(&ZeroSteps { gradient, precision: SMatrix::identity() * (part / prior) })
        })
    }

    /// The logarithm of the size s of 72 steps (six zeros, 12 intervals) with errors n is known to (1 + n^2 / s^2) / 144^(1/2). A
    /// jump of one zero by 2 mrad changes it by less than that.
    #[test]
    fn the_rate_is_learnt_from_the_steps_of_the_zeros() {
        for rate in [2e-6, 5.8e-6, 16e-6] {
            for seed in 0..5 {
                let found = learnt(rate, 12, seed, None);
                let off = (found.zero_rad / rate).ln() / found.ln_sd;
                let known = (1.0 + 18e-12 / (3.0 * rate * rate)) / 12.0;
                assert!(off.abs() < 3.0 && found.ln_sd < 2.0 * known, "{rate}: {found:?} {known}");
                assert_eq!((found.intervals, found.has_history()), (12, true));
                let jumped = learnt(rate, 12, seed, Some(5));
                let off = (jumped.zero_rad / found.zero_rad).ln().abs();
                assert!(off < known.min(0.2), "{jumped:?} {found:?}");
            }
        }
        assert!(!learnt(5e-6, 1, 1, None).has_history());
        // Measured again and again on one day.
        let flat = ZeroSteps { gradient: SVector::zeros(), precision: SMatrix::identity() * 1e9 };
        let same_day = |drift: Drift| Drift { since_months: 0.01, ..drift }.after(&flat);
        let often = (0..5).fold(Drift::default(), |drift, _| same_day(drift));
        assert!(often.intervals == 5 && !often.has_history() && often.ln_sd > 0.9, "{often:?}");
    }
}
