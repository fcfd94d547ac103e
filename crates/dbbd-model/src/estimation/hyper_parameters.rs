//! Groups of unknowns that share a variance, and the hyper-parameters that these variances follow.
//!
//! A hyper-parameter is positive, and its logarithm has a normal prior. `evidence` finds the most probable values.

use serde::{Deserialize, Serialize};

use crate::robot::{AXES, GaussianProcess, Joint};

/// The prior of a hyper-parameter: log-normal about `median`.
#[derive(Clone, Copy, Debug)]
pub(super) struct HyperPrior {
    pub(super) median: f64,
    /// Standard deviation of the logarithm.
    pub(super) ln_sd: f64,
    pub(super) bounds: [f64; 2],
}

/// Groups of unknowns that share a variance.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Group {
    /// First harmonic of a joint's angle, rad.
    Harmonic,
    /// Smooth function of a joint's angle, rad.
    Smooth,
    /// Half of the reversal error, rad.
    Backlash,
    /// Transmission ripple, rad.
    Ripple,
    /// Compliance, in prior standard deviations.
    Compliance,
    /// Geometry, in the maker's tolerances.
    Tolerance,
    /// Tool ball, in its standard uncertainty.
    Tool,
    /// Displacement of the tool ball at similar poses, mm.
    Cluster,
    /// Zeros of the joints (rad) and scale of the links with time.
    Warming,
}

impl Group {
    pub const ALL: [Self; 9] = [
        Self::Harmonic,
        Self::Smooth,
        Self::Backlash,
        Self::Ripple,
        Self::Compliance,
        Self::Tolerance,
        Self::Tool,
        Self::Cluster,
        Self::Warming,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Self::Harmonic => "harmonic",
            Self::Smooth => "smooth",
            Self::Backlash => "backlash",
            Self::Ripple => "ripple",
            Self::Compliance => "compliance",
            Self::Tolerance => "tolerance",
            Self::Tool => "tool",
            Self::Cluster => "cluster",
            Self::Warming => "warming",
        }
    }
}

/// The number of hyper-parameters.
pub(super) const HYPERS: usize = Group::ALL.len() + 4 + AXES;

/// The places of the hyper-parameters that are not the standard deviation of a group: length scale of the quick part of
/// the smooth functions (rad), noise of a pose (mm), standard deviation and length scale of the slow part (rad), and
/// the factor on the functions of each joint.
const LENGTH: usize = Group::ALL.len();
pub(super) const SIGMA: usize = LENGTH + 1;
const SLOW: usize = LENGTH + 2;
const SLOW_LENGTH: usize = LENGTH + 3;
const OF_JOINT: usize = LENGTH + 4;

/// 95 % of a normal distribution are below this number of standard deviations.
const QUANTILE_95: f64 = 1.645;

impl HyperPrior {
    /// The priors of the groups in their order, then the others. They are typical of industrial joints: an eccentricity
    /// of half a milliradian, the other errors a fifth of it and less. Tolerance and tool ball have at least their
    /// stated standard deviations. `sigma_mm` is the repeatability of the robot along a length.
    pub(super) fn all(sigma_mm: f64) -> [Self; HYPERS] {
        let angle = |median, ln_sd| Self { median, ln_sd, bounds: [1e-8, 1e-1] };
        let factor = |ln_sd, bounds| Self { median: 1.0, ln_sd, bounds };
        let mut all = [factor(JOINT_LN_SD, [0.02, 50.0]); HYPERS];
        all[Group::Harmonic as usize] = angle(5e-4, 1.0);
        all[Group::Smooth as usize] = angle(1e-4, 1.0);
        all[Group::Backlash as usize] = angle(3e-5, 1.0);
        all[Group::Ripple as usize] = angle(2e-5, 0.7);
        all[Group::Compliance as usize] = factor(1.0, [1e-4, 1e4]);
        all[Group::Tolerance as usize] = factor(0.7, [1.0, 100.0]);
        all[Group::Tool as usize] = factor(1.0, [1.0, 10.0]);
        all[Group::Cluster as usize] = Self { median: 0.02, ln_sd: 1.0, bounds: [1e-6, 10.0] };
        all[Group::Warming as usize] = Self { median: 1e-5, ln_sd: 0.7, bounds: [1e-9, 5e-5] };
        all[LENGTH] = Self { median: 0.15, ln_sd: 1.0, bounds: [0.03, 3.0] };
        all[SIGMA] = Self { median: sigma_mm, ln_sd: 0.5, bounds: [1e-6, 1e3] };
        all[SLOW] = angle(1e-4, 1.0);
        all[SLOW_LENGTH] = Self { median: 0.5, ln_sd: 1.0, bounds: [0.3, 5.0] };
        all
    }

