//! Transmission ripple: the joint that repeats an error, and how often it does so in a turn.
//!
//! Each candidate, a cosine and a sine of one joint's angle, is judged by its Bayes factor when it is added to the
//! present fit. With the precision D of its two coefficients by the lengths, all other unknowns eliminated, and the
//! gradient g, ln B = g'(D + I/s^2)^-1 g / 2 - ln|I + s^2 D| / 2.

use nalgebra::{DMatrix, DVector, Matrix2, Vector2};

use super::pose_rows::PoseRows;
use super::system::Whitened;
use crate::robot::{AXES, Joint};

/// Cycles a turn that are tried.
const ORDERS: std::ops::RangeInclusive<u32> = 3..=180;
/// Candidates whose products are formed at once.
const TOGETHER: usize = 64;
/// The logarithm of the Bayes factor of the best candidate must exceed that of the number of candidates by this.
const MARGIN: f64 = 2.0;

/// A joint, the number of times in a turn that it repeats an error, and the evidence for this.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Candidate {
    pub(super) joint: Joint,
    pub(super) order: u32,
    ln_bayes: f64,
}

impl Candidate {
    /// Whether the candidate is better than the best of all candidates would be by chance.
    pub(super) fn is_believed(&self) -> bool {
        self.ln_bayes > ln_candidates() + MARGIN
    }
}

/// The logarithm of the number of candidates: the loss of evidence for the choice of one of them.
pub(super) fn ln_candidates() -> f64 {
    (AXES as f64 * f64::from(ORDERS.end() - ORDERS.start() + 1)).ln()
}

/// A posterior to which candidates are added to judge them.
pub(super) struct RippleSearch<'a> {
    pub(super) rows: &'a PoseRows,
    pub(super) whitened: &'a Whitened,
    pub(super) sigma_mm: f64,
    pub(super) mean: &'a DVector<f64>,
    /// A root of the covariance of all unknowns.
    pub(super) root: &'a DMatrix<f64>,
    /// Prior standard deviation of a coefficient, rad.
    pub(super) sd_rad: f64,
    /// Joints that moved.
    pub(super) joints: &'a [Joint],
}

impl RippleSearch<'_> {
    /// The candidate of the largest Bayes factor.
    pub(super) fn strongest(&self) -> Option<Candidate> {
        let Self { whitened, sigma_mm, .. } = *self;
        let residual = (&whitened.right - &whitened.rows * self.mean) / sigma_mm;
        let known = (&whitened.rows * self.root).transpose() / sigma_mm;
        let candidates: Vec<(u32, Joint)> =
            ORDERS.flat_map(|order| self.joints.iter().map(move |joint| (order, *joint))).collect();
        let judged = candidates.chunks(TOGETHER).flat_map(|candidates| {
            let columns = self.columns(candidates);
            let explained = &known * &columns;
            let judge = |(at, &(order, joint)): (usize, &(u32, Joint))| {
                let [own, explained] = [&columns, &explained].map(|all| all.fixed_columns::<2>(2 * at));
                let information = own.tr_mul(&own) - explained.tr_mul(&explained);
                let ln_bayes = self.ln_bayes(information, own.tr_mul(&residual))?;
                Some(Candidate { joint, order, ln_bayes })
            };
            candidates.iter().enumerate().filter_map(judge).collect::<Vec<Candidate>>()
        });
        judged.max_by(|a, b| a.ln_bayes.total_cmp(&b.ln_bayes))
    }

    /// The whitened columns of cosine and sine of each candidate.
    fn columns(&self, candidates: &[(u32, Joint)]) -> DMatrix<f64> {
        let rows = self.rows;
        let mut columns = DMatrix::zeros(rows.lengths.len(), 2 * candidates.len());
        for (at, &(order, joint)) in candidates.iter().enumerate() {
            let joint = joint.index();
            for of_pose in &rows.poses {
                let (sin, cos) = (f64::from(order) * rows.lengths[of_pose[0]].joints[joint]).sin_cos();
                for &row in of_pose {
                    columns[(row, 2 * at)] = rows.lengths[row].by_joint[joint] * cos;
                    columns[(row, 2 * at + 1)] = rows.lengths[row].by_joint[joint] * sin;
                }
            }
        }
        self.whitened.whitening.apply(&mut columns);
        columns / self.sigma_mm
    }

    fn ln_bayes(&self, own: Matrix2<f64>, gradient: Vector2<f64>) -> Option<f64> {
        let variance = self.sd_rad * self.sd_rad;
        let widened = (own + Matrix2::identity() / variance).try_inverse()?;
        let occam = (Matrix2::identity() + own * variance).determinant();
        let ln_bayes = 0.5 * (gradient.dot(&(widened * gradient)) - occam.ln());
        ln_bayes.is_finite().then_some(ln_bayes)
    }
}
