//! A fit with errors of the joints, and what a result says of it.

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::evidence::{Hypers, Variance};
use super::joint_system::{System, Whitened};
use super::joint_unknowns::{JointUnknowns, Terms};
use super::noise_shape::{BacklashNoise, NoiseScore, NoiseShape};
use super::pose_rows::LengthNoise;
use super::prior::PriorRows;
use super::priors::Group;
use crate::measurement::LengthModel;
use crate::robot::{AXES, GaussianProcess, ParamId, RobotUncertainty};

/// A fit with the noise of a pose, and with errors of the joints where there are groups of them.
#[derive(Clone, Debug)]
pub(crate) struct JointFit {
    pub(super) model: LengthModel,
    /// Parameters that are estimated, in canonical order.
    pub(super) ids: Vec<ParamId>,
    /// Their priors.
    pub(super) prior: PriorRows,
    /// A root of the covariance of parameters and coefficients, a row each.
    pub(super) root: DMatrix<f64>,
    pub(super) groups: Vec<GroupEvidence>,
    /// How many parameters and coefficients the data determine.
    pub(super) effective_parameters: f64,
    /// Of the lengths with all that moves them, mm.
    pub(super) sigma_mm: f64,
    pub(super) noise: LengthNoise<'static>,
    pub(super) hypers: Hypers,
    /// The hyper-parameters that the uncertainty is of.
    pub(super) cautious: Hypers,
    pub(super) shape: NoiseShape,
    /// What an unknown sense of approach leaves of each joint's angle, rad.
    unapproached_rad: [f64; AXES],
    /// Gain in the logarithm of the evidence over the geometry alone.
    pub(super) gain: f64,
}

/// What the evidence says of a group.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GroupEvidence {
    #[serde(rename = "name")]
    pub group: Group,
    /// One standard deviation of its members by the evidence: rad, of compliance in prior standard deviations.
    pub sd: f64,
    /// How many of its members the data determine.
    pub effective_parameters: f64,
    /// What it explains of the lengths beyond the geometry and the groups before it, root mean square, mm.
    pub rms_mm: f64,
    /// Its share of the squares of the residuals that the geometry alone leaves.
    pub share: f64,
}

/// The errors of the joints in a result; this is `joint_errors` of `result.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JointSummary {
    /// The smooth functions are the sum of a fast and a slow process.
    pub smooth: [GaussianProcess; 2],
    /// Half of the reversal error of each joint as noise, one standard deviation, rad, if no sense of approach is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub backlash_noise_rad: Option<[f64; AXES]>,
    /// Gain in the logarithm of the evidence over the geometry alone.
    #[serde(rename = "log_evidence_gain")]
    pub gain: f64,
}

/// A linearisation and the hyper-parameters found.
pub(super) struct Solution<'a> {
    pub(super) unknowns: &'a JointUnknowns,
    pub(super) system: &'a System,
    pub(super) whitened: &'a Whitened,
    pub(super) hypers: Hypers,
    pub(super) cautious: Hypers,
}

impl Solution<'_> {
    /// What each group that can be estimated came to; what it explains is beyond the groups before it.
    fn groups(&self, determined: &[f64]) -> Option<Vec<GroupEvidence>> {
        let group_of = |k: usize| self.system.variances[k].and_then(Variance::group);
        let unknowns = 0..self.system.variances.len();
        let is_present = |group: &Group| unknowns.clone().any(|k| group_of(k) == Some(*group));
        let present: Vec<Group> = Group::ALL.into_iter().filter(is_present).collect();
        let of_geometry = self.mean_square(&[])?;
        let mut before = of_geometry;
        let mut groups = Vec::new();
        for (at, group) in present.iter().enumerate() {
            let left = self.mean_square(&present[..=at])?;
            let explained = (before - left).max(0.0);
            let members = unknowns.clone().filter(|&k| group_of(k) == Some(*group));
            groups.push(GroupEvidence {
                group: *group,
                sd: self.sd_of(*group),
                effective_parameters: members.map(|k| determined[k]).sum(),
                rms_mm: explained.sqrt(),
                share: explained / of_geometry,
            });
            before = left;
        }
        Some(groups)
    }

    /// Mean square of the residuals that the geometry and these groups leave, mm^2.
    fn mean_square(&self, groups: &[Group]) -> Option<f64> {
        let equations = self.whitened.equations.with_groups(groups);
        Some(self.system.mean_square(&equations.posterior(&self.hypers)?.mean))
    }

    /// One standard deviation of the members of a group.
    fn sd_of(&self, group: Group) -> f64 {
        match (group, self.whitened.shape.backlash) {
            (Group::Smooth, _) => {
                let [quick, slow] = self.hypers.processes();
                quick.sd_rad.hypot(slow.sd_rad)
            }
            (Group::Backlash, BacklashNoise::Sought(sds)) => {
                let moved = sds.iter().filter(|sd| **sd > 0.0).count().max(1) as f64;
                (sds.iter().map(|sd| sd * sd).sum::<f64>() / moved).sqrt()
            }
            _ => self.hypers.sd(group),
        }
    }
}

