//! How far the lengths of each visit are from what all other visits predict.
//!
//! With whitened rows A of a visit, the posterior covariance C of all unknowns and H = A C A', the residuals r of the visit become
//! (I - H)^-1 r when it is left out, and their covariance (I - H)^-1 (Rasmussen and Williams, "Gaussian Processes for Machine
//! Learning", 2006, section 5.4.2). Real robots have errors that no unknown describes: then these residuals are larger than that.

use nalgebra::DMatrix;

use super::system::{SystemPosterior, Whitened};
use crate::math::distributions::ln_gamma;

/// The factor 1 before any visit counts as much as this number of visits.
const PRIOR_VISITS: f64 = 10.0;
/// The reciprocal degrees of freedom of a visit: the mean of its exponential prior, and the values of which the mean is taken.
const USUAL_RECIPROCAL: f64 = 0.05;
const RECIPROCALS: std::ops::RangeInclusive<u32> = 0..=20;
const RECIPROCAL_STEP: f64 = 0.01;

/// What the visits that are left out show of any other pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct LeftOutVisits {
    /// The factor on the noise with which the posterior predicts them as they are found, at least 1. The noise itself stays as it
    /// is: the factor is that of what the posterior adds to it.
    pub(super) noise_factor: f64,
    /// The degrees of freedom of the t-distribution of their errors: few mean that large errors are less rare than normal ones.
    pub(super) degrees_of_freedom: f64,
}

/// The error of a visit that is left out.
struct LeftOutError {
    lengths: usize,
    /// Its square in units of the predicted covariance: chi-square of its lengths if all is normal.
    deviate: f64,
}

impl LeftOutVisits {
    /// `None` if a visit cannot be left out.
    pub(super) fn of(whitened: &Whitened, posterior: &SystemPosterior<'_>) -> Option<Self> {
        let by_root = posterior.rows_by_root(&whitened.rows)?;
        let residual = &whitened.right - &whitened.rows * &posterior.mean;
        let variance = posterior.sigma_mm.powi(2);
        let (mut found, mut predicted, mut squares) = (0.0, 0.0, 0.0);
        let mut errors = Vec::new();
        for (rows, factor) in whitened.whitening.factors() {
            let noise = factor.norm_squared() * variance;
            // Most visits have one length, which needs no matrices.
            let (off, beyond, deviate) = if let [row] = rows {
                let left_out = (1.0 - by_root.row(*row).norm_squared()).recip();
                let square = left_out * residual[*row].powi(2) / variance;
                (noise * left_out * square, noise * (left_out - 1.0), square)
            } else {
                let (by_root, residual) = (by_root.select_rows(rows), residual.select_rows(rows));
                let identity = DMatrix::identity(rows.len(), rows.len());
                let left_out = (&identity - &by_root * by_root.transpose()).try_inverse()?;
                let off = &left_out * &residual;
                let beyond = (&factor * (left_out - identity)).dot(&factor) * variance;
                ((&factor * &off).norm_squared(), beyond, residual.dot(&off) / variance)
            };
            found += off - noise;
            predicted += beyond;
            squares += beyond * beyond;
            errors.push(LeftOutError { lengths: rows.len(), deviate });
        }
        // The number of visits on which the sums rest.
        let visits = if squares > 0.0 { predicted * predicted / squares } else { 0.0 };
        let ratio = if predicted > 0.0 { found / predicted } else { 0.0 };
        let square = (PRIOR_VISITS + visits * ratio) / (PRIOR_VISITS + visits);
        // The larger of a number that is none and 1 would be 1.
        square.is_finite().then(|| Self {
            noise_factor: square.max(1.0).sqrt(),
            degrees_of_freedom: degrees_of_freedom(&errors),
        })
    }
}

