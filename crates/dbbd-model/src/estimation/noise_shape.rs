//! The noise of lengths, pose by pose.
//!
//! Where the sense of approach is not known, the angle of a joint is wrong by half of its reversal error, to either
//! side. Where the sense is known, a joint may still scatter: its last move can be too short to cross the play. Both
//! are noise in the direction in which the joint moves the tool ball, and act on the lengths of a pose together. If the
//! independent noise of each length cannot be separated from the noise of the pose, it keeps the stated value.

use super::hyper_parameters::{Group, HyperPrior};
use super::pose_rows::{PoseRows, RowNoise};
use crate::robot::AXES;

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

    pub(super) fn with_sought(self, sds: [f64; AXES]) -> Self {
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
    pub(super) fn is_in(self, sense: i8) -> bool {
        self.is_approached() || sense == 0
    }

    /// Standard deviations of the joints' angles at a length with these senses of approach, rad.
    pub(super) fn sds(self, senses: &[i8; AXES]) -> [f64; AXES] {
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

    pub(super) fn prior(self) -> HyperPrior {
        let of_backlash = HyperPrior::all(1.0)[Group::Backlash as usize];
        match self {
            Self::Approached { .. } => HyperPrior { median: SCATTER_RAD, ..of_backlash },
            Self::Unapproached(_) => of_backlash,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