    /// The distance of a logarithm from its prior median, in prior standard deviations.
    pub(super) fn off(self, ln: f64) -> f64 {
        (ln - self.median.ln()) / self.ln_sd
    }

    pub(super) fn clamp(self, ln: f64) -> f64 {
        ln.clamp(self.bounds[0].ln(), self.bounds[1].ln())
    }
}

/// The joints of a robot differ by this standard deviation of the logarithm of their errors.
const JOINT_LN_SD: f64 = 0.5;

/// Logarithms of the hyper-parameters, in the order of [`HyperPrior::all`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Hypers(pub(super) [f64; HYPERS]);

impl Hypers {
    /// The medians of the priors, with this standard deviation of the lengths, mm.
    pub(super) fn start(priors: &[HyperPrior; HYPERS], sigma_mm: f64) -> Self {
        let mut start = Self(priors.map(|prior| prior.median.ln()));
        start.0[SIGMA] = priors[SIGMA].clamp(sigma_mm.ln());
        start
    }

    /// Hyper-parameters that are drawn from their priors; `normal` gives standard normal numbers.
    pub(super) fn drawn(priors: &[HyperPrior; HYPERS], mut normal: impl FnMut() -> f64) -> Self {
        Self(priors.map(|prior| prior.clamp(prior.median.ln() + prior.ln_sd * normal())))
    }

    /// The hyper-parameters of joints before any length.
    pub(super) fn usual() -> Self {
        Self::start(&HyperPrior::all(1.0), 1.0)
    }

    /// The hyper-parameters of joints before any length, with the root of the mean square of each standard deviation over its prior:
    /// of a log-normal distribution the median times exp(variance).
    pub(super) fn root_mean_square() -> Self {
        let priors = HyperPrior::all(1.0);
        let is_sd = |at: usize| at < Group::ALL.len() || at == SLOW || at >= OF_JOINT;
        let ln = |at: usize| priors[at].median.ln() + if is_sd(at) { priors[at].ln_sd.powi(2) } else { 0.0 };
        Self(std::array::from_fn(ln))
    }

    /// One standard deviation of a group, in its unit; for smooth functions that of the quick part, before the factor
    /// of a joint.
    pub(super) fn sd(&self, group: Group) -> f64 {
        self.0[group as usize].exp()
    }

    pub(super) fn with_sigma(mut self, sigma_mm: f64) -> Self {
        self.0[SIGMA] = sigma_mm.ln();
        self
    }

    /// With these standard deviations of groups, in their units.
    pub(super) fn with_groups(mut self, sds: impl IntoIterator<Item = (Group, f64)>) -> Self {
        sds.into_iter().for_each(|(group, sd)| self.0[group as usize] = sd.ln());
        self
    }

    /// The hyper-parameters with standard deviations replaced by their posterior means, where `ln_sd` are the standard
    /// deviations of their logarithms. A standard deviation that the data do not support becomes larger than its most
    /// probable value, but at most the 95 % quantile of its prior.
    pub(super) fn mean_sds(mut self, priors: &[HyperPrior; HYPERS], ln_sd: &[f64; HYPERS]) -> Self {
        let is_sd = |at: usize| at < Group::ALL.len() || at == SLOW;
        for at in (0..HYPERS).filter(|at| is_sd(*at)) {
            let most = priors[at].median.ln() + QUANTILE_95 * priors[at].ln_sd;
            let wider = self.0[at] + 0.5 * ln_sd[at] * ln_sd[at];
            self.0[at] = wider.min(most).max(self.0[at]);
        }
        self
    }

