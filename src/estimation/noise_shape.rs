//! The noise of lengths, pose by pose, in units of the noise of a pose.
//!
//! Where the sense of approach is not known, a joint is half of its reversal error off its angle, to either side: that is
//! noise along what the joint moves. Its variances are the likeliest, by scoring (Harville, Journal of the American
//! Statistical Association 72, 1977) on their logarithms under the prior of backlash: with P = S^-1 - S^-1 A C A' S^-1
//! of a pose's rows, r what they leave and l what a joint moves, d ln Z / d ln u = u^2 sum((l' S^-1 r)^2 - l' P l), and the
//! information is 2 u_k^2 u_l^2 sum (l_k' P l_l)^2. What is expected of the sense has a coefficient of its own, whose prior
//! standard deviation is the same u: it adds (w^2 + C) / u^2 - 1.

use nalgebra::{Cholesky, DMatrix, DVector, SMatrix, SVector};

use super::joint_system::System;
use super::pose_rows::{PoseRows, RowNoise};
use super::priors::{Group, HyperPrior};
use crate::robot::AXES;

/// No step changes the logarithm of a standard deviation by more.
const LONGEST_STEP: f64 = 1.0;

/// In units of the standard deviation of a pose in each direction.
#[derive(Clone, Copy, Debug)]
pub(super) struct NoiseShape {
    /// What each length has of its own.
    pub(super) ratio: f64,
    pub(super) backlash: BacklashNoise,
}

/// Half of the reversal error of each joint where its sense of approach is not known, rad per mm of the pose's noise.
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

    /// The noise of rows whose own noise has these weights.
    pub(super) fn of_rows(&self, lines: &PoseRows, weights: &[f64]) -> RowNoise {
        let sds = self.backlash.sds();
        let joints = |senses: &[i8; AXES]| {
            std::array::from_fn(|joint| if senses[joint] == 0 { sds[joint] } else { 0.0 })
        };
        RowNoise {
            pose: 1.0,
            own: weights.iter().map(|weight| self.ratio * weight).collect(),
            joints: lines.senses.iter().map(joints).collect(),
        }
    }
}

impl BacklashNoise {
    /// What is sought, of joints that moved, where it begins; sigma in mm.
    pub(super) fn sought(moved: [bool; AXES], sigma_mm: f64) -> Self {
        let start = Self::prior().median / sigma_mm;
        Self::Sought(moved.map(|moved| if moved { start } else { 0.0 }))
    }

    pub(super) fn is_known(self) -> bool {
        matches!(self, Self::Known(_))
    }

    pub(super) fn sds(self) -> [f64; AXES] {
        let (Self::Known(sds) | Self::Sought(sds)) = self;
        sds
    }

    /// The logarithm of the prior against its middle.
    pub(super) fn ln_prior(self, sigma_mm: f64) -> f64 {
        let Self::Sought(sds) = self else { return 0.0 };
        let off = |sd: f64| Self::prior().off((sd * sigma_mm).ln());
        sds.into_iter().filter(|sd| *sd > 0.0).map(|sd| -0.5 * off(sd).powi(2)).sum()
    }

    fn prior() -> HyperPrior {
        HyperPrior::ALL[Group::Backlash as usize]
    }
}

/// A fit whose noise is scored.
pub(super) struct Scored<'a> {
    pub(super) system: &'a System,
    pub(super) shape: NoiseShape,
    pub(super) sigma_mm: f64,
    /// All unknowns, and a root of their covariance.
    pub(super) unknowns: &'a DVector<f64>,
    pub(super) root: &'a DMatrix<f64>,
    /// Where the coefficients of backlash are among them.
    pub(super) coefficients: [Option<usize>; AXES],
}

impl Scored<'_> {
    /// The shape after a step towards the likeliest.
    pub(super) fn step(self) -> Option<NoiseShape> {
        let BacklashNoise::Sought(sds) = self.shape.backlash else { return Some(self.shape) };
        let Self { system, sigma_mm, .. } = self;
        let lines = &system.lines;
        let mut levers = DMatrix::from_fn(lines.levers.len(), AXES, |row, joint| {
            if lines.senses[row][joint] == 0 { lines.levers[row][joint] } else { 0.0 }
        });
        let mut known = &lines.values * self.root;
        let mut residual = system.residual(self.unknowns);
        for rows in [&mut levers, &mut known, &mut residual] {
            system.whiten_all(rows, self.shape)?;
            *rows /= sigma_mm;
        }
        let variances = sds.map(|sd| (sd * sigma_mm).powi(2));
        let mut gradient = SVector::<f64, AXES>::zeros();
        let mut information = SMatrix::<f64, AXES, AXES>::zeros();
        for rows in &lines.poses {
            let levers = levers.select_rows(rows);
            let taken = known.select_rows(rows).tr_mul(&levers);
            let left = levers.tr_mul(&levers) - taken.tr_mul(&taken);
            let scores = levers.tr_mul(&residual.select_rows(rows));
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
            if let Some(place) = self.coefficients[k].filter(|_| sds[k] > 0.0) {
                let left = self.root.row(place).norm_squared() / variances[k];
                gradient[k] += self.unknowns[place].powi(2) / variances[k] + left - 1.0;
                information[(k, k)] += 2.0 * (1.0 - left).powi(2);
            }
            if sds[k] > 0.0 {
                gradient[k] -= prior.off((sds[k] * sigma_mm).ln()) / ln_sd;
            }
            information[(k, k)] += ln_sd.powi(-2);
        }
        let step = Cholesky::new(information)?.solve(&gradient);
        let stepped = |joint: usize| sds[joint] * step[joint].clamp(-LONGEST_STEP, LONGEST_STEP).exp();
        let backlash = BacklashNoise::Sought(std::array::from_fn(stepped));
        Some(NoiseShape { backlash, ..self.shape })
    }
}
