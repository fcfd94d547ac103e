//! The noise of lengths, pose by pose.
//!
//! Where the sense of approach is not known, the angle of a joint is wrong by half of its reversal error, to either
//! side. Where the sense is known, a joint may still scatter: its last move can be too short to cross the play. Both
//! are noise in the direction in which the joint moves the tool ball, and act on the lengths of a pose together. Their
//! standard deviations u are the most probable under their priors. They are found by scoring (Harville, Journal of the
//! American Statistical Association 72, 1977) on the logarithms of u.
//!
//! For the rows A of a pose, let S be the covariance of their noise, C the posterior covariance of the unknowns, and
//! P = S^-1 - S^-1 A C A' S^-1. With the residuals r and the derivatives l by a joint's angle,
//! d ln Z / d ln u = u^2 sum((l' S^-1 r)^2 - l' P l), and the information is 2 u_k^2 u_l^2 sum (l_k' P l_l)^2. The
//! expected value of an unknown sense has a coefficient w of its own, whose prior standard deviation is the same u: it
//! adds (w^2 + C) / u^2 - 1, here with the posterior variance C of w. The independent noise t of each length is one
//! more such variance, with W^2 in place of l l'. If it cannot be separated from the noise of the pose, it keeps the
//! stated value.

use nalgebra::{Cholesky, DMatrix, SMatrix, SVector};

use super::hyper_parameters::{Group, HyperPrior};
use super::pose_rows::{PoseRows, RowNoise};
use super::system::{SystemPosterior, Whitened};
use crate::robot::AXES;

/// Largest change of the logarithm of a standard deviation in a step.
const LONGEST_STEP: f64 = 1.0;

/// The noise besides the standard deviation sigma of a pose in each direction.
#[derive(Clone, Copy, Debug)]
pub(super) struct NoiseShape {
    /// The independent noise of each length.
    pub(super) own: OwnNoise,
    pub(super) joints: JointNoise,
}

/// Random error of each joint's angle from visit to visit: standard deviation, rad. An estimated standard deviation is
/// 0 for a joint that did not move.
#[derive(Clone, Copy, Debug)]
pub(super) enum JointNoise {
    /// The sense of approach is known for some lengths: backlash is an unknown of the model there. Where the sense is
    /// not known, half of the reversal error is noise. The scatter of all visits is estimated: a last move may be too
    /// short to cross the play, for example.
    Approached { backlash: [f64; AXES], scatter: [f64; AXES] },
    /// No sense of approach is known: backlash is estimated from the scatter.
    Unapproached([f64; AXES]),
}

/// Standard deviation of the independent noise of a length (without the noise of the pose), mm.
#[derive(Clone, Copy, Debug)]
pub(super) enum OwnNoise {
    /// The stated value: it cannot be separated from the noise of the pose.
    Stated(f64),
    /// Estimated, with a prior about the stated value.
    Sought { sd: f64, stated: f64 },
}

impl OwnNoise {
    pub(super) fn sd(self) -> f64 {
        let (Self::Stated(sd) | Self::Sought { sd, .. }) = self;
        sd
    }
}

/// Prior standard deviation of the logarithm of a standard deviation about its stated value.
const STATED_LN_SD: f64 = 1.0;

impl NoiseShape {
    /// The independent noise of a length, mm, if several lengths of a visit tell it apart from what they share.
    pub(super) fn sought_own_sd(&self) -> Option<f64> {
        match self.own {
            OwnNoise::Sought { sd, .. } => Some(sd),
            OwnNoise::Stated(_) => None,
        }
    }

    /// Whether no part of the noise is estimated.
    pub(super) fn is_known(&self) -> bool {
        self.joints.sought() == [0.0; AXES] && matches!(self.own, OwnNoise::Stated(_))
    }

    /// The noise `factor` times as large.
    pub(super) fn scaled(self, factor: f64) -> Self {
        let times = |sds: [f64; AXES]| sds.map(|sd| sd * factor);
        let joints = match self.joints {
            JointNoise::Approached { backlash, scatter } => {
                JointNoise::Approached { backlash: times(backlash), scatter: times(scatter) }
            }
            JointNoise::Unapproached(sds) => JointNoise::Unapproached(times(sds)),
        };
        let own = match self.own {
            OwnNoise::Stated(sd) => OwnNoise::Stated(sd * factor),
            OwnNoise::Sought { sd, stated } => OwnNoise::Sought { sd: sd * factor, stated },
        };
        Self { own, joints }
    }