    /// The processes whose sum the smooth functions are: a quick and a slow one.
    pub(super) fn processes(&self) -> [GaussianProcess; 2] {
        Self::PROCESSES.map(|[sd, length]| GaussianProcess {
            sd_rad: self.0[sd].exp(),
            length_scale_rad: self.0[length].exp(),
        })
    }

    /// The places of the processes' standard deviations and length scales.
    const PROCESSES: [[usize; 2]; 2] = [[Group::Smooth as usize, LENGTH], [SLOW, SLOW_LENGTH]];

    /// The factor on the smooth functions of each joint.
    pub(super) fn of_joints(&self) -> [f64; AXES] {
        std::array::from_fn(|joint| self.0[OF_JOINT + joint].exp())
    }

    pub(super) fn sigma_mm(&self) -> f64 {
        self.0[SIGMA].exp()
    }
}

/// The source of the prior variance of an unknown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Variance {
    /// A fixed standard deviation.
    Fixed(f64),
    /// The standard deviation of a group times a factor.
    Of(Group, f64),
    /// The spectral density of a joint's smooth function at this angular frequency (1/rad).
    Spectral(Joint, f64),
    /// A standard deviation of backlash that follows from the noise.
    ByNoise(f64),
}

impl Variance {
    pub(super) fn value(self, hypers: &Hypers) -> f64 {
        match self {
            Self::Fixed(sd) | Self::ByNoise(sd) => sd * sd,
            Self::Of(group, unit) => (unit * hypers.sd(group)).powi(2),
            Self::Spectral(joint, frequency) => {
                let density: f64 =
                    hypers.processes().iter().map(|part| part.spectral_density(frequency)).sum();
                density * hypers.of_joints()[joint.index()].powi(2)
            }
        }
    }

    /// Gives the derivative of the variance's logarithm by the logarithm of each hyper-parameter on which it depends to
    /// `each`, with the place of the hyper-parameter.
    pub(super) fn slopes(self, hypers: &Hypers, mut each: impl FnMut(usize, f64)) {
        match self {
            Self::Fixed(_) | Self::ByNoise(_) => {}
            Self::Of(group, _) => each(group as usize, 2.0),
            Self::Spectral(joint, frequency) => {
                let processes = hypers.processes();
                let whole: f64 = processes.iter().map(|part| part.spectral_density(frequency)).sum();
                for ([sd, length], part) in Hypers::PROCESSES.into_iter().zip(processes) {
                    let share = part.spectral_density(frequency) / whole;
                    let a2 = 5.0 / part.length_scale_rad.powi(2);
                    each(sd, 2.0 * share);
                    each(length, share * (6.0 * a2 / (a2 + frequency * frequency) - 5.0));
                }
                each(OF_JOINT + joint.index(), 2.0);
            }
        }
    }

