//! The noise of lengths, pose by pose.
//!
//! Where the sense of approach is not known, a joint is half of its reversal error off its angle, to either side: that is
//! noise along what the joint moves. Its variances are the likeliest, by scoring (Harville, Journal of the American
//! Statistical Association 72, 1977) on their logarithms under the prior of backlash: with P = S^-1 - S^-1 A C A' S^-1
//! of a pose's rows, r what they leave and l what a joint moves, d ln Z / d ln u = u^2 sum((l' S^-1 r)^2 - l' P l), and the
//! information is 2 u_k^2 u_l^2 sum (l_k' P l_l)^2. What is expected of the sense has a coefficient of its own, whose prior
//! standard deviation is the same u: it adds (w^2 + C) / u^2 - 1. The noise t that each length has of its own is one more
//! such variance: W^2 in place of l l'. Where it cannot be told from that of the pose, it is what is stated.

use nalgebra::{Cholesky, DMatrix, DVector, SMatrix, SVector};

use super::hyper_parameters::{Group, HyperPrior};
use super::pose_rows::{PoseRows, RowNoise};
use super::system::Whitened;
use crate::robot::AXES;

/// No step changes the logarithm of a standard deviation by more.
const LONGEST_STEP: f64 = 1.0;

/// What the noise has beside the standard deviation sigma of a pose in each direction.
#[derive(Clone, Copy, Debug)]
pub(super) struct NoiseShape {
    /// What each length has of its own.
    pub(super) own: OwnNoise,
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

/// The standard deviation that a length has beside its pose, mm.
#[derive(Clone, Copy, Debug)]
pub(super) enum OwnNoise {
    /// As stated: it cannot be told from that of the pose.
    Stated(f64),
    /// To be found, about what is stated.
    Sought { sd: f64, stated: f64 },
}

impl OwnNoise {
    pub(super) fn sd(self) -> f64 {
        let (Self::Stated(sd) | Self::Sought { sd, .. }) = self;
        sd
    }
}

/// Standard deviation of the logarithm of a stated standard deviation.
const STATED_LN_SD: f64 = 1.0;

impl NoiseShape {
    /// Whether nothing of it is sought.
    pub(super) fn is_known(&self) -> bool {
        self.backlash.is_known() && matches!(self.own, OwnNoise::Stated(_))
    }