/// The degrees of freedom of t-distributed errors, by the posterior mean of their reciprocal. Only the shape is judged: the errors
/// are divided by their root mean square.
fn degrees_of_freedom(errors: &[LeftOutError]) -> f64 {
    let sum = |of: fn(&LeftOutError) -> f64| errors.iter().map(of).sum::<f64>();
    let mean_square = sum(|error| error.deviate) / sum(|error| error.lengths as f64);
    // Lengths without any error show no tails, and neither do errors that are no numbers.
    let errors = if mean_square > 0.0 && mean_square.is_finite() { errors } else { &[] };
    let max_lengths = errors.iter().map(|error| error.lengths).max().unwrap_or(0);
    let candidates = RECIPROCALS.map(|step| f64::from(step) * RECIPROCAL_STEP);
    let weighted: Vec<(f64, f64)> = candidates
        .map(|reciprocal| {
            // The same for all visits with as many lengths.
            let at_zero: Vec<f64> =
                (0..=max_lengths).map(|count| ln_density_at_zero(count, reciprocal)).collect();
            let of_error = |error: &LeftOutError| {
                at_zero[error.lengths] - ln_fall(error.lengths, error.deviate / mean_square, reciprocal)
            };
            (reciprocal, errors.iter().map(of_error).sum::<f64>() - reciprocal / USUAL_RECIPROCAL)
        })
        .collect();
    let most = weighted.iter().fold(f64::NEG_INFINITY, |most, (_, weight)| most.max(*weight));
    let [mean, all] = weighted.iter().fold([0.0; 2], |[mean, all], (reciprocal, weight)| {
        let weight = (weight - most).exp();
        [mean + weight * reciprocal, all + weight]
    });
    all / mean
}

/// The logarithm of the density of `count` t-distributed numbers of the unit covariance at 0, relative to normal ones; `reciprocal`
/// is that of their degrees of freedom (Kotz and Nadarajah, "Multivariate t Distributions and Their Applications", 2004, section 1.1).
fn ln_density_at_zero(count: usize, reciprocal: f64) -> f64 {
    if reciprocal == 0.0 {
        return 0.0;
    }
    let (freedom, half) = (reciprocal.recip(), 0.5 * count as f64);
    ln_gamma(0.5 * freedom + half) - ln_gamma(0.5 * freedom) - half * (0.5 * freedom - 1.0).ln()
}

/// By how much that logarithm falls to where the squares of the numbers add to `square`.
fn ln_fall(count: usize, square: f64, reciprocal: f64) -> f64 {
    if reciprocal == 0.0 {
        return 0.5 * square;
    }
    let freedom = reciprocal.recip();
    0.5 * (freedom + count as f64) * (square / (freedom - 2.0)).ln_1p()
}

#[cfg(test)]
mod tests {
    use super::super::system::tests::{SHAPE, SIGMA_MM, dense, noise, system};
    use super::super::tests::cell_of_poses::{hypers, model, readings};
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_distr::{ChiSquared, Distribution, StandardNormal};
    use rand_pcg::Pcg64;

    /// Each visit is left out of the dense equations, and predicted by the others: 30 visits, of which every second one has two lengths,
    /// with residuals that are three times as large as their noise.
    #[test]
    fn factor_is_that_of_visits_that_are_left_out() {
        let mut readings = readings(&model(2), 30, 1);
        let mut place = 0..;
        readings.retain(|_| place.next().is_some_and(|place| place % 4 != 1));
        let (whole, hypers) = (system(&readings), hypers(SIGMA_MM));
        let noise_of_all = noise(&whole);
        let (mut found, mut predicted, mut squares) = (0.0, 0.0, 0.0);
        for visit in &whole.rows.poses {
            let others: Vec<usize> = (0..readings.len()).filter(|row| !visit.contains(row)).collect();
            let mut without = system(&others.iter().map(|row| readings[*row]).collect::<Vec<_>>());
            without.right = whole.right.select_rows(&others);
            let (mean, covariance) = dense(&without, &hypers);
            let rows = whole.rows.values.select_rows(visit);
            let off = whole.right.select_rows(visit) - &rows * mean;
            let noise = noise_of_all.select_rows(visit).select_columns(visit).trace();
            let beyond = (&rows * covariance * rows.transpose()).trace();
            found += off.norm_squared() - noise;
            predicted += beyond;
            squares += beyond * beyond;
        }
        let visits = predicted * predicted / squares;
        let expected = ((10.0 + visits * found / predicted) / (10.0 + visits)).sqrt();
        let whitened = whole.whitened(SHAPE, SIGMA_MM).unwrap();
        let posterior = whitened.equations.posterior(&hypers).unwrap();
        let factor = LeftOutVisits::of(&whitened, &posterior).unwrap().noise_factor;
        assert!(expected > 1.5 && (factor / expected - 1.0).abs() < 1e-6, "{factor} {expected}");
    }