    /// Gives the second derivatives of the variance's logarithm, as [`Self::slopes`] gives the first, with the places of both
    /// hyper-parameters. Of a sum of densities with the shares s_k the slopes are sum s_k l_k and the second derivatives
    /// sum s_k (l_k l_k' + l_k,') less the product of the slopes.
    pub(super) fn curvatures(self, hypers: &Hypers, mut each: impl FnMut(usize, usize, f64)) {
        let Self::Spectral(_, frequency) = self else { return };
        let processes = hypers.processes();
        let whole: f64 = processes.iter().map(|part| part.spectral_density(frequency)).sum();
        let parts = processes.map(|part| {
            let a2 = 5.0 / part.length_scale_rad.powi(2);
            let near = a2 / (a2 + frequency * frequency);
            let share = part.spectral_density(frequency) / whole;
            (share, [2.0, 6.0 * near - 5.0], -12.0 * near * (1.0 - near))
        });
        for (k, (share, slopes, bend)) in parts.iter().enumerate() {
            for (l, (other_share, other_slopes, _)) in parts.iter().enumerate() {
                for (i, j) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                    let own = if k == l { share * slopes[i] * slopes[j] } else { 0.0 };
                    let product = share * slopes[i] * other_share * other_slopes[j];
                    each(Hypers::PROCESSES[k][i], Hypers::PROCESSES[l][j], own - product);
                }
            }
            each(Hypers::PROCESSES[k][1], Hypers::PROCESSES[k][1], share * bend);
        }
    }

    /// One standard deviation.
    pub(super) fn sd(self, hypers: &Hypers) -> f64 {
        self.value(hypers).sqrt()
    }

    /// The group to which the unknown belongs.
    pub(super) fn group(self) -> Option<Group> {
        match self {
            Self::Fixed(_) => None,
            Self::Of(group, _) => Some(group),
            Self::Spectral(..) => Some(Group::Smooth),
            Self::ByNoise(_) => Some(Group::Backlash),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The mean of a log-normal distribution is its median times exp(variance / 2). 95 % of the prior of backlash, of median
    /// 30 urad and a standard deviation of 1 of the logarithm, are below 30 e^1.645 urad.
    #[test]
    fn what_the_data_do_not_support_is_larger_than_its_likeliest_value() {
        let priors = HyperPrior::all(0.02);
        let mut hypers = Hypers::start(&priors, 0.01);
        let mut ln_sd = [0.0; HYPERS];
        (ln_sd[Group::Harmonic as usize], ln_sd[SLOW], ln_sd[Group::Backlash as usize]) = (0.4, 0.6, 3.0);
        ln_sd[SIGMA] = 1.0;
        let mean = hypers.mean_sds(&priors, &ln_sd);
        assert!((mean.sd(Group::Harmonic) / (5e-4 * 0.08f64.exp()) - 1.0).abs() < 1e-12);
        assert!((mean.processes()[1].sd_rad / (1e-4 * 0.18f64.exp()) - 1.0).abs() < 1e-12);
        assert!((mean.sd(Group::Backlash) / (3e-5 * 1.645f64.exp()) - 1.0).abs() < 1e-12);
        assert_eq!(mean.sigma_mm(), hypers.sigma_mm());
        // What is above the quantile already stays.
        hypers.0[Group::Backlash as usize] = 1e-3f64.ln();
        assert!((hypers.mean_sds(&priors, &ln_sd).sd(Group::Backlash) / 1e-3 - 1.0).abs() < 1e-12);
    }

    #[test]
    fn slopes_and_curvatures_of_a_variance_are_its_derivatives() {
        let priors = HyperPrior::all(0.02);
        let hypers = Hypers::start(&priors, 0.01);
        for variance in [
            Variance::Fixed(2.0),
            Variance::ByNoise(3e-5),
            Variance::Of(Group::Tolerance, 0.5),
            Variance::Spectral(Joint::J3, 4.0),
        ] {
            let mut slopes = [0.0; HYPERS];
            variance.slopes(&hypers, |at, slope| slopes[at] += slope);
            for (at, slope) in slopes.into_iter().enumerate() {
                let moved = |step: f64| {
                    let mut moved = hypers;
                    moved.0[at] += step;
                    variance.value(&moved).ln()
                };
                let numeric = (moved(1e-5) - moved(-1e-5)) / 2e-5;
                assert!((slope - numeric).abs() < 1e-8, "{variance:?} {at}: {slope} {numeric}");
                let slopes_at = |step: f64| {
                    let (mut moved, mut slopes) = (hypers, [0.0; HYPERS]);
                    moved.0[at] += step;
                    variance.slopes(&moved, |at, slope| slopes[at] += slope);
                    slopes
                };
                let mut curvatures = [0.0; HYPERS];
                variance.curvatures(&hypers, |one, other, curvature| {
                    curvatures[other] += if one == at { curvature } else { 0.0 };
                });
                for (other, [high, low]) in
                    slopes_at(1e-5).into_iter().zip(slopes_at(-1e-5)).map(|(a, b)| [a, b]).enumerate()
                {
                    assert!((curvatures[other] - (high - low) / 2e-5).abs() < 1e-8, "{at} {other}");
                }
            }
        }
    }

    /// A tolerance of 1 is the least that it can be; the logarithm of 2 is ln 2 / 0.7 standard deviations away.
    #[test]
    fn deviate_of_a_hyper_parameter_is_that_of_its_logarithm() {
        let prior = HyperPrior::all(0.02)[Group::Tolerance as usize];
        assert!((prior.off(2f64.ln()) - 2f64.ln() / 0.7).abs() < 1e-12);
        assert_eq!([prior.clamp(-1.0), prior.clamp(1.0)], [0.0, 1.0]);
    }
}