impl JointFit {
    /// With the model that was reached.
    pub(super) fn of(solution: &Solution<'_>, model: LengthModel, gain: f64) -> Option<Self> {
        let Solution { unknowns, system, whitened, hypers, cautious } = solution;
        let shape = whitened.shape;
        let posterior = whitened.equations.posterior(cautious)?;
        let (root, determined) = (posterior.root()?, posterior.determined());
        let backlash_places = unknowns.backlash_places(&model);
        let score = NoiseScore {
            rows: &system.rows,
            whitened,
            sigma_mm: cautious.sigma_mm(),
            mean: &posterior.mean,
            root: &root,
            backlash_places,
        };
        let of_coefficient = |place: Option<usize>| place.map_or(0.0, |place| root.row(place).norm());
        let unapproached_rad = match shape.backlash {
            // Several lengths show the scatter of a pose in other directions too: what more backlash adds, sigma loses.
            BacklashNoise::Sought(sds) if system.rows.share_poses() => sds,
            BacklashNoise::Sought(_) => score.rms_rad()?,
            BacklashNoise::Known(sds) => {
                std::array::from_fn(|joint| sds[joint].hypot(of_coefficient(backlash_places[joint])))
            }
        };
        let sd = |variance: &Option<Variance>| variance.map(|variance| variance.sd(hypers));
        let sds: Vec<Option<f64>> = unknowns.variances.iter().map(sd).collect();
        Some(Self {
            prior: PriorRows::independent(&sds, &unknowns.means),
            root,
            groups: solution.groups(&determined)?,
            effective_parameters: determined.iter().sum(),
            sigma_mm: system.rms_sd(shape, cautious.sigma_mm()) * cautious.sigma_mm(),
            noise: LengthNoise {
                pose_mm: cautious.sigma_mm(),
                length_mm: shape.ratio * cautious.sigma_mm(),
                joints: None,
            },
            hypers: *hypers,
            cautious: *cautious,
            shape,
            unapproached_rad,
            gain,
            ids: unknowns.ids.clone(),
            model,
        })
    }

    /// What was unknown.
    pub(super) fn terms(&self) -> Terms {
        if self.groups.is_empty() { Terms::Geometry } else { Terms::JointErrors }
    }

    /// What is not known of the robot, its tool ball and the base balls.
    pub(super) fn uncertainty(&self) -> RobotUncertainty {
        let is_own = |id: ParamId| id.moves_tool_ball() || matches!(id, ParamId::Ball(..));
        let own = (0..self.ids.len()).filter(|&k| is_own(self.ids[k]));
        let own: Vec<usize> = own.collect();
        let rows: Vec<usize> = own.iter().copied().chain(self.ids.len()..self.root.nrows()).collect();
        RobotUncertainty {
            parameters: own.iter().map(|&k| self.ids[k]).collect(),
            root: self.root.select_rows(&rows),
            pose_mm: self.noise.pose_mm,
            smooth: match self.terms() {
                Terms::Geometry => Vec::new(),
                Terms::JointErrors => self.cautious.processes().to_vec(),
            },
            unapproached_rad: self.unapproached_rad,
        }
    }

    pub(super) fn summary(&self) -> JointSummary {
        JointSummary {
            smooth: self.hypers.processes(),
            backlash_noise_rad: (!self.shape.backlash.is_known()).then(|| self.shape.backlash.sds()),
            gain: self.gain,
        }
    }
}