    /// Residuals of the model's own size ask for no factor, and smaller ones for none below 1.
    #[test]
    fn a_model_that_explains_all_has_no_factor() {
        let mut system = system(&readings(&model(2), 30, 1));
        let hypers = hypers(SIGMA_MM);
        for (share, most) in [(0.3, 1.1), (0.01, 1.0)] {
            let right = &system.right * share;
            let right = std::mem::replace(&mut system.right, right);
            let whitened = system.whitened(SHAPE, SIGMA_MM).unwrap();
            let posterior = whitened.equations.posterior(&hypers).unwrap();
            let factor = LeftOutVisits::of(&whitened, &posterior).unwrap().noise_factor;
            assert!((1.0..=most).contains(&factor), "{share}: {factor}");
            system.right = right;
        }
    }

    /// Drawn errors: normal ones, and visits of three lengths that are divided by the root of a gamma variable of 6 degrees of
    /// freedom. 2000 visits tell the reciprocal to sqrt(24 / 2000) / 6 = 0.02.
    #[test]
    fn tails_of_drawn_visits() {
        let mut random = Pcg64::seed_from_u64(5);
        let mut errors = |freedom: Option<f64>, count: usize| -> Vec<LeftOutError> {
            let of_visit = |_| {
                let scale = freedom
                    .map_or(1.0, |freedom| ChiSquared::new(freedom).unwrap().sample(&mut random) / freedom);
                let square = |_| -> f64 { random.sample::<f64, _>(StandardNormal).powi(2) };
                LeftOutError { lengths: 3, deviate: (0..3).map(square).sum::<f64>() / scale }
            };
            (0..count).map(of_visit).collect()
        };
        assert!(degrees_of_freedom(&errors(None, 2000)) > 40.0);
        let found = degrees_of_freedom(&errors(Some(6.0), 2000));
        assert!((5.0..7.5).contains(&found), "{found}");
        for deviate in [0.0, f64::INFINITY, f64::NAN] {
            let errors = [LeftOutError { lengths: 1, deviate }, LeftOutError { lengths: 3, deviate: 0.0 }];
            assert_eq!(degrees_of_freedom(&errors), degrees_of_freedom(&[]), "{deviate}");
        }
        // Without visits it is the prior's: the mean of an exponential density of mean 0.05 that ends at 0.2.
        let none = degrees_of_freedom(&[]);
        let weights = (0..=20).map(|step| f64::from(step) * 0.01).map(|x| (x, (-x / 0.05).exp()));
        let [mean, all] =
            weights.fold([0.0; 2], |sums, (x, weight)| [sums[0] + x * weight, sums[1] + weight]);
        assert!((none - all / mean).abs() < 1e-9, "{none}");
    }

    /// Values of scipy.stats.multivariate_t.logpdf with the shape (freedom - 2) / freedom, plus 1.5 ln(2 pi).
    #[test]
    fn density_of_three_numbers() {
        for (square, reciprocal, expected) in [
            (0.0, 0.1, 0.40506668782935895),
            (2.0, 0.1, -1.0453663957130046),
            (30.0, 0.1, -9.722873329473217),
            (30.0, 0.2, -8.692702154600592),
            (9.0, 0.01, -4.487105389762586),
            (4.0, 0.0, -2.0),
        ] {
            let found = ln_density_at_zero(3, reciprocal) - ln_fall(3, square, reciprocal);
            assert!((found - expected).abs() < 1e-9, "{square} {reciprocal}: {found}");
        }
    }
}