    /// This noise with what is sought of another.
    pub(super) fn with_sought(self, other: Self) -> Self {
        let own = if matches!(self.own, OwnNoise::Sought { .. }) { other.own } else { self.own };
        Self { own, joints: self.joints.with_sought(other.joints.sought()) }
    }

    /// The noise of rows in units of sigma; `weights` are factors on the independent noise of each row.
    pub(super) fn of_rows(&self, rows: &PoseRows, weights: &[f64], sigma_mm: f64) -> RowNoise {
        let own = self.own.sd() / sigma_mm;
        let [approached, unapproached] =
            [1, 0].map(|sense| self.joints.sds(&[sense; AXES]).map(|sd| sd / sigma_mm));
        let joints = |senses: &[i8; AXES]| {
            std::array::from_fn(
                |joint| if senses[joint] == 0 { unapproached[joint] } else { approached[joint] },
            )
        };
        RowNoise {
            pose: 1.0,
            own: weights.iter().map(|weight| own * weight).collect(),
            joints: rows.lengths.iter().map(|length| joints(&length.senses)).collect(),
        }
    }
}

/// Prior median of the scatter of a joint, rad: a repeatability of 0.01 mm at an arm of 2 m, of four joints that move
/// the tool ball.
const SCATTER_RAD: f64 = 2.5e-6;

impl JointNoise {
    /// No noise of the joints.
    pub(super) const NONE: Self = Self::Approached { backlash: [0.0; AXES], scatter: [0.0; AXES] };

    /// The noise at which the search begins: the prior median for joints that moved, 0 for the others.
    pub(super) fn of_moved(moved: [bool; AXES], is_approached: bool) -> Self {
        let begin = |prior: HyperPrior| moved.map(|moved| if moved { prior.median } else { 0.0 });
        if is_approached {
            Self::NONE.with_sought(begin(Self::NONE.prior()))
        } else {
            let none = Self::Unapproached([0.0; AXES]);
            none.with_sought(begin(none.prior()))
        }
    }

    pub(super) fn is_approached(self) -> bool {
        match self {
            Self::Approached { .. } => true,
            Self::Unapproached(_) => false,
        }
    }

    /// The standard deviations that are estimated, rad.
    pub(super) fn sought(self) -> [f64; AXES] {
        let (Self::Approached { scatter: sds, .. } | Self::Unapproached(sds)) = self;
        sds
    }

    fn with_sought(self, sds: [f64; AXES]) -> Self {
        match self {
            Self::Approached { backlash, .. } => Self::Approached { backlash, scatter: sds },
            Self::Unapproached(_) => Self::Unapproached(sds),
        }
    }

    /// The noise with at most the prior median of scatter. Noise from backlash of unknown sense stays as it is.
    pub(super) fn at_most_usual(self) -> Self {
        match self {
            Self::Approached { backlash, scatter } => {
                Self::Approached { backlash, scatter: scatter.map(|sd| sd.min(SCATTER_RAD)) }
            }
            Self::Unapproached(_) => self,
        }
    }

    /// Whether the estimated noise of a joint acts on a length with this sense of approach.
    fn is_in(self, sense: i8) -> bool {
        self.is_approached() || sense == 0
    }

    /// Standard deviations of the joints' angles at a length with these senses of approach, rad.
    fn sds(self, senses: &[i8; AXES]) -> [f64; AXES] {
        std::array::from_fn(|joint| match self {
            Self::Approached { scatter, .. } if senses[joint] != 0 => scatter[joint],
            Self::Approached { backlash, scatter } => backlash[joint].hypot(scatter[joint]),
            Self::Unapproached(sds) if senses[joint] == 0 => sds[joint],
            Self::Unapproached(_) => 0.0,
        })
    }

    /// The logarithm of the prior density of the estimated standard deviations, relative to its largest value.
    pub(super) fn ln_prior(self) -> f64 {
        let off = |sd: f64| self.prior().off(sd.ln());
        self.sought().into_iter().filter(|sd| *sd > 0.0).map(|sd| -0.5 * off(sd).powi(2)).sum()
    }

    fn prior(self) -> HyperPrior {
        let of_backlash = HyperPrior::all(1.0)[Group::Backlash as usize];
        match self {
            Self::Approached { .. } => HyperPrior { median: SCATTER_RAD, ..of_backlash },
            Self::Unapproached(_) => of_backlash,
        }
    }
}

/// A posterior whose residuals tell how to change the noise.
pub(super) struct NoiseScore<'a> {
    pub(super) rows: &'a PoseRows,
    pub(super) whitened: &'a Whitened,
    pub(super) posterior: &'a SystemPosterior<'a>,
    /// Places of the backlash coefficients among the unknowns.
    pub(super) backlash_places: [Option<usize>; AXES],
}

