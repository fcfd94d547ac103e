//! Transmission ripple: which joint repeats an error how often a turn.
//!
//! Each candidate, a cosine and a sine of one joint's angle, is judged by its Bayes factor beside the fit as it is: with
//! the precision D of its two coefficients by the lengths, all other unknowns taken out, and g the gradient,
//! ln B = g'(D + I/s^2)^-1 g / 2 - ln|I + s^2 D| / 2.

use nalgebra::{DMatrix, DVector, Matrix2, Vector2};

use super::joint_system::System;
use super::noise_shape::NoiseShape;
use crate::robot::{AXES, Joint};

/// Cycles a turn that are tried.
const ORDERS: std::ops::RangeInclusive<u32> = 3..=180;
/// So much more than the number of candidates asks for must speak for the best.
const MARGIN: f64 = 2.0;

/// A joint and how often a turn it repeats its error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Candidate {
    pub(super) joint: Joint,
    pub(super) order: u32,
    ln_bayes: f64,
}

impl Candidate {
    /// Whether it is more than the best of so many by chance.
    pub(super) fn is_believed(&self) -> bool {
        self.ln_bayes > ln_candidates() + MARGIN
    }
}

/// The logarithm of the number of candidates: what choosing one of them costs.
pub(super) fn ln_candidates() -> f64 {
    (AXES as f64 * f64::from(ORDERS.end() - ORDERS.start() + 1)).ln()
}

/// A fit beside which candidates are judged.
pub(super) struct Beside<'a> {
    pub(super) system: &'a System,
    pub(super) shape: NoiseShape,
    pub(super) sigma_mm: f64,
    /// A root of the covariance of all unknowns.
    pub(super) root: &'a DMatrix<f64>,
    pub(super) unknowns: &'a DVector<f64>,
    /// One standard deviation of a coefficient before, rad.
    pub(super) sd_rad: f64,
}

impl Beside<'_> {
    /// The candidate that most speaks for.
    pub(super) fn strongest(&self) -> Option<Candidate> {
        let Self { system, shape, sigma_mm, .. } = *self;
        let mut rows = system.lines.values.clone();
        system.whiten_all(&mut rows, shape)?;
        let mut residual = system.residual(self.unknowns);
        system.whiten_all(&mut residual, shape)?;
        // Rows of the posterior, over sigma^2.
        let known = (rows * self.root).transpose() / (sigma_mm * sigma_mm);
        let mut best: Option<Candidate> = None;
        for order in ORDERS {
            let mut columns = DMatrix::zeros(system.lines.values.nrows(), 2 * AXES);
            for (row, (angles, levers)) in system.lines.joints.iter().zip(&system.lines.levers).enumerate() {
                for joint in 0..AXES {
                    let (sin, cos) = (f64::from(order) * angles[joint]).sin_cos();
                    columns[(row, 2 * joint)] = levers[joint] * cos;
                    columns[(row, 2 * joint + 1)] = levers[joint] * sin;
                }
            }
            system.whiten_all(&mut columns, shape)?;
            let gram = columns.transpose() * &columns / (sigma_mm * sigma_mm);
            let taken = &known * &columns;
            let gradients = columns.transpose() * &residual / (sigma_mm * sigma_mm);
            for joint in Joint::ALL {
                let at = 2 * joint.index();
                let taken = taken.columns(at, 2);
                let own = gram.fixed_view::<2, 2>(at, at) - taken.transpose() * taken;
                let own = Matrix2::from_fn(|i, j| own[(i, j)]);
                let gradient = Vector2::new(gradients[(at, 0)], gradients[(at + 1, 0)]);
                let Some(ln_bayes) = self.ln_bayes(own, gradient) else { continue };
                if best.is_none_or(|best| ln_bayes > best.ln_bayes) {
                    best = Some(Candidate { joint, order, ln_bayes });
                }
            }
        }
        best
    }

    fn ln_bayes(&self, own: Matrix2<f64>, gradient: Vector2<f64>) -> Option<f64> {
        let variance = self.sd_rad * self.sd_rad;
        let widened = (own + Matrix2::identity() / variance).try_inverse()?;
        let occam = (Matrix2::identity() + own * variance).determinant();
        let ln_bayes = 0.5 * (gradient.dot(&(widened * gradient)) - occam.ln());
        ln_bayes.is_finite().then_some(ln_bayes)
    }
}
