//! How far the lengths of each visit are from what all other visits predict.
//!
//! With whitened rows A of a visit, the posterior covariance C of all unknowns and H = A C A', the residuals r of the visit become
//! (I - H)^-1 r when it is left out, and their covariance (I - H)^-1 (Rasmussen and Williams, "Gaussian Processes for Machine
//! Learning", 2006, section 5.4.2). Real robots have errors that no unknown describes: then these residuals are larger than that.

use nalgebra::DMatrix;

use super::system::{SystemPosterior, Whitened};

/// The factor 1 before any visit counts as much as this number of visits.
const PRIOR_VISITS: f64 = 10.0;

/// The factor on the noise with which the posterior predicts visits that are left out as they are found, at least 1; `None` if a
/// visit cannot be left out. The noise itself stays as it is: the factor is that of what the posterior adds to it.
pub(super) fn noise_factor(whitened: &Whitened, posterior: &SystemPosterior<'_>) -> Option<f64> {
    let by_root = posterior.rows_by_root(&whitened.rows)?;
    let residual = &whitened.right - &whitened.rows * &posterior.mean;
    let variance = posterior.sigma_mm.powi(2);
    let (mut found, mut predicted, mut squares) = (0.0, 0.0, 0.0);
    for (rows, factor) in whitened.whitening.factors() {
        let noise = factor.norm_squared() * variance;
        // Most visits have one length, which needs no matrices.
        let (off, beyond) = if let [row] = rows {
            let left_out = (1.0 - by_root.row(*row).norm_squared()).recip();
            (noise / variance * (left_out * residual[*row]).powi(2), noise * (left_out - 1.0))
        } else {
            let by_root = by_root.select_rows(rows);
            let identity = DMatrix::identity(rows.len(), rows.len());
            let left_out = (&identity - &by_root * by_root.transpose()).try_inverse()?;
            let off = &factor * (&left_out * residual.select_rows(rows));
            (off.norm_squared(), (&factor * (left_out - identity)).dot(&factor) * variance)
        };
        found += off - noise;
        predicted += beyond;
        squares += beyond * beyond;
    }
    // The number of visits on which the sums rest.
    let visits = if squares > 0.0 { predicted * predicted / squares } else { return Some(1.0) };
    let square = (PRIOR_VISITS + visits * found / predicted) / (PRIOR_VISITS + visits);
    square.is_finite().then(|| square.max(1.0).sqrt())
}

#[cfg(test)]
mod tests {
    use super::super::system::tests::{SHAPE, SIGMA_MM, dense, noise, system};
    use super::super::tests::cell_of_poses::{hypers, model, readings};
    use super::*;

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
        let factor = noise_factor(&whitened, &posterior).unwrap();
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
            let factor = noise_factor(&whitened, &posterior).unwrap();
            assert!((1.0..=most).contains(&factor), "{share}: {factor}");
            system.right = right;
        }
    }
}