/// Gradient and information of the evidence by the logarithm of each joint's noise, then of the independent noise of a
/// length.
struct Slopes {
    gradient: SVector<f64, { AXES + 1 }>,
    information: SMatrix<f64, { AXES + 1 }, { AXES + 1 }>,
}

/// The place of the independent noise of a length among the slopes.
const OWN: usize = AXES;

impl NoiseScore<'_> {
    /// The noise after a step towards its most probable value.
    pub(super) fn step(&self) -> Option<NoiseShape> {
        let NoiseShape { own, joints } = self.whitened.shape;
        let Slopes { gradient, information } = self.slopes()?;
        let step = Cholesky::new(information)?.solve(&gradient);
        let factor = |at: usize| step[at].clamp(-LONGEST_STEP, LONGEST_STEP).exp();
        Some(NoiseShape {
            joints: joints.with_sought(std::array::from_fn(|joint| joints.sought()[joint] * factor(joint))),
            own: match own {
                OwnNoise::Sought { sd, stated } => OwnNoise::Sought { sd: sd * factor(OWN), stated },
                OwnNoise::Stated(_) => own,
            },
        })
    }

    /// Root of the posterior mean square of each joint's noise, rad: its posterior is taken as log-normal, with the
    /// most probable value as its median. Noise that the lengths hardly show may be larger than its most probable
    /// value.
    pub(super) fn rms_rad(&self) -> Option<[f64; AXES]> {
        let sds = self.whitened.shape.joints.sought();
        let covariance = Cholesky::new(self.slopes()?.information)?.inverse();
        Some(std::array::from_fn(|joint| sds[joint] * covariance[(joint, joint)].exp()))
    }

    fn slopes(&self) -> Option<Slopes> {
        let Self { rows, whitened, posterior, .. } = *self;
        let sigma_mm = posterior.sigma_mm;
        let NoiseShape { own, joints } = whitened.shape;
        let sds = joints.sought();
        let mut by_joint = DMatrix::from_fn(rows.lengths.len(), AXES, |row, joint| {
            let length = &rows.lengths[row];
            if joints.is_in(length.senses[joint]) { length.by_joint[joint] } else { 0.0 }
        });
        whitened.whitening.apply(&mut by_joint);
        by_joint /= sigma_mm;
        // Transposed, so that what belongs to a row is together.
        let known = posterior.rows_by_root(&whitened.rows)?.transpose();
        let residual = (&whitened.right - &whitened.rows * &posterior.mean) / sigma_mm;
        let variances = sds.map(|sd| sd * sd);
        let mut gradient = SVector::<f64, { AXES + 1 }>::zeros();
        let mut information = SMatrix::<f64, { AXES + 1 }, { AXES + 1 }>::zeros();
        let own_variance = match own {
            OwnNoise::Sought { sd, .. } => sd * sd,
            OwnNoise::Stated(_) => 0.0,
        };
        for (pose, of_pose) in rows.poses.iter().enumerate() {
            // What the unknowns leave of the covariance of the rows.
            let unexplained = DMatrix::from_fn(of_pose.len(), of_pose.len(), |i, j| {
                let explained = known.column(of_pose[i]).dot(&known.column(of_pose[j]));
                if i == j { 1.0 - explained } else { -explained }
            });
            let by_joint = by_joint.select_rows(of_pose);
            let residual = residual.select_rows(of_pose);
            let left_by_joint = &unexplained * &by_joint;
            let left = by_joint.tr_mul(&left_by_joint);
            let scores = by_joint.tr_mul(&residual);
            for k in 0..AXES {
                gradient[k] += variances[k] * (scores[k].powi(2) - left[(k, k)]);
                for l in 0..AXES {
                    information[(k, l)] += 2.0 * variances[k] * variances[l] * left[(k, l)].powi(2);
                }
            }
            if own_variance > 0.0 {
                // F F' is the covariance of the pose in units of sigma^2: the columns of F^-1 W belong to its lengths.
                let mut owns = whitened.whitening.inverse_factor(pose);
                for (mut column, row) in owns.column_iter_mut().zip(of_pose) {
                    column *= whitened.weights[*row] / sigma_mm;
                }
                let left_owns = owns.tr_mul(&(unexplained * &owns));
                let scores = owns.tr_mul(&residual);
                gradient[OWN] += own_variance * (scores.norm_squared() - left_owns.trace());
                information[(OWN, OWN)] += 2.0 * own_variance.powi(2) * left_owns.norm_squared();
                let across = owns.tr_mul(&left_by_joint);
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
        let prior = joints.prior();
        for k in 0..AXES {
            let is_of_sense = |_: &usize| !joints.is_approached() && sds[k] > 0.0;
            if let Some(place) = self.backlash_places[k].filter(is_of_sense) {
                let left = posterior.variance(place)? / variances[k];
                gradient[k] += posterior.mean[place].powi(2) / variances[k] + left - 1.0;
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

#[cfg(test)]
mod tests {
    use super::super::hyper_parameters::{Hypers, Variance};
    use super::super::system::System;
    use super::super::tests::cell_of_poses::{hypers, model, normals, readings};
    use super::*;
    use crate::robot::{BarId, Joint, ParamId};

    const SIGMA_MM: f64 = 0.03;

    fn system() -> System {
        let (model, readings) = (model(3), readings(&model(3), 40, 2));
        let unit = vec![1.0; readings.len()];
        let ids = [ParamId::A(Joint::J2), ParamId::BarOffset(BarId::FIRST)];
        let rows = PoseRows::at(&model, &(readings.as_slice(), unit.as_slice()), &ids, |_| None);
        System {
            right: normals(readings.len(), 7) * 0.04,
            weights: (0..readings.len()).map(|at| if at % 2 == 0 { 0.8 } else { 1.2 }).collect(),
            rows,
            variances: vec![Some(Variance::Fixed(0.5)), Some(Variance::Fixed(0.05))],
            is_sigma_given: false,
            sigma_mm: SIGMA_MM,
        }
    }

    fn shape(own: OwnNoise) -> NoiseShape {
        NoiseShape { own, joints: JointNoise::NONE }
    }

    fn sought(sd: f64) -> NoiseShape {
        shape(OwnNoise::Sought { sd, stated: 0.02 })
    }

    fn scored<R>(system: &System, shape: NoiseShape, of: impl Fn(NoiseScore<'_>) -> R) -> R {
        let whitened = system.whitened(shape, SIGMA_MM).unwrap();
        let posterior = whitened.equations.posterior(&hypers(SIGMA_MM)).unwrap();
        of(NoiseScore {
            rows: &system.rows,
            whitened: &whitened,
            posterior: &posterior,
            backlash_places: [None; AXES],
        })
    }

    /// The logarithm of the evidence at these noises; the prior of ln t is normal about what is stated.
    fn ln_evidence(system: &System, shape: NoiseShape, hypers: &Hypers) -> f64 {
        let whitened = system.whitened(shape, SIGMA_MM).unwrap();
        let of_own = match shape.own {
            OwnNoise::Sought { sd, stated } => -0.5 * ((sd / stated).ln() / STATED_LN_SD).powi(2),
            OwnNoise::Stated(_) => 0.0,
        };
        let evidence = whitened.equations.posterior(hypers).unwrap().ln_evidence(hypers);
        evidence + of_own + shape.joints.ln_prior()
    }

    #[test]
    fn gradient_by_the_noise_of_a_length_is_that_of_the_evidence() {
        let (system, hypers) = (system(), hypers(SIGMA_MM));
        for sd in [0.01, 0.025] {
            let found = scored(&system, sought(sd), |score| score.slopes().unwrap().gradient[OWN]);
            let moved = |step: f64| ln_evidence(&system, sought(sd * step.exp()), &hypers);
            let numeric = (moved(1e-4) - moved(-1e-4)) / 2e-4;
            assert!((found - numeric).abs() < 1e-4 * numeric.abs().max(1.0), "{found} {numeric}");
        }
    }

    #[test]
    fn gradient_by_the_noise_of_joints_is_that_of_the_evidence() {
        let (system, hypers) = (system(), hypers(SIGMA_MM));
        let sds = [2e-5, 5e-5, 3e-5, 8e-5, 4e-5, 1e-4];
        // The lengths have no sense of approach, so that known backlash is in their noise too.
        let approached = JointNoise::Approached { backlash: [3e-5; AXES], scatter: sds };
        for joints in [JointNoise::Unapproached(sds), approached] {
            let at = |sds| NoiseShape { joints: joints.with_sought(sds), ..sought(0.015) };
            let found = scored(&system, at(sds), |score| score.slopes().unwrap().gradient);
            for joint in 0..AXES {
                let moved = |step: f64| {
                    let mut sds = sds;
                    sds[joint] *= step.exp();
                    ln_evidence(&system, at(sds), &hypers)
                };
                let numeric = (moved(1e-4) - moved(-1e-4)) / 2e-4;
                let size = numeric.abs().max(1.0);
                assert!((found[joint] - numeric).abs() < 1e-4 * size, "{joint}: {} {numeric}", found[joint]);
            }
        }
    }

    /// Half of 0.01 mm at an arm of 2 m; the medians of [`HyperPrior::all`] and half of a standard deviation of a logarithm from them.
    #[test]
    fn noise_of_joints_is_of_the_sense_of_approach() {
        let moved = [true, true, false, true, true, true];
        let [approached, not] = [true, false].map(|is_approached| JointNoise::of_moved(moved, is_approached));
        assert_eq!(approached.sought(), [2.5e-6, 2.5e-6, 0.0, 2.5e-6, 2.5e-6, 2.5e-6]);
        assert_eq!(not.sought(), [3e-5, 3e-5, 0.0, 3e-5, 3e-5, 3e-5]);
        assert_eq!([approached, not, JointNoise::NONE].map(JointNoise::ln_prior), [0.0; 3]);
        let wider = approached.with_sought(approached.sought().map(|sd| sd * 0.5f64.exp()));
        assert!((wider.ln_prior() + 5.0 * 0.125).abs() < 1e-12);
        assert_eq!(wider.at_most_usual().sought(), approached.sought());
        // A known sense of approach leaves only the scatter; an unknown sense adds backlash.
        let noise = JointNoise::Approached { backlash: [4e-5; AXES], scatter: [3e-5; AXES] };
        let found = noise.sds(&[1, 0, -1, 0, 0, 0]);
        assert_eq!([found[0], found[2]], [3e-5; 2]);
        assert!((found[1] - 5e-5).abs() < 1e-19);
        assert_eq!(not.sds(&[1, 0, -1, 1, 1, 1]), [0.0, 3e-5, 0.0, 0.0, 0.0, 0.0]);
    }

    /// The information is the variance of the gradient over data that are as the noise says, without those of the priors; 2000
    /// data sets have it to 1 / sqrt(1000), 3 %.
    #[test]
    fn information_is_the_variance_of_the_gradient() {
        const SETS: usize = 2000;
        let mut system = system();
        let (shape, count) = (sought(0.02), system.right.len());
        let information = scored(&system, shape, |score| score.slopes().unwrap().information[(OWN, OWN)]);
        let root = {
            let whitened = system.whitened(shape, SIGMA_MM).unwrap();
            // Whitening of the unit matrix is the inverse of the root, in units of sigma.
            let mut inverse = DMatrix::identity(count, count);
            whitened.whitening.apply(&mut inverse);
            inverse.try_inverse().unwrap() * SIGMA_MM
        };
        let gradients: Vec<f64> = (0..SETS)
            .map(|set| {
                let of_unknowns = normals(2, 90_000 + set as u64)
                    .component_mul(&nalgebra::DVector::from_row_slice(&[0.5, 0.05]));
                system.right =
                    &root * normals(count, 10_000 + set as u64) + &system.rows.values * of_unknowns;
                scored(&system, shape, |score| score.slopes().unwrap().gradient[OWN])
            })
            .collect();
        let mean = gradients.iter().sum::<f64>() / SETS as f64;
        let variance = gradients.iter().map(|one| (one - mean).powi(2)).sum::<f64>() / SETS as f64;
        let expected = information - STATED_LN_SD.powi(-2);
        assert!((variance / expected - 1.0).abs() < 0.1, "{variance} {expected}");
        // Nothing pulls at the true noise: four standard errors.
        assert!(mean.abs() < 4.0 * (variance / SETS as f64).sqrt(), "{mean}");
    }

    #[test]
    fn what_is_stated_or_known_is_not_moved() {
        let known = JointNoise::Approached { backlash: [1e-5; AXES], scatter: [0.0; AXES] };
        let (system, stated) = (system(), NoiseShape { own: OwnNoise::Stated(0.015), joints: known });
        assert!(stated.is_known() && !sought(0.01).is_known());
        let after = scored(&system, stated, |score| score.step().unwrap());
        assert_eq!((after.own.sd(), after.joints.sds(&[0; AXES])), (0.015, [1e-5; AXES]));
        assert!(after.is_known());
        // Only the estimated noise moves, towards the noise of the numbers.
        let both = NoiseShape { joints: known, ..sought(0.015) };
        let after = scored(&system, both, |score| score.step().unwrap());
        assert_eq!(after.joints.sds(&[0; AXES]), [1e-5; AXES]);
        assert!(matches!(after.own, OwnNoise::Sought { sd, stated: 0.02 } if sd > 0.015), "{after:?}");
    }
}
