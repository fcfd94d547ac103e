//! The most probable noise of lengths: a step towards it from a posterior.
//!
//! The standard deviations u of a [`NoiseShape`] are the most probable under their priors. They are found by scoring
//! (Harville, Journal of the American Statistical Association 72, 1977) on the logarithms of u.
//!
//! For the rows A of a pose, let S be the covariance of their noise, C the posterior covariance of the unknowns, and
//! P = S^-1 - S^-1 A C A' S^-1. With the residuals r and the derivatives l by a joint's angle,
//! d ln Z / d ln u = u^2 sum((l' S^-1 r)^2 - l' P l), and the information is 2 u_k^2 u_l^2 sum (l_k' P l_l)^2. The
//! expected value of an unknown sense has a coefficient w of its own, whose prior standard deviation is the same u: it
//! adds (w^2 + C) / u^2 - 1, here with the posterior variance C of w. The independent noise t of each length is one
//! more such variance, with W^2 in place of l l'.

use nalgebra::{Cholesky, DMatrix, SMatrix, SVector};

use super::noise_shape::{NoiseShape, OwnNoise};
use super::pose_rows::PoseRows;
use super::system::{SystemPosterior, Whitened};
use crate::robot::AXES;

/// Largest change of the logarithm of a standard deviation in a step.
const LONGEST_STEP: f64 = 1.0;
/// Prior standard deviation of the logarithm of a standard deviation about its stated value.
const STATED_LN_SD: f64 = 1.0;

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
    use super::super::noise_shape::JointNoise;
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
