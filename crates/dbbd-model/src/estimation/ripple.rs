//! Transmission ripple: the joint that repeats an error, and how often it does so in a turn.
//!
//! Each candidate, a cosine and a sine of one joint's angle, is judged by its Bayes factor when it is added to the
//! present fit. With the precision D of its two coefficients by the lengths, all other unknowns eliminated, and the
//! gradient g, ln B = g'(D + I/s^2)^-1 g / 2 - ln|I + s^2 D| / 2.

use nalgebra::{Complex, DMatrix, Matrix2, Vector2};

use super::pose_rows::PoseRows;
use super::system::{SystemPosterior, Whitened};
use crate::math::map_items;
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
    pub(super) posterior: &'a SystemPosterior<'a>,
    /// Prior standard deviation of a coefficient, rad.
    pub(super) sd_rad: f64,
    /// Joints that moved.
    pub(super) joints: &'a [Joint],
}

/// Cosine and sine of the multiples of a joint's angle, one order after the other: e^i(k+1)q = e^ikq e^iq.
struct Turns {
    by_joint: Vec<f64>,
    once: Vec<Complex<f64>>,
    now: Vec<Complex<f64>>,
}

impl Turns {
    fn new(rows: &PoseRows, joint: Joint) -> Self {
        let at = joint.index();
        let turned = |order: f64| rows.lengths.iter().map(move |row| Complex::cis(order * row.joints[at]));
        Self {
            by_joint: rows.lengths.iter().map(|row| row.by_joint[at]).collect(),
            once: turned(1.0).collect(),
            now: turned(f64::from(*ORDERS.start())).collect(),
        }
    }
}

impl RippleSearch<'_> {
    /// The candidate of the largest Bayes factor.
    pub(super) fn strongest(&self) -> Option<Candidate> {
        let Self { whitened, posterior, .. } = *self;
        let residual = (&whitened.right - &whitened.rows * &posterior.mean) / posterior.sigma_mm;
        let known = posterior.rows_by_root(&whitened.rows)?.transpose();
        let orders: Vec<u32> = ORDERS.collect();
        let of_joint = |joint: &Joint| {
            let mut turns = Turns::new(self.rows, *joint);
            let judged = orders.chunks(TOGETHER).flat_map(|orders| {
                let columns = self.columns(&mut turns, orders.len());
                let explained = &known * &columns;
                let judge = |(at, order): (usize, &u32)| {
                    let [own, explained] = [&columns, &explained].map(|all| all.fixed_columns::<2>(2 * at));
                    let information = own.tr_mul(&own) - explained.tr_mul(&explained);
                    let ln_bayes = self.ln_bayes(information, own.tr_mul(&residual))?;
                    Some(Candidate { joint: *joint, order: *order, ln_bayes })
                };
                orders.iter().enumerate().filter_map(judge).collect::<Vec<Candidate>>()
            });
            judged.max_by(|a, b| a.ln_bayes.total_cmp(&b.ln_bayes))
        };
        let of_joints = map_items(self.joints, of_joint).into_iter().flatten();
        of_joints.max_by(|a, b| a.ln_bayes.total_cmp(&b.ln_bayes))
    }

    /// The whitened columns of cosine and sine of the next orders.
    fn columns(&self, turns: &mut Turns, orders: usize) -> DMatrix<f64> {
        let mut columns = DMatrix::zeros(turns.by_joint.len(), 2 * orders);
        for at in 0..orders {
            for (row, by_joint) in turns.by_joint.iter().enumerate() {
                let turned = turns.now[row];
                columns[(row, 2 * at)] = by_joint * turned.re;
                columns[(row, 2 * at + 1)] = by_joint * turned.im;
            }
            turns.now.iter_mut().zip(&turns.once).for_each(|(now, once)| *now *= once);
        }
        self.whitened.whitening.apply(&mut columns);
        columns / self.posterior.sigma_mm
    }

    fn ln_bayes(&self, own: Matrix2<f64>, gradient: Vector2<f64>) -> Option<f64> {
        let variance = self.sd_rad * self.sd_rad;
        let widened = (own + Matrix2::identity() / variance).try_inverse()?;
        let occam = (Matrix2::identity() + own * variance).determinant();
        let ln_bayes = 0.5 * (gradient.dot(&(widened * gradient)) - occam.ln());
        ln_bayes.is_finite().then_some(ln_bayes)
    }
}
