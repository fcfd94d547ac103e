//! The noise of lengths, pose by pose.
//!
//! Where the sense of approach is not known, a joint is half of its reversal error off its angle, to either side: that is
//! noise along what the joint moves. Its variances are the likeliest, by scoring (Harville, Journal of the American
//! Statistical Association 72, 1977) on their logarithms under the prior of backlash: with P = S^-1 - S^-1 A C A' S^-1
//! of a pose's rows, r what they leave and l what a joint moves, d ln Z / d ln u = u^2 sum((l' S^-1 r)^2 - l' P l), and the
//! information is 2 u_k^2 u_l^2 sum (l_k' P l_l)^2. What is expected of the sense has a coefficient of its own, whose prior
//! standard deviation is the same u: it adds (w^2 + C) / u^2 - 1.

use nalgebra::{Cholesky, DMatrix, DVector, SMatrix, SVector};

use super::joint_system::Whitened;
use super::pose_rows::{PoseRows, RowNoise};
use super::priors::{Group, HyperPrior};
use crate::robot::AXES;

/// No step changes the logarithm of a standard deviation by more.
const LONGEST_STEP: f64 = 1.0;

/// What the noise has beside the standard deviation sigma of a pose in each direction.
#[derive(Clone, Copy, Debug)]
pub(super) struct NoiseShape {
    /// Standard deviation that each length has of its own, over sigma.
    pub(super) ratio: f64,
    pub(super) backlash: BacklashNoise,
}

/// Half of the reversal error of each joint where its sense of approach is not known: standard deviation, rad.
#[derive(Clone, Copy, Debug)]
pub(super) enum BacklashNoise {
    /// By other lengths, whose sense is known, or none.
    Known([f64; AXES]),
    /// To be found from the scatter.
    Sought([f64; AXES]),
}

impl NoiseShape {
    pub(super) fn with_ratio(self, ratio: f64) -> Self {
        Self { ratio, ..self }
    }

    /// The noise of rows whose own noise has these weights, over sigma.
    pub(super) fn of_rows(&self, rows: &PoseRows, weights: &[f64], sigma_mm: f64) -> RowNoise {
        let sds = self.backlash.sds().map(|sd| sd / sigma_mm);
        let joints = |senses: &[i8; AXES]| {
            std::array::from_fn(|joint| if senses[joint] == 0 { sds[joint] } else { 0.0 })
        };
        RowNoise {
            pose: 1.0,
            own: weights.iter().map(|weight| self.ratio * weight).collect(),
            joints: rows.senses.iter().map(joints).collect(),
        }
    }
}

impl BacklashNoise {
    /// Of joints that moved, where the search begins.
    pub(super) fn sought(moved: [bool; AXES]) -> Self {
        Self::Sought(moved.map(|moved| if moved { Self::prior().median } else { 0.0 }))
    }

    pub(super) fn is_known(self) -> bool {
        matches!(self, Self::Known(_))
    }

    pub(super) fn sds(self) -> [f64; AXES] {
        let (Self::Known(sds) | Self::Sought(sds)) = self;
        sds
    }

    /// The logarithm of the prior against its middle.
    pub(super) fn ln_prior(self) -> f64 {
        let Self::Sought(sds) = self else { return 0.0 };
        let off = |sd: f64| Self::prior().off(sd.ln());
        sds.into_iter().filter(|sd| *sd > 0.0).map(|sd| -0.5 * off(sd).powi(2)).sum()
    }

    fn prior() -> HyperPrior {
        HyperPrior::ALL[Group::Backlash as usize]
    }
}

/// A posterior by whose residuals the noise is scored.
pub(super) struct NoiseScore<'a> {
    pub(super) rows: &'a PoseRows,
    pub(super) whitened: &'a Whitened,
    pub(super) sigma_mm: f64,
    /// All unknowns, and a root of their covariance.
    pub(super) mean: &'a DVector<f64>,
    pub(super) root: &'a DMatrix<f64>,
    /// Where the coefficients of backlash are among them.
    pub(super) backlash_places: [Option<usize>; AXES],
}

/// Gradient and information of the evidence by the logarithm of the backlash of each joint.
struct Slopes {
    gradient: SVector<f64, AXES>,
    information: SMatrix<f64, AXES, AXES>,
}

impl NoiseScore<'_> {
    /// The shape after a step towards the likeliest.
    pub(super) fn step(&self) -> Option<NoiseShape> {
        let sds = self.whitened.shape.backlash.sds();
        let Slopes { gradient, information } = self.slopes()?;
        let step = Cholesky::new(information)?.solve(&gradient);
        let stepped = |joint: usize| sds[joint] * step[joint].clamp(-LONGEST_STEP, LONGEST_STEP).exp();
        let backlash = BacklashNoise::Sought(std::array::from_fn(stepped));
        Some(NoiseShape { backlash, ..self.whitened.shape })
    }

    /// Root of the posterior mean square of each joint's backlash, rad: the likeliest is the median of a log-normal
    /// distribution. What lengths hardly show may be larger.
    pub(super) fn rms_rad(&self) -> Option<[f64; AXES]> {
        let sds = self.whitened.shape.backlash.sds();
        let covariance = Cholesky::new(self.slopes()?.information)?.inverse();
        Some(std::array::from_fn(|joint| sds[joint] * covariance[(joint, joint)].exp()))
    }

    fn slopes(&self) -> Option<Slopes> {
        let Self { rows, whitened, sigma_mm, .. } = *self;
        let sds = whitened.shape.backlash.sds();
        let mut levers = DMatrix::from_fn(rows.levers.len(), AXES, |row, joint| {
            if rows.senses[row][joint] == 0 { rows.levers[row][joint] } else { 0.0 }
        });
        whitened.whitening.apply(&mut levers);
        levers /= sigma_mm;
        let known = &whitened.rows * self.root / sigma_mm;
        let residual = (&whitened.right - &whitened.rows * self.mean) / sigma_mm;
        let variances = sds.map(|sd| sd * sd);
        let mut gradient = SVector::<f64, AXES>::zeros();
        let mut information = SMatrix::<f64, AXES, AXES>::zeros();
        for of_pose in &rows.poses {
            let levers = levers.select_rows(of_pose);
            let explained = known.select_rows(of_pose).tr_mul(&levers);
            let left = levers.tr_mul(&levers) - explained.tr_mul(&explained);
            let scores = levers.tr_mul(&residual.select_rows(of_pose));
            for k in 0..AXES {
                gradient[k] += variances[k] * (scores[k].powi(2) - left[(k, k)]);
                for l in 0..AXES {
                    information[(k, l)] += 2.0 * variances[k] * variances[l] * left[(k, l)].powi(2);
                }
            }
        }
        let prior = BacklashNoise::prior();
        let ln_sd = prior.ln_sd?;
        for k in 0..AXES {
            if let Some(place) = self.backlash_places[k].filter(|_| sds[k] > 0.0) {
                let left = self.root.row(place).norm_squared() / variances[k];
                gradient[k] += self.mean[place].powi(2) / variances[k] + left - 1.0;
                information[(k, k)] += 2.0 * (1.0 - left).powi(2);
            }
            if sds[k] > 0.0 {
                gradient[k] -= prior.off(sds[k].ln()) / ln_sd;
            }
            information[(k, k)] += ln_sd.powi(-2);
        }
        Some(Slopes { gradient, information })
    }
}