    /// The noise of rows whose own noise has these weights, over sigma.
    pub(super) fn of_rows(&self, rows: &PoseRows, weights: &[f64], sigma_mm: f64) -> RowNoise {
        let sds = self.backlash.sds().map(|sd| sd / sigma_mm);
        let own = self.own.sd() / sigma_mm;
        let joints = |senses: &[i8; AXES]| {
            std::array::from_fn(|joint| if senses[joint] == 0 { sds[joint] } else { 0.0 })
        };
        RowNoise {
            pose: 1.0,
            own: weights.iter().map(|weight| own * weight).collect(),
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
        HyperPrior::all(1.0)[Group::Backlash as usize]
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

/// Gradient and information of the evidence by the logarithm of the backlash of each joint, then of the length's own noise.
struct Slopes {
    gradient: SVector<f64, { AXES + 1 }>,
    information: SMatrix<f64, { AXES + 1 }, { AXES + 1 }>,
}

/// The place of the length's own noise among the slopes.
const OWN: usize = AXES;

impl NoiseScore<'_> {
    /// The shape after a step towards the likeliest.
    pub(super) fn step(&self) -> Option<NoiseShape> {
        let NoiseShape { own, backlash } = self.whitened.shape;
        let Slopes { gradient, information } = self.slopes()?;
        let step = Cholesky::new(information)?.solve(&gradient);
        let factor = |at: usize| step[at].clamp(-LONGEST_STEP, LONGEST_STEP).exp();
        Some(NoiseShape {
            backlash: match backlash {
                BacklashNoise::Sought(sds) => {
                    BacklashNoise::Sought(std::array::from_fn(|joint| sds[joint] * factor(joint)))
                }
                BacklashNoise::Known(_) => backlash,
            },
            own: match own {
                OwnNoise::Sought { sd, stated } => OwnNoise::Sought { sd: sd * factor(OWN), stated },
                OwnNoise::Stated(_) => own,
            },
        })
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
        let NoiseShape { own, backlash } = whitened.shape;
        let sds = if backlash.is_known() { [0.0; AXES] } else { backlash.sds() };
        let mut levers = DMatrix::from_fn(rows.levers.len(), AXES, |row, joint| {
            if rows.senses[row][joint] == 0 { rows.levers[row][joint] } else { 0.0 }
        });
        whitened.whitening.apply(&mut levers);
        levers /= sigma_mm;
        let known = &whitened.rows * self.root / sigma_mm;
        let residual = (&whitened.right - &whitened.rows * self.mean) / sigma_mm;
        let variances = sds.map(|sd| sd * sd);
        let mut gradient = SVector::<f64, { AXES + 1 }>::zeros();
        let mut information = SMatrix::<f64, { AXES + 1 }, { AXES + 1 }>::zeros();
        let own_variance = match own {
            OwnNoise::Sought { sd, .. } => sd * sd,
            OwnNoise::Stated(_) => 0.0,
        };
        for (pose, of_pose) in rows.poses.iter().enumerate() {
            let levers = levers.select_rows(of_pose);
            let known = known.select_rows(of_pose);
            let residual = residual.select_rows(of_pose);
            let explained = known.tr_mul(&levers);
            let left = levers.tr_mul(&levers) - explained.tr_mul(&explained);
            let scores = levers.tr_mul(&residual);
            for k in 0..AXES {
                gradient[k] += variances[k] * (scores[k].powi(2) - left[(k, k)]);
                for l in 0..AXES {
                    information[(k, l)] += 2.0 * variances[k] * variances[l] * left[(k, l)].powi(2);
                }
            }
            if own_variance > 0.0 {
                // With F F' the covariance of the pose in units of sigma^2, the columns of F^-1 W are those of its lengths.
                let mut owns = whitened.whitening.inverse_factor(pose);
                for (mut column, row) in owns.column_iter_mut().zip(of_pose) {
                    column *= whitened.weights[*row] / sigma_mm;
                }
                let explained_owns = known.tr_mul(&owns);
                let left_owns = owns.tr_mul(&owns) - explained_owns.tr_mul(&explained_owns);
                let scores = owns.tr_mul(&residual);
                gradient[OWN] += own_variance * (scores.norm_squared() - left_owns.trace());
                information[(OWN, OWN)] += 2.0 * own_variance.powi(2) * left_owns.norm_squared();
                let across = owns.tr_mul(&levers) - explained_owns.tr_mul(&explained);
                for k in 0..AXES {
                    let both = 2.0 * variances[k] * own_variance * across.column(k).norm_squared();
                    information[(OWN, k)] += both;
                    information[(k, OWN)] += both;
                }
            }
        }
        if let OwnNoise::Sought { sd, stated } = own {
            gradient[OWN] -= (sd / stated).ln() / STATED_LN_SD.powi(2);
        }
        information[(OWN, OWN)] += STATED_LN_SD.powi(-2);
        let prior = BacklashNoise::prior();
        for k in 0..AXES {
            if let Some(place) = self.backlash_places[k].filter(|_| sds[k] > 0.0) {
                let left = self.root.row(place).norm_squared() / variances[k];
                gradient[k] += self.mean[place].powi(2) / variances[k] + left - 1.0;
                information[(k, k)] += 2.0 * (1.0 - left).powi(2);
            }
            if sds[k] > 0.0 {
                gradient[k] -= prior.off(sds[k].ln()) / prior.ln_sd;
            }
            information[(k, k)] += prior.ln_sd.powi(-2);
        }
        Some(Slopes { gradient, information })
    }
}
